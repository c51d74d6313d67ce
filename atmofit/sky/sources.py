"""The light that is about to be scattered once more.

At every altitude and local solar zenith angle, single-scattered radiance is computed in all
directions, exactly, and kept as moments of the spherical harmonics; the orders above it are added
(`sky.orders`). No sun and no view direction is needed: all of them share these tables.

A forward peak that the moments do not resolve counts as light that goes straight on. Where all
orders are summed, the extinction leaves it out; where they are counted, it is followed along the
straight ways, of sunlight here and to the observer in `sky.look` (`forward_factors`).
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.numerics import (
    chebyshev_nodes,
    chebyshev_transform,
    harmonics,
    safe_divide,
    safe_sqrt,
)
from atmofit.optics.medium import Medium
from atmofit.sky.fan import Fan, fan_at
from atmofit.sky.orders import Light, all_higher_orders, next_orders, transport
from atmofit.sky.paths import FlatPaths, Paths, Point, stretched
from atmofit.sky.plan import Plan
from atmofit.sky.sun_angles import TWILIGHT_WIDTH, SunRange, sun_ends, sun_nodes
from atmofit.typing import Reals, Scalar

_TWILIGHT_BEGINS = math.radians(0.5)
_TWILIGHT_EDGE = math.radians(1.0)
_TWILIGHT_FALL = math.log(10) / math.radians(3.0)
_DARKEST = 1e-12  # of the brightest place; below, there is nothing worth following


class Moments(eqx.Module):
    """Moments of the radiance that arrives at each point, as Chebyshev coefficients.

    Attributes:
        coefficients: [altitude, mode, degree, sun, wavelength], over the brightness.
        log_brightness: Coefficients of the logarithm of all tables' mean radiance over
            directions and suns, in units of solar irradiance, [altitude, wavelength]. In thick
            haze it falls by powers of ten to the ground; what is left after division by it and
            by `twilight` is smooth.
        top, scale: Of the altitude coordinate [m].
        local_suns: Range of local solar zenith angles [rad]. Static.
        whole: Whether the forward peaks take part in the next scattering. Static.
    """

    coefficients: Float[Array, "z m l sun w"]
    log_brightness: Float[Array, "z w"]
    top: Scalar
    scale: Scalar
    local_suns: SunRange = eqx.field(static=True)
    whole: bool = eqx.field(static=True)


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
        every = [moments[:, :, :, :1] for moments in every]
    brightness = sum((moments[:, :, 0, 0] for moments in every[1:]), every[0][:, :, 0, 0])
    brightness = brightness.mean(axis=-1)
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
    begin = tuple(Light(each.moments[:, :, :degrees, :modes], each.irradiance) for each in injected)
    if isinstance(plan.orders, str):
        return [all_higher_orders(step, begin[0], nodes.steps).moments]
    return [light.moments for light in next_orders(step, begin, plan.arriving_orders)[1:]]


def _added(whole: Reals, part: Reals) -> Reals:
    """Moments plus those of fewer degrees and modes."""
    _, _, degrees, modes, _ = part.shape
    return whole.at[:, :, :degrees, :modes].add(part)


def _table(
    moments: Float[Array, "z w l m sun"],
    brightness: Float[Array, "z w"],
    dimming: Float[Array, "z sun"],
    medium: Medium,
    local_suns: SunRange,
    whole: bool,
) -> Moments:
    """Chebyshev coefficients of moments over brightness, and of the logarithm of brightness."""
    values = jnp.transpose(moments, (0, 3, 2, 4, 1))
    dtype = values.dtype
    to_altitude = jnp.asarray(chebyshev_transform(values.shape[0]), dtype)
    to_sun = jnp.asarray(chebyshev_transform(values.shape[3]), dtype)
    brightest = brightness.max(axis=0, keepdims=True)
    brightness = jnp.maximum(brightness, _DARKEST * brightest + jnp.finfo(dtype).tiny)
    # Without any light, a tiny brightness would make slopes overflow.
    brightness = jnp.where(brightest <= 0, 1.0, brightness)
    # One after the other, since their product may be too small to divide by.
    relative = (
        safe_divide(values, brightness[:, None, None, None]) / dimming[:, None, None, :, None]
    )
    in_sun = jnp.einsum("zmlsw,ks->zmlkw", relative, to_sun)
    coefficients = jnp.einsum("zmlkw,jz->jmlkw", in_sun, to_altitude)
    logarithm = to_altitude @ jnp.log(brightness)
    return Moments(coefficients, logarithm, medium.top, medium.scale, local_suns, whole)


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
    cosine = _axis(np.cos(sun), 1, dtype) * fan.cosine[None, None, :, None]
    across = _axis(np.cos(azimuth), 0, dtype) * _axis(np.sin(sun), 1, dtype)
    cosine = jnp.clip(cosine + across * sine[None, None, :, None], -1.0, 1.0)[..., 0]
    phases = medium.smooth_phase_functions(cosine, nodes.degrees)
    bend, spread = _bend(paths, azimuth, nodes.bend)
    to_azimuth = jnp.asarray(spread, dtype)
    modes = np.arange(plan.modes)[:, None]
    to_modes = np.cos(modes * azimuth[None, :]) * 2 * math.pi / nodes.azimuth
    onto = harmonics(fan.cosine, sine, nodes.degrees, plan.modes) * fan.weight[:, None, None]
    down = jnp.maximum(fan.cosine, 0.0) * fan.weight

    def light(gathered: list[Reals], from_ground: Reals | None) -> Light:
        radiance = jnp.zeros((*cosine.shape, medium.wavelength_nm.size), dtype)
        for phase, part in zip(phases, gathered, strict=True):
            radiance = radiance + phase * jnp.tensordot(to_azimuth, part, 1)
        if from_ground is not None:
            reflected = jnp.tensordot(to_azimuth, from_ground, 1)
            radiance = radiance.at[:, :, -fan.to_ground :].add(reflected)
        in_modes = jnp.tensordot(jnp.asarray(to_modes, dtype), radiance, 1)
        return Light(
            jnp.einsum("rlm,msrw->wlms", onto, in_modes),
            jnp.einsum("r,srw->ws", down, in_modes[0]),
        )

    return tuple(light(*each) for each in _along_rays(medium, paths, z, fan, sun, bend, plan))


def _bend(paths: Paths, azimuth: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines of azimuth at which rays are followed, and the way from there to all azimuths."""
    if isinstance(paths, FlatPaths):
        return np.zeros(1), np.ones((azimuth.size, 1))
    basis = np.cos(np.arange(count)[None, :] * azimuth[:, None])
    return chebyshev_nodes(count), basis @ chebyshev_transform(count)


def _along_rays(
    medium: Medium, paths: Paths, z: Scalar, fan: Fan, sun: np.ndarray, bend: np.ndarray, plan: Plan
) -> list[tuple[list[Reals], Reals | None]]:
    """Path integrals of density times sunlight for each scatterer, and light from the ground.

    Each is [bend, sun, ray, wavelength], without phase function and scattering optical depth; one
    pair for every term of `forward_factors`.
    """
    cosine = fan.cosine[:, None]
    start = jnp.broadcast_to(z, cosine.shape)
    point = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), fan.distance)
    sunlight, _ = _sunlight(medium, paths, start, cosine, point, sun, bend, plan)
    weights = [fan.length * p.density(point.altitude) for p in medium.scattering_profiles]
    gathered = [
        [jnp.einsum("bsrqw,rq->bsrw", term, weight) for weight in weights] for term in sunlight
    ]
    albedo = medium.ground_albedo
    if albedo is None:
        return [(each, None) for each in gathered]
    cosine, start = cosine[-fan.to_ground :], start[-fan.to_ground :]
    length = paths.length_to_ground(start, cosine)
    floor = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), length)
    at_floor, sun_cosine = _sunlight(medium, paths, start, cosine, floor, sun, bend, plan)
    reflected = jnp.maximum(sun_cosine, 0.0)[..., None] / math.pi * albedo[None, None, None, None]
    return [
        (each, (term * reflected)[..., 0, :]) for each, term in zip(gathered, at_floor, strict=True)
    ]


def _sunlight(
    medium: Medium,
    paths: Paths,
    start: Reals,
    cosine: Reals,
    point: Point,
    sun: np.ndarray,
    bend: np.ndarray,
    plan: Plan,
) -> tuple[tuple[Float[Array, "b s r q w"], ...], Float[Array, "b s r q"]]:
    """Transmittance from the sun to a point and on to the ray's start; the sun's local cosine.

    The transmittance times every term of `forward_factors`.
    """
    dtype = cosine.dtype
    sun_cosine = (
        _axis(np.cos(sun), 1, dtype) * point.turn_cosine[None, None]
        + _axis(np.sin(sun), 1, dtype) * _axis(bend, 0, dtype) * point.turn_sine[None, None]
    )
    here = jnp.broadcast_to(point.altitude[None, None], sun_cosine.shape)
    sine = safe_sqrt(1 - cosine**2)
    toward_sun, columns, up = [], [], jnp.ones_like(sun_cosine)
    for profile in medium.profiles:
        column, up = paths.sun_column(profile, here, sun_cosine)
        toward_sun.append(column)
        toward_start = paths.column_between(profile, start, cosine, sine, point)
        columns.append(column + toward_start[None, None])
    sunlight = jnp.exp(-(jnp.stack(columns, axis=-1) @ medium.extinction)) * up[..., None]
    deflected = medium.deflected(jnp.stack(toward_sun, axis=-1))
    if deflected is None or not plan.counts_peaks:
        return (sunlight,), sun_cosine
    terms = forward_factors(deflected, plan.arriving_orders)
    return tuple(sunlight * factor for factor in terms), sun_cosine


def _axis(values: np.ndarray, axis: int, dtype: jnp.dtype) -> Float[Array, "b s r q"]:
    """A NumPy vector along one of four axes."""
    shape = [1, 1, 1, 1]
    shape[axis] = values.size
    return jnp.asarray(values, dtype).reshape(shape)
