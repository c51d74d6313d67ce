"""Pictures of clouds in the sky: what Nishita, Dobashi and Nakamae show, on the values."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.cli import main
from atmofit.clouds.glow import sky_shares
from atmofit.clouds.marching import march
from atmofit.clouds.pattern_light import cloud_phase
from atmofit.clouds.picture import render_cloud
from atmofit.clouds.smooth_march import march_smoothly, packed
from atmofit.clouds.stage import STAGES, staged_cloud, staged_view
from atmofit.clouds.surroundings import clear_surroundings, sunless_surroundings

COUNT, RADIUS = 12, 500.0
PLACES = (np.arange(COUNT) + 0.5) / COUNT * 2 - 1


def ball(distance, extinction=0.05, altitude=1500.0):
    """A ball to the north that fades toward its rim."""
    x, y, z = np.meshgrid(PLACES, PLACES, PLACES, indexing="ij")
    density = np.maximum(1 - (x**2 + y**2 + z**2), 0.0)
    middle = np.array([0.0, distance, altitude])
    return af.clouds.voxel_cloud(extinction * density, middle - RADIUS, middle + RADIUS)


def view(distance, above_ground=2.0, altitude=1500.0):
    """To the ball, three times as wide as it."""
    up = altitude - above_ground
    half = min(3 * RADIUS / math.hypot(distance, up), 1.2)
    horizon = 0.5 + up / max(distance, 1.0) / (2 * math.tan(half))
    return af.View(
        0.0, 0.0, above_ground, 0.0, 2 * half, columns=32, rows=32, horizon=min(horizon, 1.0)
    )


def picture(distance, sun, solar_azimuth, extinction=0.05, **keywords):
    around = clear_surroundings(2.5, math.radians(90 - sun), math.radians(solar_azimuth))
    return render_cloud(
        ball(distance, extinction),
        view(distance),
        around,
        phase=cloud_phase(),
        **{"method": "pattern", "orders": 1} | keywords,
    )


def colours(found):
    return np.asarray(af.XYZ_to_xyY(found.XYZ))


@pytest.mark.slow
def test_rims_are_bright_where_the_sun_is_behind():
    # Figure 7 (b): the middle lets nothing through, the rim scatters straight on.
    luminance = picture(8e3, 10.0, 3.0)
    Y, far = luminance.XYZ[..., 1], luminance.distance > 1e5
    shown = np.argwhere(~far & np.isfinite(luminance.distance))
    row, column = shown.mean(axis=0).astype(int)
    middle = Y[row, column]
    rim = Y[row, column : column + 8].max()
    assert rim > 1.5 * middle
    assert rim > 1.2 * Y[row, 0]


@pytest.mark.slow
def test_far_clouds_are_bluish_and_low_suns_make_them_reddish():
    # Of all orders: by one scattering a cloud is dark from this side, and blue as the sky.
    bright = {"method": "converged", "directions": 14}
    near, away = (picture(d, 50.0, 180.0, **bright) for d in (4e3, 3e4))
    x = []
    for found in (near, away, picture(4e3, 5.0, 180.0, **bright)):
        thick = np.isfinite(found.distance)
        assert thick.sum() > 20
        x.append(np.median(colours(found)[thick][:, 0]))
    assert x[1] < x[0] - 0.003
    assert x[2] > x[0] + 0.03


def test_nothing_is_the_sky_itself():
    # The rest of the picture does not depend on the cloud, and an empty box shows what is behind.
    empty, full = picture(8e3, 30.0, 90.0, extinction=0.0), picture(8e3, 30.0, 90.0)
    beside = np.isinf(full.distance) & (np.arange(32) < 6)[None, :]
    np.testing.assert_allclose(empty.XYZ[beside], full.XYZ[beside], rtol=1e-12)
    # Skies are smooth: a picture without a cloud has no step in it.
    steps = np.abs(np.diff(empty.XYZ[:, :, 1], axis=1)) / empty.XYZ[:, 1:, 1]
    assert steps.max() < 0.05


def test_the_distance_is_that_of_the_ball():
    found = picture(8e3, 50.0, 180.0)
    shown = found.distance[np.isfinite(found.distance)]
    middle = math.hypot(8e3, 1498.0)
    assert np.all(np.abs(shown - middle) < RADIUS)
    assert shown.min() < middle - 0.4 * RADIUS


@pytest.mark.slow
def test_all_orders_are_brighter_than_one_and_white_clouds_are_white():
    one = picture(8e3, 50.0, 180.0)
    all_orders = picture(8e3, 50.0, 180.0, method="converged", directions=14)
    thick = np.isfinite(one.distance)
    assert (all_orders.XYZ[thick, 1] > 1.5 * one.XYZ[thick, 1]).mean() > 0.9
    x, y = np.median(colours(all_orders)[thick][:, :2], axis=0)
    # Between daylight at 5000 K and at 7500 K.
    assert 0.30 < x < 0.345
    assert 0.31 < y < 0.36


@pytest.mark.slow
@pytest.mark.parametrize("method", ["pattern", "converged"])
def test_extremes_are_finite(method):
    keywords = {"method": method, "orders": 1, "directions": 14}
    night = render_cloud(
        ball(3e3), view(3e3), sunless_surroundings(), phase=cloud_phase(), **keywords
    )
    assert np.isfinite(night.XYZ).all()
    assert night.XYZ[..., 1].min() > 0
    around = clear_surroundings(2.5, 0.5)
    for cloud, eye in (
        (ball(0.0), view(1.0, 1500.0)),  # the camera inside
        (ball(3e3, 1e-9), view(3e3)),
        (ball(3e3, 20.0), view(3e3)),  # optical depth 1e4
    ):
        for albedo in (0.0, 1.0):
            found = render_cloud(
                cloud,
                eye,
                around,
                phase=cloud_phase(0.95),
                single_scattering_albedo=albedo,
                **keywords,
            )
            assert np.isfinite(found.XYZ).all()
            assert found.XYZ.min() >= 0


def test_smooth_marching_converges_to_marching_through_voxels():
    def difference(count):
        x, y, z = np.meshgrid(*[(np.arange(count) + 0.5) / count * 2 - 1] * 3, indexing="ij")
        density = np.maximum(1 - (x**2 + y**2 + z**2), 0.0) ** 2
        cloud = af.clouds.voxel_cloud(3.0 * density, (-1.0,) * 3, (1.0,) * 3)
        source = jnp.asarray(1 + x + 0.5 * z)[None]
        origin, aim = jnp.asarray([-3.0, 0.2, 0.1]), jnp.asarray([0.98, 0.1, -0.05])
        aim = aim / jnp.linalg.norm(aim)
        exact = march(cloud, source, origin, aim)
        values = packed(cloud.extinction_coefficient, source)
        smooth = march_smoothly(cloud, values, origin, aim, 2 * count)
        return jnp.stack([exact.radiance[0] - smooth.radiance[0]]), smooth

    coarse, fine = (abs(float(difference(count)[0][0])) for count in (8, 32))
    assert fine < 0.2 * coarse + 1e-4
    slope = jax.grad(lambda s: march_smoothly_of(s))(1.0)
    step = 1e-5
    by_difference = (march_smoothly_of(1 + step) - march_smoothly_of(1 - step)) / (2 * step)
    np.testing.assert_allclose(slope, by_difference, rtol=1e-6)


def march_smoothly_of(scale):
    cloud = ball(0.0, 1e-3, 0.0)
    values = packed(scale * cloud.extinction_coefficient, jnp.ones((1, COUNT, COUNT, COUNT)))
    origin, aim = jnp.asarray([-900.0, 30.0, 20.0]), jnp.asarray([1.0, 0.0, 0.0])
    return march_smoothly(cloud, values, origin, aim, 24).radiance[0]


def test_a_sky_is_held_by_few_of_its_wavelengths():
    around = clear_surroundings(3.0, math.radians(70.0))
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radiance = np.asarray(around.radiance(jnp.asarray(directions)))
    columns, spectra = sky_shares(radiance)
    assert columns.shape == (3, 200)
    off = np.linalg.norm(columns.T @ spectra - radiance) / np.linalg.norm(radiance)
    assert off < 0.03


def test_presets_stand_where_they_should():
    cloud = staged_cloud("cumulus", voxels=16, toward=math.pi / 2)
    stage = STAGES["cumulus"]
    assert max(cloud.extinction_coefficient.shape) == 16
    assert float(cloud.low[2]) == pytest.approx(stage.base, abs=20.0)
    assert float(cloud.low[0] + cloud.high[0]) / 2 == pytest.approx(stage.distance, rel=0.1)
    with pytest.raises(ValueError, match=r"name must be one of .*, got 'fog'"):
        staged_cloud("fog")
    with pytest.raises(ValueError, match="voxels"):
        staged_cloud("cumulus", voxels=2)
    assert staged_view("cumulus", width=40).rows == 30


@pytest.mark.slow
def test_the_command_draws_a_cloud(tmp_path, capsys):
    asked = ["sky", "--clouds", "cumulus", "--voxels", "10", "--width", "24"]
    more = ["--scattering", "pattern", "--exr", "--out", str(tmp_path)]
    assert main(asked + more) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"cumulus.png", "cumulus.exr"}
    assert "luminance" in capsys.readouterr().out
