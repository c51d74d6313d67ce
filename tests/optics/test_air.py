"""Optics of air: the source's own fit, another package, and the scattering of depolarised light."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import atmofit as af
from atmofit.optics.air import (
    air_depolarisation,
    air_refractivity,
    king_factor,
    rayleigh_cross_section,
    rayleigh_optical_depth,
)
from atmofit.optics.molecules import Molecules

WAVELENGTH = np.linspace(250.0, 850.0, 61)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def _published_fit(wavelength_nm):
    """Bodhaine et al. (1999), eq. 30: sea level, 45 degrees, 360 ppm of carbon dioxide."""
    x = (wavelength_nm * 1e-3) ** 2
    above = 1.0455996 - 341.29061 / x - 0.90230850 * x
    return 0.0021520 * above / (1 + 0.0027059889 / x - 85.968563 * x)


def test_optical_depth_agrees_with_the_published_fit():
    # The source states 0.01 % from 250 to 850 nm and 0.05 % to 1000 nm; seen: 9.4e-5 and 4.6e-4.
    found = rayleigh_optical_depth(WAVELENGTH)
    np.testing.assert_allclose(found, _published_fit(WAVELENGTH), rtol=1e-4)
    beyond = np.linspace(850.0, 1000.0, 16)
    np.testing.assert_allclose(rayleigh_optical_depth(beyond), _published_fit(beyond), rtol=5e-4)


@pytest.mark.parametrize(("wavelength", "depth"), [(400.0, 0.3602), (550.0, 0.09707)])
def test_optical_depth_at_sea_level(wavelength, depth):
    # The published fit's numbers, printed with four digits.
    assert float(rayleigh_optical_depth(wavelength)) == pytest.approx(depth, rel=2e-4)


@pytest.mark.reference
@pytest.mark.parametrize("ppm", [300.0, 360.0, 1000.0])
def test_agrees_with_colour_science(ppm):
    """Another implementation of the same source; it leaves carbon dioxide out of refraction."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from colour.phenomena import rayleigh
    same = {"CO2_concentration": ppm, "avogadro_constant": 6.0221367e23}
    refraction = 1 + 0.54e-6 * (ppm - 300)
    section = refraction**2 * 1e-4 * rayleigh.scattering_cross_section(WAVELENGTH * 1e-7, **same)
    # (n^2 - 1)^2 over (n - 1)^2 changes by 6e-4 of the 4e-4 that carbon dioxide adds; the number
    # density is the source's rounded one, 4e-7 from the package's, twice. Seen: 7.5e-7.
    np.testing.assert_allclose(rayleigh_cross_section(WAVELENGTH, ppm), section, rtol=2e-6)
    depth = refraction**2 * rayleigh.rayleigh_optical_depth(
        WAVELENGTH * 1e-7, latitude=45.0, altitude=5517.56, **same
    )
    np.testing.assert_allclose(rayleigh_optical_depth(WAVELENGTH, 101325.0, ppm), depth, rtol=2e-6)
    king = rayleigh.F_air_Bodhaine1999(WAVELENGTH * 1e-3, ppm)
    np.testing.assert_allclose(king_factor(WAVELENGTH, ppm), king, rtol=1e-14)


def test_refractive_index_of_visible_light():
    """Ciddor (1996), another fit to other data, from 230 to 1690 nm at 450 ppm."""
    inverse = 1 / (WAVELENGTH * 1e-3) ** 2
    ciddor = 1e-8 * (5792105 / (238.0185 - inverse) + 167917 / (57.362 - inverse))
    # Both measured to about 1e-8 of the 2.8e-4 that n - 1 is; seen: 3.9e-5, at 320 nm.
    np.testing.assert_allclose(air_refractivity(WAVELENGTH, 450.0), ciddor, rtol=5e-5)


def test_depolarisation_gives_back_the_king_factor():
    wavelength = np.geomspace(200.0, 3000.0, 30)
    rho = np.asarray(air_depolarisation(wavelength))
    np.testing.assert_allclose((6 + 3 * rho) / (6 - 7 * rho), king_factor(wavelength), rtol=1e-14)
    assert (np.diff(rho) < 0).all()


def test_proportional_to_pressure():
    half = rayleigh_optical_depth(WAVELENGTH, 101325.0 / 2)
    np.testing.assert_allclose(2 * half, rayleigh_optical_depth(WAVELENGTH), rtol=1e-14)


@pytest.mark.parametrize(
    "function", [air_refractivity, king_factor, air_depolarisation, rayleigh_optical_depth]
)
def test_float32_keeps_its_digits(function):
    wavelength = np.geomspace(200.0, 3000.0, 50).astype(np.float32)
    exact = function(wavelength.astype(float))
    found = function(wavelength)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, exact, rtol=2e-6)  # 16 roundings; seen: 8.8e-7
    slope = jax.vmap(jax.grad(function))
    np.testing.assert_allclose(
        slope(wavelength), slope(wavelength.astype(float)), rtol=4e-6
    )  # seen: 1.0e-6


def test_derivative_by_wavelength():
    step = 0.01
    up, down = rayleigh_optical_depth(WAVELENGTH + step), rayleigh_optical_depth(WAVELENGTH - step)
    slope = jax.vmap(jax.grad(rayleigh_optical_depth))(jnp.asarray(WAVELENGTH))
    # The central difference's own error: 20 / 6 (step / wavelength)^2 = 5e-9.
    np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-7)


@pytest.mark.parametrize("bad", [199.0, 3001.0, np.nan])
def test_wavelengths_outside_are_refused(bad):
    message = "wavelength_nm must be between 200 and 3000 nm, got"
    for function in (air_refractivity, king_factor, air_depolarisation, rayleigh_optical_depth):
        with pytest.raises(ValueError, match=message):
            function(bad)
        assert np.isnan(jax.jit(function)(bad))


@pytest.mark.parametrize("rho", [0.0, 0.03, 0.5, 6 / 7])
def test_phase_function_with_depolarisation(rho):
    """Integrals against Legendre polynomials, exact by Gauss's rule."""
    phase = af.Rayleigh(rho)
    p = np.asarray(phase(np.arccos(NODES)))
    degree = np.arange(8)[:, None]
    integrals = 2 * np.pi * (special.eval_legendre(degree, NODES) * p) @ WEIGHTS
    np.testing.assert_allclose(phase.moments(8, jnp.array([550.0]))[:, 0], integrals, atol=1e-13)
    assert integrals[0] == pytest.approx(1, rel=1e-13)
    # What is scattered aside is polarised but for a part that is rho of the other: for one
    # polarisation p ~ 1, for the other p ~ rho + (1 - rho) cos^2.
    aside, ahead = np.asarray(phase(np.array([np.pi / 2, 0.0])))
    assert aside / ahead == pytest.approx((1 + rho) / 2, rel=1e-13)


def test_phase_function_without_depolarisation_is_unchanged():
    angle = np.linspace(0.0, np.pi, 9)
    exact = 3 / (16 * np.pi) * (1 + np.cos(angle) ** 2)
    np.testing.assert_allclose(af.Rayleigh()(angle), exact, rtol=1e-15)
    np.testing.assert_allclose(af.Rayleigh(0.0)(angle), exact, rtol=1e-15)
    np.testing.assert_array_equal(
        af.Rayleigh().moments(5, jnp.array([550.0]))[:, 0], [1, 0, 0.1, 0, 0]
    )
    assert af.Rayleigh().moments(2, jnp.array([550.0])).shape == (2, 1)


def test_depolarisation_outside_is_refused():
    for bad in (-0.1, 0.9):
        with pytest.raises(ValueError, match=r"depolarisation must be between 0 and 0.857143, got"):
            af.Rayleigh(bad).checked()
        with pytest.raises(ValueError, match=r"depolarisation must be between"):
            af.Molecules(depolarisation=bad).checked()


def test_standard_molecules():
    air = Molecules.standard(9e4).checked()
    wavelength = np.array([200.0, 333.3, 550.0, 3000.0])
    expected = rayleigh_optical_depth(wavelength, 9e4)
    np.testing.assert_allclose(air.optical_depth_at(jnp.asarray(wavelength)), expected, rtol=1e-14)
    fine = jnp.asarray(np.geomspace(200.0, 3000.0, 1000))
    second = air.phase().moments(3, fine)[2]
    rho = air_depolarisation(fine)
    # Linear between nodes 4.7 % apart: 0.047^2 / 8 (20 a + 6 b) with the parts a = 0.0113 and
    # b = 0.008 of rho at 200 nm that go as wavelength^-4 and ^-2; 1.5 times that. Seen: 9.0e-5.
    np.testing.assert_allclose(second, (1 - rho) / (5 * (2 + rho)), rtol=1.2e-4)
    assert air.is_smooth


def test_depolarisation_may_be_a_rough_spectrum():
    assert not af.Molecules(depolarisation=af.Spectrum([400.0, 800.0], [0.0, 0.1])).is_smooth


def test_an_optical_depth_beside_a_pressure_is_refused():
    with pytest.raises(ValueError, match="optical_depth must be None where surface_pressure"):
        Molecules(0.1, surface_pressure=1e5)
    with pytest.raises(ValueError, match="surface_pressure must be between 0 and 200000 Pa, got"):
        Molecules.standard(-1.0)


def test_the_default_molecules_are_those_of_the_paper():
    air = Molecules()
    assert air.surface_pressure is None
    assert air.depolarisation is None
    assert isinstance(air.density_profile(), af.Exponential)
