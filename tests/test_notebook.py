"""Sliders of the notebooks: with ipywidgets, and a single figure without."""

import sys
from types import SimpleNamespace

import ipywidgets
import nbformat
import pytest
from nbclient import NotebookClient

from atmofit import notebook
from atmofit.notebook import can_slide, sliders

RANGES = {"turbidity": (1.0, 3.0, 10.0), "sun": (0.0, 60.0, 80.0)}
CELL = """
from atmofit.notebook import sliders
sliders(lambda turbidity, sun: print(turbidity, sun), turbidity=(1, 3, 10), sun=(0, 60, 80))
"""


def test_without_a_kernel_the_figure_is_drawn_once_at_the_first_values():
    drawn = []
    assert not can_slide()
    sliders(lambda **values: drawn.append(values), **RANGES)
    assert drawn == [{"turbidity": 3.0, "sun": 60.0}]


def test_without_ipywidgets_a_kernel_does_not_slide(monkeypatch):
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert can_slide()
    monkeypatch.setattr(notebook, "find_spec", lambda name: None)
    assert not can_slide()


def test_each_number_has_a_slider_that_draws_when_it_is_let_go(monkeypatch):
    made = {}
    monkeypatch.setattr(notebook, "can_slide", lambda: True)
    monkeypatch.setattr(ipywidgets, "interact", lambda draw, **found: made.update(found))
    sliders(lambda **values: None, **RANGES)
    assert list(made) == ["turbidity", "sun"]
    for name, slider in made.items():
        assert (slider.min, slider.value, slider.max) == RANGES[name]
        assert not slider.continuous_update


@pytest.mark.slow
def test_in_a_notebook_there_are_sliders_and_the_first_figure(tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    cells = [nbformat.v4.new_code_cell(CELL)]
    found = NotebookClient(nbformat.v4.new_notebook(cells=cells), timeout=120).execute()
    widgets = found.metadata.widgets["application/vnd.jupyter.widget-state+json"]["state"].values()
    models = [widget["model_name"] for widget in widgets]
    assert models.count("FloatSliderModel") == 2
    outputs = [widget["state"]["outputs"] for widget in widgets if "outputs" in widget["state"]]
    assert [output["text"] for output in outputs[0]] == ["3.0 60.0\n"]
    assert not [o for o in found.cells[0].outputs if o.output_type == "stream"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [((1.0, 1.0, 1.0), "sun must rise"), ((0.0, 2.0, 1.0), r"sun must be .*0.* 1.*2")],
)
def test_impossible_ranges_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        sliders(lambda **values: None, sun=wrong)
