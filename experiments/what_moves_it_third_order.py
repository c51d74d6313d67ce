"""How much does the third order of scattering add? Sampled by brute force, then made smooth.

A backward Monte Carlo that shares no code with the simulator (tests/oracles) gives the ratio of
orders 1 + 2 + 3 to orders 1 + 2 in sampled skies; a polynomial of its logarithm carries it to
every direction, sun, turbidity and wavelength. The samples are kept in a file and taken up again.
"""

import dataclasses
import itertools
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.backward_monte_carlo import sky_radiance_monte_carlo
from oracles.paper_air import paper_constituents

from atmofit.render.image import save_bytes

_FLOOR = 1e-4  # of a log ratio
_MODEL_ERROR = 0.05  # of ratio - 1, beside the samples' own errors
_PULL = 1e-2
_HELD_BEYOND_NM = (400.0, 680.0)


@dataclasses.dataclass(frozen=True)
class Sampling:
    """All the samples depend on; saved beside them."""

    turbidity: tuple[float, ...] = (2.0, 4.0, 6.0)
    sun_deg: tuple[float, ...] = (0.0, 40.0, 64.0, 80.0, 87.0)
    wavelength_nm: tuple[float, ...] = (440.0, 540.0, 640.0)
    directions: int = 8
    """Of each sky and wavelength: the zenith, the others from a Sobol sequence to 89 degrees."""
    batches: int = 8
    """Independent runs, whose scatter gives the standard error."""
    paths: int = 5000
    """Of each batch."""
    seed: int = 0


def sample(sampling: Sampling, path: Path) -> np.ndarray:
    """Take the samples, or those that the file holds already.

    Args:
        sampling: What to take.
        path: JSON, replaced after each sky so that a run can be taken up again.

    Returns:
        [sample, 7]: turbidity, sun, view zenith angle, relative azimuth [rad], wavelength [nm],
        log of the ratio of orders 1 to 3 to orders 1 and 2, and its standard error.
    """
    wanted = dataclasses.asdict(sampling)
    rows, seconds = _stored(path, wanted)
    cells = list(
        itertools.product(sampling.turbidity, np.radians(sampling.sun_deg), sampling.wavelength_nm)
    )
    places = _directions(sampling, len(cells))
    for index in range(len(rows) // sampling.directions, len(cells)):
        turbidity, sun, wavelength = cells[index]
        begin = time.perf_counter()
        air = paper_constituents(turbidity, np.array([wavelength]))
        for number, (view, azimuth) in enumerate(places[index]):
            ratios = [
                _log_ratio(air, sun, view, azimuth, sampling, (index, number, batch))
                for batch in range(sampling.batches)
            ]
            error = np.std(ratios, ddof=1) / np.sqrt(sampling.batches)
            known = (turbidity, sun, view, azimuth, wavelength, np.mean(ratios), error)
            rows.append([float(value) for value in known])
        seconds += time.perf_counter() - begin
        _store(path, wanted, rows, seconds)
    return np.array(rows)


def _directions(sampling: Sampling, cells: int) -> np.ndarray:
    """View zenith angle and relative azimuth [rad], [cell, direction, 2]; the zenith first."""
    from scipy.stats import qmc  # takes seconds

    # SciPy 1.15 renamed the seed and still takes the old name.
    sequence = qmc.Sobol(2, seed=sampling.seed)  # pyright: ignore[reportCallIssue]
    drawn = sequence.random(4096)[: cells * (sampling.directions - 1)]
    drawn = drawn.reshape(cells, sampling.directions - 1, 2)
    # Evenly in angle between overhead and 89 degrees: denser toward the horizon than in cosine.
    places = drawn * np.radians([89.0, 180.0])
    return np.concatenate([np.zeros((cells, 1, 2)), places], axis=1)


def _log_ratio(air, sun, view, azimuth, sampling: Sampling, key: tuple[int, ...]) -> float:
    seed = int(np.random.SeedSequence([sampling.seed, *key]).generate_state(1)[0])
    orders, _ = sky_radiance_monte_carlo(
        air, sun, view, azimuth, orders=3, paths=sampling.paths, seed=seed
    )
    return float(np.log(orders.sum() / orders[:2].sum()))


def _stored(path: Path, wanted: dict[str, object]) -> tuple[list[list[float]], float]:
    """Samples of the same settings in the file, and the seconds they took."""
    if not path.exists():
        return [], 0.0
    stored = json.loads(path.read_text(encoding="utf-8"))
    if stored["sampling"] != json.loads(json.dumps(wanted)):
        return [], 0.0
    return stored["samples"], stored["seconds"]


def _store(path: Path, wanted: dict[str, object], rows: list[list[float]], seconds: float) -> None:
    columns = (
        "turbidity, sun [rad], view zenith angle [rad], relative azimuth [rad], wavelength [nm], "
        "log of orders 1 + 2 + 3 over orders 1 + 2, its standard error"
    )
    stored = {"sampling": wanted, "columns": columns, "seconds": seconds, "samples": rows}
    save_bytes((json.dumps(stored) + "\n").encode(), path)


@dataclasses.dataclass(frozen=True)
class ThirdOrder:
    """A polynomial of the logarithm of what the third order adds, ratio - 1.

    Attributes:
        degree: Total degree.
        coefficients: One for each monomial.
        error: Root mean square error of the log ratio of samples that were left out of the fit,
            ten parts in turn; the samples' own noise is in it.
        median_error: Median size of these errors.
        largest_error: The largest.
        noise: Root mean square standard error of the samples.
        largest_ratio: Sampled.
    """

    degree: int
    coefficients: np.ndarray
    error: float
    median_error: float
    largest_error: float
    noise: float
    largest_ratio: float

    def ratio(self, turbidity, sun, view, azimuth, wavelength_nm) -> np.ndarray:
        """Orders 1 to 3 over orders 1 and 2; the arguments broadcast, angles in rad."""
        variables = np.broadcast_arrays(turbidity, sun, view, azimuth, wavelength_nm)
        flat = np.stack([np.ravel(v) for v in variables], axis=-1)
        added = np.exp(_features(flat, self.degree) @ self.coefficients)
        return (1 + added).reshape(variables[0].shape)


def smooth(samples: np.ndarray) -> ThirdOrder:
    """Fit polynomials of total degree 1 to 4 and keep the one that foretells samples best."""
    log_ratio, errors = samples[:, 5], samples[:, 6]
    # The logarithm of next to nothing is noise: such samples get a floor and little weight.
    known = np.maximum(log_ratio, _FLOOR)
    added = np.log(np.expm1(known))
    weight = 1 / np.hypot(errors / known, _MODEL_ERROR)
    part = np.random.default_rng(0).permutation(len(added)) % 10
    tried = []
    for degree in (1, 2, 3, 4):
        design = _features(samples[:, :5], degree)
        left_out = np.empty_like(added)
        for fold in range(10):
            there = part == fold
            fitted = _solve(design[~there], added[~there], weight[~there])
            left_out[there] = design[there] @ fitted
        missed = np.log1p(np.exp(left_out)) - log_ratio
        tried.append((float(np.sqrt(np.mean(missed**2))), degree, np.abs(missed)))
    error, degree, missed = min(tried, key=lambda one: one[0])
    return ThirdOrder(
        degree=degree,
        coefficients=_solve(_features(samples[:, :5], degree), added, weight),
        error=error,
        median_error=float(np.median(missed)),
        largest_error=float(missed.max()),
        noise=float(np.sqrt(np.mean(errors**2))),
        largest_ratio=float(np.exp(log_ratio.max())),
    )


def _solve(design: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    # A weak pull to 0 keeps monomials that few samples tell apart from running away.
    size = design.shape[1]
    pull = _PULL * np.eye(size) * np.median(weight)
    pull[0, 0] = 0.0
    matrix = np.concatenate([design * weight[:, None], pull])
    return np.linalg.lstsq(matrix, np.append(values * weight, np.zeros(size)), rcond=None)[0]


def _features(samples: np.ndarray, degree: int) -> np.ndarray:
    """Monomials in five variables that are about -1 to 1 over the samples."""
    turbidity, sun, view, azimuth, wavelength = samples[:, :5].T
    cosine = np.cos(sun) * np.cos(view) + np.sin(sun) * np.sin(view) * np.cos(azimuth)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    # Held beyond the wavelengths near those sampled, where little luminance lies.
    λ = np.clip(wavelength, *_HELD_BEYOND_NM)
    variables = np.stack(
        [
            np.log(turbidity - 1) / np.log(5) * 2 - 1,  # T 2 to 6
            _along(sun),
            _along(view),
            2 * angle / np.pi - 1,
            np.log(λ / 530) / 0.19,
        ],
        axis=-1,
    )
    columns = [np.ones(len(samples))]
    for total in range(1, degree + 1):
        for powers in itertools.combinations_with_replacement(range(5), total):
            columns.append(np.prod(variables[:, powers], axis=1))
    return np.stack(columns, axis=-1)


def _along(zenith_angle: np.ndarray) -> np.ndarray:
    """Logarithm of a path length that stays finite at the horizon, -1 overhead and 1 there."""
    top, bottom = np.log(1 / 0.1), np.log(1 / 1.1)
    return 2 * (np.log(1 / (np.cos(zenith_angle) + 0.1)) - bottom) / (top - bottom) - 1


if __name__ == "__main__":
    os.nice(10)
    target = Path("runs/what_moves_it/third_order.json")
    target.parent.mkdir(parents=True, exist_ok=True)
    found = smooth(sample(Sampling(), target))
    print(
        f"degree {found.degree}, error of samples left out {found.error:.4f} rms, "
        f"{found.median_error:.4f} median, {found.largest_error:.3f} largest; noise "
        f"{found.noise:.4f}; largest ratio {found.largest_ratio:.3f}"
    )
