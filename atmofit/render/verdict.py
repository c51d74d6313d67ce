"""The verdict of a report: what reproduces, what does not, and what moves it."""

from collections.abc import Mapping

import numpy as np

from atmofit.fit.comparison import Comparison, over
from atmofit.fit.movement import Movements
from atmofit.fit.refit import RefitResult
from atmofit.fit.verdict import CLOSE, CoefficientScores, scores_of
from atmofit.render import html
from atmofit.render.findings import CHROMATICITY_CLOSE, LUMINANCE_CLOSE, findings
from atmofit.render.movements import movement_sentences, movement_tables
from atmofit.render.text import statistic, statistic_rows

CAPTIONS = {
    "scores.png": "Every published coefficient in standard errors from the regenerated one; the "
    f"axis is linear within {CLOSE:g} (grey) and logarithmic beyond. Diamonds: residuals taken as "
    "independent. Discs: each sky taken as one cluster whose residuals may be correlated.",
    "ratios.png": "Model over simulation for each turbidity and sun. Colours are even about 1 on "
    "a logarithmic scale and shared by the two tables of a row.",
    "comparison.png": "Both models against the simulation for each turbidity and sun. The two "
    "tables of a row share their colours: differences about 0, an rms from 0.",
    "what_moves_it.png": "What each assumption does, dotted lines at the reference job's own. "
    "Left: published over simulated luminance, averaged over the dome and at the zenith. Middle: "
    "what is left of luminance. Right: how far regenerated coefficients move, in the reference "
    "job's robust standard errors (linear to 1, then logarithmic).",
}
# Of each quantity: field, name, format.
_TABLES = {
    "Y": (
        ("luminance_ratio", "over the dome / simulated", ".2f"),
        ("zenith_luminance_ratio", "zenith / simulated", ".2f"),
        ("luminance_pattern_rms", "pattern, rms", ".3f"),
    ),
    **{
        q: (
            (f"{q}_ratio", "over the dome / simulated", ".3f"),
            (f"{q}_mean", "over the dome − simulated", ".4f"),
            (f"zenith_{q}_ratio", "zenith / simulated", ".3f"),
            (f"zenith_{q}_difference", "zenith − simulated", ".4f"),
        )
        for q in "xy"
    },
}


def section(result: RefitResult, pictures: Mapping[str, bytes], movements: Movements) -> list[str]:
    """The verdict as parts of a page.

    Args:
        result: Of the refit.
        pictures: PNGs by file name, those of `CAPTIONS` among them.
        movements: What was measured for the reference job, see `stored_movements`.
    """
    shown = {name: html.picture(pictures[name], words) for name, words in CAPTIONS.items()}
    return [
        html.heading("The verdict: what reproduces and what does not"),
        html.bullets(findings(result)),
        html.paragraph(
            f"Said to be reproduced: luminance within {100 * LUMINANCE_CLOSE:.0f} % rms, "
            f"chromaticity within {CHROMATICITY_CLOSE} rms, coefficients if all lie within "
            f"{CLOSE:g} robust standard errors."
        ),
        *_predictions(result),
        shown["ratios.png"],
        shown["comparison.png"],
        *_scores(scores_of(result)),
        shown["scores.png"],
        *_movements(movements),
        shown["what_moves_it.png"],
        html.paragraph(movement_sentences(movements)[-1]),
    ]


def _predictions(result: RefitResult) -> list[str]:
    names = [one.name for one in result.comparisons]
    return [
        html.heading("Both models against the simulation", 3),
        html.table(["all skies", *names], statistic_rows(result.comparisons)),
        *(part for quantity in _TABLES for part in _marginals(result, quantity)),
    ]


def _marginals(result: RefitResult, quantity: str) -> list[str]:
    """Rows for every turbidity over all suns, then for every sun over all turbidities."""
    settings, both, fields = result.skies.settings, result.comparisons, _TABLES[quantity]
    head = ["", *(f"{one.name} {name}" for _, name, _ in fields for one in both)]
    places = [(f"T {T:g}", np.s_[i, :]) for i, T in enumerate(settings.turbidity)]
    suns = enumerate(settings.solar_zenith_angle_deg)
    places += [(f"sun {sun:g}°", np.s_[:, j]) for j, sun in suns]
    rows = [
        [label, *(_cell(one, field, place, form) for field, _, form in fields for one in both)]
        for label, place in places
    ]
    title = f"{quantity} by turbidity (over all suns) and by sun (over all turbidities)"
    return [html.heading(title, 3), html.table(head, rows)]


def _cell(one: Comparison, field: str, place: object, form: str) -> str:
    """Over the cells where the model is valid; a dash if there are none."""
    return statistic(over(getattr(one, field)[place], rms=field.endswith("rms")), form)


def _scores(scores: CoefficientScores) -> list[str]:
    def row(label: str, part: CoefficientScores) -> list[str]:
        s = part.summary()
        counts = [f"{s[n]:.0f}" for n in ("count", "within_two", "within_two_robust")]
        medians = [f"{s[n]:.1f}" for n in ("median_z", "median_robust_z")]
        return [label, *counts, *medians, f"{s['within_tenth']:.0f}"]

    head = [
        "coefficients of",
        "count",
        f"|z| < {CLOSE:g}, residuals independent",
        f"|z| < {CLOSE:g}, each sky one cluster",
        "median |z|, independent",
        "median |z|, clusters",
        "within 10 %",
    ]
    rows = [row(group, scores.of_group(group)) for group in scores.groups]
    each = [
        [f"{group} {term}", *(_score(value) for value in (z, robust))]
        for group, term, z, robust in zip(
            scores.group, scores.term, scores.z, scores.robust_z, strict=True
        )
    ]
    half = (len(each) + 1) // 2
    pairs = [
        [*left, *(each[half + i] if half + i < len(each) else ("", "", ""))]
        for i, left in enumerate(each[:half])
    ]
    return [
        html.heading("Published coefficients in standard errors of the regenerated", 3),
        html.paragraph(
            "z = (published − regenerated) / standard error. With residuals taken as independent "
            "the error says how well so many directions fix a coefficient; with each sky taken as "
            "one cluster it also holds that neighbouring directions miss the formula together."
        ),
        html.table(head, [*rows, row("all", scores)]),
        html.paragraph("Each of them:"),
        html.table(["", "z", "z, clusters"] * 2, pairs),
    ]


def _score(value: float) -> str:
    return f"{value:+.1f}" if np.isfinite(value) else "-"


def _movements(movements: Movements) -> list[str]:
    known, third = movements.provenance, movements.third_order
    s = known["settings"]
    suns, turbidity = s["solar_zenith_angle_deg"], s["turbidity"]
    published, refitted = movement_tables(movements)
    versions = ", ".join(f"{name} {version}" for name, version in known["versions"].items())
    return [
        html.heading("What moves it"),
        html.paragraph(
            f"Measured once, on {known['date']}, with {versions}, for the reference job "
            f"({len(suns)} suns to {max(suns):g}°, turbidity {min(turbidity):g} to "
            f"{max(turbidity):g}, {s['directions']} directions, {s['dtype']}, promised error "
            f"{s['rtol']:g}); not for the run of this page. Each assumption is changed alone, the "
            "skies are simulated again and the model is fitted to them again."
        ),
        html.bullets(movement_sentences(movements)[:-1]),
        html.heading("The published model under each assumption", 3),
        html.table(*published),
        html.heading("The refit under each assumption", 3),
        html.table(*refitted),
        html.paragraph(
            "Moves of coefficients count in the reference job's robust standard errors. The third "
            f"order is the ratio to two orders from {third['samples']} Monte Carlo samples (errors "
            f"of {100 * third['noise']:.2f} % rms) carried over the dome by a polynomial of degree "
            f"{third['degree']}, which misses samples left out of it by "
            f"{100 * third['error']:.1f} % rms ({100 * third['median_error']:.1f} % median, "
            f"{100 * third['largest_error']:.0f} % at most); the largest ratio sampled is "
            f"{third['largest_ratio']:.2f}."
        ),
    ]
