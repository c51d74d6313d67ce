"""Colour: agreement with colour-science, and the edges."""

import colour_reference
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from atmofit import colour, tables

WAVELENGTH = np.arange(380.0, 781.0, 10.0)


def blackbody(wavelength_nm, temperature):
    """Spectral radiance [W m^-2 sr^-1 nm^-1]."""
    m = wavelength_nm * 1e-9
    return 1e-9 * 1.19104e-16 / m**5 / np.expm1(0.01438777 / (m * temperature))


def exact(spectrum, low=380.0, high=780.0):
    """XYZ of a function of wavelength: a fine sum over the table's straight lines."""
    curves = tables.cie1931_2deg()
    fine = np.linspace(low, high, 20001)
    xyz = np.stack([np.interp(fine, curves.wavelength_nm, c) for c in curves.xyz.T], axis=-1)
    return 683 * np.trapezoid(spectrum(fine)[:, None] * xyz, fine, axis=0)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("count", [2, 9, 41, 401])
def test_straight_spectra_are_exact_on_any_grid(count, dtype):
    wavelength = np.linspace(380, 780, count)
    XYZ = colour.spectrum_to_XYZ(jnp.asarray(wavelength / 500 - 0.5, dtype), wavelength)
    assert XYZ.dtype == dtype
    np.testing.assert_allclose(XYZ, exact(lambda w: w / 500 - 0.5), rtol=1e-5)


def test_uneven_grid_is_exact_for_straight_spectra():
    rng = np.random.default_rng(1)
    inner = np.sort(rng.uniform(380, 780, 30))
    wavelength = np.concatenate([[380.0], inner, [780.0]])
    XYZ = colour.spectrum_to_XYZ(2 - wavelength / 500, wavelength)
    np.testing.assert_allclose(XYZ, exact(lambda w: 2 - w / 500), rtol=3e-5)


def test_radiance_outside_the_grid_is_absent():
    part = np.linspace(500.0, 600.0, 11)
    XYZ = colour.spectrum_to_XYZ(np.ones(11), part)
    np.testing.assert_allclose(XYZ, exact(np.ones_like, 500.0, 600.0), rtol=1e-5)


@colour_reference.needed
@pytest.mark.parametrize("temperature", [2500.0, 5800.0, 12000.0])
def test_agrees_with_colour_science(temperature):
    reference = colour_reference.colour_science()
    fine = np.arange(380.0, 781.0)
    spectrum = reference.SpectralDistribution(blackbody(fine, temperature), fine)
    curves = reference.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy()
    curves.trim(spectrum.shape)
    expected = reference.colorimetry.sd_to_XYZ_integration(spectrum, curves, k=683.0)
    at_1nm = colour.spectrum_to_XYZ(blackbody(fine, temperature), fine)
    # It sums samples; here the product of straight lines is integrated.
    np.testing.assert_allclose(at_1nm, expected, rtol=5e-5)
    at_10nm = colour.spectrum_to_XYZ(blackbody(WAVELENGTH, temperature), WAVELENGTH)
    np.testing.assert_allclose(at_10nm, expected, rtol=2e-3)
    xy = colour.XYZ_to_xyY(at_10nm)[:2]
    np.testing.assert_allclose(xy, reference.XYZ_to_xy(expected), atol=2e-4)


@colour_reference.needed
def test_conversions_agree_with_colour_science():
    reference = colour_reference.colour_science()
    XYZ = np.random.default_rng(2).uniform(0.05, 1.0, (50, 3))
    np.testing.assert_allclose(colour.XYZ_to_xyY(XYZ), reference.XYZ_to_xyY(XYZ), rtol=1e-12)
    linear = colour.XYZ_to_linear_sRGB(XYZ)
    expected = reference.XYZ_to_RGB(XYZ, "sRGB")
    np.testing.assert_allclose(linear, expected, rtol=1e-9, atol=1e-9)
    encoded = colour.linear_sRGB_to_sRGB(np.clip(linear, 0, 1))
    expected = reference.models.eotf_inverse_sRGB(np.clip(np.asarray(linear), 0, 1))
    np.testing.assert_allclose(encoded, expected, rtol=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.tuples(*[st.floats(1e-3, 1.0)] * 3))
def test_xyY_round_trip(XYZ):
    back = colour.xyY_to_XYZ(colour.XYZ_to_xyY(np.asarray(XYZ)))
    np.testing.assert_allclose(back, XYZ, rtol=1e-10)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("level", [0.0, 1e-30, 1e3])
def test_black_and_dim_spectra_have_finite_values_and_slopes(level, dtype):
    radiance = jnp.full((2, 41), level, dtype)
    value, slope = jax.value_and_grad(lambda r: colour.spectrum_to_xyY(r, WAVELENGTH).sum())(
        radiance
    )
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
    if level == 0:
        np.testing.assert_allclose(
            colour.spectrum_to_xyY(radiance, WAVELENGTH), [[1 / 3, 1 / 3, 0]] * 2, rtol=1e-6
        )


def test_nan_is_not_black():
    assert np.isnan(colour.XYZ_to_xyY(np.array([np.nan, 0.0, 0.0]))[:2]).all()


def test_derivatives():
    radiance = jnp.asarray(blackbody(WAVELENGTH, 6000.0))
    grid = jnp.asarray(WAVELENGTH[1:-1] + 0.3)
    check_grads(lambda r: colour.spectrum_to_xyY(r, WAVELENGTH), (radiance,), 1, rtol=1e-5)
    # Quadrature points cross the corners of the 1 nm table, so slopes there are means.
    check_grads(lambda w: colour.spectrum_to_xyY(radiance[1:-1], w), (grid,), 1, rtol=3e-2)


def test_changing_wavelengths_compiles_nothing():
    traces = []

    @jax.jit
    def counted(radiance, wavelength):
        traces.append(None)
        return colour.spectrum_to_XYZ(radiance, wavelength)

    for first in (400.0, 410.0):
        XYZ = counted(np.ones(7), np.linspace(first, 700.0, 7))
        np.testing.assert_allclose(XYZ, exact(np.ones_like, first, 700.0), rtol=1e-5)
    assert len(traces) == 1


def test_traced_wavelengths_outside_are_nan():
    XYZ = jax.jit(colour.spectrum_to_XYZ)(np.ones(3), np.array([370.0, 500.0, 600.0]))
    assert np.isnan(XYZ).any()


@pytest.mark.parametrize("value", [-0.5, 0.0, 0.0031308, 0.5, 1.0, 4.0])
def test_encoding_is_odd_and_has_a_slope(value):
    encoded, slope = jax.value_and_grad(colour.linear_sRGB_to_sRGB)(value)
    assert np.isfinite(slope)
    np.testing.assert_allclose(colour.linear_sRGB_to_sRGB(-value), -encoded)


@pytest.mark.parametrize(
    ("radiance", "wavelength", "message"),
    [
        (np.ones(3), np.array([370.0, 500.0, 600.0]), "between 380 and 780 nm, got 370"),
        (np.ones(3), np.array([500.0, 400.0, 600.0]), "must increase, got 400 after 500"),
        (np.ones(2), np.array([400.0, 500.0, 600.0]), r"shapes \(3,\) and \(2,\)"),
        (np.ones(1), np.array([400.0]), "at least two"),
        (np.ones(3), np.array([400.0, np.nan, 600.0]), "got nan"),
    ],
)
def test_bad_input(radiance, wavelength, message):
    with pytest.raises(ValueError, match=message):
        colour.spectrum_to_XYZ(radiance, wavelength)


def test_colours_need_three_numbers():
    for function in (colour.XYZ_to_xyY, colour.xyY_to_XYZ, colour.XYZ_to_linear_sRGB):
        with pytest.raises(ValueError, match=r"must have shape \[\.\.\., 3\], got \(2,\)"):
            function(np.ones(2))
