"""The light that is about to be scattered once more.

At every altitude and local solar zenith angle, single-scattered radiance is computed in all
directions, exactly, and kept as moments of the spherical harmonics; the orders above it are added
(`sky.orders`). No sun and no view direction is needed: all of them share these tables.

A forward peak that the moments do not resolve counts as light that goes straight on. Where all
orders are summed, the extinction leaves it out; where they are counted, it is followed along the
straight ways, of sunlight here and to the observer in `sky.look` (`sunlight.forward_factors`).
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.numerics import (
    batched_product,
    chebyshev_nodes,
    chebyshev_transform,
    harmonics,
    safe_sqrt,
)
from atmofit.optics.medium import Medium
from atmofit.sky.fan import Fan, fan_at
from atmofit.sky.orders import Light, all_higher_orders, next_orders, transport
from atmofit.sky.paths import Paths, Point, stretched
from atmofit.sky.plan import Plan
from atmofit.sky.sun_angles import TWILIGHT_WIDTH, SunRange, sun_ends, sun_nodes
from atmofit.sky.sunlight import path_integrals, sun_columns
from atmofit.typing import Reals, Scalar

_TWILIGHT_BEGINS = math.radians(0.5)
_TWILIGHT_EDGE = math.radians(1.0)
_TWILIGHT_FALL = math.log(10) / math.radians(3.0)
_MODES_AT_ONCE = 4  # azimuth modes that share a matrix product
_DARKEST = 1e-12  # of the brightest place; below, there is nothing worth following
_DARK = 1e-15  # nor below this radiance over solar irradiance [1/sr]


class ModeBlock(eqx.Module):
    """What each scatterer sends out again, for a few azimuth modes.

    Attributes:
        sources: Arriving moments times scattering moments, as Chebyshev coefficients in altitude
            and sun, [mode, altitude * degree, wavelength, sun]; the degrees of one scatterer
            after those of another, from the block's first mode on, for below it there are none.
        first: The first mode. Static.
        degrees: How many of each scatterer's degrees there are, from 0 on. Static.
    """

    sources: Float[Array, "m k w sun"]
    first: int = eqx.field(static=True)
    degrees: tuple[int, ...] = eqx.field(static=True)


class Moments(eqx.Module):
    """The light that arrives at each point, about to be scattered, over the brightness.

    Attributes:
        blocks: Of azimuth modes.
        log_brightness: Coefficients of the logarithm of all tables' mean radiance over
            directions and suns, in units of solar irradiance, [altitude, wavelength]. In thick
            haze it falls by powers of ten to the ground; what is left after division by it and
            by `twilight` is smooth.
        top, scale: Of the altitude coordinate [m].
        local_suns: Range of local solar zenith angles [rad]. Static.
    """

    blocks: tuple[ModeBlock, ...]
    log_brightness: Float[Array, "z w"]
    top: Scalar
    scale: Scalar
    local_suns: SunRange = eqx.field(static=True)

    @property
    def modes(self) -> int:
        """Azimuth modes."""
        return self.blocks[-1].first + self.blocks[-1].sources.shape[0]

    @property
    def degrees(self) -> int:
        """Legendre moments."""
        return max(self.blocks[0].degrees)


def light_everywhere(medium: Medium, paths: Paths, plan: Plan) -> tuple[Moments, ...]:
    """Moments of the light that arrives everywhere, for every sun.

    Args:
        medium: Optical properties; at least one scatterer.
        paths: The geometry.
        plan: Orders and nodes; two orders or more. Static.

    Returns:
        One table of all orders; or of the first order, whose forward peak is met again in
        `look.single_scattering`, and of the sum of those above it, or of each.
    """
    nodes = plan.nodes
    dtype = medium.extinction.dtype
    unit = jnp.asarray((chebyshev_nodes(nodes.altitude) + 1) / 2, dtype)
    altitude, _ = stretched(unit, medium.top, medium.scale)
    suns = paths.local_suns(plan.suns)
    sun = sun_nodes(nodes.sun, suns)

    def at_altitude(z: Scalar) -> tuple[Light, ...]:
        fan = fan_at(paths, z, medium.top, medium.scale, nodes)
        return _light_at(medium, paths, z, fan, sun, plan)

    injected = jax.lax.map(jax.checkpoint(at_altitude), altitude)
    injected = tuple(Light(each.moments, each.irradiance[0]) for each in injected)
    first = injected[0].moments
    higher = _higher_orders(medium, paths, altitude, injected, plan)
    if isinstance(plan.orders, str):
        every, whole = [_added(first, higher[0])], [False]
    else:
        if not plan.by_order and higher:
            higher = [sum(higher[1:], higher[0])]
        every, whole = [first, *higher], [False] + [True] * len(higher)
    if plan.zenith_only:
        every = [moments[:, :1] for moments in every]
    brightness = sum((moments[:, 0, 0] for moments in every[1:]), every[0][:, 0, 0])
    # Of a sum that has not converged, in haze too thick for the plan, some are negative.
    brightness = jnp.abs(brightness).mean(axis=-1)
    dimming = twilight(paths, altitude[:, None], jnp.asarray(sun, dtype)[None, :])
    return tuple(
        _table(moments, brightness, dimming, medium, suns, both)
        for moments, both in zip(every, whole, strict=True)
    )


def _higher_orders(
    medium: Medium, paths: Paths, altitude: Reals, injected: tuple[Light, ...], plan: Plan
) -> list[Reals]:
    """Moments of each order above the first, or of their sum if all are asked for."""
    if plan.orders == 2:
        return []
    nodes = plan.nodes
    degrees, modes = nodes.higher_degrees, nodes.higher_modes
    suns = paths.local_suns(plan.suns)
    step = transport(medium, paths, altitude, nodes, suns, plan.counts_peaks)
    begin = tuple(Light(each.moments[:, :modes, :degrees], each.irradiance) for each in injected)
    if isinstance(plan.orders, str):
        return [all_higher_orders(step, begin[0], nodes.steps).moments]
    return [light.moments for light in next_orders(step, begin, plan.arriving_orders)[1:]]


def _added(whole: Reals, part: Reals) -> Reals:
    """Moments plus those of fewer degrees and modes."""
    _, modes, degrees, _, _ = part.shape
    return whole.at[:, :modes, :degrees].add(part)


def _table(
    moments: Float[Array, "z m l w sun"],
    brightness: Float[Array, "z w"],
    dimming: Float[Array, "z sun"],
    medium: Medium,
    local_suns: SunRange,
    whole: bool,
) -> Moments:
    """Chebyshev coefficients of moments over brightness, and of the logarithm of brightness."""
    dtype = moments.dtype
    to_altitude = jnp.asarray(chebyshev_transform(moments.shape[0]), dtype)
    to_sun = jnp.asarray(chebyshev_transform(moments.shape[4]), dtype)
    brightest = brightness.max(axis=0, keepdims=True)
    # In the dark, what is absent but could shine would make slopes overflow.
    brightness = jnp.maximum(brightness, _DARKEST * brightest + _DARK)
    # One after the other, since their product may be too small to divide by.
    relative = moments / brightness[:, None, None, :, None]
    relative = relative / dimming[:, None, None, None, :]
    coefficients = jnp.tensordot(to_altitude, relative @ to_sun.T, 1)
    logarithm = to_altitude @ jnp.log(brightness)
    blocks = _blocks(coefficients, medium, whole)
    return Moments(blocks, logarithm, medium.top, medium.scale, local_suns)


def _blocks(
    coefficients: Float[Array, "z m l w sun"], medium: Medium, whole: bool
) -> tuple[ModeBlock, ...]:
    """What each scatterer makes of moments, a few azimuth modes at a time."""
    modes, count = coefficients.shape[1:3]
    strength = medium.moments(count, whole)
    degrees = tuple(count if p.degree is None else min(count, p.degree + 1) for p in medium.phases)
    blocks = []
    for first in range(0, modes, _MODES_AT_ONCE):
        part = coefficients[:, first : first + _MODES_AT_ONCE]
        sources = jnp.concatenate(
            [
                part[:, :, first:end] * strength[c, first:end][None, None, ..., None]
                for c, end in enumerate(degrees)
                if end > first
            ],
            axis=2,
        )
        sources = jnp.moveaxis(sources, 0, 1)
        sources = sources.reshape(part.shape[1], -1, *sources.shape[3:])
        blocks.append(ModeBlock(sources, first, degrees))
        if max(degrees) <= first + _MODES_AT_ONCE:
            break  # nothing is scattered into further modes
    return tuple(blocks)


def twilight(paths: Paths, altitude: Reals, sun: Reals) -> Reals:
    """Roughly how light falls with the sun below its horizon, 1 above it.

    Half a degree beyond, by a third of a power of ten for each degree: what is left of a clear
    twilight after division by it varies little.

    Args:
        paths: The geometry.
        altitude: [m].
        sun: Local solar zenith angle [rad]. Both broadcast.
    """
    dip = jnp.arcsin(jnp.maximum(-paths.horizon_cosine(altitude), 0.0))
    beyond = sun - math.pi / 2 - dip - _TWILIGHT_BEGINS
    return jnp.exp(-_TWILIGHT_FALL * jax.nn.softplus(beyond / _TWILIGHT_EDGE) * _TWILIGHT_EDGE)


def sun_place(sun: Reals, suns: SunRange) -> Reals:
    """Coordinate from -1 to 1 of a solar zenith angle [rad], stretched about the horizon."""
    low, high = sun_ends(suns)
    stretch = jnp.arcsinh((sun - math.pi / 2) / TWILIGHT_WIDTH)
    return jnp.clip(2 * (stretch - low) / (high - low) - 1, -1.0, 1.0)


def _light_at(
    medium: Medium, paths: Paths, z: Scalar, fan: Fan, sun: np.ndarray, plan: Plan
) -> tuple[Light, ...]:
    """Light of sunlight scattered once, for every term of `forward_factors`."""
    dtype, nodes = z.dtype, plan.nodes
    azimuth = math.pi * (np.arange(nodes.azimuth) + 0.5) / nodes.azimuth
    sine = safe_sqrt(1 - fan.cosine**2)
    cos_sun, sin_sun = (jnp.asarray(f(sun), dtype)[None, None, :] for f in (np.cos, np.sin))
    ahead = jnp.asarray(np.cos(azimuth), dtype)[:, None, None]
    cosine = fan.cosine[None, :, None] * cos_sun + sine[None, :, None] * (ahead * sin_sun)
    # Rays and suns share an axis: long loops are fast ones.
    cosine = jnp.clip(cosine, -1.0, 1.0).reshape(azimuth.size, -1)
    phases = medium.smooth_phase_functions(cosine, nodes.degrees)
    bend, spread = _bend(paths, azimuth, nodes.bend)
    to_azimuth = jnp.asarray(spread, dtype)
    modes = np.arange(plan.modes)[:, None]
    to_modes = np.cos(modes * azimuth[None, :]) * 2 * math.pi / nodes.azimuth
    onto = harmonics(fan.cosine, sine, nodes.degrees, plan.modes) * fan.weight[:, None, None]
    onto = jnp.transpose(onto, (2, 1, 0))
    down = jnp.maximum(fan.cosine, 0.0) * fan.weight

    def light(gathered: Reals, from_ground: Reals | None) -> Light:
        parts = [
            phase * _at_azimuths(to_azimuth, part)
            for phase, part in zip(phases, gathered, strict=True)
        ]
        radiance = sum(parts[1:], parts[0])
        radiance = radiance.reshape(*radiance.shape[:2], fan.cosine.size, sun.size)
        if from_ground is not None:
            reflected = _at_azimuths(to_azimuth, from_ground)
            reflected = reflected.reshape(*reflected.shape[:2], fan.to_ground, sun.size)
            radiance = radiance.at[:, :, -fan.to_ground :].add(reflected)
        in_modes = jnp.tensordot(jnp.asarray(to_modes, dtype), radiance, 1)
        return Light(
            batched_product(onto, jnp.swapaxes(in_modes, 1, 2), 1),
            jnp.einsum("r,wrs->ws", down, in_modes[0]),
        )

    return tuple(light(*each) for each in _along_rays(medium, paths, z, fan, sun, bend, plan))


def _at_azimuths(
    to_azimuth: Float[Array, "azimuth b"], part: Float[Array, "b w p"]
) -> Float[Array, "azimuth w p"]:
    """From the bends to all azimuths, term by term: the sum becomes part of a larger loop."""
    terms = [to_azimuth[:, b, None, None] * part[b][None] for b in range(part.shape[0])]
    return sum(terms[1:], terms[0])


def _bend(paths: Paths, azimuth: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines of azimuth at which rays are followed, and the way from there to all azimuths."""
    if not paths.curved:
        return np.zeros(1), np.ones((azimuth.size, 1))
    basis = np.cos(np.arange(count)[None, :] * azimuth[:, None])
    return chebyshev_nodes(count), basis @ chebyshev_transform(count)


def _along_rays(
    medium: Medium, paths: Paths, z: Scalar, fan: Fan, sun: np.ndarray, bend: np.ndarray, plan: Plan
) -> list[tuple[Reals, Reals | None]]:
    """Path integrals of density times sunlight for each scatterer, and light from the ground.

    [scatterer, bend, wavelength, ray * sun] and [bend, wavelength, ray * sun], without phase
    function and scattering optical depth; one pair for every term of `forward_factors`.
    """
    cosine = fan.cosine[:, None]
    start = jnp.broadcast_to(z, cosine.shape)
    point = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), fan.distance)
    weight = jnp.stack([fan.length * p.density(point.altitude) for p in medium.scattering_profiles])
    gathered = _sunlight(medium, paths, start, cosine, point, sun, bend, plan, weight)
    albedo = medium.ground_albedo
    if albedo is None:
        return [(each, None) for each in gathered]
    cosine, start = cosine[-fan.to_ground :], start[-fan.to_ground :]
    length = paths.length_to_ground(start, cosine)
    floor = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), length)
    at_floor = _sunlight(medium, paths, start, cosine, floor, sun, bend, plan, None)
    return [
        (each, lit[0] * (albedo / math.pi)[None, :, None])
        for each, lit in zip(gathered, at_floor, strict=True)
    ]


def _sunlight(
    medium: Medium,
    paths: Paths,
    start: Float[Array, "r 1"],
    cosine: Float[Array, "r 1"],
    point: Point,
    sun: np.ndarray,
    bend: np.ndarray,
    plan: Plan,
    weight: Float[Array, "scatterer r q"] | None,
) -> tuple[Float[Array, "scatterer b w p"], ...]:
    """Sunlight that comes along rays from weighted points; None: as irradiance of the ground."""
    dtype = cosine.dtype
    up, ahead = (values.T[:, None, :, None] for values in (point.turn_cosine, point.turn_sine))
    cos_sun, sin_sun = (jnp.asarray(f(sun), dtype)[None, None, None] for f in (np.cos, np.sin))
    bent = jnp.asarray(bend, dtype)[None, :, None, None]
    sun_cosine = cos_sun * up + sin_sun * (bent * ahead)  # [q, b, r, s]
    altitude = point.altitude.T[:, None, :, None]
    toward_sun, is_up = sun_columns(medium, paths, altitude, sun_cosine)
    sine = safe_sqrt(1 - cosine**2)
    toward_start = jnp.stack(
        [paths.column_between(p, start, cosine, sine, point).T for p in medium.profiles], axis=1
    )
    columns = toward_sun + toward_start[:, :, None, :, None]
    if weight is None:
        each = (jnp.maximum(sun_cosine, 0.0) * is_up)[:, None]
    else:
        each = jnp.moveaxis(weight, -1, 0)[:, :, None, :, None] * is_up[:, None]
    columns, each, toward_sun = (
        values.reshape(*values.shape[:3], -1) for values in (columns, each, toward_sun)
    )
    peaks = plan.arriving_orders if medium.peaks is not None and plan.counts_peaks else 1
    return path_integrals(medium, columns, each, peaks, toward_sun)
