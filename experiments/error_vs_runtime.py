"""How does the error of a sky fall with its run time, and which node count limits it?

Every count is varied around one rung of the ladder on the reference job. Errors are those of
luminance and chromaticity over the dome under sun 0, 60, 85 degrees and turbidity 2, 6, against a
finer solution of the same code, which both oracles confirm in the same run. With --store the rungs
of the ladder go to atmofit/sky/ladder.json with what was measured of them. Finished cases are kept.
With --peers another question instead: do nanodisort and sasktran2 take longer for the same error?
"""

import dataclasses
import datetime
import json
import os
from pathlib import Path
from typing import Any

import jax
import tyro
from error_vs_runtime_case import FINE, Case
from error_vs_runtime_errors import Results, confirmation, errors, rung
from error_vs_runtime_oracle import VIEWS_DEG, random_skies, reference_skies
from error_vs_runtime_peers import Measure, compare
from error_vs_runtime_report import Row, draw_pareto, table

from atmofit.files import replace_file
from atmofit.fit.dataset import versions
from atmofit.sky import ladder

# Around the base rung: mostly fewer, one that is more.
COUNTS = {
    "polar": (8, 12, 24),
    "limb": (3, 12),
    "azimuth": (16, 20, 36),
    "bend": (2, 6),
    "degrees": (12, 16, 28),
    "view": (20, 32),
    "view_second": (10, 14),
    "path": (10, 14, 28),
    "altitude": (12, 16, 26),
    "sun": (20, 28, 56),
    "wavelength": (5, 7, 9, 16, 0),
}
QUICK_FAMILIES = ("ladder", "degrees")


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    base: float = 2e-3
    """Rung around which counts are varied."""
    families: tuple[str, ...] = ()
    """Which to run: ladder, dtype, geometry, orders or a count's name; none: all."""
    quick: bool = False
    """Few cases around rtol 1e-2 and coarse oracles, to see that everything works."""
    random: bool = False
    """Also measure the ladder in random skies."""
    store: bool = False
    """Write the ladder with its measurement into the package; needs the ladder's cases."""
    fresh: bool = False
    """Compute finished cases again."""
    repeats: int = 3
    """Hot calls; the median is reported."""
    resolution: float = 1.2
    """Of the nested quadrature in the reference skies; 0.8 is good to 3e-4, 1.2 to 4e-5."""
    random_resolution: float = 1.0
    """Of the nested quadrature in the random skies."""
    paths: int = 100_000
    """Of the Monte Carlo oracle, for each direction."""
    peers: bool = False
    """Compare with nanodisort and sasktran2 (extra `reference`) instead; into `out`/peers."""
    gpu: bool = False
    """With peers: run atmofit on a graphics processor too, if there is one."""
    skies: int = 0
    """With peers: about how many of the 60; 0: all, or 4 if quick."""
    threads: int = 2
    """With peers: processors that each code uses."""
    out: Path = Path("runs/error_vs_runtime")


def main(config: Config) -> None:
    """Run the cases, each in its own process; then table, picture, JSON and perhaps the ladder."""
    if config.peers:
        _compare_with_peers(config)
        return
    if config.quick:
        config = dataclasses.replace(
            config, base=1e-2, families=QUICK_FAMILIES, repeats=1, resolution=0.6, paths=20_000
        )
    config.out.mkdir(parents=True, exist_ok=True)
    fine = ladder.LADDER[min(ladder.LADDER)] if config.quick else FINE
    results = Results(config.out, config.repeats, config.fresh, fine)
    cases = all_cases(config)
    rows = []
    for number, case in enumerate(cases, 1):
        found = results.of(case, "job")
        rows.append(Row(case, found, *errors(found["xyY"], results.exact(case))))
        print(f"[{number}/{len(cases)}] {rows[-1].line}", flush=True)
    confirmed = [
        confirmation(results, *solution, config.resolution, config.paths)
        for solution in results.solutions
    ]
    random = config.random_resolution if config.random or config.store else None
    rungs = [
        rung(results, case, config.resolution, random) for case in cases if case.family == "ladder"
    ]
    text = table(rows, rungs, confirmed, results.older)
    print(text)
    stored = {
        "config": dataclasses.asdict(config) | {"out": str(config.out)},
        **_circumstances(),
        "confirmed": confirmed,
        "cases": [row.as_dict() for row in rows],
        "ladder": rungs,
    }
    _write(config.out / "table.md", text)
    _write(config.out / "result.json", json.dumps(stored, indent=1) + "\n")
    replace_file(config.out / "pareto.png", lambda path: draw_pareto(rows, path))
    if config.store:
        store(rungs, config)


def _compare_with_peers(config: Config) -> None:
    skies = config.skies or (4 if config.quick else 60)
    repeats = 1 if config.quick else config.repeats
    compare(
        Measure(
            skies,
            config.quick,
            config.gpu,
            config.threads,
            repeats,
            config.fresh,
            config.out / "peers",
        )
    )


def all_cases(config: Config) -> list[Case]:
    """The rungs of the ladder, then every count varied around the base rung."""
    base = ladder.LADDER[config.base]
    rungs = (5e-2, 1e-2) if config.quick else tuple(ladder.LADDER)
    cases = [
        Case("ladder", f"{rtol:g}", ladder.LADDER[rtol], dtype)
        for dtype in ("float32", "float64")
        for rtol in rungs
    ]
    for name, counts in COUNTS.items():
        own = getattr(base, name)
        for count in counts:
            if count != own:
                nodes = dataclasses.replace(base, **{name: count})
                cases.append(Case(name, "all" if count == 0 else str(count), nodes))
    cases += [
        Case("dtype", "float64", base, dtype="float64"),
        Case("geometry", "flat", base, geometry="flat"),
        Case("geometry", "paper", base, geometry="paper"),
        Case("orders", "1", base, orders=1),
    ]
    return [case for case in cases if not config.families or case.family in config.families]


def store(rungs: list[dict[str, Any]], config: Config) -> None:
    """Write the ladder with its measurement into the package."""
    measured = {(each["rtol"], each["dtype"]): dict(each) for each in rungs}
    missing = [
        (rtol, dtype)
        for rtol in ladder.LADDER
        for dtype in ("float32", "float64")
        if (rtol, dtype) not in measured
    ]
    if missing:
        raise ValueError(f"families must hold the whole ladder to store it, missing {missing}")
    stored = {
        "errors": "relative, of luminance, two orders, against nested quadrature (tests/oracles) "
        f"at resolution {config.resolution} in {len(reference_skies()) * len(VIEWS_DEG)} reference "
        f"and {config.random_resolution} in "
        f"{sum(len(sky.views_deg) for sky in random_skies())} random directions",
        "seconds": "12 suns x 5 turbidities x 343 directions x 41 wavelengths",
        **_circumstances(),
        "rungs": [
            {
                "rtol": rtol,
                "nodes": dataclasses.asdict(nodes),
                "measured": {
                    dtype: {
                        field.name: measured[rtol, dtype][field.name]
                        for field in dataclasses.fields(ladder.Measured)
                    }
                    for dtype in ("float32", "float64")
                },
            }
            for rtol, nodes in ladder.LADDER.items()
        ],
    }
    file = Path(ladder.__file__).with_name("ladder.json")
    _write(file, json.dumps(stored, indent=1) + "\n")


def _circumstances() -> dict[str, Any]:
    return {
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "versions": versions(),
        "processors": os.cpu_count(),
    }


def _write(file: Path, text: str) -> None:
    def write(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    replace_file(file, write)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
