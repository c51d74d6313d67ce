"""Rays from one point in all directions, with the steps along each."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.numerics import gauss_nodes, safe_sqrt
from atmofit.sky.ladder import Nodes
from atmofit.sky.paths import Paths, SphericalPaths, stretched
from atmofit.typing import Reals, Scalar


class Fan(eqx.Module):
    """Rays from one point in all directions, with the steps along each.

    Attributes:
        cosine: Of each ray's zenith angle, [ray].
        weight: Of each ray in an integral over the cosine, [ray].
        distance: From the point to each step, [ray, step].
        length: Weight of each step in an integral over distance, [ray, step].
        to_ground: How many rays, the last ones, end at the ground. Static.
    """

    cosine: Float[Array, " ray"]
    weight: Float[Array, " ray"]
    distance: Float[Array, "ray step"]
    length: Float[Array, "ray step"]
    to_ground: int = eqx.field(static=True)


def fan_at(paths: Paths, z: Scalar, top: Scalar, scale: Scalar, nodes: Nodes) -> Fan:
    """Rays that rise, that sink and miss the ground, and that sink to the ground."""
    dtype = z.dtype
    u, w = (jnp.asarray(x, dtype) for x in gauss_nodes(nodes.polar))
    s, ws = (jnp.asarray(x, dtype)[None, :] for x in gauss_nodes(nodes.path))
    horizon = paths.horizon_cosine(z)
    rising, sinking = u**2, horizon - (1 + horizon) * u**2
    parts = [
        (rising, 2 * u * w, *_rising_steps(paths, z, rising, top, scale, s, ws)),
        (sinking, (1 + horizon) * 2 * u * w, *_sinking_steps(paths, z, sinking, scale, s, ws)),
    ]
    if isinstance(paths, SphericalPaths):
        v, wv = (jnp.asarray(x, dtype) for x in gauss_nodes(nodes.limb))
        half, whalf = (jnp.asarray(x, dtype)[None, :] for x in gauss_nodes(nodes.path // 2))
        steps = _passing_steps(paths, z, horizon * v, top, half, whalf)
        parts.insert(1, (horizon * v, -horizon * wv, *steps))
    cosine, weight, distance, length = (jnp.concatenate(part) for part in zip(*parts, strict=True))
    return Fan(cosine, weight, distance, length, to_ground=nodes.polar)


def _rising_steps(
    paths: Paths, z: Scalar, cosine: Reals, top: Scalar, scale: Scalar, s: Reals, ws: Reals
) -> tuple[Reals, Reals]:
    """Steps on rays to space, dense at the start."""
    length, near = paths.length_up(z, cosine, top), paths.length_up(z, cosine, z + scale)
    distance, slope = stretched(s, length[:, None], near[:, None])
    return distance, slope * ws


def _sinking_steps(
    paths: Paths, z: Scalar, cosine: Reals, scale: Scalar, s: Reals, ws: Reals
) -> tuple[Reals, Reals]:
    """Steps on rays to the ground, dense at the ground."""
    length = paths.length_to_ground(z, cosine)
    end = paths.advance(z, cosine, safe_sqrt(1 - cosine**2), length)
    near = paths.length_up(jnp.zeros_like(length), -end.cosine, jnp.full_like(length, scale))
    back, slope = stretched(s, length[:, None], near[:, None])
    return jnp.maximum(length[:, None] - back, 0.0), slope * ws


def _passing_steps(
    paths: SphericalPaths, z: Scalar, cosine: Reals, top: Scalar, s: Reals, ws: Reals
) -> tuple[Reals, Reals]:
    """Steps on rays that pass their lowest point, before it and beyond."""
    down = -(paths.radius + z) * cosine[:, None]
    up = paths.length_up(z, cosine, top)[:, None] - down
    after, slope = stretched(s, up, jnp.maximum(down, 0.2 * up))
    distance = jnp.concatenate([down * (1 - s), down + after], axis=1)
    return distance, jnp.concatenate([down * ws, slope * ws], axis=1)
