"""Rays against a march that shares no code, shadows against triangles, and what the air must do."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.landscape.view import intersect

PLAN = af.PathPlan("gauss", 8)
HILLS = af.procedural_terrain(4, 128, 100.0, 800.0)
VIEW = af.View(6000.0, 1500.0, 150.0, 0.2, columns=24, rows=30, farthest=12e3, horizon=0.4)
FLAT = af.Terrain(np.zeros((8, 8)), 2e4)
OVER_FLAT = af.View(
    7e4, 1e3, 500.0, 0.0, np.radians(3.0), columns=3, rows=60, farthest=1e5, horizon=0.3
)


def light(turbidity=3.0, zenith_deg=60.0, azimuth_deg=200.0, **options):
    return af.clear_light(turbidity, np.radians(zenith_deg), np.radians(azimuth_deg), **options)


@pytest.fixture(scope="module")
def day():
    return light()


def test_rays_find_the_ground_that_a_march_finds():
    hits = intersect(HILLS, VIEW, jnp.arange(VIEW.columns))
    heights, spacing = np.asarray(HILLS.heights), float(HILLS.spacing)

    def height(x, y):
        i, j = (np.clip(v / spacing, 0, 126.999).astype(int) for v in (y, x))
        u, v = np.clip(x / spacing, 0, 127) - j, np.clip(y / spacing, 0, 127) - i
        upper = heights[i + 1, j] * (1 - u) + heights[i + 1, j + 1] * u
        return (heights[i, j] * (1 - u) + heights[i, j + 1] * u) * (1 - v) + upper * v

    eye = height(6000.0, 1500.0) + 150.0
    steps = np.arange(1.0, 12e3, 1.0)
    wrong = 0
    for c in range(0, 24, 3):
        azimuth = float(hits.azimuth[c])
        x, y = 6000 + steps * np.sin(azimuth), 1500 + steps * np.cos(azimuth)
        inside = (x >= 0) & (x <= 12700) & (y >= 0) & (y <= 12700)
        ground = np.where(inside, height(x, y), -1e6)
        for r in range(30):
            below = ground > eye + steps * float(hits.slope[c, r])
            met = bool(below.any())
            # A ray that only grazes a crest may pass between two samples.
            same = met == bool(hits.is_ground[c, r])
            if met and same:
                # Samples are .3 % of their distance apart, and the ground is bent between.
                first = steps[np.argmax(below)]
                same = abs(float(hits.distance[c, r]) - first) <= 0.005 * first + 2.0
            wrong += not same
    assert wrong <= 2


def test_level_ground_lies_where_geometry_says():
    hits = intersect(FLAT, OVER_FLAT, jnp.arange(3))
    slope = np.asarray(hits.slope)
    expected = np.where(slope < 0, -500.0 / np.where(slope < 0, slope, -1.0), np.inf)
    seen = expected < 0.9e5
    assert np.array_equal(np.asarray(hits.is_ground)[seen], np.ones(seen.sum(), bool))
    assert not np.asarray(hits.is_ground)[slope > 0].any()
    np.testing.assert_allclose(np.asarray(hits.distance)[seen], expected[seen], rtol=1e-4)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, 270.0, 30.0])
def test_a_wall_casts_a_shadow_as_long_as_a_triangle(azimuth_deg):
    heights = np.zeros((101, 101))
    heights[50, 50] = 100.0
    zenith = np.radians(70.0)
    lit = np.asarray(af.Terrain(heights, 10.0).sunlit(zenith, np.radians(azimuth_deg)))
    # Away from the sun: 100 m tan 70 degrees are 275 m, 27 points.
    away = np.radians(azimuth_deg + 180.0)
    along = np.round(50 + np.arange(1, 45)[:, None] * [np.cos(away), np.sin(away)]).astype(int)
    share = lit[along[:, 0], along[:, 1]]
    if azimuth_deg % 90 == 0:
        assert (share[:26] < 0.5).all()
    # Between the points shadows blur: a lone peak's fades with distance.
    assert (share[:4] < 0.5).all()
    assert (share[30:] == 1.0).all()
    toward = np.round(50 - np.arange(1, 45)[:, None] * [np.cos(away), np.sin(away)]).astype(int)
    assert (lit[toward[:, 0], toward[:, 1]] == 1.0).all()


def test_no_shadow_under_a_high_sun():
    assert np.asarray(HILLS.sunlit(0.05, 1.0)).min() > 0.99


def test_tiles_do_not_show(day):
    whole, tiled = (af.render_landscape(HILLS, VIEW, day, PLAN, tile=n) for n in (24, 7))
    np.testing.assert_allclose(tiled.XYZ, whole.XYZ, rtol=1e-9)
    np.testing.assert_allclose(tiled.distance, whole.distance, rtol=1e-12)
    assert whole.XYZ.shape == (30, 24, 3)
    assert np.isfinite(whole.XYZ).all()


def test_another_hour_compiles_nothing(day):
    af.render_landscape(HILLS, VIEW, day, PLAN, 0.2)
    later = light(4.0, 75.0, 250.0)
    elsewhere = dataclasses.replace(VIEW, azimuth=1.0)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event)
    )
    af.render_landscape(HILLS, elsewhere, later, PLAN, 0.3)
    assert "/jax/core/compile/backend_compile_duration" not in compiled


def over_flat_ground(a_light, **options):
    """Luminance and chromaticity down the middle column, with distances."""
    picture = af.render_landscape(FLAT, OVER_FLAT, a_light, PLAN, 0.05, **options)
    xyY = np.asarray(af.XYZ_to_xyY(picture.XYZ))[:, 1]
    return xyY, picture.distance[:, 1]


def test_dark_ground_turns_lighter_and_bluer_with_distance(day):
    xyY, distance = over_flat_ground(day)
    ground = np.flatnonzero(np.isfinite(distance))
    near, far = xyY[ground[-1]], xyY[ground[np.argmin(abs(distance[ground] - 3e4))]]
    assert far[2] > 1.2 * near[2]
    assert far[0] < near[0] - 0.01
    # Without air neither happens: only the light is the same.
    bare, _ = over_flat_ground(day, air="none")
    np.testing.assert_allclose(bare[ground], np.broadcast_to(bare[ground[0]], bare[ground].shape))


def test_the_horizon_is_whiter_than_the_sky_above(day):
    xyY, distance = over_flat_ground(day)
    sky = np.flatnonzero(~np.isfinite(distance) & (np.arange(60) < 18))
    white = np.hypot(xyY[sky, 0] - 1 / 3, xyY[sky, 1] - 1 / 3)
    assert white[-1] < 0.8 * white[0]
    assert xyY[sky[-1], 2] > xyY[sky[0], 2]


def test_at_sunset_east_and_west_differ_in_hue_and_haze_is_warm():
    colours = {}
    for turbidity in (2.0, 6.0):
        # Later than 84 degrees haze has dimmed the sun so far that the sky's colour is left.
        evening = light(turbidity, 80.0, 270.0)
        for name, azimuth in (("west", 270.0), ("east", 90.0)):
            view = dataclasses.replace(OVER_FLAT, east=jnp.asarray(7e4), north=jnp.asarray(7e4))
            view = dataclasses.replace(view, azimuth=jnp.asarray(np.radians(azimuth)))
            picture = af.render_landscape(FLAT, view, evening, PLAN, 0.05)
            far = np.argmin(np.abs(picture.distance[:, 1] - 2e4))
            colours[turbidity, name] = np.asarray(af.XYZ_to_xyY(picture.XYZ))[far, 1]
    west, east = colours[6.0, "west"], colours[6.0, "east"]
    assert west[2] > 1.5 * east[2]
    assert west[0] > east[0] + 0.01
    assert west[0] > colours[2.0, "west"][0] + 0.01


def test_a_constant_ambient_light_knows_no_direction(day):
    ambient = af.WardLarson(jnp.full(9, 0.02))
    pictures = {}
    for azimuth in (200.0, 20.0):
        view = dataclasses.replace(OVER_FLAT, east=jnp.asarray(7e4), north=jnp.asarray(7e4))
        view = dataclasses.replace(view, azimuth=jnp.asarray(np.radians(azimuth)))
        for air, given in (("path", None), ("ambient", ambient)):
            found = af.render_landscape(FLAT, view, day, PLAN, 0.05, air, given)
            far = np.argmin(np.abs(found.distance[:, 1] - 2e4))
            pictures[azimuth, air] = found.XYZ[far, 1]
    np.testing.assert_allclose(pictures[200.0, "ambient"], pictures[20.0, "ambient"], rtol=1e-6)
    assert pictures[200.0, "path"][1] > 1.3 * pictures[20.0, "path"][1]


def test_overcast_light_is_grey_and_without_shadow():
    grey = af.overcast_light(10.0)
    picture = af.render_landscape(HILLS, VIEW, grey, PLAN, 0.2, "none")
    xyY = np.asarray(af.XYZ_to_xyY(picture.XYZ))
    assert np.ptp(xyY[..., 0]) < 1e-6
    assert np.asarray(grey.around.sun_irradiance).max() == 0.0


def test_grids_are_read(tmp_path):
    path = tmp_path / "hills.asc"
    path.write_text(
        "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 30\nNODATA_value -9999\n"
        "1 2 3\n4 5 -9999\n"
    )
    terrain = af.read_elevation_grid(path)
    np.testing.assert_array_equal(terrain.heights, [[4, 5, 1], [1, 2, 3]])
    assert terrain.spacing == 30.0
    for text, message in (
        ("ncols 3\nnrows 2\n1 2", "file must name ncols, nrows, cellsize"),
        ("ncols 3\nnrows 2\ncellsize 30\n1 2", "file must hold 2 x 3 heights, got 2"),
        ("ncols x\n", "file must hold numbers, got 'x'"),
        ("ncols 1\nnrows 1\ncellsize 1\n-9999", "got only points without data"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            af.read_elevation_grid(path)


def test_terrain_comes_back_from_its_seed():
    again = af.procedural_terrain(4, 128, 100.0, 800.0)
    np.testing.assert_array_equal(again.heights, HILLS.heights)
    assert not np.allclose(af.procedural_terrain(5, 128, 100.0, 800.0).heights, HILLS.heights)
    assert float(HILLS.heights.max()) == pytest.approx(800.0)


def render(a_light, **options):
    return af.render_landscape(HILLS, VIEW, a_light, PLAN, **options)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d: af.render_landscape(HILLS, VIEW, d, PLAN, air="fog"), "air must be one of"),
        (
            lambda d: af.render_landscape(HILLS, VIEW, d, PLAN, air="ambient"),
            "ambient must be given",
        ),
        (
            lambda d: af.render_landscape(HILLS, VIEW, d, PLAN, 1.5),
            "albedo must be between 0 and 1",
        ),
        (lambda _: af.Terrain(np.zeros((1, 5)), 10.0).checked(), "heights must be a grid"),
        (lambda _: af.procedural_terrain(points=3), "points must be between 16"),
        (
            lambda _: af.View(0.0, 0.0, 2.0, 0.0, field_of_view=4.0).checked(),
            "field_of_view must be",
        ),
    ],
)
def test_bad_requests_are_refused(day, call, message):
    with pytest.raises(ValueError, match=message):
        call(day)
