"""Optics of dry air by wavelength: refraction, depolarisation and Rayleigh scattering.

From first principles, as Bodhaine et al. (1999) recommend: J. Atmos. Oceanic Technol. 16, 1854.
"""

import math

import jax.numpy as jnp

from atmofit.checks import in_range
from atmofit.constants import MAXIMUM_WAVELENGTH_NM, MINIMUM_WAVELENGTH_NM
from atmofit.extremes import Case, Domain, extremes
from atmofit.typing import Reals, RealsLike

STANDARD_PRESSURE = 101325.0  # [Pa], at sea level
LARGEST_PRESSURE = 2e5  # [Pa], at the ground
MIDDLE_CARBON_DIOXIDE_PPM = 360.0  # of the source's tables; 60 more add 1e-4 to the optical depth
LARGEST_CARBON_DIOXIDE_PPM = 1e4

_AVOGADRO = 6.0221367e23  # [1/mol], the source's
_NUMBER_DENSITY = 2.546899e25  # [1/m^3], at 288.15 K and 1013.25 hPa
# [m/s^2], at 45 degrees of latitude and 5517.56 m, the mean altitude of the air's mass above sea
# level (eqs. 11 and 26). It is 0.26 % less at the equator and as much more at the poles.
_GRAVITY = 9.789159
_SLACK_NM = 1e-6 * MAXIMUM_WAVELENGTH_NM  # the rounding of float32
_UNIT = 1e-31  # [m^2]; in it cross sections keep their digits in float32

_WAVELENGTHS = Domain(MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM)
_CARBON_DIOXIDE = Domain(0.0, LARGEST_CARBON_DIOXIDE_PPM)


@extremes(
    # The formula by hand at 1 / wavelength^2 = 4 per square micrometre.
    Case(
        "500 nm",
        {"wavelength_nm": 500.0, "carbon_dioxide_ppm": 300.0},
        limit=1e-8 * (8060.51 + 2480990 / 128.274 + 17455.7 / 35.32957),
        slope={"carbon_dioxide_ppm": 0.54e-14 * (8060.51 + 2480990 / 128.274 + 17455.7 / 35.32957)},
    ),
    wavelength_nm=_WAVELENGTHS,
    carbon_dioxide_ppm=_CARBON_DIOXIDE,
    least=0.0,
)
def air_refractivity(
    wavelength_nm: RealsLike, carbon_dioxide_ppm: RealsLike = MIDDLE_CARBON_DIOXIDE_PPM
) -> Reals:
    """Refractive index of dry air minus 1, at 288.15 K and 1013.25 hPa.

    Args:
        wavelength_nm: In vacuum [nm], 200 to 3000, any shape. The source measured 185 to 1690;
            beyond, its formula is continued.
        carbon_dioxide_ppm: Share of the air's volume [1e-6], 0 to 10,000, a number.

    Returns:
        n - 1 [-], shape of `wavelength_nm`.

    Raises:
        ValueError: An argument lies outside its range.

    References:
        Peck and Reeder (1972), J. Opt. Soc. Am. 62, 958; Bodhaine et al. (1999), eqs. 18 and 19.
    """
    return 1e-8 * _refractivity(*_checked(wavelength_nm, carbon_dioxide_ppm))


@extremes(
    Case("air without it", {"carbon_dioxide_ppm": 0.0}),
    # (78.084 F(N2) + 20.946 F(O2) + 0.934) / 99.964 at 1 micrometre.
    Case(
        "1000 nm, no carbon dioxide",
        {"wavelength_nm": 1000.0, "carbon_dioxide_ppm": 0.0},
        limit=(78.084 * 1.034317 + 20.946 * 1.0975298 + 0.934) / 99.964,
    ),
    wavelength_nm=_WAVELENGTHS,
    carbon_dioxide_ppm=_CARBON_DIOXIDE,
    least=0.0,
)
def king_factor(
    wavelength_nm: RealsLike, carbon_dioxide_ppm: RealsLike = MIDDLE_CARBON_DIOXIDE_PPM
) -> Reals:
    """By how much the anisotropy of its molecules raises the scattering of dry air.

    Args:
        wavelength_nm: [nm], 200 to 3000, any shape.
        carbon_dioxide_ppm: Share of the air's volume [1e-6], 0 to 10,000, a number.

    Returns:
        King factor F(air) [-], shape of `wavelength_nm`.

    Raises:
        ValueError: An argument lies outside its range.

    References:
        Bates (1984), Planet. Space Sci. 32, 785; Bodhaine et al. (1999), eqs. 5, 6 and 23.
    """
    return 1 + _king_factor_less_1(*_checked(wavelength_nm, carbon_dioxide_ppm))


@extremes(wavelength_nm=_WAVELENGTHS, carbon_dioxide_ppm=_CARBON_DIOXIDE, least=0.0)
def air_depolarisation(
    wavelength_nm: RealsLike, carbon_dioxide_ppm: RealsLike = MIDDLE_CARBON_DIOXIDE_PPM
) -> Reals:
    """Depolarisation factor of dry air, for light that arrives unpolarised.

    Args:
        wavelength_nm: [nm], 200 to 3000, any shape.
        carbon_dioxide_ppm: Share of the air's volume [1e-6], 0 to 10,000, a number.

    Returns:
        The ratio of the weaker to the stronger polarisation, scattered aside [-]: the solution
        of F = (6 + 3 rho) / (6 - 7 rho), with the King factor F.

    Raises:
        ValueError: An argument lies outside its range.
    """
    king_less_1 = _king_factor_less_1(*_checked(wavelength_nm, carbon_dioxide_ppm))
    return 6 * king_less_1 / (10 + 7 * king_less_1)


@extremes(wavelength_nm=_WAVELENGTHS, carbon_dioxide_ppm=_CARBON_DIOXIDE, least=0.0)
def rayleigh_cross_section(
    wavelength_nm: RealsLike, carbon_dioxide_ppm: RealsLike = MIDDLE_CARBON_DIOXIDE_PPM
) -> Reals:
    """Scattering cross section of a molecule of dry air.

    Args:
        wavelength_nm: [nm], 200 to 3000, any shape.
        carbon_dioxide_ppm: Share of the air's volume [1e-6], 0 to 10,000, a number.

    Returns:
        Cross section [m^2]. In float32 its slope by wavelength nears the smallest number there
        is and loses digits, 4 % at 3000 nm; `rayleigh_optical_depth` does not.

    Raises:
        ValueError: An argument lies outside its range.

    References:
        Bodhaine et al. (1999), eq. 22.
    """
    return _UNIT * _cross_section_in_units(*_checked(wavelength_nm, carbon_dioxide_ppm))


@extremes(
    Case("vacuum", {"surface_pressure": 0.0}, limit=0.0),
    wavelength_nm=_WAVELENGTHS,
    surface_pressure=Domain(0.0, LARGEST_PRESSURE),
    carbon_dioxide_ppm=_CARBON_DIOXIDE,
    least=0.0,
)
def rayleigh_optical_depth(
    wavelength_nm: RealsLike,
    surface_pressure: RealsLike = STANDARD_PRESSURE,
    carbon_dioxide_ppm: RealsLike = MIDDLE_CARBON_DIOXIDE_PPM,
) -> Reals:
    """Vertical optical depth of dry air above a ground, by scattering.

    Gravity is that of 45 degrees of latitude and a ground near sea level; the optical depth is
    0.26 % larger at the equator and as much smaller at the poles.

    Args:
        wavelength_nm: [nm], 200 to 3000, any shape.
        surface_pressure: At the ground [Pa], 0 to 200,000, a number.
        carbon_dioxide_ppm: Share of the air's volume [1e-6], 0 to 10,000, a number.

    Returns:
        Optical depth [-], shape of `wavelength_nm`.

    Raises:
        ValueError: An argument lies outside its range.

    References:
        Bodhaine et al. (1999), eqs. 17, 22, 25 and 26.
    """
    inverse, share = _checked(wavelength_nm, carbon_dioxide_ppm)
    pressure = in_range("surface_pressure", surface_pressure, 0.0, LARGEST_PRESSURE, "Pa")
    molar_mass = 1e-3 * (15.0556 * share + 28.9595)  # [kg/mol]
    column = pressure.astype(inverse.dtype) * (_AVOGADRO * _UNIT / _GRAVITY) / molar_mass
    return _cross_section_in_units(inverse, share) * column


def _refractivity(inverse: Reals, share: Reals) -> Reals:
    """Refractive index minus 1, in units of 1e-8."""
    at_300_ppm = 8060.51 + 2480990 / (132.274 - inverse) + 17455.7 / (39.32957 - inverse)
    return at_300_ppm * (1 + 0.54 * (share - 3e-4))


def _king_factor_less_1(inverse: Reals, share: Reals) -> Reals:
    """King factor minus 1; argon's is 0."""
    nitrogen = 0.034 + 3.17e-4 * inverse
    oxygen = 0.096 + (1.385e-3 + 1.448e-4 * inverse) * inverse
    carbon_dioxide = 100 * share  # in per cent, as the others
    parts = 78.084 * nitrogen + 20.946 * oxygen + carbon_dioxide * 0.15
    return parts / (78.084 + 20.946 + 0.934 + carbon_dioxide)


def _cross_section_in_units(inverse: Reals, share: Reals) -> Reals:
    """Cross section in units of 1e-31 m^2, of order 1 in visible light."""
    n_less_1 = 1e-8 * _refractivity(inverse, share)
    # n^2 - 1 as (n - 1)(n + 1): n itself would lose four digits in float32.
    lorentz = 1e4 * n_less_1 * (2 + n_less_1) / (3 + (2 + n_less_1) * n_less_1)
    scale = 24 * math.pi**3 * 1e24 * 1e-8 / (_NUMBER_DENSITY**2 * _UNIT)
    return scale * (lorentz * inverse) ** 2 * (1 + _king_factor_less_1(inverse, share))


def _checked(wavelength_nm: RealsLike, carbon_dioxide_ppm: RealsLike) -> tuple[Reals, Reals]:
    """1 / wavelength^2 [1/micrometre^2], and carbon dioxide as a share in the same dtype."""
    low, high = MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM
    wavelength = in_range("wavelength_nm", wavelength_nm, low, high, "nm", slack=_SLACK_NM)
    ppm = in_range("carbon_dioxide_ppm", carbon_dioxide_ppm, 0.0, LARGEST_CARBON_DIOXIDE_PPM)
    return 1 / jnp.square(1e-3 * wavelength), 1e-6 * ppm.astype(wavelength.dtype)
