"""From one order of scattering to the next: the light everywhere, for every sun."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.numerics import harmonics, safe_divide, safe_sqrt
from atmofit.optics.medium import Medium
from atmofit.sky.ladder import Nodes
from atmofit.sky.paths import Paths, SphericalPaths
from atmofit.sky.streams import Layers, Streams, layers, stencil_start, streams
from atmofit.sky.sun_angles import SunRange
from atmofit.sky.turning import turning_matrix
from atmofit.typing import Reals

Index = Int[Array, ""]
_POWERS = 3  # of the angle turned along a ray: 0, 1, 2
_PARALLEL = 10.0  # squares this many roundings of the whole count as nothing


class Light(NamedTuple):
    """One order of scattered light.

    Attributes:
        moments: Of the radiance that arrives at each altitude, over solar irradiance,
            [altitude, wavelength, degree, mode, sun].
        irradiance: Of the ground by it, over solar irradiance, [wavelength, sun].
    """

    moments: Float[Array, "z w l m sun"]
    irradiance: Float[Array, "w sun"]


class Transport(eqx.Module):
    """Takes one order of light to the next; depends on the medium, not on the light.

    Attributes:
        rays: Shared by all altitudes.
        upward: Layers of the light that comes from above, seen from below.
        downward: Layers of the light that comes from below, seen from above.
        above: One minus transmittance from the highest altitude to space, [wavelength, ray].
        strength: Scattering over extinction times Legendre moments,
            [altitude, wavelength, degree].
        functions: Spherical harmonics of the rays' directions, seen upward, then downward,
            [altitude, ray, degree, mode].
        albedo: Of the ground, [wavelength], or None.
        local_suns: Range of local solar zenith angles [rad]. Static.
        curved: Whether the local sun turns along a ray. Static.
    """

    rays: Streams
    upward: Layers
    downward: Layers
    above: Float[Array, "w ray"]
    strength: Float[Array, "z w l"]
    functions: Float[Array, "z rays l m"]
    albedo: Float[Array, " w"] | None
    local_suns: SunRange = eqx.field(static=True)
    curved: bool = eqx.field(static=True)

    def __call__(self, light: Light) -> Light:
        """The next order."""
        source = light.moments * self.strength[..., None, None]
        # Light by mode, in the directions of all rays: [z, w, rays, m, sun].
        source = jnp.einsum("zrlm,zwlms->zwrms", self.functions, source)
        count = self.rays.cosine.shape[1]
        from_above, at_ground = self._down(source[:, :, :count])
        from_below = self._up(source[:, :, count:], at_ground, light.irradiance)
        arriving = jnp.concatenate([self._turned(from_above), self._turned(from_below)], axis=2)
        weight = jnp.concatenate([self.rays.weight, self.rays.weight], axis=1)
        onto = 2 * np.pi * self.functions * weight[..., None, None]
        moments = jnp.einsum("zrlm,zwrms->zwlms", onto, arriving)
        down = (2 * np.pi * self.rays.weight * self.rays.cosine)[0]
        irradiance = jnp.einsum("r,wrs->ws", down, arriving[0, :, :count, 0])
        return Light(moments, irradiance)

    def _down(self, source: Reals) -> tuple[Reals, Reals]:
        """Light that comes from above: [power, z, w, ray, m, sun], and what reaches the ends."""
        start = jnp.zeros((_POWERS, *source.shape[1:]), source.dtype)
        start = start.at[0].set(source[-1] * self.above[..., None, None])
        end, passed = self._sweep(self.upward, source, start, reverse=True)
        return jnp.concatenate([passed, start[None]]), end

    def _up(self, source: Reals, end: Reals, irradiance: Float[Array, "w sun"]) -> Reals:
        """Light that comes from below: the ground's, or what passed the lowest point."""
        grounded = self.rays.to_ground
        start = end.at[:, :, :grounded].set(0.0)
        if self.albedo is not None:
            reflected = (self.albedo[:, None] * irradiance / np.pi)[:, None, :]
            start = start.at[0, :, :grounded, 0].set(
                jnp.broadcast_to(reflected, (source.shape[1], grounded, source.shape[-1]))
            )
        _, passed = self._sweep(self.downward, source, start, reverse=False)
        return jnp.concatenate([start[None], passed])

    def _sweep(
        self, each: Layers, source: Reals, start: Reals, reverse: bool
    ) -> tuple[Reals, Reals]:
        """Layer by layer."""
        count = source.shape[0]
        low = jnp.asarray(stencil_start(np.arange(count - 1), count), jnp.int32)
        turn = jnp.where(self.rays.reached[:-1], self.rays.turn, 0.0)

        def through(light: Reals, layer: tuple[Reals, Reals, Reals, Index]) -> tuple[Reals, Reals]:
            transmittance, weight, turn, first = layer
            stencil = jax.lax.dynamic_slice_in_dim(source, first, weight.shape[1])
            turn = turn[None, :, None, None]
            moved = (
                light[0],
                light[1] + turn * light[0],
                light[2] + turn * (2 * light[1] + turn * light[0]),
            )
            new = jnp.stack(
                [
                    transmittance[..., None, None] * moved[k]
                    + sum(
                        weight[k, p][..., None, None] * stencil[p] for p in range(weight.shape[1])
                    )
                    for k in range(_POWERS)
                ]
            )
            return new, new

        return jax.lax.scan(
            through, start, (each.transmittance, each.source, turn, low), reverse=reverse
        )

    def _turned(self, light: Reals) -> Reals:
        """[z, power, w, ray, m, sun] to [z, w, ray, m, sun], as seen with the local sun."""
        if not self.curved:
            return light[:, 0]
        modes, suns = light.shape[-2:]
        matrix = jnp.asarray(turning_matrix(modes, suns, self.local_suns), light.dtype)
        turned = jnp.einsum("zkwrms,knums->zwrnu", light[:, 1:], matrix)
        return light[:, 0] + turned


def transport(
    medium: Medium,
    paths: Paths,
    altitude: Float[Array, " z"],
    nodes: Nodes,
    local_suns: SunRange,
    whole: bool,
) -> Transport:
    """Prepare the steps from order to order.

    Args:
        medium: Optical properties.
        paths: The geometry.
        altitude: Where light is known [m], increasing.
        nodes: How many of everything. Static.
        local_suns: Range of local solar zenith angles [rad]. Static.
        whole: Whether forward peaks take part. Static.
    """
    rays = streams(paths, altitude, nodes.streams)
    upward, downward, above = layers(medium, paths, rays, altitude)
    density = jnp.stack([profile.density(altitude) for profile in medium.profiles])
    scattering = density[: len(medium.phases)]
    extinction = density.T @ medium.extinction
    strength = jnp.einsum("cz,clw->zwl", scattering, medium.moments(nodes.higher_degrees, whole))
    sine = safe_sqrt((1 - rays.cosine) * (1 + rays.cosine))
    both = jnp.concatenate([rays.cosine, -rays.cosine], axis=1)
    sines = jnp.concatenate([sine, sine], axis=1)
    return Transport(
        rays,
        upward,
        downward,
        -jnp.expm1(-above),
        safe_divide(strength, extinction[..., None]),
        harmonics(both, sines, nodes.higher_degrees, nodes.higher_modes),
        medium.ground_albedo,
        local_suns,
        isinstance(paths, SphericalPaths),
    )


def next_orders(step: Transport, injected: tuple[Light, ...], count: int) -> tuple[Light, ...]:
    """Light of so many orders.

    Args:
        step: From order to order.
        injected: What sunlight adds to each order; the first is the first order, and where they
            end, nothing more is added.
        count: How many orders. Static.
    """
    every = [injected[0]]
    for order in range(1, count):
        light = step(every[-1])
        if order < len(injected):
            light = jax.tree.map(jnp.add, light, injected[order])
        every.append(light)
    return tuple(every)


def all_higher_orders(step: Transport, first: Light, steps: int) -> Light:
    """Sum of all orders above the first, from a few of them.

    The sum S solves S = first + step(S). It is sought as a mixture of the orders computed, for
    each wavelength and sun the one that misses this by the least squares (a Krylov space, so that
    few orders do where successive ones fall slowly), and stepped once more.

    Args:
        step: From order to order.
        first: Light scattered once.
        steps: How many orders to compute above it. Static.
    """

    def add(light: Light, _: None) -> tuple[Light, Light]:
        new = jax.checkpoint(Transport.__call__)(step, light)
        return new, new

    _, higher = jax.lax.scan(add, first, None, length=steps)
    orders = [first, *(Light(higher.moments[k], higher.irradiance[k]) for k in range(steps))]
    share = _mixture([light.moments for light in orders])
    return Light(
        sum(
            (share[k][None, :, None, None, :] * orders[k + 1].moments for k in range(1, steps)),
            share[0][None, :, None, None, :] * orders[1].moments,
        ),
        sum(
            (share[k] * orders[k + 1].irradiance for k in range(1, steps)),
            share[0] * orders[1].irradiance,
        ),
    )


def _mixture(orders: list[Reals]) -> list[Float[Array, "w sun"]]:
    """Shares of all orders but the last whose sum solves S = first + step(S) best.

    A step takes each order to the next, so what the share of one adds to first is the difference
    of the two; these are made orthogonal one by one (Gram and Schmidt).
    """

    def dot(a: Reals, b: Reals) -> Float[Array, "w sun"]:
        return jnp.einsum("zwlms,zwlms->ws", a, b)

    def times(share: Reals, a: Reals) -> Reals:
        return share[None, :, None, None, :] * a

    count = len(orders) - 1
    basis, triangle, sought = [], [[jnp.zeros(())] * count for _ in range(count)], []
    rest = orders[0]
    for k in range(count):
        part = orders[k] - orders[k + 1]
        whole = dot(part, part)
        for i, other in enumerate(basis):
            triangle[i][k] = dot(other, part)
            part = part - times(triangle[i][k], other)
        square = dot(part, part)
        # What is left of nearly parallel ones is rounding.
        new = square > _PARALLEL * jnp.finfo(part.dtype).eps * whole
        length = jnp.sqrt(jnp.where(new, square, 1.0))
        part = times(jnp.where(new, 1 / length, 0.0), part)
        triangle[k][k] = length
        basis.append(part)
        sought.append(dot(part, rest))
        rest = rest - times(sought[k], part)
    share: list[Reals] = [jnp.zeros(())] * count
    for k in reversed(range(count)):
        known = sum(
            (triangle[k][j] * share[j] for j in range(k + 1, count)), jnp.zeros_like(sought[k])
        )
        share[k] = (sought[k] - known) / triangle[k][k]
    return share
