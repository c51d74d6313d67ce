"""What is left out of a cloud's picture is said, is not computed, and is not missed."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.clouds.depths import voxel_size
from atmofit.clouds.plan import _coarser, _longest_depth, plan_cloud
from atmofit.clouds.surroundings import clear_surroundings, sunless_surroundings

PHASE = af.clouds.cloud_phase()
PLACES = (np.arange(10) + 0.5) / 10 * 2 - 1
X, Y, Z = np.meshgrid(PLACES, PLACES, PLACES, indexing="ij")
VIEW = af.View(0.0, 0.0, 2.0, 0.0, 0.5, columns=24, rows=24, horizon=0.75)


@functools.cache
def around():
    return clear_surroundings(2.5, math.radians(50.0), math.radians(100.0))


def ball(extinction, radius=500.0, distance=5e3):
    middle = np.array([0.0, distance, 1200.0])
    density = np.maximum(1 - (X**2 + Y**2 + Z**2), 0.0)
    return af.clouds.voxel_cloud(extinction * density, middle - radius, middle + radius)


def in_an_empty_box(cloud, more=4):
    size = voxel_size(cloud)
    grid = jnp.pad(cloud.extinction_coefficient, more)
    return af.clouds.voxel_cloud(grid, cloud.low - more * size, cloud.high + more * size)


def render(cloud, plan, method, orders=2):
    keywords = {"method": method, "orders": orders, "directions": 14, "most": 60}
    return af.clouds.render_cloud(
        cloud, VIEW, around(), phase=PHASE, cloud_plan=plan, **keywords
    ).XYZ


def test_empty_voxels_are_not_missed():
    wide = in_an_empty_box(ball(0.03))
    plan = plan_cloud(wide, VIEW, around(), phase=PHASE, method="pattern", orders=1, rtol=0.0)
    # The voxels that hold anything, and one more on each side.
    assert [last - first for first, last in plan.box] == [12, 12, 12]
    assert plan.left_out[0] == "70% of the voxels: empty"
    assert "computed: 12 x 12 x 12 voxels" in str(plan)
    np.testing.assert_allclose(plan.cropped(wide).low, wide.low + 3 * voxel_size(wide), rtol=1e-12)
    whole = dataclasses.replace(plan, box=((0, 18),) * 3)
    off = np.abs(
        render(wide, plan, "pattern", orders=1) / render(wide, whole, "pattern", orders=1) - 1
    )
    # A ray's samples begin at the grid's rim, and the sun's rays blur between empty voxels.
    assert off.max() < 0.03  # seen: 0.018; 0.019 by all orders
    assert off.mean() < 1e-3  # seen: 6.6e-4; 7.3e-4


def test_faint_orders_are_left_out():
    for extinction, kept in ((1e-7, 1), (3e-5, 2), (0.03, 3)):
        plan = plan_cloud(ball(extinction), VIEW, around(), phase=PHASE, method="pattern")
        assert plan.orders == kept
    plan = plan_cloud(ball(3e-5), VIEW, around(), phase=PHASE, method="pattern")
    assert any(line.startswith("orders 3 to 3: at most") for line in plan.left_out)
    black = {"single_scattering_albedo": 1e-3, "method": "pattern"}
    assert plan_cloud(ball(0.03), VIEW, around(), phase=PHASE, **black).orders == 1


def test_no_line_is_longer_than_the_longest():
    rng = np.random.default_rng(3)
    grid = rng.random((5, 8, 3)) * (rng.random((5, 8, 3)) > 0.5)
    cloud = af.clouds.voxel_cloud(grid, (0.0, 0.0, 0.0), (2.0, 2.0, 3.0))
    bound = _longest_depth(cloud)
    starts, aims = rng.random((2, 2000, 3)) * np.array([2.0, 2.0, 3.0])
    aims = aims - starts
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    origin = jnp.asarray(starts - 10 * aims)
    nothing = jnp.zeros_like(cloud.extinction_coefficient)[None]
    passed = jax.jit(jax.vmap(lambda o, a: af.clouds.march(cloud, nothing, o, a).transmittance))
    deepest = float(-jnp.log(jnp.min(passed(origin, jnp.asarray(aims)))))
    assert 0.3 * bound < deepest <= bound


def test_elements_behind_a_thick_cloud_are_left_out():
    thick, thin = (
        plan_cloud(ball(e), VIEW, around(), phase=PHASE, method="pattern", rtol=1e-2)
        for e in (1.0, 1e-4)
    )
    assert len(thick.elements) <= 48
    assert any("elements of sky and ground" in line for line in thick.left_out)
    directions, _ = af.clouds.sky_elements(3)
    # They are beyond the cloud; the rim still sends on what is straight behind.
    left = sorted(set(range(54)) - set(thick.elements))
    assert directions[left][:, 1].min() > 0.4
    whole = plan_cloud(ball(1.0), VIEW, around(), phase=PHASE, method="pattern", rtol=0.0)
    assert whole.elements == tuple(range(54))
    fewer, all_ = (render(ball(1.0), plan, "pattern", orders=1) for plan in (thick, whole))
    assert 0 < np.abs(fewer - all_).sum() / all_.sum() < 1e-2
    assert np.abs(fewer / all_ - 1).max() < 0.05  # seen: 0.032, at the rim
    assert len(thin.elements) >= len(thick.elements)


def test_fewer_spectra_serve_a_grey_sky():
    night = sunless_surroundings()
    plan = plan_cloud(ball(0.03), VIEW, night, phase=PHASE, rtol=1e-3)
    assert plan.orders == 0
    assert "the sun: it does not shine" in plan.left_out
    clear = plan_cloud(ball(0.03), VIEW, around(), phase=PHASE, rtol=1e-3)
    assert clear.sources == 3
    coarse = plan_cloud(ball(0.03), VIEW, around(), phase=PHASE, rtol=0.1)
    assert coarse.sources < 3


@pytest.mark.slow
def test_fewer_spectra_are_not_missed():
    coarse, clear = (
        plan_cloud(ball(0.03), VIEW, around(), phase=PHASE, rtol=r) for r in (0.1, 1e-3)
    )
    assert coarse.sources < clear.sources
    some, all_ = (render(ball(0.03), p, "converged") for p in (coarse, clear))
    assert np.abs(some / all_ - 1).max() < 0.1


def test_a_coarser_cloud_holds_as_much():
    grid = np.random.default_rng(5).random((40, 7, 33))
    cloud = af.clouds.voxel_cloud(grid, (0.0, 0.0, 0.0), (4.0, 0.7, 3.3))
    coarse = _coarser(cloud)
    assert max(coarse.extinction_coefficient.shape) <= 16
    volumes = [float(jnp.prod(voxel_size(c))) for c in (cloud, coarse)]
    one, other = (
        float(c.extinction_coefficient.sum()) * v
        for c, v in zip((cloud, coarse), volumes, strict=True)
    )
    assert other == pytest.approx(one, rel=1e-12)


def test_wrong_input_is_refused():
    cloud = ball(0.03)
    with pytest.raises(TypeError, match="cloud must be known"):
        jax.jit(lambda c: plan_cloud(c, VIEW, around(), phase=PHASE).orders)(cloud)
    with pytest.raises(ValueError, match="rtol"):
        plan_cloud(cloud, VIEW, around(), phase=PHASE, rtol=0.7)
    plan = plan_cloud(in_an_empty_box(cloud), VIEW, around(), phase=PHASE)
    with pytest.raises(ValueError, match="does not lie in a grid of"):
        plan.cropped(cloud)
    with pytest.raises(ValueError, match="elements must be numbers below 6"):
        af.clouds.sky_light(
            cloud, np.ones(6), phase=PHASE, view_direction=(0.0, 0.0, 1.0), elements=(7,)
        )
