"""Where the sun stands: a formula in JAX, and an almanac for dates."""

import datetime
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.numerics import safe_sqrt
from atmofit.typing import Reals, RealsLike

_HOURS = 12 / math.pi  # per radian of the Earth's turn


@extremes(
    Case("pole", {"latitude": math.pi / 2, "day_of_year": 172.0}),
    Case("sun overhead at noon", {"latitude": 0.4091, "day_of_year": 173.0, "hour": 12.0}),
    Case("midnight", {"hour": 0.0}),
    latitude=Domain(-math.pi / 2, math.pi / 2),
    longitude=Domain(-math.pi, math.pi),
    day_of_year=Domain(1.0, 366.0),
    hour=Domain(0.0, 24.0),
    time_zone=Domain(-14.0, 14.0),
)
def solar_position(
    latitude: RealsLike,
    longitude: RealsLike,
    day_of_year: RealsLike,
    hour: RealsLike,
    time_zone: RealsLike = 0.0,
) -> tuple[Reals, Reals]:
    """Direction to the sun by the formula of the 1999 paper, without refraction.

    Within 1.1 degrees of an almanac between 70 degrees south and 60 north in 2013, 0.3 in the mean;
    it knows no leap years. The signs are those with which the formula is right; in print one of
    the azimuth's is wrong.

    Args:
        latitude: North is positive [rad].
        longitude: East is positive [rad], -pi to pi.
        day_of_year: 1 to 366.
        hour: Of the zone's standard time, 0 to 24.
        time_zone: East of Greenwich [h], -14 to 14. All arguments broadcast.

    Returns:
        Solar zenith angle, 0 to pi [rad], and solar azimuth, clockwise from north, 0 to 2 pi [rad].
        At the pole, or with the sun overhead, the azimuth has no meaning. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Preetham, Shirley and Smits (1999), appendix A.6.
    """
    named = {
        "latitude": (latitude, -math.pi / 2, math.pi / 2),
        "longitude": (longitude, -math.pi, math.pi),
        "day_of_year": (day_of_year, 1.0, 366.0),
        "hour": (hour, 0.0, 24.0),
        "time_zone": (time_zone, -14.0, 14.0),
    }
    checked = [in_range(name, *given, slack=1e-6) for name, given in named.items()]
    φ, λ, J, h, zone = jnp.broadcast_arrays(
        *(value.astype(jnp.result_type(*checked)) for value in checked)
    )
    # The paper counts longitudes west; the zone's meridian lies 15 degrees for each hour.
    equation = 0.170 * jnp.sin(4 * math.pi * (J - 80) / 373)
    equation = equation - 0.129 * jnp.sin(2 * math.pi * (J - 8) / 355)
    solar_time = h + equation + _HOURS * λ - zone
    declination = 0.4093 * jnp.sin(2 * math.pi * (J - 81) / 368)
    turn = solar_time / _HOURS
    up = jnp.sin(φ) * jnp.sin(declination) - jnp.cos(φ) * jnp.cos(declination) * jnp.cos(turn)
    west = -jnp.cos(declination) * jnp.sin(turn)
    south = -(jnp.cos(φ) * jnp.sin(declination) + jnp.sin(φ) * jnp.cos(declination) * jnp.cos(turn))
    along = safe_sqrt(west**2 + south**2)
    nowhere = along == 0  # the azimuth's slope has no limit there
    from_south = jnp.arctan2(jnp.where(nowhere, 0.0, west), jnp.where(nowhere, 1.0, south))
    return jnp.arctan2(along, up), jnp.mod(from_south + math.pi, 2 * math.pi)


def sun_at(
    time: datetime.datetime,
    latitude: float,
    longitude: float,
    altitude: float = 0.0,
) -> tuple[float, float]:
    """Direction to the sun by NREL's almanac, as pvlib computes it, without refraction.

    Args:
        time: With its time zone.
        latitude: North is positive [rad].
        longitude: East is positive [rad].
        altitude: Above the sea [m], -500 to 10,000.

    Returns:
        Solar zenith angle and solar azimuth, clockwise from north [rad].

    Raises:
        ValueError: A time without zone, or an argument out of range.
        ImportError: pvlib is not installed (`pip install 'atmofit[solar]'`).

    References:
        Reda and Andreas (2004), Solar Energy 76, 577.
    """
    if time.tzinfo is None:
        raise ValueError(f"time must have a time zone, got {time.isoformat()}")
    in_range("latitude", latitude, -math.pi / 2, math.pi / 2)
    in_range("longitude", longitude, -math.pi, math.pi)
    in_range("altitude", altitude, -500.0, 1e4, "m")
    try:
        import pandas
        from pvlib.solarposition import get_solarposition
    except ImportError as error:
        raise ImportError("dates need pvlib: pip install 'atmofit[solar]'") from error
    place = np.degrees([latitude, longitude]).tolist()
    table: Any = get_solarposition(pandas.DatetimeIndex([time]), *place, altitude=altitude)
    zenith, azimuth = np.radians([table["zenith"].to_numpy()[0], table["azimuth"].to_numpy()[0]])
    return float(zenith), float(azimuth)
