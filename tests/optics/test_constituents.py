"""Molecules, haze, absorbers, ground and the atmosphere that they make."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.optics.medium import optical_properties
from atmofit.optics.molecules import molecular_scattering_coefficient
from atmofit.tables import preetham1999_spectra

AT_550 = jnp.array([550.0])


@pytest.mark.parametrize(("n", "expected"), [(1.0003, 1.356e-5), (1.000278, 1.165e-5)])
def test_molecular_coefficient(n, expected):
    """Erratum 26."""
    found = molecular_scattering_coefficient(AT_550, jnp.asarray(n))
    assert found[0] == pytest.approx(expected, rel=5e-4)


def test_molecules_fall_as_the_fourth_power_of_the_wavelength():
    depth = af.Molecules().optical_depth_at(jnp.array([400.0, 800.0]))
    assert depth[0] / depth[1] == pytest.approx(16)
    assert depth[0] * (400 / 550) ** 4 == pytest.approx(1.165e-5 / 0.1136e-3, rel=1e-3)
    assert af.Molecules(0.1, 8.8e3).optical_depth_at(AT_550) == pytest.approx(0.1)


def test_haze_of_a_turbidity():
    """Erratum 1: 7.94e-5 per metre at the ground for T = 2, at 550 nm."""
    haze = af.Haze.from_turbidity(2.0)
    assert haze.scale_height == pytest.approx(1 / 0.8333e-3)
    depth = float(haze.optical_depth_at(AT_550)[0])
    assert depth == pytest.approx(7.94e-5 * 1200, rel=2e-3)
    clean = float(af.Haze.from_turbidity(1.0).optical_depth_at(AT_550)[0])
    assert 0 < clean < 0.02 * depth
    # Linear in turbidity, and in ratio to what the definition of turbidity asks for.
    depths = [
        float(af.Haze.from_turbidity(t).optical_depth_at(AT_550)[0]) for t in (3.0, 4.0, 64.0)
    ]
    assert depths[1] - depths[0] == pytest.approx(depths[0] - depth, rel=1e-9)
    assert depths[2] / (63 * 0.1001) == pytest.approx(0.95, abs=0.01)


def test_spectrum_of_the_papers_haze():
    """Junge exponent 4: wavelength^-2 times K."""
    wavelength = jnp.array([380.0, 550.0, 780.0])
    depth = np.asarray(af.Haze.from_turbidity(3.0).optical_depth_at(wavelength))
    table = preetham1999_spectra()
    shape = np.interp(wavelength, table.wavelength_nm, table.K) / np.asarray(wavelength) ** 2
    np.testing.assert_allclose(depth / depth[1], shape / shape[1], rtol=1e-12)


def test_power_law_and_given_spectrum():
    wavelength = jnp.array([275.0, 550.0, 1100.0])
    haze = af.Haze(0.2, 1.5, 1e3)
    np.testing.assert_allclose(
        haze.optical_depth_at(wavelength), 0.2 * 2 ** np.array([1.5, 0, -1.5])
    )
    given = af.Haze(af.Spectrum([200.0, 1200.0], [1.0, 0.0]), 1.5)
    np.testing.assert_allclose(given.optical_depth_at(wavelength), 1 - (wavelength - 200) / 1000)


@pytest.mark.parametrize("turbidity", [0.99, 0.0, -3.0, 65.0, np.nan, np.inf])
def test_turbidity_outside_its_range(turbidity):
    with pytest.raises(ValueError, match="turbidity must be between 1 and 64, got"):
        af.Atmosphere.from_turbidity(turbidity)


def test_a_traced_turbidity_below_1_gives_nan():
    depth = jax.jit(lambda t: af.Haze.from_turbidity(t).optical_depth)(0.5)
    assert np.isnan(depth)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (lambda: af.Molecules(-0.1), "optical_depth must be between 0 and 1000, got -0.1"),
        (lambda: af.Molecules(np.nan), "optical_depth must be .* got nan"),
        (
            lambda: af.Molecules(scale_height=0.0),
            "scale_height must be between 1 and 30000 m, got 0",
        ),
        (lambda: af.Molecules(refractive_index=0.9), "refractive_index must be .* got 0.9"),
        (lambda: af.Haze(1e4), "optical_depth must be .* got 10000"),
        (lambda: af.Haze(0.1, scale_height=-1.0), "scale_height must be .* got -1"),
        (lambda: af.Haze(0.1, angstrom_exponent=9.0), "angstrom_exponent must be .* got 9"),
        (
            lambda: af.Haze(0.1, single_scattering_albedo=1.1),
            "single_scattering_albedo must be between 0 and 1, got 1.1",
        ),
        (lambda: af.Haze(0.1, phase=af.HenyeyGreenstein(2.0)), "asymmetry must be .* got 2"),
        (
            lambda: af.Haze(af.Spectrum([400.0, 500.0], [0.1, -0.1])),
            r"optical_depth must be .* got -0.1 \(1 of 2 values\)",
        ),
        (lambda: af.Ground(1.5), "albedo must be between 0 and 1, got 1.5"),
        (lambda: af.Absorber(-1.0, af.GaussianLayer(22e3, 5e3)), "optical_depth must be .* got -1"),
    ],
)
def test_impossible_values_are_refused(part, message):
    with pytest.raises(ValueError, match=message):
        part().checked()


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        (
            {"geometry": "cube"},
            'geometry must be one of "spherical", "pseudo-spherical", "flat", "paper", got',
        ),
        ({"preset": "moon"}, 'preset must be one of "preetham1999", "standard", got'),
        ({"radius": 1.0}, "radius must be between 100000 and 1e.09 m, got 1"),
    ],
)
def test_impossible_structure_is_refused(keywords, message):
    with pytest.raises(Exception, match=message) as caught:
        af.Atmosphere(af.Molecules(), **keywords)
    assert isinstance(caught.value, ValueError)


def test_optical_properties_of_everything():
    atmosphere = af.Atmosphere(
        af.Molecules(0.1),
        af.Haze(0.2, 0.0, single_scattering_albedo=0.5),
        (af.Absorber(0.3, af.GaussianLayer(22e3, 5e3)),),
        af.Ground(0.4),
    )
    medium = optical_properties(atmosphere, jnp.array([500.0, 600.0]))
    np.testing.assert_allclose(medium.extinction, [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]])
    np.testing.assert_allclose(medium.scattering, [[0.1, 0.1], [0.1, 0.1]])
    assert medium.ground_albedo is not None
    np.testing.assert_allclose(medium.ground_albedo, [0.4, 0.4])
    assert medium.moments(4).shape == (2, 4, 2)
    np.testing.assert_allclose(medium.moments(4)[:, 0], medium.scattering)
    assert medium.top == pytest.approx(14 * float(af.Molecules().scale_height))


@pytest.mark.parametrize(
    ("atmosphere", "smooth"),
    [
        (af.Atmosphere.from_turbidity(2.0), True),
        (af.Atmosphere(af.Molecules(), ground=af.Ground(0.2)), True),
        (af.Atmosphere(af.Molecules(af.Spectrum([1.0, 2.0], [1.0, 1.0]))), False),
        (af.Atmosphere(af.Molecules(af.Spectrum([1.0, 2.0], [1.0, 1.0], smooth=True))), True),
        (af.Atmosphere(af.Molecules(), ground=af.Ground(af.Spectrum([1.0], [1.0]))), False),
        (af.Atmosphere(af.Molecules(), absorbers=(af.Absorber(0.1, af.Exponential(1e3)),)), False),
        (
            af.Atmosphere(haze=af.Haze(0.1, phase=af.HenyeyGreenstein(af.Spectrum([1.0], [0.1])))),
            False,
        ),
    ],
)
def test_which_atmospheres_are_smooth_in_wavelength(atmosphere, smooth):
    assert atmosphere.is_smooth == smooth
