"""The US Standard Atmosphere 1976: published values, hydrostatics, and its exponential layers."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import atmofit as af
from atmofit.optics import exponential_layers
from atmofit.optics.exponential_layers import ExponentialLayers
from atmofit.optics.standard_atmosphere import (
    geopotential_altitude,
    standard_density_profile,
    standard_number_density,
    standard_pressure,
    standard_temperature,
)

RADIUS = 6371e3
EARTH = 6356.766e3  # of the standard
# Geopotential altitude [m], temperature [K] and pressure [Pa] as published.
PUBLISHED = [
    (0.0, 288.15, 101325.0),
    (11e3, 216.65, 22632.06),
    (20e3, 216.65, 5474.889),
    (32e3, 228.65, 868.0187),
    (47e3, 270.65, 110.9063),
    (51e3, 270.65, 66.93887),
    (71e3, 214.65, 3.956420),
    (84.852e3, 186.946, 0.3733836),
]


@pytest.mark.parametrize(("height", "temperature", "pressure"), PUBLISHED)
def test_published_values(height, temperature, pressure):
    z = height * EARTH / (EARTH - height)
    assert float(geopotential_altitude(z)) == pytest.approx(height, rel=1e-14)
    assert float(standard_temperature(z)) == pytest.approx(temperature, rel=1e-6)
    assert float(standard_pressure(z)) == pytest.approx(pressure, rel=3e-7)  # seven digits


@pytest.mark.parametrize(
    ("z", "temperature", "pressure", "number"),
    [
        (0.0, 288.150, 1.01325e5, 2.5470e25),
        (5e3, 255.676, 5.4048e4, 1.5312e25),
        (10e3, 223.252, 2.6499e4, 8.5976e24),
        (30e3, 226.509, 1.1970e3, 3.8278e23),
        (50e3, 270.650, 7.9779e1, 2.1351e22),
    ],
)
def test_published_table(z, temperature, pressure, number):
    """Table 1 of the standard, five digits."""
    assert float(standard_temperature(z)) == pytest.approx(temperature, abs=6e-4)
    assert float(standard_pressure(z)) == pytest.approx(pressure, rel=5e-5)
    assert float(standard_number_density(z)) == pytest.approx(number, rel=5e-5)


def test_hydrostatic_equilibrium():
    """The slope of the logarithm of pressure is minus the weight of a molecule over k T."""
    z = jnp.asarray(np.linspace(10.0, 1.2e5, 500))
    slope = jax.vmap(jax.grad(lambda a: jnp.log(standard_pressure(a))))(z)
    gravity = 9.80665 * (EARTH / (EARTH + z)) ** 2
    expected = -gravity * 28.9644 / (8314.32 * standard_temperature(z))
    np.testing.assert_allclose(slope, expected, rtol=1e-9)


def test_the_column_weighs_what_the_pressure_says():
    """Independent of the profile: pressure over the weight, at the altitude of its mass."""
    z = np.linspace(0.0, 2e5, 40001)
    n, g = np.asarray(standard_number_density(z)), 9.80665 * (EARTH / (EARTH + z)) ** 2
    mass = 28.9644 / 6.022169e26
    assert np.trapezoid(n * g, z) * mass == pytest.approx(101325.0, rel=2e-6)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_values_and_slopes_are_finite(dtype):
    z = jnp.asarray([0.0, 11019.0, 11019.1, 5e4, 86e3, 2e5], dtype)
    for function in (standard_temperature, standard_pressure, standard_number_density):
        value, slope = jax.vmap(jax.value_and_grad(function))(z)
        assert value.dtype == dtype
        assert (np.asarray(value) > 0).all()
        assert np.isfinite(slope).all()


def test_altitudes_outside_are_refused():
    for bad in (-1.0, 3e5):
        with pytest.raises(ValueError, match="altitude must be between 0 and 200000 m, got"):
            standard_pressure(bad)


@pytest.fixture(scope="module")
def truth():
    """Density and column above of the standard, over the whole column, every 0.5 m."""
    z = np.linspace(0.0, 2e5, 400001)
    n = np.asarray(standard_number_density(z))
    below = np.concatenate([[0.0], np.cumsum((n[1:] + n[:-1]) / 2) * z[1]])
    return z, n / below[-1], 1 - below / below[-1]


@pytest.mark.parametrize(
    ("highest", "of_density", "of_column"),
    [(3e4, 0.0068, 0.00125), (5e4, 0.0071, 0.0018), (86e3, 0.029, 0.0147)],
)
def test_layers_fit_the_standard(truth, highest, of_density, of_column):
    """Seen: 0.67, 0.70, 2.86 % of density; 0.12, 0.17, 1.45 % of the column above."""
    z, density, column = truth
    some = slice(0, np.searchsorted(z, highest), 100)
    profile = standard_density_profile()
    at = jnp.asarray(z[some])
    assert np.abs(profile.density(at) / density[some] - 1).max() < of_density
    assert np.abs(profile.vertical_column(at) / column[some] - 1).max() < of_column


def _slant(density, z, cosine, breaks):
    """Column along a straight ray, by Gauss's rule between the altitudes of the breaks."""
    x, w = np.polynomial.legendre.leggauss(60)
    start, r0, total = (RADIUS + z) * cosine, RADIUS + z, 0.0
    rise = np.array([z, *sorted(b for b in breaks if b > z)]) - z
    more = rise * (2 * r0 + rise)
    ends = more / np.where(more > 0, start + np.sqrt(start**2 + more), 1.0)
    for a, b in itertools.pairwise(ends):
        s = a + (b - a) * (x + 1) / 2
        change = s * (2 * start + s)
        total += (b - a) / 2 * (w @ density(z + change / (r0 + np.sqrt(r0**2 + change))))
    return total


RAYS = [(z, c) for z in (0.0, 5.7e3, 8e3, 3e4, 4.5e4) for c in (0.0, 0.02, 0.1, 0.4, 1.0)]


@pytest.mark.parametrize(("z", "cosine"), RAYS)
def test_slant_columns(truth, z, cosine):
    profile = standard_density_profile()
    standard = (11019.0, 20063.0, 32162.0, 47350.0, 51413.0, 71802.0, 86e3)
    near = (z + 100.0, z + 1e3, z + 1e4, 1.2e5, 1.9e5)
    breaks = [*np.asarray(profile.base), *standard, *near]
    found = float(profile.rising_column(jnp.asarray(z), jnp.asarray(cosine), RADIUS))
    own = _slant(lambda a: np.asarray(profile.density(jnp.asarray(a))), z, cosine, breaks)
    assert found == pytest.approx(own, rel=1e-4)  # of the closed form; seen: 8.1e-5
    real = _slant(lambda a: np.interp(a, truth[0], truth[1]), z, cosine, breaks)
    assert found == pytest.approx(real, rel=2e-3)  # of the fit; seen: 1.8e-3
    single = jax.tree.map(lambda x: x.astype(np.float32), profile)
    low = single.rising_column(jnp.asarray(z, "float32"), jnp.asarray(cosine, "float32"), RADIUS)
    assert float(low) == pytest.approx(found, rel=2e-6)  # 16 roundings; seen: 6.3e-7


@pytest.mark.parametrize("bases", [[0.0], [0.0, 3e3, 2e4]])
def test_layers_of_one_scale_height_are_an_exponential(bases):
    layers, one = ExponentialLayers(bases, [7e3] * len(bases)), af.Exponential(7e3)
    z, cosine = jnp.array([0.0, 2e3, 3e3, 5e4]), jnp.array([0.0, 0.05, 0.5, 1.0])
    np.testing.assert_allclose(layers.density(z), one.density(z), rtol=1e-13)
    np.testing.assert_allclose(layers.vertical_column(z), one.vertical_column(z), rtol=1e-13)
    np.testing.assert_allclose(
        layers.rising_column(z, cosine, RADIUS), one.rising_column(z, cosine, RADIUS), rtol=1e-12
    )
    # The level column of `Exponential` is a series of its own.
    np.testing.assert_allclose(
        layers.level_column(z, RADIUS), one.level_column(z, RADIUS), rtol=1e-6
    )
    assert float(layers.top) == pytest.approx(14 * 7e3)
    assert float(layers.scale) == pytest.approx(7e3)


def test_slope_polynomial():
    x = np.concatenate([[0.0], np.geomspace(1e-3, 5.0, 300)])
    exact = np.sqrt(np.pi) * special.erfcx(x) * (1 - 2 * x**2) + 2 * x
    zero = jnp.asarray(0.0)
    np.testing.assert_allclose(exponential_layers._slope(jnp.asarray(x), zero), exact, rtol=2e-5)
    far = np.array([30.0, 1e3, 1e6])  # the asymptotic series, whose next term is 4.5 / x^5
    np.testing.assert_allclose(
        exponential_layers._slope(jnp.asarray(far), zero), 2 / far - 2 / far**3, rtol=2e-5
    )


def test_slopes_by_the_scale_heights():
    def column(scale_height):
        layers = ExponentialLayers([0.0, 6e3, 1.1e4], scale_height)
        return layers.rising_column(jnp.asarray(1e3), jnp.asarray(0.1), RADIUS)

    heights = jnp.array([9.7e3, 8.5e3, 6.3e3])
    slope = jax.grad(column)(heights)
    for k in range(3):
        step = jnp.zeros(3).at[k].set(1.0)
        change = (column(heights + step) - column(heights - step)) / 2
        assert float(slope[k]) == pytest.approx(float(change), rel=1e-6)


@pytest.mark.parametrize(
    ("base", "scale_height", "message"),
    [
        ([], [], "length that is not 0"),
        ([0.0, 1.0], [1e3], r"got shapes \(2,\) and \(1,\)"),
        ([1.0, 2.0], [1e3, 1e3], "base must begin with 0 m, got 1"),
        ([0.0, 2.0, 2.0], [1e3] * 3, "base must increase from layer to layer"),
        ([0.0, -2.0], [1e3] * 2, "base must be between 0 and 1e.06 m, got -2"),
        ([0.0], [0.5], "scale_height must be between 1 and 30000 m, got 0.5"),
    ],
)
def test_layers_that_are_refused(base, scale_height, message):
    with pytest.raises(ValueError, match=message):
        ExponentialLayers(base, scale_height).checked()


def test_traced_bases_that_do_not_increase_give_nan():
    def density(base):
        return ExponentialLayers(base, jnp.array([8e3, 7e3])).checked().density(jnp.asarray(10.0))

    assert np.isfinite(jax.jit(density)(jnp.array([0.0, 1e3])))
    for bad in ([0.0, 0.0], [1.0, 1e3]):
        assert np.isnan(jax.jit(density)(jnp.array(bad)))
