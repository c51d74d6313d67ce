"""What moves the verdict: each assumption changed in turn, and what that does.

It was measured once, for the reference job, by `experiments/what_moves_it.py`; the table is kept
with the package.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

import numpy as np

from atmofit.fit.comparison import compare
from atmofit.fit.distribution import DistributionFit
from atmofit.fit.refit import fitted_model
from atmofit.fit.skies import SimulatedSkies
from atmofit.fit.verdict import CoefficientScores, coefficient_scores, in_errors
from atmofit.fit.zenith import ZenithFit
from atmofit.models.preetham import PREETHAM_1999

MOVEMENTS = "what_moves_it.json"
BASELINE = "baseline"
KINDS = (BASELINE, "single", "combination")


@dataclasses.dataclass(frozen=True)
class Movement:
    """What a changed assumption does to the skies and to the refit.

    Attributes:
        key: Short name.
        label: In words.
        kind: "baseline", "single" (one assumption changed) or "combination".
        luminance_ratio: Mean over the dome of published / simulated.
        zenith_luminance_ratio: At the zenith.
        x_mean, y_mean: Mean of published - simulated.
        luminance_log_rms: Root mean square of log(published / simulated Y).
        luminance_pattern_rms: Of the published pattern, each sky's mean ratio divided out.
        refit_luminance_rms: Of regenerated / simulated - 1, refitted under the assumption.
        refit_pattern_rms, refit_x_rms, refit_y_rms: Likewise.
        within_two, within_two_robust: Published coefficients within two standard errors.
        moved_rms: Root mean square change of the regenerated coefficients, in units of the
            baseline's robust standard errors.
        moved_median: Median of its size.
        moved_by_group: Its median for each group of `CoefficientScores`.
        largest_mover: Name of the coefficient that moves most, empty if none does.
        largest_move: Its change in robust standard errors.
        converged: Whether all joint fits did.
    """

    key: str
    label: str
    kind: str
    luminance_ratio: float
    zenith_luminance_ratio: float
    x_mean: float
    y_mean: float
    luminance_log_rms: float
    luminance_pattern_rms: float
    refit_luminance_rms: float
    refit_pattern_rms: float
    refit_x_rms: float
    refit_y_rms: float
    within_two: int
    within_two_robust: int
    moved_rms: float
    moved_median: float
    moved_by_group: dict[str, float]
    largest_mover: str
    largest_move: float
    converged: bool


def movement(
    key: str,
    label: str,
    kind: str,
    skies: SimulatedSkies,
    distributions: Mapping[str, DistributionFit],
    zeniths: Mapping[str, ZenithFit],
    *,
    baseline: CoefficientScores,
    weight: np.ndarray | None = None,
) -> Movement:
    """Measure what an assumption does.

    Args:
        key: Short name.
        label: In words.
        kind: One of `KINDS`.
        skies: Simulated under the assumption.
        distributions: Joint fits under the assumption.
        zeniths: Zenith fits likewise.
        baseline: Scores of the fits from which coefficients move.
        weight: Of each direction in the comparisons, as in `compare`.
    """
    model = fitted_model(distributions, zeniths, skies.settings.turbidity)
    published = compare(PREETHAM_1999, skies, "published", weight).summary()
    own = compare(model, skies, "regenerated", weight).summary()
    scores = coefficient_scores(distributions, zeniths)
    move = in_errors(scores.regenerated - baseline.regenerated, baseline.robust_standard_error)
    group, largest = np.array(scores.group), int(np.argmax(np.abs(move)))
    count = scores.summary()
    shown = (
        "luminance_ratio", "zenith_luminance_ratio", "x_mean", "y_mean", "luminance_log_rms",
        "luminance_pattern_rms",
    )  # fmt: skip
    return Movement(
        key=key,
        label=label,
        kind=kind,
        **{name: published[name] for name in shown},
        refit_luminance_rms=own["luminance_rms"],
        refit_pattern_rms=own["luminance_pattern_rms"],
        refit_x_rms=own["x_rms"],
        refit_y_rms=own["y_rms"],
        within_two=int(count["within_two"]),
        within_two_robust=int(count["within_two_robust"]),
        moved_rms=float(np.sqrt(np.mean(move**2))),
        moved_median=float(np.median(np.abs(move))),
        moved_by_group={
            name: float(np.median(np.abs(move[group == name]))) for name in scores.groups
        },
        largest_mover=f"{scores.group[largest]}: {scores.term[largest]}" if move.any() else "",
        largest_move=float(move[largest]),
        converged=all(bool(fit.converged) for fit in distributions.values()),
    )


@dataclasses.dataclass(frozen=True)
class Movements:
    """What was measured by `experiments/what_moves_it.py`.

    Attributes:
        provenance: Command, date, versions, settings.
        third_order: How well the third order is known.
        rows: The baseline first.
    """

    provenance: dict[str, Any]
    third_order: dict[str, Any]
    rows: tuple[Movement, ...]

    @property
    def baseline(self) -> Movement:
        """From which the others move."""
        return self.rows[0]

    def of_kind(self, kind: str) -> tuple[Movement, ...]:
        """The rows of one kind."""
        return tuple(row for row in self.rows if row.kind == kind)


def stored_movements() -> Movements:
    """Read the table that is kept with the package.

    Raises:
        ValueError: It is damaged.
    """
    text = resources.files("atmofit.tables").joinpath(MOVEMENTS).read_text(encoding="utf-8")
    return parse_movements(text)


def parse_movements(text: str) -> Movements:
    """Read and check the table.

    Args:
        text: JSON, as `movements_to_json` writes it.

    Raises:
        ValueError: A field is missing or of another type, a number is not finite, or the first
            row is not the baseline.
    """
    try:
        stored = json.loads(text)
        rows = tuple(Movement(**row) for row in stored["rows"])
        found = Movements(dict(stored["provenance"]), dict(stored["third_order"]), rows)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{MOVEMENTS} must be a table of movements, got {error!r}") from error
    for row in rows:
        _check(row)
    kinds = [row.kind for row in rows]
    if kinds[:1] != [BASELINE] or kinds.count(BASELINE) > 1:
        raise ValueError(f"{MOVEMENTS} must hold one baseline, first, got kinds {kinds}")
    if len({row.key for row in rows}) < len(rows):
        raise ValueError(f"{MOVEMENTS} must name each row once, got {[row.key for row in rows]}")
    return found


def movements_to_json(movements: Movements) -> str:
    """The table as JSON, one line a row."""
    rows = [json.dumps(dataclasses.asdict(row), ensure_ascii=False) for row in movements.rows]
    head = [
        f'"{name}": {json.dumps(getattr(movements, name), ensure_ascii=False)}'
        for name in ("provenance", "third_order")
    ]
    return "{" + ",\n".join([*head, '"rows": [\n' + ",\n".join(rows) + "\n]"]) + "}\n"


def _check(row: Movement) -> None:
    """Refuse a row whose values are not of the declared types, or not finite."""
    where = f"{MOVEMENTS}, row {row.key!r}:"
    if row.kind not in KINDS:
        raise ValueError(f"{where} kind must be one of {KINDS}, got {row.kind!r}")
    types: dict[Any, tuple[type, ...]] = {float: (float, int), int: (int,)}
    for field in dataclasses.fields(row):
        value = getattr(row, field.name)
        wanted = types.get(field.type, (bool, str, dict))
        numbers = value.values() if isinstance(value, dict) else [value]
        finite = all(math.isfinite(n) for n in numbers if isinstance(n, (float, int)))
        if not isinstance(value, wanted) or not finite:
            raise ValueError(f"{where} {field.name} must be a finite {field.type}, got {value!r}")
