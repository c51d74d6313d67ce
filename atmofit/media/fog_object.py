"""What the sun lights in fog: Klassen's object component, and the fog's own light at sunset."""

import math

import equinox as eqx
import jax.numpy as jnp

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.media.fog import LONGEST, SUNLIGHT, fog_transfer
from atmofit.media.fog_geometry import sine_of_elevation
from atmofit.media.fog_medium import HIGHEST, HIGHEST_TOP, FogLayer, fog_layer, spectrum_over
from atmofit.typing import Reals, RealsLike, real_array


def fog_sunlight(
    fog: FogLayer,
    altitude: RealsLike,
    solar_zenith_angle: RealsLike,
    sunlight: str = "exact",
) -> Reals:
    """Share of the sun's light that arrives directly at places in the fog and above.

    Args:
        fog: The layer.
        altitude: [m], 0 to 100,000.
        solar_zenith_angle: 0 to pi/2 [rad]. It broadcasts with `altitude`.
        sunlight: "exact" and "constant": over a flat earth, "curved": over a round one; "diffuse":
            none. Static.

    Returns:
        Transmittance [-], [..., wavelength].

    Raises:
        ValueError: An argument is out of range, or another word.

    References:
        Klassen (1987), the last exponent of equation 40; with `sunlight` "curved", equation 19.
    """
    choice("sunlight", sunlight, SUNLIGHT)
    place = in_range("altitude", altitude, 0.0, HIGHEST, "m")
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, math.pi / 2)
    dtype = jnp.result_type(place, sun)
    place, sun = (x.astype(dtype) for x in jnp.broadcast_arrays(place, sun))
    return _sunlight(fog.checked().in_dtype(dtype), place, sun, sunlight)


@eqx.filter_jit
def _sunlight(fog: FogLayer, altitude: Reals, sun: Reals, sunlight: str) -> Reals:
    depth = fog.sun_depth(altitude, sine_of_elevation(sun), sunlight == "curved")
    return jnp.zeros_like(depth) if sunlight == "diffuse" else jnp.exp(-depth)


def diffuse_fog(fog: FogLayer, solar_zenith_angle: RealsLike, irradiance: RealsLike = 1.0) -> Reals:
    """Radiance of fog that lies too deep in the light of a low sun to be lit by it directly.

    Many scatterings leave the colour of the sun above the fog, seen through the air of a round
    earth, and no direction. How bright, the paper leaves open; here it is the mean radiance of the
    sun's beam over the sphere. Objects then have this as their ambient light, and no other.

    Args:
        fog: The layer.
        solar_zenith_angle: 0 to pi/2 [rad], any shape.
        irradiance: Of the sun above the air, a number or [wavelength].

    Returns:
        [..., wavelength], in the unit of the irradiance per sr.

    Raises:
        ValueError: The angle is out of range.

    References:
        Klassen (1987), section 11.2.
    """
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, math.pi / 2)
    above = jnp.full_like(sun, 1.0) * fog.top.astype(sun.dtype)
    arriving = fog_sunlight(fog, above, sun, "curved")
    return arriving * spectrum_over(real_array(irradiance), sun) / (4 * math.pi)


def fog_object(
    fog: FogLayer,
    reflectance: RealsLike,
    distance: RealsLike,
    view_zenith_angle: RealsLike,
    solar_zenith_angle: RealsLike,
    observer_altitude: RealsLike = 0.0,
    *,
    irradiance: RealsLike = 1.0,
    ambient: RealsLike = 0.0,
    sunlight: str = "exact",
) -> Reals:
    """Light of an object as it arrives at an eye through fog: the paper's object component.

    Args:
        fog: The layer.
        reflectance: Radiance toward the eye over the sun's irradiance on a plane that faces it
            [1/sr], a number or [..., wavelength]: of a Lambert surface, albedo / pi times the
            cosine of incidence.
        distance: To the object [m], finite; it ends at the ground.
        view_zenith_angle: 0 (up) to pi (down) [rad].
        solar_zenith_angle: 0 to pi/2 [rad].
        observer_altitude: Of the eye [m]. These four broadcast.
        irradiance: Of the sun above the air, a number or [wavelength].
        ambient: Radiance that the object sends to the eye by all other light, a number or
            [..., wavelength].
        sunlight: As of `fog_transfer`; with "diffuse" nothing but the ambient light is left.

    Returns:
        Radiance without what the fog scatters, [..., wavelength].

    Raises:
        ValueError: An argument is out of range, or another word.

    References:
        Klassen (1987), equations 36 and 40; 47 with a minus before its last term.
    """
    far = in_range("distance", distance, 0.0, LONGEST, "m")
    passed = fog_transfer(
        fog, far, view_zenith_angle, 0.0, solar_zenith_angle, observer_altitude, 1.0, sunlight
    ).transmittance
    up = sine_of_elevation(real_array(view_zenith_angle))
    altitude = jnp.clip(real_array(observer_altitude) + far * up, 0.0, HIGHEST)
    arriving = fog_sunlight(fog, altitude, solar_zenith_angle, sunlight)
    shared, own = (_by_wavelength(x, passed) for x in (reflectance, ambient))
    light = spectrum_over(real_array(irradiance), passed[..., 0])
    return passed * (own + shared * light * arriving)


def _by_wavelength(value: RealsLike, like: Reals) -> Reals:
    """A number or an array that ends with wavelength, beside another."""
    array = real_array(value).astype(like.dtype)
    return array.reshape((1,) * max(like.ndim - array.ndim, 0) + array.shape)


extremes(
    Case("level sun", {"sun": math.pi / 2}),
    Case("ground without fog's height", {"altitude": 0.0, "top": 0.0}),
    Case("at the top", {"altitude": 100.0, "top": 100.0}),
    call=lambda altitude, sun, top: tuple(
        fog_sunlight(fog_layer("dense", top), altitude, sun, name) for name in SUNLIGHT
    ),
    altitude=Domain(0.0, HIGHEST),
    sun=Domain(0.0, math.pi / 2),
    top=Domain(0.0, HIGHEST_TOP),
)(fog_sunlight)
extremes(
    Case("level sun", {"sun": math.pi / 2}),
    call=lambda sun, top: diffuse_fog(fog_layer("dense", top), sun),
    sun=Domain(0.0, math.pi / 2),
    top=Domain(0.0, HIGHEST_TOP),
)(diffuse_fog)
extremes(
    Case("at the eye", {"distance": 0.0, "eye": 100.0}),
    Case("level", {"view": math.pi / 2}),
    Case("level sun", {"sun": math.pi / 2}),
    Case("black", {"reflectance": 0.0}),
    call=lambda reflectance, distance, view, sun, eye: tuple(
        fog_object(fog_layer("thin", 50.0), reflectance, distance, view, sun, eye, sunlight=name)
        for name in ("exact", "curved")
    ),
    reflectance=Span(0.0, 10.0),
    distance=Domain(0.0, LONGEST),
    view=Domain(0.0, math.pi),
    sun=Domain(0.0, math.pi / 2),
    eye=Domain(0.0, HIGHEST),
)(fog_object)
