"""The sun itself through the atmosphere: light that nothing scattered."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.constants import LARGEST_OPTICAL_DEPTH
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.geometry import HORIZON
from atmofit.optics.atmosphere import LATEST_SUN, Atmosphere
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import Molecules
from atmofit.sky.field import HIGHEST_OBSERVER, cast
from atmofit.sky.paths import paths_of
from atmofit.spectrum import Spectrum
from atmofit.sun import irradiance_at
from atmofit.typing import Reals, RealsLike, Scalar, real_array


def simulate_sun(
    atmosphere: Atmosphere,
    solar_zenith_angle: RealsLike,
    wavelength_nm: RealsLike,
    solar_irradiance: RealsLike | Spectrum | None = None,
    observer_altitude: RealsLike = 0.0,
) -> Reals:
    """Irradiance of a surface that faces the sun, by light that met nothing on its way.

    Forward-scattered light about the disk is not in it. `spectrum_to_xyY` takes it to a colour.

    Args:
        atmosphere: What the air is made of.
        solar_zenith_angle: At the observer [rad], a number, 0 to 96 degrees if the planet is round.
        wavelength_nm: [nm], a number or a list.
        solar_irradiance: As in `SkyField.radiance`; 1.0 gives transmittance [-].
        observer_altitude: 0 to 100,000 [m].

    Returns:
        [W m^-2 nm^-1], [wavelength]; 0 where the sun is below the observer's horizon.

    Raises:
        ValueError: A value lies outside its range.
    """
    air = atmosphere.checked()
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, air.latest_sun)
    observer = in_range("observer_altitude", observer_altitude, 0.0, HIGHEST_OBSERVER, "m")
    wavelength = jnp.atleast_1d(real_array(wavelength_nm)).astype(sun.dtype)
    transmittance = _transmittance(
        cast(air, sun.dtype.name), sun, observer.astype(sun.dtype), wavelength
    )
    return transmittance * irradiance_at(wavelength, solar_irradiance, air.preset)


@eqx.filter_jit
def _transmittance(
    air: Atmosphere, sun: Scalar, observer: Scalar, wavelength_nm: Float[Array, " w"]
) -> Float[Array, " w"]:
    # In the "paper" geometry a sun below 70 degrees would see the flat Earth: 1e-2 at most.
    paths, depth = paths_of(air)[-1], jnp.zeros_like(wavelength_nm)
    cosine, up = jnp.cos(sun), jnp.where(sun <= HORIZON, 1.0, 0.0).astype(sun.dtype)
    for part in (air.molecules, air.haze, *air.absorbers):
        if part is not None:
            column, up = paths.sun_column(part.density_profile(), observer, cosine)
            depth = depth + column * part.optical_depth_at(wavelength_nm)
    return jnp.exp(-depth) * up


extremes(
    Case("overhead", {"solar_zenith_angle": 0.0, "haze_depth": 0.0, "observer_altitude": 0.0}),
    Case("level, thick", {"solar_zenith_angle": HORIZON, "haze_depth": 1e3}),
    Case("end of twilight", {"solar_zenith_angle": LATEST_SUN, "observer_altitude": 0.0}, 0.0),
    call=lambda solar_zenith_angle, haze_depth, observer_altitude: simulate_sun(
        Atmosphere(Molecules(0.1, 8e3), Haze(haze_depth, 1.3)),
        solar_zenith_angle,
        550.0,
        1.0,
        observer_altitude,
    ),
    solar_zenith_angle=Domain(0.0, LATEST_SUN),
    haze_depth=Span(0.0, LARGEST_OPTICAL_DEPTH),
    observer_altitude=Span(0.0, HIGHEST_OBSERVER),
    least=0.0,
)(simulate_sun)
