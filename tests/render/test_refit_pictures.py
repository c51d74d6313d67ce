"""Pictures and sentences of a refit; the whole set is drawn in test_report."""

import dataclasses

import numpy as np
import pytest
from render.fake_refit import SUNS_DEG, TURBIDITY, fake_result

from atmofit.render.heat_maps import ERRORS, RATIOS, draw_comparison
from atmofit.render.refit_pictures import draw_residuals, draw_skies, draw_zenith, exposure, nearest
from atmofit.render.text import STATISTICS


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_nearest_takes_each_value_once_in_order():
    assert nearest((4.0, 2.0, 3.0), (2.0, 2.1, 4.0, 9.0)) == [1, 0]


@pytest.mark.parametrize("rows", [RATIOS, ERRORS], ids=["ratios", "errors"])
def test_heat_maps_print_every_number_and_a_dash_where_not_valid(rows):
    result = fake_result()
    words = texts(draw_comparison(result.comparisons, result.skies.settings, rows))
    assert len(words) == len(rows) * 2 * len(TURBIDITY) * len(SUNS_DEG)
    assert words.count("–") == len(rows) * len(SUNS_DEG)  # published, T 11
    values = result.comparisons[1].luminance_ratio.ravel() if rows is RATIOS else []
    for value in values:
        assert f"{value:.2f}" in words
    assert "−0" not in words


def test_residual_maps_hold_the_skies_that_are_asked_for():
    figure = draw_residuals(
        fake_result(), "Y", turbidity=(3.0,), solar_zenith_angle_deg=(40.0, 80.0)
    )
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    residuals = fake_result().residuals[1, 1, :, 2] / fake_result().skies.quantity("Y")[1, 1]
    rms = 100 * np.sqrt(np.mean(residuals**2))
    assert titles[0] == f"T = 3, sun 40°: rms {rms:.0f} %"
    assert len(titles) == 2


def test_zenith_curves_leave_out_a_model_that_is_not_valid():
    figure = draw_zenith(fake_result(), panels=3)
    published = figure.axes[2].lines[1]  # T 11
    assert published.get_label() == "published"
    assert np.isnan(np.asarray(published.get_ydata(), float)).all()
    points = np.asarray(figure.axes[2].lines[0].get_ydata(), float)
    np.testing.assert_allclose(points, fake_result().skies.zenith[0, :, 2] / 1e3)


def test_skies_state_their_exposure():
    skies = fake_result().skies
    white = exposure(skies.quantity("Y")[[0, 1, 2], 0]) / 1e3
    figure = draw_skies(skies, turbidity=TURBIDITY, solar_zenith_angle_deg=(10.0,))
    assert figure.axes[0].get_title() == f"sun 10°, exposure {white:.2g} kcd m⁻²"


def test_every_statistic_of_a_comparison_is_shown():
    fields = {field.name for field in dataclasses.fields(fake_result().comparisons[0])}
    assert {field for field, _, _ in STATISTICS} == fields - {"name"}
