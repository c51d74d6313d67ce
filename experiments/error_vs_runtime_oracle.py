"""Skies and directions to measure errors in, and the oracles' values there, kept in a cache.

An oracle's value is computed once and kept under runs/; its file's name holds a hash of the sky,
the directions and the oracles' source: a changed oracle is never mistaken for an old one.
"""

import dataclasses
import functools
import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import atmofit as af
from atmofit.files import replace_file

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import oracles
from oracles.backward_monte_carlo import sky_radiance_monte_carlo
from oracles.nested_quadrature import sky_radiance
from oracles.paper_air import paper_constituents

Reals = NDArray[np.float64]

VIEWS_DEG = ((0, 0), (15, 60), (45, 0), (45, 180), (70, 90), (80, 0), (85, 30), (89, 0), (89, 180))
SUNS_DEG, TURBIDITIES = (0.0, 60.0, 85.0), (2.0, 6.0)
WAVELENGTH_NM = np.array(af.RefitSettings().wavelength_nm)
CACHE = Path("runs/oracle")
SEED = 20

MONTE_CARLO_INDEX = 17  # 550 nm


@dataclasses.dataclass(frozen=True)
class Sky:
    """One clear sky of the 1999 paper's air and directions in it."""

    turbidity: float
    sun_deg: float
    views_deg: tuple[tuple[float, float], ...] = VIEWS_DEG
    geometry: str = "spherical"

    @property
    def directions(self) -> af.Directions:
        """The directions [rad]."""
        return af.Directions(*np.radians(np.array(self.views_deg, float)).T)


def reference_skies(geometry: str = "spherical") -> tuple[Sky, ...]:
    """Sun 0, 60, 85 degrees x turbidity 2, 6; nine directions each."""
    return tuple(
        Sky(turbidity, sun_deg, geometry=geometry)
        for turbidity in TURBIDITIES
        for sun_deg in SUNS_DEG
    )


def random_skies(count: int = 30) -> tuple[Sky, ...]:
    """Turbidity 1 to 8, sun 0 to 88 degrees as a Latin hypercube, and the four corners of that box.

    Each has five directions: three anywhere down to 89 degrees, and where errors are largest: one
    between 80 and 89 degrees and one close to the sun.
    """
    rng = np.random.default_rng(SEED)
    unit = (
        np.stack([rng.permutation(count), rng.permutation(count)]) + rng.random((2, count))
    ) / count
    corners = np.array([[0, 0, 1, 1], [0, 1, 0, 1]])
    turbidity, sun_deg = np.concatenate([unit, corners], axis=1) * [[7.0], [88.0]] + [[1.0], [0.0]]
    return tuple(
        Sky(T, sun, _random_views(sun, rng))
        for T, sun in zip(turbidity.round(3).tolist(), sun_deg.round(3).tolist(), strict=True)
    )


def _random_views(sun_deg: float, rng: np.random.Generator) -> tuple[tuple[float, float], ...]:
    """Zenith and azimuth [degree] of random directions, the last about 4 degrees from the sun."""
    away, around = rng.uniform(2, 6), rng.uniform(0, np.pi)
    zenith = min(abs(sun_deg + away * np.cos(around)), 89.0)
    across = away * np.sin(around) / max(np.sin(np.radians(zenith)), 0.1)
    near_sun = (zenith, min(across, 180.0))
    low = (rng.uniform(80, 89), rng.uniform(0, 180))
    anywhere = np.stack([rng.uniform(0, 89, 3), rng.uniform(0, 180, 3)], axis=1)
    views = np.array([*anywhere, low, near_sun]).round(3).tolist()
    return tuple((zenith, azimuth) for zenith, azimuth in views)


def quadrature(sky: Sky, resolution: float, fresh: bool = False) -> tuple[Reals, float]:
    """Orders 1 and 2 by nested quadrature.

    Args:
        sky: Where.
        resolution: Of the quadrature; 1 is good to 4e-5 for suns to 85 degrees.
        fresh: Compute it again, to measure its cost.

    Returns:
        Radiance over solar irradiance [order, view, wavelength], and the seconds that a direction
        took when it was computed.
    """
    file = _file("quadrature", sky, resolution)
    if fresh or not file.exists():
        constituents = paper_constituents(sky.turbidity, WAVELENGTH_NM)
        begin = time.perf_counter()
        values = [
            sky_radiance(
                constituents,
                *np.radians([sky.sun_deg, *view]),
                orders=2,
                geometry=sky.geometry,
                resolution=resolution,
            )
            for view in sky.views_deg
        ]
        seconds = (time.perf_counter() - begin) / len(values)
        _store(file, radiance=np.stack(values, axis=1), seconds=seconds)
    with np.load(file) as stored:
        return stored["radiance"], float(stored["seconds"])


def monte_carlo(sky: Sky, paths: int) -> tuple[Reals, Reals, float]:
    """Orders 1 and 2 together at 550 nm by backward Monte Carlo.

    Args:
        sky: Where.
        paths: How many for each direction.

    Returns:
        Radiance over solar irradiance [view], its standard error [view], and the seconds that a
        direction took when it was computed.
    """
    file = _file("monte_carlo", sky, paths)
    if not file.exists():
        constituents = paper_constituents(sky.turbidity, WAVELENGTH_NM)
        begin = time.perf_counter()
        found = [
            sky_radiance_monte_carlo(
                constituents,
                *np.radians([sky.sun_deg, *view]),
                orders=2,
                geometry=sky.geometry,
                paths=paths,
                seed=seed,
                wavelength_index=MONTE_CARLO_INDEX,
            )
            for seed, view in enumerate(sky.views_deg)
        ]
        seconds = (time.perf_counter() - begin) / len(found)
        # The errors of the two orders stem from the same paths: added, they are an upper bound.
        mean, error = (np.array([each[i].sum() for each in found]) for i in (0, 1))
        _store(file, mean=mean, error=error, seconds=seconds)
    with np.load(file) as stored:
        return stored["mean"], stored["error"], float(stored["seconds"])


def luminance(radiance: Reals) -> Reals:
    """Luminance [cd m^-2] of radiance over solar irradiance [..., wavelength]."""
    sun = np.asarray(af.solar_irradiance_spectrum("preetham1999")(WAVELENGTH_NM), float)
    return np.asarray(af.spectrum_to_xyY(radiance * sun, WAVELENGTH_NM), float)[..., 2]


@functools.cache
def _source_hash() -> str:
    """Hash of everything an oracle's value depends on beside its arguments."""
    names = ("__init__", "nested_quadrature", "ray_integrals", "slant_columns", "paper_air")
    names += ("backward_monte_carlo",)
    folder = Path(oracles.__file__).parent
    text = b"".join((folder / f"{name}.py").read_bytes() for name in names)
    return hashlib.sha256(text + WAVELENGTH_NM.tobytes()).hexdigest()


def _file(kind: str, sky: Sky, effort: float) -> Path:
    key = json.dumps([kind, dataclasses.asdict(sky), effort, _source_hash()])
    return CACHE / f"{kind}_{hashlib.sha256(key.encode()).hexdigest()[:16]}.npz"


def _store(file: Path, **arrays: Any) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)

    def write(path: Path) -> None:
        with path.open("wb") as handle:
            np.savez(handle, **arrays)

    replace_file(file, write)
