"""From one order of scattering to the next: the light everywhere, for every sun."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.numerics import batched_product, harmonics, safe_divide, safe_sqrt
from atmofit.optics.medium import Medium
from atmofit.sky.ladder import Nodes
from atmofit.sky.paths import Paths
from atmofit.sky.streams import Layers, Streams, layers, streams
from atmofit.sky.sun_angles import SunRange
from atmofit.sky.turning import turning_matrix
from atmofit.typing import Reals

_PARALLEL = 10.0  # squares this many roundings of the whole count as nothing


class Light(NamedTuple):
    """One order of scattered light.

    Attributes:
        moments: Of the radiance that arrives at each altitude, over solar irradiance,
            [altitude, mode, degree, wavelength, sun].
        irradiance: Of the ground by it, over solar irradiance, [wavelength, sun].
    """

    moments: Float[Array, "z m l w sun"]
    irradiance: Float[Array, "w sun"]


class Transport(eqx.Module):
    """Takes one order of light to the next; depends on the medium, not on the light.

    Attributes:
        rays: Shared by all altitudes.
        upward: Layers of the light that comes from above, seen from below.
        downward: Layers of the light that comes from below, seen from above.
        strength: Scattering over extinction times Legendre moments,
            [altitude, degree, wavelength].
        above: Spherical harmonics of the rays' directions, seen upward,
            [altitude, mode, ray, degree].
        below: Likewise, seen downward.
        albedo: Of the ground, [wavelength], or None.
        turning: From the light weighted with the angle turned to the power 1 and 2, [mode * sun],
            to what it adds, [power, mode * sun, mode * sun]; None where the local sun does not
            turn along a ray.
    """

    rays: Streams
    upward: Layers
    downward: Layers
    strength: Float[Array, "z l w"]
    above: Float[Array, "z m ray l"]
    below: Float[Array, "z m ray l"]
    albedo: Float[Array, " w"] | None
    turning: Float[Array, "2 p p"] | None

    def __call__(self, light: Light) -> Light:
        """The next order."""
        source = light.moments * self.strength[:, None, :, :, None]
        down, at_ground = self._sweep(
            self.upward, self._onto_rays(self.above, source), None, reverse=True
        )
        start = self._from_ground(at_ground, light.irradiance)
        up, _ = self._sweep(
            self.downward, self._onto_rays(self.below, source), start, reverse=False
        )
        moments = self._onto_moments(self.above, down) + self._onto_moments(self.below, up)
        weight = (2 * np.pi * self.rays.weight * self.rays.cosine)[0]
        suns = light.irradiance.shape[-1]
        return Light(moments, jnp.tensordot(weight, down[0, :, :, :suns], 1))

    @staticmethod
    def _onto_rays(
        functions: Float[Array, "z m ray l"], source: Float[Array, "z m l w sun"]
    ) -> Float[Array, "z ray w p"]:
        """Light in the directions of all rays; modes and suns share an axis."""
        on_rays = jnp.moveaxis(batched_product(functions, source, 2), 1, 3)
        return on_rays.reshape(*on_rays.shape[:3], -1)

    def _onto_moments(
        self, functions: Float[Array, "z m ray l"], arriving: Float[Array, "z ray w p"]
    ) -> Float[Array, "z m l w sun"]:
        weighted = functions * (2 * np.pi * self.rays.weight)[:, None, :, None]
        arriving = arriving.reshape(*arriving.shape[:3], functions.shape[1], -1)
        return batched_product(jnp.swapaxes(weighted, -1, -2), jnp.moveaxis(arriving, 3, 1), 2)

    def _from_ground(
        self, end: tuple[Reals, ...], irradiance: Float[Array, "w sun"]
    ) -> tuple[Reals, ...]:
        """Light that begins to rise: the ground's, or what passed the lowest point."""
        grounded = self.rays.to_ground
        first, *others = (power.at[:grounded].set(0.0) for power in end)
        if self.albedo is not None:
            reflected = self.albedo[:, None] * irradiance / np.pi
            first = first.at[:grounded, :, : reflected.shape[1]].set(
                jnp.broadcast_to(reflected, (grounded, *reflected.shape))
            )
        return (first, *others)

    def _sweep(
        self,
        each: Layers,
        source: Float[Array, "z ray w p"],
        start: tuple[Reals, ...] | None,
        reverse: bool,
    ) -> tuple[Float[Array, "z ray w p"], tuple[Float[Array, "ray w p"], ...]]:
        """Layer by layer: light everywhere, as seen with the local sun, and the last of it.

        It is carried along by power of the angle turned since it was scattered: 0, 1 and 2.
        """
        powers = each.source.shape[1]
        low = jnp.asarray(each.stencil_start, jnp.int32)
        if start is None:
            start = (jnp.zeros_like(source[0]),) * powers

        def through(
            light: tuple[Reals, ...], layer: tuple[Reals, Reals, Reals, Reals]
        ) -> tuple[tuple[Reals, ...], tuple[Reals, ...]]:
            transmittance, weight, turn, first = layer
            stencil = jax.lax.dynamic_slice_in_dim(source, first, weight.shape[1])
            turn = turn[:, None, None]
            moved = list(light)
            if powers > 1:
                moved[1] = light[1] + turn * light[0]
                moved[2] = light[2] + turn * (2 * light[1] + turn * light[0])
            new = tuple(
                sum(
                    (weight[k, p][..., None] * stencil[p] for p in range(weight.shape[1])),
                    transmittance[..., None] * moved[k],
                )
                for k in range(powers)
            )
            return new, new

        end, light = jax.lax.scan(
            through, start, (each.transmittance, each.source, each.turn, low), reverse=reverse
        )
        if self.turning is None:
            return light[0], end
        turned = [
            power @ matrix
            for power, matrix in zip(light[1:], self.turning, strict=True)
        ]
        return sum(turned, light[0]), end


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
    dtype = altitude.dtype
    degrees, modes = nodes.higher_degrees, nodes.higher_modes
    rays = streams(paths, altitude, nodes.streams)
    upward, downward = layers(medium, paths, rays, altitude)
    density = jnp.stack([profile.density(altitude) for profile in medium.profiles])
    scattering = density[: len(medium.phases)]
    extinction = density.T @ medium.extinction
    strength = jnp.einsum("cz,clw->zlw", scattering, medium.moments(degrees, whole))
    sine = safe_sqrt((1 - rays.cosine) * (1 + rays.cosine))
    above, below = (
        jnp.moveaxis(harmonics(cosine, sine, degrees, modes), -1, 1)
        for cosine in (rays.cosine, -rays.cosine)
    )
    turning = None
    if paths.curved:
        matrix = turning_matrix(modes, nodes.sun, local_suns)
        size = modes * nodes.sun
        turning = jnp.asarray(np.swapaxes(matrix.reshape(2, size, size), 1, 2), dtype)
    return Transport(
        rays,
        upward,
        downward,
        safe_divide(strength, extinction[:, None, :]),
        above,
        below,
        medium.ground_albedo,
        turning,
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
            (share[k][None, None, None] * orders[k + 1].moments for k in range(1, steps)),
            share[0][None, None, None] * orders[1].moments,
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
        return (a * b).sum(axis=(0, 1, 2))

    def times(share: Reals, a: Reals) -> Reals:
        return share[None, None, None] * a

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
