"""Pictures of the turbidity experiments."""

from pathlib import Path
from typing import Any

import numpy as np

from atmofit.files import replace_file

PALETTE = ("#1f5fa8", "#56b4e9", "#c8553d", "#5a9367", "#8c6bb1")


def draw_study(path: Path, cases: dict[str, dict[str, Any]]) -> Path:
    """Estimates against the truth, and the error of every estimator against its run time.

    The first panel has matched skies, the next two skies of real air with their intervals.

    Args:
        path: Of the picture.
        cases: Truth, values and standard errors of every case by name.
    """
    from matplotlib.figure import Figure

    chosen = {
        "simulator, 1 % noise": "simulator, 81 directions, 1.0%, exposure known",
        "real air, two orders": "mismatch: two orders, the paper's air, with model error",
        "real air, ATMOFIT_2026": "mismatch: ATMOFIT_2026, with model error",
    }
    figure = Figure(figsize=(14, 3.9), layout="constrained")
    *axes, cost = figure.subplots(1, 4)
    for ax, (title, name) in zip(axes, chosen.items(), strict=True):
        truth, value, error = (np.asarray(cases[name][k]) for k in ("truth", "value", "error"))
        ends = (1.0, 12.0)
        ax.plot(ends, ends, color="#999999", lw=0.8)
        bars = 1.96 * np.minimum(error, 5.0)
        ax.errorbar(truth, value, bars, fmt=".", ms=4, lw=0.6, color="#1f5fa8")
        ax.set(xlabel="true turbidity [-]", title=title, xscale="log", yscale="log")
        ax.set(xlim=ends, ylim=ends, xticks=[1, 2, 5, 10], yticks=[1, 2, 5, 10])
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(lambda x, _: f"{x:g}")
            axis.set_minor_formatter("")
    axes[0].set_ylabel("estimated turbidity [-]")
    _draw_cost(cost, cases)
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))


def _draw_cost(ax: Any, cases: dict[str, dict[str, Any]]) -> None:
    """Root mean square error in skies of real air against seconds a sky."""
    names = [name.split(": ")[1] for name in cases if name.startswith("mismatch")]
    models = list(dict.fromkeys(name.rsplit(", ", 1)[0] for name in names))
    for color, model in zip(PALETTE, models, strict=False):
        for kind, marker in (("with", "o"), ("without", "x")):
            case = cases[f"mismatch: {model}, {kind} model error"]
            off = np.asarray(case["value"]) - np.asarray(case["truth"])
            label = model if kind == "with" else None
            ax.plot(case["seconds"], np.sqrt(np.mean(off**2)), marker, color=color, label=label)
    ax.set(xscale="log", yscale="log", title="o with model error, x without")
    ax.set(xlabel="seconds a sky [s]", ylabel="rms error of turbidity, real air [-]")
    ax.set(xlim=(2e-4, 20), ylim=(0.1, 5), yticks=[0.1, 0.2, 0.5, 1, 2, 5])
    ax.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
    ax.yaxis.set_minor_formatter("")
    ax.legend(frameon=False, fontsize=7)


def draw_measured(
    path: Path,
    estimates: dict[str, list[dict[str, Any]]],
    site: float,
    station: tuple[float, float],
) -> Path:
    """Optical depths of the haze in every scan, with their 95 % intervals.

    Args:
        path: Of the picture.
        estimates: Of every estimator by name, one for each scan.
        site: Optical depth that the 2013 comparison took.
        station: Least and largest of an AERONET station.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), layout="constrained")
    ax = figure.subplots()
    ax.axhspan(*station, color="#dddddd", lw=0, label="AERONET, 300 km away (May)")
    ax.axhline(site, color="#777777", ls="--", lw=0.9, label="site, as used in 2013 (May)")
    for k, (name, scans) in enumerate(estimates.items()):
        depth = np.array([scan["optical_depth"] for scan in scans])
        low, high = np.array([scan["interval"] for scan in scans]).T
        place = np.arange(1, depth.size + 1) + 0.14 * (k - (len(estimates) - 1) / 2)
        bars = np.stack([depth - low, high - depth])
        ax.errorbar(place, depth, bars, fmt="o", ms=4, lw=1.1, color=PALETTE[k], label=name)
    ax.set(
        xlabel="scan (1 to 8: May 27, 9 and 10: September 24, 2013)",
        ylabel="haze optical depth at 550 nm [-]",
        xticks=np.arange(1, 11),
        ylim=(0, None),
    )
    ax.legend(frameon=False, fontsize=7)
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))
