"""The verdict's sentences follow its numbers, and its section holds them."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest
from render.fake_refit import SUNS_DEG, TURBIDITY, fake_result

from atmofit.fit.movement import Movement, Movements
from atmofit.fit.verdict import scores_of
from atmofit.render.findings import findings
from atmofit.render.movements import MOVEMENT_COLUMNS, movement_rows, movement_sentences
from atmofit.render.verdict import CAPTIONS, section
from atmofit.render.verdict_pictures import draw_movements, draw_scores, verdict_pictures

PNG = b"\x89PNG\r\n\x1a\n"
START = Movement(
    key="baseline",
    label="as it is",
    kind="baseline",
    luminance_ratio=2.0,
    zenith_luminance_ratio=2.2,
    x_mean=-0.02,
    y_mean=-0.03,
    luminance_log_rms=0.7,
    luminance_pattern_rms=0.3,
    refit_luminance_rms=0.2,
    refit_pattern_rms=0.15,
    refit_x_rms=0.006,
    refit_y_rms=0.004,
    within_two=20,
    within_two_robust=30,
    moved_rms=0.0,
    moved_median=0.0,
    moved_by_group={"Y": 0.0},
    largest_mover="",
    largest_move=0.0,
    converged=True,
)


def row(key, kind="single", **changes):
    moved = {"moved_rms": 2.5, "moved_median": 0.5, "largest_mover": "Y: A slope"}
    label = f"changed {key}"
    return dataclasses.replace(
        START, key=key, label=label, kind=kind, largest_move=-7.0, **(moved | changes)
    )


def movements(*rows):
    settings = {
        "turbidity": [2.0, 6.0],
        "solar_zenith_angle_deg": [0.0, 87.0],
        "directions": 343,
        "dtype": "float32",
        "rtol": 0.01,
    }
    known = {"date": "2026-01-02", "versions": {"atmofit": "0.0.7"}, "settings": settings}
    third = {
        "samples": 360, "noise": 0.002, "degree": 3, "error": 0.01, "median_error": 0.003,
        "largest_error": 0.1, "largest_ratio": 1.4,
    }  # fmt: skip
    return Movements(known, third, (START, *rows))


def test_findings_tell_the_numbers_of_the_result():
    result = fake_result()
    said = " ".join(findings(result))
    summary = result.comparisons[0].summary()
    assert "All 39 searches" in said
    assert f"{summary['luminance_ratio']:.2f} times the simulation" in said
    assert f"{summary['zenith_luminance_ratio']:.2f} times the simulated one" in said
    assert f"{summary['x_mean']:+.4f} in x" in said
    assert f"{summary['y_rms']:.4f})" in said
    assert f"{summary['zenith_y_difference']:+.4f} at the zenith" in said
    pattern = result.comparisons[1].summary()["luminance_pattern_rms"]
    assert f"{100 * pattern:.0f} %" in said
    dome = scores_of(result).of_group("Y", "x", "y").summary()
    counts = f"{dome['within_two_robust']} published ones lie within 2 robust standard errors"
    assert counts in said
    assert "not valid" not in said


def test_findings_turn_with_the_numbers():
    result = fake_result()
    before = findings(result)[1:5]
    assert "Luminance, not reproduced" in before[0]  # 1 / 0.9 is 11 % off
    published, regenerated = result.comparisons
    same = {
        name: np.full_like(values, 1.0 if name.endswith("ratio") else 0.0)
        for name, values in vars(published).items()
        if name != "name"
    }
    equal = dataclasses.replace(published, **same)
    after = findings(dataclasses.replace(result, comparisons=(equal, regenerated)))[1:5]
    assert all(", reproduced" in sentence for sentence in after)
    flat = np.full_like(published.luminance_pattern_rms, 0.2)
    uneven = dataclasses.replace(equal, luminance_pattern_rms=flat)
    after = findings(dataclasses.replace(result, comparisons=(uneven, regenerated)))
    assert after[3].startswith("Pattern of luminance over the dome, not reproduced")


def test_coefficients_are_reproduced_only_if_all_are():
    result = fake_result()
    assert "Coefficients, not reproduced" in findings(result)[-2]
    wide = {
        "distributions": {
            q: dataclasses.replace(fit, robust_standard_error=jnp.full((5, 2), 1e6))
            for q, fit in result.distributions.items()
        },
        "zeniths": {
            q: dataclasses.replace(
                fit, robust_standard_error=jnp.full(np.shape(fit.coefficients), 1e6)
            )
            for q, fit in result.zeniths.items()
        },
    }
    assert "Coefficients, reproduced" in findings(dataclasses.replace(result, **wide))[-2]


def test_findings_say_when_fits_did_not_converge_or_a_model_is_not_valid():
    assert "36 of 39 searches did NOT converge" in findings(fake_result(converged=False))[0]
    nothing = {
        name: np.full_like(values, np.nan)
        for name, values in vars(fake_result().comparisons[0]).items()
        if name != "name"
    }
    empty = dataclasses.replace(fake_result().comparisons[0], **nothing)
    result = dataclasses.replace(fake_result(), comparisons=(empty, fake_result().comparisons[1]))
    assert "not valid at any of these turbidities" in findings(result)[1]


def test_movements_in_words_follow_the_numbers():
    near = row("near", luminance_log_rms=0.3, moved_median=0.2)
    far = row("far", luminance_log_rms=0.9, refit_luminance_rms=0.5, moved_median=3.0)
    both = row("both", "combination", luminance_log_rms=0.2)
    said = movement_sentences(movements(near, far, both))
    assert "“changed near” brings the published luminance closest" in said[1]
    assert "from 0.70 to 0.30" in said[1]
    assert said[1].endswith("0 change it by less than 0.02.")
    assert "“changed far” takes it farthest away (0.90)" in said[1]
    assert "20 % rms in luminance (“changed near”) and 50 %" in said[2]
    assert said[3].startswith("1 of the 2 move half")
    assert "at most 7 in Y: A slope" in said[3]
    assert said[4].startswith("Combined, changed both: closer to the published model")
    turned = movement_sentences(
        movements(
            dataclasses.replace(near, luminance_log_rms=0.8),
            dataclasses.replace(far, luminance_log_rms=0.75),
            dataclasses.replace(both, luminance_log_rms=0.71),
        )
    )
    assert "none brings the published luminance closer" in turned[1]
    assert "“changed near” takes it farthest away" in turned[1]
    assert "farther from the published model" in turned[4]


def test_closing_sentence_names_the_largest_mover_and_what_stays_open():
    far = row("far", luminance_log_rms=0.9)
    near = row("near", luminance_log_rms=0.6)
    said = movement_sentences(movements(near, far))[-1]
    assert "largest mover of the published luminance is “changed far”" in said
    assert "no assumption explains the mean level of luminance, nor luminance sky by sky" in said
    level = dataclasses.replace(near, luminance_ratio=1.05, zenith_luminance_ratio=0.95)
    said = movement_sentences(movements(level, far))[-1]
    assert "the mean level of luminance is reached by “changed near”" in said
    assert "no assumption explains luminance sky by sky" in said
    every = dataclasses.replace(
        level, luminance_log_rms=0.05, luminance_pattern_rms=0.04, x_mean=0.001, y_mean=-0.002
    )
    said = movement_sentences(movements(every, far))[-1]
    assert "no assumption explains" not in said
    assert "“changed near” (rms of the log ratio -0.65)" in said


def test_table_of_movements_holds_every_number_and_marks_failed_fits():
    one = row("one", converged=False, luminance_ratio=1.234, within_two=11)
    cells = movement_rows(movements(one))
    assert {len(line) for line in cells} == {len(MOVEMENT_COLUMNS)}
    assert cells[0][-3:] == ("-", "-", "-")
    assert cells[1][0] == "changed one (a fit did not converge)"
    assert {"1.23", "-0.0200", "0.700", "11 (30)", "Y: A slope -7"} <= set(cells[1])


@pytest.fixture(scope="module")
def page():
    pictures = dict.fromkeys(CAPTIONS, PNG)
    rows = (row("near", luminance_log_rms=0.3), row("both", "combination"))
    return "\n".join(section(fake_result(), pictures, movements(*rows)))


def test_section_holds_scores_ratios_movements_and_pictures(page):
    result = fake_result()
    cells = set(re.findall(r"<td>([^<]*)</td>", page))
    scores = scores_of(result)
    for values in (scores.z, scores.robust_z):
        assert {f"{value:+.1f}" for value in values} <= cells
    for name in ("zenith Y", *(f"T {T:g}" for T in TURBIDITY), *(f"sun {s:g}°" for s in SUNS_DEG)):
        assert name in cells
    one = result.comparisons[1]
    assert {f"{value:.2f}" for value in one.zenith_luminance_ratio.mean(0)} <= cells
    assert {f"{value:.3f}" for value in one.x_ratio.mean(1)} <= cells
    assert page.count("<img ") == len(CAPTIONS)
    for words in ("2026-01-02", "atmofit 0.0.7", "for the reference job", "changed near", "360"):
        assert words in page
    assert page.rstrip().endswith("in x and y.</p>")
    assert not re.search(r"\b(nan|inf|None)\b", page)


def test_pictures_are_drawn_with_every_row(monkeypatch):
    figure = draw_movements(movements(row("one"), row("two")))
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["as it is", "changed one", "changed two"]
    terms = [label.get_text() for ax in draw_scores(scores_of(fake_result())).axes
             for label in ax.get_yticklabels()]  # fmt: skip
    assert len(terms) == 58
    # The figures alone: laying them out takes seconds.
    monkeypatch.setattr("atmofit.render.verdict_pictures.png_bytes", lambda figure: PNG)
    pictures = verdict_pictures(fake_result(), movements(row("one")))
    assert {*pictures, "comparison.png"} == set(CAPTIONS)
