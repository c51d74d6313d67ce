"""Skies with absorbers and coloured grounds from few wavelengths."""

import dataclasses

import numpy as np
import pytest
from small_skies import DIRECTIONS, FEW_NODES

import atmofit as af

WAVELENGTHS = np.arange(380.0, 781.0, 10.0)
# Grass, roughly: an edge at 700 nm.
GRASS = af.Spectrum([380.0, 680.0, 730.0, 780.0], [0.05, 0.08, 0.4, 0.45])
NODES = dataclasses.replace(FEW_NODES, wavelength=9, rough=3)


def sky(air, sun, every):
    plan = af.plan_sky(air, orders="all", rtol=5e-2, dtype="float64", all_wavelengths=every)
    plan = dataclasses.replace(plan, nodes=NODES)
    return np.asarray(af.simulate_sky(air, sun, DIRECTIONS, WAVELENGTHS, plan=plan))


@pytest.mark.slow
@pytest.mark.parametrize("sun_deg", [30.0, 85.0])
def test_few_wavelengths_hold_ozone_and_a_coloured_ground(sun_deg):
    air = af.Atmosphere.standard(
        af.Haze(0.1, 1.3, 1.2e3), af.Ground(GRASS), ozone_dobson=300.0, geometry="flat"
    )
    sun = np.radians(sun_deg)
    every, few = (sky(air, sun, all_wavelengths) for all_wavelengths in (True, False))
    # Spectra within 2 %, worst at the long end, where three nodes hold the ground's effect;
    # luminance, which the rung promises to 1e-2, far better.
    assert 0 < np.abs(few / every - 1).max() < 2e-2
    bright, exact = (af.spectrum_to_XYZ(each, WAVELENGTHS)[..., 1] for each in (few, every))
    assert np.abs(np.asarray(bright / exact) - 1).max() < 4e-3
    # The gas and the ground's edge are not in the smooth part: without them it is far off.
    bare = dataclasses.replace(air, absorbers=(), ground=af.Ground(0.0))
    assert np.abs(sky(bare, sun, True) / every - 1).max() > 0.1


def test_no_gas_at_all_is_the_smooth_sky():
    bare = af.Atmosphere.from_turbidity(3.0, "flat")
    none = dataclasses.replace(bare, absorbers=(af.Absorber(0.0, af.GaussianLayer(22e3, 5e3)),))
    np.testing.assert_allclose(sky(none, 0.5, False), sky(bare, 0.5, False), rtol=1e-12)
