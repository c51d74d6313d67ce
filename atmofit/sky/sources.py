"""The light that is about to be scattered a second time.

At every altitude and local solar zenith angle, single-scattered radiance is computed in all
directions, exactly, and kept as moments of the spherical harmonics. No sun and no view direction
is needed: all of them share these tables.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.geometry import scattering_angle
from atmofit.numerics import (
    chebyshev_nodes,
    chebyshev_transform,
    gauss_nodes,
    harmonics,
    safe_divide,
    safe_sqrt,
)
from atmofit.optics.atmosphere import Medium
from atmofit.sky.paths import FlatPaths, Paths, Point, SphericalPaths, stretched
from atmofit.sky.plan import Nodes
from atmofit.typing import Reals, Scalar

_SUN_LIMIT = {True: math.pi / 2, False: math.radians(101.5)}  # flat or not: what a view ray meets
_DARKEST = 1e-12  # of the brightest altitude; below, there is nothing worth following
_TWILIGHT_WIDTH = math.radians(3.5)  # sun angles are dense within this of the horizon


class Moments(eqx.Module):
    """Moments of the radiance that arrives at each point, as Chebyshev coefficients.

    Attributes:
        coefficients: [altitude, mode, degree, sun, wavelength], over the brightness.
        log_brightness: Coefficients of the logarithm of the mean radiance over directions and
            suns, in units of solar irradiance, [altitude, wavelength]. In thick haze it falls by
            powers of ten to the ground; what is left after division is smooth.
        top, scale: Of the altitude coordinate [m].
        sun_limit: Largest local solar zenith angle [rad]. Static.
    """

    coefficients: Float[Array, "z m l sun w"]
    log_brightness: Float[Array, "z w"]
    top: Scalar
    scale: Scalar
    sun_limit: float = eqx.field(static=True)


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


def single_scattering_moments(medium: Medium, paths: Paths, nodes: Nodes) -> Moments:
    """Moments of the single-scattered light everywhere, for every sun.

    Args:
        medium: Optical properties; at least one scatterer.
        paths: The geometry.
        nodes: How many of everything. Static.
    """
    flat = isinstance(paths, FlatPaths)
    dtype = medium.extinction.dtype
    top, scale = medium.top, medium.scale
    unit = jnp.asarray((chebyshev_nodes(nodes.altitude) + 1) / 2, dtype)
    altitude, _ = stretched(unit, top, scale)
    sun = _sun_nodes(nodes.sun, _SUN_LIMIT[flat])

    def at_altitude(z: Scalar) -> Float[Array, "m l sun w"]:
        return _moments_at(medium, paths, z, _fan(paths, z, top, scale, nodes), sun, nodes)

    values = jax.lax.map(at_altitude, altitude)
    to_altitude = jnp.asarray(chebyshev_transform(nodes.altitude), dtype)
    to_sun = jnp.asarray(chebyshev_transform(nodes.sun), dtype)
    brightness = values[:, 0, 0].mean(axis=1)
    brightest = brightness.max(axis=0, keepdims=True)
    brightness = jnp.maximum(brightness, _DARKEST * brightest + jnp.finfo(dtype).tiny)
    # Without any light, a tiny brightness would make slopes overflow.
    brightness = jnp.where(brightest == 0, 1.0, brightness)
    relative = safe_divide(values, brightness[:, None, None, None, :])
    in_sun = jnp.einsum("zmlsw,ks->zmlkw", relative, to_sun)
    coefficients = jnp.einsum("zmlkw,jz->jmlkw", in_sun, to_altitude)
    logarithm = to_altitude @ jnp.log(brightness)
    return Moments(coefficients, logarithm, top, scale, _SUN_LIMIT[flat])


def sun_place(sun: Reals, limit: float) -> Reals:
    """Coordinate from -1 to 1 of a solar zenith angle [rad], stretched about the horizon."""
    low, high = (math.asinh((end - math.pi / 2) / _TWILIGHT_WIDTH) for end in (0.0, limit))
    stretch = jnp.arcsinh((sun - math.pi / 2) / _TWILIGHT_WIDTH)
    return jnp.clip(2 * (stretch - low) / (high - low) - 1, -1.0, 1.0)


def _sun_nodes(count: int, limit: float) -> np.ndarray:
    """Solar zenith angles [rad] at the Chebyshev nodes of `sun_place`."""
    low, high = (math.asinh((end - math.pi / 2) / _TWILIGHT_WIDTH) for end in (0.0, limit))
    unit = (chebyshev_nodes(count) + 1) / 2
    return math.pi / 2 + _TWILIGHT_WIDTH * np.sinh(low + (high - low) * unit)


def _fan(paths: Paths, z: Scalar, top: Scalar, scale: Scalar, nodes: Nodes) -> Fan:
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


def _moments_at(
    medium: Medium, paths: Paths, z: Scalar, fan: Fan, sun: np.ndarray, nodes: Nodes
) -> Float[Array, "m l sun w"]:
    """Moments of the light that arrives along all rays of the fan, for every sun."""
    dtype = z.dtype
    azimuth = math.pi * (np.arange(nodes.azimuth) + 0.5) / nodes.azimuth
    sine = safe_sqrt(1 - fan.cosine**2)
    angle = scattering_angle(
        jnp.arctan2(sine, fan.cosine)[None, None, :],
        jnp.asarray(azimuth, dtype)[:, None, None],
        jnp.asarray(sun, dtype)[None, :, None],
    )
    bend, spread = _bend(paths, azimuth, nodes.bend)
    gathered, from_ground = _along_rays(medium, paths, z, fan, sun, bend)
    to_azimuth = jnp.asarray(spread, dtype)
    radiance = jnp.zeros((*angle.shape, medium.wavelength_nm.size), dtype)
    for phase, part in zip(medium.phase_functions(angle), gathered, strict=True):
        radiance = radiance + phase * jnp.tensordot(to_azimuth, part, 1)
    if from_ground is not None:
        reflected = jnp.tensordot(to_azimuth, from_ground, 1)
        radiance = radiance.at[:, :, -fan.to_ground :].add(reflected)
    modes = np.arange(nodes.modes)[:, None]
    to_modes = np.cos(modes * azimuth[None, :]) * 2 * math.pi / nodes.azimuth
    in_modes = jnp.tensordot(jnp.asarray(to_modes, dtype), radiance, 1)
    y = harmonics(fan.cosine, sine, nodes.degrees, nodes.modes) * fan.weight[:, None, None]
    return jnp.einsum("rlm,msrw->mlsw", y, in_modes)


def _bend(paths: Paths, azimuth: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosines of azimuth at which rays are followed, and the way from there to all azimuths."""
    if isinstance(paths, FlatPaths):
        return np.zeros(1), np.ones((azimuth.size, 1))
    basis = np.cos(np.arange(count)[None, :] * azimuth[:, None])
    return chebyshev_nodes(count), basis @ chebyshev_transform(count)


def _along_rays(
    medium: Medium, paths: Paths, z: Scalar, fan: Fan, sun: np.ndarray, bend: np.ndarray
) -> tuple[list[Reals], Reals | None]:
    """Path integrals of density times sunlight for each scatterer, and light from the ground.

    Each is [bend, sun, ray, wavelength], without phase function and scattering optical depth.
    """
    cosine = fan.cosine[:, None]
    start = jnp.broadcast_to(z, cosine.shape)
    point = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), fan.distance)
    sunlight, _ = _sunlight(medium, paths, start, cosine, point, sun, bend)
    gathered = [
        jnp.einsum("bsrqw,rq->bsrw", sunlight, fan.length * profile.density(point.altitude))
        for profile in medium.scattering_profiles
    ]
    if medium.ground_albedo is None:
        return gathered, None
    cosine, start = cosine[-fan.to_ground :], start[-fan.to_ground :]
    length = paths.length_to_ground(start, cosine)
    floor = paths.advance(start, cosine, safe_sqrt(1 - cosine**2), length)
    sunlight, sun_cosine = _sunlight(medium, paths, start, cosine, floor, sun, bend)
    reflected = sunlight * jnp.maximum(sun_cosine, 0.0)[..., None] / math.pi
    return gathered, reflected[..., 0, :] * medium.ground_albedo[None, None, None, :]


def _sunlight(
    medium: Medium,
    paths: Paths,
    start: Reals,
    cosine: Reals,
    point: Point,
    sun: np.ndarray,
    bend: np.ndarray,
) -> tuple[Float[Array, "b s r q w"], Float[Array, "b s r q"]]:
    """Transmittance from the sun to a point and on to the ray's start; the sun's local cosine."""
    dtype = cosine.dtype
    sun_cosine = (
        _axis(np.cos(sun), 1, dtype) * point.turn_cosine[None, None]
        + _axis(np.sin(sun), 1, dtype) * _axis(bend, 0, dtype) * point.turn_sine[None, None]
    )
    here = jnp.broadcast_to(point.altitude[None, None], sun_cosine.shape)
    sine = safe_sqrt(1 - cosine**2)
    columns, up = [], jnp.ones_like(sun_cosine)
    for profile in medium.profiles:
        toward_sun, up = paths.sun_column(profile, here, sun_cosine)
        toward_start = paths.column_between(profile, start, cosine, sine, point)
        columns.append(toward_sun + toward_start[None, None])
    depth = jnp.stack(columns, axis=-1) @ medium.extinction
    return jnp.exp(-depth) * up[..., None], sun_cosine


def _axis(values: np.ndarray, axis: int, dtype: jnp.dtype) -> Float[Array, "b s r q"]:
    """A NumPy vector along one of four axes."""
    shape = [1, 1, 1, 1]
    shape[axis] = values.size
    return jnp.asarray(values, dtype).reshape(shape)
