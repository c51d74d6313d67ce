"""The verdict's numbers: scores of coefficients, comparisons, and what moves them."""

import dataclasses
import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
from render.fake_refit import SUNS_DEG, TURBIDITY, fake_result

from atmofit.fit.comparison import compare, predict
from atmofit.fit.movement import (
    MOVEMENTS,
    Movements,
    movement,
    movements_to_json,
    parse_movements,
    stored_movements,
)
from atmofit.fit.verdict import coefficient_scores, scores_of, to_dict
from atmofit.models.preetham import PREETHAM_1999

ASSUMPTIONS = {
    "baseline",
    *("orders_1", "orders_3"),
    *("geometry_flat", "geometry_paper"),
    "refractive_index",
    *("haze_600_m", "haze_2400_m", "boundary_layer", "layer_aloft"),
    *("phase_over_K", "phase_printed", "phase_over_4_pi", "phase_doubled"),
    *("weighting_absolute", "weighting_log"),
    "suns_72",
    *("near_sun_10", "near_sun_20"),
    *("ground_albedo", "haze_albedo", "sunlight_doubled"),
    *("paper", "closest", "closest_normalised"),
}


def fits_of(model, error=0.25, robust=0.5):
    """Fits whose coefficients are a model's."""
    result = fake_result()

    def fit(one, coefficients, field):
        value = jnp.asarray(coefficients)
        errors = {"standard_error": error, "robust_standard_error": robust}
        full = {name: jnp.full(value.shape, size) for name, size in errors.items()}
        return dataclasses.replace(one, **{field: value}, **full)

    matrices = (model.x_distribution, model.y_distribution, model.luminance_distribution)
    zeniths = (model.zenith_x, model.zenith_y, model.zenith_luminance)
    joint = {
        q: fit(result.distributions[q], value, "matrix")
        for q, value in zip("xyY", matrices, strict=True)
    }
    zenith = {
        q: fit(result.zeniths[q], value, "coefficients")
        for q, value in zip("xyY", zeniths, strict=True)
    }
    return joint, zenith


def own_skies(factor=1.0):
    """Skies that the published model makes, times a factor in Y; T inside its range."""
    skies = fake_result().skies
    skies = dataclasses.replace(
        skies, settings=dataclasses.replace(skies.settings, turbidity=(2.0, 3.0, 4.0))
    )
    xyY = predict(PREETHAM_1999, skies) * np.array([1.0, 1.0, 1.0])
    xyY[..., 2] *= factor
    return dataclasses.replace(skies, xyY=xyY)


def test_scores_are_differences_over_errors():
    result = fake_result()
    scores = scores_of(result)
    assert len(scores.term) == 30 + 28
    place = {pair: i for i, pair in enumerate(zip(scores.group, scores.term, strict=True))}
    checked = 0
    for q, name in (("Y", "luminance"), ("x", "x"), ("y", "y")):
        published = getattr(PREETHAM_1999, f"{name}_distribution")
        fit = result.distributions[q]
        for row, letter in enumerate("ABCDE"):
            for column, part in enumerate(("slope", "intercept")):
                i = place[q, f"{letter} {part}"]
                distance = published[row, column] - float(fit.matrix[row, column])
                naive = distance / float(fit.standard_error[row, column])
                robust = distance / float(fit.robust_standard_error[row, column])
                assert (scores.z[i], scores.robust_z[i]) == pytest.approx((naive, robust))
                checked += 1
    fit = result.zeniths["x"]
    for row, T in enumerate(("T²", "T", "")):
        for column, s in enumerate(("s³", "s²", "s", "")):
            i = place["zenith x", f"{T}{s}" or "1"]
            distance = PREETHAM_1999.zenith_x[row, column] - float(fit.coefficients[row, column])
            assert scores.robust_z[i] == pytest.approx(distance / 0.00628, abs=1e-12)
            checked += 1
    assert checked == 42


def test_summary_counts_and_medians():
    scores = coefficient_scores(*fits_of(fake_result().model, error=0.01, robust=0.02))
    size, robust = np.abs(scores.z), np.abs(scores.robust_z)
    np.testing.assert_allclose(size, 2 * robust)
    summary = scores.summary()
    assert summary["within_two"] == sum(z < 2 for z in size)
    assert summary["within_two_robust"] == sum(z < 2 for z in robust)
    assert summary["within_two"] < summary["within_two_robust"] < summary["count"] == 58
    assert summary["median_z"] == pytest.approx(np.median(size))
    assert scores.of_group("Y", "zenith Y").summary()["count"] == 14


def test_published_model_against_itself():
    joint, zenith = fits_of(PREETHAM_1999, error=0.0)
    scores = coefficient_scores(joint, zenith)
    assert not scores.z.any()  # also where the error is 0
    assert not scores.robust_z.any()
    assert scores.summary()["within_two"] == 58
    other = coefficient_scores(*fits_of(fake_result().model, error=0.0))
    assert np.isinf(other.z).any()
    one = compare(PREETHAM_1999, own_skies(), "published")
    for name, values in one.summary().items():
        expected = 1.0 if name.endswith("ratio") else 0.0
        assert values == pytest.approx(expected, abs=1e-12), name


def test_pattern_leaves_out_the_mean_ratio():
    skies = own_skies(factor=0.5)
    s = compare(PREETHAM_1999, skies, "published").summary()
    assert s["luminance_ratio"] == pytest.approx(2.0)
    assert s["luminance_log_rms"] == pytest.approx(math.log(2))
    assert s["luminance_pattern_rms"] == pytest.approx(0.0, abs=1e-12)
    one = fake_result().comparisons[1]
    ratio = predict(fake_result().model, fake_result().skies)[..., 2]
    ratio = ratio / fake_result().skies.quantity("Y")
    np.testing.assert_allclose(one.luminance_pattern_rms, ratio.std(-1) / ratio.mean(-1))
    np.testing.assert_allclose(one.luminance_log_rms, np.sqrt((np.log(ratio) ** 2).mean(-1)))


def test_directions_and_skies_are_left_out_of_a_comparison():
    skies, model = fake_result().skies, fake_result().model
    weight = np.ones(skies.xyY.shape[:-1])
    weight[:, :, 3:] = 0.0
    weight[1, 2] = 0.0
    one = compare(model, skies, "regenerated", weight)
    ratio = predict(model, skies)[..., 2] / skies.quantity("Y")
    expected = ratio[..., :3].mean(-1)
    assert np.isnan(one.luminance_ratio[1, 2])
    assert np.isnan(one.zenith_x_difference[1, 2])
    expected[1, 2] = np.nan
    np.testing.assert_allclose(one.luminance_ratio, expected)
    assert one.tables()["x_ratio"][1][2] is None
    with pytest.raises(ValueError, match="weight must be finite"):
        compare(model, skies, "regenerated", -weight)
    with pytest.raises(ValueError, match="of the shape"):
        compare(model, skies, "regenerated", weight[0])


def test_verdict_as_json():
    stored = json.loads(json.dumps(to_dict(fake_result()), allow_nan=False))
    assert stored["coefficients"]["Y"]["A slope"]["z"] == pytest.approx(
        scores_of(fake_result()).z[0]
    )
    assert stored["coefficients_summary"]["all"]["count"] == 58
    ratios = stored["predictions"]["regenerated"]["zenith_luminance_ratio"]
    assert (len(ratios), len(ratios[0])) == (len(TURBIDITY), len(SUNS_DEG))
    assert stored["predictions"]["published"]["x_ratio"][0] == [None] * len(SUNS_DEG)  # T 11


@pytest.fixture(scope="module")
def moved():
    """A baseline and a row in which one coefficient moves by three robust errors."""
    skies = own_skies()
    joint, zenith = fits_of(PREETHAM_1999)
    baseline = coefficient_scores(joint, zenith)
    rows = [movement("baseline", "as it is", "baseline", skies, joint, zenith, baseline=baseline)]
    matrix = np.array(joint["x"].matrix)
    matrix[3, 1] += 3 * 0.5
    other = joint | {"x": dataclasses.replace(joint["x"], matrix=jnp.asarray(matrix))}
    rows.append(movement("one", "changed", "single", skies, other, zenith, baseline=baseline))
    return Movements({"date": "2026-01-01"}, {"noise": 0.1}, tuple(rows))


def test_movement_names_the_coefficient_that_moves(moved):
    still, one = moved.rows
    assert (still.moved_rms, still.largest_mover, still.largest_move) == (0.0, "", 0.0)
    assert still.luminance_ratio == pytest.approx(1.0)
    assert still.refit_luminance_rms == pytest.approx(0.0, abs=1e-12)
    assert (one.largest_mover, one.largest_move) == ("x: D intercept", pytest.approx(3.0))
    assert one.moved_rms == pytest.approx(3 / math.sqrt(58))
    assert one.moved_median == 0.0
    assert one.refit_x_rms > 0.01
    assert (one.within_two, one.within_two_robust) == (57, 57)


def test_table_of_movements_is_read_as_it_was_written(moved):
    assert parse_movements(movements_to_json(moved)) == moved


@pytest.mark.parametrize(
    "damage",
    [
        lambda rows: rows[0].pop("x_mean"),
        lambda rows: rows[0].update(kind="single"),
        lambda rows: rows[1].update(kind="other"),
        lambda rows: rows[1].update(x_mean=math.nan),
        lambda rows: rows[1].update(luminance_ratio="1.0"),
        lambda rows: rows[1].update(key="baseline"),
        lambda rows: rows.clear(),
    ],
)
def test_damaged_table_is_refused(moved, damage):
    stored = json.loads(movements_to_json(moved))
    damage(stored["rows"])
    with pytest.raises(ValueError, match=MOVEMENTS):
        parse_movements(json.dumps(stored))
    with pytest.raises(ValueError, match=MOVEMENTS):
        parse_movements("[]")


def test_stored_table_is_complete():
    stored = stored_movements()
    assert {row.key for row in stored.rows} == ASSUMPTIONS
    start = stored.baseline
    assert (start.moved_rms, start.moved_median, start.largest_move) == (0.0, 0.0, 0.0)
    assert set(start.moved_by_group.values()) == {0.0}
    for row in stored.rows[1:]:
        assert row.moved_rms > 0, row.key
        assert row.largest_mover, row.key
    assert {"command", "date", "versions", "settings"} <= set(stored.provenance)
    assert "/" not in json.dumps(stored.provenance["settings"])
    assert stored.provenance["settings"]["turbidity"] == [2, 3, 4, 5, 6]
