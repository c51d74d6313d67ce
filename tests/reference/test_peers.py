"""The codes we are compared with give the reference radiances, so we set them up rightly."""

import dataclasses

import numpy as np
import pytest
from error_vs_runtime_peers import all_cases
from peers_atmofit import atmofit_sky
from peers_case import Case
from peers_judge import (
    CONTESTS,
    FLAT,
    NODES,
    SINGLE,
    Measured,
    Row,
    cheapest,
    differences,
    finest_differences,
    headline,
    judge,
)
from peers_report import points_of
from peers_scene import (
    Scene,
    few_skies,
    judged,
    median_seconds,
    reference_batch,
    some_skies,
)
from reference.data import groups, needs

FLAT_TABLE, ROUND_TABLE, WALK_TABLE = (
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
    for key, columns in groups(FLAT_TABLE).items():
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
@needs(FLAT_TABLE)
@pytest.mark.parametrize(("letters", "rtol"), [("a", 1e-5), ("bc", 3e-4), ("e", 6e-4)])
def test_nanodisort_flat(nanodisort_sky, letters, rtol):
    for key, columns, scene in _flat_skies(letters):
        skies = nanodisort_sky(scene, 32, 84)
        assert _error(skies, columns["nanodisort"]) < rtol, key


# Seen: 9.2e-4, and 2.6e-3 below the steep absorber: levels, and a planet only 100 times larger.
@needs(FLAT_TABLE)
@pytest.mark.parametrize(("letters", "rtol"), [("b", 2e-3), ("e", 4e-3)])
def test_sasktran2_flat_single(sasktran2_sky, letters, rtol):
    for key, columns, scene in _flat_skies(letters):
        skies = sasktran2_sky(scene, "single", geometry="plane_parallel", layers=160)
        assert _error(skies, columns["single_analytic"]) < rtol, key


# Seen: 9.9e-4 in air, 3.5e-2 in haze, 5 degrees from the zenith, with 32 streams too: the package
# interpolates the higher orders in angle. From 20 degrees on 4.6e-3.
@needs(FLAT_TABLE)
@pytest.mark.parametrize(("letters", "rtol", "rtol_low"), [("a", 2e-3, 2e-3), ("bce", 5e-2, 8e-3)])
def test_sasktran2_flat_all_orders(sasktran2_sky, letters, rtol, rtol_low):
    for key, columns, scene in _flat_skies(letters):
        skies = sasktran2_sky(scene, geometry="plane_parallel", layers=80)
        error = np.abs(skies.radiance.ravel() / columns["nanodisort"] - 1)
        assert error.max() < rtol, key
        assert error[columns["view_zenith"] >= 20].max() < rtol_low, key


def _round_skies(suns):
    for key, columns in groups(ROUND_TABLE).items():
        if key[1] in suns:
            molecules, haze = (float(part) for part in key[0].split("_")[1:3])
            yield key, columns, _scene(columns, molecules, haze)


# Seen: 3.4e-4 at sun 80, 7.3e-4 at 90; 9.2e-4 and 3.4e-3 with half the levels: second order.
@needs(ROUND_TABLE)
@pytest.mark.parametrize(("sun", "rtol"), [(80.0, 5e-4), (90.0, 1e-3)])
def test_sasktran2_round_single(sasktran2_sky, sun, rtol):
    for key, columns, scene in _round_skies([sun]):
        skies = sasktran2_sky(scene, "single", layers=160)
        for column in ("sasktran2_SS_Exact", "own_spherical_SS"):
            assert _error(skies, columns[column]) < rtol, (key, column)


# Seen: 2.2e-3, on other levels than the table's.
@needs(ROUND_TABLE)
def test_sasktran2_round_all_orders(sasktran2_sky):
    for key, columns, scene in _round_skies([80.0]):
        skies = sasktran2_sky(scene, layers=80)
        assert _error(skies, columns["sasktran2_DO16_numsza1"]) < 4e-3, key


# Seen: 1.6e-2 at sun 60, 2.4e-2 at 80. The higher orders come from flat columns, so here two
# models differ, by far more than the walk's standard error of 1e-3.
@needs(WALK_TABLE)
@pytest.mark.parametrize(("sun", "rtol"), [(60.0, 2.5e-2), (80.0, 4e-2)])
def test_sasktran2_against_a_random_walk(sasktran2_sky, sun, rtol):
    for key, columns in groups(WALK_TABLE).items():
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


def _coarse(batch):
    """With three rings, three azimuths and three wavelengths."""
    return dataclasses.replace(
        batch,
        view_zenith_angle=batch.view_zenith_angle[::6],
        relative_azimuth=batch.relative_azimuth[::9],
        wavelength_nm=batch.wavelength_nm[::20],
        molecules_optical_depth=batch.molecules_optical_depth[::20],
        absorber_optical_depth=batch.absorber_optical_depth[::20],
        haze_optical_depth=batch.haze_optical_depth[:, ::20],
    )


def test_a_batch_is_its_skies_one_by_one(nanodisort_sky, sasktran2_sky):
    batch = _coarse(few_skies(reference_batch(), 6))
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


# Seen: 4.2e-3, with rung 5e-4 3e-4; 4.0e-4 with any rung, so that this is the other's levels.
@pytest.mark.slow
def test_atmofit_is_told_of_the_same_skies(nanodisort_sky, sasktran2_sky):
    batch = _coarse(few_skies(reference_batch(), 4))
    flat = atmofit_sky(batch, 1e-2, geometry="flat", dtype="float64")
    exact = nanodisort_sky(batch, 32, 84).radiance
    assert differences(flat.radiance, exact, batch)["inner_largest"] < 1e-2
    single = atmofit_sky(batch, 1e-2, 1, dtype="float64")
    exact = sasktran2_sky(batch, "single", layers=160).radiance
    assert differences(single.radiance, exact, batch)["inner_largest"] < 1e-3
    assert single.compile_seconds > 0


def test_differences():
    scene = few_skies(reference_batch(), 10)  # the last sun stands at 87 degrees
    finest = np.ones(scene.shape)
    radiance = finest.copy()
    radiance[0, 0, 0, 0, 0] = 1.25
    radiance[1, 0, 0, 0, 0] = 0.5
    found = differences(radiance, finest, scene)
    assert found["largest"] == 0.5
    assert found["inner_largest"] == 0.25
    assert found["rms"] == pytest.approx(np.sqrt((0.25**2 + 0.5**2) / finest.size))
    assert found["inner_rms"] == pytest.approx(0.25 / np.sqrt(finest[0, :, :17].size))


def test_few_skies_and_what_is_judged():
    batch = reference_batch()
    assert few_skies(batch, 60).shape == batch.shape
    assert [few_skies(batch, count).shape[:2] for count in (1, 2, 4, 6, 10, 20)] == [
        *((1, 1), (2, 1), (2, 2), (2, 3), (2, 5), (4, 5))
    ]
    exam = some_skies(batch, *judged(batch))
    np.testing.assert_allclose(np.degrees(exam.solar_zenith_angle), [0, 40, 80, 87])
    np.testing.assert_array_equal(exam.wavelength_nm, np.arange(380.0, 781.0, 50.0))
    of_all = batch.haze_optical_depth[[0, -1]][:, ::5]
    np.testing.assert_array_equal(exam.haze_optical_depth, of_all)
    assert exam.shape == (4, 2, 18, 19, 9)


def test_median_seconds_leaves_the_first_call_out_and_keeps_its_patience():
    calls = []
    assert median_seconds(lambda: calls.append(1), 3, 60.0) < 1.0
    assert len(calls) == 4
    assert median_seconds(lambda: calls.append(1), 3, 0.0) > 0.0
    assert len(calls) == 5


def _measured(code, group, radiance, seconds=1.0, finest=False, **settings):
    return Measured(Case(code, group, settings, finest), radiance, {"seconds_per_sky": seconds})


def test_each_group_has_its_reference():
    scene = few_skies(reference_batch(), 4)
    one = np.ones(scene.shape)
    rows = judge(
        [
            _measured("nanodisort", FLAT, one, finest=True),
            _measured("atmofit", FLAT, 1.5 * one),
            _measured("sasktran2", "round_all_orders", 2 * one, finest=True),
            _measured("atmofit", "round_all_orders", 4 * one, finest=True),
            _measured("atmofit", "round_all_orders", 5 * one),
        ],
        scene,
    )
    found = [row.error and row.error["largest"] for row in rows]
    assert found == [None, pytest.approx(0.5), None, None, pytest.approx(0.25)]


def test_finest_solutions_are_compared():
    scene = few_skies(reference_batch(), 4)
    one = np.ones(scene.shape)
    found = finest_differences(
        [
            _measured("nanodisort", FLAT, one, finest=True),
            _measured("sasktran2", SINGLE, 2 * one, finest=True),
            _measured("atmofit", SINGLE, 3 * one, finest=True),
        ],
        scene,
    )
    assert list(found) == [SINGLE]
    assert found[SINGLE]["largest"] == pytest.approx(0.5)


def _row(code, seconds, error, group=FLAT, **settings):
    case = Case(code, group, settings)
    return Row(case, {"seconds_per_sky": seconds}, {"inner_largest": error})


def test_the_cheapest_that_is_good_enough_and_the_ratio():
    rows = [
        _row("nanodisort", 0.1, 2e-2, streams=8),
        _row("nanodisort", 0.4, 1e-2, streams=12),
        _row("nanodisort", 0.5, 1e-3, streams=16),
        _row("atmofit", 0.02, 5e-3, rung=1e-2, every_wavelength=True),
        _row("atmofit", 0.01, 5e-3, rung=1e-2, every_wavelength=False),
        _row("atmofit", 1e-3, 5e-3, SINGLE, rung=1e-2, every_wavelength=False),
    ]
    found = cheapest(rows, FLAT, "nanodisort", 1e-2)
    assert found is not None
    assert found.case.settings == {"streams": 12}
    assert cheapest(rows, FLAT, "nanodisort", 1e-4) is None
    contest = next(each for each in CONTESTS if (each.group, each.own) == (FLAT, NODES))
    assert headline(rows, contest)["ratio"] == pytest.approx(40.0)
    contest = next(each for each in CONTESTS if each.group == SINGLE)
    assert headline(rows, contest)["ratio"] is None


def test_points_of_the_picture():
    cases = [row.as_dict() for row in (_row("nanodisort", 2.0, 1e-3), _row("nanodisort", 1.0, 0.1))]
    cases.append(cases[0] | {"error": None})
    cases.append(cases[0] | {"finest": True})
    assert points_of(cases, FLAT, "nanodisort") == [(1.0, 0.1), (2.0, 1e-3)]
    assert points_of(cases, SINGLE, "nanodisort") == []


@pytest.mark.parametrize("quick", [True, False])
def test_every_contest_has_cases(quick):
    cases = all_cases(quick, gpu=False)
    keys = {(case.group, case.series) for case in cases if not case.finest}
    for contest in CONTESTS:
        assert {(contest.group, contest.peer), (contest.group, contest.own)} <= keys
    finest = [(case.group, case.code) for case in cases if case.finest]
    assert len(finest) == len(set(finest)) == 5
    assert len({(case.group, case.series, str(case.settings)) for case in cases}) == len(cases)
