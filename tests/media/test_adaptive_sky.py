"""Klassen's way to save integrals: right where it integrates, unseen where it reuses."""

import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.media.adaptive_sky import adaptive_sky
from atmofit.media.two_layers import blue_behind, coloured, sky_integral, two_layers
from atmofit.render.film import on_film

LAYERS = two_layers(wavelength_nm=np.arange(400.0, 701.0, 50.0))
NOON, SUNSET = np.radians([20.0, 89.0])


def camera(width, height):
    """Angles of the pixels of a level camera, a right angle wide, the horizon at its lower edge."""
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, (height - np.arange(height) - 0.5))
    y = y / height
    return np.arccos(y / np.sqrt(1 + x**2 + y**2)).ravel(), np.arctan2(x, 1).ravel()


def exact(sun, zenith, azimuth):
    at = (jnp.asarray(sun), jnp.asarray(zenith), jnp.asarray(azimuth))
    return np.asarray(sky_integral(LAYERS, *at, True, 96)).T


def shown(sun, zenith, azimuth, integral):
    """Values of sRGB times 255."""
    at = (jnp.asarray(sun), jnp.asarray(zenith), jnp.asarray(azimuth))
    seen = coloured(LAYERS, *at, jnp.asarray(integral.T), blue_behind(LAYERS, None))
    xyY = np.asarray(af.spectrum_to_xyY(seen, LAYERS.wavelength_nm))
    return 255 * on_film(xyY, float(np.percentile(xyY[:, 2], 80)))


# With the sun level the haze's upper end is a square root, of which 96 nodes leave 9e-5.
@pytest.mark.parametrize(("sun", "rtol"), [(NOON, 1e-6), (SUNSET, 1e-6), (np.pi / 2, 2e-4)])
def test_every_line_integrated_is_right(sun, rtol):
    zenith = np.pi / 2 - np.radians([0.0, 0.5, 5.0, 30.0, 90.0])
    azimuth = np.array([0.0, 3.0, 1.0, 2.0, 0.0])
    found = adaptive_sky(LAYERS, sun, zenith, azimuth, bits=None, rtol=1e-7)
    # Tolerances of intervals add up to that of the whole, and the Richardson term is beyond it.
    np.testing.assert_allclose(found.integral, exact(sun, zenith, azimuth), rtol=rtol)
    assert found.integrals == 5
    assert found.evaluations >= 5 * 5


@pytest.mark.parametrize("sun", [NOON, SUNSET])
def test_reuse_is_not_seen_on_eight_bits(sun):
    zenith, azimuth = camera(48, 24)
    found = adaptive_sky(LAYERS, sun, zenith, azimuth)
    truth = exact(sun, zenith, azimuth)
    off = shown(sun, zenith, azimuth, found.integral) - shown(sun, zenith, azimuth, truth)
    assert np.abs(off).max() <= 1.0
    assert found.integrals < zenith.size


@pytest.mark.parametrize("sun", [NOON, SUNSET])
def test_integrals_grow_more_slowly_than_pixels(sun):
    few, many = (
        adaptive_sky(LAYERS, sun, *camera(width, width // 2), bits=5.0).integrals
        for width in (16, 64)
    )
    assert 0.3 < np.log(many / few) / np.log(16) < 0.8


def test_a_row_of_one_angle_needs_one_integral():
    found = adaptive_sky(LAYERS, 1.0, np.full(100, 1.2), np.full(100, 0.3))
    assert found.integrals == 1
    assert (found.integral == found.integral[0]).all()


def test_more_bits_take_more_integrals():
    angles = camera(64, 32)
    few, more = (adaptive_sky(LAYERS, NOON, *angles, bits=bits).integrals for bits in (4.0, 8.0))
    assert few < more < 64 * 32


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bits": 1.0}, "bits must be between 2 and 16, got 1"),
        ({"rtol": 0.0}, "rtol must be between 1e-12 and 0.1, got 0"),
        ({"solar_zenith_angle": 2.0}, "solar_zenith_angle must be between"),
        ({"view_zenith_angle": np.array([2.0])}, "view_zenith_angle must be between"),
    ],
)
def test_bad_requests_are_refused(changed, message):
    good = {
        "solar_zenith_angle": 1.0,
        "view_zenith_angle": np.ones(1),
        "relative_azimuth": np.ones(1),
    }
    with pytest.raises(ValueError, match=message):
        adaptive_sky(LAYERS, **(good | changed))
