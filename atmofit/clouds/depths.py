"""Optical depth from every voxel of a cloud to its outline, along one direction.

Rays go from slice to slice along the axis that the direction follows most closely. They keep their
own sideways distance from the voxels' centres, so that nothing is interpolated more than twice:
the extinction onto the rays, and the depths back to the centres. Done at every slice instead,
interpolation smears a depth by an error of first order.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.clouds.volume import LARGEST_EXTINCTION, Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import mean_decay
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_LEVEL = 1e-6  # stands for a direction's component of 0
_UNIT_SLACK = 1e-3  # how far from 1 a direction's length may be

Grid = Float[Array, "x y z"]


def unit_vector(name: str, direction: RealsLike) -> Vector:
    """A direction of length 1, freed from rounding.

    Raises:
        ValueError: A known direction has not three components or not about unit length.
    """
    vector = real_array(direction)
    if vector.shape != (3,):
        raise ValueError(f"{name} must have 3 components, got the shape {vector.shape}")
    # in_range has no norm of its own: a traced vector of another length becomes NaN.
    squared = jnp.sum(vector**2)
    checked = in_range(f"squared length of {name}", squared, 1 - _UNIT_SLACK, 1 + _UNIT_SLACK)
    return vector / jnp.sqrt(checked)


def optical_depth_toward(cloud: VoxelCloud, direction: RealsLike) -> Grid:
    """Optical depth from the centre of each voxel to the outline.

    Of second order in the size of the voxels where the extinction is smooth and fades out at the
    outline, and exact along the axes and the diagonals of the voxels.

    Args:
        cloud: On a grid of voxels.
        direction: Unit vector from the voxels to the light, 3 numbers.

    Returns:
        Optical depth [-], [x, y, z].

    Raises:
        ValueError: A known argument is out of range.
    """
    cloud = cloud.checked()
    vector = unit_vector("direction", direction).astype(cloud.extinction_coefficient.dtype)
    return _depths(cloud, vector)


extremes(
    Case("nothing", {"extinction_coefficient": (0.0, 0.0)}, limit=(0.0, 0.0)),
    Case("up", {"extinction_coefficient": (1.0, 2.0), "angle": 0.0}, limit=(2.5, 1.0)),
    Case("down", {"extinction_coefficient": (1.0, 2.0), "angle": math.pi}, limit=(0.5, 2.0)),
    call=lambda extinction_coefficient, angle: _of_two(extinction_coefficient, angle),
    extinction_coefficient=Domain((0.0, 0.0), (LARGEST_EXTINCTION, LARGEST_EXTINCTION)),
    angle=Span(0.0, math.pi),
)(optical_depth_toward)


def sunlight_reaching(cloud: VoxelCloud, direction: RealsLike) -> Grid:
    """Share of the sunlight that comes to each voxel, averaged over the way through it.

    Args:
        cloud: On a grid of voxels.
        direction: Unit vector to the sun, 3 numbers.

    Returns:
        Transmittance [-], [x, y, z]; 1 in an empty cloud.

    Raises:
        ValueError: A known argument is out of range.
    """
    cloud = cloud.checked()
    vector = unit_vector("direction", direction).astype(cloud.extinction_coefficient.dtype)
    return reaching(cloud, vector)


extremes(
    Case("nothing", {"extinction_coefficient": 0.0}, limit=1.0),
    Case("one", {"extinction_coefficient": 1.0}, limit=1 - math.exp(-1.0)),
    call=lambda extinction_coefficient: sunlight_reaching(
        voxel_cloud(extinction_coefficient.reshape(1, 1, 1), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        (0.0, 0.0, 1.0),
    )[0, 0, 0],
    extinction_coefficient=Domain(0.0, LARGEST_EXTINCTION),
)(sunlight_reaching)


def voxel_size(cloud: VoxelCloud) -> Vector:
    """Edges of a voxel [m]."""
    count = jnp.asarray(cloud.extinction_coefficient.shape, cloud.low.dtype)
    return (cloud.high - cloud.low) / count


def passed(depths: tuple[Grid, Grid], fading: Scalar | float = 1.0) -> Grid:
    """Mean over each voxel of what is left of rays that a share of the optical depth weakens."""
    before, own = depths
    return jnp.exp(-fading * before) * mean_decay(fading * own)


@eqx.filter_jit
def reaching(cloud: VoxelCloud, direction: Vector) -> Grid:
    """The kernel of `sunlight_reaching`."""
    return passed(depths_toward(cloud, direction))


def depths_toward(cloud: VoxelCloud, direction: Vector) -> tuple[Grid, Grid]:
    """Optical depth between the outline and where light enters each voxel, and of the voxel."""
    way = jnp.min(voxel_size(cloud) / jnp.maximum(jnp.abs(direction), _LEVEL))
    own = cloud.extinction_coefficient * way
    # The centre's depth holds half of the voxel's own.
    return jnp.maximum(_depths(cloud, direction) - own / 2, 0.0), own


@eqx.filter_jit
def _depths(cloud: VoxelCloud, direction: Vector) -> Grid:
    """The kernel of `optical_depth_toward`."""
    size = voxel_size(cloud)
    axis = jnp.argmax(jnp.abs(direction) / size)
    ways = [functools.partial(_along, axis=a) for a in range(3)]
    return jax.lax.switch(axis, ways, cloud.extinction_coefficient, size, direction)


def _along(extinction: Grid, size: Vector, direction: Vector, axis: int) -> Grid:
    """By slices across an axis, from the one that the light meets first."""
    one, other = (a for a in range(3) if a != axis)
    lead = direction[axis]
    # Another axis's branch may be given a direction that does not follow it.
    slant = jnp.where(jnp.abs(lead) > 0, jnp.abs(lead), 1.0)
    way = size[axis] / slant
    shifts = [jnp.clip(direction[a] / slant * (size[axis] / size[a]), -1, 1) for a in (one, other)]
    slices = jnp.moveaxis(extinction, axis, 0)
    ordered = jnp.where(lead > 0, slices[::-1], slices)

    def step(summed: Reals, slice_: tuple[Scalar, Reals]) -> tuple[Reals, Reals]:
        number, values = slice_
        here = values
        for a, shift in enumerate(shifts):
            offset = -number * shift
            whole, before = jnp.floor(offset), jnp.floor(offset + shift)
            moved = jnp.where(number > 0, whole - before, 0.0).astype(int)
            summed, here = _moved(summed, moved, a), _onto(here, offset - whole, a)
        summed = summed + here * way
        depth = summed - here * way / 2
        for a, shift in enumerate(shifts):
            depth = _back(depth, -number * shift - jnp.floor(-number * shift), a)
        return summed, depth

    rows, columns = ordered.shape[1:]
    start = jnp.zeros((rows + 1, columns + 1), extinction.dtype)
    numbers = jnp.arange(ordered.shape[0], dtype=extinction.dtype)
    _, depths = jax.lax.scan(jax.checkpoint(step), start, (numbers, ordered))
    depths = jnp.where(lead > 0, depths[::-1], depths)
    return jnp.moveaxis(depths, 0, axis)


def _padded(values: Reals, axis: int) -> Reals:
    """With zeros on both sides of an axis."""
    return jnp.pad(values, [(1, 1) if a == axis else (0, 0) for a in range(values.ndim)])


def _cut(values: Reals, first: int, axis: int) -> Reals:
    """All but one along an axis, from the first."""
    return jax.lax.slice_in_dim(values, first, first + values.shape[axis] - 1, axis=axis)


def _moved(values: Reals, by: Array, axis: int) -> Reals:
    """By -1, 0 or 1 places, with zeros coming in."""
    return jax.lax.dynamic_slice_in_dim(_padded(values, axis), 1 - by, values.shape[axis], axis)


def _onto(values: Reals, part: Scalar, axis: int) -> Reals:
    """Between centres, onto rays that lie this part of a voxel beyond each, and one before."""
    padded = _padded(values, axis)
    return (1 - part) * _cut(padded, 0, axis) + part * _cut(padded, 1, axis)


def _back(values: Reals, part: Scalar, axis: int) -> Reals:
    """From those rays to the centres."""
    return part * _cut(values, 0, axis) + (1 - part) * _cut(values, 1, axis)


def _of_two(extinction_coefficient: Float[Array, "2"], angle: Scalar) -> tuple[Scalar, Scalar]:
    """Depths of two cubes on top of each other, in the x-z plane."""
    cloud = voxel_cloud(extinction_coefficient[None, None, :], (0.0, 0.0, 0.0), (1.0, 1.0, 2.0))
    direction = jnp.stack([jnp.sin(angle), jnp.zeros_like(angle), jnp.cos(angle)])
    depth = optical_depth_toward(cloud, direction)
    return depth[0, 0, 0], depth[0, 0, 1]
