"""Fisheye pictures of the dome."""

import numpy as np
import pytest
from render.fake_refit import small_dome

from atmofit.geometry import DirectionGrid, dome_343
from atmofit.render.image import new_figure, png_bytes
from atmofit.render.panorama import draw_dome, interpolate_dome, sky_image


def plane(directions):
    """A function that is linear on the picture: degrees toward the sun, and as many up to it."""
    view, azimuth = (np.asarray(angle) for angle in directions.angles())
    return np.degrees(view) * np.cos(azimuth)


FULL = DirectionGrid(np.radians([0.0, 30.0, 60.0, 88.0]), np.radians(np.arange(0.0, 360.0, 15.0)))


@pytest.mark.parametrize("directions", [dome_343(), FULL], ids=["half", "full"])
@pytest.mark.parametrize("smooth", [True, False])
def test_interpolation_keeps_a_plane_and_the_sun_at_the_top(directions, smooth):
    picture = interpolate_dome(directions, plane(directions), pixels=40, smooth=smooth)
    centres = -90 + 4.5 * (np.arange(40) + 0.5)
    right, up = np.meshgrid(centres, -centres)
    inside = np.hypot(right, up) < 86
    np.testing.assert_allclose(picture[inside], up[inside], atol=1e-6)
    assert np.isnan(picture[0, 0])
    assert picture[0, 20] > 85


def test_azimuth_grows_clockwise():
    view, azimuth = (np.asarray(angle) for angle in FULL.angles())
    picture = interpolate_dome(FULL, view * np.sin(azimuth), pixels=40)
    assert picture[20, 35] > 1
    assert picture[20, 4] < -1


def test_half_dome_is_mirrored():
    directions = dome_343()
    view, azimuth = (np.asarray(angle) for angle in directions.angles())
    picture = interpolate_dome(directions, view * azimuth, pixels=40)
    np.testing.assert_allclose(picture, picture[:, ::-1], atol=1e-9)


def test_ring_at_89_degrees_reaches_the_horizon_but_a_partial_dome_does_not():
    pixels = 300
    middle = pixels // 2
    assert np.isfinite(interpolate_dome(dome_343(), np.ones(343), pixels=pixels)[0, middle])
    picture = interpolate_dome(small_dome(), np.ones(16), pixels=pixels)
    assert np.isnan(picture[0, middle])
    assert picture[middle, middle] == 1


def test_values_are_never_overshot():
    values = np.zeros(343)
    values[100] = 1.0
    picture = interpolate_dome(dome_343(), values)
    assert np.nanmin(picture) == 0
    assert np.nanmax(picture) <= 1


def test_nan_gives_an_empty_picture():
    assert np.isnan(interpolate_dome(dome_343(), np.full(343, np.nan))).all()


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"values must have shape \(343,\), got \(342,\)"):
        interpolate_dome(dome_343(), np.ones(342))
    with pytest.raises(ValueError, match="xyY must have shape"):
        sky_image(dome_343(), np.ones((343, 2)), white_luminance=1.0)
    with pytest.raises(ValueError, match="white_luminance must be positive, got 0"):
        sky_image(dome_343(), np.ones((343, 3)), white_luminance=0.0)
    line = DirectionGrid(np.radians([0.0]), np.radians([0.0, 90.0]))
    with pytest.raises(ValueError, match="at least three directions, got 1"):
        interpolate_dome(line, np.ones((1, 2)))


def test_white_and_blue_skies():
    white = np.tile([0.3127, 0.3290, 1e4], (343, 1))
    picture = sky_image(dome_343(), white, white_luminance=1e4, pixels=20)
    expected = 1.055 * (1 - np.exp(-1)) ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(picture[10, 10], [expected] * 3 + [1], atol=2e-3)
    np.testing.assert_array_equal(picture[0, 0], 0)
    red, _, blue, _ = sky_image(
        dome_343(), np.tile([0.25, 0.26, 1e4], (343, 1)), white_luminance=2e4, pixels=20
    )[10, 10]
    assert blue > red


def test_dome_with_labels_sun_and_limits():
    figure = new_figure(3.0, 3.0)
    directions = dome_343()
    image = draw_dome(
        figure.subplots(),
        directions,
        plane(directions),
        limits=(-90.0, 90.0),
        solar_zenith_angle=1.0,
    )
    figure.colorbar(image, label="[°]")
    assert image.get_clim() == (-90, 90)
    words = [text.get_text() for text in figure.axes[0].texts]
    assert words == ["30°", "60°", "0°", "90°", "180°", "270°"]
    assert png_bytes(figure).startswith(b"\x89PNG\r\n\x1a\n")
