"""Light of all orders: balances that must close, closed forms, symmetries and the path tracer."""

import functools
import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from measured_data import data_folder
from reference.data import needs
from scipy.integrate import lebedev_rule, quad

import atmofit as af
from atmofit.clouds.converged import converged_light
from atmofit.clouds.first_order import single_scattering
from atmofit.clouds.marching import view
from atmofit.clouds.ordinates import COUNTS, ScaledPhase, degree_held, ordinates
from atmofit.clouds.path_trace import path_trace
from atmofit.clouds.sweeps import sweep
from atmofit.clouds.volume import voxel_cloud

NPZ = "cloud_sphere_pathtraced.npz"
F32 = np.float32
RANDOM = np.random.default_rng(7)
PHASE = af.HenyeyGreenstein(0.85)
ASIDE = (0.6, 0.0, 0.8)
UNEVEN = RANDOM.uniform(0.0, 3.0, (3, 5, 4))
SIDES = np.array([0.3, 0.6, 0.5])  # of its voxels


def sphere(voxels, extinction=5.0, dtype: Any = F32):
    """Radius 1; voxels at its surface have the mean of what is inside and outside."""
    parts = 6
    x = ((np.arange(voxels * parts) + 0.5) / (voxels * parts) * 2 - 1) ** 2
    inside = x[:, None, None] + x[None, :, None] + x[None, None, :] < 1
    share = inside.reshape((voxels, parts) * 3).mean((1, 3, 5))
    return voxel_cloud((extinction * share).astype(dtype), -np.ones(3), np.ones(3))


def balls(voxels, optical_depth):
    """Three that overlap and fade out, a cloud without symmetry."""
    place = ((np.arange(voxels) + 0.5) / voxels * 2 - 1) * 1.2
    density = np.zeros((voxels,) * 3)
    for x, y, z, radius in ((0, 0, 0, 1.1), (0.5, 0.3, 0.2, 0.7), (-0.4, 0.1, 0.5, 0.7)):
        a, b, c = np.meshgrid(place - x, place - y, place - z, indexing="ij")
        density += np.clip(1 - (a**2 + b**2 + c**2) / radius**2, 0.0, None) ** 3
    column = density.sum(axis=2).max() * 2.4 / voxels
    grid = density * optical_depth / column
    return voxel_cloud(grid.astype(F32), -1.2 * np.ones(3), 1.2 * np.ones(3))


def uneven(extinction=UNEVEN, sides=SIDES):
    return voxel_cloud(extinction, np.zeros(3), sides * np.array(extinction.shape))


def blocks(picture):
    """Averages over 8x8 pixels."""
    return np.asarray(picture, float).reshape(6, 8, 6, 8).mean((1, 3))


def relative(found, expected):
    return math.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))


@pytest.mark.parametrize("count", COUNTS)
def test_quadrature_is_lebedevs(count):
    directions, weight = ordinates(count)
    assert directions.shape == (count, 3)
    others, other_weight = lebedev_rule(2 * degree_held(count) + 1)
    sets = [
        sorted(map(tuple, np.round(np.column_stack(columns), 9) + 0.0))
        for columns in ((directions, weight), (others.T, other_weight))
    ]
    np.testing.assert_allclose(sets[0], sets[1], atol=2e-9)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("asymmetry", [-0.5, 0.0, 0.85, 0.99])
def test_scattering_keeps_power_and_mean_cosine(count, asymmetry):
    parts = ScaledPhase.of(af.HenyeyGreenstein(asymmetry), count, jnp.asarray([550.0]))
    matrix, (directions, _) = np.asarray(parts.matrix(count)), ordinates(count)
    np.testing.assert_allclose(matrix.sum(axis=0), 1.0, rtol=1e-12)
    mean = (matrix * (directions @ directions.T)).sum(axis=0)
    peak = float(parts.peak)
    # Of a backward peak the part beyond the last degree is blurred: at most turned round.
    blurred = 2 * max(-asymmetry, 0.0) ** (degree_held(count) + 1)
    np.testing.assert_allclose(peak + (1 - peak) * mean, asymmetry, atol=1e-12 + blurred)


@pytest.mark.parametrize("shape", [(4, 4, 4), (3, 5, 4), (1, 1, 6)])
def test_each_direction_loses_nothing(shape):
    extinction, count = RANDOM.uniform(0.0, 4.0, shape), 26
    emitted, inflow = RANDOM.uniform(0.0, 1.0, (count, *shape)), RANDOM.uniform(0.0, 1.0, count)
    thick, size, power, outside = (jnp.asarray(x) for x in (extinction, SIDES, emitted, inflow))
    found = sweep(thick, size, power, outside, count, (0.5, 1.0, 0.83333))
    collided = np.sum(extinction * np.asarray(found.light), axis=(1, 2, 3))
    given = found.received + emitted.sum(axis=(1, 2, 3))
    np.testing.assert_allclose(found.escaped + collided, given, rtol=1e-12)
    assert np.all(np.asarray(found.light) >= 0)
    # Nothing in a uniform radiance changes it, whatever the direction.
    empty = sweep(0 * thick, size, 0 * power, outside, count, (0.5, 1.0, 0.83333))
    volume = np.prod(SIDES)
    np.testing.assert_allclose(empty.light / volume, inflow[:, None, None, None] + 0 * emitted)


def test_first_order_is_exact_under_the_sun():
    column = np.array([0.5, 3.0, 0.0, 1.5])
    cloud = voxel_cloud(column[None, None, :], np.zeros(3), np.array([1.0, 1.0, 2.0]))
    found = single_scattering(
        cloud, ASIDE, phase=PHASE, single_scattering_albedo=0.8, sun_irradiance=3.0
    )
    for k, extinction in enumerate(column):
        above = 0.5 * column[k + 1 :].sum()
        mean = quad(lambda s, a=above, b=extinction: math.exp(-a - b * 0.5 * s), 0, 1)[0]
        expected = 0.8 * 3.0 * PHASE(math.pi - math.acos(0.8)) * mean
        np.testing.assert_allclose(found[0, 0, k], expected, rtol=1e-12)


def test_thin_cloud_scatters_once():
    """Second order is at most the albedo times the optical depth across, 2e-6 here."""
    cloud = sphere(4, 1e-6, float)
    light = converged_light(cloud, phase=PHASE, directions=14)
    once = single_scattering(cloud, ASIDE, phase=PHASE)
    # What else there is comes by every angle, the first order by a dim one: 10 times more.
    np.testing.assert_allclose(light.source_function(ASIDE), once, rtol=2e-5)


@pytest.mark.parametrize("shape", [(4, 4, 4), (3, 5, 4)])
def test_white_cloud_in_uniform_light_is_unseen(shape):
    cloud = uneven(RANDOM.uniform(0.0, 9.0, shape))
    light = converged_light(
        cloud, phase=PHASE, sun_irradiance=0.0, incoming=2.0, directions=26, rtol=1e-10
    )
    np.testing.assert_allclose(light.source_function((0.48, -0.64, 0.6)), 2.0, rtol=1e-8)


@pytest.mark.parametrize(("dtype", "extinction"), [(F32, 5.0), (F32, 50.0), (float, 50.0)])
def test_white_cloud_gives_back_what_it_takes(dtype, extinction):
    """The issue asks for 1e-3; the residual of 1e-4 is some 1e-4 of what collides first."""
    cloud = sphere(12, extinction, dtype)
    light = converged_light(cloud, phase=af.HenyeyGreenstein(dtype(0.85)), directions=26)
    assert light.sunlight.dtype == dtype
    assert float(light.residual) <= 1e-4
    assert abs(float(light.power_error)) < 3e-4
    assert float(light.absorbed) == 0.0


def test_what_is_absorbed_is_missing():
    light = converged_light(
        uneven(),
        phase=PHASE,
        single_scattering_albedo=0.9,
        directions=26,
        rtol=1e-10,
        incoming=RANDOM.uniform(0.0, 1.0, 26),
        sun_direction=(0.0, 0.6, 0.8),
    )
    assert float(light.absorbed) > 0.01 * float(light.received)
    assert abs(float(light.power_error)) < 1e-9


def test_axes_are_alike():
    """Turning cloud, sun and eye turns the light, on grids of any shape."""
    light = converged_light(
        uneven(), phase=PHASE, directions=26, rtol=1e-11, sun_direction=(0.64, -0.6, 0.48)
    )
    turned = converged_light(
        uneven(UNEVEN.transpose(1, 2, 0), SIDES[[1, 2, 0]]),
        phase=PHASE,
        directions=26,
        rtol=1e-11,
        sun_direction=(-0.6, 0.48, 0.64),
    )
    seen, other = (
        light.source_function((0.36, 0.48, 0.8)),
        turned.source_function((0.48, 0.8, 0.36)),
    )
    np.testing.assert_allclose(other, np.transpose(seen, (1, 2, 0)), rtol=1e-8)


def test_unit_of_length_does_not_matter():
    small, large = uneven(), uneven(UNEVEN / 1e3, SIDES * 1e3)
    seen = [
        converged_light(cloud, phase=PHASE, directions=14, rtol=1e-11).source_function(ASIDE)
        for cloud in (small, large)
    ]
    np.testing.assert_allclose(seen[1], seen[0], rtol=1e-8)


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2, 3), has_aux=True)
def brightness(extinction, albedo, asymmetry, irradiance):
    """Of a small picture, by all that the light depends on; and the error of the power."""
    cloud = voxel_cloud(extinction, -np.ones(3), np.ones(3))
    light = converged_light(
        cloud,
        phase=af.HenyeyGreenstein(asymmetry),
        single_scattering_albedo=albedo,
        sun_irradiance=irradiance,
        incoming=0.1,
        directions=14,
        rtol=1e-4 if extinction.dtype == F32 else 1e-11,
    )
    seen = light.source_function(ASIDE)
    angle = math.acos(0.8)
    picture = view(cloud, seen, sun_angle=angle, width=4, extent=3.0, rays=1).radiance
    return jnp.sum(picture), light.power_error


def test_slopes_are_those_of_differences():
    extinction = jnp.asarray(RANDOM.uniform(0.2, 3.0, (3, 3, 3)))
    values = (extinction, jnp.asarray(0.95), jnp.asarray(0.7), jnp.asarray(2.0))
    _, slopes = brightness(*values)
    for k, (value, slope) in enumerate(zip(values, slopes, strict=True)):
        for place in [(0, 1, 2), (2, 2, 2)] if value.ndim else [()]:
            low, high = (
                brightness(*values[:k], value.at[place].add(step), *values[k + 1 :])[0][0]
                for step in (-1e-5, 1e-5)
            )
            np.testing.assert_allclose(slope[place], (high - low) / 2e-5, rtol=1e-6)


@pytest.mark.parametrize("dtype", [F32, float])
def test_extremes_stay_finite(dtype):
    share = RANDOM.uniform(0.0, 1.0, (3, 3, 3))
    share[0] = 0.0
    for extinction, *others in itertools.product(
        (0.0, 5e-7, 5.0, 5e3), (0.0, 1.0), (0.0, 0.85, 0.99)
    ):
        values = (extinction * share, *others, 1.0)
        (value, error), slopes = brightness(*(jnp.asarray(x, dtype) for x in values))
        assert all(np.all(np.isfinite(x)) for x in (value, *slopes)), values
        assert abs(float(error)) < 1e-3, values


def test_impossible_arguments_are_refused():
    wrong: dict[str, Any]
    for wrong, words in (
        ({"directions": 20}, "directions"),
        ({"single_scattering_albedo": 1.1}, "single_scattering_albedo"),
        ({"sun_direction": (0.0, 1.0, 1.0)}, "length of sun_direction"),
        ({"incoming": -1.0}, "incoming"),
        ({"rtol": 0.0}, "rtol"),
    ):
        with pytest.raises(ValueError, match=words):
            converged_light(uneven(), phase=PHASE, **wrong)


@pytest.fixture(scope="module")
def sphere_light():
    return converged_light(sphere(32), phase=af.HenyeyGreenstein(F32(0.85)))


@pytest.mark.reference
@pytest.mark.slow
@needs(NPZ)
@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 120, 150])
def test_sphere_agrees_with_another_path_tracer(degrees, sphere_light):
    """Not into the sun: there the steps of the rim count. 18 % with 4 rays a pixel; with 64 and 96
    voxels an edge 9 and 4.6 %."""
    with np.load(data_folder() / "reference" / NPZ) as file:
        radiance = blocks(file[f"sun_angle_{degrees}"])
    seen = sphere_light.view(sun_angle=F32(math.radians(degrees)))
    assert relative(blocks(seen.radiance), radiance) < 0.05  # seen: 0.018 to 0.039


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sphere", "balls"])
def test_agrees_with_own_path_tracer_on_the_same_voxels(kind, sphere_light):
    phase = af.HenyeyGreenstein(F32(0.85))
    if kind == "sphere":
        cloud, light, degrees = sphere(32), sphere_light, (150, 180)
    else:
        cloud = balls(32, 10.0)
        light, degrees = converged_light(cloud, phase=phase), (60, 150)
    for angle in np.radians(np.array(degrees, F32)):
        traced = path_trace(cloud, phase=phase, sun_angle=angle, samples=400, seed=3)
        found, expected = blocks(light.view(sun_angle=angle, rays=4).radiance), traced.radiance
        noise = np.mean(blocks(traced.standard_error**2)) / 64
        wrong = np.mean((found - blocks(expected)) ** 2) - noise
        assert wrong < 0.05**2 * np.mean(blocks(expected) ** 2)
