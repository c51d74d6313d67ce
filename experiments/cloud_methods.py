"""What does each way to light a cloud cost, and how wrong is it?

A white cloud of overlapping balls, on a grid of voxels, seen from three sides in front of black;
optical depths of 0.1 to 100 across its thickest column. The truth is a path tracer's picture of the
same voxels by many paths; errors are of averages over 8 x 8 pixels, over the pictures' own root
mean square. A method is a function from a cloud to its pictures: add others to METHODS. One
optical depth a run if wanted: a later run keeps the rows of the earlier. Writes result.json,
table.md and a picture.
"""

import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.clouds.converged import converged_light
from atmofit.clouds.first_order import single_scattering
from atmofit.clouds.marching import sensor_direction, view
from atmofit.clouds.path_trace import path_trace
from atmofit.clouds.pattern_light import pattern_light
from atmofit.clouds.volume import VoxelCloud, voxel_cloud
from atmofit.files import replace_file

F32 = np.float32
HALF, EXTENT, WIDTH, BLOCK = 1.2, 2.4, 48, 8
ANGLES = tuple(F32(math.radians(degrees)) for degrees in (30.0, 90.0, 150.0))
BALLS = (  # x, y, z and radius [m]
    (0.0, 0.0, 0.0, 0.9),
    (0.5, 0.2, 0.25, 0.6),
    (-0.45, -0.25, 0.3, 0.65),
    (0.1, 0.5, -0.2, 0.6),
    (-0.25, 0.3, 0.5, 0.5),
    (0.35, -0.45, -0.1, 0.6),
)
CONVERGED = ((2, 14), (2, 26), (1, 14), (1, 26), (1, 50))  # times coarser, directions
PATTERN = ((2, 400), (3, 100), (3, 400))  # orders, paths of each
COLORS = ("#8c6bb1", "#d19a2a", "#1f5fa8", "#c8553d")
Pictures = np.ndarray
Method = Callable[[VoxelCloud], Any]


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    optical_depths: tuple[float, ...] = (0.1, 1.0, 10.0, 100.0)
    voxels: int = 24
    """Along each edge of the cloud that all methods are judged by; an even number."""
    asymmetry: float = 0.85
    samples: int = 512
    """Paths of a pixel for the truth."""
    repeats: int = 2
    """Hot runs, of which the quickest counts."""
    out: Path = Path("runs/cloud_methods")
    picture: Path = Path("docs/cloud_methods.png")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    stored = config.out / "result.json"
    results = json.loads(stored.read_text())["optical depth"] if stored.exists() else {}
    for depth in config.optical_depths:
        results[f"{depth:g}"] = compared(config, depth)
        results = dict(sorted(results.items(), key=lambda item: float(item[0])))
        write_run(config.out, config, {"optical depth": results}, table(results) + "\n")
    print(table(results))
    print(replace_file(config.picture, lambda path: draw(path, results, config.voxels)))


def cloud_of(voxels: int, optical_depth: float) -> VoxelCloud:
    """Balls that fade out toward their surface, as Wyvill's, above a threshold."""
    place = ((np.arange(voxels) + 0.5) / voxels * 2 - 1) * HALF
    field = np.zeros((voxels,) * 3)
    for *middle, radius in BALLS:
        offsets = np.meshgrid(*(place - x for x in middle), indexing="ij")
        inside = np.clip(1 - sum(offset**2 for offset in offsets) / radius**2, 0.0, None)
        field += inside**3
    density = np.clip(field - 0.1, 0.0, 0.5)
    column = density.sum(axis=2).max() * 2 * HALF / voxels
    return voxel_cloud((density * optical_depth / column).astype(F32), (-HALF,) * 3, (HALF,) * 3)


def coarser(cloud: VoxelCloud, factor: int) -> VoxelCloud:
    """Averages over blocks of voxels."""
    fine = cloud.extinction_coefficient
    n = fine.shape[0] // factor
    grid = fine.reshape(n, factor, n, factor, n, factor).mean(axis=(1, 3, 5))
    return voxel_cloud(grid, cloud.low, cloud.high)


def methods(config: Config) -> dict[str, Method]:
    """What is compared. Names start with the kind, which sets the colour."""
    phase = af.HenyeyGreenstein(F32(config.asymmetry))

    def single(cloud: VoxelCloud) -> Any:
        sources = [single_scattering(cloud, sensor_direction(a), phase=phase) for a in as_arrays()]
        return [seen(cloud, source, angle) for source, angle in zip(sources, ANGLES, strict=True)]

    def pattern(cloud: VoxelCloud, orders: int, most: int) -> Any:
        found = []
        for angle in ANGLES:
            light = pattern_light(
                cloud,
                phase=phase,
                view_direction=sensor_direction(jnp.asarray(angle)),
                orders=orders,
                most=most,
            )
            found.append(seen(cloud, light.total, angle))
        return found

    def converged(cloud: VoxelCloud, directions: int, factor: int) -> Any:
        grid = coarser(cloud, factor)
        light = converged_light(grid, phase=phase, directions=directions, rtol=1e-3)
        return [
            seen(grid, light.source_function(sensor_direction(a)), angle)
            for a, angle in zip(as_arrays(), ANGLES, strict=True)
        ]

    def traced(cloud: VoxelCloud, samples: int, seed: int = 2) -> Any:
        return [
            path_trace(
                cloud,
                phase=phase,
                sun_angle=angle,
                width=WIDTH,
                extent=EXTENT,
                samples=samples,
                seed=seed,
            ).radiance
            for angle in ANGLES
        ]

    found: dict[str, Method] = {"truth": lambda cloud: traced(cloud, config.samples, 1)}
    found["single"] = single
    for orders, most in PATTERN:
        name = f"pattern, {config.voxels}^3, {orders} orders, {most} paths"
        found[name] = lambda cloud, o=orders, m=most: pattern(cloud, o, m)
    for factor, directions in CONVERGED:
        name = f"converged, {config.voxels // factor}^3, {directions} directions"
        found[name] = lambda cloud, d=directions, f=factor: converged(cloud, d, f)
    for samples in (4, 16, 64):
        found[f"Monte Carlo, {samples} paths"] = lambda cloud, n=samples: traced(cloud, n)
    return found


def as_arrays() -> list[Any]:
    """The angles as JAX wants them."""
    return [jnp.asarray(angle) for angle in ANGLES]


def seen(cloud: VoxelCloud, source: Any, angle: np.float32) -> Any:
    """One picture."""
    return view(cloud, source, sun_angle=angle, width=WIDTH, extent=EXTENT).radiance


def compared(config: Config, optical_depth: float) -> dict[str, dict[str, float]]:
    """Error and time of every method at one optical depth."""
    cloud = cloud_of(config.voxels, optical_depth)
    every = methods(config)
    truth, other = blocks(every["truth"](cloud)), {}
    size = math.sqrt(np.mean(truth**2))
    for name, method in every.items():
        if name == "truth":
            continue
        begin = time.perf_counter()
        pictures = jax.block_until_ready(method(cloud))
        first, hot = time.perf_counter() - begin, math.inf
        for _ in range(config.repeats):
            begin = time.perf_counter()
            jax.block_until_ready(method(cloud))
            hot = min(hot, time.perf_counter() - begin)
        wrong = blocks(pictures) - truth
        other[name] = {
            "first_s": first,
            "hot_s": hot,
            "error": math.sqrt(np.mean(wrong**2)) / size,
            "mean_ratio": float(blocks(pictures).mean() / truth.mean()),
        }
        print(f"{optical_depth:g}", name, other[name], flush=True)
    noisy = next(value["error"] for name, value in other.items() if "64 paths" in name)
    # Noise falls with the square root of the number of paths.
    other["truth"] = {
        "error": noisy / math.sqrt(1 + config.samples / 64),
        "samples": config.samples,
    }
    return other


def blocks(pictures: Any) -> np.ndarray:
    """Averages over 8 x 8 pixels."""
    n = WIDTH // BLOCK
    return np.asarray(pictures, float).reshape(-1, n, BLOCK, n, BLOCK).mean(axis=(2, 4))


def table(results: dict[str, dict[str, dict[str, float]]]) -> str:
    """Error and seconds, a pair of columns for each optical depth."""
    names = list(next(iter(results.values())))
    rows = []
    for name in names:
        row = [name if name != "truth" else "noise of the truth"]
        for found in results.values():
            value = found[name]
            row.append(f"{100 * value['error']:.2g} %")
            row.append(f"{value['hot_s']:.2f}" if "hot_s" in value else "")
        rows.append(row)
    head = ["method"]
    for depth in results:
        head += [f"error, depth {depth}", "time [s]"]
    return markdown(head, rows)


def draw(path: Path, results: dict[str, dict[str, dict[str, float]]], finest: int) -> None:
    """Error against time, a panel for each optical depth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 4.2), layout="constrained")
    panels = figure.subplots(1, len(results), sharex=True, sharey=True, squeeze=False)[0]
    kinds = list(dict.fromkeys(n.split(",")[0] for n in next(iter(results.values()))))
    kinds.remove("truth")
    markers = {"14": "v", "26": "^", "50": "o"}
    for panel, (depth, found) in zip(panels, results.items(), strict=True):
        for name, value in found.items():
            if name == "truth":
                continue
            words = name.replace(" directions", "").split(", ")
            color = COLORS[kinds.index(words[0])]
            marker = markers.get(words[-1], "D")
            big = 20 if f"{finest // 2}^3" in name else 60
            panel.scatter(value["hot_s"], 100 * value["error"], big, color, marker=marker)
        panel.axhline(100 * found["truth"]["error"], color="0.6", ls=":", lw=1)
        panel.set(xscale="log", yscale="log", xlabel="time of three pictures [s]")
        panel.set_title(f"optical depth {depth}")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("error of 8 x 8 averages [% of rms]")
    legend(panels[-1], kinds, markers)
    figure.savefig(path, dpi=130)


def legend(panel: Any, kinds: list[str], markers: dict[str, str]) -> None:
    """Kinds by colour, directions by marker."""
    for color, kind in zip(COLORS, kinds, strict=False):
        panel.plot([], [], "D", color=color, label=kind)
    for count, marker in markers.items():
        panel.plot([], [], marker, color="0.5", ls="", label=f"{count} directions")
    panel.plot([], [], "o", color="0.5", ms=4, label="small: half the voxels an edge")
    panel.plot([], [], ":", color="0.6", label="noise of the truth")
    panel.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.02, 0.5))


if __name__ == "__main__":
    main(tyro.cli(Config))
