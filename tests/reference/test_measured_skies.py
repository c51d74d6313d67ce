"""Reading the measured skies and scoring two other codes against them."""

import jax.numpy as jnp
import numpy as np
import pytest
from measured_air import OZONE_DOBSON, read_retrievals, real_air, real_atmosphere
from measured_data import (
    NEAR_SUN,
    DataMissing,
    data_folder,
    luminance,
    read_codes,
    read_npz,
    read_skies,
    score,
)
from measured_fitted import fitted_scores, hosek_wilkie, site_albedo
from measured_models import (
    daylight_spectrum,
    simulation,
    site_atmosphere,
    turbidity_from_optical_depth,
)

import atmofit as af

SCANS = "measured_sky_2013/scans.npz"
needs_data = pytest.mark.skipif(
    not (data_folder() / SCANS).is_file(),
    reason="measured skies absent: set ATMOFIT_DATA to the folder that holds measured_sky_2013",
)
pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def skies():
    return read_skies(data_folder())


@pytest.fixture(scope="module")
def scores(skies):
    return {(row["model"], row["group"]): row for row in score(skies, read_codes(data_folder()))}


@needs_data
def test_scans_are_repaired_and_turned_toward_the_sun(skies):
    raw = read_npz(data_folder(), SCANS)
    fine, wavelength_nm = raw["radiance_W_m2_sr_nm"].astype(float), raw["wavelength_nm"]
    assert skies.radiance.shape == (10, 81, 40)
    assert {name: int(scans.sum()) for name, scans in skies.groups.items()} == {
        "may": 8,
        "september": 2,
    }
    np.testing.assert_allclose(
        skies.radiance[:, 0], skies.radiance[:, [1, 31]].mean(axis=1), rtol=1e-12
    )
    # 407 and 501 nm are among the measured wavelengths, 418.75 nm lies between two.
    for wavelength, share in ((407.0, 0.0), (501.0, 0.0), (418.75, 0.75)):
        k = np.searchsorted(wavelength_nm, np.floor(wavelength))
        expected = (1 - share) * fine[:, 1:, k] + share * fine[:, 1:, k + 1]
        at = skies.radiance[:, 1:, skies.wavelength_nm == wavelength][..., 0]
        np.testing.assert_allclose(at, expected, rtol=1e-6)
    near = (skies.scattering_angle < NEAR_SUN).sum(axis=1)
    assert near[skies.groups["may"]].sum() == 9
    # In May the brightest direction is next to the sun, seen: within 8.5 degrees.
    brightest = skies.luminance.argmax(axis=1)
    angle = skies.scattering_angle[np.arange(10), brightest]
    assert (angle[skies.groups["may"]] < NEAR_SUN).all()


@needs_data
def test_luminance_agrees_with_that_of_the_data_set(skies):
    given = read_npz(data_folder(), SCANS)["luminance_cd_m2"]
    # The data set integrates over every nm, here over 40 samples; seen: 0.57 %.
    np.testing.assert_allclose(skies.luminance[:, 1:], given[:, 1:], rtol=8e-3)


@needs_data
def test_directions_share_their_rings(skies):
    directions = skies.directions
    assert len(directions) == 10
    assert directions[0].rings == (32, 24, 16, 8, 1)
    directions[0].checked()


@needs_data
@pytest.mark.parametrize(
    ("model", "rms", "far", "relative"),
    # Seen: 11.47, 8.85 and 11.35, 9.00 mW. Another resampling moves them by 0.5 to 1.5.
    [("disort", 11.5, 8.9, 0.124), ("libradtran", 11.4, 9.0, 0.121)],
)
def test_codes_in_may_are_the_noise_floor(scores, model, rms, far, relative):
    row = scores[model, "may"]
    assert row["rms_mW"] == pytest.approx(rms, abs=0.2)
    assert row["rms_far_mW"] == pytest.approx(far, abs=0.2)
    assert row["luminance_rms_relative"] == pytest.approx(relative, abs=0.005)


@needs_data
@pytest.mark.parametrize("model", ["disort", "libradtran"])
def test_codes_in_september_had_another_aerosol(scores, model):
    # Reported as about 25 mW; seen: 25.3 and 26.4.
    assert scores[model, "september"]["rms_mW"] == pytest.approx(25.5, abs=1.5)


@needs_data
def test_averaging_over_bands_lowers_the_noise():
    banded = read_skies(data_folder(), band=True)
    rows = score(banded, read_codes(data_folder()))
    # Seen: 10.27 and 10.17 mW.
    assert all(9.7 < row["rms_mW"] < 10.7 for row in rows if row["group"] == "may")


@needs_data
@pytest.mark.slow
def test_simulation_with_the_air_of_the_codes_is_as_good_as_disort(skies, scores):
    simulated = simulation(skies, *site_atmosphere(data_folder()), "all")
    disort, _ = read_codes(data_folder())
    may = skies.groups["may"]
    difference = simulated.radiance[may] - disort.radiance[may]
    # Seen: 1.26 %, and 11.54 beside 11.47 mW.
    assert np.sqrt((difference**2).mean() / (disort.radiance[may] ** 2).mean()) < 0.015
    (row,) = (row for row in score(skies, [simulated]) if row["group"] == "may")
    assert row["rms_mW"] == pytest.approx(scores["disort", "may"]["rms_mW"], abs=0.4)


@needs_data
@pytest.mark.slow
def test_simulation_with_real_air(skies):
    may, september = score(skies, [real_air(skies, data_folder())])
    assert np.isfinite([*may["rms_mW_by_scan"], *september["rms_mW_by_scan"]]).all()
    # Seen: 17.4 and 43.3 mW. Within 1 %, the simulator's promise, of a mean radiance of 65 mW in
    # May; in September a direction next to the low sun carries most of it.
    assert may["rms_mW"] == pytest.approx(17.4, abs=0.7)
    assert september["rms_mW"] == pytest.approx(43.3, abs=2.0)
    # Too bright, but the pattern is better than that of the codes, 10.5 %; seen: 1.209 and 6.1 %.
    assert may["luminance_level"] == pytest.approx(1.21, abs=0.02)
    assert may["luminance_pattern_rms"] < 0.07


@needs_data
def test_real_air_is_as_its_sources_say():
    aerosol = read_retrievals(data_folder())
    assert aerosol.optical_depth == pytest.approx(0.097, abs=0.001)
    assert aerosol.angstrom_exponent == pytest.approx(1.017, abs=0.001)
    μ = np.cos(aerosol.scattering_angle)
    total = -np.trapezoid(aerosol.phase_function, μ, axis=0) / 2
    # The angles are 2 degrees apart, but for the peak; seen: 0.3 % below 1.
    np.testing.assert_allclose(total, 1.0, rtol=1e-2)
    site = read_npz(data_folder(), SCANS)
    for group, day in (("may", 147), ("september", 267)):
        expected = van_heuklon_ozone(site["latitude_deg"], site["longitude_deg"], day)
        assert OZONE_DOBSON[group] == pytest.approx(expected, abs=0.5)
        (ozone,) = real_atmosphere(data_folder(), group)[0].absorbers
        depth = ozone.optical_depth_at(jnp.array([360.0, 370.0, 380.0, 600.0, 780.0, 818.25]))
        table = af.Absorber.ozone(OZONE_DOBSON[group])
        at_600 = float(table.optical_depth_at(jnp.array([600.0]))[0])
        np.testing.assert_allclose(depth, [0.0, 0.0, 0.0, at_600, 0.0, 0.0], rtol=1e-12)


def van_heuklon_ozone(latitude, longitude, day):
    """Ozone [Dobson units] in the north and west, Van Heuklon (1979), Solar Energy 22, 63."""
    seasonal = 40 * np.sin(np.radians(0.9865 * (day - 30)))
    by_longitude = 20 * np.sin(np.radians(3 * longitude))
    return 235 + (150 + seasonal + by_longitude) * np.sin(np.radians(1.28 * latitude)) ** 2


def test_ozone_formula_gives_a_published_example():
    # 321.2 in the comments of a public implementation, for 36 N, 122 W and July 4.
    assert van_heuklon_ozone(36.0, -122.0, 185) == pytest.approx(321.2, abs=0.05)


def test_luminance_of_a_flat_spectrum():
    wavelength_nm = np.linspace(360.0, 830.0, 95)
    # 683 lm/W times the integral of the luminosity curve, 106.857 nm.
    assert luminance(np.ones(95), wavelength_nm) == pytest.approx(683 * 106.857, rel=1e-4)


def test_missing_folder_is_explained_in_one_line(tmp_path):
    with pytest.raises(DataMissing, match="sky-measurements-2014") as error:
        read_skies(tmp_path)
    message = str(error.value)
    assert "Kider et al. 2014" in message
    assert str(tmp_path) in message
    assert "\n" not in message


def test_daylight_spectrum_is_that_of_colour_science():
    import colour

    wavelength_nm = np.arange(380.0, 781.0, 10.0)
    for temperature in (4500.0, 6504.0, 15000.0):
        xy = colour.temperature.CCT_to_xy_CIE_D(temperature)
        spectrum = daylight_spectrum(np.array([*xy, 5000.0]), wavelength_nm)
        theirs = colour.sd_CIE_illuminant_D_series(xy)
        expected = np.interp(wavelength_nm, theirs.wavelengths, theirs.values)
        # colour-science rounds M1 and M2 to 3 digits, and S1 reaches 60 % of S0.
        ratio = spectrum / expected
        np.testing.assert_allclose(ratio, ratio[0], rtol=7e-4)
        assert luminance(spectrum, wavelength_nm) == pytest.approx(5000.0, rel=1e-6)


def test_turbidity_of_an_optical_depth():
    # Molecules alone have turbidity 1 (the formula gives 0.995); the day of May has about 2.
    assert turbidity_from_optical_depth(0.0) == pytest.approx(1.0, abs=0.01)
    assert turbidity_from_optical_depth(0.097) == pytest.approx(1.963, abs=0.001)


@pytest.mark.slow
@needs_data
def test_models_with_fitted_turbidity(skies):
    """The shipped model within 1.4 times DISORT's error, and before the published ones."""
    pytest.importorskip("mitsuba")
    atmosphere, irradiance = site_atmosphere(data_folder())
    assert atmosphere.ground is not None
    albedo = site_albedo(atmosphere.ground.albedo, irradiance)
    assert albedo == pytest.approx(0.066, abs=0.001)
    codes = read_codes(data_folder())
    rows = {
        (row["model"], row["group"]): row
        for row in fitted_scores(skies, codes, af.PREETHAM_1999, irradiance, albedo)
    }
    ours, disort = rows["atmofit_2026", "may"], rows["disort", "may"]
    assert ours["rms_mW"] is not None
    assert disort["rms_mW"] is not None
    assert ours["rms_mW"] <= 1.4 * disort["rms_mW"]  # seen: 14.8 and 10.9
    for other in ("hosek_wilkie", "preetham_1999"):
        assert ours["rms_shared_mW"] < rows[other, "may"]["rms_shared_mW"]
    assert all(1.2 < T < 2.5 for T in ours["turbidity"])


@needs_data
def test_hosek_and_wilkie_are_those_of_the_stored_table(skies):
    pytest.importorskip("mitsuba")
    table = np.genfromtxt(
        data_folder() / "reference" / "hosek_wilkie_sky.csv", delimiter=",", names=True
    )
    sky = hosek_wilkie(6.0, np.radians(60.0), 0.3)
    chosen = table[
        (table["turbidity"] == 6)
        & (table["sun_elev_deg"] == 30)
        & (table["ground_albedo"] == 0.3)
        & (table["wavelength_nm"] == 550)
    ][::5]
    assert chosen.size > 10
    found = sky(
        np.radians(chosen["view_zenith_deg"]),
        np.radians(chosen["rel_azimuth_deg_0_is_sun"]),
        np.array([550.0]),
    )
    np.testing.assert_allclose(found[:, 0], chosen["radiance_W_m2_sr_nm"], rtol=1e-5)
