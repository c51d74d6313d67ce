"""The published sky model."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.geometry import DirectionGrid, Directions, dome_343
from atmofit.models.preetham import PREETHAM_1999, PreethamModel


def test_zenith_luminance_is_the_papers():
    """Values that SYSTEMS P5 verified, kcd m^-2 at 0, 10, ..., 90 degrees for T = 2."""
    known = [15.5, 9.89, 7.37, 5.89, 4.87, 4.11, 3.49, 2.95, 2.46, 1.99]
    xyY = PREETHAM_1999.zenith(2.0, np.radians(np.arange(0, 91, 10)))
    np.testing.assert_allclose(xyY[:, 2] / 1e3, known, atol=0.0052)


def test_zenith_is_where_the_sky_is_that_value():
    sky = PREETHAM_1999(3.0, 1.0, Directions(np.zeros(1), np.zeros(1)))
    np.testing.assert_allclose(sky[0], PREETHAM_1999.zenith(3.0, 1.0), rtol=1e-12)


def test_formula_written_out():
    """One direction by hand, in plain NumPy."""
    T, sun, view, azimuth = 4.0, 0.9, 1.1, 2.0
    cosine = np.cos(view) * np.cos(sun) + np.sin(view) * np.sin(sun) * np.cos(azimuth)
    angle = np.arccos(cosine)
    A, B, C, D, E = (0.1787 * T - 1.4630, -0.3554 * T + 0.4275, -0.0227 * T + 5.3251,
                     0.1206 * T - 2.5771, -0.0670 * T + 0.3703)  # fmt: skip

    def F(θ, γ):
        return (1 + A * np.exp(B / np.cos(θ))) * (1 + C * np.exp(D * γ) + E * np.cos(γ) ** 2)

    chi = (4 / 9 - T / 120) * (np.pi - 2 * sun)
    zenith = 1e3 * ((4.0453 * T - 4.9710) * np.tan(chi) - 0.2155 * T + 2.4192)
    sky = PREETHAM_1999(T, sun, Directions(np.array([view]), np.array([azimuth])))
    np.testing.assert_allclose(sky[0, 2], zenith * F(view, angle) / F(0, sun), rtol=1e-12)


def test_grid_and_list_agree():
    grid = DirectionGrid(np.linspace(0, 1.5, 4), np.linspace(0, 3, 5))
    sky = PREETHAM_1999(2.5, 0.6, grid)
    assert sky.shape == (4, 5, 3)
    np.testing.assert_allclose(sky.reshape(-1, 3), PREETHAM_1999(2.5, 0.6, grid.as_list()))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_finite_and_positive_over_the_whole_range(dtype):
    dome = dome_343()
    rim = np.array([np.pi / 2, np.pi / 2, 0.0])
    dirs = Directions(
        jnp.concatenate([dome.view_zenith_angle, rim]).astype(dtype),
        jnp.concatenate([dome.relative_azimuth, np.array([0.0, np.pi, 0.0])]).astype(dtype),
    )

    def total(T, sun):
        sky = PREETHAM_1999(T, sun, dirs)
        return sky.sum(), sky

    both = jax.jit(jax.vmap(jax.value_and_grad(total, argnums=(0, 1), has_aux=True)))
    T, sun = np.meshgrid([1.7, 2.0, 6.0, 10.0], np.radians([0, 30, 60, 89, 90]), indexing="ij")
    (_, sky), slopes = both(T.ravel().astype(dtype), sun.ravel().astype(dtype))
    assert sky.dtype == dtype
    assert np.isfinite(sky).all()
    assert (sky[..., 2] > 0).all()
    for slope in slopes:
        assert np.isfinite(slope).all()


def test_coefficients_can_be_differentiated_and_changed():
    dirs = dome_343()

    @jax.jit
    @jax.grad
    def slope(matrix):
        model = eqx.tree_at(lambda m: m.luminance_distribution, PREETHAM_1999, matrix)
        return model(3.0, 0.8, dirs)[..., 2].mean()

    assert np.isfinite(slope(jnp.asarray(PREETHAM_1999.luminance_distribution))).all()


def test_negative_luminance_is_not_clipped():
    wide = eqx.tree_at(
        lambda m: m.zenith_luminance, PREETHAM_1999, np.array([4.0453, -4.9710, -0.2155, 0.0])
    )
    assert float(wide.zenith(6.0, np.pi / 2)[2]) < 0


@pytest.mark.parametrize(
    ("turbidity", "sun", "view", "message"),
    [
        (1.5, 0.5, 0.1, r"turbidity must be between 1.7 and 10, got 1.5"),
        (10.5, 0.5, 0.1, "turbidity.*got 10.5"),
        (np.nan, 0.5, 0.1, "turbidity.*got nan"),
        (3.0, 1.6, 0.1, "solar_zenith_angle.*1.5708 rad, got 1.6"),
        (3.0, 0.5, 1.58, "view_zenith_angle.*got 1.58"),
    ],
)
def test_out_of_range(turbidity, sun, view, message):
    with pytest.raises(ValueError, match=message):
        PREETHAM_1999(turbidity, sun, Directions(np.array([view]), np.zeros(1)))


def test_traced_out_of_range_is_nan():
    dirs = Directions(np.zeros(1), np.zeros(1))
    assert np.isnan(jax.jit(lambda T: PREETHAM_1999(T, 0.5, dirs))(1.5)).all()
    assert np.isnan(jax.jit(lambda s: PREETHAM_1999(3.0, s, dirs))(1.6)).all()


def test_bad_model():
    matrices = {
        "x_distribution": np.ones((5, 2)),
        "y_distribution": np.ones((5, 2)),
        "luminance_distribution": np.ones((5, 2)),
        "zenith_x": np.ones((3, 4)),
        "zenith_y": np.ones((3, 4)),
        "zenith_luminance": np.ones(4),
    }
    with pytest.raises(ValueError, match=r"turbidity_range must increase.*\(5, 2\)"):
        PreethamModel(**matrices, turbidity_range=(5.0, 2.0))


def test_in_single_precision_after_double():
    sky = DirectionGrid(jnp.array([0.3, 0.9]), jnp.array([0.0]))
    traced = jax.jit(lambda T, s, sky: PREETHAM_1999(T, s, sky))
    double = traced(3.0, 0.9, sky)
    with jax.enable_x64(False):
        single = traced(*jax.tree.map(jnp.float32, (3.0, 0.9, sky)))
        assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, rtol=1e-5)
