"""A picture of a cloud by chance: every order of scattering, no error but noise.

Paths start at the sensor. The next collision is drawn by delta tracking (Woodcock), the first one
is forced to happen, every collision looks at the sun, some scatterings are drawn toward it, and
Russian roulette ends what carries little. All of these leave the mean as it is. As lanes of a
fixed number of paths fall free, the next paths start in them, so that no lane waits for the
longest path.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from atmofit.checks import angle_in_range, in_range
from atmofit.clouds.scatter import Scatter, scatter_of, turned, versine_between
from atmofit.clouds.volume import LARGEST_LENGTH, Cloud, Vector, homogeneous_sphere
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import RealsLike, Scalar, real_array

LANES, _FEW_LANES = 4096, 64  # paths under way at a time; at the end, when few are left
_NUMBERS = 6  # random numbers of a step
_TOWARD_SUN = 0.2  # share of the first scatterings that are drawn about the sun
_LITTLE = 0.1  # weight below which paths are put at risk
_RISK_FROM = 500  # scatterings after which all are: the chance to live falls as their inverse
_MOST_SCATTERINGS = 200_000  # a path that has lived so long is given up, and counted
_FAINT = 0.03  # transmittance below which a ray to the sun is put at risk
_MOST_PATHS = 2**30


class PathTraced(eqx.Module):
    """A picture by path tracing, with its noise.

    Attributes:
        radiance: [up, right], the top row first [1/sr], for a sun of unit irradiance.
        standard_error: Of each pixel [1/sr].
        mean: Radiance averaged over the picture [1/sr].
        mean_standard_error: Its standard error [1/sr].
        given_up: Weight of the paths that were given up after 200,000 scatterings, over the
            number of all paths [-]; 0 in all but the thickest clouds. The only bias.
    """

    radiance: Float[Array, "up right"]
    standard_error: Float[Array, "up right"]
    mean: Scalar
    mean_standard_error: Scalar
    given_up: Scalar


class _Path(eqx.Module):
    """A path under way."""

    pixel: Int[Array, ""]
    alive: Bool[Array, ""]
    position: Vector
    direction: Vector
    weight: Scalar
    scatterings: Int[Array, ""]
    lit: Bool[Array, ""]  # on the way of a ray from the position to the sun
    light_position: Vector
    light: Scalar  # what that ray has left
    total: Scalar  # radiance found so far


class _Scene(eqx.Module):
    """What all paths share."""

    cloud: Cloud
    scatter: Scatter
    albedo: Scalar
    sun: Vector
    forward: Vector  # where the sensor looks
    right: Vector
    extent: Scalar
    width: int = eqx.field(static=True)


def path_trace(
    cloud: Cloud,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    sun_angle: RealsLike,
    width: int = 48,
    extent: RealsLike = 4.0,
    samples: int = 64,
    seed: int = 0,
    wavelength_nm: RealsLike = 550.0,
) -> PathTraced:
    """Radiance of a cloud in front of black, by unbiased path tracing; without derivatives.

    The sun is in the direction +z and has unit irradiance. The sensor stands in the x-z plane, at
    the sun's angle from +z toward +x, looks at the origin in parallel rays and has +y up.

    Args:
        cloud: From `homogeneous_sphere`, `homogeneous_cube` or `voxel_cloud`, or another `Cloud`.
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        sun_angle: Between the directions to the sensor and to the sun, 0 to pi [rad]; at pi the
            sensor looks into the sun, which it does not see.
        width: Pixels in both directions.
        extent: Width of the picture, in the cloud's unit [m].
        samples: Paths of each pixel, at least 2.
        seed: Of the random numbers; with everything else equal, equal seeds give equal pictures.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The picture and its standard errors. Much of the light comes by few bright paths: where
        fewer than about a thousand paths meet the cloud, the standard error is often too small.

    Raises:
        ValueError: A known argument is out of range, or there are more than 2^30 paths.
    """
    cloud, phase = cloud.checked(), phase.checked()
    dtype = cloud.largest_extinction().dtype
    cloud, phase = jax.tree.map(lambda leaf: leaf.astype(dtype), (cloud, phase))
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    angle = angle_in_range("sun_angle", sun_angle, 0.0, math.pi)
    size = in_range("extent", extent, 1e-6, LARGEST_LENGTH, "m")
    if width < 1 or samples < 2 or samples * width**2 > _MOST_PATHS:
        raise ValueError(
            f"width must be >= 1, samples >= 2 and samples width^2 <= 2^30, got {width}, {samples}"
        )
    wavelength = real_array(wavelength_nm).astype(dtype).reshape(1)
    values = (albedo.astype(dtype), angle.astype(dtype), size.astype(dtype))
    return _traced(
        cloud, phase, wavelength, values, jnp.asarray(samples), jax.random.key(seed), width
    )


@eqx.filter_jit
def _traced(
    cloud: Cloud,
    phase: PhaseFunction,
    wavelength: Float[Array, "1"],
    values: tuple[Scalar, Scalar, Scalar],
    samples: Int[Array, ""],
    key: Key[Array, ""],
    width: int,
) -> PathTraced:
    """The kernel of `path_trace`."""
    albedo, angle, extent = values
    zero, one = jnp.zeros_like(angle), jnp.ones_like(angle)
    # At the axis the sensor's own right is still in the x-z plane.
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    scene = _Scene(
        cloud,
        scatter_of(phase, wavelength),
        albedo,
        sun=jnp.stack([zero, zero, one]),
        forward=-jnp.stack([sine, zero, cosine]),
        right=jnp.stack([cosine, zero, -sine]),
        extent=extent,
        width=width,
    )
    sums, given_up = _all_paths(scene, samples * width**2, key)
    known = sum(jnp.sum(0 * leaf) for leaf in jax.tree.leaves((cloud, phase, values)))
    return _picture(sums + known, given_up, samples.astype(zero.dtype), width)


def _picture(
    sums: Float[Array, "pixel 2"], given_up: Scalar, samples: Scalar, width: int
) -> PathTraced:
    """Mean and standard error from the sums of the paths' radiances and of their squares."""
    mean, mean_square = jnp.moveaxis(sums / samples, -1, 0)
    variance = jnp.maximum(mean_square - mean**2, 0.0) / (samples - 1)
    return PathTraced(
        mean.reshape(width, width),
        jnp.sqrt(variance).reshape(width, width),
        jnp.mean(mean),
        jnp.sqrt(jnp.mean(variance) / width**2),
        given_up / (samples * width**2),
    )


class _Progress(eqx.Module):
    """What the loop carries on."""

    paths: _Path  # all fields with the lanes as first axis
    started: Int[Array, ""]
    step: Int[Array, ""]
    sums: Float[Array, "pixel 2"]
    given_up: Scalar


def _all_paths(
    scene: _Scene, count: Int[Array, ""], key: Key[Array, ""]
) -> tuple[Float[Array, "pixel 2"], Scalar]:
    """Sums over the paths of each pixel: of radiance, and of its square."""
    zero = jnp.zeros_like(scene.albedo)
    nothing = jax.tree.map(lambda leaf: jnp.zeros((LANES, *leaf.shape), leaf.dtype), _no_path(zero))
    sums = jnp.zeros((scene.width**2, 2), zero.dtype)
    start = _Progress(nothing, jnp.asarray(0), jnp.asarray(0), sums, zero)

    def busy(now: _Progress) -> Bool[Array, ""]:
        return (now.started < count) | (jnp.sum(now.paths.alive) > _FEW_LANES)

    many = jax.lax.while_loop(busy, lambda now: _advance(scene, now, count, key), start)
    # The longest paths go on among themselves, else each of their steps would cost that of all.
    left = jnp.argsort(~many.paths.alive)[:_FEW_LANES]
    few = eqx.tree_at(
        lambda now: now.paths, many, jax.tree.map(lambda leaf: leaf[left], many.paths)
    )
    done = jax.lax.while_loop(
        lambda now: jnp.any(now.paths.alive), lambda now: _advance(scene, now, count, key), few
    )
    return done.sums, done.given_up


def _advance(
    scene: _Scene, now: _Progress, count: Int[Array, ""], key: Key[Array, ""]
) -> _Progress:
    """One step of every path, and new paths where there are none."""
    alive = now.paths.alive
    shape = (_NUMBERS, alive.size)
    numbers = jax.random.uniform(jax.random.fold_in(key, now.step), shape, scene.albedo.dtype)
    going, lost = jax.vmap(lambda path, u: _step(scene, path, u), (0, 1))(now.paths, numbers)
    number = now.started + jnp.cumsum(~alive) - 1
    fresh = jax.vmap(lambda n, u: _start(scene, n, u), (0, 1))(number, numbers)
    fresh = eqx.tree_at(lambda path: path.alive, fresh, fresh.alive & (number < count))
    total = jnp.where(alive & ~going.alive, going.total, 0.0)
    return _Progress(
        jax.tree.map(lambda one, other: _select(alive, one, other), going, fresh),
        jnp.minimum(now.started + jnp.sum(~alive), count),
        now.step + 1,
        now.sums.at[going.pixel].add(jnp.stack([total, total**2], axis=-1)),
        now.given_up + jnp.sum(jnp.where(alive, lost, 0.0)),
    )


def _no_path(zero: Scalar) -> _Path:
    none, no, nowhere = jnp.asarray(0), jnp.asarray(False), jnp.stack([zero] * 3)
    return _Path(none, no, nowhere, nowhere, zero, none, no, nowhere, zero, zero)


def _start(scene: _Scene, number: Int[Array, ""], u: Float[Array, " number"]) -> _Path:
    """A path from anywhere in its pixel, brought to its first collision.

    Its weight is the chance that there is one, so that no path is wasted on a thin cloud.
    """
    zero = jnp.zeros_like(scene.albedo)
    pixel = number % scene.width**2
    column, row = ((n.astype(zero.dtype)) for n in (pixel % scene.width, pixel // scene.width))
    to_right = ((column + u[0]) / scene.width - 0.5) * scene.extent
    upward = (0.5 - (row + u[1]) / scene.width) * scene.extent
    origin = to_right * scene.right + jnp.stack([zero, upward, zero])
    near, far = scene.cloud.crossing(origin, scene.forward)
    largest = scene.cloud.largest_extinction()
    way = jnp.maximum(far - near, 0.0)
    weight = -jnp.expm1(-largest * way)
    step = jnp.minimum(-jnp.log1p(-u[2] * weight) / jnp.where(largest > 0, largest, 1.0), way)
    position = origin + (near + step) * scene.forward
    path = _no_path(zero)
    changed = (pixel, weight > 0, position, scene.forward, weight, position)
    return eqx.tree_at(
        lambda p: (p.pixel, p.alive, p.position, p.direction, p.weight, p.light_position),
        path,
        changed,
    )


def _step(scene: _Scene, path: _Path, u: Float[Array, " number"]) -> tuple[_Path, Scalar]:
    """One collision, or one step of a ray to the sun; also the weight of a path given up."""
    cloud, direction = scene.cloud, path.direction
    hit = ~path.lit & (u[1] < cloud.filling(path.position))
    lit = path.lit | hit
    start = path.weight * scene.albedo * scene.scatter.value(versine_between(direction, scene.sun))
    light = jnp.where(hit, start, path.light)
    light_position = jnp.where(hit, path.position, path.light_position)
    light_position, factor, left = cloud.light_step(light_position, scene.sun, u[0])
    arrived = lit & (left | (path.lit & ~(path.light > 0)))
    light = light * factor
    faint = ~arrived & (light < _FAINT * start)
    light = jnp.where(faint, jnp.where(u[4] < 0.5, 2 * light, 0.0), light)

    scatterings = path.scatterings + arrived.astype(path.scatterings.dtype)
    scattered, ratio = _scattered(scene, direction, scatterings, u[2], u[3])
    new_direction = jnp.where(arrived, scattered, direction)
    weight = path.weight * jnp.where(arrived, scene.albedo * ratio, 1.0)
    chance = jnp.where(arrived, _chance(weight, scatterings), 1.0)
    weight = jnp.where(u[4] < chance, weight / jnp.where(chance > 0, chance, 1.0), 0.0)

    moves = arrived | ~lit
    step = jnp.where(moves, -jnp.log1p(-u[5]) / cloud.largest_extinction(), 0.0)
    position = path.position + step * new_direction
    inside = (weight > 0) & (~moves | cloud.inside(position))
    alive = inside & (scatterings < _MOST_SCATTERINGS)
    total = path.total + jnp.where(arrived, light, 0.0)
    going = lit & ~arrived
    going_on = _Path(
        path.pixel,
        alive,
        position,
        new_direction,
        weight,
        scatterings,
        going,
        light_position,
        light,
        total,
    )
    return going_on, jnp.where(inside & ~alive, weight, 0.0)


def _scattered(
    scene: _Scene, direction: Vector, scatterings: Int[Array, ""], one: Scalar, other: Scalar
) -> tuple[Vector, Scalar]:
    """A new direction, and the phase function over the density it is drawn by.

    Some are drawn about the sun instead of about the old direction: after a large turn toward
    the sun the next scattering is very bright, and a path that comes there by chance is rare.
    """
    # The shares of all scatterings multiply to a power, not to an exponential, of their number.
    share = _TOWARD_SUN / jnp.maximum(scatterings, 1).astype(one.dtype)
    to_sun = other < share
    turn = jnp.where(to_sun, other / share, (other - share) / (1 - share))
    axis = jnp.where(to_sun, scene.sun, direction)
    new = turned(axis, scene.scatter.draw(one), 2 * math.pi * turn)
    versine = versine_between(new, direction)
    density = (1 - share) * scene.scatter.density(versine) + share * scene.scatter.density(
        versine_between(new, scene.sun)
    )
    return new, scene.scatter.value(versine) / density


def _chance(weight: Scalar, scatterings: Int[Array, ""]) -> Scalar:
    """To live on. Of paths without end in a white cloud, 1 / sqrt(n) would live n scatterings."""
    n = scatterings.astype(weight.dtype)
    late = jnp.where(scatterings > _RISK_FROM, n / (n + 1), 1.0)
    return jnp.minimum(weight / _LITTLE, 1.0) * late


def _select(which: Bool[Array, " lane"], one: Array, other: Array) -> Array:
    """Lane by lane."""
    return jnp.where(which.reshape(-1, *(1,) * (one.ndim - 1)), one, other)


extremes(
    Case("nothing", {"extinction": 0.0}, limit=0.0),
    Case("black", {"single_scattering_albedo": 0.0}, limit=0.0),
    Case("thin", {"extinction": 1e-6}),
    Case("thick and white", {"extinction": 1e4, "single_scattering_albedo": 1.0}),
    Case("narrow, into the sun", {"asymmetry": 0.99, "sun_angle": math.pi}),
    Case("misses", {"radius": 1e-6}),
    call=lambda radius, extinction, asymmetry, single_scattering_albedo, sun_angle: (
        lambda traced: (traced.radiance, traced.standard_error)
    )(
        path_trace(
            homogeneous_sphere(radius=radius, extinction_coefficient=extinction),
            phase=HenyeyGreenstein(asymmetry),
            single_scattering_albedo=single_scattering_albedo,
            sun_angle=sun_angle,
            width=2,
            samples=2,
        )
    ),
    derivative="none",
    radius=Span(1e-6, 1.0),
    extinction=Span(0.0, 1e4),
    asymmetry=Domain(-0.999, 0.999),
    single_scattering_albedo=Domain(0.0, 1.0),
    sun_angle=Domain(0.0, math.pi),
    least=0.0,
)(path_trace)
