"""Figures with sliders in a notebook, and without them where there is no notebook."""

import os
import sys
from collections.abc import Callable
from importlib.util import find_spec

from atmofit.checks import in_range

_STEPS = 50  # of each slider, from end to end


def sliders(draw: Callable[..., object], **ranges: tuple[float, float, float]) -> None:
    """Draw a figure again whenever one of its numbers is changed by a slider.

    Without a notebook, where the package ipywidgets is missing, or with ATMOFIT_FAST=1, the figure
    is drawn once.

    Args:
        draw: Called with a number for each name in `ranges`, by keyword; its figure is shown.
        ranges: For each number its smallest, first and largest value, in the unit of `draw`.

    Raises:
        ValueError: A range has no width, or its first value lies outside.
    """
    for name, (low, first, high) in ranges.items():
        if not low < high:
            raise ValueError(f"{name} must rise from smallest to largest, got {low:g} to {high:g}")
        in_range(name, first, low, high)
    import matplotlib.pyplot as plt

    def show(**values: float) -> None:
        draw(**values)
        plt.show()

    if not can_slide():
        show(**{name: float(first) for name, (_, first, _) in ranges.items()})
        return
    from ipywidgets import FloatSlider, interact

    interact(
        show,
        **{
            name: FloatSlider(
                value=first, min=low, max=high, step=(high - low) / _STEPS, continuous_update=False
            )
            for name, (low, first, high) in ranges.items()
        },
    )


def can_slide() -> bool:
    """Whether a notebook's kernel runs this, by hand, and ipywidgets is there."""
    if os.environ.get("ATMOFIT_FAST") == "1":
        return False  # run by a program, for which a figure is enough
    ipython = sys.modules.get("IPython")  # a kernel has imported it
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None and find_spec("ipywidgets") is not None
