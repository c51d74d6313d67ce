"""Free parameters, prior and weighting of the Perez fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.fit import parameters, weighting
from atmofit.fit.parameters import PerezPrior
from atmofit.models.preetham import PREETHAM_1999

PUBLISHED = np.array(
    [
        matrix @ np.array([T, 1.0])
        for matrix in (
            PREETHAM_1999.luminance_distribution,
            PREETHAM_1999.x_distribution,
            PREETHAM_1999.y_distribution,
        )
        for T in (2.0, 4.0, 6.0)
    ]
)


def test_free_parameters_hold_every_published_sky():
    free = parameters.to_free(jnp.asarray(PUBLISHED))
    assert np.isfinite(free).all()
    np.testing.assert_allclose(parameters.to_coefficients(free), PUBLISHED, rtol=1e-12)


def test_any_free_parameters_are_a_sky():
    free = np.random.default_rng(5).normal(size=(1000, 5)) * 2
    A, B, _, D, _ = np.moveaxis(np.asarray(parameters.to_coefficients(jnp.asarray(free))), -1, 0)
    assert (B < 0).all()
    assert (D < 0).all()
    assert (1 + A * np.exp(B) > -1e-9).all()


def test_candidates_differ_and_are_finite():
    table = parameters.candidates()
    assert table.shape == (42, 5)
    assert np.isfinite(table).all()
    assert np.unique(table, axis=0).shape == table.shape


def test_random_starts_lie_in_the_box_and_come_again():
    starts = parameters.random_starts(500, 2, seed=3)
    np.testing.assert_array_equal(starts, parameters.random_starts(500, 2, seed=3))
    assert (starts != parameters.random_starts(500, 2, seed=4)).any()
    assert (starts[:, 0] != starts[:, 1]).any()
    drawn = np.asarray(parameters.to_coefficients(jnp.asarray(starts)))
    low, high = np.array(parameters.LOWEST_START), np.array(parameters.HIGHEST_START)
    inside = (drawn > low - 1e-9) & (drawn < high + 1e-9)
    dark = np.isclose(starts[..., 0], np.log(parameters.DARKEST_START))
    assert inside[..., 1:].all()
    assert inside[~dark].all()  # a dark start keeps B and gets another A
    assert 0 < dark.mean() < 0.02
    spread = drawn[..., 1:].reshape(-1, 4)
    expected = (low + high)[1:] / 2
    np.testing.assert_allclose(spread.mean(axis=0), expected, atol=0.05 * (high - low)[1:].max())


def test_prior_is_a_ridge_in_its_widths():
    prior = PerezPrior(strength=0.1)
    free = jnp.asarray(np.random.default_rng(7).normal(size=(3, 5)))
    np.testing.assert_allclose(prior.residuals(free), 0.1 * np.asarray(prior.place(free)))
    np.testing.assert_allclose(prior.free(prior.place(free)), free, rtol=1e-12)


@pytest.mark.parametrize("ends", [1, 2])
def test_paths_end_with_the_prior(ends):
    prior = PerezPrior(strength=0.02)
    paths = parameters.paths(prior, ends, jnp.dtype("float64"))
    assert paths.pulls.shape == (4, 5 * ends)
    np.testing.assert_allclose(paths.ridges[:, -1], 0.02)
    np.testing.assert_allclose(paths.ridges[0], 0.02)
    np.testing.assert_allclose(paths.ridges[1:], [[0.1, 0.02, 0.02]] * 3)


def test_prior():
    prior = PerezPrior(strength=0.1)
    centre = jnp.asarray(np.stack([prior.centre, prior.centre + prior.width]))
    np.testing.assert_allclose(prior.residuals(centre), [np.zeros(5), np.full(5, 0.1)], atol=1e-12)
    with pytest.raises(ValueError, match=r"strength must be at least 0, got -1"):
        PerezPrior(strength=-1)
    with pytest.raises(ValueError, match="width must be positive"):
        PerezPrior(width=(1, 1, 1, 1, 0))
    with pytest.raises(ValueError, match="centre must hold 5 finite numbers"):
        PerezPrior(centre=(1, 2))


@pytest.mark.parametrize("kind", weighting.WEIGHTINGS)
def test_best_scale_is_the_minimum(kind):
    rng = np.random.default_rng(6)
    shape = jnp.asarray(rng.uniform(0.5, 2.0, 50))
    values = 7.0 * shape * jnp.asarray(rng.uniform(0.9, 1.1, 50))

    def loss(scale):
        return jnp.sum(weighting.measure(values, kind).misfit(scale * shape, values) ** 2)

    best = weighting.measure(values, kind).best_scale(shape, values)
    curvature = float(jax.grad(jax.grad(loss))(best))
    assert abs(float(jax.grad(loss)(best))) < 1e-9 * curvature * float(best)
    assert float(best) == pytest.approx(7.0, rel=0.05)


def test_misfits_agree_where_they_are_small():
    values = jnp.asarray([2.0, 3.0, 4.0])
    model = values * (1 + 1e-5)
    relative = weighting.measure(values, "relative").misfit(model, values)
    np.testing.assert_allclose(relative, 1e-5, rtol=1e-6)
    np.testing.assert_allclose(
        weighting.measure(values, "log").misfit(model, values), relative, rtol=1e-4
    )
    absolute = weighting.measure(values, "absolute").misfit(model, values)
    np.testing.assert_allclose(absolute * np.sqrt(29 / 3), (model - values), rtol=1e-9)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_logarithm_goes_on_below_zero(dtype):
    x = jnp.asarray([-1.0, 0.0, 1e-7, 1e-6, 1e-5, 1.0], dtype)
    values, slopes = jax.vmap(jax.value_and_grad(weighting.safe_log))(x)
    assert np.isfinite(values).all()
    assert (np.diff(values) > 0).all()
    assert np.isfinite(slopes).all()
    assert (slopes > 0).all()
