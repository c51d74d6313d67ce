"""Pictures of the turbidity experiments."""

from pathlib import Path
from typing import Any

import numpy as np

from atmofit.files import replace_file

COLOURS = {"simulator": "#1f5fa8", "published (1999)": "#c8553d", "regenerated": "#5a9367"}


def draw_recovery(path: Path, turbidity: np.ndarray, results: dict[str, Any]) -> Path:
    """Estimates against the truth, and how the simulator's errors compare with their size.

    Args:
        path: Of the picture.
        turbidity: The truth of every sky.
        results: Values and standard errors of every model by name.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    ends = (turbidity.min(), turbidity.max())
    left.plot(ends, ends, color="#999999", lw=0.8)
    for name, columns in results.items():
        left.plot(turbidity, columns["value"], ".", ms=4, color=COLOURS[name], label=name)
    left.set(xlabel="true turbidity [-]", ylabel="estimated turbidity [-]")
    left.legend(frameon=False)
    simulator = results["simulator"]
    pull = (simulator["value"] - turbidity) / simulator["standard_error"]
    right.plot(turbidity, pull, ".", ms=4, color=COLOURS["simulator"])
    for level in (-1.96, 1.96):
        right.axhline(level, color="#999999", lw=0.8, ls="--")
    right.set(
        xlabel="true turbidity [-]",
        ylabel="error / standard error [-]",
        title="simulator; dashed: 95 %",
    )
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))


def draw_measured(
    path: Path,
    sun_deg: np.ndarray,
    may: np.ndarray,
    estimates: dict[str, list[dict[str, Any]]],
    site: list[float],
) -> Path:
    """Estimates of the measured scans, with the intervals scaled by the residual.

    Args:
        path: Of the picture.
        sun_deg: Solar zenith angle of every scan [degrees].
        may: Which scans are of May; the others are drawn open.
        estimates: Of every model by name, one for each scan.
        site: Least and largest turbidity that the aerosol of the site in May gives.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(*site, color="#dddddd", label="aerosol of the site, May")
    for place, (name, found) in enumerate(estimates.items()):
        value = np.array([one["value"] for one in found])
        half = 1.96 * np.array([one["scaled_standard_error"] for one in found])
        for some, face in ((may, COLOURS[name]), (~may, "white")):
            axes.errorbar(
                sun_deg[some] + 0.4 * (place - 1),
                value[some],
                half[some],
                fmt="o",
                ms=5,
                color=COLOURS[name],
                mfc=face,
                label=name if some is may else None,
            )
    axes.set(
        xlabel="sun from the zenith [°]",
        ylabel="estimated turbidity [-]",
        title="bars: 95 %, scaled by the residual; open: September",
    )
    axes.legend(frameon=False, fontsize=8)
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))
