"""How far do rays run between spheres, and what do Blinn's and Esposito's exponentials say?

Spheres are dropped into a periodic box at random: freely (they may overlap) or one by one where
there is room (they may not). Rays along an axis start at random points outside all spheres; the
share still free after a way s is compared with exp(-n pi p^2 s), and with that of the number
density n / (1 - D). Writes result.json, table.md and prints the table.
"""

import dataclasses
import math
from pathlib import Path

import numpy as np
import tyro
from run_files import markdown, write_run

DEPTHS = (0.1, 0.5, 1.0, 2.0)  # n pi p^2 s


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    volume_fractions: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.2, 0.3)
    width: float = 30.0
    """Of the box, across the rays, in radii; along them it is at least that."""
    rays: int = 4000
    """In each box."""
    boxes: int = 16
    seed: int = 1
    out: Path = Path("runs/particle_shadows")


def main(config: Config) -> None:
    """Measure, print and write."""
    random = np.random.default_rng(config.seed)
    rows, results = [], []
    for fraction in config.volume_fractions:
        for overlap in (True, False):
            mean, error = shares(random, config, fraction, overlap)
            for depth, found, sigma in zip(DEPTHS, mean, error, strict=True):
                poisson, dense = math.exp(-depth), math.exp(-depth / (1 - fraction))
                results.append(
                    {
                        "volume_fraction": fraction,
                        "overlapping": overlap,
                        "optical_depth": depth,
                        "free": found,
                        "standard_error": sigma,
                        "poisson": poisson,
                        "dense": dense,
                    }
                )
                rows.append(
                    [
                        f"{fraction:g}",
                        "yes" if overlap else "no",
                        f"{depth:g}",
                        f"{found:.4f} +- {sigma:.4f}",
                        f"{poisson:.4f} ({poisson / found - 1:+.1%})",
                        f"{dense:.4f} ({dense / found - 1:+.1%})",
                    ]
                )
    head = ["D", "overlap", "n pi p^2 s", "free", "exp(-nV)", "exp(-nV/(1-D))"]
    text = markdown(head, rows)
    print(text)
    write_run(config.out, config, {"shares": results}, text + "\n")


def shares(
    random: np.random.Generator, config: Config, fraction: float, overlap: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Mean share of free rays at every depth, and its standard error from box to box."""
    number_density = fraction * 3 / (4 * math.pi)  # in units of the radius
    ways = np.asarray(DEPTHS) / (number_density * math.pi)
    box = np.array([config.width, config.width, max(config.width, 1.2 * ways[-1])])
    count = round(number_density * box.prod())
    each = []
    for _ in range(config.boxes):
        centres = random.uniform(size=(count, 3)) * box if overlap else packed(random, count, box)
        free = free_ways(random, centres, box, config.rays)
        each.append((free[:, None] > ways).mean(axis=0))
    return np.mean(each, axis=0), np.std(each, axis=0, ddof=1) / math.sqrt(config.boxes)


def packed(random: np.random.Generator, count: int, box: np.ndarray) -> np.ndarray:
    """Centres of unit spheres in a periodic box, each dropped where it touches none before it."""
    centres = np.empty((count, 3))
    placed = 0
    while placed < count:
        tries = random.uniform(size=(64, 3)) * box
        clear = (_squares(tries[:, None] - centres[:placed], box) > 4).all(axis=1)
        first = placed
        for candidate in tries[clear]:
            if placed < count and (_squares(candidate - centres[first:placed], box) > 4).all():
                centres[placed] = candidate
                placed += 1
    return centres


def free_ways(
    random: np.random.Generator, centres: np.ndarray, box: np.ndarray, rays: int
) -> np.ndarray:
    """Ways along the third axis from points outside unit spheres to the first one, or infinity."""
    found: list[np.ndarray] = []
    while sum(map(len, found)) < rays:
        starts = random.uniform(size=(max(rays // 4, 1), 3)) * box
        apart = _wrapped(centres - starts[:, None], box)
        across = 1 - apart[..., 0] ** 2 - apart[..., 1] ** 2
        half = np.sqrt(np.maximum(across, 0.0))
        hit = across > 0
        outside = ~np.any(hit & (np.abs(apart[..., 2]) < half), axis=1)
        ahead = np.where(hit, apart[..., 2] % box[2] - half, np.inf)
        found.append(ahead.min(axis=1)[outside])
    return np.concatenate(found)[:rays]


def _wrapped(apart: np.ndarray, box: np.ndarray) -> np.ndarray:
    return apart - box * np.round(apart / box)


def _squares(apart: np.ndarray, box: np.ndarray) -> np.ndarray:
    return np.sum(_wrapped(apart, box) ** 2, axis=-1)


if __name__ == "__main__":
    main(tyro.cli(Config))
