"""Turbidity in other units: optical depths, Angstrom's coefficient and meteorological range."""

import math

import jax.numpy as jnp

from atmofit.checks import in_range, is_traced
from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY, REFERENCE_WAVELENGTH_NM
from atmofit.extremes import Case, Domain, extremes
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import molecular_scattering_coefficient
from atmofit.tables import constant
from atmofit.typing import Reals, RealsLike, real_array

CONTRAST = 0.02  # that an eye still sees: Koschmieder's meteorological range
_RANGE = -math.log(CONTRAST)  # 3.912 optical depths
_REFRACTION = 1.000278
_ROUNDING = 1e-4


@extremes(
    Case("clear", {"turbidity": 1.0}, limit=0.04608 - 0.04586, size=0.04),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
)
def angstrom_beta(turbidity: RealsLike) -> Reals:
    """Angstrom's turbidity coefficient: optical depth of the haze at 1 micrometre.

    Args:
        turbidity: 1 to 64.

    References:
        Preetham, Shirley and Smits (1999), appendix A.1.
    """
    T = in_range("turbidity", turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY)
    return constant("angstrom_beta_slope") * T + constant("angstrom_beta_intercept")


def turbidity_of(atmosphere: Atmosphere) -> Reals:
    """Optical depth of air with haze over that of air alone at 550 nm, absorbing gases left out.

    Args:
        atmosphere: With molecules.

    Raises:
        ValueError: It has no molecules, or is impossible.

    References:
        Preetham, Shirley and Smits (1999), section 2.2.
    """
    air = atmosphere.checked()
    if air.molecules is None:
        raise ValueError("atmosphere must have molecules for a turbidity, got none")
    wavelength = real_array([REFERENCE_WAVELENGTH_NM])
    molecules = air.molecules.optical_depth_at(wavelength)[0]
    if air.haze is None:
        return jnp.ones_like(molecules)
    return 1 + air.haze.optical_depth_at(wavelength)[0] / molecules


extremes(
    call=lambda turbidity: turbidity_of(Atmosphere.from_turbidity(turbidity)),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
)(turbidity_of)


def _surface_extinction(turbidity: Reals, refractive_index: Reals) -> Reals:
    """Scattering coefficient of air and haze at the ground at 550 nm [1/m]."""
    wavelength = jnp.asarray([REFERENCE_WAVELENGTH_NM], refractive_index.dtype)
    molecules = molecular_scattering_coefficient(wavelength, refractive_index)[0]
    haze = jnp.vectorize(lambda T: Haze.from_turbidity(T).optical_depth_at(wavelength)[0])
    return molecules + haze(turbidity) * constant("haze_decay")


@extremes(
    Case("clear", {"turbidity": 1.0}),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    refractive_index=Domain(1.0002, 1.0004),
)
def meteorological_range(turbidity: RealsLike, refractive_index: RealsLike = _REFRACTION) -> Reals:
    """Distance at which a black object before the horizon keeps 2 % contrast, at 550 nm.

    Args:
        turbidity: 1 to 64.
        refractive_index: Of air, a number, 1.0002 to 1.0004; 1.0003 is what the paper prints.

    Returns:
        [m].

    References:
        Preetham, Shirley and Smits (1999), section 2.2 and figure 3; Koschmieder (1924).
    """
    T = in_range("turbidity", turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY)
    n = in_range("refractive_index", refractive_index, 1.0002, 1.0004)
    return _RANGE / _surface_extinction(T, n.astype(T.dtype))


def turbidity_from_range(
    meteorological_range: RealsLike, refractive_index: RealsLike = _REFRACTION
) -> Reals:
    """Turbidity of a meteorological range, the inverse of `meteorological_range`.

    Args:
        meteorological_range: [m]; what belongs to turbidities from 1 to 64.
        refractive_index: Of air, as there.

    Raises:
        ValueError: A range that no such turbidity has.
    """
    n = in_range("refractive_index", refractive_index, 1.0002, 1.0004)
    R = in_range("meteorological_range", meteorological_range, 1e-3, math.inf, "m")
    # Extinction is linear in turbidity.
    ends = jnp.asarray([MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY], n.dtype)
    clear, thick = (x.astype(R.dtype) for x in _surface_extinction(ends, n))
    if not is_traced(n):
        low, high = _RANGE / float(thick), _RANGE / float(clear)
        R = in_range("meteorological_range", R, low, high, "m", slack=1e-6 * high)
    share = (_RANGE / R - clear) / (thick - clear)
    turbidity = MINIMUM_TURBIDITY + (MAXIMUM_TURBIDITY - MINIMUM_TURBIDITY) * share
    return jnp.where((share > -_ROUNDING) & (share < 1 + _ROUNDING), turbidity, jnp.nan)


extremes(
    call=lambda turbidity: turbidity_from_range(meteorological_range(turbidity)),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
)(turbidity_from_range)
