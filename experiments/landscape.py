"""A landscape at several hours, with and without air between, and what it costs to draw.

Stages figures 1, 7 and 8 of Preetham, Shirley and Smits (1999) over mountains from a seed: a grey
sky without air against the model; morning, evening, haze and overcast; the CIE's clear sky with
Ward Larson's ambient light against the model, to the west and to the east. Then seconds and memory
against pixels and by stage. Writes landscape.png, single pictures, result.json and table.md.
"""

import dataclasses
import json
import math
import resource
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
from atmofit.files import replace_file
from atmofit.landscape.light import WAVELENGTHS_NM
from atmofit.render.film import on_film
from atmofit.render.pictures import typical_luminance, write_picture

ALBEDO = af.Spectrum(WAVELENGTHS_NM, np.linspace(0.06, 0.16, 9))  # dry ground and grass
SIZES = ((250, 188), (500, 375), (1000, 750), (2000, 1500))
WEST, EAST = math.radians(270.0), math.radians(90.0)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    seed: int = 5
    columns: int = 640
    rows: int = 480
    relief: float = 1800.0
    """Of the terrain [m]."""
    repeats: int = 3
    """Hot runs, of which the quickest counts."""
    rtol: float = 3e-3
    """Of the lines of sight."""
    cost: bool = True
    """Whether times are taken."""
    size: int | None = None
    """For the processes that the run starts: which of the sizes to time."""
    out: Path = Path("runs/landscape")


def main(config: Config) -> None:
    """Draw, time, print and write."""
    if config.size is not None:
        print(json.dumps(cost_of(config, *SIZES[config.size])))
        return
    config.out.mkdir(parents=True, exist_ok=True)
    pictures = staged(config)
    for name, (picture, white) in pictures.items():
        file = name.split(":")[0].replace(" ", "_").replace(",", "")
        write_picture(picture, config.out / f"{file}.png", white)
    first, _ = next(iter(pictures.values()))
    write_picture(first, config.out / "linear.exr")
    print(draw(config.out / "landscape.png", pictures))
    text, costs = "", []
    if config.cost:
        # Peaks of memory need processes of their own.
        for k in range(len(SIZES)):
            command = [sys.executable, __file__, "--size", str(k), "--seed", str(config.seed)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            costs.append(json.loads(done.stdout.splitlines()[-1]))
            print(costs[-1], flush=True)
        head = ["pixels", "first call [s]", *(f"{name} [s]" for name in STAGES), "peak [MB]"]
        rows = [
            [f"{c['columns']} x {c['rows']}", f"{c['first_s']:.1f}"]
            + [f"{c[name]:.2f}" for name in STAGES]
            + [f"{c['peak_MB']:.0f}"]
            for c in costs
        ]
        text = markdown(head, rows)
        print(text)
    write_run(config.out, config, {"costs": costs}, text + "\n")


def scene(config: Config) -> tuple[af.Terrain, tuple[float, float]]:
    """Mountains, and a place among them that sees far to the west and to the east."""
    terrain = af.procedural_terrain(config.seed, relief=config.relief)
    heights = np.asarray(terrain.heights)
    middle = heights[400:600, 400:600]
    row, column = np.unravel_index(np.argmax(middle), middle.shape)
    return terrain, ((column + 400) * 60.0, (row + 400) * 60.0)


def look(config: Config, place: tuple[float, float], azimuth: float, **options: Any) -> af.View:
    """A view from a summit."""
    size = {"columns": config.columns, "rows": config.rows} | options
    return af.View(*place, 30.0, azimuth, horizon=0.4, farthest=5e4, **size)


def plan_for(config: Config, light: af.Light) -> af.PathPlan:
    """For all lines of sight of these views."""
    angles = (math.radians(60.0), math.radians(125.0))
    return af.plan_path(light.air, (3.0, 6e4), angles, (0.0, config.relief + 100), config.rtol)


def ambient_of(light: af.Light) -> af.WardLarson:
    """The constant ambient light that is right on average over all level lines of sight."""
    azimuth, distance = np.radians(np.arange(5.0, 360.0, 10.0)), np.geomspace(300.0, 5e4, 12)
    shape = (azimuth.size, distance.size)
    source = light.around.toward(
        light.air, np.full(shape, math.pi / 2), np.broadcast_to(azimuth[:, None], shape)
    )
    path = af.Path(np.broadcast_to(distance, shape), math.pi / 2, 1e3)
    found = af.path_transfer(light.air, path, source)
    return af.fit_ward_larson(found.in_scattered, found.transmittance)


def staged(config: Config) -> dict[str, tuple[af.Picture, float]]:
    """The pictures with their exposures; pairs that are to be compared share one."""
    terrain, place = scene(config)
    found: dict[str, tuple[af.Picture, float]] = {}

    def take(name: str, light: af.Light, azimuth: float, like: str = "", **options: Any) -> None:
        view, plan = look(config, place, azimuth), plan_for(config, light)
        picture = af.render_landscape(terrain, view, light, plan, ALBEDO, **options)
        white = found[like][1] if like else typical_luminance(picture)
        found[name] = (picture, white)

    day = af.clear_light(2.0, math.radians(50.0), math.radians(160.0))
    grey_day = af.clear_light(2.0, math.radians(50.0), math.radians(160.0), grey=True)
    morning = af.clear_light(2.0, math.radians(75.0), EAST)
    evening = af.clear_light(2.0, math.radians(80.0), WEST)
    hazy = af.clear_light(6.0, math.radians(80.0), WEST)
    overcast = af.overcast_light(10.0)
    take("day, T 2: model", day, WEST)
    take("day, T 2: grey sky, no air", grey_day, WEST, "day, T 2: model", air="none")
    take("morning, T 2", morning, WEST)
    take("evening, T 2", evening, WEST)
    take("evening, T 6", hazy, WEST)
    take("evening, T 6, no air", hazy, WEST, "evening, T 6", air="none")
    take("overcast, T 10", overcast, WEST)
    take("overcast, T 10, no air", overcast, WEST, "overcast, T 10", air="none")
    dusk = af.clear_light(4.0, math.radians(82.0), WEST)
    grey_dusk = af.clear_light(4.0, math.radians(82.0), WEST, grey=True)
    ambient = ambient_of(dusk)
    for name, azimuth in (("west", WEST), ("east", EAST)):
        take(f"evening, T 4, {name}: model", dusk, azimuth)
        like = f"evening, T 4, {name}: model"
        options = {"air": "ambient", "ambient": ambient}
        take(f"evening, T 4, {name}: CIE, ambient", grey_dusk, azimuth, like, **options)
    return found


def draw(path: Path, pictures: dict[str, tuple[af.Picture, float]]) -> Path:
    """All on one sheet."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8.6), layout="constrained")
    for ax, (name, (picture, white)) in zip(
        figure.subplots(3, 4).ravel(), pictures.items(), strict=True
    ):
        ax.imshow(on_film(np.asarray(af.XYZ_to_xyY(picture.XYZ)), white))
        ax.set_title(name, fontsize=9)
        ax.axis("off")
    return replace_file(path, lambda name: figure.savefig(name, dpi=110))


STAGES = ("geometry and shading", "aerial perspective", "whole")


def cost_of(config: Config, columns: int, rows: int) -> dict[str, Any]:
    """Seconds and peak memory of one size."""
    terrain, place = scene(config)
    light = af.clear_light(2.0, math.radians(75.0), EAST)
    plan = plan_for(config, light)
    view = look(config, place, WEST, columns=columns, rows=rows)
    times = {}
    for air in ("none", "path"):
        begin = time.perf_counter()
        af.render_landscape(terrain, view, light, plan, ALBEDO, air)
        first, hot = time.perf_counter() - begin, math.inf
        for _ in range(config.repeats):
            begin = time.perf_counter()
            af.render_landscape(terrain, view, light, plan, ALBEDO, air)
            hot = min(hot, time.perf_counter() - begin)
        times[air] = (first, hot)
    return {
        "columns": columns,
        "rows": rows,
        "plan": plan.name,
        "first_s": times["path"][0],
        "geometry and shading": times["none"][1],
        "aerial perspective": times["path"][1] - times["none"][1],
        "whole": times["path"][1],
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", False)
    main(tyro.cli(Config))
