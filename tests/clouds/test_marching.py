"""Rays through voxels against a sorted list of all crossings, written anew."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from atmofit.clouds.marching import march, view
from atmofit.clouds.volume import voxel_cloud

RANDOM = np.random.default_rng(5)
LOW, HIGH = np.array([-1.0, -0.5, 0.0]), np.array([1.0, 1.5, 3.0])
EXTINCTION = RANDOM.uniform(0.0, 2.0, (4, 5, 3))
SOURCES = RANDOM.uniform(0.0, 1.0, (2, 4, 5, 3))
CLOUD = voxel_cloud(EXTINCTION, LOW, HIGH)
marched = jax.jit(jax.vmap(march, (None, None, 0, 0)))


def by_crossings(origin, direction):
    """Radiance of both sources and transmittance."""
    planes = [np.linspace(a, b, n + 1) for a, b, n in zip(LOW, HIGH, (4, 5, 3), strict=True)]
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.concatenate(
            [(p - o) / d for p, o, d in zip(planes, origin, direction, strict=True)]
        )
    ways = np.sort(np.concatenate([[0.0], ways[np.isfinite(ways) & (ways > 0)]]))
    radiance, passed = np.zeros(2), 1.0
    for start, end in itertools.pairwise(ways):
        place = (origin + (start + end) / 2 * direction - LOW) / (HIGH - LOW) * (4, 5, 3)
        if np.all((place > 0) & (place < (4, 5, 3))):
            voxel = tuple(place.astype(int))
            left = np.exp(-EXTINCTION[voxel] * (end - start))
            radiance += passed * (1 - left) * SOURCES[(slice(None), *voxel)]
            passed *= left
    return radiance, passed


def rays(count):
    """Toward places in the cloud, from outside and from inside, some along an axis."""
    inside = RANDOM.uniform(LOW, HIGH, (count, 3))
    direction = RANDOM.normal(size=(count, 3))
    direction[: count // 4, :2] = 0.0
    direction[count // 4 : count // 2, 0] = 0.0
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    back = np.where(np.arange(count) % 3 == 0, 0.0, 10.0)
    return inside - back[:, None] * direction, direction


@pytest.mark.parametrize(("dtype", "tolerance"), [("float64", 1e-12), ("float32", 1e-5)])
def test_march_agrees_with_sorted_crossings(dtype, tolerance):
    origins, directions = rays(400)
    cloud = voxel_cloud(EXTINCTION.astype(dtype), LOW, HIGH)
    arrays = (jnp.asarray(values, dtype) for values in (SOURCES, origins, directions))
    found = marched(cloud, *arrays)
    assert found.radiance.dtype == dtype
    expected = [by_crossings(*ray) for ray in zip(origins, directions, strict=True)]
    # A ray of 10 m is placed to some roundings of 10 in single precision.
    np.testing.assert_allclose(found.radiance, [e[0] for e in expected], atol=tolerance)
    np.testing.assert_allclose(found.transmittance, [e[1] for e in expected], atol=tolerance)


def test_a_ray_that_misses_or_has_passed_meets_nothing():
    origins = jnp.asarray([[3.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 9.0, 1.0]])
    directions = jnp.asarray([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    found = marched(CLOUD, jnp.asarray(SOURCES), origins, directions)
    np.testing.assert_array_equal(found.radiance, 0.0)
    np.testing.assert_array_equal(found.transmittance, 1.0)


def test_both_ways_let_the_same_through():
    origins, directions = rays(60)
    ends = origins + 30.0 * directions
    forth = marched(CLOUD, jnp.asarray(SOURCES), jnp.asarray(ends - 60 * directions), directions)
    back = marched(CLOUD, jnp.asarray(SOURCES), jnp.asarray(ends), -jnp.asarray(directions))
    np.testing.assert_allclose(forth.transmittance, back.transmittance, rtol=1e-12)


def test_slopes_by_extinction_and_source():
    origin, direction = jnp.asarray([-3.0, -2.0, -1.0]), jnp.asarray([0.6, 0.48, 0.64])

    def radiance(extinction, sources):
        cloud = voxel_cloud(extinction, LOW, HIGH)
        return march(cloud, jnp.asarray(sources), origin, direction).radiance[1]

    values = (jnp.asarray(EXTINCTION), jnp.asarray(SOURCES))
    check_grads(radiance, values, order=1, rtol=1e-7)


def test_thick_and_empty_voxels_stay_finite():
    extinction = jnp.asarray([[[0.0, 1e-30, 1e6, 0.0]]])
    sources = jnp.ones((1, 1, 4))

    def radiance(extinction):
        cloud = voxel_cloud(extinction, np.zeros(3), np.ones(3))
        middle, up = jnp.asarray([0.5, 0.5, -1.0]), jnp.asarray([0.0, 0.0, 1.0])
        return march(cloud, sources, middle, up).radiance

    value, slope = jax.value_and_grad(radiance)(extinction)
    assert value == pytest.approx(1.0)
    assert np.all(np.isfinite(slope))
    # The first voxel is a quarter of the way; what it adds it takes from those behind.
    assert slope[0, 0, 0] == pytest.approx(0.0)


def test_a_picture_stands_as_that_of_the_path_tracer():
    """A voxel toward +x, +y, +z: seen from +z it is right and up, seen from +x left and up."""
    extinction = np.zeros((4, 4, 4))
    extinction[3, 3, 3] = 1e3
    cloud = voxel_cloud(extinction, -np.ones(3), np.ones(3))
    for angle, column in ((0.0, slice(6, 8)), (np.pi / 2, slice(0, 2))):
        seen = view(cloud, np.ones((4, 4, 4)), sun_angle=angle, width=8, extent=2.0)
        expected = np.zeros((8, 8))
        expected[:2, column] = 1.0
        np.testing.assert_allclose(seen.radiance, expected, atol=1e-6)
        np.testing.assert_allclose(seen.transmittance, 1 - expected, atol=1e-6)


def test_impossible_pictures_are_refused():
    with pytest.raises(ValueError, match="source_function"):
        view(CLOUD, np.ones((4, 5, 4)), sun_angle=0.0)
    with pytest.raises(ValueError, match="sun_angle"):
        view(CLOUD, SOURCES[0], sun_angle=4.0)
    with pytest.raises(ValueError, match="rays"):
        view(CLOUD, SOURCES[0], sun_angle=0.0, rays=0)
