"""Nishita's reference pattern: how much light do its paths bring, at what cost?

Sums of form factors with and without sub-voxels; paths that bring 90 % of an order; what the
pattern gives of each order in a uniform box, and what later orders would add, beside a random walk;
seconds against voxels. Writes result.json, table.md and a picture.
"""

import dataclasses
import math
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

from atmofit.clouds.depths import optical_depth_toward, sunlight_reaching
from atmofit.clouds.form_factors import form_factors
from atmofit.clouds.pattern import ReferencePattern, reference_pattern
from atmofit.clouds.pattern_light import average_extinction, cloud_phase, pattern_light
from atmofit.clouds.volume import VoxelCloud, voxel_cloud
from atmofit.files import replace_file
from atmofit.optics.phase import CornetteShanks

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.cloud_orders import cloud_orders

BOX = (8, 8, 16)
VIEW = np.array([0.02, 0.03, 1.0]) / np.linalg.norm([0.02, 0.03, 1.0])
F32 = np.float32


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    asymmetries: tuple[float, ...] = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95)
    angles: tuple[float, ...] = (10.0, 160.0)
    """Between the sun's rays and the line of sight [degrees]; 10 looks toward the sun."""
    box_depths: tuple[float, ...] = (0.8, 1.6, 3.2, 8.0)
    """Of the box, along its longest edge."""
    photons: int = 200_000
    orders: int = 12
    voxels: tuple[int, ...] = (32, 64, 100)
    paths: int = 400
    out: Path = Path("runs/cloud_pattern")
    picture: Path = Path("docs/cloud_pattern.png")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    patterns = {}
    result = {
        "rows": [row_sums(g) for g in config.asymmetries],
        "paths": [
            counted(g, angle, depth, patterns)
            for g in (0.7, 0.9)
            for angle in config.angles
            for depth in (0.05, 0.2)
        ],
        "orders": [by_order(config, depth) for depth in config.box_depths],
        "seconds": [seconds(config, voxels) for voxels in config.voxels],
    }
    text = report(result)
    print(text)
    write_run(config.out, config, result, text)
    print(replace_file(config.picture, lambda path: draw(path, result, patterns)))


def sun_at(angle: float) -> np.ndarray:
    """Direction to a sun whose rays are this far from the line of sight [degrees]."""
    turn = math.radians(angle)
    return -np.array([math.sin(turn), 0.0, math.cos(turn)])


def row_sums(g: float, depth: float = 0.05) -> dict[str, float]:
    """Of the form factors to all other voxels, 8 on each side and along the light."""
    up, reach = np.array([0.0, 0.0, 1.0]), (4, 4, 8)
    row = form_factors(
        phase=CornetteShanks(F32(g)), direction=up, extinction_coefficient=depth, reach=reach
    )
    place = np.indices(row.shape).reshape(3, -1).T - np.array(reach)
    other = np.any(place != 0, axis=1)
    way = np.linalg.norm(place[other], axis=1)
    angle = np.arccos(np.clip(place[other] @ up / way, -1, 1))
    phase = np.asarray(CornetteShanks(F32(g))(jnp.asarray(angle)))
    middles = float(np.sum(phase * depth * np.exp(-depth * way) / way**2))
    possible = 1 - math.exp(-depth * float(np.linalg.norm(np.array(reach) + 1)))
    return {"g": g, "averaged": float(row.sum()), "middles": middles, "possible": possible}


def counted(
    g: float, angle: float, depth: float, patterns: dict[Any, ReferencePattern]
) -> dict[str, Any]:
    """Paths and orders in the paper's sample space, by a voxel's optical depth."""
    pattern = reference_pattern(
        phase=CornetteShanks(F32(g)),
        sun_direction=sun_at(angle),
        view_direction=VIEW,
        voxel_size=1.0,
        extinction_coefficient=depth,
        own_voxel=False,
        most=10**7,
    )
    patterns[g, angle, depth] = pattern
    second, third = pattern.paths
    best = float(third.contribution[:400].sum()) / third.total
    return {
        "g": g,
        "angle": angle,
        "depth": depth,
        "possible": third.possible,
        "second": len(second.factor),
        "third": len(third.factor),
        "by 400": best,
        "orders": pattern.order_shares,
    }


def by_order(config: Config, box_depth: float, g: float = 0.7, angle: float = 160.0) -> Any:
    """A uniform box by the pattern and by a random walk."""
    depth, sun, phase = box_depth / BOX[2], sun_at(angle), CornetteShanks(F32(g))

    def value(cosine: np.ndarray) -> np.ndarray:
        top = 3 * (1 - g**2) / (2 * (2 + g**2)) * (1 + cosine**2)
        return top / (1 + g**2 - 2 * g * cosine) ** 1.5 / (4 * math.pi)

    walk, error = cloud_orders(
        np.array(BOX, float), depth, value, sun, VIEW, photons=config.photons, orders=config.orders
    )
    cloud = voxel_cloud(np.full(BOX, depth, F32), (0.0, 0.0, 0.0), tuple(map(float, BOX)))
    kwargs = {"phase": phase, "sun_direction": sun, "view_direction": VIEW}
    light = pattern_light(cloud, most=config.paths, **kwargs)
    seen = np.asarray(sunlight_reaching(cloud, VIEW)) * depth
    found = np.sum(np.asarray(light.source_function) * seen, axis=(1, 2, 3))
    return {
        "depth": box_depth,
        "walk": (walk / walk.sum()).tolist(),
        "error": (error / walk.sum()).tolist(),
        "pattern": (found / walk.sum()).tolist(),
        "kept": light.shares,
    }


def lumpy(voxels: int) -> VoxelCloud:
    """A ball of cloud with lumps, optical depth about 20 across."""
    place = (np.arange(voxels) + 0.5) / voxels * 2 - 1
    x, y, z = np.meshgrid(place, place, place, indexing="ij")
    lumps = 1 + 0.5 * np.sin(8 * x) * np.sin(7 * y + z)
    grid = np.where(x**2 + y**2 + z**2 < 0.95, 10 * lumps, 0.0)
    return voxel_cloud(grid.astype(F32), (-1.0,) * 3, (1.0,) * 3)


def seconds(config: Config, voxels: int) -> dict[str, float]:
    """Pattern and filter, hot."""
    cloud, phase, view = lumpy(voxels), cloud_phase(F32(0.85)), (0.6, 0.0, 0.8)
    sun = (0.0, 0.0, 1.0)
    start = time.perf_counter()
    pattern = reference_pattern(
        phase=phase,
        sun_direction=sun,
        view_direction=view,
        voxel_size=2 / voxels,
        extinction_coefficient=average_extinction(cloud),
        most=config.paths,
    )
    made = time.perf_counter() - start

    def light() -> Any:
        return pattern_light(
            cloud, phase=phase, sun_direction=sun, view_direction=view, pattern=pattern
        ).source_function

    def sweep() -> Any:
        return optical_depth_toward(cloud, view)

    times = []
    for call in (light, sweep):
        jax.block_until_ready(call())
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    paths = sum(len(paths.factor) for paths in pattern.paths)
    return {
        "voxels": voxels,
        "pattern": made,
        "filter": times[0],
        "sweep": times[1],
        "paths": paths,
    }


def report(result: dict[str, Any]) -> str:
    """The tables."""
    rows = [
        [f"{r['g']:g}", f"{r['averaged']:.3f}", f"{r['middles']:.3f}", f"{r['possible']:.3f}"]
        for r in result["rows"]
    ]
    paths = [
        [
            f"{r['g']:g}",
            f"{r['angle']:g}",
            f"{r['depth']:g}",
            f"{r['second']}",
            f"{r['third']:,}",
            f"{100 * r['by 400']:.0f}",
            " / ".join(f"{100 * s:.0f}" for s in r["orders"]),
        ]
        for r in result["paths"]
    ]
    orders = [
        [
            f"{r['depth']:g}",
            " / ".join(f"{s:.3f}" for s in r["walk"][:3]),
            f"{sum(r['walk'][3:]):.3f}",
            " / ".join(f"{s:.3f}" for s in r["pattern"]),
            " / ".join(f"{s:.2f}" for s in r["kept"]),
        ]
        for r in result["orders"]
    ]
    cost = [
        [
            f"{r['voxels']}^3",
            str(r["paths"]),
            f"{r['pattern']:.1f}",
            f"{r['filter']:.2f}",
            f"{r['sweep']:.3f}",
        ]
        for r in result["seconds"]
    ]
    return "\n\n".join(
        [
            markdown(["g", "sum, sub-voxels", "sum, middles", "possible"], rows),
            markdown(
                [
                    "g",
                    "angle [deg]",
                    "depth of a voxel",
                    "paths for 90 %, order 2",
                    "order 3",
                    "order 3 by 400 [%]",
                    "orders 1 / 2 / 3 [%]",
                ],
                paths,
            ),
            markdown(
                [
                    "box depth",
                    "walk, orders 1 / 2 / 3",
                    "4 to 12",
                    "pattern, 1 / 2 / 3",
                    "kept, 2 / 3",
                ],
                orders,
            ),
            markdown(["voxels", "paths", "pattern [s]", "filter [s]", "sweep [s]"], cost),
        ]
    )


def draw(path: Path, result: dict[str, Any], patterns: dict[Any, ReferencePattern]) -> None:
    """Row sums, two patterns, orders, seconds."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained")
    rows = result["rows"]
    g = [r["g"] for r in rows]
    axis = axes[0, 0]
    axis.semilogy(g, [r["middles"] for r in rows], "o-", color="#c8553d", label="between middles")
    axis.semilogy(g, [r["averaged"] for r in rows], "o-", color="#1f5fa8", label="sub-voxels")
    axis.axhline(rows[0]["possible"], color="0.4", ls="--", label="possible")
    axis.set(
        xlabel="asymmetry g [-]",
        ylabel="light that collides again [-]",
        title="Sum of form factors",
    )
    axis.legend(frameon=False)
    for axis, angle in zip(axes[0, 1:], (10.0, 160.0), strict=True):
        pattern = patterns[0.9, angle, 0.05]
        second = pattern.paths[0]
        image = np.full((BOX[2], BOX[0]), np.nan)
        for leg, light in zip(second.legs[:, 0], second.contribution, strict=True):
            x, z = leg[0] + BOX[0] // 2, leg[2] + BOX[2] // 2
            image[z, x] = np.nansum([image[z, x], light / second.total])
        shown = axis.imshow(
            100 * image,
            origin="lower",
            cmap="viridis",
            norm="log",
            vmin=0.1,
            vmax=30,
            extent=(-4.5, 3.5, -8.5, 7.5),
        )
        axis.plot(0, 0, "x", color="#c8553d", ms=9, mew=2)
        axis.set(
            xlabel="x [voxels]",
            ylabel="z, to the eye [voxels]",
            title=f"Order 2, rays {angle:g}° off",
        )
        figure.colorbar(shown, ax=axis, label="share of order 2 [%]")
    axis, orders = axes[1, 0], result["orders"]
    place = np.arange(len(orders))
    below, built = np.zeros(len(orders)), np.zeros(len(orders))
    for k, color in enumerate(("#fde0a5", "#5a9367", "#1f5fa8")):
        walk, found = (np.array([r[name][k] for r in orders]) for name in ("walk", "pattern"))
        axis.bar(place - 0.2, walk, 0.36, below, color=color, label=f"order {k + 1}")
        axis.bar(place + 0.2, found, 0.36, built, color=color, hatch="///", edgecolor="white")
        below, built = below + walk, built + found
    axis.bar(place - 0.2, 1 - below, 0.36, below, color="0.75", label="4 to 12")
    axis.set_xticks(place, [f"{r['depth']:g}" for r in orders])
    axis.set(
        xlabel="optical depth of the box [-]",
        ylabel="share of the light [-]",
        ylim=(0, 1.25),
        title="Random walk, and hatched: pattern",
    )
    axis.legend(frameon=False, fontsize=9, ncols=2, loc="upper center")
    axis = axes[1, 1]
    for r in result["paths"]:
        label = f"g {r['g']:g}, {r['angle']:g}°, depth {r['depth']:g}"
        axis.barh(label, r["third"], color="#8c6bb1")
    axis.axvline(400, color="#c8553d", label="the paper's 400")
    axis.invert_yaxis()
    axis.set(
        xscale="log",
        xlabel="paths that bring 90 % [-]",
        title="Order 3: paths, of 1,046,529",
        xlim=(100, 2e6),
    )
    axis.legend(frameon=False, loc="lower right")
    axis.margins(y=0.1)
    axis, cost = axes[1, 2], result["seconds"]
    counts = [r["voxels"] ** 3 for r in cost]
    for name, color in (("pattern", "#8c6bb1"), ("filter", "#1f5fa8"), ("sweep", "#5a9367")):
        axis.loglog(counts, [r[name] for r in cost], "o-", color=color, label=name)
    axis.set(xlabel="voxels", ylabel="time [s]", title=f"Cost, {cost[-1]['paths']} paths at most")
    axis.legend(frameon=False)
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)


if __name__ == "__main__":
    main(tyro.cli(Config))
