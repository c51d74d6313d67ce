"""From one order of scattering to the next: the light everywhere, for every sun."""

from collections.abc import Sequence
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
from atmofit.sky.streams import Streams, carried, layers, streams
from atmofit.sky.sun_angles import SunRange
from atmofit.sky.turning import turns
from atmofit.typing import Reals

_PARALLEL = 10.0  # squares this many roundings of the whole count as nothing
_TRACE = 1e-6  # extinction over the largest, below which slopes of its kind are damped
_DIM = 1e-12  # light over solar irradiance [1/sr]; slopes of shares of less would overflow


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

    A ray has two sides: looking up along it, light comes from above, looking down, from below.
    The places on it are all altitudes on the one side, then all on the other. Even azimuth modes
    are kept apart from odd ones, and share an axis with the suns.

    Attributes:
        rays: Shared by all altitudes.
        onto: Spherical harmonics of the rays' directions on both sides,
            [altitude, mode, side * ray, degree].
        carried: What arrives at each place of the source function at every place, and of light
            from the ground, times the angle turned on the way to the power 0, 1 and 2, or 0 where
            none is, [ray, wavelength, place, place + ground].
        strength: Scattering over extinction times Legendre moments,
            [altitude, degree, wavelength].
        albedo: Of the ground, [wavelength], or None.
        turning: What light weighted with the angle turned, or with its square, adds as seen with
            the local sun, see `turns`; for even and for odd modes, [mode * sun, mode * sun].
        turned: Parity and power of what each of these turns; empty where nothing turns. Static.
    """

    rays: Streams
    onto: Float[Array, "z m sideray l"]
    carried: tuple[Float[Array, "ray w i j"], ...]
    strength: Float[Array, "z l w"]
    albedo: Float[Array, " w"] | None
    turning: tuple[tuple[Reals, ...], ...]
    turned: tuple[tuple[tuple[int, int], ...], ...] = eqx.field(static=True)

    def __call__(self, light: Light) -> Light:
        """The next order."""
        source = light.moments * self.strength[:, None, :, :, None]
        parities = (0, 1)
        on_rays = [self._onto_rays(source[:, p::2], self.onto[:, p::2]) for p in parities]
        if self.albedo is None:
            carried = [power[..., :-1] for power in self.carried]
        else:
            carried = self.carried
            reflected = self.albedo[:, None] * light.irradiance / np.pi
            on_rays = [_with_ground(each, reflected, p) for p, each in enumerate(on_rays)]
        arriving = [batched_product(carried[0], each, 2) for each in on_rays]
        for p, turned in enumerate(self._turned(carried, on_rays)):
            arriving[p] = arriving[p].at[..., : turned.shape[-1]].add(turned)
        # Summed before it is reordered: reordering reads far apart.
        arriving = jax.lax.optimization_barrier(arriving)
        parts = [self._onto_moments(each, self.onto[:, p::2]) for p, each in enumerate(arriving)]
        order = np.argsort(np.concatenate([np.arange(source.shape[1])[p::2] for p in parities]))
        weight = (2 * np.pi * self.rays.weight * self.rays.cosine)[0]
        down = arriving[0][:, :, 0, : light.irradiance.shape[-1]]
        return Light(jnp.concatenate(parts, axis=1)[:, order], jnp.tensordot(weight, down, 1))

    def _turned(
        self, carried: Sequence[Reals], on_rays: list[Reals]
    ) -> list[Float[Array, "ray w place p"]]:
        """What turning adds to the first even and to the first odd modes; nothing in flat air."""
        weighted, added = {}, []
        for matrices, kinds in zip(self.turning, self.turned, strict=True):
            parts = []
            for matrix, (of, power) in zip(matrices, kinds, strict=True):
                if (of, power) not in weighted:
                    those = on_rays[of][..., : matrix.shape[0]]
                    weighted[of, power] = batched_product(carried[power], those, 2)
                parts.append(weighted[of, power] @ matrix)
            added.append(sum(parts[1:], parts[0]))
        return added

    def _onto_rays(
        self, source: Float[Array, "z m l w sun"], onto: Float[Array, "z m sideray l"]
    ) -> Float[Array, "ray w place p"]:
        """The source function at all places of all rays."""
        z, modes, both, _ = onto.shape
        each = batched_product(onto, source, 2).reshape(z, modes, 2, both // 2, *source.shape[3:])
        each = jnp.transpose(each, (3, 4, 2, 0, 1, 5))
        return each.reshape(*each.shape[:2], 2 * z, -1)

    def _onto_moments(
        self, arriving: Float[Array, "ray w place p"], onto: Float[Array, "z m sideray l"]
    ) -> Float[Array, "z m l w sun"]:
        """Moments of the light at all places of all rays."""
        z, modes, _, _ = onto.shape
        each = arriving.reshape(*arriving.shape[:2], 2, z, modes, -1)
        each = jnp.transpose(each, (3, 4, 2, 0, 1, 5))
        each = each.reshape(z, modes, -1, *each.shape[4:])
        weight = jnp.concatenate([self.rays.weight, self.rays.weight], axis=1)
        weighted = onto * (2 * np.pi * weight)[:, None, :, None]
        return batched_product(jnp.swapaxes(weighted, -1, -2), each, 2)


def _with_ground(
    on_rays: Float[Array, "ray w place p"], reflected: Float[Array, "w sun"], parity: int
) -> Float[Array, "ray w more p"]:
    """Append light from the ground, which has no azimuth, after all places."""
    rays, wavelengths, _, size = on_rays.shape
    ground = jnp.zeros((wavelengths, size), on_rays.dtype)
    if parity == 0:
        ground = ground.at[:, : reflected.shape[1]].set(reflected)
    ground = jnp.broadcast_to(ground[None, :, None], (rays, wavelengths, 1, size))
    return jnp.concatenate([on_rays, ground], axis=2)


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
    density = jnp.stack([profile.density(altitude) for profile in medium.profiles])
    scattering = density[: len(medium.phases)]
    extinction = density.T @ medium.extinction
    strength = jnp.einsum("cz,clw->zlw", scattering, medium.moments(degrees, whole))
    sine = safe_sqrt((1 - rays.cosine) * (1 + rays.cosine))
    both = jnp.concatenate([rays.cosine, -rays.cosine], axis=1)
    functions = harmonics(both, jnp.concatenate([sine, sine], axis=1), degrees, modes)
    turning = turns(modes, nodes.sun, local_suns) if paths.curved else ()
    return Transport(
        rays,
        jnp.moveaxis(functions, -1, 1),
        carried(rays, *layers(medium, paths, rays, altitude)),
        _scattered_share(strength, extinction[:, None, :]),
        medium.ground_albedo,
        tuple(tuple(jnp.asarray(each.matrix, dtype) for each in some) for some in turning),
        tuple(tuple((each.of, each.power) for each in some) for some in turning),
    )


def _scattered_share(strength: Reals, extinction: Reals) -> Float[Array, "z l w"]:
    """Strength over extinction, 0 where there is none, with slopes that stay bounded aloft.

    Where next to nothing is, its kind changes at once with a trace of something else: a source
    function whose slope has no bound, though no light comes of it.
    """
    held = jax.lax.stop_gradient(safe_divide(strength, extinction))
    change = strength - held * extinction
    there = jax.lax.stop_gradient(extinction)
    least = _TRACE * there.max(axis=0, keepdims=True)
    there = jnp.maximum(there, jnp.where(least > 0, least, 1.0))
    return held + (change - jax.lax.stop_gradient(change)) / there


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
    share = _mixture([_in_units(light.moments, first.moments) for light in orders])
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


def _in_units(moments: Reals, of_first: Reals) -> Reals:
    """In units of the brightest, whose squares are numbers; without slopes where all is dark."""
    brightest = jax.lax.stop_gradient(jnp.abs(of_first).max(axis=(0, 1, 2), keepdims=True))
    unit = jnp.where(brightest > jnp.finfo(moments.dtype).tiny, brightest, 1.0)
    dark = brightest < _DIM
    return jnp.where(dark, jax.lax.stop_gradient(moments), moments) / unit


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
