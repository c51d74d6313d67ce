"""Growth of clouds, and the presets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.clouds.growth import grow, triangulate
from atmofit.clouds.metaballs import metaballs
from atmofit.clouds.presets import PRESETS, cloud_preset

START = metaballs([[0.0, 0.0, 600.0], [500.0, 0.0, 500.0]], [600.0, 500.0], 1.0)


def test_surface_of_a_ball_is_a_sphere():
    v = 0.5
    ball = metaballs([[10.0, 20.0, 30.0]], [2.0], [1.0], (5 * v**2 + 4 * v**3) / 9)
    surface = triangulate(ball, 40)
    away = surface.corners - np.array([10.0, 20.0, 30.0])
    radius, cell = 2 * np.sqrt(1 - v), 4 / 40
    # Linear within a cell: wrong by the cell squared times curvature, an eighth of it.
    np.testing.assert_allclose(np.linalg.norm(away, axis=-1), radius, atol=cell**2 / 2)
    assert surface.areas.sum() == pytest.approx(4 * np.pi * radius**2, rel=0.01)
    assert np.all(np.sum(surface.normals * away.mean(axis=1), axis=1) > 0)


def test_the_same_seed_grows_the_same_balls():
    one, same, other = (grow(START, most=40, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.centres, same.centres)
    assert np.array_equal(one.radii, same.radii)
    assert not np.array_equal(one.centres, other.centres)


def test_old_balls_stay_and_the_count_is_bounded():
    for most in (0, 2, 3, 31):
        grown = grow(START, most=most, generations=3)
        assert grown.count == max(most, 2)
        assert np.array_equal(grown.centres[:2], START.centres)


def test_new_balls_are_on_the_surface_and_not_below():
    grown = grow(START, generations=1, most=300, lowest_normal=-0.1)
    centres, radii = np.asarray(grown.centres)[2:], np.asarray(grown.radii)[2:]
    lowest = triangulate(START).corners[..., 2].min()
    assert np.all(centres[:, 2] - radii >= lowest - 1e-9)
    left = centres[:, 2] > lowest + radii + 1e-9  # the others were lifted
    assert left.sum() > 200
    # The box is 1600 m, a cell 33 m: linear within it, wrong by about 1 m of a slope of 1 / 250 m.
    np.testing.assert_allclose(START.density(centres[left]), 0.25, atol=0.02)
    down = -np.asarray(jax.vmap(jax.grad(START.density))(jnp.asarray(centres[left])))
    # Normals of triangles, of 33 m on balls of 400 m, are up to 0.1 off.
    assert np.min(down[:, 2] / np.linalg.norm(down, axis=1)) > -0.2


def test_radii_shrink_outward_and_by_generation():
    grown = grow(START, generations=2, most=602, outward=0.8)
    centres, radii = np.asarray(grown.centres)[2:], np.asarray(grown.radii)[2:]
    first, second = radii[:200], radii[200:]
    assert second.mean() < 0.6 * first.mean()
    away = np.linalg.norm((centres[:200] - [200, 0, 550]) / [1400, 1100, 1100], axis=1)
    assert np.corrcoef(away, first)[0, 1] < -0.3


@pytest.mark.parametrize(
    "balls",
    [metaballs([], [], []), metaballs(np.zeros((1, 3)), [1.0], [0.1])],
    ids=["no balls", "none dense enough"],
)
def test_without_a_surface_nothing_grows(balls):
    assert triangulate(balls).areas.size == 0
    assert grow(balls).count == balls.count


def test_nowhere_to_grow():
    assert grow(START, lowest_normal=1.0).count == 2


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name):
    cloud, start = cloud_preset(name, seed=4), cloud_preset(name, seed=4, grown=False)
    assert cloud.count == {"cumulus": 96, "cumulonimbus": 340}[name]
    assert np.array_equal(cloud.centres[: start.count], start.centres)
    assert np.all(cloud.centres[:, 2] - cloud.radii >= -1e-2)


def test_impossible_values_are_refused():
    with pytest.raises(ValueError, match='"cumulus", "cumulonimbus"'):
        cloud_preset("stratus")
    with pytest.raises(ValueError, match="most must be between 0 and 10000"):
        grow(START, most=10**9)
    with pytest.raises(ValueError, match="generations must be"):
        grow(START, generations=99)
    with pytest.raises(ValueError, match="cells must be"):
        triangulate(START, 10_000)
