"""The sun by formula: five transmittances and the optical mass of the 1999 paper."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.colour import spectrum_to_xyY
from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON
from atmofit.tables import constant, preetham1999_spectra
from atmofit.typing import Reals, RealsLike

_LARGEST_COLUMN = 1.0  # of ozone or water [m]
_MASS_POLE_DEG, _MASS_FACTOR, _MASS_EXPONENT = 93.885, 0.15, -1.253  # Kasten (1966)


class SunTransmittance(eqx.Module):
    """Shares of direct sunlight that pass, each [..., wavelength] [-].

    Attributes:
        molecules: What they do not scatter.
        haze: What it neither scatters nor absorbs, by Angstrom's formula.
        ozone: What it does not absorb, like the next two.
        gases: Mixed gases, mostly oxygen.
        water: Water vapour.
    """

    molecules: Reals
    haze: Reals
    ozone: Reals
    gases: Reals
    water: Reals

    @property
    def total(self) -> Reals:
        """All five together."""
        return self.molecules * self.haze * self.ozone * self.gases * self.water


@extremes(
    Case("overhead", {"solar_zenith_angle": 0.0}, limit=1 / (1 + 0.15 * 93.885**-1.253)),
    Case("horizon", {"solar_zenith_angle": math.pi / 2}, limit=1 / (0.15 * 3.885**-1.253)),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)
def optical_mass(solar_zenith_angle: RealsLike) -> Reals:
    """Relative optical mass of the air on the way to the sun; 1 overhead, 36.5 at the horizon.

    Args:
        solar_zenith_angle: 0 to pi/2 [rad].

    References:
        Kasten (1966), as Preetham, Shirley and Smits (1999) appendix A.1 give it.
    """
    angle = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    below = jnp.maximum(_MASS_POLE_DEG - angle * (180 / math.pi), 1.0)
    # The sine of the elevation keeps single precision at the horizon.
    return 1 / (jnp.sin(HORIZON - angle) + _MASS_FACTOR * below**_MASS_EXPONENT)


def sun_transmittance(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    wavelength_nm: RealsLike | None = None,
    ozone_column: RealsLike = 0.0035,
    water_column: RealsLike = 0.02,
) -> SunTransmittance:
    """What each of five constituents leaves of sunlight, with the air mass as a factor.

    As printed in 1999 the mass stands in the exponent of the wavelength, which makes the sun black
    beyond two air masses.

    Args:
        turbidity: 1 to 64.
        solar_zenith_angle: 0 to pi/2 [rad].
        wavelength_nm: 380 to 780 [nm], between which the table of absorption is linear; None: the
            table's own, every 10 nm.
        ozone_column: At normal temperature and pressure [m].
        water_column: Precipitable water [m]. All but the wavelength broadcast.

    Returns:
        The shares, [..., wavelength].

    Raises:
        ValueError: A known argument is out of range.

    References:
        Preetham, Shirley and Smits (1999), appendix A.1, after Iqbal (1983) and Leckner (1978).
    """
    named = {
        "turbidity": (turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
        "solar_zenith_angle": (solar_zenith_angle, 0.0, HORIZON),
        "ozone_column": (ozone_column, 0.0, _LARGEST_COLUMN),
        "water_column": (water_column, 0.0, _LARGEST_COLUMN),
    }
    checked = [in_range(name, *given, slack=1e-6) for name, given in named.items()]
    dtype = jnp.result_type(*checked)
    T, sun, ozone, water = (x.astype(dtype)[..., None] for x in jnp.broadcast_arrays(*checked))
    table = preetham1999_spectra()
    λ = table.wavelength_nm if wavelength_nm is None else wavelength_nm
    first, last = float(table.wavelength_nm[0]), float(table.wavelength_nm[-1])
    λ = in_range("wavelength_nm", λ, first, last, "nm").astype(dtype)

    def absorption(values: np.ndarray) -> Reals:
        at = jnp.interp(λ, jnp.asarray(table.wavelength_nm, dtype), jnp.asarray(values, dtype))
        return jnp.broadcast_to(at, (*T.shape[:-1], λ.size))

    m = optical_mass(sun)
    log_micrometres = jnp.broadcast_to(jnp.log(λ * 1e-3), (*T.shape[:-1], λ.size))

    def power(depth: Reals | float, exponent: float) -> Reals:
        return jnp.exp(-depth * m * jnp.exp(-exponent * log_micrometres))

    beta = constant("angstrom_beta_slope") * T + constant("angstrom_beta_intercept")
    return SunTransmittance(
        molecules=power(
            constant("rayleigh_optical_depth_factor"), constant("rayleigh_optical_depth_exponent")
        ),
        haze=power(beta, constant("angstrom_exponent")),
        ozone=jnp.exp(-absorption(table.k_ozone) * ozone * m),
        gases=_band("gas", absorption(table.k_gas) * m),
        water=_band("water", absorption(table.k_water) * water * m),
    )


def _band(name: str, amount: Reals) -> Reals:
    """Leckner's formula for lines that saturate."""
    factor, saturation, exponent = (
        constant(f"{name}_{what}") for what in ("factor", "saturation", "exponent")
    )
    return jnp.exp(-factor * amount / (1 + saturation * amount) ** exponent)


extremes(
    call=lambda turbidity, solar_zenith_angle, ozone_column, water_column: sun_transmittance(
        turbidity, solar_zenith_angle, None, ozone_column, water_column
    ),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    solar_zenith_angle=Domain(0.0, HORIZON),
    ozone_column=Domain(0.0, _LARGEST_COLUMN),
    water_column=Domain(0.0, _LARGEST_COLUMN),
    least=0.0,
)(sun_transmittance)


def direct_sun_radiance(turbidity: RealsLike, solar_zenith_angle: RealsLike) -> Reals:
    """Mean radiance of the sun's disk from the ground.

    Args:
        turbidity: 1 to 64.
        solar_zenith_angle: 0 to pi/2 [rad]. Both broadcast.

    Returns:
        [W m^-2 sr^-1 nm^-1], [..., 41 wavelengths from 380 to 780 nm]; of the last three the sun's
        own radiance is an extrapolation. Times 6.7637e-5 sr it is the irradiance.

    Raises:
        ValueError: A known argument is out of range.
    """
    share = sun_transmittance(turbidity, solar_zenith_angle).total
    return share * jnp.broadcast_to(
        jnp.asarray(preetham1999_spectra().sun_radiance, share.dtype), share.shape
    )


@extremes(
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)
def direct_sun_xyY(turbidity: RealsLike, solar_zenith_angle: RealsLike) -> Float[Array, "*s 3"]:
    """Chromaticity and luminance of the sun's disk.

    Args:
        turbidity: 1 to 64.
        solar_zenith_angle: 0 to pi/2 [rad]. Both broadcast.

    Returns:
        x, y and Y [cd m^-2], on a last axis.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Preetham, Shirley and Smits (1999), section 3.1 and appendix A.1.
    """
    radiance = direct_sun_radiance(turbidity, solar_zenith_angle)
    return spectrum_to_xyY(radiance, preetham1999_spectra().wavelength_nm)


extremes(
    call=lambda turbidity, solar_zenith_angle: direct_sun_radiance(turbidity, solar_zenith_angle),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)(direct_sun_radiance)
