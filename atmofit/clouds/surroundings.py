"""What lights a cloud: the sun through the air above it, the sky, and the ground below."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.clouds.volume import Vector
from atmofit.geometry import HORIZON, Directions
from atmofit.landscape.light import WAVELENGTHS_NM, clear_light, overcast_light
from atmofit.landscape.picture import Light
from atmofit.optics.continental import continental_air
from atmofit.sky.direct import simulate_sun
from atmofit.typing import RealsLike, real_array

_HIGHEST_CLOUD = 2e4  # [m]


class Surroundings(eqx.Module):
    """Light around a cloud, per unit of the sun's irradiance above the air.

    Attributes:
        light: Of a landscape below: sky, ground, and the air that a picture looks through.
        sun_irradiance: Across the sun's rays at the cloud [-], [wavelength].
    """

    light: Light
    sun_irradiance: Float[Array, " w"]

    @property
    def sun_direction(self) -> Vector:
        """Unit vector to the sun: east, north, up."""
        zenith, azimuth = self.light.around.solar_zenith_angle, self.light.solar_azimuth
        level = jnp.sin(zenith)
        return jnp.stack([level * jnp.sin(azimuth), level * jnp.cos(azimuth), jnp.cos(zenith)])

    def radiance(self, directions: Float[Array, "direction 3"]) -> Float[Array, "direction w"]:
        """What comes from somewhere, the sun left out [1/sr].

        Args:
            directions: Unit vectors from the cloud: east, north, up. Below the horizon lies level
                ground.
        """
        zenith = jnp.arccos(jnp.clip(directions[:, 2], -1.0, 1.0))
        azimuth = jnp.arctan2(directions[:, 0], directions[:, 1]) - self.light.solar_azimuth
        sky = self.light.sky(Directions(jnp.minimum(zenith, HORIZON), azimuth))
        ground = self.light.around.ground_radiance[None, :]
        return jnp.where((directions[:, 2] >= 0)[:, None], sky, ground).astype(zenith.dtype)


def clear_surroundings(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    solar_azimuth: RealsLike = 0.0,
    albedo: RealsLike = 0.2,
    altitude: RealsLike = 1500.0,
) -> Surroundings:
    """Sun, clear sky and ground about a cloud in the air over a continent.

    Args:
        turbidity: As `ATMOFIT_2026` has it, 1.7 to 10.
        solar_zenith_angle: 0 to pi/2 [rad].
        solar_azimuth: Clockwise from north [rad].
        albedo: Of the ground, 0 to 1.
        altitude: Of the cloud, which sees the sun through less air than the ground does; 0 to
            20,000 [m].

    Raises:
        ValueError: An argument is out of range.
    """
    height = in_range("altitude", altitude, 0.0, _HIGHEST_CLOUD, "m")
    light = clear_light(turbidity, solar_zenith_angle, solar_azimuth, albedo)
    atmosphere = continental_air(turbidity, albedo=albedo)
    sun = real_array(solar_zenith_angle)
    return Surroundings(light, simulate_sun(atmosphere, sun, WAVELENGTHS_NM, 1.0, height))


def sunless_surroundings(turbidity: RealsLike = 10.0, albedo: RealsLike = 0.2) -> Surroundings:
    """A cloud that the sun does not reach, under the CIE's overcast sky: skylight alone.

    Args:
        turbidity: Of the haze, in the range of `PREETHAM_1999`, whose zenith sets the brightness.
        albedo: Of the ground, 0 to 1.
    """
    light = overcast_light(turbidity, math.radians(60.0), albedo)
    return Surroundings(light, jnp.zeros_like(light.around.sun_irradiance))
