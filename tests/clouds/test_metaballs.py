"""The field of metaballs, against the polynomial of its source."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.clouds.metaballs import fields, metaballs

RANDOM = np.random.default_rng(3)
CENTRES, RADII = RANDOM.uniform(-1, 1, (7, 3)), RANDOM.uniform(0.3, 0.9, 7)
DENSITIES = RANDOM.uniform(0.2, 1.0, 7)
PLACES = RANDOM.uniform(-1.5, 1.5, (200, 3))
BALLS = metaballs(CENTRES, RADII, DENSITIES, 0.3)


def plain(places):
    """The polynomial in r / R as the source has it."""
    x = np.linalg.norm(places[:, None] - CENTRES, axis=-1) / RADII
    f = 1 - 22 / 9 * x**2 + 17 / 9 * x**4 - 4 / 9 * x**6
    return np.where(x < 1, f, 0) @ DENSITIES


def test_density_is_the_sources_polynomial():
    # A few roundings of numbers up to 17/9, seven times.
    np.testing.assert_allclose(BALLS.density(PLACES), plain(PLACES), rtol=0, atol=5e-14)


def test_outward_is_minus_the_gradient():
    slopes = jax.vmap(jax.grad(BALLS.density))(jnp.asarray(PLACES))
    np.testing.assert_allclose(fields(BALLS, jnp.asarray(PLACES)).outward, -slopes, atol=1e-12)


def test_differentiable_in_everything():
    def total(balls):
        return jnp.sum(fields(balls, jnp.asarray(PLACES)).density)

    slopes, step = jax.grad(total)(BALLS), 1e-6
    for name, where in (("centres", (2, 1)), ("radii", (3,)), ("densities", (4,))):
        array = np.array(getattr(BALLS, name))
        ends = []
        for sign in (1, -1):
            moved = array.copy()
            moved[where] += sign * step
            values = {"centres": CENTRES, "radii": RADII, "densities": DENSITIES, name: moved}
            ends.append(float(total(metaballs(**values, threshold=0.3))))
        # Rounding of a sum of about 60 over the step, and the step squared.
        assert getattr(slopes, name)[where] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


def test_no_balls():
    assert float(metaballs([], [], []).density([1.0, 2.0, 3.0])) == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((1, 3)), [0.0], [1.0]), "radii must be between 0.001 and 1e"),
        ((np.zeros((1, 3)), [1.0], [-1.0]), "densities must be between 0 and"),
        ((np.zeros((1, 3)), [1.0], [1.0], 0.0), "threshold must be between 1e-06"),
        ((np.full((1, 3), np.nan), [1.0], [1.0]), "centres must be between"),
        ((np.zeros((2, 3)), [1.0], [1.0]), r"\[n, 3\], \[n\] and \[n\]"),
    ],
)
def test_impossible_balls_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        metaballs(*arguments)


def test_places_are_checked():
    with pytest.raises(ValueError, match="axis of size 3"):
        BALLS.density(np.zeros((5, 2)))
    with pytest.raises(ValueError, match="position must be between"):
        BALLS.density([np.inf, 0.0, 0.0])
