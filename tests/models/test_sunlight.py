"""The direct sun against values and packages that share no code with it."""

import numpy as np
import pytest
from pvlib.atmosphere import get_relative_airmass

import atmofit as af

TABLE_NM = np.arange(380.0, 781.0, 10.0)


def test_optical_mass_is_kasten_s():
    zenith = np.linspace(0.0, 90.0, 91)
    expected = get_relative_airmass(zenith, model="kasten1966")
    np.testing.assert_allclose(af.optical_mass(np.radians(zenith)), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("zenith_deg", "x", "y", "Y"),
    [(0.0, 0.3304, 0.3405, 1.497e9), (80.0, 0.3906, 0.3907, 5.31e8)],
)
def test_colour_of_the_sun_at_turbidity_2(zenith_deg, x, y, Y):
    found = np.asarray(af.direct_sun_xyY(2.0, np.radians(zenith_deg)))
    # Given to the digits printed; sums over 10 nm differ by their ends.
    np.testing.assert_allclose(found[:2], [x, y], atol=1.5e-4)
    np.testing.assert_allclose(found[2], Y, rtol=1e-3)


def test_transmittances_follow_beer_s_law_and_leckner_s_bands():
    overhead, low = (af.sun_transmittance(3.0, np.radians(z)) for z in (0.0, 80.0))
    masses = np.asarray(af.optical_mass(np.radians([0.0, 80.0])))
    for name in ("molecules", "haze", "ozone"):
        depths = [-np.log(np.asarray(getattr(t, name))) for t in (overhead, low)]
        np.testing.assert_allclose(depths[1] * masses[0], depths[0] * masses[1], rtol=1e-6)
    # Lines saturate: a band absorbs less than in proportion.
    for name, λ in (("gases", 760.0), ("water", 720.0)):
        depths = [-np.log(np.asarray(getattr(t, name))[λ == TABLE_NM][0]) for t in (overhead, low)]
        assert 1 < depths[1] / depths[0] < 0.7 * masses[1] / masses[0]
    assert (np.asarray(overhead.total) <= np.asarray(overhead.haze)).all()


def test_exact_columns_give_nearly_the_same_sun():
    """The formula's optical depths against our own columns through the paper's exponential air."""
    for turbidity, zenith, most in ((2.0, 0.0, 0.03), (2.0, 70.0, 0.05), (4.0, 60.0, 0.1)):
        angle = np.radians(zenith)
        formula = af.sun_transmittance(turbidity, angle, ozone_column=0.0, water_column=0.0)
        share = np.asarray(formula.total)[:-4]  # without oxygen
        own = af.simulate_sun(af.Atmosphere.from_turbidity(turbidity), angle, TABLE_NM[:-4], 1.0)
        np.testing.assert_allclose(share, own, atol=most)


def test_between_the_table_s_wavelengths_absorption_is_linear():
    at, table = (af.sun_transmittance(2.0, 1.0, λ).ozone for λ in ([605.0], [600.0, 610.0]))
    np.testing.assert_allclose(np.log(at[0]), np.log(np.asarray(table)).mean(), rtol=1e-10)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"turbidity must be between 1 and 64, got 0\.5"):
        af.direct_sun_xyY(0.5, 0.0)
    with pytest.raises(ValueError, match=r"solar_zenith_angle must be .* got 1\.7"):
        af.optical_mass(1.7)
    with pytest.raises(ValueError, match="wavelength_nm must be between 380 and 780 nm, got 900"):
        af.sun_transmittance(2.0, 0.0, [900.0])
