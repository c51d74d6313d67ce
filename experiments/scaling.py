"""How does the work on many skies scale with the number of devices?

Strong scaling: the same rows on 1, 2, 4 and 8 devices. Weak scaling: as many rows on each device.
Each number of devices has a process of its own. On a CPU the devices are shares of one processor:
more of them than it has cores cannot be faster, and one program may use all cores already.
"""

import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.scale.works import Work

HEAD = [
    "work", "scaling", "devices", "rows", "compile and first [s]", "hot [s]", "CPU [s]",
    "rows per second", "efficiency",
]  # fmt: skip
SUNS_DEG = (10.0, 30.0, 50.0, 65.0, 75.0, 85.0)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    devices: tuple[int, ...] = (1, 2, 4, 8)
    """Each in a process of its own."""
    airs: int = 16
    """Of simulated skies in strong scaling, six suns each; a multiple of the most devices."""
    series: int = 1024
    """Of skies whose turbidity is estimated, likewise."""
    orders: int = 2
    """Of the simulation."""
    repeats: int = 3
    """Hot calls; the fastest is reported."""
    out: Path = Path("runs/scaling")
    picture: Path = Path("docs/scaling.png")
    child: int = 0
    """Set by the experiment itself: measure on so many devices, and print what was found."""


def main(config: Config) -> None:
    """Measure in processes of their own; print and write the table and the picture."""
    if config.child:
        print(json.dumps(measure(config)))
        return
    found: list[dict[str, Any]] = []
    for count in config.devices:
        options = [*sys.argv[1:], "--child", str(count)]
        run = subprocess.run(
            [sys.executable, __file__, *options], stdout=subprocess.PIPE, text=True, check=True
        )
        found += json.loads(run.stdout.splitlines()[-1])
    for one in found:
        first = next(
            other for other in found if all(other[k] == one[k] for k in ("work", "scaling"))
        )
        rate = (one["rows"] / one["hot"]) / (first["rows"] / first["hot"])
        one["efficiency"] = rate * first["devices"] / one["devices"]
    rows = [
        [
            one["work"], one["scaling"], str(one["devices"]), str(one["rows"]),
            f"{one['first']:.1f}", f"{one['hot']:.3f}", f"{one['cpu']:.3f}",
            f"{one['rows'] / one['hot']:.1f}",
            f"{one['efficiency']:.0%}",
        ]
        for one in found
    ]  # fmt: skip
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    words = (
        f"\n\n{cores} cores: more devices than cores share them, so that rows per second cannot "
        f"grow beyond {cores} devices and the efficiency falls as 1 / devices from there; nor can "
        "they grow at all where one device keeps all cores busy already, or other jobs do. CPU is "
        "the time of all cores: where it stays, more devices cost nothing. A row "
        f"of skies is an air under {len(SUNS_DEG)} suns in 343 directions, {config.orders} "
        "orders; a row of the series one turbidity from a dome of 343 luminances."
    )
    text = markdown(HEAD, rows) + words
    print(text)
    write_run(config.out, config, {"measured": found, "cores": cores}, text)
    draw(found, config.picture, int(cores or 1))


def measure(config: Config) -> list[dict[str, Any]]:
    """Both works, both kinds of scaling, on one number of devices."""
    mesh = af.device_mesh(config.child)
    jax.config.update("jax_enable_x64", True)
    most, found = max(config.devices), []
    for name, work, total in (
        ("skies", sky_work(config), config.airs),
        ("turbidities", series_work(config), config.series),
    ):
        compute, first = af.over_devices(work.compute, mesh, work.group), 0.0
        for scaling, rows in (("strong", total), ("weak", total * config.child // most)):
            inputs = work.inputs(0, rows)
            seconds = [timed(compute, inputs) for _ in range(1 + config.repeats)]
            first = first or seconds[0][0]  # the program of the second scaling is the same
            found.append(
                {
                    "work": name,
                    "scaling": scaling,
                    "devices": config.child,
                    "rows": rows,
                    "first": first,
                    "hot": min(wall for wall, _ in seconds[1:]),
                    "cpu": min(cpu for _, cpu in seconds[1:]),
                }
            )
    return found


def timed(compute: Any, inputs: Any) -> tuple[float, float]:
    """Seconds of a call by the clock, and of all cores together.

    It returns NumPy arrays, so it is done when it returns.
    """
    begin, used = time.perf_counter(), time.process_time()
    compute(inputs)
    return time.perf_counter() - begin, time.process_time() - used


def sky_work(config: Config) -> Work:
    """Simulated skies, an air for each turbidity."""
    turbidity = tuple(np.geomspace(1.2, 10.0, config.airs).tolist())
    sky = af.TrainingSettings(turbidity, SUNS_DEG, (0.2,), (450.0,), rtol=5e-2)
    plan = af.plan_sky(
        sky.atmosphere(jax.numpy.asarray(2.0), jax.numpy.asarray(0.2)),
        solar_zenith_angle=np.radians([0.0, 90.0]),
        orders=config.orders,
        rtol=5e-2,
        all_wavelengths=True,
        dtype="float32",
    )
    return af.SkyWork(sky, plan=plan)


def series_work(config: Config) -> Work:
    """Domes of the published model with noise, turbidity from 2 to 6."""
    rng, dome = np.random.default_rng(0), af.dome_343()
    observations = []
    for T, sun in zip(
        np.linspace(2.0, 6.0, config.series),
        np.radians(np.resize(SUNS_DEG[:5], config.series)),
        strict=True,
    ):
        Y = np.asarray(af.PREETHAM_1999(T, sun, dome)[..., 2])
        noisy = Y * np.exp(0.05 * rng.standard_normal(Y.shape))
        observations.append(af.Observation(dome, noisy, sun, 0.05))
    return af.SeriesWork(observations)


def draw(found: list[dict[str, Any]], path: Path, cores: int) -> None:
    """Rows per second, and processor time per row, over devices."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.4), layout="constrained")
    *rates, cost = figure.subplots(1, 3)
    devices = sorted({one["devices"] for one in found})
    # cividis is even in lightness and the same to colour-blind eyes.
    colours = dict(zip(("strong", "weak"), colormaps["cividis"]([0.1, 0.75]), strict=True))
    for panel, name in zip(rates, ("skies", "turbidities"), strict=True):
        for scaling, colour in colours.items():
            some = [one for one in found if (one["work"], one["scaling"]) == (name, scaling)]
            rate = [one["rows"] / one["hot"] for one in some]
            panel.semilogx(devices, rate, "o-", color=colour, label=f"{scaling} scaling")
            free = max(
                cores * some[0]["hot"] / some[0]["cpu"], 1.0
            )  # cores over those of one device
            ideal = [rate[0] * min(n, free) for n in devices]
            panel.semilogx(
                devices, ideal, ":", color=colour, label=f"{scaling}, {cores} cores full"
            )
            per_row = np.array([one["cpu"] / one["rows"] for one in some])
            mark = "o-" if name == "skies" else "s--"
            cost.semilogx(
                devices, per_row / per_row[0], mark, color=colour, label=f"{name}, {scaling}"
            )
        panel.set(title=name, ylabel="rows per second [1/s]")
    cost.set(title="processor time", ylabel="CPU time per row / one device [-]")
    for panel in (*rates, cost):
        panel.set(xlabel="devices", ylim=(0, None))
        panel.set_xticks(devices, [str(n) for n in devices])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    for panel in (rates[0], cost):
        panel.legend(fontsize=8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(tyro.cli(Config))
