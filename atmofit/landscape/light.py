"""Lights for a landscape: a clear day, an overcast one, and an older sky to compare with."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from atmofit.geometry import Directions, scattering_angle
from atmofit.landscape.picture import Light, sunlight_weights
from atmofit.media.light_around import light_around
from atmofit.media.low_air import low_air
from atmofit.models.cie import cie_clear_sky, cie_overcast_sky
from atmofit.models.preetham import PREETHAM_1999
from atmofit.models.sky_model import SkyModel
from atmofit.models.stored import ATMOFIT_2026
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.continental import continental_air
from atmofit.sky.direct import simulate_sun
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

# Nine, at the middle of even parts of what an eye sees.
WAVELENGTHS_NM = tuple(float(λ) for λ in np.linspace(410.0, 690.0, 9))


class ModelSky(eqx.Module):
    """A fitted sky model's radiance over the sun's irradiance [1/sr].

    Attributes:
        model: With wavelengths.
        turbidity: [-].
        solar_zenith_angle: [rad].
        albedo: Of the ground [-].
    """

    model: SkyModel
    turbidity: Scalar
    solar_zenith_angle: Scalar
    albedo: Scalar

    def __call__(self, directions: Directions) -> Reals:
        """[direction, wavelength]."""
        place = (self.turbidity, self.solar_zenith_angle, directions)
        return self.model.radiance(*place, WAVELENGTHS_NM, self.albedo, 1.0)


class GreySky(eqx.Module):
    """One of the CIE's skies, of sunlight's own colour.

    Attributes:
        zenith: Radiance there over the sun's irradiance [1/sr].
        solar_zenith_angle: [rad], or None: overcast.
    """

    zenith: Scalar
    solar_zenith_angle: Scalar | None

    def __call__(self, directions: Directions) -> Reals:
        """[direction, wavelength]."""
        view, azimuth = directions.angles()
        if self.solar_zenith_angle is None:
            shape = cie_overcast_sky(view)
        else:
            angle = scattering_angle(view, azimuth, self.solar_zenith_angle)
            shape = cie_clear_sky(view, angle, self.solar_zenith_angle)
        values = (self.zenith * shape)[:, None]
        return jnp.broadcast_to(values, (*view.shape, len(WAVELENGTHS_NM)))


def clear_light(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    solar_azimuth: RealsLike = 0.0,
    albedo: RealsLike = 0.2,
    grey: bool = False,
) -> Light:
    """Sun and clear sky in the air over a continent.

    Args:
        turbidity: As `ATMOFIT_2026` has it, 1.7 to 10.
        solar_zenith_angle: 0 to pi/2 [rad].
        solar_azimuth: Clockwise from north [rad].
        albedo: Of the ground around, 0 to 1.
        grey: Whether the sky is the CIE's clear one without colour, as bright at the zenith.

    Raises:
        ValueError: An argument is out of range.
    """
    sun, T, ground = (scalar(x) for x in (solar_zenith_angle, turbidity, albedo))
    λ = real_array(WAVELENGTHS_NM).astype(sun.dtype)
    atmosphere = continental_air(T, albedo=ground)
    air = low_air(atmosphere, λ)
    sky: ModelSky | GreySky = ModelSky(ATMOFIT_2026.only("wavelengths"), T, sun, ground)
    if grey:
        zenith = Directions(jnp.zeros_like(sun)[None], jnp.zeros_like(sun)[None])
        weights = jnp.asarray(sunlight_weights(WAVELENGTHS_NM)[:, 1], sun.dtype)
        luminance = jnp.sum(sky(zenith)[0] * weights)
        sky = GreySky(luminance / jnp.sum(weights), sun)
    direct = simulate_sun(atmosphere, sun, λ, 1.0)
    return Light(light_around(air, sun, direct, sky, ground), air, scalar(solar_azimuth), sky)


def overcast_light(
    turbidity: RealsLike = 10.0, solar_zenith_angle: RealsLike = 1.0, albedo: RealsLike = 0.2
) -> Light:
    """The CIE's overcast sky over thick haze, without a sun.

    Args:
        turbidity: Of the haze, in the range of `PREETHAM_1999`, whose zenith sets the brightness.
        solar_zenith_angle: Of the hidden sun [rad].
        albedo: Of the ground around, 0 to 1.
    """
    luminance = PREETHAM_1999.zenith(turbidity, solar_zenith_angle)[..., 2]
    weights = sunlight_weights(WAVELENGTHS_NM)[:, 1]
    sky = GreySky(scalar(luminance / weights.sum()), None)
    air = low_air(Atmosphere.from_turbidity(turbidity), WAVELENGTHS_NM)
    around = light_around(air, solar_zenith_angle, 0.0, sky, albedo)
    return Light(around, air, scalar(0.0), sky)
