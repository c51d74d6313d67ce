"""Tables of turbidity and sun as coloured cells with their numbers."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from atmofit.fit.comparison import Comparison
from atmofit.fit.skies import RefitSettings
from atmofit.render.image import new_figure
from atmofit.render.panorama import DIFFERENCES, MAGNITUDES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Field, title, kind of colours, factor on the numbers printed, and their format.
Row = tuple[str, str, str, float, str]
RATIOS: tuple[Row, ...] = (
    ("luminance_ratio", "mean of model Y / simulated Y", "ratio", 1.0, ".2f"),
    ("zenith_luminance_ratio", "zenith: model Y / simulated Y", "ratio", 1.0, ".2f"),
    ("x_ratio", "mean of model x / simulated x", "ratio", 1.0, ".3f"),
    ("zenith_x_ratio", "zenith: model x / simulated x", "ratio", 1.0, ".3f"),
    ("y_ratio", "mean of model y / simulated y", "ratio", 1.0, ".3f"),
    ("zenith_y_ratio", "zenith: model y / simulated y", "ratio", 1.0, ".3f"),
)
ERRORS: tuple[Row, ...] = (
    ("luminance_rms", "rms of model Y / simulated Y − 1 [%]", "size", 100.0, ".0f"),
    ("luminance_pattern_rms", "the same, mean ratio divided out [%]", "size", 100.0, ".0f"),
    ("x_mean", "mean of model x − simulated x [10⁻³]", "difference", 1e3, ".0f"),
    ("zenith_x_difference", "zenith: model x − simulated x [10⁻³]", "difference", 1e3, ".0f"),
    ("x_rms", "rms of model x − simulated x [10⁻³]", "size", 1e3, ".0f"),
    ("y_mean", "mean of model y − simulated y [10⁻³]", "difference", 1e3, ".0f"),
    ("zenith_y_difference", "zenith: model y − simulated y [10⁻³]", "difference", 1e3, ".0f"),
    ("y_rms", "rms of model y − simulated y [10⁻³]", "size", 1e3, ".0f"),
)


def draw_comparison(
    comparisons: Sequence[Comparison], settings: RefitSettings, rows: Sequence[Row] = ERRORS
) -> "Figure":
    """Models against the simulation, turbidity down and sun across, one column a model.

    Args:
        comparisons: At least one.
        settings: Whose turbidities and suns are the axes.
        rows: What is shown: `ERRORS` or `RATIOS`.
    """
    suns, turbidities = len(settings.solar_zenith_angle_deg), len(settings.turbidity)
    width = max(0.5 + 0.37 * suns, 4.2) * len(comparisons) + 0.4
    figure = new_figure(width, (0.42 + 0.23 * turbidities) * len(rows) + 0.4)
    axes = figure.subplots(len(rows), len(comparisons), squeeze=False)
    order = np.ix_(np.argsort(settings.turbidity), np.argsort(settings.solar_zenith_angle_deg))
    for i, (field, title, kind, factor, form) in enumerate(rows):
        tables = [getattr(one, field)[order] for one in comparisons]
        limits = _limits(np.stack(tables), kind)
        for j, table in enumerate(tables):
            _draw_table(axes[i, j], table, kind, limits, _printer(factor, form))
            axes[i, j].set_title(f"{title}: {comparisons[j].name}", loc="left")
            _label(axes[i, j], settings, bottom=i == len(rows) - 1, left=j == 0)
    return figure


def _measure(values: np.ndarray, kind: str) -> np.ndarray:
    """What is shown as colour, so that cells of every size can be told apart."""
    # The logarithm makes 2 and 1/2 equally strong; the root tames one large cell.
    if kind == "ratio":
        return np.log(np.where(values > 0, values, np.nan))
    return np.sqrt(values) if kind == "size" else values


def _printer(factor: float, form: str) -> Callable[[float], str]:
    """Numbers times a factor, with a true minus and without a minus before zero."""
    return lambda value: f"{factor * value:z{form}}".replace("-", "−")


def _limits(values: np.ndarray, kind: str) -> tuple[float, float]:
    """Range of the colours: from 0 for a size, else even about the middle."""
    reach = np.abs(_measure(values, kind))
    largest = float(reach[np.isfinite(reach)].max(initial=0.0)) or 1.0
    return (0.0 if kind == "size" else -largest), largest


def _draw_table(
    axes: "Axes",
    table: np.ndarray,
    kind: str,
    limits: tuple[float, float],
    text: Callable[[float], str],
) -> None:
    shown = _measure(table, kind)
    image = axes.imshow(
        shown, aspect="auto", cmap=MAGNITUDES if kind == "size" else DIFFERENCES,
        vmin=limits[0], vmax=limits[1],
    )  # fmt: skip
    for (row, column), value in np.ndenumerate(table):
        if not np.isfinite(value):
            axes.text(column, row, "–", ha="center", va="center", fontsize=8)
            continue
        red, green, blue, _ = image.cmap(image.norm(shown[row, column]))
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        axes.text(
            column, row, text(value), ha="center", va="center", fontsize=7.5,
            color="white" if dark else "black",
        )  # fmt: skip


def _label(axes: "Axes", settings: RefitSettings, *, bottom: bool, left: bool) -> None:
    suns, turbidities = sorted(settings.solar_zenith_angle_deg), sorted(settings.turbidity)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_xticks(range(len(suns)), [f"{sun:g}" for sun in suns] if bottom else [])
    axes.set_yticks(range(len(turbidities)), [f"{T:g}" for T in turbidities] if left else [])
    if bottom:
        axes.set_xlabel("sun from zenith [°]")
    if left:
        axes.set_ylabel("T [-]")
