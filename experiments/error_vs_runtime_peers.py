"""Error against run time of nanodisort, sasktran2 and atmofit on the same skies, in one go.

12 suns x 5 haze loads, 342 directions, 41 wavelengths. Three problems, each with its own meaning
of error: a flat atmosphere with all orders (against nanodisort's finest settings), a round one with
single scattering (against sasktran2's), and a round one with all orders. There sasktran2 takes its
higher orders from flat columns, so that it is no exact reference: each code is held against its own
finest settings, and the difference of the two is stated. Errors are taken over a few skies and
wavelengths, the extremes among them, because the finest settings take up to half a minute a sky;
times over all. Finished cases are kept.
"""

import dataclasses
import datetime
import json
import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from peers_case import Case, Task, gpu_name, run_apart
from peers_judge import (
    CONTESTS,
    FLAT,
    ROUND,
    SINGLE,
    TOLERANCE,
    Measured,
    finest_differences,
    headline,
    judge,
    on_gpu,
)
from peers_report import draw, text
from peers_scene import few_skies, judged, reference_batch, some_skies
from run_files import write_run

from atmofit.files import output_folder, replace_file
from atmofit.sky.ladder import LADDER

PATIENCE = 20.0  # no further hot call once a case's took so long together [s]


@dataclasses.dataclass(frozen=True)
class Measure:
    """How the cases are measured.

    Attributes:
        skies: About how many of the 60.
        quick: A few coarse cases.
        gpu: Run atmofit's cases on a graphics processor too, if there is one.
        threads: Processors that are used.
        repeats: Hot calls; the median is reported.
        fresh: Compute finished cases again.
        out: Folder.
    """

    skies: int
    quick: bool
    gpu: bool
    threads: int
    repeats: int
    fresh: bool
    out: Path


def compare(measure: Measure) -> None:
    """Run the cases, each in its own process; then table, picture and JSON.

    Raises:
        SystemExit: A package is absent, or `skies` too small.
    """
    if absent := [name for name in ("nanodisort", "sasktran2") if find_spec(name) is None]:
        raise SystemExit(f"{' and '.join(absent)} must be installed: extra `reference`")
    if measure.skies < 2:
        raise SystemExit(f"skies must be at least 2, got {measure.skies}")
    batch = few_skies(reference_batch(), measure.skies)
    exam = some_skies(batch, *judged(batch))
    gpu = gpu_name() if measure.gpu else None
    if measure.gpu:
        print(f"GPU: {gpu}" if gpu else "No GPU: JAX sees none, so atmofit runs on the CPU alone.")
    cases = all_cases(measure.quick, gpu is not None)
    measured = []
    for number, case in enumerate(cases, 1):
        measured.append(_result(case, measure))
        seconds = measured[-1].cost["seconds_per_sky"]
        line = f"{case.group}, {case.series}, {case.label}: {seconds:.3g} s a sky"
        print(f"[{number}/{len(cases)}] {line}", flush=True)
    rows = judge(measured, exam)
    contests = [*CONTESTS, *(on_gpu(contest) for contest in CONTESTS if gpu)]
    headlines = [headline(rows, contest) for contest in contests]
    between = finest_differences(measured, exam)
    stored = {
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "gpu": gpu,
        "skies": batch.sky_count,
        "shape": batch.shape,
        "judged_suns_deg": np.degrees(exam.solar_zenith_angle).round(6).tolist(),
        "judged_skies": exam.sky_count,
        "judged_wavelengths": exam.wavelength_nm.size,
        "load_average_after": round(os.getloadavg()[0], 2),
        "finest_differences": between,
        "headlines": headlines,
        "cases": [row.as_dict() for row in rows],
    }
    table = text(stored, TOLERANCE, measure.threads)
    print(table)
    write_run(measure.out, measure, stored, table)
    replace_file(measure.out / "pareto_peers.png", lambda path: draw(stored, TOLERANCE, path))


# Streams and layers of nanodisort; layers of sasktran2 alone; its streams, layers and sun angles.
# The finest of each come first.
_FLAT = ((48, 60), (32, 30), (16, 30), (16, 15), (12, 15), (8, 15))
_SINGLE = (320, 160, 80, 60, 40, 20)
_ROUND = ((32, 160, 3), (16, 80, 3), (16, 80, 1), (16, 40, 1), (12, 60, 3), (8, 40, 1), (8, 20, 1))
_QUICK_FLAT = ((24, 30), (16, 15), (12, 15), (8, 8))
_QUICK_SINGLE = (160, 80, 40, 20)
_QUICK_ROUND = ((16, 80, 1), (16, 40, 1), (8, 20, 1))


def all_cases(quick: bool, gpu: bool) -> list[Case]:
    """The finest of each code and group before the others."""
    flat = [{"streams": n, "layers": m} for n, m in (_QUICK_FLAT if quick else _FLAT)]
    single = [{"mode": "single", "layers": n} for n in (_QUICK_SINGLE if quick else _SINGLE)]
    all_orders = [
        {"mode": "discrete_ordinates", "streams": n, "layers": m, "sun_angles": k}
        for n, m, k in (_QUICK_ROUND if quick else _ROUND)
    ]
    cases = [
        Case(code, group, settings, finest=settings is family[0])
        for code, group, family in (
            ("nanodisort", FLAT, flat),
            ("sasktran2", SINGLE, single),
            ("sasktran2", ROUND, all_orders),
        )
        for settings in family
    ]
    fine, rungs = (2e-3, [0.1, 5e-2]) if quick else _fine_and_others()
    cases += [_atmofit(group, fine, True, finest=True) for group in (SINGLE, ROUND)]
    cases += [
        _atmofit(group, rung, every, device=device)
        for device in (("cpu", "gpu") if gpu else ("cpu",))
        for group in (FLAT, SINGLE, ROUND)
        for every in (True, False)
        for rung in rungs
    ]
    return cases


def _fine_and_others() -> tuple[float, list[float]]:
    """The finest rung of the ladder, and the others, the coarsest first."""
    *others, fine = sorted(LADDER, reverse=True)
    return fine, others


def _atmofit(
    group: str, rung: float, every: bool, *, finest: bool = False, device: str = "cpu"
) -> Case:
    settings = {
        "rung": rung,
        "orders": 1 if group == SINGLE else "all",
        "geometry": "flat" if group == FLAT else "spherical",
        "every_wavelength": every,
        **({"dtype": "float64"} if finest else {}),
    }
    return Case("atmofit", group, settings, finest, device)


def _result(case: Case, measure: Measure) -> Measured:
    """The radiance that is judged and its cost, read if the case is finished."""
    folder = output_folder(measure.out / "cases")
    task = Task(case, measure.skies, measure.threads, measure.repeats, PATIENCE)
    file = folder / task.file_name
    if measure.fresh or not file.is_file():
        replace_file(file, lambda new: run_apart(task, new))
    with np.load(file) as stored:
        return Measured(case, stored["radiance"], json.loads(str(stored["facts"])))
