"""Sunlight on the way to a point and on to where it is seen, summed along rays."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.optics.medium import Medium
from atmofit.sky.paths import Paths
from atmofit.typing import Reals

_AT_ONCE = 48  # steps of a ray that are summed in one loop of the compiled program


def sun_columns(
    medium: Medium, paths: Paths, altitude: Reals, sun_cosine: Reals
) -> tuple[Reals, Reals]:
    """Columns toward the sun over vertical columns [-], and whether the sun is up (1 or 0).

    The constituents of the columns are their second axis.

    Args:
        medium: Optical properties.
        paths: The geometry.
        altitude: [m], broadcasts.
        sun_cosine: Of the local solar zenith angle.
    """
    here = jnp.broadcast_to(altitude, sun_cosine.shape)
    columns, up = [], jnp.ones_like(sun_cosine)
    for profile in medium.profiles:
        column, up = paths.sun_column(profile, here, sun_cosine)
        columns.append(column)
    return jnp.stack(columns, axis=1), up


def path_integrals(
    medium: Medium,
    columns: Float[Array, "step constituent *n s"],
    weight: Float[Array, "step scatterer *n s"],
    peaks: int | str = 1,
    straight: Float[Array, "step constituent *n s"] | None = None,
) -> tuple[Float[Array, "scatterer *n w s"], ...]:
    """Sums over the steps of rays of each scatterer's weight times transmittance.

    Args:
        medium: Optical properties.
        columns: Over vertical columns, from the sun to the step and on to the ray's start.
        weight: Density times length, 0 where the sun is down; broadcasts.
        peaks: What forward peaks make of it: how many orders, one sum for the light that met so
            many of them, which all dim it; or "met or not": sums for light that met none and for
            all, where the extinction leaves the peaks out. Static.
        straight: Columns on which forward peaks are met; None: all of the way.

    Returns:
        For each sum; exponentials are fast where the last axis is long.
    """
    count = 2 if isinstance(peaks, str) else peaks
    met = None
    if medium.peaks is not None and count > 1:
        met = columns if straight is None else straight
    # Kept apart from how they came about, lest that be done again for each wavelength.
    steps = jax.lax.optimization_barrier((columns, weight, met))
    size = columns.shape[0]
    if size <= _AT_ONCE:
        return _summed(medium, steps, peaks, count)
    batches = -(-size // _AT_ONCE)
    each = -(-size // batches)

    def in_batches(values: Reals) -> Reals:
        # What is added has no weight.
        more = jnp.zeros((batches * each - size, *values.shape[1:]), values.dtype)
        return jnp.concatenate([values, more]).reshape(batches, each, *values.shape[1:])

    def add(sums: tuple[Reals, ...], some: Any) -> tuple[tuple[Reals, ...], None]:
        return jax.tree.map(jnp.add, sums, _summed(medium, some, peaks, count)), None

    *shape, last = jnp.broadcast_shapes(columns.shape[2:], weight.shape[2:])
    zero = jnp.zeros((weight.shape[1], *shape, medium.extinction.shape[1], last), columns.dtype)
    sums, _ = jax.lax.scan(add, (zero,) * count, jax.tree.map(in_batches, steps))
    return sums


def _summed(
    medium: Medium, steps: tuple[Reals, Reals, Reals | None], peaks: int | str, count: int
) -> tuple[Float[Array, "scatterer *n w s"], ...]:
    """The sums, written out: each becomes one loop of the compiled program, several times as fast.

    The exponentials are computed again for every scatterer, which costs less than to keep them.
    """
    columns, weight, met = steps
    sums: list[list[Reals]] = [[] for _ in range(count)]
    for c in range(weight.shape[1]):
        terms: list[list[Reals]] = [[] for _ in range(count)]
        for step in range(columns.shape[0]):
            before = None if met is None else met[step]
            lights = _lights(medium, columns[step], before, peaks, count)
            for each, light in zip(terms, lights, strict=True):
                each.append(weight[step, c][..., None, :] * light)
        for each, parts in zip(sums, terms, strict=True):
            each.append(functools.reduce(jnp.add, parts))
    # Kept apart from what is made of them, lest they be summed again there for each azimuth.
    return jax.lax.optimization_barrier(tuple(jnp.stack(each) for each in sums))


def _lights(
    medium: Medium, column: Reals, met: Reals | None, peaks: int | str, count: int
) -> list[Reals]:
    """Transmittance from the sun by way of one step, for each sum."""
    depth = _depth(column, medium.extinction)
    if met is None or medium.peaks is None:
        return [jnp.exp(-depth)] * count
    deflected = _depth(met, medium.peaks * medium.scattering)
    if isinstance(peaks, str):
        return [jnp.exp(-(depth + deflected)), jnp.exp(-depth)]
    return [jnp.exp(-depth) * factor for factor in forward_factors(deflected, count)]


def _depth(
    column: Float[Array, "constituent *n s"], extinction: Float[Array, "some w"]
) -> Float[Array, "*n w s"]:
    """Optical depth, term by term, so that it and its exponential become one loop."""
    each = extinction.reshape(-1, *(1,) * (column.ndim - 2), extinction.shape[1], 1)
    terms = [column[c][..., None, :] * each[c] for c in range(extinction.shape[0])]
    return functools.reduce(jnp.add, terms)


def forward_factors(deflected: Reals, orders: int) -> tuple[Reals, ...]:
    """What forward peaks make of light, order by order, over light that met nothing.

    Args:
        deflected: Optical depth of forward peaks on the way.
        orders: How many. Static.

    Returns:
        Terms of the exponential series, the first is 1.
    """
    terms = [jnp.ones_like(deflected)]
    for order in range(1, orders):
        terms.append(terms[-1] * deflected / order)
    return tuple(terms)
