"""Does the published model come back? Its coefficients scored against regenerated ones."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from atmofit.fit.distribution import DistributionFit
from atmofit.fit.parameters import NAMES
from atmofit.fit.refit import RefitResult
from atmofit.fit.zenith import ZenithFit
from atmofit.models.preetham import PREETHAM_1999, PreethamModel

DISTRIBUTIONS = {"Y": "luminance_distribution", "x": "x_distribution", "y": "y_distribution"}
ZENITHS = {"Y": "zenith_luminance", "x": "zenith_x", "y": "zenith_y"}
PARTS = ("slope", "intercept")
LUMINANCE_CELLS = ("a", "b", "c", "d")
CHROMATICITY_CELLS = tuple(
    f"{T}{s}".strip() or "1" for T in ("T²", "T", "") for s in ("s³", "s²", "s", "")
)
CLOSE = 2.0  # standard errors


def distribution(model: PreethamModel, quantity: str) -> np.ndarray:
    """Perez coefficients of one of Y, x and y, [A..E, (slope, intercept)]."""
    return np.asarray(getattr(model, DISTRIBUTIONS[quantity]))


def zenith(model: PreethamModel, quantity: str) -> np.ndarray:
    """Zenith coefficients of one of Y [kcd m^-2], x and y, as a list of 4 or 12."""
    return np.asarray(getattr(model, ZENITHS[quantity])).ravel()


@dataclasses.dataclass(frozen=True)
class CoefficientScores:
    """Published coefficients against regenerated ones; every array is [coefficient].

    Attributes:
        group: "Y", "x", "y" (over the dome), "zenith Y", "zenith x", "zenith y".
        term: Inside the group, such as "A slope".
        published, regenerated: Y at the zenith in kcd m^-2.
        standard_error: Of the regenerated one, residuals taken as independent.
        robust_standard_error: Likewise, each sky taken as one cluster.
    """

    group: tuple[str, ...]
    term: tuple[str, ...]
    published: np.ndarray
    regenerated: np.ndarray
    standard_error: np.ndarray
    robust_standard_error: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """(Published - regenerated) / standard error."""
        return in_errors(self.published - self.regenerated, self.standard_error)

    @property
    def robust_z(self) -> np.ndarray:
        """(Published - regenerated) / robust standard error."""
        return in_errors(self.published - self.regenerated, self.robust_standard_error)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups in order, each once."""
        return tuple(dict.fromkeys(self.group))

    def of_group(self, *groups: str) -> "CoefficientScores":
        """The coefficients of some groups."""
        chosen = [index for index, group in enumerate(self.group) if group in groups]
        return CoefficientScores(
            group=tuple(self.group[i] for i in chosen),
            term=tuple(self.term[i] for i in chosen),
            published=self.published[chosen],
            regenerated=self.regenerated[chosen],
            standard_error=self.standard_error[chosen],
            robust_standard_error=self.robust_standard_error[chosen],
        )

    def summary(self) -> dict[str, int | float]:
        """Counts of |z| below 2 and medians of |z|, with either error; how many within 10 %."""
        size, robust = np.abs(self.z), np.abs(self.robust_z)
        difference = np.abs(self.published - self.regenerated)
        return {
            "count": size.size,
            "within_two": int((size < CLOSE).sum()),
            "within_two_robust": int((robust < CLOSE).sum()),
            "median_z": float(np.median(size)),
            "median_robust_z": float(np.median(robust)),
            "within_tenth": int((difference <= 0.1 * np.abs(self.regenerated)).sum()),
        }

    def to_dict(self) -> dict[str, dict[str, dict[str, float | None]]]:
        """Every number by group and term; None where it is not finite."""
        out: dict[str, dict[str, dict[str, float | None]]] = {group: {} for group in self.groups}
        columns = {
            "published": self.published,
            "regenerated": self.regenerated,
            "standard_error": self.standard_error,
            "robust_standard_error": self.robust_standard_error,
            "z": self.z,
            "robust_z": self.robust_z,
        }
        for i, (group, term) in enumerate(zip(self.group, self.term, strict=True)):
            out[group][term] = {name: _finite(values[i]) for name, values in columns.items()}
        return out


def coefficient_scores(
    distributions: Mapping[str, DistributionFit],
    zeniths: Mapping[str, ZenithFit],
    published: PreethamModel = PREETHAM_1999,
) -> CoefficientScores:
    """Score a published model's coefficients against fits.

    Args:
        distributions: Joint fits of "Y", "x" and "y".
        zeniths: Fits of the zenith values of "Y", "x" and "y".
        published: What is scored.
    """
    group, term, columns = [], [], []
    for q in DISTRIBUTIONS:
        terms = [f"{name} {part}" for name in NAMES for part in PARTS]
        fit = distributions[q]
        known = (distribution(published, q), fit.matrix)
        columns.append([*known, fit.standard_error, fit.robust_standard_error])
        group, term = group + [q] * len(terms), term + terms
    for q in ZENITHS:
        terms = list(LUMINANCE_CELLS if q == "Y" else CHROMATICITY_CELLS)
        fit = zeniths[q]
        known = (zenith(published, q), fit.coefficients)
        columns.append([*known, fit.standard_error, fit.robust_standard_error])
        group, term = group + [f"zenith {q}"] * len(terms), term + terms
    arrays = (
        np.concatenate([np.ravel(np.asarray(value, float)) for value in column])
        for column in zip(*columns, strict=True)
    )
    return CoefficientScores(tuple(group), tuple(term), *arrays)


def scores_of(result: RefitResult) -> CoefficientScores:
    """Score the 1999 coefficients against a refit."""
    return coefficient_scores(result.distributions, result.zeniths)


def to_dict(result: RefitResult) -> dict[str, Any]:
    """The verdict as JSON: scores of the coefficients, and both models by turbidity and sun."""
    scores = scores_of(result)
    groups = {group: scores.of_group(group).summary() for group in scores.groups}
    return {
        "coefficients": scores.to_dict(),
        "coefficients_summary": {"all": scores.summary(), **groups},
        "predictions": {one.name: one.tables() for one in result.comparisons},
    }


def in_errors(difference: np.ndarray, error: np.ndarray) -> np.ndarray:
    """A difference over its error; 0 where it is 0, infinite where only the error is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0, 0.0, difference / error)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
