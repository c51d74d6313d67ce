"""Table and picture of error against run time."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from error_vs_runtime_case import Case


@dataclasses.dataclass(frozen=True)
class Row:
    """One case, its cost and its errors over the dome."""

    case: Case
    cost: dict[str, Any]
    largest: float
    rms: float
    x: float
    y: float
    where: str

    @property
    def line(self) -> str:
        """A row of the table."""
        cost = self.cost
        return (
            f"| {self.case.family} | {self.case.label} | {self.case.dtype} "
            f"| {cost['compile']:.1f} | {cost['first']:.2f} | {cost['hot']:.2f} "
            f"| {cost['peak_MB']:.0f} | {self.largest:.3%} | {self.rms:.3%} "
            f"| {self.x:.1e} | {self.y:.1e} | {self.where} |"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        cost = {k: float(self.cost[k]) for k in ("compile", "first", "hot", "peak_MB")}
        errors = {k: getattr(self, k) for k in ("largest", "rms", "x", "y", "where")}
        return dataclasses.asdict(self.case) | cost | errors


def table(
    rows: Sequence[Row], rungs: Sequence[dict[str, Any]], confirmed: Sequence[dict], older: int
) -> str:
    """All that was measured, as Markdown."""
    lines = ["# Error against run time, reference job", ""]
    lines += [_sentence(each) for each in confirmed]
    if older:
        lines += ["", f"{older} results were kept from other versions of the simulator's source."]
    lines += [
        "",
        "Errors over the dome against the fine solution:",
        "",
        *_head(
            "varied, value, dtype, compile [s], first call [s], hot call [s], peak [MB], "
            "largest error of Y, rms of Y, largest of x, largest of y, largest Y at [degree]"
        ),
        *(row.line for row in rows),
        "",
    ]
    if rungs:
        lines += ["Rungs of the ladder against nested quadrature itself:", "", *rung_table(rungs)]
    return "\n".join(lines) + "\n"


def rung_table(rungs: Sequence[dict[str, Any]]) -> list[str]:
    """The ladder with its errors against nested quadrature, as lines of Markdown."""
    head = (
        "rtol, dtype, compile [s], first call [s], hot call [s], peak [MB], "
        "largest error of Y, rms of Y"
    )
    with_random = all("random_largest" in each for each in rungs)
    lines = _head(head + (", random skies largest, random skies rms" if with_random else ""))
    for each in rungs:
        line = (
            f"| {each['rtol']:g} | {each['dtype']} | {each['compile_seconds']:.1f} "
            f"| {each['first_seconds']:.2f} | {each['hot_seconds']:.2f} "
            f"| {each['peak_megabytes']:.0f} "
            f"| {each['reference_largest']:.3%} | {each['reference_rms']:.3%} |"
        )
        if with_random:
            line += f" {each['random_largest']:.3%} | {each['random_rms']:.3%} |"
        lines.append(line)
    return lines


def draw_pareto(rows: Sequence[Row], path: Path) -> None:
    """Largest error against hot seconds, with the front and the rungs of the ladder."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    same = [r for r in rows if r.case.geometry == "spherical" and r.case.orders == 2]
    families = [f for f in dict.fromkeys(r.case.family for r in same) if f != "ladder"]
    colours = mpl.colormaps["viridis"]
    fig, ax = plt.subplots(figsize=(9, 6), layout="constrained")
    for number, family in enumerate(families):
        chosen = [r for r in same if r.case.family == family]
        ax.plot(
            [float(r.cost["hot"]) for r in chosen],
            [r.largest for r in chosen],
            "os^D"[number % 4],
            color=colours(number / max(len(families) - 1, 1)),
            markersize=6,
            label=family,
        )
    front = pareto_front([(float(r.cost["hot"]), r.largest) for r in same])
    ax.plot(*zip(*front, strict=True), "-", color="0.6", linewidth=1, label="front", zorder=0)
    for dtype, marker in (("float32", "*"), ("float64", "P")):
        chosen = [r for r in same if r.case.family == "ladder" and r.case.dtype == dtype]
        seconds, largest = [float(r.cost["hot"]) for r in chosen], [r.largest for r in chosen]
        ax.plot(seconds, largest, marker, color="crimson", markersize=12, label=f"ladder, {dtype}")
        if dtype == "float32":
            for row, s, e in zip(chosen, seconds, largest, strict=True):
                ax.annotate(f"rtol {row.case.label}", (s, e), (8, 6), textcoords="offset points")
    ax.set(xscale="log", yscale="log", xlabel="hot call of the reference job [s]")
    ax.set_ylabel("largest relative error of luminance Y [-]")
    ax.grid(which="both", alpha=0.2)
    ax.legend(fontsize=8, ncols=2)
    fig.savefig(path, dpi=150)
    plt.close(fig)


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that none beats in both cost and error, by cost."""
    front: list[tuple[float, float]] = []
    for cost, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((cost, error))
    return front


def _head(names: str) -> list[str]:
    columns = names.split(", ")
    return ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]


def _sentence(each: dict[str, Any]) -> str:
    """How well the fine solution is confirmed."""
    text = (
        f"Fine solution, {each['geometry']}, {each['orders']} order(s): within "
        f"{each['quadrature_largest']:.3%} of nested quadrature "
        f"(rms {each['quadrature_rms']:.3%})"
    )
    if "monte_carlo_mean" in each:
        text += (
            f"; {each['monte_carlo_mean']:+.2%} ± {each['monte_carlo_mean_error']:.2%} from "
            f"Monte Carlo on average, {each['monte_carlo_largest_score']:.1f} standard errors at "
            "most"
        )
    return text + ".\n"
