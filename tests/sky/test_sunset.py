"""Sunlight and sky of Hoffman and Preetham (2002): what a round Earth's shadow and air must do."""

import numpy as np
import pytest

import atmofit as af

WAVELENGTHS = [450.0, 550.0, 650.0]
AIR = af.Atmosphere(molecules=af.Molecules())


def test_the_sun_reddens_as_it_sinks():
    suns = np.radians([0.0, 40.0, 70.0, 80.0, 85.0, 88.0, 90.0])
    light = np.stack([af.simulate_sun(AIR, sun, WAVELENGTHS, 1.0) for sun in suns])
    assert (np.diff(light[:, 2] / light[:, 0]) > 0).all()
    assert (np.diff(light, axis=0) < 0).all()


@pytest.fixture(scope="module")
def sunset():
    """Opposite a sun that has set by four degrees, from the horizon upward."""
    view = np.radians([89.0, 88.0, 86.0, 84.0, 80.0, 75.0, 70.0])
    directions = af.Directions(view, np.full(view.size, np.pi))
    return np.asarray(af.simulate_sky(AIR, np.radians(94.0), directions, WAVELENGTHS, 1, 1e-2, 1.0))


def test_the_earth_s_shadow_rises_opposite_the_sun(sunset):
    # A shell in which most light is scattered, to 30 km, is dark up to about 4 degrees.
    assert sunset[0, 1] < 0.5 * sunset.max(axis=0)[1]
    assert np.argmax(sunset[:, 1]) >= 2


def test_above_the_shadow_the_belt_is_red(sunset):
    seen = sunset[sunset[:, 0] > 1e-3 * sunset[:, 0].max()]
    assert len(seen) >= 3
    red = seen[:, 2] / seen[:, 0]
    assert (np.diff(red) < 0).all()
    assert red[0] > 1.5
