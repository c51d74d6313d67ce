"""Light through a layer of fog that the sun lights: Klassen (1987), sections 11 and 12.

The fog reaches from the ground to its top over a flat earth. Light is scattered once. The way of
sunlight in the fog changes linearly along the line of sight, so its integral has a closed form; the
paper takes that way as constant. Air of even density lies above and within.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.geometry import scattering_angle
from atmofit.media.fog_geometry import Piece, cut_way, sine_of_elevation
from atmofit.media.fog_medium import (
    ASYMMETRY,
    HIGHEST,
    LARGEST_EXTINCTION,
    FogLayer,
    spectrum_over,
)
from atmofit.numerics import mean_decay
from atmofit.optics.phase import HenyeyGreenstein, Rayleigh
from atmofit.typing import Reals, RealsLike, Scalar, real_array

LONGEST = 1e6  # [m]
SUNLIGHT = ("exact", "constant", "curved", "diffuse")


class FogTransfer(eqx.Module):
    """What fog and air do to light on a way.

    Attributes:
        transmittance: [-], [..., wavelength].
        in_scattered: Radiance that is added, in the unit of the irradiance per sr.
    """

    transmittance: Float[Array, "*path w"]
    in_scattered: Float[Array, "*path w"]


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
        observer_altitude: Of the eye [m], 0 to 100,000. These five broadcast.
        irradiance: Of the sun above the air, a number or [wavelength].
        sunlight: How the sun lights the fog. Static. "exact": over a flat earth. "constant": the
            paper's, with the way to the ground for every droplet. "curved": over a round earth,
            exact at both ends of each part of the way and linear in between, for a low sun.
            "diffuse": a fog of the same radiance everywhere (`diffuse_fog`), for a level sun.

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
    layer, light = fog.checked().in_dtype(dtype), real_array(irradiance)
    return _transfer(layer, far, view, azimuth, sun, eye, light, sunlight)


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
    """Air before the fog, fog, and air behind it, each behind what is nearer."""
    sine = sine_of_elevation(sun)
    pieces = cut_way(far, sine_of_elevation(view), eye, fog.top, fog.air_top)
    air, drops = fog.over(far)
    by_air, by_drops = _scattering(fog, scattering_angle(view, azimuth, sun))
    light = jnp.zeros_like(by_drops + air)
    passed = jnp.ones_like(light)
    for piece, foggy in zip(pieces, (False, True, False), strict=True):
        extinction = air + drops if foggy else air
        scattering = by_air + by_drops if foggy else by_air
        if foggy and sunlight == "diffuse":
            scattering = extinction / (4 * math.pi)
        first, last = _sun_depths(fog, piece, sine, sunlight, foggy)
        last = last + extinction * piece.length[..., None]
        light = light + passed * scattering * _lit(first, last, piece.length[..., None])
        passed = passed * jnp.exp(-extinction * piece.length[..., None])
    return FogTransfer(passed, light * spectrum_over(irradiance, far))


def _scattering(fog: FogLayer, angle: Reals) -> tuple[Reals, Reals]:
    """Coefficients per solid angle of air and of droplets [1/m/sr]."""
    air, drops = (spectrum_over(x, angle) for x in (fog.molecular_extinction, fog.scattering))
    by_air, by_drops = (x.at_wavelengths(angle, fog.wavelength_nm) for x in (Rayleigh(), fog.phase))
    return air * by_air, drops * by_drops


def _sun_depths(
    fog: FogLayer, piece: Piece, sine: Reals, sunlight: str, foggy: bool
) -> tuple[Reals, Reals]:
    """Optical depth from the sun to both ends of a part of the way."""
    curved = sunlight in ("curved", "diffuse")
    if foggy and sunlight in ("constant", "diffuse"):
        altitude = fog.top if sunlight == "diffuse" else jnp.zeros_like(fog.top)
        everywhere = jnp.zeros_like(piece.start) + altitude
        depth = fog.sun_depth(everywhere, sine, curved)
        return depth, depth
    start, end = (fog.sun_depth(x, sine, curved) for x in (piece.start, piece.end))
    return start, end


def _lit(first: Reals, last: Reals, length: Reals) -> Reals:
    """Integral [m] of exp(-depth) along a length on which the depth changes linearly.

    Taken from the brighter end nothing overflows.
    """
    return jnp.exp(-jnp.minimum(first, last)) * length * mean_decay(jnp.abs(last - first))


def apply_fog(
    image_radiance: RealsLike,
    fog: FogLayer,
    distance: RealsLike,
    view_zenith_angle: RealsLike,
    relative_azimuth: RealsLike,
    solar_zenith_angle: RealsLike,
    observer_altitude: RealsLike = 0.0,
    irradiance: RealsLike = 1.0,
    sunlight: str = "exact",
) -> Reals:
    """Put fog over an image whose distances are known.

    Args:
        image_radiance: [..., wavelength].
        fog: The layer.
        distance: Of every pixel [m], infinity where there is only sky.
        view_zenith_angle: Likewise, as all that follows as of `fog_transfer` [rad].
        relative_azimuth: [rad].
        solar_zenith_angle: [rad].
        observer_altitude: [m].
        irradiance: Of the sun above the air, a number or [wavelength].
        sunlight: As of `fog_transfer`. Static.

    Returns:
        Radiance [..., wavelength].

    Raises:
        ValueError: An argument is out of range, or another word.

    References:
        Klassen (1987), section 12.
    """
    found = fog_transfer(
        fog,
        distance,
        view_zenith_angle,
        relative_azimuth,
        solar_zenith_angle,
        observer_altitude,
        irradiance,
        sunlight,
    )
    radiance = real_array(image_radiance).astype(found.transmittance.dtype)
    return radiance * found.transmittance + found.in_scattered


def _of_gray(sunlight: str) -> Callable[..., tuple[Reals, Reals, Reals]]:
    def call(
        extinction: Scalar, distance: Scalar, view: Scalar, sun: Scalar, eye: Scalar
    ) -> tuple[Reals, Reals, Reals]:
        """Through gray fog 100 m thick."""
        b = extinction[None]
        air, wavelength = jnp.full_like(b, 1e-5), jnp.full_like(b, 550.0)
        fog = FogLayer(100.0, b, b, air, wavelength, HenyeyGreenstein(ASYMMETRY))
        where = (fog, distance, view, 0.5, sun, eye)
        found = fog_transfer(*where, sunlight=sunlight)
        over = apply_fog(jnp.ones_like(b), *where, sunlight=sunlight)
        return found.transmittance, found.in_scattered, over

    return call


for _name in SUNLIGHT:
    for _subject in (fog_transfer, apply_fog) if _name == "exact" else (fog_transfer,):
        extremes(
            Case("no way", {"distance": 0.0}, limit=(1.0, 0.0, 1.0)),
            Case("level", {"view": math.pi / 2}),
            Case("toward the sun's height", {"view": 1.0, "sun": 1.0}),
            Case("sun at the horizon", {"sun": math.pi / 2}),
            Case("no fog", {"extinction": 0.0}),
            Case("optical depth 10000", {"extinction": 1.0, "distance": 1e4, "view": 1.5}),
            Case("eye at the top", {"eye": 100.0}),
            Case("eye at the top, level sun", {"eye": 100.0, "sun": math.pi / 2, "view": 1.6}),
            Case("eye above, down", {"eye": 500.0, "view": 3.0}),
            Case("as far as it goes", {"distance": LONGEST, "view": math.pi / 2}),
            part=_name,
            call=_of_gray(_name),
            extinction=Domain(0.0, LARGEST_EXTINCTION),
            distance=Span(0.0, LONGEST),
            view=Domain(0.0, math.pi),
            sun=Domain(0.0, math.pi / 2),
            eye=Domain(0.0, HIGHEST),
        )(_subject)
