"""Gases of real air: amounts, the band formula, and the sky of the standard atmosphere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.optics.standard_atmosphere import standard_number_density

# Where table 2 of the paper gives a coefficient.
ROWS = [(450.0, 0.3), (550.0, 8.5), (600.0, 12.5), (770.0, 0.4), (390.0, 0.0)]
KINDS = {
    "ozone": af.Absorber.ozone,
    "water vapour": af.Absorber.water_vapour,
    "mixed gases": af.Absorber.mixed_gases,
}


def _depth(gas, wavelength_nm):
    return float(gas.optical_depth_at(jnp.asarray([wavelength_nm]))[0])


@pytest.mark.parametrize(("wavelength", "coefficient"), ROWS)
def test_ozone(wavelength, coefficient):
    """350 Dobson units are the 0.0035 m of the paper's appendix A.1."""
    assert _depth(af.Absorber.ozone(350.0), wavelength) == pytest.approx(coefficient * 0.0035)


def test_ozone_at_its_visible_maximum():
    # The cross section near 602 nm is 5.1e-25 m^2 in the laboratory, and a Dobson unit 2.687e20
    # molecules per square metre; the table's coefficient is 9 % lower.
    measured = 5.1e-25 * 2.687e20 * 300
    assert _depth(af.Absorber.ozone(), 600.0) == pytest.approx(measured, rel=0.1)


def _band_formula(factor, saturation, k_amount, airmass):
    """Leckner (1978), as the paper prints it in appendix A.1: optical depth along a path."""
    return factor * k_amount * airmass / (1 + saturation * k_amount * airmass) ** 0.45


WATER = (0.2385, 20.07, 100.0 * 0.02)  # 720 nm, 20 kg/m^2
OXYGEN = (1.41, 118.93, 3.0)  # 760 nm


@pytest.mark.parametrize("airmass", [1.0, 1.5, 7.0])
def test_saturated_gases_meet_the_band_formula_at_their_air_mass(airmass):
    water = _depth(af.Absorber.water_vapour(20.0, airmass=airmass), 720.0)
    assert water * airmass == pytest.approx(_band_formula(*WATER, airmass), rel=1e-12)
    oxygen = _depth(af.Absorber.mixed_gases(airmass=airmass), 760.0)
    assert oxygen * airmass == pytest.approx(_band_formula(*OXYGEN, airmass), rel=1e-12)


@pytest.mark.parametrize(
    ("airmass", "water", "oxygen"),
    [(1.0, -0.16, -0.17), (2.0, 0.14, 0.14), (5.0, 0.71, 0.72), (10.0, 1.33, 1.35)],
)
def test_stated_errors_at_other_air_masses(airmass, water, oxygen):
    """What Beer's law makes of saturated bands; the figures stand in the docstrings."""
    found = _depth(af.Absorber.water_vapour(20.0), 720.0) * airmass
    assert found / _band_formula(*WATER, airmass) - 1 == pytest.approx(water, abs=5e-3)
    found = _depth(af.Absorber.mixed_gases(), 760.0) * airmass
    assert found / _band_formula(*OXYGEN, airmass) - 1 == pytest.approx(oxygen, abs=5e-3)


def test_little_water_absorbs_by_beers_law():
    one, ten = (_depth(af.Absorber.water_vapour(1e-6, airmass=m), 720.0) for m in (1.0, 10.0))
    assert one == pytest.approx(0.2385 * 100 * 1e-9, rel=1e-6)  # saturation: 0.45 20 1e-7
    assert ten == pytest.approx(one, rel=1e-5)


def test_profiles():
    z = jnp.array([0.0, 4e3, 22e3])
    density = af.Absorber.water_vapour().density_profile().density(z)
    assert density[1] / density[0] == pytest.approx(np.exp(-2.0))
    density = af.Absorber.mixed_gases().density_profile().density(z)
    real = standard_number_density(z)
    assert density[1] / density[0] == pytest.approx(float(real[1] / real[0]), rel=0.014)


# Mid-latitude ozone of the US Standard Atmosphere 1976 (Krueger and Minzner 1976): altitude [km],
# and density [1e18 / m^3]. The column is 345 Dobson units.
OZONE_KM = [0, 1, 2, *range(4, 52, 2)]
OZONE = [1.02, 0.92, 0.68, 0.58, 0.57, 0.65, 1.13, 2.02, 2.35, 2.95, 4.04, 4.77, 4.86, 4.54]
OZONE += [4.03, 3.24, 2.52, 2.03, 1.58, 1.22, 0.873, 0.607, 0.398, 0.274, 0.169, 0.103, 0.0664]


def test_ozone_lies_where_the_standard_has_it():
    z = np.linspace(0.0, 5e4, 2001)
    density = 1e18 * np.interp(z, np.multiply(OZONE_KM, 1e3), OZONE)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2) * z[1]])
    assert below[-1] / 2.687e20 == pytest.approx(345, rel=0.01)  # linear between 2 km
    above = af.Absorber.ozone().density_profile().vertical_column(jnp.asarray(z))
    # What a Gaussian can do: seen 0.028 (one of 22 km and 5 km: 0.13).
    assert np.abs(np.asarray(above) - (1 - below / below[-1])).max() < 0.03


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", KINDS)
def test_amounts_are_traced(name, dtype):
    wavelength = jnp.asarray([380.0, 600.0, 720.0, 760.0, 780.0], dtype)

    def depth(amount):
        return KINDS[name](amount).checked().optical_depth_at(wavelength).sum()

    for amount in (0.0, 10.0):
        value, slope = jax.jit(jax.value_and_grad(depth))(jnp.asarray(amount, dtype))
        assert value.dtype == dtype
        assert np.isfinite(value)
        assert slope > 0


@pytest.mark.parametrize("name", KINDS)
def test_slopes_by_the_amounts(name):
    def depth(amount):
        return KINDS[name](amount).optical_depth_at(jnp.array([600.0, 720.0, 760.0])).sum()

    change = (depth(10.001) - depth(9.999)) / 0.002
    # Central difference: third derivative times 1e-6 / 6 over the slope, below 1e-8.
    assert float(jax.grad(depth)(10.0)) == pytest.approx(float(change), rel=1e-7)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("wavelength", [379.0, 781.0])
def test_wavelengths_beyond_the_table_are_refused(name, wavelength):
    with pytest.raises(ValueError, match="wavelength_nm must be between 380 and 780 nm, got"):
        _depth(KINDS[name](), wavelength)


@pytest.mark.parametrize(
    ("gas", "message"),
    [
        (lambda: af.Absorber.ozone(-1.0), "column_dobson must be between 0 and 1000 DU, got -1"),
        (lambda: af.Absorber.water_vapour(101.0), "column_kg_m2 must be between 0 and 100 kg"),
        (lambda: af.Absorber.water_vapour(scale_height=0.0), "scale_height must be between 1"),
        (lambda: af.Absorber.water_vapour(airmass=0.5), "airmass must be between 1 and 40, got"),
        (lambda: af.Absorber.mixed_gases(np.nan), "surface_pressure must be .* got nan"),
    ],
)
def test_impossible_amounts_are_refused(gas, message):
    with pytest.raises(ValueError, match=message):
        gas()


DIRECTIONS = af.Directions(jnp.array([0.0, 1.2]), jnp.array([0.0, 2.0]))


def _sky(orders, wavelength_nm=(450.0, 600.0), **keywords):
    atmosphere = af.Atmosphere.standard(**keywords)
    return np.asarray(
        af.simulate_sky(atmosphere, 1.0, DIRECTIONS, wavelength_nm, orders=orders, rtol=1.0)
    )


def test_the_standard_atmosphere():
    atmosphere = af.Atmosphere.standard()
    assert atmosphere.preset == "standard"
    assert not atmosphere.is_smooth  # ozone: every wavelength is computed
    assert af.Atmosphere.standard(ozone_dobson=None).is_smooth
    assert af.Atmosphere.standard(af.Haze(0.1), af.Ground(0.2), ozone_dobson=None).is_smooth


def test_ozone_darkens_the_standard_sky():
    with_ozone, without = _sky(1), _sky(1, ozone_dobson=None)
    assert (without > 0).all()
    # Overhead, most ozone lies above the air that scatters and dims the sunlight on its way down,
    # whose path is 1 / cos; below, what is left dims the shorter way to the eye.
    transmittance = with_ozone[0] / without[0]
    vertical = np.array([0.3, 12.5]) * 3e-3
    assert (transmittance > np.exp(-vertical / np.cos(1.0))).all()
    assert (transmittance < np.exp(-vertical)).all()


def test_air_of_a_thin_single_scattering_sky():
    """Molecules only, far red: radiance near tau p / (4 mu's) times the sun, to first order."""
    wavelength = 2500.0  # optical depth 2e-4
    found = _sky(1, [wavelength], ozone_dobson=None)[0, 0]
    air = af.Molecules.standard()
    tau = float(air.optical_depth_at(jnp.asarray([wavelength]))[0])
    sun = float(af.solar_irradiance_spectrum("standard")(wavelength))
    phase = float(air.phase()(1.0, wavelength))
    assert found == pytest.approx(sun * tau * phase, rel=1e-3)  # extinction: 3 tau / 2 = 3e-4


@pytest.mark.slow
def test_two_orders_of_the_standard_sky():
    air = af.Atmosphere.standard(af.Haze(0.1), af.Ground(0.2), geometry="flat")
    plan = af.plan_sky(air, orders=2, rtol=1.0, by_order=True)
    field = af.solve_sky(air, [450.0, 600.0], plan=plan)
    apart = np.asarray(field.radiance_by_order(1.0, DIRECTIONS))
    assert np.isfinite(apart).all()
    assert (apart > 0).all()


@pytest.mark.slow
def test_slopes_of_the_standard_sky():
    def total(pressure, ozone):
        atmosphere = af.Atmosphere.standard(surface_pressure=pressure, ozone_dobson=ozone)
        return af.simulate_sky(
            atmosphere, 1.0, DIRECTIONS, [450.0, 600.0], orders=1, rtol=1.0
        ).sum()

    slopes = jax.grad(total, argnums=(0, 1))(101325.0, 300.0)
    for k, step in enumerate((10.0, 1.0)):
        ends = [[101325.0, 300.0], [101325.0, 300.0]]
        ends[0][k] += step
        ends[1][k] -= step
        change = (total(*ends[0]) - total(*ends[1])) / (2 * step)
        assert float(slopes[k]) == pytest.approx(float(change), rel=1e-4)
