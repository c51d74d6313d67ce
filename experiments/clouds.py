"""Clouds after Nishita, Dobashi and Nakamae (1996): their pictures again, and what they cost.

Figure 7 (a cumulus under the sun at 65, 10 and 5 degrees), figure 8 (a cumulonimbus, far and near),
the three orders of 1996 beside all orders, seconds and memory against voxels, and the cost of a
picture's gradient. Writes clouds.png, single pictures, result.json and table.md.
"""

import dataclasses
import json
import math
import re
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.clouds.converged import converged_light
from atmofit.clouds.pattern_light import cloud_phase, pattern_light
from atmofit.clouds.picture import render_cloud
from atmofit.clouds.presets import cloud_preset
from atmofit.clouds.stage import staged_cloud, staged_view
from atmofit.clouds.surroundings import clear_surroundings
from atmofit.files import replace_file
from atmofit.render.film import on_film
from atmofit.render.pictures import typical_luminance, write_picture

TURBIDITY, ALBEDO = 2.5, 0.15
Scene = tuple[str, float, float, float | None]
# Name: preset, elevation and azimuth of the sun [degree], distance [m].
PICTURES: dict[str, Scene] = {
    "7 (a), sun 65": ("cumulus", 65.0, 120.0, None),
    "7 (b), sun 10, behind": ("cumulus", 10.0, 12.0, None),
    "7 (c), sun 5": ("cumulus", 5.0, 150.0, None),
    "8, far": ("cumulonimbus", 35.0, 130.0, 45e3),
    "8, near": ("cumulonimbus", 35.0, 130.0, None),
}
SIZES = (32, 64, 100, 128)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    width: int = 500
    voxels: int = 100
    seed: int = 5
    method: str = "converged"
    """Of the pictures; the second figure beside the first is by the other."""
    cost: bool = True
    """Whether times are taken."""
    size: int | None = None
    """For the processes that the run starts: how many voxels to time."""
    out: Path = Path("runs/clouds")


def main(config: Config) -> None:
    """Draw, time, print and write."""
    if config.size is not None:
        print(json.dumps(cost_of(config, config.size)))
        return
    config.out.mkdir(parents=True, exist_ok=True)
    pictures, seconds = {}, {}
    tasks = [(name, scene, config.method) for name, scene in PICTURES.items()]
    tasks.append(("7 (a), three orders, as in 1996", next(iter(PICTURES.values())), "pattern"))
    for name, scene, method in tasks:
        start = time.perf_counter()
        pictures[name] = draw_one(config, scene, method)
        seconds[name] = time.perf_counter() - start
        print(f"{name}: {seconds[name]:.1f} s", flush=True)
        file = re.sub(r"\W+", "_", name)
        write_picture(pictures[name], config.out / f"{file}.png")
    print(draw(config.out / "clouds.png", pictures))
    result: dict[str, Any] = {"seconds": seconds, "colours": colours(pictures)}
    text = markdown(
        ["picture", "seconds", "x of the cloud", "y", "luminance over the sky's beside it"],
        [
            [name, f"{seconds[name]:.1f}", *(f"{v:.3f}" for v in values)]
            for name, values in result["colours"].items()
        ],
    )
    if config.cost:
        result["gradient"] = gradient_cost()
        result["costs"] = []
        for size in SIZES:
            # Peaks of memory need processes of their own.
            command = [sys.executable, __file__, "--size", str(size)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            result["costs"].append(json.loads(done.stdout.splitlines()[-1]))
            print(result["costs"][-1], flush=True)
        text += "\n" + cost_tables(result)
    print(text)
    write_run(config.out, config, result, text)


def draw_one(config: Config, scene: Scene, method: str) -> af.Picture:
    """A picture to the north."""
    preset, elevation, azimuth, distance = scene
    cloud = staged_cloud(preset, seed=config.seed, voxels=config.voxels, distance=distance)
    middle = float(cloud.low[2] + cloud.high[2]) / 2
    around = clear_surroundings(
        TURBIDITY, math.radians(90 - elevation), math.radians(azimuth), ALBEDO, middle
    )
    view = staged_view(preset, width=config.width)
    return render_cloud(cloud, view, around, phase=cloud_phase(), method=method, tell=tell)


def tell(stage: str) -> None:
    """Say what a picture goes without."""
    if stage.startswith("left out"):
        print(f"  {stage}", flush=True)


def colours(pictures: dict[str, af.Picture]) -> dict[str, tuple[float, float, float]]:
    """Median chromaticity of each cloud, and its luminance over that of the sky on its level."""
    found = {}
    for name, picture in pictures.items():
        xyY = np.asarray(af.XYZ_to_xyY(picture.XYZ))
        sky = np.asarray(np.isinf(picture.distance))
        rows = np.asarray((~sky).any(axis=1) & sky.any(axis=1))
        cloud = ~sky & rows[:, None]
        over = np.median(xyY[cloud][:, 2]) / np.median(xyY[sky & rows[:, None]][:, 2])
        x, y, _ = np.median(xyY[cloud], axis=0)
        found[name] = (float(x), float(y), float(over))
    return found


def cost_of(config: Config, voxels: int) -> dict[str, float]:
    """Seconds and memory of the paper's task: 338 balls, sun, sky and ground, three orders."""
    start = time.perf_counter()
    balls = cloud_preset("cumulonimbus", seed=config.seed)
    shaped = time.perf_counter()
    cloud = staged_cloud("cumulonimbus", seed=config.seed, voxels=voxels)
    gridded = time.perf_counter()
    around = clear_surroundings(TURBIDITY, 0.9, 2.3, ALBEDO, 5e3)
    view = staged_view("cumulonimbus", width=config.width)
    found: dict[str, float] = {
        "voxels": voxels,
        "balls": balls.count,
        "shape [s]": shaped - start,
        "shape and grid [s]": gridded - shaped,
    }
    for method in ("pattern", "converged"):
        if method == "converged" and voxels > 100:
            continue
        for word in ("first", "hot"):
            begin = time.perf_counter()
            render_cloud(cloud, view, around, phase=cloud_phase(), method=method)
            found[f"{method}, {word} [s]"] = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        found[f"{method}, peak so far [MB]"] = peak
    return found


def gradient_cost() -> dict[str, tuple[float, float, float]]:
    """Seconds of a picture, of its gradient by every voxel's density, and their ratio."""
    axis = (np.arange(24) + 0.5) / 24 * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    density = jnp.asarray(5.0 * np.maximum(1 - (x**2 + y**2 + z**2), 0.0), jnp.float32)
    place = (jnp.full(3, -1.0, jnp.float32), jnp.full(3, 1.0, jnp.float32))

    def converged(density: jax.Array) -> jax.Array:
        light = converged_light(
            af.clouds.voxel_cloud(density, *place), phase=cloud_phase(), directions=50, rtol=1e-3
        )
        return jnp.sum(light.view(sun_angle=1.0, width=48, extent=2.4).radiance)

    def pattern(density: jax.Array) -> jax.Array:
        cloud = af.clouds.voxel_cloud(density, *place)
        light = pattern_light(cloud, phase=cloud_phase(), view_direction=aim, pattern=made)
        seen = af.clouds.view(cloud, light.total, sun_angle=1.0, width=48, extent=2.4)
        return jnp.sum(seen.radiance)

    aim = np.array([math.sin(1.0), 0.0, math.cos(1.0)])
    made = af.clouds.reference_pattern(
        phase=cloud_phase(),
        sun_direction=(0.0, 0.0, 1.0),
        view_direction=aim,
        voxel_size=np.full(3, 2 / 24),
        extinction_coefficient=2.0,
    )
    found = {}
    for name, function in (("converged", converged), ("pattern", pattern)):
        times = []
        for program in (eqx.filter_jit(function), eqx.filter_jit(jax.value_and_grad(function))):
            times.append(hot(lambda p=program: p(density)))
        found[name] = (*times, times[1] / times[0])
    return found


def hot(call: Callable[[], Any], repeats: int = 3) -> float:
    """Seconds of the best of some hot runs."""
    jax.block_until_ready(call())
    seconds = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        seconds = min(seconds, time.perf_counter() - start)
    return seconds


def cost_tables(result: dict[str, Any]) -> str:
    """Both tables in markdown."""
    heads = list(result["costs"][1])
    rows = [
        [f"{row[head]:.3g}" if head in row else "" for head in heads] for row in result["costs"]
    ]
    slopes = markdown(
        ["light inside", "picture [s]", "with its gradient [s]", "ratio"],
        [[name, *(f"{v:.3g}" for v in values)] for name, values in result["gradient"].items()],
    )
    return markdown(heads, rows) + "\n" + slopes


def draw(path: Path, pictures: dict[str, af.Picture]) -> Path:
    """All pictures on a sheet; those of the cumulus at noon share an exposure."""
    import matplotlib.pyplot as plt

    white = typical_luminance(next(iter(pictures.values())))
    figure, axes = plt.subplots(2, 3, figsize=(13, 7), layout="constrained")
    for one, (name, picture) in zip(axes.flat, pictures.items(), strict=True):
        exposure = white if "(a)" in name else typical_luminance(picture)
        one.imshow(on_film(np.asarray(af.XYZ_to_xyY(picture.XYZ)), exposure))
        one.set_title(f"figure {name}", fontsize=10)
        one.set_axis_off()
    replace_file(path, lambda name: figure.savefig(name, dpi=110, format="png"))
    plt.close(figure)
    return path


if __name__ == "__main__":
    main(tyro.cli(Config))
