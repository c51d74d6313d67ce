"""Light carried through a grid of voxels, direction by direction, with nothing lost.

A direction's power moves from slice to slice along the axis that it follows most closely, shared
among the next slice's voxels by bilinear weights, which add to 1. In a voxel it decays, and what
the voxel emits joins it evenly along the way. So for each direction power that comes in and is
emitted equals what leaves and what collides, to rounding. The weights smear a slanted beam, at
worst by half the square root of the number of slices, in voxels.
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.clouds.ordinates import dominant_axis, groups, ordinates
from atmofit.clouds.volume import Vector
from atmofit.numerics import mean_decay
from atmofit.typing import Reals, Scalar

_SERIES_TO, _SERIES_TERMS = 0.5, 14  # as of the mean decay

Grid = Float[Array, "x y z"]
Grids = Float[Array, "direction x y z"]
PerDirection = Float[Array, " direction"]


class Swept(eqx.Module):
    """What directions carry through a grid.

    Attributes:
        light: Power times way, in each voxel [m]; times the extinction coefficient, what collides.
        escaped: Power that leaves the grid [-].
        received: Power that comes in [-].
    """

    light: Grids
    escaped: PerDirection
    received: PerDirection


class _Bundle(eqx.Module):
    """Directions that are carried together, each along the axis that it follows.

    Slices are in the order in which each direction meets them; all have as many rows and columns.

    Attributes:
        way: Through a slice [m].
        shifts: Sideways between slices, along the two other axes [voxels].
        face: Of a voxel, as the directions see it [m2].
        backward: Which directions meet the slices from the last to the first.
        axes: Of the directions, in parts: axis and number of directions. Static.
    """

    way: PerDirection
    shifts: tuple[PerDirection, PerDirection]
    face: PerDirection
    backward: Bool[Array, " direction"]
    axes: tuple[tuple[int, int], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, directions: Float[Array, "direction 3"], size: Vector, axis: int) -> "_Bundle":
        """Directions whose longest component, in voxels, is this axis's."""
        one, other = (a for a in range(3) if a != axis)
        slant = jnp.abs(directions[:, axis])
        return cls(
            size[axis] / slant,
            (
                directions[:, one] / slant * (size[axis] / size[one]),
                directions[:, other] / slant * (size[axis] / size[other]),
            ),
            slant * size[one] * size[other],
            directions[:, axis] < 0,
            ((axis, directions.shape[0]),),
        )

    @classmethod
    def joined(cls, bundles: list["_Bundle"]) -> "_Bundle":
        """Of grids with as many voxels along every axis: one program instead of three."""
        arrays = [(b.way, b.shifts, b.face, b.backward) for b in bundles]
        joined = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *arrays)
        way, shifts, face, backward = joined
        return cls(way, shifts, face, backward, sum((b.axes for b in bundles), ()))

    def slices(self, values: Grids) -> Float[Array, "slice direction row column"]:
        """Of a quantity with a value for each direction."""
        parts, start = [], 0
        for axis, count in self.axes:
            parts.append(jnp.moveaxis(values[start : start + count], axis + 1, 0))
            start += count
        return self._ordered(jnp.concatenate(parts, axis=1))

    def grids(self, slices: Float[Array, "slice direction row column"]) -> Grids:
        """The other way round."""
        slices, parts, start = self._ordered(slices), [], 0
        for axis, count in self.axes:
            parts.append(jnp.moveaxis(slices[:, start : start + count], 0, axis + 1))
            start += count
        return jnp.concatenate(parts)

    def _ordered(self, slices: Reals) -> Reals:
        return jnp.where(self.backward[None, :, None, None], slices[::-1], slices)

    def shifted(self, values: Reals, outside: Reals) -> Reals:
        """What comes to a slice's voxels from those of the slice before."""
        return _shifted(_shifted(values, self.shifts[0], outside, 1), self.shifts[1], outside, 2)

    def lost(self, rows: int, columns: int) -> Float[Array, "direction row column"]:
        """Share of each voxel's power that the next shift takes out at the sides."""
        kept = []
        for shift, n in zip(self.shifts, (rows, columns), strict=True):
            first, last = (jnp.asarray(np.eye(n)[k], shift.dtype)[None, :] for k in (0, -1))
            s = shift[:, None]
            kept.append(1 - jnp.maximum(s, 0.0) * last - jnp.maximum(-s, 0.0) * first)
        return 1 - kept[0][:, :, None] * kept[1][:, None, :]


def mean_of_decay(x: Reals) -> Reals:
    """(1 - mean_decay(x)) / x for x of at least 0.

    The way that emission has in its own voxel of optical depth x, over the whole way through.
    """
    near = x < _SERIES_TO
    small, far = jnp.where(near, x, 0.0), jnp.where(near, _SERIES_TO, x)
    series = jnp.zeros_like(x)
    for k in reversed(range(_SERIES_TERMS)):
        series = series * small + (-1) ** k / math.factorial(k + 2)
    return jnp.where(near, series, (1 - mean_decay(far)) / far)


def sweep(
    extinction: Grid,
    size: Vector,
    emitted: Grids,
    inflow: PerDirection | None,
    count: int,
    shape: tuple[float, float, float],
) -> Swept:
    """Carry the light of all directions of a quadrature.

    Args:
        extinction: [1/m].
        size: Of a voxel [m].
        emitted: Power of each voxel.
        inflow: Radiance from outside times the direction's solid angle; None: none, and what
            escapes is not wanted either.
        count: Of the directions, see `ordinates`.
        shape: Of a voxel, its known proportions.
    """
    directions, _ = ordinates(count)
    order = groups(dominant_axis(directions, shape))
    bundles = [
        _Bundle.of(jnp.asarray(directions[which], extinction.dtype), size, axis)
        for axis, which in order
    ]
    places = [which for _, which in order]
    if _even(extinction):
        bundles, places = [_Bundle.joined(bundles)], [np.concatenate(places)]
    parts = [
        _carried(
            bundle, extinction, _chosen(emitted, which), None if inflow is None else inflow[which]
        )
        for bundle, which in zip(bundles, places, strict=True)
    ]
    swept = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    back = np.argsort(np.concatenate(places))
    return jax.tree.map(lambda leaf: _chosen(leaf, back), swept)


def sweep_one(
    extinction: Grid, size: Vector, emitted: Grid, inflow: Scalar, direction: Vector
) -> Swept:
    """Carry the light of one direction, which may be traced."""

    def along(axis: int, grids: Reals, size: Vector, direction: Vector) -> tuple[Reals, Any]:
        bundle = _Bundle.of(direction[None], size, axis)
        swept = _carried(bundle, grids[0], grids[1:], inflow[None])
        return swept.light, (swept.escaped, swept.received)

    light, powers = _by_axis(along, jnp.stack([extinction, emitted]), size, direction)
    return Swept(light, *powers)


def _even(grid: Grid) -> bool:
    return len(set(grid.shape)) == 1


def _by_axis(
    along: Callable[[int, Reals, Vector, Vector], tuple[Reals, Any]],
    grids: Reals,
    size: Vector,
    direction: Vector,
) -> tuple[Reals, Any]:
    """What one direction does to grids, along the axis that it follows."""
    axis = jnp.argmax(jnp.abs(direction) / size)
    if not _even(grids[0]):
        branches = [lambda _, a=a: along(a, grids, size, direction) for a in range(3)]
        return jax.lax.switch(axis, branches, None)
    # Turned so that this axis is the first, else three programs would be compiled.
    found, more = along(0, _turned(grids, axis), jnp.roll(size, -axis), jnp.roll(direction, -axis))
    return _turned(found, (3 - axis) % 3), more


def _turned(grids: Reals, steps: Int[Array, ""]) -> Reals:
    """With the axes in cyclic order, from another one on."""
    orders = [(0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2)]
    branches = [lambda g, order=order: jnp.transpose(g, order) for order in orders]
    return jax.lax.switch(steps, branches, grids)


def _carried(
    bundle: _Bundle, extinction: Grid, emitted: Grids, inflow: PerDirection | None
) -> Swept:
    """From slice to slice."""
    way = bundle.way[:, None, None]
    here = bundle.slices(jnp.broadcast_to(extinction[None], emitted.shape))
    slices = (here, bundle.slices(emitted))
    nothing = jnp.zeros_like(bundle.way)
    outside = (nothing if inflow is None else inflow * bundle.face)[:, None, None]
    rows, columns = here.shape[2:]
    lost = bundle.lost(rows, columns)

    def step(carry: tuple[Reals, Reals], values: tuple[Reals, Reals]) -> tuple[Any, Reals]:
        power, escaped = carry
        if inflow is not None:
            escaped = escaped + jnp.sum(power * lost, axis=(1, 2))
        depth = values[0] * way
        arrived, mean = bundle.shifted(power, outside), mean_decay(depth)
        light = way * (arrived * mean + values[1] * mean_of_decay(depth))
        return (arrived * jnp.exp(-depth) + values[1] * mean, escaped), light

    start = jnp.broadcast_to(outside, here.shape[1:])
    (last, escaped), light = jax.lax.scan(jax.checkpoint(step), (start, nothing), slices)
    # A uniform inflow loses at the sides of a slice what it gains there.
    voxels = jnp.sum(lost, axis=(1, 2)) * here.shape[0] + rows * columns
    return Swept(
        bundle.grids(light), escaped + jnp.sum(last, axis=(1, 2)), outside[:, 0, 0] * voxels
    )


def _shifted(values: Reals, shift: PerDirection, outside: Reals, axis: int) -> Reals:
    """Along one axis: to neighbours, from 0 to 1 voxels away."""
    edge_shape = list(values.shape)
    edge_shape[axis] = 1
    edge, n = jnp.broadcast_to(outside, edge_shape), values.shape[axis]
    lower = jnp.concatenate([edge, jax.lax.slice_in_dim(values, 0, n - 1, axis=axis)], axis)
    upper = jnp.concatenate([jax.lax.slice_in_dim(values, 1, n, axis=axis), edge], axis)
    s = shift[:, None, None]
    return (1 - jnp.abs(s)) * values + jnp.maximum(s, 0.0) * lower + jnp.maximum(-s, 0.0) * upper


def _chosen(values: Reals, which: np.ndarray) -> Reals:
    """Some of the first axis; a slice where they are neighbours."""
    first, last = int(which[0]), int(which[-1])
    if np.array_equal(which, np.arange(first, last + 1)):
        return values[first : last + 1]
    return values[which]
