"""One code at some settings, run in a process of its own so that its cost is its own.

The parent names a case, the child computes the skies and returns radiance, time and memory.
"""

import dataclasses
import datetime
import hashlib
import json
import os
import resource
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from peers_scene import (
    Scene,
    Skies,
    few_skies,
    judged,
    median_seconds,
    reference_batch,
    some_skies,
)

_WHOLE = 3  # times the patience: a batch that takes longer is timed over the judged skies


@dataclasses.dataclass(frozen=True)
class Case:
    """A code at some settings.

    Attributes:
        code: "nanodisort", "sasktran2" or "atmofit".
        group: Cases that solve the same problem.
        settings: Arguments of the code's function.
        finest: Whether others are compared with it; it is run once, over what is judged alone.
        device: "cpu" or "gpu".
    """

    code: str
    group: str
    settings: dict[str, Any]
    finest: bool = False
    device: str = "cpu"

    @property
    def series(self) -> str:
        """What it is called beside other settings of the code."""
        if self.code != "atmofit":
            return self.code
        every = self.settings["every_wavelength"]
        where = ", GPU" if self.device == "gpu" else ""
        return f"atmofit, {'every wavelength' if every else 'wavelength nodes'}{where}"

    @property
    def label(self) -> str:
        """Its settings in words, without those that the group and the series imply."""
        implied = {"mode", "orders", "geometry", "every_wavelength"}
        return ", ".join(
            f"{name.replace('_', ' ')} {value}"
            for name, value in self.settings.items()
            if name not in implied
        )


@dataclasses.dataclass(frozen=True)
class Task:
    """A case and how it is measured.

    Attributes:
        case: What is computed.
        skies: About how many of the 60 of the reference batch.
        threads: Processors that are used.
        repeats: Hot calls, see `median_seconds`.
        patience: See there.
    """

    case: Case
    skies: int
    threads: int
    repeats: int
    patience: float

    @property
    def file_name(self) -> str:
        """Differs where anything does that the result depends on."""
        here = Path(__file__).parent
        sources = [here / f"peers_{name}.py" for name in (self.case.code, "scene", "case")]
        facts = json.dumps([dataclasses.asdict(self), code_version(self.case.code)])
        digest = hashlib.sha256(facts.encode() + b"".join(s.read_bytes() for s in sources))
        return f"{self.case.group}_{self.case.code}_{digest.hexdigest()[:16]}.npz"


def code_version(code: str) -> str:
    """Version of a package, of atmofit that of its source too."""
    if code != "atmofit":
        return version(code)
    from atmofit.provenance import source_digest

    return f"{version(code)} {source_digest()[:12]}"


def run_apart(task: Task, file: Path) -> None:
    """Measure a task in a process of its own, without the compilation cache, that writes a file.

    Args:
        task: What to measure.
        file: An .npz with the radiance that is judged, and the rest as JSON in `facts`.

    Raises:
        RuntimeError: The process failed.
    """
    surroundings = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    if task.case.device == "cpu":
        surroundings["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, __file__, json.dumps(dataclasses.asdict(task)), str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=surroundings)
    if done.returncode != 0:
        case = f"{task.case.group}, {task.case.series}, {task.case.label}"
        raise RuntimeError(f"{case} failed:\n{done.stderr[-2000:]}")


def gpu_name() -> str | None:
    """Of the first graphics processor that JAX sees, asked in a process of its own."""
    question = "import jax; print(jax.devices('gpu')[0].device_kind)"
    done = subprocess.run(
        [sys.executable, "-c", question], check=False, capture_output=True, text=True
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _measure(task: Task) -> tuple[np.ndarray, dict[str, Any]]:
    """The radiance that is judged, and what it cost."""
    load = os.getloadavg()[0]
    batch = few_skies(reference_batch(), task.skies)
    places = judged(batch)
    scene, chosen = batch, places
    if task.case.finest:
        scene = some_skies(batch, *places)
        chosen = tuple(list(range(len(each))) for each in places)
    elif _is_slow(task, batch):
        scene = some_skies(batch, *places[:2])
        chosen = (*(list(range(len(each))) for each in places[:2]), places[2])
    skies = _run(task, scene, 0 if task.case.finest else task.repeats)
    return skies.radiance[chosen[0]][:, chosen[1]][..., chosen[2]], {
        "seconds_per_sky": skies.seconds_per_sky,
        "compile_seconds": skies.compile_seconds,
        "peak_megabytes": _peak_megabytes(task.case.device),
        "skies_timed": scene.sky_count,
        "wavelengths_timed": scene.wavelength_nm.size,
        "load_average_before": round(load, 2),
        "date": datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds"),
        "version": code_version(task.case.code),
    }


def _is_slow(task: Task, batch: Scene) -> bool:
    """Whether the whole batch would take too long, by one sky, which also warms the code up."""
    if task.case.code == "atmofit":
        return False
    one = _run(task, few_skies(batch, 1), 0)
    return one.seconds_per_sky * batch.sky_count > _WHOLE * task.patience


def _run(task: Task, scene: Scene, repeats: int) -> Skies:
    """Some skies. The package is imported here, so that one may do without the others."""
    settings = task.case.settings
    if task.case.code == "atmofit":
        from peers_atmofit import atmofit_sky

        return atmofit_sky(scene, repeats=repeats, patience=task.patience, **settings)
    if task.case.code == "nanodisort":
        from peers_nanodisort import nanodisort_sky as sky
    else:
        from peers_sasktran2 import sasktran2_sky as sky
    found: list[Skies] = []
    seconds = median_seconds(
        lambda: found.append(sky(scene, threads=task.threads, **settings)), repeats, task.patience
    )
    return Skies(found[-1].radiance, seconds / scene.sky_count)


def _peak_megabytes(device: str) -> float:
    """Of the process, or of the graphics processor."""
    if device == "gpu":
        import jax

        return (jax.devices("gpu")[0].memory_stats() or {}).get("peak_bytes_in_use", 0) / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def _prepare(task: Task) -> None:
    """Confine the process to so many processors; tell JAX where to compute, and how exactly."""
    if task.case.device == "cpu" and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: task.threads])
    if task.case.code == "atmofit":
        import jax

        jax.config.update("jax_enable_x64", task.case.settings.get("dtype") == "float64")
        if task.case.device == "gpu":
            jax.config.update("jax_default_device", jax.devices("gpu")[0])


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    task = Task(**given | {"case": Case(**given["case"])})
    _prepare(task)
    radiance, facts = _measure(task)
    with Path(sys.argv[2]).open("wb") as handle:
        np.savez(handle, radiance=radiance, facts=json.dumps(facts))
