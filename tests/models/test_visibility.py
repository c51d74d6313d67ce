"""Turbidity in other units."""

import numpy as np
import pytest

import atmofit as af


def test_pure_air_is_seen_through_for_280_kilometres():
    # 3.912 / 1.356e-5 is 288 km for air alone with the printed refractive index; at turbidity 1
    # the paper's concentration formula leaves a trace of haze.
    alone = 3.912 / 1.356e-5
    found = float(af.meteorological_range(1.0, 1.0003))
    assert 0.95 * alone < found < alone


def test_range_and_turbidity_are_inverse():
    turbidity = np.array([1.0, 1.5, 2.0, 6.0, 20.0, 64.0])
    there = af.meteorological_range(turbidity)
    assert (np.diff(there) < 0).all()
    np.testing.assert_allclose(af.turbidity_from_range(there), turbidity, rtol=1e-10)
    with pytest.raises(ValueError, match=r"meteorological_range must be between .* got 1e"):
        af.turbidity_from_range(1e6)


def test_range_is_that_of_the_low_air():
    air = af.low_air(af.Atmosphere.from_turbidity(5.0), [550.0])
    passing = af.path_transfer(
        air, af.Path(float(af.meteorological_range(5.0)), np.pi / 2), 0.0
    ).transmittance
    np.testing.assert_allclose(passing, 0.02, rtol=1e-6)


def test_three_ways_to_haze_agree():
    # Angstrom's formula against the ratio of optical depths, within .8 % (1.7 to 10); the paper's
    # concentration of haze, with the corrected refractive index, is 5 to 8 % off.
    for turbidity in (1.7, 3.0, 10.0):
        at_550 = float(af.angstrom_beta(turbidity)) * 0.55**-1.3
        assert at_550 == pytest.approx((turbidity - 1) * 0.008735 * 0.55**-4.08, rel=0.008)
        ratio = float(af.turbidity_of(af.Atmosphere.from_turbidity(turbidity)))
        assert ratio - 1 == pytest.approx(turbidity - 1, rel=0.09)
    assert af.turbidity_of(af.Atmosphere(molecules=af.Molecules())) == 1.0
    with pytest.raises(ValueError, match="atmosphere must have molecules"):
        af.turbidity_of(af.Atmosphere(haze=af.Haze(0.1)))
