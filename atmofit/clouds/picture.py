"""A cloud in front of the sky, seen through the air between."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import choice, in_range
from atmofit.clouds.glow import METHODS, Droplets, Glow, converged_glow, pattern_glow
from atmofit.clouds.plan import CloudPlan, plan_cloud
from atmofit.clouds.smooth_march import march_smoothly, packed
from atmofit.clouds.surroundings import Surroundings
from atmofit.clouds.volume import Vector, VoxelCloud
from atmofit.landscape.picture import Light, Picture, sky_behind, sunlight_weights
from atmofit.landscape.view import View
from atmofit.media.path_plan import DEFAULT_PLAN, PathPlan
from atmofit.media.transfer import Path, along
from atmofit.numerics import safe_divide
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_FARTHEST = 3e5  # at which a ray that points below the horizon meets the ground, at most [m]
_TILE, _BLOCK = 16384, 2048  # rays of a tile, and under way at a time
_STEPS = 2  # of a ray for each voxel along the longest axis


class Rays(eqx.Module):
    """A picture's lines of sight: east, north and up from the eye.

    Attributes:
        directions: Unit vectors, [ray, 3].
        share: Of the four corners of what shows the cloud, [ray, 4].
        eye: Place of the eye [m].
    """

    directions: Float[Array, "ray 3"]
    share: Float[Array, "ray 4"]
    eye: Vector


def render_cloud(
    cloud: VoxelCloud,
    view: View,
    surroundings: Surroundings,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    method: str = "converged",
    directions: int = 50,
    rtol: float = 1e-3,
    orders: int = 3,
    most: int = 400,
    wavelength_nm: RealsLike = 550.0,
    plan: PathPlan = DEFAULT_PLAN,
    cloud_plan: CloudPlan | None = None,
    tell: Callable[[str], None] = lambda stage: None,
) -> Picture:
    """Render the picture: cloud, the sky or the level ground behind it, and the air before it.

    The cloud's own shadow in the air and on the ground is left out.

    Args:
        cloud: Its axes are east, north and altitude [m].
        view: The camera, over level ground at altitude 0.
        surroundings: Sun, sky, ground and air.
        phase: Of the droplets.
        single_scattering_albedo: Of the droplets, 0 to 1 [-].
        method: "converged": all orders, see `converged_light`; "pattern": as in 1996, the sun's
            light by `pattern_light`, that of sky and ground after one scattering. Static.
        directions: Of `converged_light`. Static.
        rtol: Likewise. Static.
        orders: Of `pattern_light`, 1 to 3. Static.
        most: Paths of each order, likewise. Static.
        wavelength_nm: Where the phase function is taken [nm].
        plan: Of the air before the cloud, see `plan_path`. Static.
        cloud_plan: What is left out, see `plan_cloud`; None: what it finds for this picture.
        tell: Called with the name of each stage, and of each tile, as it begins, and with all
            that is left out.

    Returns:
        The picture; its distance is to where the cloud's light comes from, or to the ground.

    Raises:
        ValueError: A known argument is out of range.
    """
    choice("method", method, METHODS)
    if cloud_plan is None:
        cloud_plan = plan_cloud(
            cloud,
            view,
            surroundings,
            phase=phase,
            single_scattering_albedo=single_scattering_albedo,
            method=method,
            orders=orders,
            wavelength_nm=wavelength_nm,
        )
    for line in cloud_plan.left_out:
        tell(f"left out: {line}")
    cloud = cloud_plan.cropped(cloud.checked())
    view, phase = view.checked(), phase.checked()
    dtype = cloud.extinction_coefficient.dtype
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    surroundings = jax.tree.map(lambda leaf: leaf.astype(dtype), surroundings)
    rays, hit = _rays(cloud, view)
    corners = _corners(rays, hit, view)
    wavelength = real_array(wavelength_nm).astype(dtype).reshape(1)
    droplets = Droplets(phase, albedo.astype(dtype), wavelength)
    scene = (cloud, surroundings, -corners, droplets)
    tell(f"light inside: {method}")
    if method == "converged":
        glow = converged_glow(*scene, directions=directions, rtol=rtol, sources=cloud_plan.sources)
    else:
        orders, kept = cloud_plan.orders, cloud_plan.elements
        glow = pattern_glow(*scene, orders=orders, most=most, kept=kept)
    light = surroundings.light
    tell("sky")
    behind, distance = (np.array(x) for x in _behind(light, rays.directions, rays.eye[2], plan))
    through = np.flatnonzero(hit)
    for number, first in enumerate(range(0, through.size, _TILE)):
        tell(f"tile {number + 1} of {-(-through.size // _TILE)}")
        # The last tile is filled up, so that all are of one shape and one program.
        tile = through[np.minimum(np.arange(first, first + _TILE), through.size - 1)]
        some = Rays(rays.directions[tile], rays.share[tile], rays.eye)
        seen, way = _through_cloud(glow, light, some, jnp.asarray(behind[tile]), plan)
        behind[tile], distance[tile] = np.asarray(seen), np.asarray(way)
    weights = sunlight_weights(tuple(np.asarray(light.air.wavelength_nm, float).tolist()))
    shape = (view.rows, view.columns)
    return Picture((behind @ weights).reshape(*shape, 3), distance.reshape(shape))


def _rays(cloud: VoxelCloud, view: View) -> tuple[Rays, np.ndarray]:
    """All lines of sight, row by row, and which of them meet the cloud's box."""
    dtype = cloud.extinction_coefficient.dtype
    azimuth, slope = (np.asarray(x, float) for x in view.rays(jnp.arange(view.columns)))
    level = 1 / np.sqrt(1 + slope.T**2)
    directions = np.stack(
        [level * np.sin(azimuth), level * np.cos(azimuth), level * slope.T], axis=-1
    ).reshape(-1, 3)
    eye = np.array([view.east, view.north, view.above_ground], float)
    moving = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    one, other = ((np.asarray(end, float) - eye) / moving for end in (cloud.low, cloud.high))
    near, far = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
    hit = (far > near) & (far > 0)
    row, column = np.divmod(np.arange(hit.size), view.columns)
    share = np.full((hit.size, 4), 0.25)
    if hit.any():
        parts = []
        for place in (row, column):
            first, last = place[hit].min(), place[hit].max()
            parts.append(np.clip((place - first) / max(last - first, 1), 0.0, 1.0))
        down, right = parts
        share = np.stack([a * b for a in (1 - down, down) for b in (1 - right, right)], axis=-1)
    arrays = (jnp.asarray(x, dtype) for x in (directions, share, eye))
    return Rays(*arrays), hit


def _corners(rays: Rays, hit: np.ndarray, view: View) -> Float[Array, "4 3"]:
    """Lines of sight at the corners of what shows the cloud."""
    row, column = np.divmod(np.flatnonzero(hit if hit.any() else ~hit), view.columns)
    ends = [(r, c) for r in (row.min(), row.max()) for c in (column.min(), column.max())]
    return rays.directions[np.array([r * view.columns + c for r, c in ends])]


def _azimuths(light: Light, directions: Float[Array, "ray 3"]) -> tuple[Reals, Reals]:
    """View zenith angles and azimuths from the sun [rad]."""
    level = jnp.sqrt(directions[:, 0] ** 2 + directions[:, 1] ** 2)
    zenith = jnp.arctan2(level, directions[:, 2])
    return zenith, jnp.arctan2(directions[:, 0], directions[:, 1]) - light.solar_azimuth


@eqx.filter_jit
def _behind(
    light: Light, directions: Float[Array, "ray 3"], altitude: Scalar, plan: PathPlan
) -> tuple[Float[Array, "ray w"], Float[Array, " ray"]]:
    """Radiance where there is no cloud: sky and sun, or level ground through the air; distances."""
    zenith, azimuth = _azimuths(light, directions)
    sky = sky_behind(light, zenith, azimuth)
    down = jnp.maximum(-directions[:, 2], 0.0)
    distance = altitude / jnp.maximum(down, altitude / _FARTHEST)
    ground = jnp.broadcast_to(light.around.ground_radiance, sky.shape)
    air = _air(light, distance, zenith, azimuth, altitude, plan)
    below = directions[:, 2] < 0
    seen = jnp.where(below[:, None], ground * air[0] + air[1], sky)
    return seen, jnp.where(below, distance, jnp.inf)


def _air(
    light: Light, distance: Reals, zenith: Reals, azimuth: Reals, altitude: Scalar, plan: PathPlan
) -> tuple[Float[Array, "ray w"], Float[Array, "ray w"]]:
    """Transmittance of the air over some distances, and the light that it adds."""
    path = Path(distance, zenith, jnp.broadcast_to(altitude, distance.shape))
    passing, integrals = along(light.air, path, plan)
    source = light.around.toward(light.air, zenith, azimuth)
    return passing.T, jnp.sum(source * jnp.moveaxis(integrals, -1, 0), axis=-2)


@eqx.filter_jit
def _through_cloud(
    glow: Glow, light: Light, rays: Rays, behind: Float[Array, "ray w"], plan: PathPlan
) -> tuple[Float[Array, "ray w"], Float[Array, " ray"]]:
    """Radiance of the rays that meet the cloud's box, and how far its light comes."""
    away = _distance_of_voxels(glow.cloud, rays.eye)
    fields = jnp.concatenate([glow.fields, away[None], jnp.ones_like(away)[None]])
    values = packed(glow.cloud.extinction_coefficient, fields)
    steps = _STEPS * max(away.shape)

    def one(direction: Vector) -> tuple[Reals, Scalar]:
        found = march_smoothly(glow.cloud, values, rays.eye, direction, steps)
        return found.radiance, found.transmittance

    gathered, passed = jax.lax.map(one, rays.directions, batch_size=_BLOCK)
    spectra = glow.spectra(-rays.directions, rays.share)
    own = jnp.einsum("rk,rkw->rw", gathered[:, :-2], spectra)
    opacity = gathered[:, -1]
    distance = safe_divide(gathered[:, -2], opacity)
    zenith, azimuth = _azimuths(light, rays.directions)
    transmittance, added = _air(light, distance, zenith, azimuth, rays.eye[2], plan)
    seen = own * transmittance + opacity[:, None] * added + passed[:, None] * behind
    return seen, jnp.where(opacity > 1 / math.e, distance, jnp.inf)


def _distance_of_voxels(cloud: VoxelCloud, eye: Vector) -> Float[Array, "x y z"]:
    """From the eye to the middle of each voxel [m]."""
    count = cloud.extinction_coefficient.shape
    size = (cloud.high - cloud.low) / jnp.asarray(count, eye.dtype)
    axes = [
        low + (jnp.arange(n, dtype=eye.dtype) + 0.5) * step - here
        for n, low, step, here in zip(count, cloud.low, size, eye, strict=True)
    ]
    x, y, z = jnp.meshgrid(*axes, indexing="ij")
    return jnp.sqrt(x**2 + y**2 + z**2)
