"""Results of cases, kept in a folder, and their errors against fine solutions and oracles."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from error_vs_runtime_case import FINE, Case, run_apart, source_hash
from error_vs_runtime_oracle import (
    MONTE_CARLO_INDEX,
    SUNS_DEG,
    TURBIDITIES,
    VIEWS_DEG,
    WAVELENGTH_NM,
    Reals,
    luminance,
    monte_carlo,
    quadrature,
    random_skies,
    reference_skies,
)

import atmofit as af
from atmofit.files import replace_file
from atmofit.sky.ladder import Nodes

_FLAT_BELOW = np.radians(70.0)  # views and suns that the "paper" geometry takes as flat
# Of `VIEWS_DEG`, for Monte Carlo, which is slow.
_MONTE_CARLO_VIEWS = (2, 4, 6)


class Results:
    """Results of cases, computed where they are not in the folder yet.

    Attributes:
        older: How many were kept from other versions of the simulator's source.
        solutions: Geometry and orders of the fine solutions that were needed.
    """

    def __init__(
        self, folder: Path, repeats: int = 3, fresh: bool = False, fine: Nodes = FINE
    ) -> None:
        """Nothing is computed yet; `fresh`: what lies in the folder is not used."""
        self._folder, self._repeats, self._fresh, self._fine = folder, repeats, fresh, fine
        self._done: dict[tuple[str, str], dict[str, Any]] = {}
        self.older = 0
        self.solutions: list[tuple[str, int]] = []

    def of(self, case: Case, task: str) -> dict[str, Any]:
        """What the task gives for a case."""
        key = (case.key, task)
        if key not in self._done:
            file = self._folder / f"{task}_{case.key}.npz"
            if self._fresh or not file.exists():
                replace_file(file, lambda new: run_apart(case, task, new, self._repeats))
            with np.load(file) as stored:
                found = {name: stored[name] for name in stored.files}
            self.older += str(found["source"]) != source_hash()
            self._done[key] = found
        return self._done[key]

    def fine(self, geometry: str, orders: int) -> Reals:
        """Fine radiance over solar irradiance [turbidity, sun, direction, wavelength]."""
        if geometry == "paper":
            flat, spherical = self.fine("flat", orders), self.fine("spherical", orders)
            view = np.asarray(af.dome_343().view_zenith_angle)
            low = (np.radians(SUNS_DEG)[:, None] < _FLAT_BELOW) & (view < _FLAT_BELOW)
            return np.where(low[None, :, :, None], flat, spherical)
        if (geometry, orders) not in self.solutions:
            self.solutions.append((geometry, orders))
        case = Case("fine", geometry, self._fine, "float64", geometry, orders)
        return self.of(case, "fine")["radiance"]

    def exact(self, case: Case) -> Reals:
        """Fine x, y and Y for the case's geometry and orders."""
        sun = np.asarray(af.solar_irradiance_spectrum("preetham1999")(WAVELENGTH_NM), float)
        radiance = self.fine(case.geometry, case.orders) * sun
        return np.asarray(af.spectrum_to_xyY(radiance, WAVELENGTH_NM), float)


def errors(found: Reals, exact: Reals) -> tuple[float, float, float, float, str]:
    """Largest and rms relative error of Y, largest of x and y, and where Y's is largest."""
    relative = found[..., 2] / exact[..., 2] - 1
    colour = np.abs(found - exact)[..., :2].reshape(-1, 2).max(axis=0)
    at = np.unravel_index(np.abs(relative).argmax(), relative.shape)
    zenith, azimuth = (np.degrees(float(a[at[2]])) for a in af.dome_343().angles())
    where = f"T {TURBIDITIES[at[0]]:g}, sun {SUNS_DEG[at[1]]:g}, view {zenith:.0f}, {azimuth:.0f}"
    return (
        float(np.abs(relative).max()),
        float((relative**2).mean() ** 0.5),
        float(colour[0]),
        float(colour[1]),
        where,
    )


def confirmation(
    results: Results, geometry: str, orders: int, resolution: float, paths: int
) -> dict[str, Any]:
    """How far the fine solution is from the two oracles, in sampled directions."""
    fine = results.fine(geometry, orders)
    fine = fine.reshape(-1, *fine.shape[2:])
    apart, score, difference = [], [], []
    for sky, radiance in zip(reference_skies(geometry), fine, strict=True):
        exact, _ = quadrature(sky, resolution)
        sampled = radiance[_sampled()]
        apart.append(luminance(sampled) / luminance(exact[:orders].sum(axis=0)) - 1)
        if orders == 2:
            views = tuple(VIEWS_DEG[i] for i in _MONTE_CARLO_VIEWS)
            few = dataclasses.replace(sky, views_deg=views)
            mean, error, _ = monte_carlo(few, paths)
            gap = sampled[list(_MONTE_CARLO_VIEWS), MONTE_CARLO_INDEX] - mean
            score.append(gap / error)
            difference.append(gap / mean)
    found = {
        "geometry": geometry,
        "orders": orders,
        "quadrature_largest": float(np.abs(apart).max()),
        "quadrature_rms": float(np.mean(np.square(apart)) ** 0.5),
    }
    if orders == 2:
        found |= {
            "monte_carlo_mean": float(np.mean(difference)),
            "monte_carlo_mean_error": float(np.std(difference) / np.sqrt(np.size(difference))),
            "monte_carlo_largest_score": float(np.abs(score).max()),
        }
    return found


def rung(
    results: Results, case: Case, resolution: float, random_resolution: float | None = None
) -> dict[str, Any]:
    """One rung: its cost, and its errors against nested quadrature itself.

    Args:
        results: Where its results are.
        case: Its label is the rung.
        resolution: Of the quadrature in the reference skies.
        random_resolution: Likewise in the random skies; None: those are left out.
    """
    job = results.of(case, "job")
    luminances = job["xyY"][..., 2].reshape(-1, 343)[:, _sampled()]
    exact = [luminance(quadrature(sky, resolution)[0].sum(axis=0)) for sky in reference_skies()]
    found: dict[str, Any] = {
        "rtol": float(case.label),
        "dtype": case.dtype,
        **_error_of("reference", luminances / np.array(exact) - 1),
    }
    if random_resolution is not None:
        exact = [
            luminance(quadrature(sky, random_resolution)[0].sum(axis=0)) for sky in random_skies()
        ]
        values = results.of(case, "random")["luminance"]
        found |= _error_of("random", values / np.array(exact) - 1)
    return found | {
        "compile_seconds": round(float(job["compile"]), 2),
        "first_seconds": round(float(job["first"]), 3),
        "hot_seconds": round(float(job["hot"]), 3),
        "peak_megabytes": round(float(job["peak_MB"])),
    }


def _sampled() -> list[int]:
    """Where the oracle's directions lie in the dome."""
    zenith, azimuth = (np.degrees(np.asarray(a)) for a in af.dome_343().angles())
    return [int(np.hypot(zenith - view[0], azimuth - view[1]).argmin()) for view in VIEWS_DEG]


def _error_of(name: str, relative: Reals) -> dict[str, float]:
    """Largest and rms, to three digits."""
    largest, rms = np.abs(relative).max(), np.mean(np.square(relative)) ** 0.5
    return {f"{name}_largest": float(f"{largest:.3g}"), f"{name}_rms": float(f"{rms:.3g}")}
