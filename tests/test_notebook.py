"""Sliders of the notebooks: with ipywidgets, and a single figure without."""

import sys
from types import SimpleNamespace

import ipywidgets
import pytest

from atmofit import notebook
from atmofit.notebook import can_slide, sliders

RANGES = {"turbidity": (1.0, 3.0, 10.0), "sun": (0.0, 60.0, 80.0)}


def test_without_a_kernel_the_figure_is_drawn_once_at_the_first_values():
    drawn = []
    assert not can_slide()
    sliders(lambda **values: drawn.append(values), **RANGES)
    assert drawn == [{"turbidity": 3.0, "sun": 60.0}]


def test_without_ipywidgets_or_in_fast_mode_a_kernel_does_not_slide(monkeypatch):
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.delenv("ATMOFIT_FAST", raising=False)
    assert can_slide()
    monkeypatch.setenv("ATMOFIT_FAST", "1")
    assert not can_slide()
    monkeypatch.delenv("ATMOFIT_FAST")
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


@pytest.mark.parametrize(
    ("wrong", "said"),
    [((1.0, 1.0, 1.0), "sun must rise"), ((0.0, 2.0, 1.0), r"sun must be .*0.* 1.*2")],
)
def test_impossible_ranges_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        sliders(lambda **values: None, sun=wrong)
