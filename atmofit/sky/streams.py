"""Straight rays that all altitudes share, and what their layers do to the light along them.

A ray keeps its distance from the planet's centre, so one that meets the ground at some angle, or
passes at some height above it, crosses every altitude: light of all orders is carried along the
same few of them. They are cut at the altitudes where the light is known.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.numerics import gauss_nodes, safe_sqrt
from atmofit.optics.medium import Medium
from atmofit.sky.paths import Paths, SphericalPaths
from atmofit.typing import Reals

Index = Int[Array, ""]
_LIMB_SPACING = 2
_STENCIL = 4  # altitudes between which a source is interpolated
_LAYER_NODES = 3  # of the quadrature inside a layer
_THINNEST = 1e-4  # optical depth of a layer below which light weighs all its parts alike
_FAINTEST, _NOTHING = 1e-15, 1e-30  # extinction over the largest, and [1/m], that count as none
_STEEPEST = 30.0  # logarithm of the largest ratio of extinctions across a layer
_STRAIGHTEST = 1e-3  # logarithm of a ratio below which the extinction counts as constant


class Streams(eqx.Module):
    """The shared rays; "ray" runs over those that meet the ground, then those that pass above it.

    Attributes:
        cosine: Of the angle between ray and local zenith, at least 0, [altitude, ray].
        weight: In an integral over that cosine from 0 to 1; 0 where the ray passes above,
            [altitude, ray].
        distance: From the ray's lowest point, on the ground or above it [m], [altitude, ray].
        turn: Angle at the centre between the ends of a layer [rad], [layer, ray].
        to_ground: How many rays, the first ones, meet the ground. Static.
        spacing: The others pass at the height of every so-manieth altitude. Static.
    """

    cosine: Float[Array, "z ray"]
    weight: Float[Array, "z ray"]
    distance: Float[Array, "z ray"]
    turn: Float[Array, "layer ray"]
    to_ground: int = eqx.field(static=True)
    spacing: int = eqx.field(static=True, default=_LIMB_SPACING)

    @property
    def reached(self) -> np.ndarray:
        """Whether an altitude is on a ray, [altitude, ray]."""
        altitudes, rays = self.cosine.shape
        passing = self.spacing * np.arange(rays - self.to_ground)
        lowest = np.concatenate([np.zeros(self.to_ground, int), passing])
        return np.arange(altitudes)[:, None] >= lowest[None, :]


class Layers(eqx.Module):
    """What each layer does to the light of each ray, seen from its lower or its upper end.

    For light that comes from above, the last layer is all that lies above the highest altitude;
    for light that comes from below, the first one does nothing.

    Attributes:
        transmittance: [layer, ray, wavelength].
        source: Weights of the source functions at the stencil's altitudes, times the angle
            turned to the power 0, 1, 2, or to 0 where none is, [layer, power, stencil, ray,
            wavelength].
        turn: Angle at the centre between the ends of a layer [rad], [layer, ray].
        stencil_start: The lowest altitude of each layer's stencil. Static.
    """

    transmittance: Float[Array, "layer ray w"]
    source: Float[Array, "layer power stencil ray w"]
    turn: Float[Array, "layer ray"]
    stencil_start: tuple[int, ...] = eqx.field(static=True)


def streams(paths: Paths, altitude: Float[Array, " z"], polar: int) -> Streams:
    """The shared rays.

    Args:
        paths: The geometry.
        altitude: Increasing [m], the first next to the ground.
        polar: How many of them meet the ground. Static.
    """
    dtype = altitude.dtype
    u, w = (jnp.asarray(x, dtype) for x in gauss_nodes(polar))
    at_ground, weight = (u**2)[None, :], (2 * u * w)[None, :]
    z = altitude[:, None]
    if not isinstance(paths, SphericalPaths):
        cosine = jnp.broadcast_to(at_ground, (altitude.size, polar))
        return Streams(
            cosine,
            jnp.broadcast_to(weight, cosine.shape),
            z / cosine,
            jnp.zeros((altitude.size - 1, polar), dtype),
            polar,
        )
    radius = paths.radius
    start = radius * at_ground
    rise = z * (2 * radius + z)
    root = jnp.sqrt(start**2 + rise)
    # Differences of the roots would lose the lowest layers in float32.
    distance = rise / (start + root)
    cosine = jnp.minimum(root / (radius + z), 1.0)
    weight = weight * (radius / (radius + z)) ** 2 * at_ground / cosine
    nearest = radius * jnp.sqrt((1 - at_ground) * (1 + at_ground))
    # The others pass at the height of one of the altitudes.
    pass_at = altitude[None, :-1:_LIMB_SPACING]
    beside = safe_sqrt(jnp.maximum(z - pass_at, 0.0) * (2 * radius + z + pass_at))
    limb = beside / (radius + z)
    distance = jnp.concatenate([distance, beside], axis=1)
    root = jnp.concatenate([root, beside], axis=1)
    nearest = jnp.concatenate([nearest, radius + pass_at], axis=1)
    across = nearest * jnp.diff(distance, axis=0)
    return Streams(
        jnp.concatenate([cosine, limb], axis=1),
        jnp.concatenate([weight, _limb_weights(limb)], axis=1),
        distance,
        jnp.arctan2(across, nearest**2 + root[:-1] * root[1:]),
        polar,
    )


def _limb_weights(cosine: Float[Array, "z ray"]) -> Float[Array, "z ray"]:
    """Trapezoids between the cosines at which the rays that pass below an altitude cross it.

    They fall from the edge of the ground; the last ray also stands for those up to the level.
    """
    altitudes, rays = cosine.shape
    exists = np.arange(altitudes)[:, None] >= _LIMB_SPACING * np.arange(rays)[None, :]
    next_exists = jnp.asarray(exists[:, 1:], cosine.dtype)
    falls = (cosine[:, :-1] - cosine[:, 1:]) / 2
    none = jnp.zeros_like(cosine[:, :1])
    toward_level = jnp.concatenate([falls * (2 - next_exists), cosine[:, -1:]], axis=1)
    return toward_level + jnp.concatenate([none, falls * next_exists], axis=1)


def layers(
    medium: Medium, paths: Paths, rays: Streams, altitude: Float[Array, " z"]
) -> tuple[Layers, Layers]:
    """What the layers do to light seen from below, and seen from above.

    A source function is interpolated between altitudes and weighted with the transmittance to
    the layer's end exactly, however thick the layer, with the extinction taken as exponential
    along the ray inside it.
    """
    z = jnp.broadcast_to(altitude[:, None], rays.cosine.shape)
    columns = jnp.stack(
        [paths.rising_column(profile, z, rays.cosine) for profile in medium.profiles], axis=-1
    )
    between = jnp.maximum(columns[:-1] - columns[1:], 0.0)
    reached = rays.reached[:-1, :, None]
    depth = jnp.where(reached, between, 0.0) @ medium.extinction
    density = jnp.stack([p.density(altitude) for p in medium.profiles], axis=-1)
    extinction = density @ medium.extinction
    # Of layers that hold next to nothing the slope would be lost among numbers of any size.
    faint = _FAINTEST * jax.lax.stop_gradient(jnp.max(extinction, axis=0)) + _NOTHING
    log_extinction = jnp.log(extinction + faint[None, :])
    growth = jnp.clip(jnp.diff(log_extinction, axis=0), -_STEEPEST, _STEEPEST)
    growth = jnp.where(jnp.abs(growth) < _STRAIGHTEST, _STRAIGHTEST, growth)
    place, near = _places(rays, paths, medium.scale)
    powers = 3 if paths.curved else 1
    turn = jnp.where(rays.reached[:-1], rays.turn, 0.0)
    start = _stencil_start(altitude.size).tolist()
    below = _seen(rays, depth, growth, place, near, powers, from_above=False)
    above = _seen(rays, depth, growth, place, near, powers, from_above=True)
    # From beyond the highest altitude comes what its source function, the last of the stencil,
    # sends through all that lies above.
    beyond = (
        jnp.zeros_like(below[:1]).at[0, 0, -1].set(-jnp.expm1(-columns[-1] @ medium.extinction))
    )
    through, still = jnp.exp(-depth), jnp.zeros_like(turn[:1])
    upward = Layers(
        jnp.concatenate([through, jnp.zeros_like(through[:1])]),
        jnp.concatenate([below, beyond]),
        jnp.concatenate([turn, still]),
        (*start, start[-1]),
    )
    downward = Layers(
        jnp.concatenate([jnp.ones_like(through[:1]), through]),
        jnp.concatenate([jnp.zeros_like(above[:1]), above]),
        jnp.concatenate([still, turn]),
        (start[0], *start),
    )
    return upward, downward


def carried(
    rays: Streams, upward: Layers, downward: Layers
) -> tuple[Float[Array, "ray w i j"], ...]:
    """What arrives at every place of a ray from every place, by power of the angle turned.

    The places are all altitudes, for light that comes from above, then all again for light that
    comes from below; the last source is light of 1 from the ground.
    """
    altitudes, (count, wavelengths) = rays.cosine.shape[0], upward.transmittance.shape[1:]
    places = np.eye(2 * altitudes + 1)
    above, below = (
        jnp.asarray(places[k * altitudes :][:altitudes], rays.turn.dtype) for k in (0, 1)
    )
    dark = jnp.zeros((count, wavelengths, 2 * altitudes + 1), rays.turn.dtype)
    powers = upward.source.shape[1]
    end, down = _through(upward, above, (dark,) * powers, reverse=True)
    # What passes the lowest point goes on; from the ground comes nothing but its own light.
    grounded = (np.arange(count) < rays.to_ground)[:, None, None]
    lit = dark.at[..., -1].set(1.0)
    start = tuple(
        jnp.where(grounded, dark if power else lit, each) for power, each in enumerate(end)
    )
    _, up = _through(downward, below, start, reverse=False)
    both = (jnp.concatenate(each) for each in zip(down, up, strict=True))
    return tuple(jnp.moveaxis(each, 0, 2) for each in both)


def _through(
    each: Layers, source: Float[Array, "z j"], start: tuple[Reals, ...], reverse: bool
) -> tuple[tuple[Reals, ...], tuple[Float[Array, "z ray w j"], ...]]:
    """Layer by layer: the last light and all of it, by power of the angle turned so far."""

    def one(
        light: tuple[Reals, ...], layer: tuple[Reals, Reals, Reals, Index]
    ) -> tuple[tuple[Reals, ...], tuple[Reals, ...]]:
        transmittance, weight, turn, first = layer
        stencil = jax.lax.dynamic_slice_in_dim(source, first, weight.shape[1])
        turn = turn[:, None, None]
        moved = list(light)
        if len(light) > 1:
            moved[1] = light[1] + turn * light[0]
            moved[2] = light[2] + turn * (2 * light[1] + turn * light[0])
        new = tuple(
            transmittance[..., None] * before + jnp.einsum("prw,pj->rwj", weight[k], stencil)
            for k, before in enumerate(moved)
        )
        return new, new

    low = jnp.asarray(each.stencil_start, jnp.int32)
    layer = (each.transmittance, each.source, each.turn, low)
    return jax.lax.scan(one, start, layer, reverse=reverse)


def _stencil_start(altitudes: int) -> np.ndarray:
    """The lowest altitude of each layer's stencil."""
    return np.clip(np.arange(altitudes - 1) - 1, 0, altitudes - _STENCIL)


def _places(
    rays: Streams, paths: Paths, scale: Reals
) -> tuple[Float[Array, "z ray"], Float[Array, " ray"]]:
    """Coordinate in which a source is smooth along a ray, and the distance on which it changes."""
    grounded = rays.cosine[0, : rays.to_ground]
    near = scale / grounded
    if isinstance(paths, SphericalPaths):
        passing = rays.distance.shape[1] - rays.to_ground
        rise, start = scale * (2 * paths.radius + scale), paths.radius * grounded
        near = rise / (start + jnp.sqrt(start**2 + rise))
        limb = jnp.broadcast_to(jnp.sqrt(rise), (passing,))
        near = jnp.concatenate([near, limb])
    return jnp.log1p(rays.distance / near[None, :]), near


def _seen(
    rays: Streams,
    depth: Float[Array, "layer ray w"],
    growth: Float[Array, "layer w"],
    place: Float[Array, "z ray"],
    near: Float[Array, " ray"],
    powers: int,
    from_above: bool,
) -> Float[Array, "layer power stencil ray w"]:
    """Weights of the sources in layers that are seen from one end."""
    dtype = depth.dtype
    y, weight = (jnp.asarray(x, dtype)[:, None, None, None] for x in gauss_nodes(_LAYER_NODES))
    opaque = -jnp.expm1(-depth)
    thick = jnp.maximum(depth, _THINNEST)
    growth = (-growth if from_above else growth)[None, :, None, :]
    depth_share = -jnp.log1p(y * jnp.expm1(-thick)[None]) / thick[None]
    share = jnp.log1p(jnp.minimum(depth_share, 1.0) * jnp.expm1(growth)) / growth
    low, high = rays.distance[:-1, :, None], rays.distance[1:, :, None]
    begin, end = (high, low) if from_above else (low, high)
    here = jnp.log1p((begin[None] + share * (end - begin)[None]) / near[None, None, :, None])
    turned = share * rays.turn[None, :, :, None]
    index = _stencil_start(depth.shape[0] + 1)[:, None] + np.arange(_STENCIL)[None, :]
    nodes = jnp.moveaxis(place[index], 1, 0)  # [stencil, layer, ray]
    usable = np.moveaxis(rays.reached[index], 1, 0)
    basis = _lagrange(here, nodes, usable)
    weight = (
        weight
        * opaque[None]
        * jnp.where(rays.reached[:-1], 1.0, 0.0).astype(dtype)[None, ..., None]
    )
    weights = jnp.stack([weight * turned**power for power in range(powers)])
    return jnp.einsum("kqlrw,pqlrw->lkprw", weights, basis)


def _lagrange(
    x: Float[Array, "node layer ray w"],
    nodes: Float[Array, "stencil layer ray"],
    usable: np.ndarray,
) -> Float[Array, "stencil node layer ray w"]:
    """Lagrange polynomials through the usable ones of the nodes."""
    basis = []
    for p in range(_STENCIL):
        value = jnp.broadcast_to(
            jnp.where(usable[p], 1.0, 0.0).astype(x.dtype)[None, ..., None], x.shape
        )
        for r in range(_STENCIL):
            if r != p:
                both = usable[p] & usable[r]
                apart = jnp.where(both, nodes[p] - nodes[r], 1.0)[None, ..., None]
                factor = (x - nodes[r][None, ..., None]) / apart
                value = value * jnp.where(both[None, ..., None], factor, 1.0)
        basis.append(value)
    return jnp.stack(basis)
