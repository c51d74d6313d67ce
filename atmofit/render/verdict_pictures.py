"""Pictures of the verdict: scores of the coefficients, ratios, and what moves them."""

from typing import TYPE_CHECKING

import numpy as np

from atmofit.fit.movement import Movement, Movements
from atmofit.fit.refit import RefitResult
from atmofit.fit.verdict import CLOSE, CoefficientScores, scores_of
from atmofit.render.coefficients import PUBLISHED, REGENERATED
from atmofit.render.heat_maps import RATIOS, draw_comparison
from atmofit.render.image import new_figure, png_bytes, style
from atmofit.render.movements import short_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GREY = "#888888"


def verdict_pictures(result: RefitResult, movements: Movements) -> dict[str, bytes]:
    """The pictures of the verdict, as PNG by file name."""
    with style():
        figures = {
            "scores.png": draw_scores(scores_of(result)),
            "ratios.png": draw_comparison(result.comparisons, result.skies.settings, RATIOS),
            "what_moves_it.png": draw_movements(movements),
        }
        return {name: png_bytes(figure) for name, figure in figures.items()}


def draw_scores(scores: CoefficientScores) -> "Figure":
    """Every published coefficient in standard errors from the regenerated one."""
    figure = new_figure(9.0, 8.0)
    columns = (("Y", "x", "y"), ("zenith Y", "zenith x", "zenith y"))
    reach = 1.5 * max(float(np.max(_size(scores.z))), float(np.max(_size(scores.robust_z))), CLOSE)
    sizes = [0.0, CLOSE, *(10.0**n for n in range(1, 1 + int(np.log10(reach))))]
    ticks = [*(-size for size in sizes[:0:-1]), *sizes]
    left, right = figure.add_gridspec(1, 2)
    first = None
    for place, groups in ((left, columns[0]), (right, columns[1])):
        parts = [scores.of_group(group) for group in groups]
        rows = place.subgridspec(
            len(groups), 1, height_ratios=[len(part.term) + 1 for part in parts]
        )
        for k, (group, part) in enumerate(zip(groups, parts, strict=True)):
            ax = figure.add_subplot(rows[k])
            first = first or ax
            _draw_group(ax, part)
            ax.set_title(group if " " in group else f"{group} over the dome", loc="left")
            ax.set_xscale("symlog", linthresh=CLOSE, linscale=0.7)
            ax.set_xlim(-reach, reach)
            ax.minorticks_off()
            ax.set_xticks(ticks, [f"{tick:g}".replace("-", "−") for tick in ticks])
            if k == len(groups) - 1:
                ax.set_xlabel("(published − regenerated) / standard error [-]")
    assert first is not None
    handles, names = first.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _draw_group(axes: "Axes", scores: CoefficientScores) -> None:
    """One row a coefficient, two marks each."""
    at = np.arange(len(scores.term))
    axes.axvspan(-CLOSE, CLOSE, color="#e8e8e8", lw=0, label=f"within {CLOSE:g}")
    axes.axvline(0, color=_GREY, lw=0.6)
    for row, (naive, robust) in enumerate(zip(scores.z, scores.robust_z, strict=True)):
        axes.plot([naive, robust], [row, row], color="#bbbbbb", lw=0.8, zorder=1)
    axes.plot(
        scores.z, at, "D", ms=4, mfc="none", color=PUBLISHED, label="residuals independent"
    )  # fmt: skip
    axes.plot(scores.robust_z, at, "o", ms=4, color=REGENERATED, label="each sky one cluster")
    axes.set_yticks(at, scores.term)
    axes.tick_params(axis="y", length=0, labelsize=7)
    axes.set_ylim(len(at) - 0.4, -0.6)


def draw_movements(movements: Movements) -> "Figure":
    """One row an assumption: the published model, the refit's own error, the coefficients."""
    rows = movements.rows
    figure = new_figure(9.6, 1.4 + 0.24 * len(rows))
    axes = figure.subplots(1, 3, sharey=True)
    ratios: list[_Mark] = [
        ("luminance_ratio", 1.0, "o", PUBLISHED, "over the dome"),
        ("zenith_luminance_ratio", 1.0, "D", REGENERATED, "zenith"),
    ]
    errors: list[_Mark] = [
        ("luminance_log_rms", 100.0, "o", PUBLISHED, "published, logarithm"),
        ("luminance_pattern_rms", 100.0, "D", PUBLISHED, "published, pattern"),
        ("refit_luminance_rms", 100.0, "o", REGENERATED, "its own refit"),
    ]
    moves: list[_Mark] = [
        ("moved_median", 1.0, "o", REGENERATED, "median"),
        ("largest_move", 1.0, "|", _GREY, "largest"),
    ]
    _draw_column(axes[0], rows, ratios, "published / simulated Y [-]")
    _draw_column(axes[1], rows, errors, "rms of Y [%]")
    _draw_column(axes[2], rows, moves, "move of the regenerated\ncoefficients [standard errors]")
    axes[0].axvline(1.0, color="#333333", lw=0.8)
    axes[0].set_xscale("log")
    ticks = (0.5, 1, 2, 3, 5)
    axes[0].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes[0].minorticks_off()
    axes[1].set_xlim(left=0)
    axes[2].set_xscale("symlog", linthresh=1.0)
    axes[2].set_xlim(left=0)
    axes[0].set_yticks(range(len(rows)), [short_label(row) for row in rows])
    axes[0].tick_params(axis="y", length=0)
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


_Mark = tuple[str, float, str, str, str]  # field, factor, marker, colour, label


def _draw_column(axes: "Axes", rows: tuple[Movement, ...], marks: list[_Mark], title: str) -> None:
    at = np.arange(len(rows))
    for row in range(len(rows)):
        axes.axhline(row, color="#eeeeee", lw=0.6, zorder=0)
    for field, factor, marker, colour, label in marks:
        values = factor * np.abs([getattr(row, field) for row in rows])
        fill = "none" if marker == "D" else colour
        axes.axvline(values[0], color=colour, lw=0.6, ls=":", zorder=0)
        axes.plot(values, at, marker, ms=5, mfc=fill, color=colour, label=label)
    axes.set_xlabel(title)
    axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1, frameon=False, handletextpad=0.2,
        fontsize=8,
    )  # fmt: skip


def _size(values: np.ndarray) -> np.ndarray:
    return np.abs(values[np.isfinite(values)])
