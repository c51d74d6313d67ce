"""The landscape lit by sun and sky, seen through the air between."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import choice
from atmofit.colour import LUMINOUS_EFFICACY
from atmofit.geometry import HORIZON, Directions, scattering_angle
from atmofit.landscape.terrain import Terrain
from atmofit.landscape.view import Hits, View, intersect
from atmofit.media.baselines import WardLarson
from atmofit.media.light_around import LightAround
from atmofit.media.low_air import LowAir
from atmofit.media.path_plan import PathPlan
from atmofit.media.transfer import Path, along
from atmofit.spectrum import Spectrum, at, checked_spectral, spectral
from atmofit.sun import solar_irradiance_spectrum
from atmofit.tables import cie1931_2deg
from atmofit.typing import Reals, RealsLike

AIRS = ("path", "none", "ambient")
_SUN_RADIUS = 4.65e-3  # of the disk [rad]


class Light(eqx.Module):
    """What lights a landscape, per unit of the sun's irradiance above the air.

    Attributes:
        around: Light of sun, sky and ground, and what of it the air scatters.
        air: What the lines of sight go through.
        solar_azimuth: Clockwise from north [rad].
        sky: Radiance in a list of directions, [direction, wavelength]: a module, whose numbers may
            then change without compiling again.
    """

    around: LightAround
    air: LowAir
    solar_azimuth: Float[Array, ""]
    sky: Callable[[Directions], Reals]


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture before it is shown.

    Attributes:
        XYZ: Tristimulus values, Y in cd m^-2, [row, column, 3].
        distance: To the ground [m], [row, column]; infinite for sky.
    """

    XYZ: Float[np.ndarray, "row column 3"]
    distance: Float[np.ndarray, "row column"]


def render_landscape(
    terrain: Terrain,
    view: View,
    light: Light,
    plan: PathPlan,
    albedo: RealsLike | Spectrum = 0.2,
    air: str = "path",
    ambient: WardLarson | None = None,
    tile: int = 20,
) -> Picture:
    """Render the picture, a tile of columns at a time.

    Ground reflects evenly (Lambert), lit by the sun where no ground stands before it, by the share
    of the sky above its slope and by level ground for the rest.

    Args:
        terrain: Heights.
        view: The camera.
        light: Sun, sky and air, at a few wavelengths: the spectrum relative to the sun's is linear
            between them.
        plan: Of the lines of sight, see `plan_path`. Static.
        albedo: Of the ground, 0 to 1: a number or a `Spectrum`.
        air: "path": true aerial perspective; "none": air that does nothing, not computed;
            "ambient": Ward Larson's constant ambient light, which `ambient` gives. Static.
        ambient: The ambient light.
        tile: Columns that are computed at once; memory grows with it alone. Static.

    Returns:
        The picture.

    Raises:
        ValueError: Unknown air, or ambient light missing or given without need.
    """
    choice("air", air, AIRS)
    if (air == "ambient") != (ambient is not None):
        raise ValueError(f'ambient must be given for air "ambient" alone, got air "{air}"')
    terrain, view = terrain.checked(), view.checked()
    λ = light.air.wavelength_nm
    reflectance = checked_spectral("albedo", spectral(albedo), 0.0, 1.0)
    reflected = jnp.broadcast_to(at(reflectance, λ), λ.shape)
    weights = jnp.asarray(sunlight_weights(tuple(np.asarray(λ).tolist())), λ.dtype)
    XYZ, distance = _render(terrain, view, light, plan, reflected, weights, air, ambient, tile)
    ordered = [np.moveaxis(np.asarray(x)[: view.columns], 0, 1) for x in (XYZ, distance)]
    return Picture(*ordered)


@eqx.filter_jit
def _render(
    terrain: Terrain,
    view: View,
    light: Light,
    plan: PathPlan,
    albedo: Float[Array, " w"],
    weights: Float[Array, "w 3"],
    air: str,
    ambient: WardLarson | None,
    tile: int,
) -> tuple[Reals, Reals]:
    """The kernel: [column, row, 3] and distances, with columns to fill the last tile."""
    lit = terrain.sunlit(light.around.solar_zenith_angle, light.solar_azimuth)
    slopes = terrain.slopes()
    tiles = -(-view.columns // tile)

    def columns_of(number: Array) -> tuple[Reals, Reals]:
        hits = intersect(terrain, view, number * tile + jnp.arange(tile))
        ground = _ground(terrain, view, light, hits, lit, slopes, albedo)
        seen = _through_air(light, hits, ground, plan, air, ambient)
        azimuth = (hits.azimuth - light.solar_azimuth)[:, None]
        zenith = hits.view_zenith_angle
        sky = sky_behind(light, zenith, jnp.broadcast_to(azimuth, zenith.shape))
        radiance = jnp.where(hits.is_ground[..., None], seen, sky)
        return radiance @ weights, jnp.where(hits.is_ground, hits.length, jnp.inf)

    XYZ, distance = jax.lax.map(columns_of, jnp.arange(tiles))
    return XYZ.reshape(-1, view.rows, 3), distance.reshape(-1, view.rows)


def _ground(
    terrain: Terrain,
    view: View,
    light: Light,
    hits: Hits,
    lit: Float[Array, "north east"],
    slopes: tuple[Reals, Reals],
    albedo: Float[Array, " w"],
) -> Float[Array, "column row w"]:
    """Radiance of the ground where the rays meet it."""
    around = light.around
    east, north = hits.place(view)
    rise_east, rise_north = (terrain.sample(slope, east, north) for slope in slopes)
    upright = 1 / jnp.sqrt(1 + rise_east**2 + rise_north**2)
    zenith, azimuth = around.solar_zenith_angle, light.solar_azimuth
    level = jnp.sin(zenith) * (rise_east * jnp.sin(azimuth) + rise_north * jnp.cos(azimuth))
    facing = jnp.maximum(jnp.cos(zenith) - level, 0.0) * upright
    direct = facing * terrain.sample(lit, east, north)
    sky_share = (1 + upright) / 2
    irradiance = (
        direct[..., None] * around.sun_irradiance[None, None]
        + sky_share[..., None] * around.sky_irradiance[None, None]
        + (1 - sky_share)[..., None] * (jnp.pi * around.ground_radiance)[None, None]
    )
    return irradiance * (albedo / jnp.pi)[None, None]


def _through_air(
    light: Light,
    hits: Hits,
    radiance: Float[Array, "column row w"],
    plan: PathPlan,
    air: str,
    ambient: WardLarson | None,
) -> Float[Array, "column row w"]:
    """What is left of the ground's light, and what the air adds."""
    if air == "none":
        return radiance
    flat = Path(
        hits.length.ravel(),
        hits.view_zenith_angle.ravel(),
        jnp.full(hits.length.size, hits.altitude),
    )
    passing, integrals = along(light.air, flat, plan)
    transmittance = passing.T.reshape(radiance.shape)
    if ambient is not None:
        return ambient(radiance, transmittance)
    azimuth = jnp.broadcast_to((hits.azimuth - light.solar_azimuth)[:, None], hits.length.shape)
    source = light.around.toward(light.air, hits.view_zenith_angle, azimuth)
    added = jnp.sum(source * jnp.moveaxis(integrals, -1, 0).reshape(source.shape), axis=-2)
    return radiance * transmittance + added


def sky_behind(light: Light, view_zenith_angle: Reals, relative_azimuth: Reals) -> Reals:
    """Radiance of sky and sun, per unit of the sun's irradiance above the air [1/sr].

    Args:
        light: Of a landscape.
        view_zenith_angle: Of lines of sight [rad]; at the horizon for those that lead below it.
        relative_azimuth: From the sun [rad], in the same shape.

    Returns:
        [..., wavelength].
    """
    view = jnp.minimum(view_zenith_angle, HORIZON)
    directions = Directions(view.ravel(), relative_azimuth.ravel())
    radiance = light.sky(directions).astype(view.dtype)
    angle = scattering_angle(view, relative_azimuth, light.around.solar_zenith_angle)
    disk = light.around.sun_irradiance / (jnp.pi * _SUN_RADIUS**2)
    inside = (angle < _SUN_RADIUS) & (view_zenith_angle < HORIZON)
    return radiance.reshape(*view.shape, -1) + jnp.where(inside[..., None], disk, 0.0)


def sunlight_weights(
    wavelength_nm: tuple[float, ...], preset: str = "standard"
) -> Float[np.ndarray, "w 3"]:
    """What radiance over solar irradiance adds to X, Y and Z [cd m^-2 sr].

    The ratio is linear between its wavelengths and constant beyond the last; the sun's own lines
    are in the weights.

    Args:
        wavelength_nm: Increasing [nm].
        preset: Of the sun's spectrum.
    """
    curves = cie1931_2deg()
    sun = np.asarray(solar_irradiance_spectrum(preset)(curves.wavelength_nm), float)
    light = LUMINOUS_EFFICACY * sun[:, None] * curves.xyz
    hats = np.stack(
        [np.interp(curves.wavelength_nm, wavelength_nm, row) for row in np.eye(len(wavelength_nm))]
    )
    return hats @ light
