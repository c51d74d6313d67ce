"""The sun's place against an almanac."""

import datetime
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af


def almanac(days, hours, latitude_deg, longitude_deg):
    import pandas
    from pvlib.solarposition import get_solarposition

    first = pandas.Timestamp("2013-01-01", tz="UTC")
    elapsed = [pandas.Timedelta(days=d - 1, hours=h) for d, h in zip(days, hours, strict=True)]
    times = pandas.DatetimeIndex([first + each for each in elapsed])
    found: Any = get_solarposition(times, latitude_deg, longitude_deg)
    return np.radians(found["zenith"].to_numpy()), np.radians(found["azimuth"].to_numpy())


@pytest.mark.reference
@pytest.mark.parametrize("latitude_deg", [-70.0, -35.0, -23.4, 0.0, 42.4, 60.0])
@pytest.mark.parametrize("longitude_deg", [-76.5, 151.0])
def test_formula_is_within_a_degree_of_the_almanac(latitude_deg, longitude_deg):
    days, hours = (
        a.ravel() for a in np.meshgrid(np.arange(1.0, 366.0, 13.0), np.arange(0.0, 24.0))
    )
    zone = round(longitude_deg / 15)  # so that the day is the place's own
    zenith, azimuth = almanac(days, hours - zone, latitude_deg, longitude_deg)
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    found = af.solar_position(latitude, longitude, days, hours, zone)
    apart = np.degrees(af.scattering_angle(found[0], found[1] - azimuth, zenith))
    # The formula knows no years and the day begins elsewhere: seen .85 to 1.11, mean .27 to .34.
    assert apart.max() <= 1.15
    assert apart.mean() <= 0.36


@pytest.mark.reference
def test_dates_are_those_of_the_almanac_and_know_their_zone():
    eastern = datetime.timezone(datetime.timedelta(hours=-4))
    noon = datetime.datetime(2013, 5, 27, 13, 2, tzinfo=eastern)
    latitude, longitude = np.radians([42.443449, -76.481962]).tolist()
    zenith, azimuth = af.sun_at(noon, latitude, longitude, altitude=270.0)
    assert np.degrees(zenith) == pytest.approx(42.4434 - 21.35, abs=0.1)  # latitude - declination
    assert np.degrees(azimuth) == pytest.approx(180.0, abs=2.0)
    again = noon.astimezone(datetime.UTC)
    assert af.sun_at(again, latitude, longitude, altitude=270.0) == (zenith, azimuth)


def test_slopes_are_finite_and_those_of_differences():
    at = jnp.asarray([0.7, -1.3, 147.0, 10.5])

    def both(x):
        return jnp.stack(af.solar_position(x[0], x[1], x[2], x[3], -5.0))

    slope = jax.jacrev(both)(at)
    h = 1e-5
    for k in range(4):
        step = h * np.eye(4)[k]
        difference = (both(at + step) - both(at - step)) / (2 * h)
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-6, atol=1e-8)
    overhead = jax.jacfwd(lambda h: jnp.stack(af.solar_position(0.0, 0.0, 81.0, h)))(12.0)
    assert np.isfinite(overhead).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((2.0, 0.0, 100.0, 12.0), "latitude must be between -1.5708 and 1.5708, got 2"),
        ((0.0, 4.0, 100.0, 12.0), "longitude must be .* got 4"),
        ((0.0, 0.0, 367.0, 12.0), "day_of_year must be between 1 and 366, got 367"),
        ((0.0, 0.0, 100.0, 25.0), "hour must be between 0 and 24, got 25"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        af.solar_position(*arguments)


def test_dates_without_zone_are_refused():
    with pytest.raises(ValueError, match="time must have a time zone, got 2013-05-27T12:00:00"):
        af.sun_at(datetime.datetime(2013, 5, 27, 12), 0.7, -1.3)
