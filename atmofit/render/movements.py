"""What moves the verdict, as a table and as sentences whose words follow the numbers."""

from collections.abc import Callable

from atmofit.fit.movement import Movement, Movements
from atmofit.render.findings import CHROMATICITY_CLOSE, LUMINANCE_CLOSE

SMALL = 0.02  # change of the rms of the log ratio that is called small
MOVEMENT_COLUMNS = [
    "assumption",
    "Y: published / simulated",
    "zenith Y: likewise",
    "x: published − simulated",
    "y: likewise",
    "rms of log Y ratio",
    "rms of its pattern",
    "own refit: Y rms",
    "own refit: its pattern",
    "own refit: x rms",
    "own refit: y rms",
    "coefficients within 2 standard errors (robust)",
    "coefficients move, median",
    "move, rms",
    "moves most",
]


def movement_rows(movements: Movements) -> list[tuple[str, ...]]:
    """Cells of `MOVEMENT_COLUMNS`, the baseline first."""
    return [_cells(row, row.label, movements.baseline) for row in movements.rows]


def movement_tables(movements: Movements) -> list[tuple[list[str], list[list[str]]]]:
    """Head and rows of two narrower tables: the published model, and the refits."""
    rows = [_cells(row, short_label(row), movements.baseline) for row in movements.rows]
    parts = ((0, 1, 2, 3, 4, 5, 6, 11), (0, 7, 8, 9, 10, 12, 13, 14))
    return [
        ([MOVEMENT_COLUMNS[k] for k in part], [[row[k] for k in part] for row in rows])
        for part in parts
    ]


def short_label(row: Movement) -> str:
    """The label without the list of what a combination holds."""
    return row.label.split(":")[0] if row.kind == "combination" else row.label


def _cells(row: Movement, label: str, baseline: Movement) -> tuple[str, ...]:
    most = f"{row.largest_mover} {row.largest_move:+.3g}" if row.largest_mover else "-"
    return (
        label + ("" if row.converged else " (a fit did not converge)"),
        f"{row.luminance_ratio:.2f}",
        f"{row.zenith_luminance_ratio:.2f}",
        f"{row.x_mean:+.4f}",
        f"{row.y_mean:+.4f}",
        f"{row.luminance_log_rms:.3f}",
        f"{row.luminance_pattern_rms:.3f}",
        f"{row.refit_luminance_rms:.3f}",
        f"{row.refit_pattern_rms:.3f}",
        f"{row.refit_x_rms:.4f}",
        f"{row.refit_y_rms:.4f}",
        f"{row.within_two} ({row.within_two_robust})",
        "-" if row is baseline else f"{row.moved_median:.2f}",
        "-" if row is baseline else f"{row.moved_rms:.3g}",
        most,
    )


def movement_sentences(movements: Movements) -> list[str]:
    """What each kind of assumption does, and what none explains."""
    singles = movements.of_kind("single")
    sentences = [_start(movements.baseline)]
    if singles:
        sentences += [_level(movements, singles), _refits(singles), _coefficients(singles)]
    sentences += [_combination(row, movements.baseline) for row in movements.of_kind("combination")]
    return [*sentences, _closing(movements)]


def _start(row: Movement) -> str:
    return (
        f"Under the reference job's own assumptions published luminance is "
        f"{row.luminance_ratio:.2f} times the simulated one over the dome and "
        f"{row.zenith_luminance_ratio:.2f} times at the zenith; the logarithm of the ratio is "
        f"{row.luminance_log_rms:.2f} rms, its pattern {row.luminance_pattern_rms:.2f}."
    )


def _level(movements: Movements, singles: tuple[Movement, ...]) -> str:
    start = movements.baseline.luminance_log_rms
    ordered = sorted(singles, key=lambda row: row.luminance_log_rms)
    best, worst = ordered[0], ordered[-1]
    closer = (
        f"“{best.label}” brings the published luminance closest (rms of the log ratio from "
        f"{start:.2f} to {best.luminance_log_rms:.2f})"
        if best.luminance_log_rms < start
        else "none brings the published luminance closer"
    )
    farther = (
        f"“{worst.label}” takes it farthest away ({worst.luminance_log_rms:.2f})"
        if worst.luminance_log_rms > start
        else "none takes it farther away"
    )
    still = sum(abs(row.luminance_log_rms - start) < SMALL for row in singles)
    return (
        f"Of {len(singles)} assumptions changed one at a time, {closer}; {farther}; {still} change "
        f"it by less than {SMALL}."
    )


def _refits(singles: tuple[Movement, ...]) -> str:
    ordered = sorted(singles, key=lambda row: row.refit_luminance_rms)
    best, worst = ordered[0], ordered[-1]
    return (
        f"A refit under each of them leaves between {100 * best.refit_luminance_rms:.0f} % rms in "
        f"luminance (“{best.label}”) and {100 * worst.refit_luminance_rms:.0f} % "
        f"(“{worst.label}”)."
    )


def _coefficients(singles: tuple[Movement, ...]) -> str:
    still = sum(row.moved_median < 1 for row in singles)
    ordered = sorted(singles, key=lambda row: row.moved_median)
    most = ordered[-1]
    return (
        f"{still} of the {len(singles)} move half of the regenerated coefficients by less than one "
        f"robust standard error; “{most.label}” moves them most (median {most.moved_median:.1f}, "
        f"at most {abs(most.largest_move):.0f} in {most.largest_mover})."
    )


def _combination(row: Movement, baseline: Movement) -> str:
    change = row.luminance_log_rms - baseline.luminance_log_rms
    way = "closer to" if change < 0 else "farther from"
    return (
        f"Combined, {row.label}: {way} the published model; its luminance is then "
        f"{row.luminance_ratio:.2f} times the simulated one (zenith "
        f"{row.zenith_luminance_ratio:.2f}), the log ratio {row.luminance_log_rms:.2f} rms, the "
        f"pattern {row.luminance_pattern_rms:.2f}, x and y off by {row.x_mean:+.4f} and "
        f"{row.y_mean:+.4f}, and {row.within_two_robust} coefficients come within two robust "
        "standard errors."
    )


# What may be explained, and when an assumption is said to do so.
_ASPECTS: tuple[tuple[str, Callable[[Movement], bool]], ...] = (
    (
        "the mean level of luminance",
        lambda row: (
            max(abs(row.luminance_ratio - 1), abs(row.zenith_luminance_ratio - 1))
            <= LUMINANCE_CLOSE
        ),
    ),
    (
        "luminance sky by sky and direction by direction",
        lambda row: row.luminance_log_rms <= LUMINANCE_CLOSE,
    ),
    ("the pattern over the dome", lambda row: row.luminance_pattern_rms <= LUMINANCE_CLOSE),
    (
        "mean chromaticity",
        lambda row: max(abs(row.x_mean), abs(row.y_mean)) <= CHROMATICITY_CLOSE,
    ),
)


def _closing(movements: Movements) -> str:
    explained, open_ = [], []
    for name, reached in _ASPECTS:
        labels = [f"“{row.label}”" for row in movements.rows if reached(row)]
        if labels:
            explained.append(f"{name} is reached by {', '.join(labels)}")
        else:
            open_.append(name)
    start = movements.baseline.luminance_log_rms
    singles = movements.of_kind("single")
    parts = []
    if singles:
        mover = max(singles, key=lambda row: abs(row.luminance_log_rms - start))
        parts.append(
            f"The largest mover of the published luminance is “{mover.label}” (rms of the log "
            f"ratio {mover.luminance_log_rms - start:+.2f})"
        )
    parts += explained
    parts.append(f"no assumption explains {', nor '.join(open_)}" if open_ else "nothing is left")
    return "; ".join(parts) + (
        f". Reached means within {100 * LUMINANCE_CLOSE:.0f} % in luminance and "
        f"{CHROMATICITY_CLOSE} in x and y."
    )
