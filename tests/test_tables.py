"""The tables of the papers."""

import dataclasses

import colour_reference
import numpy as np
import pytest

from atmofit import tables


def test_phase_table_is_the_papers():
    phase = tables.preetham1999_phase()
    assert phase.eta.shape == (phase.scattering_angle.size, phase.wavelength_nm.size) == (13, 5)
    np.testing.assert_allclose(phase.scattering_angle[[0, -1]], np.radians([1, 180]))
    np.testing.assert_array_equal(phase.wavelength_nm, [400, 450, 550, 650, 850])
    assert phase.eta[0, 0] == 4.192
    assert phase.eta[-1, -1] == 0.1566


def test_angular_integral_of_the_phase_table_is_the_total():
    """Integral of eta sin over the angle is K: the two tables describe one haze."""
    phase, spectra = tables.preetham1999_phase(), tables.preetham1999_spectra()
    angle = np.linspace(0, np.pi, 4001)
    for k, wavelength in enumerate((400, 450, 550, 650)):
        eta = np.exp(np.interp(angle, phase.scattering_angle, np.log(phase.eta[:, k])))
        total = np.trapezoid(eta * np.sin(angle), angle)
        expected = spectra.K[spectra.wavelength_nm == wavelength]
        # Straight lines between the logarithms overshoot where they curve.
        np.testing.assert_allclose(total, expected, rtol=0.02)


def test_spectra():
    spectra = tables.preetham1999_spectra()
    np.testing.assert_array_equal(spectra.wavelength_nm, np.arange(380, 781, 10))
    for field in dataclasses.fields(spectra):
        values = getattr(spectra, field.name)
        assert values.shape == (41,)
        assert np.isfinite(values).all()
    at = {int(wavelength): k for k, wavelength in enumerate(spectra.wavelength_nm)}
    assert spectra.k_ozone[at[600]] == 12.5
    assert spectra.k_water[at[720]] == 100.0
    assert spectra.k_gas[at[760]] == 3.0
    assert spectra.k_ozone[at[380]] == spectra.k_gas[at[550]] == 0


def test_sun():
    spectra = tables.preetham1999_spectra()
    # The solid angle turns the table into the irradiances it was made from.
    np.testing.assert_allclose(spectra.sun_irradiance[:3], [1.120, 1.098, 1.429], rtol=3e-6)
    known = ~spectra.sun_is_extrapolated
    assert 10 * spectra.sun_irradiance[known].sum() == pytest.approx(616.6, abs=0.05)
    np.testing.assert_array_equal(
        spectra.wavelength_nm[spectra.sun_is_extrapolated], [760, 770, 780]
    )
    ratios = spectra.sun_radiance[1:] / spectra.sun_radiance[:-1]
    mean = (spectra.sun_radiance[-4] / spectra.sun_radiance[-9]) ** 0.2  # 700 to 750 nm
    np.testing.assert_allclose(ratios[-3:], mean, rtol=1e-12)


@colour_reference.needed
def test_daylight_components_agree_with_colour_science():
    colour = colour_reference.colour_science()
    spectra = tables.preetham1999_spectra()
    basis = colour.colorimetry.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    for name in ("S0", "S1", "S2"):
        expected = [basis[name][wavelength] for wavelength in spectra.wavelength_nm]
        np.testing.assert_allclose(getattr(spectra, name), expected, atol=1e-12)


def test_coefficients_have_the_papers_layout():
    published = tables.preetham1999_coefficients()
    np.testing.assert_array_equal(published.distribution["Y"][0], [0.1787, -1.4630])
    np.testing.assert_array_equal(published.distribution["x"][3], [-0.0641, -0.8989])
    np.testing.assert_array_equal(
        published.zenith_chromaticity["y"][1], [-0.0421, 0.0897, -0.0415, 0.0052]
    )
    np.testing.assert_array_equal(published.zenith_luminance, [4.0453, -4.9710, -0.2155, 2.4192])


def test_constants_say_why_they_differ():
    constants = tables.preetham1999_constants()
    changed = {name for name, c in constants.items() if c.printed != c.used}
    assert changed == {
        "refractive_index",
        "temperature",
        "haze_concentration_slope",
        "haze_concentration_intercept",
        "sun_solid_angle",
    }
    for name in changed:
        assert len(constants[name].reason) > 20
    assert tables.constant("haze_concentration_slope") == 0.6544e-18
    boltzmann = 1.380649e-23
    density = tables.constant("pressure") / (boltzmann * tables.constant("temperature"))
    assert density == pytest.approx(tables.constant("number_density"), rel=1e-3)


def test_haze_concentration_fits_the_definition_of_turbidity():
    """With the corrected exponent, haze at T = 2 is as thick as the molecules (row 1)."""
    c = 2 * tables.constant("haze_concentration_slope") + tables.constant(
        "haze_concentration_intercept"
    )
    K = tables.preetham1999_spectra().K[17]
    coefficient = tables.constant("haze_prefactor") * c * np.pi * (2 * np.pi / 550e-9) ** 2 * K
    molecules = tables.constant("rayleigh_optical_depth_factor") * 0.55**-4.08
    assert coefficient / tables.constant("haze_decay") == pytest.approx(molecules, rel=0.06)


@colour_reference.needed
def test_colour_matching_functions_agree_with_colour_science():
    curves = tables.cie1931_2deg()
    reference = colour_reference.colour_matching_functions(curves.wavelength_nm)
    np.testing.assert_allclose(curves.xyz, reference, rtol=1e-11)


def test_tables_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        tables.preetham1999_phase().eta[0, 0] = 1.0
