"""Rays through a grid of voxels, voxel by voxel: exact where all is constant in each."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.clouds.volume import LARGEST_LENGTH, Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, extremes
from atmofit.numerics import mean_decay
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_LEVEL = 1e-15  # a component of a direction that counts as none
_BLOCK = 4096  # rays under way at a time


class Marched(eqx.Module):
    """What a ray meets.

    Attributes:
        radiance: Of each source function, [source axes].
        transmittance: Share of the light from behind that passes [-].
    """

    radiance: Float[Array, "*source"]
    transmittance: Scalar


def march(
    cloud: VoxelCloud,
    source_function: Float[Array, "*source x y z"],
    origin: Vector,
    direction: Vector,
) -> Marched:
    """Radiance that one ray gathers; vmap it for many.

    Args:
        cloud: What the ray goes through.
        source_function: Radiance that is scattered toward the eye in each voxel, per optical depth.
        origin: The eye [m], inside the cloud or outside; what lies behind it does not count.
        direction: Unit vector from the eye.

    Returns:
        The integral of source function times transmittance over optical depth, and the
        transmittance of the whole way. No light: radiance 0, transmittance 1.
    """
    count = cloud.extinction_coefficient.shape
    n = jnp.asarray(count)
    size = (cloud.high - cloud.low) / n.astype(origin.dtype)
    # The slopes of what is divided by less would overflow.
    level = jnp.abs(direction) < _LEVEL
    moving, direction = jnp.where(level, _LEVEL, direction), jnp.where(level, 0.0, direction)
    near, far = cloud.crossing(origin, direction)
    near = jnp.maximum(near, 0.0)
    stride = jnp.where(moving < 0, -1, 1)
    entry = (origin + near * direction - cloud.low) / size
    place = jnp.clip(jnp.floor(entry).astype(n.dtype), 0, n - 1)
    sources = source_function.reshape(-1, math.prod(count)).T
    thickness = cloud.extinction_coefficient.reshape(-1)

    def step(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], None]:
        place, here, passed, radiance = carry
        ahead = (place + jnp.where(stride > 0, 1, 0)).astype(origin.dtype)
        walls = (cloud.low + ahead * size - origin) / moving
        wall = jnp.argmin(walls)
        there = jnp.clip(walls[wall], here, jnp.maximum(far, here))
        inside = jnp.all((place >= 0) & (place < n))
        x, y, z = jnp.clip(place, 0, n - 1)
        voxel = (x * count[1] + y) * count[2] + z
        depth = jnp.where(inside, thickness[voxel] * (there - here), 0.0)
        gained = passed * depth * mean_decay(depth)
        radiance = radiance + gained * sources[voxel]
        place = place + jnp.where(jnp.arange(3) == wall, stride, 0)
        return (place, there, passed * jnp.exp(-depth), radiance), None

    start = (place, near, jnp.ones_like(near), jnp.zeros_like(sources[0]) + 0 * near)
    (_, _, passed, radiance), _ = jax.lax.scan(step, start, None, length=sum(count))
    return Marched(radiance.reshape(source_function.shape[:-3]), passed)


class Viewed(eqx.Module):
    """A picture by marching.

    Attributes:
        radiance: [source axes, up, right], the top row first.
        transmittance: [up, right] [-].
    """

    radiance: Float[Array, "*source up right"]
    transmittance: Float[Array, "up right"]


def view(
    cloud: VoxelCloud,
    source_function: RealsLike,
    *,
    sun_angle: RealsLike,
    width: int = 48,
    extent: RealsLike = 4.0,
    rays: int = 2,
) -> Viewed:
    """A picture in parallel rays, of the same place as that of `path_trace`.

    Args:
        cloud: A grid of voxels.
        source_function: [source axes, x, y, z]: radiance that is scattered toward the sensor, per
            optical depth.
        sun_angle: Between the directions to the sensor and +z, toward +x, 0 to pi [rad].
        width: Pixels in both directions.
        extent: Width of the picture, in the cloud's unit [m].
        rays: Of each pixel, in both directions.

    Returns:
        Averages over the pixels' rays.

    Raises:
        ValueError: A known argument is out of range, or the shapes do not fit.
    """
    cloud = cloud.checked()
    dtype = cloud.extinction_coefficient.dtype
    sources = real_array(source_function).astype(dtype)
    angle = angle_in_range("sun_angle", sun_angle, 0.0, math.pi).astype(dtype)
    size = in_range("extent", extent, 1e-6, LARGEST_LENGTH, "m").astype(dtype)
    if sources.shape[-3:] != cloud.extinction_coefficient.shape:
        raise ValueError(
            "source_function must end with the cloud's axes "
            f"{cloud.extinction_coefficient.shape}, got the shape {sources.shape}"
        )
    if width < 1 or rays < 1:
        raise ValueError(f"width and rays must be >= 1, got {width} and {rays}")
    return _viewed(cloud, sources, angle, size, width, rays)


def sensor_direction(sun_angle: Scalar) -> Vector:
    """Unit vector from the cloud to the sensor of `view` and `path_trace`."""
    return jnp.stack([jnp.sin(sun_angle), jnp.zeros_like(sun_angle), jnp.cos(sun_angle)])


@eqx.filter_jit
def _viewed(
    cloud: VoxelCloud, sources: Reals, angle: Scalar, extent: Scalar, width: int, rays: int
) -> Viewed:
    """The kernel of `view`, block by block."""
    to_sensor = sensor_direction(angle)
    right = jnp.stack([jnp.cos(angle), jnp.zeros_like(angle), -jnp.sin(angle)])
    across = width * rays
    step = (jnp.arange(across, dtype=angle.dtype) + 0.5) / across - 0.5
    middle = (cloud.low + cloud.high) / 2
    back = jnp.sum(jnp.abs(cloud.high - cloud.low)) + jnp.sum(jnp.abs(middle))

    def one(number: Array) -> Marched:
        to_right, upward = step[number % across] * extent, -step[number // across] * extent
        zero = jnp.zeros_like(upward)
        origin = to_right * right + jnp.stack([zero, upward, zero]) + back * to_sensor
        return march(cloud, sources, origin, -to_sensor)

    found = jax.lax.map(one, jnp.arange(across**2), batch_size=min(_BLOCK, across**2))

    def pixels(values: Reals) -> Reals:
        shape = (width, rays, width, rays)
        return jnp.mean(values.reshape(*shape, *values.shape[1:]), axis=(1, 3))

    return Viewed(
        jnp.moveaxis(pixels(found.radiance), (0, 1), (-2, -1)), pixels(found.transmittance)
    )


extremes(
    Case("nothing", {"extinction": (0.0, 0.0)}, limit=(0.0, 1.0)),
    Case("thin", {"extinction": (1e-6, 1e-6)}),
    Case("thick", {"extinction": (1e6, 1e6)}, limit=(1.0, 0.0)),
    Case("one of two", {"extinction": (0.0, 1.0)}, (1 - math.exp(-1), math.exp(-1))),
    call=lambda extinction: _through(extinction),
    extinction=Domain((0.0, 0.0), (1e6, 1e6)),
)(march)


def _through(extinction: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Along two voxels of 1 m, whose source function is 1."""
    corners = ((0.0, 0.0, 0.0), (1.0, 1.0, 2.0))
    cloud = voxel_cloud(extinction[None, None, :], *corners)
    start, up = (jnp.asarray(v, extinction.dtype) for v in ((0.5, 0.5, -1.0), (0.0, 0.0, 1.0)))
    found = march(cloud, jnp.ones((1, 1, 2), extinction.dtype), start, up)
    return found.radiance, found.transmittance


extremes(
    Case("from above", {"extinction": 1.0, "sun_angle": 0.0}, limit=1 - math.exp(-2)),
    Case("from below", {"extinction": 1.0, "sun_angle": math.pi}, limit=1 - math.exp(-2)),
    Case("nothing", {"extinction": 0.0}, limit=0.0),
    call=lambda extinction, sun_angle: (
        view(
            voxel_cloud(jnp.broadcast_to(extinction, (2, 2, 2)), (-1.0,) * 3, (1.0,) * 3),
            jnp.ones((2, 2, 2), extinction.dtype),
            sun_angle=sun_angle,
            width=1,
            extent=1.0,
        ).radiance
    ),
    heavy=True,
    extinction=Domain(0.0, 1e6),
    sun_angle=Domain(0.0, math.pi),
)(view)
