"""The sun through the atmosphere."""

import numpy as np
import pytest

import atmofit as af

WAVELENGTHS = np.array([400.0, 550.0, 700.0])


@pytest.mark.parametrize("geometry", ["flat", "spherical"])
def test_an_overhead_sun_loses_the_vertical_optical_depth(geometry):
    air = af.Atmosphere(af.Molecules(0.3), af.Haze(0.2, 0.0), geometry=geometry)
    found = af.simulate_sun(air, 0.0, WAVELENGTHS, 1.0)
    np.testing.assert_allclose(found, np.exp(-0.5), rtol=1e-4)  # of the sphere's closed form


def test_a_gas_alone_needs_no_scatterer():
    gas = af.Absorber(0.4, af.GaussianLayer(22e3, 5e3))
    found = af.simulate_sun(af.Atmosphere(absorbers=(gas,), geometry="flat"), 0.0, 550.0, 1.0)
    np.testing.assert_allclose(found, np.exp(-0.4), rtol=1e-12)


def test_the_setting_sun_is_red_and_then_gone():
    air = af.Atmosphere.from_turbidity(3.0)
    blue, red = np.asarray(af.simulate_sun(air, np.radians(89.0), WAVELENGTHS, 1.0))[[0, 2]]
    assert 0 < blue < 0.01 * red
    assert not np.any(np.asarray(af.simulate_sun(air, np.radians(91.0), WAVELENGTHS, 1.0)))
    # From 10 km up the horizon lies 3.2 degrees lower.
    aloft = af.simulate_sun(air, np.radians(91.0), WAVELENGTHS, 1.0, observer_altitude=1e4)
    assert np.all(np.asarray(aloft) > 0)


def test_what_is_refused():
    air = af.Atmosphere.from_turbidity(3.0, "flat")
    with pytest.raises(ValueError, match=r"solar_zenith_angle must be .* got 1\.6"):
        af.simulate_sun(air, 1.6, WAVELENGTHS)
    with pytest.raises(ValueError, match=r"observer_altitude must be .* got -1"):
        af.simulate_sun(air, 0.5, WAVELENGTHS, observer_altitude=-1.0)
