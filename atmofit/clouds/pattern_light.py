"""Light inside a cloud by one, two and three scatterings, by the reference pattern.

The pattern's paths are laid over every voxel of the cloud, as a filter is over a picture, with the
cloud's own extinction along each. What lies outside of the cloud holds nothing.

References:
    Nishita, Dobashi and Nakamae (1996), SIGGRAPH '96, 379, section 3.4.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.checks import in_range, is_traced
from atmofit.clouds.depths import Grid, sunlight_reaching, unit_vector, voxel_size
from atmofit.clouds.pattern import Paths, ReferencePattern, leg_samples, reference_pattern
from atmofit.clouds.volume import LARGEST_EXTINCTION, Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, extremes
from atmofit.optics.particle_phases import PhaseSum
from atmofit.optics.phase import CornetteShanks, PhaseFunction, Rayleigh
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_RAYLEIGH_SHARE = 0.05
_ORDERS = (1, 2, 3)


def cloud_phase(
    asymmetry: RealsLike = 0.85, rayleigh_share: RealsLike = _RAYLEIGH_SHARE
) -> PhaseSum:
    """Cloud droplets: Cornette-Shanks, and a little of Rayleigh.

    Args:
        asymmetry: Cornette's and Shanks's parameter g, -0.999 to 0.999.
        rayleigh_share: Rayleigh's part of the scattered light [-], 0 to 1.

    Returns:
        The mixture.

    Raises:
        ValueError: A known argument is out of range.
    """
    share = in_range("rayleigh_share", rayleigh_share, 0.0, 1.0)
    return PhaseSum(
        jnp.stack([1 - share, share]), (CornetteShanks(asymmetry).checked(), Rayleigh())
    )


extremes(
    Case("Rayleigh's alone", {"share": 1.0, "angle": 0.0}, limit=6 / (16 * math.pi)),
    Case("none of it", {"share": 0.0, "asymmetry": 0.5, "angle": 0.0}, 18 / 2.25 / (4 * math.pi)),
    call=lambda asymmetry, share, angle: cloud_phase(asymmetry, share)(angle),
    asymmetry=Domain(-0.999, 0.999),
    share=Domain(0.0, 1.0),
    angle=Domain(0.0, math.pi),
)(cloud_phase)


class PatternLight(eqx.Module):
    """Light scattered toward the eye, order by order.

    Attributes:
        source_function: Radiance that each voxel scatters toward the eye, per optical depth, for a
            sun of unit irradiance [1/sr], [order, x, y, z].
        paths: Kept of each order from the second.
        shares: What they bring of their order's light in the sample space [-].
    """

    source_function: Float[Array, "order x y z"]
    paths: tuple[int, ...] = eqx.field(static=True)
    shares: tuple[float, ...] = eqx.field(static=True)

    @property
    def total(self) -> Grid:
        """Source function of all orders that were asked for."""
        return jnp.sum(self.source_function, axis=0)


class _Legs(eqx.Module):
    """Paths that need as many samples, ready for the filter.

    Attributes:
        factor: See `Paths`.
        samples: Voxels from the path's end at the eye to the samples of each leg's extinction.
        ways: Way of each sample of a leg [m]; that in the leg's first voxel is the first.
        ends: Voxels to the far end of each leg.
        chords: Way in a leg's last voxel [m].
        reach: Voxels that a path leads away at most, along each axis.
    """

    factor: Float[Array, "*path"]
    samples: Int[Array, "*path leg sample 3"]
    ways: Float[Array, "*path leg sample_"]
    ends: Int[Array, "*path leg 3"]
    chords: Float[Array, "*path leg"]
    reach: tuple[int, int, int] = eqx.field(static=True)


def pattern_light(
    cloud: VoxelCloud,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    sun_direction: RealsLike = (0.0, 0.0, 1.0),
    view_direction: RealsLike,
    orders: int = 3,
    pattern: ReferencePattern | None = None,
    share: float = 0.9,
    most: int = 400,
    wavelength_nm: RealsLike = 550.0,
) -> PatternLight:
    """Sunlight scattered up to three times in a cloud, toward one eye.

    Derivatives are those with the pattern held: by the extinction and the albedo, for the first
    order also by the phase function and the sun's direction.

    Args:
        cloud: On a grid of voxels.
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        sun_direction: Unit vector to the sun, 3 numbers.
        view_direction: Unit vector from the cloud to the eye.
        orders: Of scattering, 1 to 3; the program has no others.
        pattern: From `reference_pattern` for the same voxels, phase function and directions;
            None: made here from the average extinction of the voxels that hold anything.
        share: Of each order's light, see `reference_pattern`.
        most: Paths kept of each order, at most. What is left out is made up for by scaling.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The source functions.

    Raises:
        ValueError: A known argument is out of range, or a pattern must be made from traced values.
    """
    if orders not in _ORDERS:
        raise ValueError(f"orders must be one of {_ORDERS}, got {orders}")
    cloud, phase = cloud.checked(), phase.checked()
    dtype = cloud.extinction_coefficient.dtype
    phase = jax.tree.map(lambda leaf: leaf.astype(dtype), phase)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0).astype(dtype)
    sun, view = (
        unit_vector(name, direction).astype(dtype)
        for name, direction in (
            ("sun_direction", sun_direction),
            ("view_direction", view_direction),
        )
    )
    wavelength = real_array(wavelength_nm).astype(dtype).reshape(1)
    found: tuple[Paths, ...] = ()
    if orders > 1:
        if pattern is None:
            pattern = reference_pattern(
                phase=phase,
                sun_direction=sun_direction,
                view_direction=view_direction,
                voxel_size=_known(voxel_size(cloud)),
                extinction_coefficient=average_extinction(cloud),
                orders=orders,
                share=share,
                most=most,
                wavelength_nm=wavelength_nm,
            )
        found = pattern.paths[: orders - 1]
        if len(found) < orders - 1:
            raise ValueError(f"the pattern has orders to {len(found) + 1}, not {orders}")
    lit = sunlight_reaching(cloud, sun)
    light = [albedo * phase_toward(phase, wavelength, -sun, view) * lit]
    for paths in found:
        light.append(albedo ** (len(light) + 1) * light_by_paths(cloud, lit, paths))
    return PatternLight(
        jnp.stack(light),
        tuple(len(paths.factor) for paths in found),
        tuple(paths.share for paths in found),
    )


extremes(
    Case("empty", {"extinction_coefficient": (0.0, 0.0)}),
    Case("black", {"albedo": 0.0}, limit=(0.0,) * 6),
    Case("thick", {"extinction_coefficient": (1e4, 1e4), "albedo": 1.0}),
    call=lambda extinction_coefficient, albedo: pattern_light(
        voxel_cloud(extinction_coefficient[None, None], (0.0, 0.0, 0.0), (1.0, 1.0, 2.0)),
        phase=cloud_phase(0.8),
        single_scattering_albedo=albedo,
        view_direction=(1.0, 0.0, 0.0),
        pattern=_small_pattern(),
    ).source_function.reshape(-1),
    extinction_coefficient=Domain((0.0, 0.0), (LARGEST_EXTINCTION, LARGEST_EXTINCTION)),
    albedo=Domain(0.0, 1.0),
)(pattern_light)


@functools.cache
def _small_pattern() -> ReferencePattern:
    """For the declaration alone."""
    with jax.ensure_compile_time_eval():
        return reference_pattern(
            phase=cloud_phase(np.float32(0.8)),
            sun_direction=(0.0, 0.0, 1.0),
            view_direction=(1.0, 0.0, 0.0),
            voxel_size=1.0,
            extinction_coefficient=0.5,
            counts=(1, 1, 3),
            directions=100,
        )


def phase_toward(
    phase: PhaseFunction, wavelength: Float[Array, "1"], one: Vector, other: Vector
) -> Scalar:
    """Phase function between two directions of travel [1/sr], with finite slopes."""
    half = jnp.sqrt(jnp.clip(jnp.sum((one - other) ** 2) / 4, 1e-12, 1.0 - 1e-6))
    return phase.at_wavelengths(2 * jnp.arcsin(half), wavelength)[..., 0]


def average_extinction(cloud: VoxelCloud) -> float:
    """Mean of the voxels that hold anything [1/m]; 0 if none does.

    Raises:
        ValueError: The cloud is traced.
    """
    grid = _known(cloud.extinction_coefficient)
    return float(grid[grid > 0].mean()) if np.any(grid > 0) else 0.0


def light_by_paths(cloud: VoxelCloud, lit: Grid, paths: Paths) -> Grid:
    """Radiance scattered toward the eye in each voxel by all paths of an order [1/sr].

    Args:
        cloud: On a grid of voxels.
        lit: Share of the sunlight that comes to each voxel.
        paths: Of one order; albedo 1.
    """
    extinction = cloud.extinction_coefficient
    part = occupied(extinction)
    dense, bright = extinction[part], lit[part]
    total = jnp.zeros_like(dense)
    for legs in _groups(paths, dense.dtype):
        total = total + _filtered(dense, bright, legs)
    return jnp.zeros_like(extinction).at[part].set(total)


def occupied(extinction: Grid) -> tuple[slice, slice, slice]:
    """The box of voxels that hold anything, and one more on each side; all if it is not known."""
    if is_traced(extinction):
        return slice(None), slice(None), slice(None)
    full = np.asarray(extinction) > 0

    def along(axis: int) -> slice:
        where = np.flatnonzero(full.any(tuple(a for a in range(3) if a != axis)))
        return slice(max(int(where[0]) - 1, 0), int(where[-1]) + 2) if where.size else slice(0, 1)

    return along(0), along(1), along(2)


def _known(values: Array) -> np.ndarray:
    """As NumPy has it.

    Raises:
        ValueError: It is traced.
    """
    if is_traced(values):
        raise ValueError("a pattern is made from known values: make it before, outside of JAX")
    return np.asarray(values, float)


def _groups(paths: Paths, dtype: np.dtype) -> list[_Legs]:
    """Paths by the number of samples that their legs need: 0, 1, 3 or 7."""
    if len(paths.factor) == 0:
        return []
    samples, ways, chords = leg_samples(paths.legs, paths.voxel_size)
    needed = np.max(np.sum(ways[..., 1:] > 0, axis=-1), axis=1)
    ends = np.cumsum(paths.legs, axis=1)
    starts = ends - paths.legs
    groups, below = [], -1
    for most in (0, 1, 3, 7):
        which = np.flatnonzero((needed > below) & (needed <= most))
        below = most
        if which.size == 0:
            continue
        count = min(most, samples.shape[2])
        places = starts[which, :, None] + samples[which, :, :count]
        reach = np.abs(ends[which]).max((0, 1))
        if count:
            reach = np.maximum(reach, np.abs(places).max((0, 1, 2)))
        groups.append(
            _Legs(
                jnp.asarray(paths.factor[which] * paths.scale, dtype),
                jnp.asarray(places, jnp.int32),
                jnp.asarray(ways[which, :, : count + 1], dtype),
                jnp.asarray(ends[which], jnp.int32),
                jnp.asarray(chords[which], dtype),
                (int(reach[0]), int(reach[1]), int(reach[2])),
            )
        )
    return groups


@eqx.filter_jit
def _filtered(extinction: Grid, lit: Grid, legs: _Legs) -> Grid:
    """One pass over the grid for each path."""
    edges = [(n, n) for n in legs.reach]
    dense, bright = jnp.pad(extinction, edges), jnp.pad(lit, edges)
    reach = jnp.asarray(legs.reach, jnp.int32)

    def at(values: Reals, place: Int[Array, "3"]) -> Grid:
        return jax.lax.dynamic_slice(values, reach + place, extinction.shape)

    @jax.checkpoint
    def light(path: _Legs) -> Grid:
        depth, chance, here = jnp.zeros_like(extinction), path.factor, extinction
        for leg in range(path.chords.shape[0]):
            depth = depth + here * path.ways[leg, 0]
            for sample in range(path.samples.shape[1]):
                depth = depth + at(dense, path.samples[leg, sample]) * path.ways[leg, sample + 1]
            here = at(dense, path.ends[leg])
            # 1 - exp(-x) without cancellation, and quicker than expm1.
            half = jnp.tanh(here * path.chords[leg] / 2)
            chance = chance * (2 * half / (1 + half))
        return chance * jnp.exp(-depth) * at(bright, path.ends[-1])

    def step(total: Grid, path: _Legs) -> tuple[Grid, None]:
        return total + light(path), None

    total, _ = jax.lax.scan(step, jnp.zeros_like(extinction), legs)
    return total
