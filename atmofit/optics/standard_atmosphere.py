"""The US Standard Atmosphere 1976 below 86 km, from its defining constants.

U.S. Standard Atmosphere, 1976 (NOAA, NASA, USAF), NOAA-S/T 76-1562, part 1.
"""

import functools

import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.exponential_layers import ExponentialLayers
from atmofit.tables import us_standard_1976_layers
from atmofit.typing import Reals, RealsLike

HIGHEST_ALTITUDE = 2e5  # [m]
_RADIUS = 6356.766e3  # [m], at which the standard's gravity is g0
_GRAVITY = 9.80665  # [m/s^2], g0
_GAS_CONSTANT = 8314.32  # [J/(kmol K)], the standard's
_MOLAR_MASS = 28.9644  # [kg/kmol]
_AVOGADRO = 6.022169e26  # [1/kmol], the standard's
_GROUND_TEMPERATURE = 288.15  # [K]
_GROUND_PRESSURE = 101325.0  # [Pa]
# Geopotential altitude [m] where each layer begins, and its lapse rate [K/m] (table 4). The last
# is not the standard's: above 86 km the temperature stays, so that the density falls
# exponentially; 4e-6 of the column lies there.
_BASES = (0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84.852e3)
_LAPSE_RATES = (-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3, 0.0)
_WEIGHT = _GRAVITY * _MOLAR_MASS / _GAS_CONSTANT  # [K/m], of the air
_ALTITUDES = Domain(0.0, HIGHEST_ALTITUDE)


@functools.cache
def _at_bases() -> tuple[np.ndarray, np.ndarray]:
    """Temperature [K] and logarithm of the pressure [Pa] where the layers begin."""
    temperature, log_pressure = [_GROUND_TEMPERATURE], [np.log(_GROUND_PRESSURE)]
    for base, top, lapse in zip(_BASES[:-1], _BASES[1:], _LAPSE_RATES[:-1], strict=True):
        below, above = temperature[-1], temperature[-1] + lapse * (top - base)
        level = (top - base) / below if lapse == 0 else np.log(above / below) / lapse
        temperature.append(above)
        log_pressure.append(log_pressure[-1] - _WEIGHT * level)
    return np.asarray(temperature), np.asarray(log_pressure)


def geopotential_altitude(altitude: RealsLike) -> Reals:
    """Altitude that the same energy would lift a mass to if gravity did not fall.

    Args:
        altitude: Above sea level [m], 0 to 200,000, any shape.

    Returns:
        Geopotential altitude [m].

    Raises:
        ValueError: The altitude lies outside.
    """
    z = in_range("altitude", altitude, 0.0, HIGHEST_ALTITUDE, "m")
    return z * (_RADIUS / (_RADIUS + z))


extremes(
    Case("sea level", {"altitude": 0.0}, limit=0.0, slope={"altitude": 1.0}),
    Case("86 km", {"altitude": 86e3}, limit=84852.0, rtol=1e-6),  # the standard rounds to metres
    altitude=_ALTITUDES,
    least=0.0,
)(geopotential_altitude)


def standard_temperature(altitude: RealsLike) -> Reals:
    """Temperature of the standard atmosphere; above 86 km it stays, other than the standard's.

    Args:
        altitude: Above sea level [m], 0 to 200,000, any shape.

    Returns:
        Molecular-scale temperature [K], which is the temperature below 80 km and at most 0.04 %
        above it up to 86 km.

    Raises:
        ValueError: The altitude lies outside.
    """
    return _state(altitude)[0]


def standard_pressure(altitude: RealsLike) -> Reals:
    """Pressure of the standard atmosphere; above 86 km it falls exponentially.

    Args:
        altitude: Above sea level [m], 0 to 200,000, any shape.

    Returns:
        Pressure [Pa].

    Raises:
        ValueError: The altitude lies outside.
    """
    return jnp.exp(_state(altitude)[1])


def standard_number_density(altitude: RealsLike) -> Reals:
    """Molecules in a volume of the standard atmosphere; above 86 km it falls exponentially.

    Args:
        altitude: Above sea level [m], 0 to 200,000, any shape.

    Returns:
        Number density [1/m^3].

    Raises:
        ValueError: The altitude lies outside.
    """
    temperature, log_pressure = _state(altitude)
    return _AVOGADRO / _GAS_CONSTANT * jnp.exp(log_pressure) / temperature


extremes(
    Case("sea level", {"altitude": 0.0}, limit=288.15, slope={"altitude": -6.5e-3}),
    Case("tropopause", {"altitude": 11e3 * _RADIUS / (_RADIUS - 11e3)}, limit=216.65),
    altitude=_ALTITUDES,
    least=0.0,
)(standard_temperature)
extremes(
    Case("sea level", {"altitude": 0.0}, 101325.0, {"altitude": -101325.0 * _WEIGHT / 288.15}),
    altitude=_ALTITUDES,
    least=0.0,
)(standard_pressure)
extremes(
    Case("sea level", {"altitude": 0.0}, limit=101325.0 * _AVOGADRO / (_GAS_CONSTANT * 288.15)),
    altitude=_ALTITUDES,
    least=0.0,
)(standard_number_density)


def standard_density_profile() -> ExponentialLayers:
    """Density of the standard atmosphere in a form whose slant columns are cheap.

    Eight layers, in each of which the density is exponential, fitted to
    `standard_number_density`: within 0.71 % of it below 50 km and 2.9 % below 86 km; the column
    above an altitude is within 0.12 % below 30 km, 0.17 % below 50 km and 1.5 % below 86 km, and
    so are columns along rays (0.18 % below 45 km).
    """
    table = us_standard_1976_layers()
    return ExponentialLayers(table.base, table.scale_height)


extremes(
    Case("all of it", {"altitude": 0.0}, limit=1.0),
    call=lambda altitude: standard_density_profile().vertical_column(altitude),
    altitude=Span(0.0, 1e6),
    least=0.0,
)(standard_density_profile)


def _state(altitude: RealsLike) -> tuple[Reals, Reals]:
    """Temperature [K] and logarithm of the pressure [Pa]."""
    h = geopotential_altitude(altitude)
    temperatures, log_pressures = _at_bases()
    layer = jnp.searchsorted(
        jnp.asarray(_BASES[1:], h.dtype), h, side="right", method="compare_all"
    )

    def of_layer(values: object) -> Reals:
        return jnp.asarray(values, h.dtype)[layer]

    base = of_layer(temperatures)
    rise = h - of_layer(_BASES)
    change = of_layer(_LAPSE_RATES) * rise / base
    # log(1 + x) / x, by its series where the quotient would be 0 / 0.
    thin = jnp.abs(change) < 1e-3
    x = jnp.where(thin, 1.0, change)
    ratio = jnp.where(thin, 1 - change / 2 + change**2 / 3, jnp.log1p(x) / x)
    log_pressure = of_layer(log_pressures) - _WEIGHT * rise / base * ratio
    return base * (1 + change), log_pressure
