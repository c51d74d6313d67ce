"""Errors of the compared codes, and who is how much faster at the same error."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from peers_case import Case
from peers_scene import Scene

TOLERANCE = 1e-2  # of the comparison: largest error to sun 80, view 85
INNER_SUN, INNER_VIEW = np.radians([80.5, 85.5])  # beyond, a flat or a coarse code errs most
FLAT, SINGLE, ROUND = "flat_all_orders", "round_single", "round_all_orders"
# Whose finest settings are the reference of all; without one, each code's own are.
REFERENCE = {FLAT: "nanodisort", SINGLE: "sasktran2"}


@dataclasses.dataclass(frozen=True)
class Measured:
    """A case, its radiance where it is judged, and what it cost."""

    case: Case
    radiance: np.ndarray
    cost: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Row:
    """A case with its cost, and its errors, of which the finest settings may have none."""

    case: Case
    cost: dict[str, Any]
    error: dict[str, float] | None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        names = {"series": self.case.series, "label": self.case.label}
        return {**dataclasses.asdict(self.case), **names, **self.cost, "error": self.error}


@dataclasses.dataclass(frozen=True)
class Contest:
    """Who is compared with whom.

    Attributes:
        group: The problem.
        peer: A series.
        own: A series of atmofit.
        aim: How many times as many skies a second we want, if anything.
    """

    group: str
    peer: str
    own: str
    aim: float | None


EVERY, NODES = "atmofit, every wavelength", "atmofit, wavelength nodes"
CONTESTS = (
    Contest(FLAT, "nanodisort", EVERY, 15),
    Contest(FLAT, "nanodisort", NODES, 50),
    Contest(ROUND, "sasktran2", EVERY, 8),
    Contest(ROUND, "sasktran2", NODES, 25),
    Contest(SINGLE, "sasktran2", EVERY, 10),
    Contest(SINGLE, "sasktran2", NODES, 10),
)


def judge(measured: Sequence[Measured], exam: Scene) -> list[Row]:
    """Errors of all cases against the finest of their group, or of their group and code."""
    finest = _finest(measured)
    rows = []
    for each in measured:
        case = each.case
        reference = finest[case.group, REFERENCE.get(case.group, case.code)]
        is_reference = each.radiance is reference
        error = None if is_reference else differences(each.radiance, reference, exam)
        rows.append(Row(case, each.cost, error))
    return rows


def finest_differences(measured: Sequence[Measured], exam: Scene) -> dict[str, dict[str, float]]:
    """How far atmofit's finest radiance is from the other code's, by group where both are."""
    finest = _finest(measured)
    return {
        group: differences(finest[group, "atmofit"], radiance, exam)
        for (group, code), radiance in finest.items()
        if code != "atmofit" and (group, "atmofit") in finest
    }


def _finest(measured: Sequence[Measured]) -> dict[tuple[str, str], np.ndarray]:
    """Radiance of the finest case, by group and code."""
    return {
        (each.case.group, each.case.code): each.radiance for each in measured if each.case.finest
    }


def differences(radiance: np.ndarray, finest: np.ndarray, scene: Scene) -> dict[str, float]:
    """Relative differences over all directions, skies and wavelengths.

    Args:
        radiance: [sun, load, ring, azimuth, wavelength].
        finest: Likewise.
        scene: Of both.

    Returns:
        Largest and root mean square down to sun 80 and view 85 degrees, and over everything.
    """
    error = np.abs(radiance / finest - 1)
    suns = scene.solar_zenith_angle < INNER_SUN
    inner = error[suns][:, :, scene.view_zenith_angle < INNER_VIEW]
    return {
        "inner_largest": float(inner.max()),
        "inner_rms": float(np.sqrt(np.mean(inner**2))),
        "largest": float(error.max()),
        "rms": float(np.sqrt(np.mean(error**2))),
    }


def cheapest(rows: Sequence[Row], group: str, series: str, tolerance: float) -> Row | None:
    """The fastest settings of a series whose error is small enough, or None."""
    fit = [
        row
        for row in rows
        if (row.case.group, row.case.series) == (group, series)
        and row.error is not None
        and row.error["inner_largest"] <= tolerance
    ]
    return min(fit, key=lambda row: row.cost["seconds_per_sky"], default=None)


def headline(rows: Sequence[Row], contest: Contest) -> dict[str, Any]:
    """Skies per second of two codes at the tolerance, and their ratio where both reach it."""
    found: dict[str, Any] = dataclasses.asdict(contest)
    speeds = []
    for side in ("own", "peer"):
        row = cheapest(rows, contest.group, found[side], TOLERANCE)
        if row is not None:
            speeds.append(1 / row.cost["seconds_per_sky"])
            found[f"{side}_settings"] = row.case.label
            found[f"{side}_skies_per_second"] = speeds[-1]
            found[f"{side}_error"] = row.error
    found["ratio"] = speeds[0] / speeds[1] if len(speeds) == 2 else None
    return found


def on_gpu(contest: Contest) -> Contest:
    """The same with atmofit on a graphics processor, for which nothing is aimed at."""
    return dataclasses.replace(contest, own=f"{contest.own}, GPU", aim=None)
