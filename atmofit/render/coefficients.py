"""Published and regenerated coefficients side by side."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from atmofit.fit.parameters import NAMES
from atmofit.fit.refit import RefitResult
from atmofit.fit.verdict import (
    CHROMATICITY_CELLS,
    DISTRIBUTIONS,
    LUMINANCE_CELLS,
    PARTS,
    distribution,
    zenith,
)
from atmofit.models.preetham import PREETHAM_1999
from atmofit.render.image import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PUBLISHED, REGENERATED = "#c05020", "#1f5fa8"  # differ in lightness too


def draw_matrices(result: RefitResult) -> "Figure":
    """Every coefficient of both models, with two standard errors of the fits."""
    figure = new_figure(9.0, 10.0)
    layout: Any = [[f"{q} {part}" for part in PARTS for _ in range(3)] for q in DISTRIBUTIONS]
    layout.append(["zenith Y", "zenith Y", "zenith x", "zenith x", "zenith y", "zenith y"])
    axes = figure.subplot_mosaic(layout)
    for quantity in DISTRIBUTIONS:
        error = np.asarray(result.distributions[quantity].standard_error)
        published = distribution(PREETHAM_1999, quantity)
        regenerated = distribution(result.model, quantity)
        for k, part in enumerate(PARTS):
            ax = axes[f"{quantity} {part}"]
            _draw_list(ax, NAMES, published[:, k], regenerated[:, k], error[:, k])
            ax.set_title(f"{quantity}: {part}" + (" in T" if k == 0 else ""), loc="left")
        error = np.ravel(result.zeniths[quantity].standard_error)
        pair = (zenith(PREETHAM_1999, quantity), zenith(result.model, quantity))
        cells = LUMINANCE_CELLS if quantity == "Y" else CHROMATICITY_CELLS
        ax = axes[f"zenith {quantity}"]
        _draw_list(ax, cells, *pair, error)
        unit = " [kcd m⁻²]" if quantity == "Y" else ", s in rad"
        ax.set_title(f"zenith {quantity}{unit}", loc="left")
    handles, names = axes["Y slope"].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=2, frameon=False)
    return figure


def _draw_list(
    axes: "Axes",
    names: Sequence[str],
    published: np.ndarray,
    regenerated: np.ndarray,
    error: np.ndarray,
) -> None:
    """Two marks for each name."""
    at = np.arange(len(names))
    axes.axhline(0, color="#888888", lw=0.6)
    for edge in at[:-1] + 0.5:
        axes.axvline(edge, color="#dddddd", lw=0.6)
    axes.plot(at - 0.16, published, "D", ms=5, color=PUBLISHED, label="published 1999")
    axes.errorbar(
        at + 0.16, regenerated, yerr=2 * error, fmt="o", ms=5, color=REGENERATED, capsize=3,
        lw=1.2, label="regenerated ± 2 standard errors",
    )  # fmt: skip
    axes.set_xticks(at, names)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.tick_params(axis="x", length=0, rotation=90 if len(names) > 5 else 0)
