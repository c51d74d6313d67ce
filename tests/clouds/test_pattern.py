"""Orders two and three by the reference pattern, beside random walks in the same boxes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.cloud_orders import cloud_orders

from atmofit.clouds.depths import sunlight_reaching
from atmofit.clouds.pattern import (
    adaptive_counts,
    leg_chance,
    random_paths,
    reference_pattern,
)
from atmofit.clouds.pattern_light import cloud_phase, light_by_paths, pattern_light
from atmofit.clouds.volume import voxel_cloud
from atmofit.optics.phase import CornetteShanks

BOX, DEPTH = (4, 4, 4), 0.1  # of a voxel
VIEW = np.array([0.02, 0.03, 1.0]) / np.linalg.norm([0.02, 0.03, 1.0])
SUN = np.array([-0.4, 0.3, -0.2]) / np.linalg.norm([-0.4, 0.3, -0.2])
G = 0.7
PHASE = CornetteShanks(G)


def shanks(cosine, g=G):
    top = 3 * (1 - g**2) / (2 * (2 + g**2)) * (1 + cosine**2)
    return top / (1 + g**2 - 2 * g * cosine) ** 1.5 / (4 * np.pi)


def box(extinction=DEPTH, counts=BOX):
    return voxel_cloud(np.full(counts, extinction), (0.0, 0.0, 0.0), tuple(map(float, counts)))


@functools.cache
def whole(share=1.0, own=True, orders=3):
    return reference_pattern(
        phase=PHASE,
        sun_direction=SUN,
        view_direction=VIEW,
        voxel_size=1.0,
        extinction_coefficient=DEPTH,
        counts=(7, 7, 7),
        share=share,
        most=200_000,
        own_voxel=own,
        directions=1000,
        orders=orders,
    )


def intensity(light, cloud):
    seen = np.asarray(sunlight_reaching(cloud, VIEW) * cloud.extinction_coefficient)
    return np.sum(np.asarray(light.source_function) * seen, axis=(1, 2, 3))


def test_orders_agree_with_a_random_walk():
    # All paths of a sample space that reaches from any voxel of the box to any other.
    cloud = box()
    pattern = whole(share=0.97)
    light = pattern_light(
        cloud, phase=PHASE, sun_direction=SUN, view_direction=VIEW, pattern=pattern
    )
    walk, error = cloud_orders(
        np.array(BOX, float), DEPTH, shanks, SUN, VIEW, photons=100_000, orders=3
    )
    # The cut edges of a box four voxels wide cost the first order 1 to 3 %, and so on; a walk
    # in a wider box is in the experiment.
    for found, true, noise, part in zip(
        intensity(light, cloud), walk, error, (0.03, 0.05, 0.08), strict=True
    ):
        assert abs(found / true - 1) < part + 3 * noise / true


def test_the_sample_space_itself_is_reproduced():
    # The middle voxel of a cloud that is the sample space, all paths.
    pattern = whole(orders=2)
    cloud = box(counts=(7, 7, 7))
    lit = sunlight_reaching(cloud, SUN)
    middle = light_by_paths(cloud, lit, pattern.paths[0])[3, 3, 3]
    assert float(middle) == pytest.approx(pattern.paths[0].total, rel=1e-5)


def test_counts_of_paths():
    pattern = reference_pattern(
        phase=PHASE,
        sun_direction=SUN,
        view_direction=VIEW,
        voxel_size=1.0,
        extinction_coefficient=DEPTH,
        own_voxel=False,
        most=400,
        directions=300,
    )
    assert pattern.counts == (8, 8, 16)
    assert [paths.possible for paths in pattern.paths] == [1023, 1_046_529]
    assert len(pattern.paths[0].factor) <= 400 == len(pattern.paths[1].factor)
    for paths in pattern.paths:
        assert np.all(np.diff(paths.contribution) <= 0)
        assert paths.contribution.sum() == pytest.approx(paths.share * paths.total)
        assert np.all(np.any(paths.legs != 0, axis=-1))  # no leg stays in its voxel
        assert paths.scale == pytest.approx(1 / paths.share)
    assert sum(pattern.order_shares) == pytest.approx(1)


def test_the_fewest_paths_that_bring_the_share_are_kept():
    some, all_ = whole(share=0.8, orders=2).paths[0], whole(orders=2).paths[0]
    assert some.share >= 0.8
    assert some.contribution[:-1].sum() < 0.8 * all_.total
    np.testing.assert_array_equal(some.contribution, all_.contribution[: len(some.contribution)])


def test_drawn_paths_are_right_on_average():
    pattern = whole(share=0.8, orders=2)
    cloud = box(counts=(7, 7, 7))
    full = pattern.paths[0]
    # In even extinction the filter is the sum of the contributions, see the test above.
    true, drawn, printed = full.total, [], []
    for seed in range(400):
        paths = random_paths(pattern, 0.25, seed).paths[0]
        drawn.append(paths.scale * paths.contribution.sum())
        ratio = len(full.factor) / len(paths.factor)
        printed.append(full.share * ratio * paths.contribution.sum())  # I r n2 / n1
    error = np.std(drawn) / np.sqrt(len(drawn))
    assert abs(np.mean(drawn) - true) < 3 * error
    assert np.mean(printed) / true == pytest.approx(full.share**2, abs=3 * error / true)
    assert full.share**2 == pytest.approx(0.64, abs=0.02)
    lit = sunlight_reaching(cloud, SUN)
    one = random_paths(pattern, 0.25, 0).paths[0]
    assert float(light_by_paths(cloud, lit, one)[3, 3, 3]) == pytest.approx(drawn[0], rel=1e-5)


def test_orders_that_are_not_asked_for_are_not_there():
    cloud, kwargs = box(), {"phase": PHASE, "sun_direction": SUN, "view_direction": VIEW}
    one = pattern_light(cloud, orders=1, **kwargs)
    assert one.source_function.shape == (1, *BOX)
    assert one.paths == ()
    two = pattern_light(cloud, orders=2, pattern=whole(share=0.8), **kwargs)
    assert two.source_function.shape == (2, *BOX)
    np.testing.assert_allclose(two.total, jnp.sum(two.source_function, axis=0))
    with pytest.raises(ValueError, match="orders to 2"):
        pattern_light(cloud, orders=3, pattern=whole(share=0.8, orders=2), **kwargs)


def test_albedo_counts_once_for_each_order_and_emptiness_is_dark():
    grid = np.zeros((9, 8, 8))
    grid[2:5, 3:6, 1:7] = DEPTH * (1 + np.random.default_rng(2).random((3, 3, 6)))
    cloud = voxel_cloud(grid, (0.0, 0.0, 0.0), (9.0, 8.0, 8.0))
    kwargs = {"phase": PHASE, "sun_direction": SUN, "view_direction": VIEW, "pattern": whole(0.8)}
    white, grey = (
        pattern_light(cloud, single_scattering_albedo=w, **kwargs).source_function
        for w in (1.0, 0.5)
    )
    for order in range(3):
        np.testing.assert_allclose(grey[order], 0.5 ** (order + 1) * white[order], rtol=1e-12)
    # As a traced cloud, the box of what holds anything is not known: the same light in it.
    traced = jax.jit(
        lambda e: (
            pattern_light(
                voxel_cloud(e, (0.0, 0.0, 0.0), (9.0, 8.0, 8.0)), **kwargs
            ).source_function
        )
    )(grid)
    held = grid > 0
    np.testing.assert_allclose(traced[:, held], np.asarray(white)[:, held], rtol=1e-12)


def test_slopes_by_the_extinction():
    grid = jnp.asarray(DEPTH * (1 + np.random.default_rng(2).random((3, 3, 4))))
    turn = jnp.asarray(np.random.default_rng(4).random(grid.shape))

    @jax.jit
    def total(step):
        cloud = voxel_cloud(grid + step * turn, (0.0, 0.0, 0.0), (3.0, 3.0, 4.0))
        light = pattern_light(
            cloud, phase=PHASE, sun_direction=SUN, view_direction=VIEW, pattern=whole(0.8)
        )
        return jnp.sum(light.total)

    step = 1e-5
    difference = float(total(step) - total(-step)) / (2 * step)
    assert float(jax.grad(total)(0.0)) == pytest.approx(difference, rel=1e-6)


def test_sample_space_follows_the_light():
    kwargs = {"phase": CornetteShanks(0.9), "view_direction": (0.0, 0.0, 1.0), "voxel_size": 1.0}
    kwargs |= {"largest": (9, 9, 21), "share": 0.8, "directions": 600}
    # Toward the sun: what counts lies along the line of sight.
    x, y, z = adaptive_counts(extinction_coefficient=0.05, sun_direction=(0.0, 0.0, -1.0), **kwargs)
    assert x <= 5
    assert y <= 5
    assert z >= 11
    # Lit from the side, a thick cloud's light comes from near.
    thin, thick = (
        adaptive_counts(extinction_coefficient=depth, sun_direction=(1.0, 0.0, 0.0), **kwargs)
        for depth in (0.05, 1.0)
    )
    assert np.prod(thick) < np.prod(thin)


def test_phase_of_droplets():
    angle = np.array([0.0, 0.7, np.pi])
    mixed = np.asarray(cloud_phase(0.9)(jnp.asarray(angle)))
    rayleigh = 3 / (16 * np.pi) * (1 + np.cos(angle) ** 2)
    np.testing.assert_allclose(
        mixed, 0.95 * shanks(np.cos(angle), 0.9) + 0.05 * rayleigh, rtol=1e-10
    )
    # Erratum 52: below a tenth at 10 degrees only from g = .912 on.
    tenth = np.cos(np.radians(10))
    assert shanks(tenth, 0.9) / shanks(1.0, 0.9) > 0.1 > shanks(tenth, 0.913) / shanks(1.0, 0.913)


def test_chance_of_a_leg():
    legs = np.array([[[0, 0, 2]], [[0, 0, 0]]])
    thick = leg_chance(legs, np.array([1.0, 1.0, 1.0]), 0.5)[:, 0]
    # Half of its own voxel, the next, then a collision in the one behind.
    np.testing.assert_allclose(thick, [np.exp(-0.75) * (1 - np.exp(-0.5)), 1 - np.exp(-0.25)])


def test_refusals():
    kwargs = {"phase": PHASE, "sun_direction": SUN, "view_direction": VIEW, "voxel_size": 1.0}
    with pytest.raises(ValueError, match="orders"):
        reference_pattern(extinction_coefficient=1.0, orders=4, **kwargs)
    with pytest.raises(ValueError, match="2048"):
        reference_pattern(extinction_coefficient=1.0, counts=(30, 30, 30), **kwargs)
    with pytest.raises(ValueError, match="chance"):
        random_paths(whole(orders=2), 0.0, 0)
    with pytest.raises(ValueError, match="known"):
        jax.jit(
            lambda e: pattern_light(
                voxel_cloud(e, (0.0,) * 3, (1.0,) * 3), phase=PHASE, view_direction=VIEW
            )
        )(jnp.ones((2, 2, 2)))
