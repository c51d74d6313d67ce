"""The whole way from settings to coefficients, on a small table of skies; and its files."""

import dataclasses
import json

import numpy as np
import pytest

import atmofit as af
from atmofit.fit.comparison import predict
from atmofit.fit.skies import QUANTITIES
from atmofit.io import (
    coefficients_to_dict,
    read_settings,
    write_coefficients,
    write_dataset,
)

SETTINGS = af.RefitSettings(
    turbidity=(2.0, 4.0, 6.0), solar_zenith_angle_deg=(0.0, 30.0, 60.0, 80.0), rtol=5e-2, starts=4
)


def same_model(one, other):
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.fixture(scope="module")
def stages():
    return []


@pytest.fixture(scope="module")
def result(stages):
    return af.refit(SETTINGS, progress=stages.append)


def test_every_fit_converges_and_every_stage_is_timed(result, stages):
    assert result.converged
    pieces = [f"piece {i} of 3" for i in (1, 2, 3)]
    assert stages == ["simulation", *pieces, *list(result.seconds)[1:]]
    assert all(seconds > 0 for seconds in result.seconds.values())


def test_given_skies_are_fitted_without_simulation(result, monkeypatch):
    monkeypatch.setattr("atmofit.fit.refit.simulate_skies", None)
    again = af.refit(skies=result.skies)
    assert "simulation" not in again.seconds
    same_model(again.model, result.model)
    np.testing.assert_array_equal(again.skies.xyY, result.skies.xyY)


def test_settings_of_the_fits_may_differ_from_those_of_the_skies(result):
    settings = dataclasses.replace(SETTINGS, weighting="log")
    skies = result.skies.under(settings)
    assert skies.settings == settings
    assert skies.xyY is result.skies.xyY


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"turbidity": (2.0, 3.0, 6.0)}, r"turbidity must be that of the given skies, \(2\.0, 4"),
        ({"settings": af.RefitSettings()}, "must be that of the given skies"),
        ({"orders": 1}, "orders must be that of the given skies, 2, got 1"),
        ({"pieces": "folder"}, "pieces must be None where skies are given, got 'folder'"),
    ],
)
def test_what_contradicts_the_given_skies_is_refused(arguments, message, result):
    with pytest.raises(ValueError, match=message):
        af.refit(skies=result.skies, **arguments)


def test_skies_are_positive_and_have_the_stated_shapes(result):
    assert result.skies.radiance.shape == (3, 4, 343, 41)
    assert (result.skies.radiance > 0).all()
    np.testing.assert_array_equal(result.skies.zenith, result.skies.xyY[:, :, 0])


def test_regenerated_model_is_nearer_to_the_skies_than_the_published_one(result):
    published, regenerated = (c.summary() for c in result.comparisons)
    for name in ("luminance_rms", "x_rms", "y_rms"):
        assert regenerated[name] < published[name]
    # The formula itself misses the skies by far more than the fits' own tolerance.
    assert 0.03 < regenerated["luminance_rms"] < 0.5


def test_published_model_is_too_bright_and_too_yellow_or_blue_as_known(result):
    """DESIGN: zenith luminance differs by 1.6 to 4, x and y by about -0.02."""
    published = result.comparisons[0]
    assert ((published.zenith_luminance_ratio > 1.2) & (published.zenith_luminance_ratio < 5)).all()
    assert -0.03 < published.summary()["x_mean"] < -0.01
    assert -0.03 < published.summary()["y_mean"] < -0.01


def test_residuals_are_prediction_minus_simulation(result):
    expected = predict(result.model, result.skies) - result.skies.xyY
    np.testing.assert_array_equal(result.residuals, expected)
    ratio = expected[..., 2] / result.skies.quantity("Y")
    regenerated = result.comparisons[1]
    np.testing.assert_allclose(np.sqrt((ratio**2).mean(-1)), regenerated.luminance_rms, rtol=1e-12)


def test_coefficients_survive_the_file(result, tmp_path):
    path = write_coefficients(result, tmp_path / "coefficients.json")
    model, settings = af.read_coefficients(path), read_settings(path)
    assert settings == SETTINGS
    same_model(model, result.model)
    stored = json.loads(path.read_text())
    for quantity in QUANTITIES:
        for row in stored["distribution"][quantity].values():
            assert all(number["standard_error"] > 0 for number in row.values())
    assert stored["versions"]["jax"]
    assert list(tmp_path.iterdir()) == [path]


def test_dataset_has_units_and_comes_back(result, tmp_path):
    xarray = pytest.importorskip("xarray")
    path = write_dataset(result, tmp_path / "sky.nc")
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        np.testing.assert_array_equal(stored["radiance"], result.skies.radiance)
        np.testing.assert_array_equal(stored["luminance_residual"], result.residuals[..., 2])
        assert stored["luminance"].attrs["units"] == "cd m-2"
        assert json.loads(stored.attrs["settings"])["rtol"] == SETTINGS.rtol
    assert list(tmp_path.iterdir()) == [path]


def test_dictionary_has_every_number(result):
    stored = coefficients_to_dict(result)
    assert len(stored["zenith"]["x"]) == 3
    assert len(stored["zenith"]["x"][0]) == 4
    assert len(stored["zenith"]["Y"]) == 4
    assert set(stored["comparison"]) == {"published", "regenerated"}
    json.dumps(stored, allow_nan=False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"turbidity": (0.5, 2.0, 3.0)}, r"turbidity must be between 1 and 64, got 0\.5"),
        ({"turbidity": (2.0, 3.0)}, "turbidity must hold at least 3 values"),
        ({"turbidity": (2.0, 2.0, 3.0)}, "all different"),
        ({"turbidity": (2.0, 3.0, float("nan"))}, "turbidity must be between 1 and 64, got nan"),
        ({"solar_zenith_angle_deg": (0.0, 20.0, 40.0, 95.0)}, "suns must be .* got 95"),
        ({"wavelength_nm": (300.0, 500.0)}, "wavelength_nm must be .* got 300"),
        ({"rtol": -1.0}, r"rtol must be between 0\.0005 and 1, got -1"),
        ({"orders": 21}, 'orders must be 1 to 20 or "all", got 21'),
        ({"geometry": "round"}, "geometry must be one of .* got .round"),
        ({"dtype": "float16"}, "dtype must be one of"),
        ({"weighting": "none"}, "weighting must be one of"),
    ],
)
def test_bad_settings_are_refused_before_any_work(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(SETTINGS, **change)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {}}'])
def test_file_that_is_not_coefficients_is_refused(text, tmp_path):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"file must be a coefficients\.json .*other\.json"):
        af.read_coefficients(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"file must exist, got .*nothing\.json"):
        af.read_coefficients(tmp_path / "nothing.json")
