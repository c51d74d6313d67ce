"""Photographs: a rendered one whose sun, trees, clouds and turbidity are known, and bad ones."""

import dataclasses

import numpy as np
import pytest

import atmofit as af
from atmofit.observe.images import Photograph

ROWS, COLUMNS = 96, 192
SUN = (np.radians(62.0), np.radians(140.0))  # zenith angle, azimuth from the left edge
TURBIDITY = 2.6


def render(projection="latlong", turbidity=TURBIDITY):
    """A photograph of the analytic sky over dark ground, with a sun, a tree and bad pixels."""
    shape = (ROWS, COLUMNS, 3) if projection == "latlong" else (128, 128, 3)
    zenith, azimuth, _ = Photograph(np.ones(shape), projection).angles()
    up = zenith < np.pi / 2
    directions = af.Directions(zenith[up], azimuth[up] - SUN[1])
    rgb = np.full(shape, 0.02)
    sky = af.ATMOFIT_2026.linear_sRGB(turbidity, SUN[0], directions)
    rgb[up] = np.asarray(sky) / 2e4  # a relative unit
    return rgb, zenith, azimuth


def spoilt():
    rgb, zenith, azimuth = render()
    to_sun = np.arccos(
        np.cos(zenith) * np.cos(SUN[0]) + np.sin(zenith) * np.sin(SUN[0]) * np.cos(azimuth - SUN[1])
    )
    rgb[to_sun < np.radians(1.5)] = [9e3, 8e3, -2e3]  # a damaged sun
    tree = (np.degrees(azimuth) > 300) & (np.degrees(azimuth) < 330) & (np.degrees(zenith) > 65)
    rgb[tree] = 0.01
    rgb[20, 5] = np.nan
    rgb[20, 60, 1] = -0.5
    return rgb, zenith, azimuth, tree


def test_the_sun_is_found_and_what_is_no_sky_is_masked_and_counted():
    rgb, zenith, _, tree = spoilt()
    sky = af.sky_from_photograph(Photograph(rgb))
    apart = af.scattering_angle(sky.solar_zenith_angle, sky.solar_azimuth - SUN[1], SUN[0])
    assert np.degrees(float(apart)) < 1.0  # half a pixel is 0.9
    assert not sky.used[tree].any()
    assert not sky.used[20, 5]
    assert not sky.used[20, 60]
    assert not sky.used[zenith > np.radians(85.0)].any()
    assert sky.counts["not finite"] == 1
    assert sky.counts["negative"] == 1
    assert sky.counts["behind things"] > 0.9 * (tree & (zenith < np.radians(85.0))).sum()
    assert sky.counts["used"] == sky.used.sum()
    assert sum(sky.counts.values()) == ROWS * COLUMNS
    assert sky.cell[sky.used].min() == 0
    assert sky.cell.max() == sky.observation.values.shape[0] - 1


@pytest.mark.slow
@pytest.mark.parametrize("exposure", ["unknown", "each channel"])
def test_turbidity_comes_back(exposure):
    sky = af.sky_from_photograph(Photograph(spoilt()[0]), af.SkySettings(exposure=exposure))
    found = af.estimate_turbidity(sky.observation, af.ATMOFIT_2026, robust=True, starts=2)
    assert found.converged
    # Cells of 7.5 degrees average a curved sky, and the tree's rim is left in some.
    assert found.value == pytest.approx(TURBIDITY, rel=0.04)


def test_a_fisheye_is_the_same_sky():
    rgb, _, _ = render("fisheye")
    sky = af.sky_from_photograph(
        Photograph(rgb, "fisheye"), af.SkySettings(sun=SUN, exposure="unknown")
    )
    found = af.estimate_turbidity(sky.observation, af.ATMOFIT_2026)
    assert found.value == pytest.approx(TURBIDITY, rel=0.03)


def test_solid_angles_add_up():
    for projection, shape, expected in (
        ("latlong", (64, 128, 3), 4 * np.pi),
        ("fisheye", (256, 256, 3), 2 * np.pi),
    ):
        area = Photograph(np.ones(shape), projection).angles()[2]
        assert area.sum() == pytest.approx(expected, rel=2e-3)


def test_files_come_back(tmp_path):
    import cv2
    import OpenEXR

    rgb = render()[0].astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": rgb}) as file:
        file.write(str(tmp_path / "sky.exr"))
    np.testing.assert_allclose(af.read_photograph(tmp_path / "sky.exr").rgb, rgb)
    cv2.imwrite(str(tmp_path / "sky.hdr"), rgb[..., ::-1])
    # Eight bits share an exponent among the channels.
    again = af.read_photograph(tmp_path / "sky.hdr").rgb
    assert (np.abs(again - rgb) <= rgb.max(axis=2, keepdims=True) / 128).all()
    whole = (tmp_path / "sky.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"file must be a whole OpenEXR image, got .*cut"):
        af.read_photograph(tmp_path / "cut.exr")
    (tmp_path / "cut.hdr").write_bytes((tmp_path / "sky.hdr").read_bytes()[:900])
    with pytest.raises(ValueError, match=r"file must be a whole Radiance image, got .*cut"):
        af.read_photograph(tmp_path / "cut.hdr")
    with pytest.raises(ValueError, match=r"a \.png has been tone-mapped"):
        af.read_photograph(tmp_path / "sky.png")
    with pytest.raises(ValueError, match="file must exist"):
        af.read_photograph(tmp_path / "absent.exr")


def test_images_beyond_memory_are_refused_unread(tmp_path, monkeypatch):
    import cv2
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = np.zeros((100, 300, 3), np.float32)
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "wide.exr"))
    cv2.imwrite(str(tmp_path / "wide.hdr"), pixels)
    monkeypatch.setattr("atmofit.observe.images._MOST_PIXELS", 29_999)
    for name in ("wide.exr", "wide.hdr"):
        with pytest.raises(ValueError, match=r"at most 29999 pixels, got (300 x 100|100 x 300) in"):
            af.read_photograph(tmp_path / name)
    monkeypatch.setattr("atmofit.observe.images._LARGEST_IMAGE", 100)
    with pytest.raises(ValueError, match="file must have at most 100 bytes"):
        af.read_photograph(tmp_path / "wide.hdr")


def constant():
    return np.full((ROWS, COLUMNS, 3), 0.5)


def clipped():
    return np.minimum(render()[0], 0.12)


def tone_mapped():
    rgb = spoilt()[0]
    rgb = np.where(np.isfinite(rgb), np.abs(rgb), 1.0)
    return rgb / (rgb + 4 * np.median(rgb))


def masked():
    return np.full((ROWS, COLUMNS, 3), np.nan)


def sunless():
    """The sun behind the photographer's hand: nothing is left within 40 degrees of it."""
    rgb, zenith, azimuth = render()
    across = np.sin(zenith) * np.sin(SUN[0]) * np.cos(azimuth - SUN[1])
    near = np.arccos(np.cos(zenith) * np.cos(SUN[0]) + across) < np.radians(50.0)
    rgb[near] = np.nan
    return rgb


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (constant, "photograph must have the sky's range of brightness"),
        (clipped, "photograph must not be clipped"),
        (tone_mapped, "photograph must show the sun with its full range"),
        (masked, "photograph must show sky"),
        (sunless, "photograph must show the sun with its full range"),
    ],
)
def test_images_that_tell_nothing_are_refused(image, message):
    with pytest.raises(ValueError, match=message):
        af.sky_from_photograph(Photograph(image()))


def test_a_given_sun_may_be_outside_the_frame():
    sky = af.sky_from_photograph(Photograph(sunless()), af.SkySettings(sun=SUN, exposure="unknown"))
    assert sky.solar_zenith_angle == SUN[0]
    assert sky.counts["around the sun"] > 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lowest_elevation_deg": 85.0}, "lowest_elevation_deg must be between 0 and 80 degree"),
        ({"cell_deg": 0.5}, "cell_deg must be between 1 and 30 degree, got 0.5"),
        ({"sun": (2.0, 0.0)}, "sun must be between 0 and 1.5708 rad, got 2"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(af.SkySettings(), **settings)
