"""Table and picture of the comparison with other codes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from error_vs_runtime_report import pareto_front
from run_files import markdown

# Colours that the colour-blind tell apart (Okabe and Ito 2008), and a marker each.
_STYLE = {
    "nanodisort": ("#D55E00", "s"),
    "sasktran2": ("#CC79A7", "D"),
    "atmofit, every wavelength": ("#0072B2", "o"),
    "atmofit, wavelength nodes": ("#56B4E9", "^"),
    "atmofit, every wavelength, GPU": ("#000000", "o"),
    "atmofit, wavelength nodes, GPU": ("#009E73", "^"),
}
TITLE = {
    "flat_all_orders": "flat, all orders",
    "round_single": "round, single scattering",
    "round_all_orders": "round, all orders",
}
REFERENCE = {
    "flat_all_orders": "nanodisort's finest",
    "round_single": "sasktran2's finest",
    "round_all_orders": "each code's own finest",
}
_HEADLINE = [
    *("problem", "atmofit", "settings", "largest error", "skies/s"),
    *("peer", "settings", "largest error", "skies/s", "ratio", "aim"),
]
_CASES = [
    *("problem", "code", "settings", "s a sky", "compile [s]", "peak [MB]"),
    *("largest to sun 80, view 85", "rms there", "largest", "rms", "skies timed", "load before"),
]


def text(stored: dict[str, Any], tolerance: float, threads: int) -> str:
    """All that was measured, as Markdown.

    Args:
        stored: What result.json holds.
        tolerance: Of the headlines.
        threads: Of every code.
    """
    suns = ", ".join(f"{sun:g}" for sun in stored["judged_suns_deg"])
    against = "; ".join(f"{TITLE[group]}: {what}" for group, what in REFERENCE.items())
    lines = [
        "# Error against run time, with other codes",
        "",
        f"{stored['skies']} skies (suns, haze loads, rings, azimuths, wavelengths: "
        f"{' x '.join(map(str, stored['shape']))}), {threads} threads, {stored['date']}; "
        + (f"GPU: {stored['gpu']}." if stored["gpu"] else "no GPU."),
        f"Errors over {stored['judged_skies']} of them, suns {suns} degrees under the least and "
        f"most haze, at {stored['judged_wavelengths']} wavelengths, relative, against: {against}.",
        "",
        *_between(stored["finest_differences"]),
        "",
        f"Cheapest settings with errors up to {tolerance:.0%} to sun 80, view 85:",
        "",
        markdown(_HEADLINE, [_headline_row(each) for each in stored["headlines"]]),
        "",
        "All cases:",
        "",
        markdown(_CASES, [_case_row(case) for case in stored["cases"]]),
    ]
    return "\n".join(lines) + "\n"


def draw(stored: dict[str, Any], tolerance: float, path: Path) -> None:
    """Error against seconds a sky, a panel for each problem, with every Pareto front."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(
        1, 3, figsize=(13, 5.5), sharex=True, sharey=True, layout="constrained"
    )
    named = {}
    for ax, (group, title) in zip(axes, TITLE.items(), strict=True):
        for series, (colour, marker) in _STYLE.items():
            points = points_of(stored["cases"], group, series)
            if not points:
                continue
            front = pareto_front(points)
            ax.plot(*zip(*points, strict=True), marker, color=colour, alpha=0.5, markersize=5)
            named[series] = ax.plot(*zip(*front, strict=True), f"-{marker}", color=colour)[0]
        ax.axhline(tolerance, color="0.4", linestyle="--", linewidth=1)
        ax.set(xscale="log", yscale="log", xlabel="time for a sky [s]")
        ax.set_title(f"{title}\nagainst {REFERENCE[group]}", fontsize=10)
        ax.grid(which="major", alpha=0.3)
    fig.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named))
    axes[0].set_ylabel("largest relative error of radiance [-]\nto sun 80, view 85 degrees")
    fig.savefig(path, dpi=150)
    plt.close(fig)


def points_of(
    cases: Sequence[dict[str, Any]], group: str, series: str
) -> list[tuple[float, float]]:
    """Seconds a sky and error of every case of a series that has an error, by seconds."""
    return sorted(
        (case["seconds_per_sky"], case["error"]["inner_largest"])
        for case in cases
        if (case["group"], case["series"]) == (group, series)
        and case["error"] is not None
        and not case["finest"]
    )


def _between(differences: dict[str, dict[str, float]]) -> list[str]:
    """How far the finest solutions are apart, a line each."""
    return [
        f"{TITLE[group]}: atmofit's finest is within {d['inner_largest']:.2%} of the other code's "
        f"(rms {d['inner_rms']:.2%}) to sun 80, view 85, and {d['largest']:.2%} (rms "
        f"{d['rms']:.2%}) everywhere.\n"
        for group, d in differences.items()
    ]


def _headline_row(each: dict[str, Any]) -> list[str]:
    def side(name: str) -> list[str]:
        if f"{name}_skies_per_second" not in each:
            return [each[name], "none is so good", "-", "-"]
        return [
            each[name],
            each[f"{name}_settings"],
            f"{each[f'{name}_error']['inner_largest']:.2%}",
            f"{each[f'{name}_skies_per_second']:.3g}",
        ]

    ratio = "-" if each["ratio"] is None else f"{each['ratio']:.3g}"
    aim = "-" if each["aim"] is None else f"{each['aim']:g}"
    return [TITLE[each["group"]], *side("own"), *side("peer"), ratio, aim]


def _case_row(case: dict[str, Any]) -> list[str]:
    names = ("inner_largest", "inner_rms", "largest", "rms")
    errors = ["-"] * 4 if case["error"] is None else [f"{case['error'][n]:.1e}" for n in names]
    return [
        TITLE[case["group"]],
        f"{case['series']} ({case['version']})",
        case["label"] + (" (finest)" if case["finest"] else ""),
        "-" if case["finest"] else f"{case['seconds_per_sky']:.4f}",
        f"{case['compile_seconds']:.1f}" if case["compile_seconds"] else "-",
        f"{case['peak_megabytes']:.0f}",
        *errors,
        "-" if case["finest"] else str(case["skies_timed"]),
        f"{case['load_average_before']:.1f}",
    ]
