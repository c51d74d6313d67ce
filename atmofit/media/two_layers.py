"""Sun and sky of an atmosphere of two even layers, haze below and air above: Klassen (1987).

Both layers are concentric with the planet. Light is scattered once, by the haze; what the air
scatters is a constant blue behind it. "exact" follows the geometry of spheres, "paper" takes the
sun's elevation as the same on both shells and dl/dr as constant along the line of sight, which
darkens the horizon to a small part of what it is.
"""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.constants import EARTH_RADIUS
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.numerics import gauss_nodes, safe_sqrt
from atmofit.optics.air import rayleigh_optical_depth
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

GEOMETRIES = ("exact", "paper")
NODES = (8, 16, 24, 48, 96)
_LEAST_HEIGHT = 1e-3  # [m], below which a distance grows in proportion
_WAVELENGTHS = np.arange(380.0, 701.0, 10.0)  # the paper's 33


class TwoLayers(eqx.Module):
    """A planet with haze up to one altitude and air up to another.

    Attributes:
        radius: Of the planet [m].
        haze_top: Altitude [m].
        air_top: Altitude at which air of the ground's density would end [m], above `haze_top`.
        molecular_extinction: Of the air [1/m], by wavelength.
        haze_extinction: [1/m].
        haze_scattering: [1/m].
        wavelength_nm: [nm].
        phase: Of the haze.
    """

    radius: Scalar = eqx.field(converter=scalar)
    haze_top: Scalar = eqx.field(converter=scalar)
    air_top: Scalar = eqx.field(converter=scalar)
    molecular_extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    haze_extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    haze_scattering: Float[Array, " w"] = eqx.field(converter=real_array)
    wavelength_nm: Float[Array, " w"] = eqx.field(converter=real_array)
    phase: PhaseFunction


def two_layers(
    haze_extinction: RealsLike = 5e-5,
    haze_top: RealsLike = 2e3,
    air_top: RealsLike = 8.4e3,
    *,
    angstrom_exponent: RealsLike = 1.0,
    single_scattering_albedo: RealsLike = 0.95,
    phase: PhaseFunction | None = None,
    wavelength_nm: RealsLike = _WAVELENGTHS,
) -> TwoLayers:
    """Earth with a haze. The paper prints no values: these are ours.

    Args:
        haze_extinction: At 550 nm [1/m], 0 to 0.02.
        haze_top: Altitude [m], 1 to 20,000.
        air_top: Altitude [m] that ends air of even density, `haze_top` to 100,000; its vertical
            optical depth is Rayleigh's times this over 8.4 km.
        angstrom_exponent: Of the haze, -1 to 4 [-].
        single_scattering_albedo: Of the haze, 0 to 1 [-].
        phase: Of the haze; None: Henyey-Greenstein, 0.75.
        wavelength_nm: [nm].

    Raises:
        ValueError: A known argument is out of range.
    """
    wavelength = real_array(wavelength_nm)
    density = in_range("haze_extinction", haze_extinction, 0.0, 0.02, "1/m")
    density = density.astype(wavelength.dtype)
    top = in_range("haze_top", haze_top, 1.0, 2e4, "m")
    air = in_range("air_top", air_top, 1.0, 1e5, "m")
    air = in_range("air_top - haze_top", air - top.astype(air.dtype), 0.0, 1e5, "m") + top
    exponent = in_range("angstrom_exponent", angstrom_exponent, -1.0, 4.0)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    haze = density * (wavelength / 550.0) ** -exponent.astype(wavelength.dtype)
    return TwoLayers(
        EARTH_RADIUS,
        top,
        air,
        rayleigh_optical_depth(wavelength) / 8.4e3,
        haze,
        haze * albedo.astype(wavelength.dtype),
        wavelength,
        HenyeyGreenstein(0.75) if phase is None else phase.checked(),
    )


@extremes(
    Case("straight up", {"sine": 1.0, "radius": 6.371e6, "height": 1e3}, limit=1e3),
    Case("no height", {"height": 0.0}, limit=0.0),
    Case(
        "level",
        {"sine": 0.0, "radius": 6.371e6, "height": 1e3},
        limit=math.sqrt(1e3 * (2 * 6.371e6 + 1e3)),
    ),
    radius=Span(1e3, 1e8),
    height=Span(0.0, 1e5),
    sine=Span(0.0, 1.0),
)
def shell_distance(radius: Reals, height: Reals, sine: Reals) -> Reals:
    """Way from a sphere to a concentric one above it [m].

    Equation 19 without its difference of large squares, which single precision does not hold.

    Args:
        radius: Of the inner sphere [m].
        height: Of the outer one above it [m], at least 0.
        sine: Of the way's elevation where it leaves the inner sphere [-]; below 0 it passes
            through lower altitudes first.
    """
    difference = height * (2 * radius + height)
    least = _LEAST_HEIGHT * (2 * radius + _LEAST_HEIGHT)
    up = radius * sine
    root = safe_sqrt(jnp.maximum(difference, least) + up**2)
    # Downward the two roots add up, where the other form would cancel.
    rising = difference / (root + jnp.maximum(up, 0.0))
    return jnp.where(sine < 0, root - jnp.minimum(up, 0.0), rising)


def layered_sun(
    layers: TwoLayers, solar_zenith_angle: RealsLike, geometry: str = "exact"
) -> Float[Array, "*sun w"]:
    """Share of the sun's light that arrives at the ground [-], by wavelength.

    Args:
        layers: What it passes through.
        solar_zenith_angle: 0 to pi/2 [rad], any shape.
        geometry: "exact" or "paper". Static.

    Raises:
        ValueError: A known angle is out of range.
    """
    choice("geometry", geometry, GEOMETRIES)
    zenith = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    up = jnp.sin(HORIZON - zenith)
    ways = _sun_ways(layers, jnp.zeros_like(up), up, geometry == "exact")
    return jnp.exp(-_depth(layers, *ways))


def _sun_ways(layers: TwoLayers, altitude: Reals, sine: Reals, exact: bool) -> tuple[Reals, Reals]:
    """Ways of sunlight through all air and through the haze [m], down to an altitude."""
    radius, top = layers.radius.astype(sine.dtype), layers.haze_top.astype(sine.dtype)
    here = radius + altitude
    in_haze = shell_distance(here, top - altitude, sine)
    at_top = (here * sine + in_haze) / (radius + top) if exact else sine
    above = shell_distance(radius + top, layers.air_top.astype(sine.dtype) - top, at_top)
    return above + in_haze, in_haze


def _depth(layers: TwoLayers, air: Reals, haze: Reals) -> Float[Array, "*way w"]:
    per_metre = jnp.stack([layers.molecular_extinction, layers.haze_extinction])
    return jnp.stack([air, haze], axis=-1) @ per_metre.astype(air.dtype)


def haze_opacity(layers: TwoLayers, view_zenith_angle: RealsLike) -> Float[Array, "*view w"]:
    """Share of what lies behind the haze that it hides [-], equation 31.

    Args:
        layers: With the haze.
        view_zenith_angle: 0 to pi/2 [rad], any shape.

    Raises:
        ValueError: A known angle is out of range.
    """
    zenith = angle_in_range("view_zenith_angle", view_zenith_angle, 0.0, HORIZON)
    way = shell_distance(layers.radius, layers.haze_top, jnp.sin(HORIZON - zenith))
    return 1 - jnp.exp(-way[..., None] * _on_last(layers.haze_extinction, way))


def _on_last(spectrum: Float[Array, " w"], like: Reals) -> Reals:
    return spectrum.astype(like.dtype).reshape((1,) * like.ndim + (-1,))


def layered_sky(
    layers: TwoLayers,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    *,
    solar_irradiance: RealsLike = 1.0,
    blue: RealsLike | None = None,
    geometry: str = "exact",
    nodes: int = 24,
) -> Float[Array, "*direction w"]:
    """Radiance of the sky: the haze's own light, and the blue behind it through the haze.

    Args:
        layers: Haze and air.
        solar_zenith_angle: 0 to pi/2 [rad], a number.
        directions: To look in.
        solar_irradiance: Before it enters the air [W m^-2 nm^-1], a number or by wavelength.
        blue: Radiance of the sky behind the haze over the irradiance [1/sr], by wavelength; None:
            what a vertical column of air scatters, evenly over the sphere.
        geometry: "exact" or "paper". Static.
        nodes: Of the quadrature along the line of sight: 8, 16, 24, 48 or 96. Static.

    Returns:
        [*directions, wavelength], [W m^-2 sr^-1 nm^-1] or [1/sr] for an irradiance of 1.

    Raises:
        ValueError: A known argument is out of range.
    """
    choice("geometry", geometry, GEOMETRIES)
    if nodes not in NODES:
        raise ValueError(f"nodes must be one of {NODES}, got {nodes}")
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    zenith, azimuth = (x.ravel() for x in directions.angles())
    zenith = angle_in_range("view_zenith_angle", zenith, 0.0, HORIZON)
    integral = sky_integral(layers, sun, zenith, azimuth, geometry == "exact", nodes)
    found = coloured(layers, sun, zenith, azimuth, integral, blue_behind(layers, blue))
    irradiance = real_array(solar_irradiance).astype(found.dtype)
    return (found * irradiance.reshape(1, -1)).reshape(*directions.shape, -1)


def blue_behind(layers: TwoLayers, blue: RealsLike | None) -> Float[Array, " w"]:
    """Radiance behind the haze over the irradiance, see `layered_sky`."""
    if blue is not None:
        return jnp.broadcast_to(real_array(blue), layers.wavelength_nm.shape)
    return (1 - jnp.exp(-layers.molecular_extinction * layers.air_top)) / (4 * math.pi)


@eqx.filter_jit
def coloured(
    layers: TwoLayers,
    sun: Scalar,
    zenith: Float[Array, " view"],
    azimuth: Float[Array, " view"],
    integral: Float[Array, "w view"],
    blue: Float[Array, " w"],
) -> Float[Array, "view w"]:
    """The phase function, which is known exactly, and the blue."""
    angle = scattering_angle(zenith, azimuth, sun)
    phase = layers.phase.at_wavelengths(angle, layers.wavelength_nm).astype(zenith.dtype)
    way = shell_distance(layers.radius.astype(zenith.dtype), layers.haze_top, jnp.cos(zenith))
    scattering, extinction = (
        x.astype(zenith.dtype)[None, :] for x in (layers.haze_scattering, layers.haze_extinction)
    )
    behind = blue.astype(zenith.dtype)[None, :] * jnp.exp(-extinction * way[:, None])
    return scattering * phase * integral.T + behind


@eqx.filter_jit
def sky_integral(
    layers: TwoLayers,
    sun: Scalar,
    zenith: Float[Array, " view"],
    azimuth: Float[Array, " view"],
    exact: bool,
    nodes: int,
) -> Float[Array, "w view"]:
    """Integral of transmittance to the sun and to the eye along lines of sight [m].

    Gauss-Legendre nodes in a variable that stretches both ends of the way, as in `media.transfer`.
    While the sun is up, the planet's shadow lies below the observer's horizon: all of it is lit.
    """
    dtype = zenith.dtype
    radius, top = layers.radius.astype(dtype), layers.haze_top.astype(dtype)
    up = jnp.sin(HORIZON - zenith)
    toward = jnp.cos(scattering_angle(zenith, azimuth, sun))
    sun_up = jnp.sin(HORIZON - sun).astype(dtype)
    whole = shell_distance(radius, top, up)
    per_metre = jnp.stack([layers.molecular_extinction, layers.haze_extinction], 1).astype(dtype)
    # Where the nodes lie does not change the integral, so its slope need not follow them.
    reach = jax.lax.stop_gradient(1 / (1e-9 + jnp.max(jnp.sum(per_metre, axis=1))))
    evenly, shares = gauss_nodes(nodes)
    # Under a level sun its way ends in a square root at the top of the haze; so it is smooth.
    bent = (1 - (1 - evenly) ** 2, 2 * (1 - evenly) * shares)
    places, weights = (jnp.asarray(x, dtype) for x in bent)
    stretched = 2 * jnp.log1p(whole / reach)
    ratio = reach / (whole + reach)

    def on_way(node: Scalar) -> tuple[Reals, Reals, Reals, Reals]:
        """Length, its slope by the node, altitude and sine of the sun's elevation there."""
        if not exact:
            altitude = top * node
            way = shell_distance(radius, altitude, up)
            return way, whole, altitude, jnp.broadcast_to(sun_up, up.shape)
        grown = jnp.exp(stretched * node)
        bend = 1 + ratio * grown
        way = jnp.minimum(reach * jnp.expm1(stretched * node) / bend, whole)
        slope = stretched * reach * grown * (1 + ratio) / bend**2
        rise = way * (way + 2 * radius * up)
        altitude = jnp.clip(rise / (jnp.sqrt(radius**2 + rise) + radius), 0.0, top)
        sine = (radius * sun_up + way * toward) / (radius + altitude)
        return way, slope, altitude, jnp.clip(sine, -1.0, 1.0)

    def add(total: Reals, at: tuple[Scalar, Scalar]) -> tuple[Reals, None]:
        node, weight = at
        way, slope, altitude, sine = on_way(node)
        air, haze = _sun_ways(layers, altitude, sine, exact)
        depth = per_metre @ jnp.stack([air + way, haze + way])
        return total + (weight * slope)[None, :] * jnp.exp(-depth), None

    none = jnp.zeros((per_metre.shape[0], zenith.size), dtype)
    total, _ = jax.lax.scan(add, none, (places, weights))
    return total


def _extreme(geometry: str) -> Callable[..., tuple[Reals, ...]]:
    def call(
        haze_extinction: Scalar, haze_top: Scalar, sun: Scalar, view: Scalar, azimuth: Scalar
    ) -> tuple[Reals, ...]:
        layers = two_layers(haze_extinction, haze_top, 2e4, wavelength_nm=(450.0, 650.0))
        seen = layered_sky(
            layers, sun, Directions(view[None], azimuth[None]), geometry=geometry, nodes=8
        )
        return seen, layered_sun(layers, sun, geometry), haze_opacity(layers, view)

    return call


for _geometry in GEOMETRIES:
    extremes(
        Case("no haze", {"haze_extinction": 0.0}),
        Case("a metre of it", {"haze_top": 1.0}),
        Case("level, at sunset", {"sun": HORIZON, "view": HORIZON, "azimuth": 0.0}),
        Case("level, away from sunset", {"sun": HORIZON, "view": HORIZON, "azimuth": math.pi}),
        Case("thick", {"haze_extinction": 0.02}),
        Case("into the sun", {"sun": 1.0, "view": 1.0, "azimuth": 0.0}),
        part=_geometry,
        call=_extreme(_geometry),
        haze_extinction=Domain(0.0, 0.02),
        haze_top=Domain(1.0, 2e4),
        sun=Domain(0.0, HORIZON),
        view=Domain(0.0, HORIZON),
        azimuth=Span(0.0, math.pi),
        least=0.0,
    )(layered_sky)
