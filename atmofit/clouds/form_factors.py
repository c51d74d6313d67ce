"""Share of the light scattered in one voxel that collides in another, with the phase function.

Rays leave many places of a voxel in even directions, and each shares what it carries among the
voxels that it crosses: what collides and what escapes add to what was scattered, whatever the
phase function. Between the middles of two voxels alone, the peak of a phase function would be
counted as if it filled all of a voxel, and give more light than there is.

All of this is NumPy: it is done once, before the programs that use it are compiled.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range, is_traced
from atmofit.clouds.volume import LARGEST_EXTINCTION, LARGEST_LENGTH
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import RealsLike

DIRECTIONS = 2000
_TABLE = 8192  # angles at which a phase function is looked up
_LEVEL = 1e-12  # stands for a direction's component of 0
_STARTS = 24  # places of each ray
_PLASTIC = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])


def form_factors(
    *,
    phase: PhaseFunction,
    direction: RealsLike,
    voxel_size: RealsLike = (1.0, 1.0, 1.0),
    extinction_coefficient: RealsLike,
    reach: tuple[int, int, int] = (4, 4, 8),
    directions: int = DIRECTIONS,
    wavelength_nm: RealsLike = 550.0,
) -> np.ndarray:
    """Where light of one direction collides after it was scattered in a voxel.

    Args:
        phase: Of one scattering.
        direction: Unit vector along which the light travelled, 3 numbers.
        voxel_size: Edges of a voxel [m].
        extinction_coefficient: The same everywhere [1/m], 0 to 1e6.
        reach: Voxels on each side, along the three axes.
        directions: Of the rays; more for a narrower phase function.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        Share of the scattered light that collides next in each voxel [-], of the shape
        2 reach + 1; the middle one is the voxel itself. Their sum is below 1 by what leaves.

    Raises:
        ValueError: An argument is out of range.
    """
    size, extinction = checked_medium(voxel_size, extinction_coefficient)
    rays = even_directions(directions)
    table = crossings(size, extinction, reach, rays)
    weights = scattered(phase, wavelength_nm, unit(direction)[None], rays)[0]
    return (table @ weights).reshape(box_shape(reach))


def checked_medium(
    voxel_size: RealsLike, extinction_coefficient: RealsLike
) -> tuple[np.ndarray, float]:
    """Edges and extinction of a voxel as NumPy has them.

    Raises:
        ValueError: They are traced or out of range.
    """
    if is_traced(voxel_size, extinction_coefficient):
        raise ValueError("form factors are made outside of JAX's programs: their inputs are traced")
    size = in_range("voxel_size", voxel_size, 1e-9, LARGEST_LENGTH, "m")
    extinction = in_range("extinction_coefficient", extinction_coefficient, 0.0, LARGEST_EXTINCTION)
    return np.broadcast_to(np.asarray(size, float), (3,)), float(extinction)


def unit(direction: RealsLike) -> np.ndarray:
    """A direction of length 1.

    Raises:
        ValueError: It has not three components, or length 0.
    """
    vector = np.asarray(direction, float)
    if vector.shape != (3,) or not np.linalg.norm(vector) > 0:
        raise ValueError(f"a direction has 3 components, not all 0, got {vector}")
    return vector / np.linalg.norm(vector)


def even_directions(count: int) -> np.ndarray:
    """Unit vectors [direction, 3] of equal solid angle, on a spiral."""
    number = np.arange(count) + 0.5
    z = 1 - 2 * number / count
    azimuth = number * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - z**2)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), z], -1)


def phase_table(phase: PhaseFunction, wavelength_nm: RealsLike, cosine: np.ndarray) -> np.ndarray:
    """A phase function [1/sr] at cosines of the scattering angle, by table."""
    # Even in the square root of the versine, that is in the sine of half the angle.
    half = np.linspace(0.0, 1.0, _TABLE)
    with jax.ensure_compile_time_eval():
        angle = jnp.asarray(2 * np.arcsin(half))
        alike = jax.tree.map(lambda leaf: leaf.astype(angle.dtype), phase)
        values = np.asarray(alike(angle, wavelength_nm), np.float32)
    place = np.sqrt(np.clip((1 - cosine) / 2, 0.0, 1.0, dtype=np.float32)) * (_TABLE - 1)
    below = np.minimum(place.astype(np.int32), _TABLE - 2)
    part = place - below
    return (1 - part) * values[below] + part * values[below + 1]


def scattered(
    phase: PhaseFunction, wavelength_nm: RealsLike, incoming: np.ndarray, rays: np.ndarray
) -> np.ndarray:
    """Share of the light of each incoming direction that goes each ray's way, [incoming, ray].

    The shares of a direction add to 1.
    """
    cosine = incoming.astype(np.float32) @ rays.astype(np.float32).T
    values = phase_table(phase, wavelength_nm, cosine)
    return values / values.sum(1, keepdims=True)


def box_shape(reach: tuple[int, int, int]) -> tuple[int, int, int]:
    """Voxels of a box that reaches so far on each side."""
    return 2 * reach[0] + 1, 2 * reach[1] + 1, 2 * reach[2] + 1


def crossings(
    size: np.ndarray,
    extinction: float,
    reach: tuple[int, int, int],
    rays: np.ndarray,
    starts: int = _STARTS,
) -> np.ndarray:
    """Chance to collide in each voxel around, for a ray from a voxel's inside.

    Args:
        size: Edges of a voxel [m].
        extinction: [1/m].
        reach: Voxels on each side.
        rays: Unit vectors, [ray, 3].
        starts: Places of each ray that are averaged over.

    Returns:
        [voxel, ray], the voxels in the order of the box's axes.
    """
    shape, count = np.array(box_shape(reach)), len(rays)
    table = np.zeros(int(np.prod(shape)) * count, np.float32)
    moving = np.where(np.abs(rays) < _LEVEL, _LEVEL, rays)
    stride, ray = np.where(moving > 0, 1, -1), np.arange(count)
    for number in range(starts):
        # Each ray has places of its own, evenly over the voxel when taken together.
        start = ((number * count + ray)[:, None] * _PLASTIC + 0.5) % 1.0
        inside = np.where(moving > 0, 1 - start, start)
        walls = inside * size / np.abs(moving)
        place = np.tile(np.array(reach), (count, 1))
        before = np.ones(count)
        for _ in range(sum(reach) + 3):
            axis = np.argmin(walls, 1)
            here = walls[ray, axis]
            after = np.exp(-extinction * here)
            within = np.all((place >= 0) & (place < shape), 1)
            cell = np.ravel_multi_index(tuple(np.clip(place, 0, shape - 1).T), tuple(shape))
            # A ray is in one voxel at a time, so that no two of these are the same.
            table[cell * count + ray] += np.where(within, before - after, 0.0)
            before = after
            place[ray, axis] += stride[ray, axis]
            walls[ray, axis] += (size / np.abs(moving))[ray, axis]
    return (table / starts).reshape(-1, count)
