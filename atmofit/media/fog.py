"""A layer of even fog under thin air, lit by the sun: Klassen (1987), sections 10 to 12.

The fog reaches from the ground to its top over a flat earth. Light is scattered once. The way of
sunlight in the fog changes linearly along the line of sight, so its integral has a closed form; the
paper takes that way as constant ("constant" below). Air of even density lies above and within.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.geometry import scattering_angle
from atmofit.numerics import mean_decay, safe_sqrt
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction, Rayleigh
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

LONGEST, HIGHEST = 1e6, 1e5  # [m]
EARTH_RADIUS = 6.371e6  # [m]
SUNLIGHT = ("exact", "constant", "diffuse")
EXTINCTION = {"thin": 15e-3, "dense": 40e-3}  # [1/m], the ends of the paper's range
_LEAST_COSINE = 1e-6


class FogLayer(eqx.Module):
    """Fog from altitude 0 to its top, and air up to another.

    Attributes:
        top: Of the fog [m].
        extinction: Of the droplets [1/m], by wavelength.
        scattering: Of the droplets [1/m].
        molecular_extinction: Of the air, all of it scattering [1/m].
        wavelength_nm: [nm].
        phase: Of the droplets.
        air_top: Altitude at which the even air ends [m], at least `top`.
    """

    top: Scalar = eqx.field(converter=scalar)
    extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    scattering: Float[Array, " w"] = eqx.field(converter=real_array)
    molecular_extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    wavelength_nm: Float[Array, " w"] = eqx.field(converter=real_array)
    phase: PhaseFunction
    air_top: Scalar = eqx.field(converter=scalar, default=8e3)


class FogTransfer(eqx.Module):
    """What fog and air do to light on a way.

    Attributes:
        transmittance: [-], [..., wavelength].
        in_scattered: Radiance that is added, in the unit of the irradiance per sr.
    """

    transmittance: Float[Array, "*path w"]
    in_scattered: Float[Array, "*path w"]


def fog_layer(density: str, top: RealsLike, wavelength_nm: RealsLike = (550.0,)) -> FogLayer:
    """Fog with the paper's constants, the same at all wavelengths, under air without effect.

    Args:
        density: "thin" (15 per km) or "dense" (40 per km).
        top: Altitude [m].
        wavelength_nm: [nm].

    Returns:
        The layer; its droplets absorb nothing and scatter with asymmetry 0.85, which is ours.

    Raises:
        ValueError: Another word, or a top out of range.
    """
    extinction = EXTINCTION[choice("density", density, tuple(EXTINCTION))]
    top = in_range("top", top, 0.0, 8e3, "m")
    wavelength = real_array(wavelength_nm)
    even = jnp.full_like(wavelength, extinction)
    none = jnp.zeros_like(wavelength)
    return FogLayer(top, even, even, none, wavelength, HenyeyGreenstein(0.85))


def _lit(b: Reals, start: Reals, length: Reals, upward: Reals, top: Reals, way: Reals) -> Reals:
    """Integral [m] of sunlight times transmittance along a length in an even medium.

    `way` is the sunlight's way per metre of height. From the brighter end nothing overflows.
    """
    first = b * (top - start) * way
    change = b * length * (1 - upward * way)
    from_brighter = jnp.minimum(first, first + change)
    return jnp.exp(-from_brighter) * length * mean_decay(jnp.abs(change))


def fog_transfer(
    fog: FogLayer,
    distance: RealsLike,
    view_zenith_angle: RealsLike,
    relative_azimuth: RealsLike,
    solar_zenith_angle: RealsLike,
    observer_altitude: RealsLike = 0.0,
    irradiance: RealsLike = 1.0,
    sunlight: str = "exact",
) -> FogTransfer:
    """Extinction and in-scattering along straight ways from an eye in, at the top of or above fog.

    Args:
        fog: The layer.
        distance: To what is seen [m], at least 0, infinity allowed; a way ends at the ground and,
            as the earth is round, after 1000 km.
        view_zenith_angle: 0 (up) to pi (down) [rad].
        relative_azimuth: 0 toward the sun [rad].
        solar_zenith_angle: 0 to pi/2 [rad].
        observer_altitude: Of the eye [m]. These five broadcast.
        irradiance: Of the sun above the air, a number or [wavelength].
        sunlight: "exact"; "constant": the paper's, whose way in the fog is that to the ground; or
            "diffuse", for a low sun: fog of constant radiance irradiance / (4 pi).

    Returns:
        Arrays with wavelength last.

    Raises:
        ValueError: An argument is out of range, or another word.

    References:
        Klassen (1987), equations 41 to 46, with the scattering angle of any azimuth.
    """
    choice("sunlight", sunlight, SUNLIGHT)
    far = jnp.minimum(real_array(distance), LONGEST)
    far = in_range("distance", far, 0.0, LONGEST, "m")
    view = angle_in_range("view_zenith_angle", view_zenith_angle, 0.0, math.pi)
    azimuth = in_range("relative_azimuth", relative_azimuth, -math.inf, math.inf, "rad")
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, math.pi / 2)
    eye = in_range("observer_altitude", observer_altitude, 0.0, HIGHEST, "m")
    dtype = jnp.result_type(far, view, azimuth, sun, eye)
    far, view, azimuth, sun, eye = (
        x.astype(dtype) for x in jnp.broadcast_arrays(far, view, azimuth, sun, eye)
    )
    light = real_array(irradiance).astype(dtype)
    return _transfer(fog, far, view, azimuth, sun, eye, light, sunlight)


@eqx.filter_jit
def _transfer(
    fog: FogLayer,
    far: Reals,
    view: Reals,
    azimuth: Reals,
    sun: Reals,
    eye: Reals,
    irradiance: Reals,
    sunlight: str,
) -> FogTransfer:
    """The kernel: air before the fog, fog, air behind it."""
    dtype = far.dtype
    up = jnp.sin(math.pi / 2 - view)
    way = 1 / jnp.maximum(jnp.sin(math.pi / 2 - sun), _LEAST_COSINE)
    steep = jnp.maximum(jnp.abs(up), _LEAST_COSINE)
    top, air_top = fog.top.astype(dtype), fog.air_top.astype(dtype)
    down = up < 0
    # An eye above the air sees as one where its way enters it.
    far = jnp.maximum(far - jnp.maximum(eye - air_top, 0.0) / steep, 0.0)
    eye = jnp.minimum(eye, air_top)
    # Where the way leaves what it is in: at the ground, or at the top of the air.
    end = jnp.minimum(far, jnp.where(down, eye, jnp.maximum(air_top - eye, 0.0)) / steep)
    to_top = jnp.abs(top - eye) / steep
    inside = eye <= top
    # The eye's own air, then the fog, then the air behind.
    before = jnp.where(inside, 0.0, jnp.where(down, jnp.minimum(to_top, end), end))
    in_fog = jnp.where(
        inside, jnp.where(down, end, jnp.minimum(to_top, end)), jnp.where(down, end - before, 0.0)
    )
    behind = end - before - in_fog

    def spread(x: Reals) -> Reals:
        return x[..., None]

    def by_wavelength(x: Array) -> Reals:
        return x.astype(dtype).reshape((1,) * far.ndim + x.shape)

    air, drops = by_wavelength(fog.molecular_extinction), by_wavelength(fog.extinction)
    both = air + drops
    angle = scattering_angle(view, azimuth, sun)
    wavelength = fog.wavelength_nm.astype(dtype)
    by_air = air * Rayleigh().at_wavelengths(angle, wavelength)
    by_fog = by_air + by_wavelength(fog.scattering) * fog.phase.at_wavelengths(angle, wavelength)

    u, w = spread(up), spread(way)
    start = spread(jnp.where(inside, eye, jnp.minimum(eye, top)))
    long = spread(in_fog)
    above_top = jnp.exp(-air * (air_top - top) * w)
    if sunlight == "exact":
        lit = above_top * _lit(both, start, long, u, top, w)
    elif sunlight == "constant":
        lit = above_top * jnp.exp(-both * top * w) * long * mean_decay(both * long)
    else:
        lit = long * mean_decay(both * long)
        by_fog = both / (4 * math.pi)
    passed_air, passed_fog = jnp.exp(-air * spread(before)), jnp.exp(-both * long)
    eye_air = _lit(air, spread(eye), spread(before), u, air_top, w)
    behind_air = _lit(air, jnp.zeros_like(start) + top, spread(behind), u, air_top, w)
    light = by_air * eye_air + passed_air * (by_fog * lit + passed_fog * by_air * behind_air)
    return FogTransfer(passed_air * passed_fog * jnp.exp(-air * spread(behind)), light * irradiance)


def apply_fog(
    image_radiance: RealsLike,
    fog: FogLayer,
    distance: RealsLike,
    *args: RealsLike,
    **more: RealsLike,
) -> Reals:
    """Put fog over an image whose distances are known.

    Args:
        image_radiance: [..., wavelength].
        fog: The layer.
        distance: [...], infinity where there is only sky [m].
        *args: As of `fog_transfer`.
        **more: As of `fog_transfer`.

    Returns:
        Radiance [..., wavelength].

    Raises:
        ValueError: As `fog_transfer`.

    References:
        Klassen (1987), section 12.
    """
    found = fog_transfer(fog, distance, *args, **more)  # pyright: ignore[reportArgumentType]
    return real_array(image_radiance).astype(found.transmittance.dtype) * found.transmittance + (
        found.in_scattered
    )


def sunlight_below(fog: FogLayer, altitude: RealsLike, solar_zenith_angle: RealsLike) -> Reals:
    """Transmittance of the way from the sun to places in the fog, [..., wavelength].

    Equation 40's exponent, and 47's with a minus before its last term.
    """
    z = real_array(altitude)[..., None]
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, math.pi / 2)
    way = 1 / jnp.maximum(jnp.sin(math.pi / 2 - sun), _LEAST_COSINE)[..., None]
    air, drops = fog.molecular_extinction, fog.extinction
    lead = (1,) * (max(z.ndim, way.ndim) - 1)
    air, drops = air.reshape(*lead, -1), drops.reshape(*lead, -1)
    return jnp.exp(-way * (air * (fog.air_top - z) + drops * (fog.top - z)))


def shell_path(
    thickness: RealsLike, zenith_angle: RealsLike, radius: float = EARTH_RADIUS
) -> Reals:
    """Length of a way from the ground through a layer around a round earth [m]."""
    t = in_range("thickness", thickness, 0.0, HIGHEST, "m")
    across = radius * jnp.sin(math.pi / 2 - real_array(zenith_angle))
    height = t * (2 * radius + t)
    return height / jnp.maximum(across + safe_sqrt(across**2 + height), 1e-3)


def _of_gray(
    extinction: Scalar,
    distance: Scalar,
    view_zenith_angle: Scalar,
    solar_zenith_angle: Scalar,
    observer_altitude: Scalar,
    sunlight: str,
) -> tuple[Reals, Reals]:
    """Transfer through gray fog 100 m thick, for the stability table."""
    b = extinction[None]
    air = jnp.full_like(b, 1e-5)
    fog = FogLayer(100.0, b, b, air, jnp.full_like(b, 550.0), HenyeyGreenstein(0.85))
    found = fog_transfer(
        fog,
        distance,
        view_zenith_angle,
        0.5,
        solar_zenith_angle,
        observer_altitude,
        sunlight=sunlight,
    )
    return found.transmittance, found.in_scattered


for _name in SUNLIGHT:
    extremes(
        Case("no way", {"distance": 0.0}, limit=(1.0, 0.0)),
        Case("level", {"view_zenith_angle": math.pi / 2}),
        Case("toward the sun's height", {"view_zenith_angle": 1.0, "solar_zenith_angle": 1.0}),
        Case("sun at the horizon", {"solar_zenith_angle": math.pi / 2}),
        Case("no fog", {"extinction": 0.0}),
        Case("optical depth 10000", {"extinction": 1.0, "distance": 1e4, "view_zenith_angle": 1.5}),
        Case("eye at the top", {"observer_altitude": 100.0}),
        Case("eye above, down", {"observer_altitude": 500.0, "view_zenith_angle": 3.0}),
        Case("as far as it goes", {"distance": LONGEST, "view_zenith_angle": math.pi / 2}),
        part=_name,
        call=lambda sunlight=_name, **at: _of_gray(sunlight=sunlight, **at),
        extinction=Span(0.0, 1.0),
        distance=Span(0.0, LONGEST),
        view_zenith_angle=Domain(0.0, math.pi),
        solar_zenith_angle=Domain(0.0, math.pi / 2),
        observer_altitude=Domain(0.0, HIGHEST),
    )(fog_transfer)
