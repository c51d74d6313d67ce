"""Spectra from colours, and the older skies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from colour.colorimetry import sd_CIE_illuminant_D_series

import atmofit as af

TABLE_NM = np.arange(380.0, 781.0, 10.0)


def test_daylight_comes_back():
    x = np.linspace(0.25, 0.38, 14)
    y = -3.0 * x**2 + 2.87 * x - 0.275  # the daylight locus
    xyY = np.stack([x, y, np.full(14, 5e3)], axis=-1)
    found = af.daylight_spectrum(xyY)
    assert not np.asarray(found.negative).any()
    back = np.asarray(af.spectrum_to_xyY(found.radiance, TABLE_NM))
    # The components' published factors are rounded: 1.3e-4 in x and y.
    np.testing.assert_allclose(back[:, :2], xyY[:, :2], atol=1.3e-4)
    np.testing.assert_allclose(back[:, 2], 5e3, rtol=1e-6)


def test_spectrum_is_the_standard_illuminant_s():
    xy = np.array([0.31272, 0.32903])
    found = np.asarray(af.daylight_spectrum([*xy, 1.0]).radiance)
    other = sd_CIE_illuminant_D_series(xy, M1_M2_rounding=False)[TABLE_NM]
    np.testing.assert_allclose(found / found[18], other / other[18], rtol=2e-3)


def test_negative_spectra_are_cut_and_counted():
    red = af.daylight_spectrum([0.55, 0.41, 100.0])
    assert bool(red.negative)
    assert np.asarray(red.radiance).min() == 0.0
    assert af.spectrum_to_XYZ(red.radiance, TABLE_NM)[1] == pytest.approx(100.0)
    grid = af.DirectionGrid(np.radians(np.arange(0, 91, 2)), np.radians(np.arange(0, 181, 5)))
    share = {}
    for sun in (80, 85, 90):
        xyY = np.maximum(af.PREETHAM_1999(2.0, np.radians(sun), grid), 0.0)
        share[sun] = float(np.mean(af.daylight_spectrum(xyY).negative))
    # 2, 8 and 18 to 24 % of directions elsewhere, with another spacing.
    assert 0.005 < share[80] < share[85] < share[90] < 0.25


def test_bad_colours_are_refused():
    with pytest.raises(ValueError, match="xyY must have x, y and Y on its last axis, got shape"):
        af.daylight_spectrum([0.3, 0.3])
    with pytest.raises(ValueError, match="xyY must be at least 0, got -1"):
        af.daylight_spectrum([0.3, 0.3, -1.0])


def test_old_skies():
    assert af.cie_overcast_sky(np.pi / 2) == pytest.approx(1 / 3)
    zenith = af.cie_clear_sky(0.0, 0.7, 0.7)
    assert zenith == pytest.approx(1.0)
    # Brightest at the sun, darkest opposite it.
    view = np.radians(np.linspace(0, 85, 40))
    toward = af.cie_clear_sky(view, np.abs(view - 0.7), 0.7)
    away = af.cie_clear_sky(view, view + 0.7, 0.7)
    assert view[np.argmax(toward)] == pytest.approx(0.7, abs=0.05)
    assert np.argmin(np.concatenate([away[::-1], toward])) < 40


def test_high_turbidity_turns_overcast():
    grid = af.DirectionGrid(np.radians([0.0, 45.0, 85.0]), np.radians([0.0, 90.0, 180.0]))
    clear, mixed, overcast, beyond = (
        np.asarray(af.hazy_sky_xyY(T, 0.8, grid)) for T in (5.0, 8.0, 10.0, 40.0)
    )
    np.testing.assert_allclose(clear, af.PREETHAM_1999(5.0, 0.8, grid), rtol=1e-6)
    np.testing.assert_allclose(overcast[..., :2], 1 / 3, rtol=1e-6)
    at_horizon = (1 + 2 * np.cos(np.radians(85.0))) / 3
    np.testing.assert_allclose(overcast[2, :, 2] / overcast[0, :, 2], at_horizon, rtol=1e-5)
    np.testing.assert_allclose(beyond, overcast)
    half = np.asarray(af.PREETHAM_1999(8.0, 0.8, grid))
    assert ((mixed[..., 0] > half[..., 0]) == (half[..., 0] < 1 / 3)).all()
    slope = jax.jacfwd(lambda T: af.hazy_sky_xyY(T, 0.8, grid))(jnp.asarray(8.0))
    assert np.isfinite(slope).all()
    with pytest.raises(ValueError, match="clear_until and overcast_from must increase inside"):
        af.hazy_sky_xyY(5.0, 0.8, grid, clear_until=8.0, overcast_from=7.0)
