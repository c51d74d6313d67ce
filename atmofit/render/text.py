"""Tables in plain text, for the terminal."""

import math
from collections.abc import Sequence

import numpy as np

from atmofit.fit.comparison import Comparison
from atmofit.fit.parameters import NAMES
from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import SimulatedSkies
from atmofit.fit.verdict import (
    CHROMATICITY_CELLS,
    DISTRIBUTIONS,
    LUMINANCE_CELLS,
    PARTS,
    distribution,
    zenith,
)
from atmofit.models.preetham import PREETHAM_1999

# Field of a comparison, its name in a table, its format.
STATISTICS = (
    ("luminance_ratio", "Y, mean of model / simulation", ".3f"),
    ("luminance_rms", "Y, rms of model / simulation - 1", ".3f"),
    ("luminance_log_rms", "Y, rms of log(model / simulation)", ".3f"),
    ("luminance_pattern_rms", "Y, rms of the pattern, mean left out", ".3f"),
    ("x_ratio", "x, mean of model / simulation", ".3f"),
    ("x_mean", "x, mean of model - simulation", ".4f"),
    ("x_rms", "x, rms of model - simulation", ".4f"),
    ("y_ratio", "y, mean of model / simulation", ".3f"),
    ("y_mean", "y, mean of model - simulation", ".4f"),
    ("y_rms", "y, rms of model - simulation", ".4f"),
    ("zenith_luminance_ratio", "Y at the zenith, model / simulation", ".3f"),
    ("zenith_x_ratio", "x at the zenith, model / simulation", ".3f"),
    ("zenith_x_difference", "x at the zenith, model - simulation", ".4f"),
    ("zenith_y_ratio", "y at the zenith, model / simulation", ".3f"),
    ("zenith_y_difference", "y at the zenith, model - simulation", ".4f"),
)


def number(value: float) -> str:
    """A coefficient with five significant digits; a dash where there is none."""
    return f"{float(value):.5g}" if math.isfinite(value) else "-"


def error(value: float) -> str:
    """A standard error with two significant digits."""
    return f"{float(value):.2g}" if math.isfinite(value) else "-"


def condition(value: float) -> str:
    """A condition number with at least two digits, written out."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def coefficient_rows(result: RefitResult, quantity: str) -> list[tuple[str, ...]]:
    """Name, published, regenerated, standard error, for slope and then for intercept."""
    matrices = (
        distribution(PREETHAM_1999, quantity),
        distribution(result.model, quantity),
        np.asarray(result.distributions[quantity].standard_error),
    )
    return [
        (name, *(cell for k in range(len(PARTS)) for cell in _cells(*(m[i, k] for m in matrices))))
        for i, name in enumerate(NAMES)
    ]


def zenith_rows(result: RefitResult, quantity: str) -> list[tuple[str, ...]]:
    """Name, published, regenerated, standard error of each zenith coefficient."""
    names = LUMINANCE_CELLS if quantity == "Y" else CHROMATICITY_CELLS
    columns = (
        zenith(PREETHAM_1999, quantity),
        zenith(result.model, quantity),
        np.ravel(result.zeniths[quantity].standard_error),
    )
    return [(name, *_cells(*row)) for name, *row in zip(names, *columns, strict=True)]


def _cells(published: float, regenerated: float, standard_error: float) -> tuple[str, ...]:
    return number(published), number(regenerated), error(standard_error)


def statistic(value: float, form: str) -> str:
    """One number of a comparison; a dash where the model is not valid."""
    return f"{value:z{form}}" if math.isfinite(value) else "-"


def statistic_rows(comparisons: Sequence[Comparison]) -> list[tuple[str, ...]]:
    """Each statistic over all skies, one column a model."""
    summaries = [one.summary() for one in comparisons]
    return [
        (name, *(statistic(summary[field], form) for summary in summaries))
        for field, name, form in STATISTICS
    ]


def summary_text(result: RefitResult) -> str:
    """Coefficients beside the published ones, quality of the fits and comparison, as plain text."""
    lines = ["Perez coefficients (slope T + intercept): published | regenerated ± its error"]
    for quantity in DISTRIBUTIONS:
        lines.append(f"{quantity:<4}{'slope':^32} {'intercept':^32}")
        for name, *cells in coefficient_rows(result, quantity):
            lines.append(f"  {name} {_pair(*cells[:3])} {_pair(*cells[3:])}")
        fit = result.distributions[quantity]
        lines.append(
            f"    rms {float(fit.rms):.2g} ({fit.weighting}), condition number "
            f"{condition(float(fit.condition_number))}, {int(fit.steps)} steps, "
            + ("converged" if bool(fit.converged) else "NOT CONVERGED")
        )
    lines.append("Zenith luminance [kcd m^-2]: published | regenerated ± standard error")
    lines += [f"  {name} {_pair(*cells)}" for name, *cells in zenith_rows(result, "Y")]
    for quantity in DISTRIBUTIONS:
        fit = result.zeniths[quantity]
        lines.append(
            f"  zenith {quantity}: rms {float(fit.rms):.2g} ({fit.weighting}), condition number "
            f"{condition(float(fit.condition_number))}"
        )
    lines += ["", *_statistics(result.comparisons)]
    return "\n".join(lines)


def comparison_text(comparison: Comparison, skies: SimulatedSkies) -> str:
    """A model against simulated skies: each turbidity and sun, then all together."""
    settings = skies.settings
    suns = "".join(f"{sun:>8g}" for sun in settings.solar_zenith_angle_deg)
    lines = []
    for field, name, form in STATISTICS:
        if field.startswith("zenith"):
            continue
        lines += [name, f"{'T, sun':>8}{suns}"]
        for T, row in zip(settings.turbidity, getattr(comparison, field), strict=True):
            lines.append(f"{T:>8g}" + "".join(f"{statistic(value, form):>8}" for value in row))
    return "\n".join([*lines, "", *_statistics((comparison,))])


def _statistics(comparisons: Sequence[Comparison]) -> list[str]:
    widths = [max(12, len(one.name) + 2) for one in comparisons]
    names = (f"{one.name:>{width}}" for one, width in zip(comparisons, widths, strict=True))
    lines = [f"{'Against the simulation, all skies':<36}" + "".join(names)]
    for name, *cells in statistic_rows(comparisons):
        row = (f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))
        lines.append(f"{name:<36}" + "".join(row))
    return lines


def _pair(published: str, regenerated: str, standard_error: str) -> str:
    return f"{published:>10} |{regenerated:>10} ± {standard_error:<7}"
