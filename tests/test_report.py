"""The report of a refit."""

import re

import numpy as np
import pytest
from render.fake_refit import SUNS_DEG, TURBIDITY, fake_result

from atmofit.models.preetham import PREETHAM_1999
from atmofit.render import html
from atmofit.render.text import error, number
from atmofit.report import comparison_text, report_html, summary_text, write_report

PNG = b"\x89PNG\r\n\x1a\n"
PICTURES = {
    "matrices.png",
    "residuals_luminance.png",
    "residuals_x.png",
    "residuals_y.png",
    "comparison.png",
    "ratios.png",
    "scores.png",
    "what_moves_it.png",
    "zenith.png",
    "skies.png",
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_report(fake_result(), tmp_path_factory.mktemp("report") / "new")


@pytest.fixture(scope="module")
def page(written):
    return written[0].read_text(encoding="utf-8")


def test_report_and_pictures_are_written_and_nothing_else(written):
    assert written[0].name == "report.html"
    assert {path.name for path in written[1:]} == PICTURES
    assert set(written[0].parent.iterdir()) == set(written)
    assert all(path.read_bytes().startswith(PNG) for path in written[1:])


def test_report_holds_its_pictures_and_no_address(page):
    assert page.count('src="data:image/png;base64,') == len(PICTURES)
    rest = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]*", "", page)
    for outside in ("http", "//", "<script", "<link", "url(", "@import"):
        assert outside not in rest
    assert "viewport" in rest


def test_report_shows_every_coefficient_with_its_error(page):
    result = fake_result()
    cells = set(re.findall(r"<td>([^<]*)</td>", page))
    for model in (PREETHAM_1999, result.model):
        for name in ("x_distribution", "y_distribution", "luminance_distribution"):
            assert {number(value) for value in np.ravel(getattr(model, name))} <= cells
        for name in ("zenith_x", "zenith_y", "zenith_luminance"):
            assert {number(value) for value in np.ravel(getattr(model, name))} <= cells
    for fit in result.distributions.values():
        assert {error(value) for value in np.ravel(fit.standard_error)} <= cells
        assert {number(float(fit.rms)), number(float(fit.largest)), "321", "17"} <= cells
    assert "0.0031" in cells


def test_report_tells_settings_seconds_prior_and_findings(page):
    for words in ("11, 3, 4", "10°, 40°, 60°, 80°", "1.25", "3.75", "spherical", "0.001"):
        assert words in page
    for words in ("All 39 searches", "prior", "jax ", "12 of 12"):
        assert words in page
    for one in fake_result().comparisons:
        assert f"{one.summary()['luminance_ratio']:.3f}" in page
        assert f"{one.summary()['x_mean']:.4f}" in page


def test_text_is_escaped():
    assert html.paragraph("<b> & 'c'") == "<p>&lt;b&gt; &amp; &#x27;c&#x27;</p>"
    shown = html.table(["<x>"], [["a & b"]])
    assert "&lt;x&gt;" in shown
    assert "a &amp; b" in shown
    assert 'alt="&quot;"' in html.picture(PNG, '"')
    assert "<title>1 &lt; 2</title>" in html.page("1 < 2", [])
    assert "<li>&lt;</li>" in html.bullets(["<"])
    assert html.block("<") == "<pre>&lt;</pre>"


def test_page_without_pictures_of_its_own_name_is_refused():
    with pytest.raises(KeyError):
        report_html(fake_result(), {"other.png": PNG})


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(OSError, match="file"):
        write_report(fake_result(), tmp_path / "file" / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


def test_no_partial_file_when_writing_fails(tmp_path, monkeypatch):
    pictures = dict.fromkeys(PICTURES, PNG)
    monkeypatch.setattr("atmofit.report.refit_pictures", lambda result: pictures)
    (tmp_path / "zenith.png").mkdir()
    with pytest.raises(OSError, match=r"zenith\.png"):
        write_report(fake_result(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} <= PICTURES | {"report.html"}


def test_summary_holds_coefficients_and_comparison():
    text = summary_text(fake_result())
    result = fake_result()
    for quantity, fit in result.distributions.items():
        assert f"\n{quantity} " in text
        for value, uncertain in zip(
            np.ravel(fit.matrix), np.ravel(fit.standard_error), strict=True
        ):
            assert re.search(rf"{re.escape(number(value))} ± {re.escape(error(uncertain))}", text)
    assert "condition number 321, 17 steps, converged" in text
    for one in result.comparisons:
        assert f"{one.summary()['luminance_ratio']:.3f}" in text
    assert max(map(len, text.splitlines())) <= 80


def test_comparison_holds_every_cell():
    result = fake_result()
    text = comparison_text(result.comparisons[0], result.skies)
    lines = [line.split() for line in text.splitlines()]
    assert ["T,", "sun", *(f"{sun:g}" for sun in SUNS_DEG)] in lines
    assert [f"{TURBIDITY[0]:g}", *["-"] * len(SUNS_DEG)] in lines
    for T, row in zip(TURBIDITY[1:], result.comparisons[0].luminance_ratio[1:], strict=True):
        assert [f"{T:g}", *(f"{value:.3f}" for value in row)] in lines
    assert "-0.000" not in text
