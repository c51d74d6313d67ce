"""First scattering of the light of sky and ground in a cloud, by elements of the sky.

The sphere is cut into the meshes of a cube's faces, an element each. An element has one radiance
and, at each voxel, one transmittance, along the direction of its middle; the phase function is
integrated over it, for its peak is narrower than an element. Stored are optical depths, never
transmittances: of those, the paper's quotient of two is 0 / 0 in a thick cloud.

References:
    Nishita, Dobashi and Nakamae (1996), SIGGRAPH '96, 379, section 3.5.
"""

import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.checks import in_range
from atmofit.clouds.depths import reaching, unit_vector
from atmofit.clouds.pattern_light import phase_toward
from atmofit.clouds.volume import Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, extremes
from atmofit.optics.phase import CornetteShanks, PhaseFunction
from atmofit.typing import Reals, RealsLike, real_array

MESHES = (1, 2, 3, 4, 6, 8)  # along the edge of a face, tried one after the other
_FINE = 48  # parts of a face's edge over which a phase function is integrated
_BRIGHTEST = 1e12


class SkyLight(eqx.Module):
    """What `refined_sky_light` finds.

    Attributes:
        source_function: Radiance that each voxel scatters toward the eye, per optical depth,
            [wavelength axes, x, y, z].
        elements: How many the sky was cut into.
        change: By the last refinement, over the largest value [-].
    """

    source_function: Float[Array, "*w x y z"]
    elements: int = eqx.field(static=True)
    change: float = eqx.field(static=True)


def sky_elements(mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Elements of the whole sphere: 6 for a mesh of 1, along the axes, 24 for one of 2.

    Args:
        mesh: Parts of the edge of each of a cube's faces, 1 to 48.

    Returns:
        Unit vectors from the cloud to the elements' middles, [element, 3], and solid angles [sr],
        which add to 4 pi.

    Raises:
        ValueError: The mesh is too coarse or too fine.
    """
    if not 1 <= mesh <= _FINE:
        raise ValueError(f"mesh must be 1 to {_FINE}, got {mesh}")
    return _cube(mesh)


def sky_light(
    cloud: VoxelCloud,
    sky_radiance: RealsLike,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    view_direction: RealsLike,
    wavelength_nm: RealsLike = 550.0,
    elements: tuple[int, ...] | None = None,
) -> Float[Array, "*w x y z"]:
    """Source function of light from all around after one scattering.

    Args:
        cloud: On a grid of voxels.
        sky_radiance: From each of the elements of `sky_elements`, [element, wavelength axes], at
            least 0; see `with_ground` for those below the horizon.
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        view_direction: Unit vector from the cloud to the eye, 3 numbers.
        wavelength_nm: Where the phase function is taken [nm].
        elements: Numbers of those that count, see `plan_cloud`; None: all.

    Returns:
        Radiance scattered toward the eye per optical depth, in the unit of the sky's radiance,
        [wavelength axes, x, y, z].

    Raises:
        ValueError: A known argument is out of range, or the number of elements is not 6 mesh^2.
    """
    cloud, phase = cloud.checked(), phase.checked()
    dtype = cloud.extinction_coefficient.dtype
    phase = jax.tree.map(lambda leaf: leaf.astype(dtype), phase)
    radiance = in_range("sky_radiance", sky_radiance, 0.0, _BRIGHTEST).astype(dtype)
    count = 6 * _mesh_of(radiance) ** 2
    if elements is not None and not set(elements) <= set(range(count)):
        raise ValueError(f"elements must be numbers below {count}, got {elements}")
    chosen = np.arange(count) if elements is None else np.array(elements, int)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0).astype(dtype)
    view = unit_vector("view_direction", view_direction).astype(dtype)
    wavelength = real_array(wavelength_nm).astype(dtype).reshape(1)
    numbers = jnp.asarray(chosen, jnp.int32)
    return albedo * _lit(cloud, radiance, phase, wavelength, view, numbers)


extremes(
    Case("empty", {"extinction_coefficient": 0.0, "radiance": 2.0}, limit=2.0),
    Case("dense", {"extinction_coefficient": 1e6}),
    call=lambda extinction_coefficient, radiance, asymmetry: sky_light(
        voxel_cloud(extinction_coefficient.reshape(1, 1, 1), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        jnp.broadcast_to(radiance, (6,)),
        phase=CornetteShanks(asymmetry),
        view_direction=(0.0, 0.0, 1.0),
    )[0, 0, 0],
    extinction_coefficient=Domain(0.0, 1e6),
    radiance=Domain(0.0, _BRIGHTEST),
    asymmetry=Domain(-0.999, 0.999),
)(sky_light)


def with_ground(
    sky_radiance: RealsLike,
    albedo: RealsLike,
    *,
    sun_direction: RealsLike = (0.0, 0.0, 1.0),
    sun_irradiance: RealsLike = 0.0,
) -> Reals:
    """Let the ground send up what sky and sun send down, evenly: upward sky light.

    Args:
        sky_radiance: From each of the elements of `sky_elements`, [element, wavelength axes], z
            being up. What is given below the horizon is taken as black.
        albedo: Of the ground [-], 0 to 1, a number or of the shape of the wavelength axes.
        sun_direction: Unit vector to the sun, 3 numbers.
        sun_irradiance: Across the sun's rays at the ground, a number or [wavelength axes].

    Returns:
        Radiance of the same shape; elements cut by the horizon have a mean of both sides.

    Raises:
        ValueError: A known argument is out of range.
    """
    sky = in_range("sky_radiance", sky_radiance, 0.0, _BRIGHTEST)
    share = in_range("albedo", albedo, 0.0, 1.0).astype(sky.dtype)
    beam = in_range("sun_irradiance", sun_irradiance, 0.0, _BRIGHTEST).astype(sky.dtype)
    sun = unit_vector("sun_direction", sun_direction).astype(sky.dtype)
    above, level = (jnp.asarray(values, sky.dtype) for values in _horizon(_mesh_of(sky)))
    above = above.reshape(-1, *(1,) * (sky.ndim - 1))
    irradiance = jnp.tensordot(level, sky, 1) + beam * jnp.maximum(sun[2], 0.0)
    return above * sky + (1 - above) * (share * irradiance / math.pi)[None]


extremes(
    Case("black", {"albedo": 0.0, "radiance": 1.0}, limit=0.0),
    Case("white under an even sky", {"albedo": 1.0, "radiance": 3.0, "irradiance": 0.0}, 3.0),
    call=lambda radiance, albedo, irradiance: with_ground(
        jnp.broadcast_to(radiance, (24,)), albedo, sun_irradiance=irradiance
    )[16],  # straight down
    radiance=Domain(0.0, _BRIGHTEST),
    albedo=Domain(0.0, 1.0),
    irradiance=Domain(0.0, _BRIGHTEST),
)(with_ground)


def refined_sky_light(
    cloud: VoxelCloud,
    sky: Callable[[Float[Array, "element 3"]], Reals],
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    view_direction: RealsLike,
    rtol: float = 0.02,
    wavelength_nm: RealsLike = 550.0,
) -> SkyLight:
    """Cut the sky into more elements until the light no longer changes; outside of jit.

    Args:
        cloud: On a grid of voxels.
        sky: Radiance from unit vectors, [element, wavelength axes].
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        view_direction: Unit vector from the cloud to the eye, 3 numbers.
        rtol: Largest change allowed, over the largest value.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The light, and the elements it took: 384 at most.

    Raises:
        ValueError: An argument is out of range.
    """

    def by(mesh: int) -> Reals:
        directions, _ = sky_elements(mesh)
        return sky_light(
            cloud,
            sky(jnp.asarray(directions, cloud.extinction_coefficient.dtype)),
            phase=phase,
            single_scattering_albedo=single_scattering_albedo,
            view_direction=view_direction,
            wavelength_nm=wavelength_nm,
        )

    mesh, found, change = MESHES[0], by(MESHES[0]), math.inf
    for finer in MESHES[1:]:
        if change <= rtol:
            break
        before, mesh, found = found, finer, by(finer)
        largest = float(jnp.max(jnp.abs(found)))
        change = float(jnp.max(jnp.abs(found - before))) / max(largest, 1e-30)
    return SkyLight(found, 6 * mesh**2, change)


@eqx.filter_jit
def _lit(
    cloud: VoxelCloud,
    radiance: Reals,
    phase: PhaseFunction,
    wavelength: Float[Array, "1"],
    view: Vector,
    numbers: Int[Array, " kept"],
) -> Float[Array, "*w x y z"]:
    """The kernel of `sky_light`, element by element."""
    mesh = _mesh_of(radiance)
    directions, _ = _cube(mesh)
    shares = element_shares(phase, wavelength, view, mesh)
    wavelengths = radiance.shape[1:]
    flat = radiance.reshape(radiance.shape[0], -1)

    def light(element: tuple[Vector, Reals]) -> Reals:
        toward, bright = element
        return bright[:, None, None, None] * reaching(cloud, toward)[None]

    def step(total: Reals, element: tuple[Vector, Reals]) -> tuple[Reals, None]:
        return total + jax.checkpoint(light)(element), None

    grid = cloud.extinction_coefficient
    start = jnp.zeros((flat.shape[1], *grid.shape), grid.dtype)
    sources = (jnp.asarray(directions, grid.dtype)[numbers], (flat * shares[:, None])[numbers])
    total, _ = jax.lax.scan(step, start, sources)
    return total.reshape(*wavelengths, *grid.shape)


def element_shares(
    phase: PhaseFunction, wavelength: Float[Array, "1"], view: Vector, mesh: int
) -> Float[Array, " element"]:
    """Phase function between each element and the eye, integrated; they add to 1."""
    directions, angles, owner = _parts(mesh)
    fine = jnp.asarray(directions, view.dtype)
    values = jax.vmap(lambda from_: phase_toward(phase, wavelength, -from_, view))(fine)
    each = values * jnp.asarray(angles, view.dtype)
    summed = jnp.zeros(6 * mesh**2, view.dtype).at[jnp.asarray(owner)].add(each)
    return summed / jnp.sum(summed)


def _mesh_of(radiance: Reals) -> int:
    """Parts of a face's edge, from the number of elements."""
    count = radiance.shape[0] if radiance.ndim else 0
    mesh = math.isqrt(count // 6)
    if not 1 <= mesh <= _FINE or 6 * mesh**2 != count:
        raise ValueError(f"the number of elements must be 6 mesh^2, got the shape {radiance.shape}")
    return mesh


@functools.cache
def _cube(mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Meshes of a cube's faces: directions of the middles, and solid angles [sr]."""
    edges = np.linspace(-1.0, 1.0, mesh + 1)
    # Solid angle of the rectangle from a face's middle to a corner (x, y), with signs.
    x, y = np.meshgrid(edges, edges, indexing="ij")
    corner = np.arctan2(x * y, np.sqrt(1 + x**2 + y**2))
    angle = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    middle = (edges[1:] + edges[:-1]) / 2
    x, y = (values.reshape(-1) for values in np.meshgrid(middle, middle, indexing="ij"))
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = np.stack([x, y], -1)
            faces.append(np.insert(face, axis, sign, axis=1))
    vectors = np.concatenate(faces)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / length, np.tile(angle.reshape(-1), 6)


@functools.cache
def _parts(mesh: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Small parts of all elements: directions, solid angles [sr], and the element's number."""
    fine = mesh * -(-_FINE // mesh)
    directions, angles = _cube(fine)
    row, column = np.divmod(np.arange(fine**2), fine)
    within = (row * mesh // fine) * mesh + column * mesh // fine
    owner = (np.arange(6)[:, None] * mesh**2 + within[None, :]).reshape(-1)
    # JAX remembers a kept array's type in double precision: 32 bits serve both precisions.
    return directions, angles, owner.astype(np.int32)


@functools.cache
def _horizon(mesh: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each element the share above the horizon, and the irradiance below for radiance 1 [sr]."""
    directions, angles, owner = _parts(mesh)
    z, count = directions[:, 2], 6 * mesh**2
    level = np.bincount(owner, angles * np.maximum(z, 0.0), count)
    above = np.bincount(owner, angles * (z > 0), count) / np.bincount(owner, angles, count)
    # Of an even sky of radiance 1, the irradiance is pi.
    return above, level * (math.pi / level.sum())
