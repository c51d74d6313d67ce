"""How long do other codes take for the reference skies, and what do their settings cost them?

Errors are differences from the same code's finest settings, so they say nothing of what the codes
leave out: nanodisort is flat, sasktran2 round, its higher orders from flat columns. What each is
worth against independent radiances is in tests/reference/test_peers.py. Finished cases are kept.
"""

import dataclasses
import json
import os
import statistics
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from peers_scene import Scene, Skies, few_skies, reference_batch
from run_files import markdown, write_run

from atmofit.files import output_folder, replace_file

INNER_SUN, INNER_VIEW = np.radians([80.5, 85.5])  # beyond, a flat or a coarse code errs most
HEADER = [
    "code",
    "settings",
    "s a sky",
    "largest difference",
    "to sun 80, view 85",
    "rms",
    "load",
]


@dataclasses.dataclass(frozen=True)
class Case:
    """A code at some settings.

    Attributes:
        code: "nanodisort" or "sasktran2".
        group: Cases that solve the same problem and are compared with one another.
        settings: Arguments of the code's function.
    """

    code: str
    group: str
    settings: dict[str, Any]

    @property
    def name(self) -> str:
        """Of its file."""
        return "_".join([self.group, *(f"{k}_{v}" for k, v in self.settings.items())])

    def skies(self, scene: Scene, threads: int) -> Skies:
        """Compute the scene. The package is imported here, so that one may do without the other.

        Raises:
            ImportError: The package is absent.
        """
        if self.code == "nanodisort":
            from peers_nanodisort import nanodisort_sky

            return nanodisort_sky(scene, threads=threads, **self.settings)
        from peers_sasktran2 import sasktran2_sky

        return sasktran2_sky(scene, threads=threads, **self.settings)


def _flat(streams: int, layers: int) -> Case:
    return Case("nanodisort", "flat_all_orders", {"streams": streams, "layers": layers})


def _single(layers: int) -> Case:
    return Case("sasktran2", "round_single", {"mode": "single", "layers": layers})


def _round(streams: int, layers: int, sun_angles: int = 1) -> Case:
    settings = {"streams": streams, "layers": layers, "sun_angles": sun_angles}
    return Case("sasktran2", "round_all_orders", {"mode": "discrete_ordinates", **settings})


# The finest of each group comes first: the others are compared with it.
CASES = (
    *(_flat(*one) for one in ((48, 60), (32, 60), (32, 30), (16, 60), (16, 30), (16, 15), (8, 30))),
    *(_single(layers) for layers in (320, 160, 80, 40, 20)),
    _round(32, 80, 3),
    *(_round(16, *one) for one in ((80, 3), (80, 1), (40, 1), (20, 1))),
    _round(8, 40),
)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    skies: int = 60
    """About how many of the 60 skies; the finest settings take up to half a minute a sky."""
    groups: tuple[str, ...] = ()
    """Which to run: flat_all_orders, round_single, round_all_orders; none: all."""
    threads: int = 2
    """At work at once."""
    repeats: int = 1
    """Runs of each but the finest case; the median time is reported."""
    fresh: bool = False
    """Compute finished cases again."""
    out: Path = Path("runs/peers")


def main(config: Config) -> None:
    """Run the cases, finest first; print and write the table."""
    if unknown := set(config.groups) - {case.group for case in CASES}:
        raise SystemExit(f"groups must be of {sorted({c.group for c in CASES})}, got {unknown}")
    scene = few_skies(reference_batch(), config.skies)
    folder = cases_folder(config, scene)
    finest: dict[str, Case] = {}
    results = []
    for case in CASES:
        if config.groups and case.group not in config.groups:
            continue
        best = finest.setdefault(case.group, case)
        results.append(_result(case, best, scene, folder, config))
        print(_line(results[-1]), flush=True)
    table = markdown(HEADER, [_row(result) for result in results])
    print(table)
    stored = {"skies": scene.sky_count, "shape": scene.shape, "cases": results}
    write_run(config.out, config, stored, table)


def cases_folder(config: Config, scene: Scene) -> Path:
    """Where cases of this scene are kept: other skies or thread counts never mix."""
    suns, loads = scene.shape[:2]
    folder = config.out / f"cases_{suns}_suns_{loads}_loads_{config.threads}_threads"
    output_folder(folder)
    return folder


def _result(case: Case, best: Case, scene: Scene, folder: Path, config: Config) -> dict[str, Any]:
    """Figures of a case, read if it is finished; the finest leaves its radiance too."""
    path, fine = folder / f"{case.name}.json", folder / f"{best.name}.npy"
    if path.is_file() and fine.is_file() and not config.fresh:
        return json.loads(path.read_text(encoding="utf-8"))
    load = os.getloadavg()[0]
    count = 1 if case is best else config.repeats
    runs = [case.skies(scene, config.threads) for _ in range(count)]
    if case is best:
        _replace(fine, lambda file: np.save(file, runs[0].radiance))
    result = {
        "code": case.code,
        "version": version(case.code),
        "group": case.group,
        "settings": case.settings,
        "seconds_per_sky": statistics.median(run.seconds_per_sky for run in runs),
        "load_average_before": round(load, 2),
        **differences(runs[0].radiance, np.load(fine), scene),
    }
    text = json.dumps(result, indent=1) + "\n"
    _replace(path, lambda file: file.write_text(text, encoding="utf-8"))
    return result


def differences(radiance: np.ndarray, finest: np.ndarray, scene: Scene) -> dict[str, float]:
    """Relative differences over all directions, skies and wavelengths.

    Args:
        radiance: [sun, load, ring, azimuth, wavelength].
        finest: Likewise.
        scene: Of both.

    Returns:
        The largest; the largest down to sun 80 and view 85 degrees; the root of the mean square.
    """
    error = np.abs(radiance / finest - 1)
    suns = scene.solar_zenith_angle < INNER_SUN
    inner = error[suns][:, :, scene.view_zenith_angle < INNER_VIEW]
    return {
        "largest": float(error.max()),
        "largest_to_sun_80_view_85": float(inner.max()),
        "rms": float(np.sqrt(np.mean(error**2))),
    }


def _row(result: dict[str, Any]) -> list[str]:
    settings = ", ".join(f"{name} {value}" for name, value in result["settings"].items())
    return [
        f"{result['code']} {result['version']}",
        settings,
        f"{result['seconds_per_sky']:.3f}",
        f"{result['largest']:.1e}",
        f"{result['largest_to_sun_80_view_85']:.1e}",
        f"{result['rms']:.1e}",
        f"{result['load_average_before']:.1f}",
    ]


def _line(result: dict[str, Any]) -> str:
    return "  ".join(_row(result))


def _replace(path: Path, write: Callable[[Path], Any]) -> None:
    replace_file(path, lambda temporary: write(temporary))


if __name__ == "__main__":
    main(tyro.cli(Config))
