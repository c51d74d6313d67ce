"""The codes we are compared with give the reference radiances, so we set them up rightly."""

import dataclasses

import numpy as np
import pytest
from peers import differences
from peers_scene import Scene, few_skies, reference_batch
from reference.data import groups, needs

FLAT, ROUND, WALK = (
    "planeparallel_sky_radiance.csv",
    "spherical_sky_radiance.csv",
    "spherical_monte_carlo.csv",
)
pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def nanodisort_sky():
    pytest.importorskip("nanodisort")
    return pytest.importorskip("peers_nanodisort").nanodisort_sky


@pytest.fixture(scope="module")
def sasktran2_sky():
    pytest.importorskip("sasktran2")
    return pytest.importorskip("peers_sasktran2").sasktran2_sky


def _scene(columns, molecules, haze, **rest):
    """One sky of a table whose directions are a grid, at one wavelength."""
    view, azimuth = (np.unique(columns[name]) for name in ("view_zenith", "rel_azimuth"))
    assert np.array_equal(columns["view_zenith"], np.repeat(view, azimuth.size))
    absorber = np.array([rest.pop("absorber", 0.0)])
    return Scene(
        np.radians(columns["sun_zenith"][:1]),
        np.radians(view),
        np.radians(azimuth),
        np.array([550.0]),
        np.array([molecules]),
        np.array([[haze]]),
        absorber,
        **rest,
    )


def _flat_skies(letters):
    for key, columns in groups(FLAT).items():
        if key[0][0] in letters:
            first = {name: values[0] for name, values in columns.items()}
            yield (
                key,
                columns,
                _scene(
                    columns,
                    first["tauR"],
                    first["tauH"],
                    absorber=first["tauAbs"],
                    asymmetry=first["g"],
                    single_scattering_albedo=first["ssaH"],
                    ground_albedo=first["albedo"],
                ),
            )


def _error(skies, reference):
    return float(np.abs(skies.radiance.ravel() / reference - 1).max())


# Seen: a 5e-6, where the table's digits and streams end; b, c 1.1e-4, e 4.6e-4. The table's 84
# layers are others than ours, for which data/README.md allows 3e-4; e has a steep absorber too.
@needs(FLAT)
@pytest.mark.parametrize(("letters", "rtol"), [("a", 1e-5), ("bc", 3e-4), ("e", 6e-4)])
def test_nanodisort_flat(nanodisort_sky, letters, rtol):
    for key, columns, scene in _flat_skies(letters):
        skies = nanodisort_sky(scene, 32, 84)
        assert _error(skies, columns["nanodisort"]) < rtol, key


# Seen: 9.2e-4, and 2.6e-3 below the steep absorber: levels, and a planet only 100 times larger.
@needs(FLAT)
@pytest.mark.parametrize(("letters", "rtol"), [("b", 2e-3), ("e", 4e-3)])
def test_sasktran2_flat_single(sasktran2_sky, letters, rtol):
    for key, columns, scene in _flat_skies(letters):
        skies = sasktran2_sky(scene, "single", geometry="plane_parallel", layers=160)
        assert _error(skies, columns["single_analytic"]) < rtol, key


# Seen: 9.9e-4 in air, 3.5e-2 in haze, 5 degrees from the zenith, with 32 streams too: the package
# interpolates the higher orders in angle. From 20 degrees on 4.6e-3.
@needs(FLAT)
@pytest.mark.parametrize(("letters", "rtol", "rtol_low"), [("a", 2e-3, 2e-3), ("bce", 5e-2, 8e-3)])
def test_sasktran2_flat_all_orders(sasktran2_sky, letters, rtol, rtol_low):
    for key, columns, scene in _flat_skies(letters):
        skies = sasktran2_sky(scene, geometry="plane_parallel", layers=80)
        error = np.abs(skies.radiance.ravel() / columns["nanodisort"] - 1)
        assert error.max() < rtol, key
        assert error[columns["view_zenith"] >= 20].max() < rtol_low, key


def _round_skies(suns):
    for key, columns in groups(ROUND).items():
        if key[1] in suns:
            molecules, haze = (float(part) for part in key[0].split("_")[1:3])
            yield key, columns, _scene(columns, molecules, haze)


# Seen: 3.4e-4 at sun 80, 7.3e-4 at 90; 9.2e-4 and 3.4e-3 with half the levels: second order.
@needs(ROUND)
@pytest.mark.parametrize(("sun", "rtol"), [(80.0, 5e-4), (90.0, 1e-3)])
def test_sasktran2_round_single(sasktran2_sky, sun, rtol):
    for key, columns, scene in _round_skies([sun]):
        skies = sasktran2_sky(scene, "single", layers=160)
        for column in ("sasktran2_SS_Exact", "own_spherical_SS"):
            assert _error(skies, columns[column]) < rtol, (key, column)


# Seen: 2.2e-3, on other levels than the table's.
@needs(ROUND)
def test_sasktran2_round_all_orders(sasktran2_sky):
    for key, columns, scene in _round_skies([80.0]):
        skies = sasktran2_sky(scene, layers=80)
        assert _error(skies, columns["sasktran2_DO16_numsza1"]) < 4e-3, key


# Seen: 1.6e-2 at sun 60, 2.4e-2 at 80. The higher orders come from flat columns, so here two
# models differ, by far more than the walk's standard error of 1e-3.
@needs(WALK)
@pytest.mark.parametrize(("sun", "rtol"), [(60.0, 2.5e-2), (80.0, 4e-2)])
def test_sasktran2_against_a_random_walk(sasktran2_sky, sun, rtol):
    for key, columns in groups(WALK).items():
        if key[1] != sun:
            continue
        _, molecules, haze, *albedo = key[0].split("_")
        view, row = np.unique(columns["view_zenith"], return_inverse=True)
        azimuth, column = np.unique(columns["rel_azimuth"], return_inverse=True)
        grid = {
            "sun_zenith": columns["sun_zenith"],
            "view_zenith": np.repeat(view, azimuth.size),
            "rel_azimuth": np.tile(azimuth, view.size),
        }
        ground = float(albedo[0][1:]) if albedo else 0.0
        scene = _scene(grid, float(molecules), float(haze), ground_albedo=ground)
        found = sasktran2_sky(scene, layers=80).radiance[0, 0, row, column, 0]
        assert np.abs(found / columns["total"] - 1).max() < rtol, key


def test_a_batch_is_its_skies_one_by_one(nanodisort_sky, sasktran2_sky):
    batch = few_skies(reference_batch(), 6)
    batch = dataclasses.replace(
        batch,
        view_zenith_angle=batch.view_zenith_angle[::6],
        relative_azimuth=batch.relative_azimuth[::9],
        wavelength_nm=batch.wavelength_nm[::20],
        molecules_optical_depth=batch.molecules_optical_depth[::20],
        absorber_optical_depth=batch.absorber_optical_depth[::20],
        haze_optical_depth=batch.haze_optical_depth[:, ::20],
    )
    one = dataclasses.replace(
        batch,
        solar_zenith_angle=batch.solar_zenith_angle[1:],
        view_zenith_angle=batch.view_zenith_angle[2:],
        relative_azimuth=batch.relative_azimuth[1:2],
    )
    # sasktran2 with 2 threads differs from run to run: by up to 3e-5 seen.
    for code, rtol in ((nanodisort_sky, 1e-12), (sasktran2_sky, 2e-4)):
        whole = code(batch, layers=20).radiance
        assert whole.shape == batch.shape == (2, 3, 3, 3, 3)
        np.testing.assert_allclose(code(one, layers=20).radiance, whole[1:, :, 2:, 1:2], rtol)


def test_differences():
    scene = few_skies(reference_batch(), 10)  # the last sun stands at 87 degrees
    finest = np.ones(scene.shape)
    radiance = finest.copy()
    radiance[0, 0, 0, 0, 0] = 1.25
    radiance[1, 0, 0, 0, 0] = 0.5
    found = differences(radiance, finest, scene)
    assert found["largest"] == 0.5
    assert found["largest_to_sun_80_view_85"] == 0.25
    assert found["rms"] == pytest.approx(np.sqrt((0.25**2 + 0.5**2) / finest.size))
