"""What does the surface of metaballs cost by Bezier clipping and by brute force, and voxels?

Rays against the presets and against random balls; brute force takes even samples of every ray and
halves the first change of side, with as many samples as keep it from missing more than a few
surfaces. Writes result.json, table.md and a picture of the presets before and after their growth.
"""

import dataclasses
import math
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

from atmofit.clouds.bezier import surface_hit
from atmofit.clouds.metaballs import Metaballs, fields, metaballs
from atmofit.clouds.presets import PRESETS, cloud_preset
from atmofit.clouds.voxels import box_around, occupied_blocks, voxelise
from atmofit.files import replace_file

SUN = np.array([-0.55, -0.45, 0.70])


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    rays: int = 20_000
    samples: int = 512
    """Of each ray, for brute force."""
    counts: tuple[int, ...] = (32, 64, 100, 128)
    """Voxels along each axis."""
    width: int = 520
    """Of each of the four pictures [pixels]."""
    repeats: int = 3
    """Hot runs, of which the quickest counts."""
    seed: int = 1
    out: Path = Path("runs/cloud_shapes")
    picture: Path = Path("docs/cloud_shapes.png")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    random = np.random.default_rng(config.seed)
    clouds = {
        "one ball": metaballs(np.zeros((1, 3)), np.ones(1), 1.0),
        "20 random": random_balls(random, 20),
        **{name: double(cloud_preset(name)) for name in PRESETS},
    }
    result = {name: rays(config, random, balls) for name, balls in clouds.items()}
    text = ray_table(result)
    voxels = {
        name: {n: gridded(config, clouds[name], n) for n in config.counts} for name in PRESETS
    }
    text += "\n\n" + voxel_table(voxels)
    print(text)
    print(replace_file(config.picture, lambda path: draw(config, path)))
    write_run(config.out, config, {"rays": result, "voxels": voxels}, text)


def random_balls(random: np.random.Generator, count: int) -> Metaballs:
    """In a cube of 2 m."""
    return metaballs(
        random.uniform(-1, 1, (count, 3)),
        random.uniform(0.2, 0.7, count),
        random.uniform(0.2, 1.0, count),
    )


def double(balls: Metaballs) -> Metaballs:
    """The same balls in double precision."""
    return jax.tree.map(lambda leaf: leaf.astype(float), balls)


def rays(config: Config, random: np.random.Generator, balls: Metaballs) -> dict[str, float]:
    """Time and roots of both ways; errors over the balls' box."""
    low, high = box_around(balls)
    size = np.linalg.norm(high - low)
    outside = random.normal(size=(config.rays, 3))
    outside *= size / np.linalg.norm(outside, axis=1)[:, None]
    origin = (low + high) / 2 + outside
    toward = random.uniform(low, high, (config.rays, 3)) - origin
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    start, step = jnp.asarray(origin), jnp.asarray(toward)
    clip_s, hit = timed(config, lambda: surface_hit(balls, start, step))
    brute_s, brute = timed(
        config, lambda: brute_force(balls, start, step, float(2 * size), config.samples)
    )
    found, plain = np.asarray(hit.distance), np.asarray(brute)
    both = np.isfinite(found) & np.isfinite(plain)
    off = np.where(both, found, 0.0) - np.where(both, plain, 0.0)
    same = both & (np.abs(off) < 0.5 * size / config.samples)
    single = jax.tree.map(lambda leaf: leaf.astype(np.float32), (balls, start, step))
    single_s, _ = timed(config, lambda: surface_hit(*single))
    left = np.asarray(balls.density(origin + np.where(both, found, 0.0)[:, None] * toward))
    return {
        "balls": balls.count,
        "rays": config.rays,
        "hit": int(np.isfinite(found).sum()),
        "bezier_s_per_million": 1e6 * clip_s / config.rays,
        "single_s_per_million": 1e6 * single_s / config.rays,
        "brute_s_per_million": 1e6 * brute_s / config.rays,
        "root_error": float(np.abs(off[same]).max() / size),
        "residual": float(np.abs(left - float(balls.threshold))[both].max()),
        "brute_missed": int((np.isfinite(found) & ~same).sum()),
        "bezier_missed": int((np.isfinite(plain) & ~np.isfinite(found)).sum()),
    }


@eqx.filter_jit
def brute_force(balls: Metaballs, start: Any, toward: Any, length: float, samples: int) -> Any:
    """First change of side between even samples, then halved; infinite if there is none."""
    s = jnp.linspace(0.0, length, samples)

    def inside(distance: Any, rows: Any) -> Any:
        here, way = rows
        return fields(balls, here + distance[..., None] * way).density > balls.threshold

    def some(rows: Any) -> Any:
        here, way = rows
        sides = inside(s, (here[None, :], way[None, :]))
        first = jnp.argmax(sides)
        low, high = s[jnp.maximum(first - 1, 0)], s[first]
        for _ in range(45):
            middle = (low + high) / 2
            side = inside(middle, (here, way))
            low, high = jnp.where(side, low, middle), jnp.where(side, middle, high)
        return jnp.where(jnp.any(sides), high, jnp.inf)

    return jax.lax.map(some, (start, toward), batch_size=1024)


def timed(config: Config, run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the quickest hot run, and what it gave."""
    found, hot = jax.block_until_ready(run()), math.inf
    for _ in range(config.repeats):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        hot = min(hot, time.perf_counter() - begin)
    return hot, found


def gridded(config: Config, balls: Metaballs, count: int) -> dict[str, float]:
    """Time, and the share of voxels in empty blocks."""
    seconds, cloud = timed(
        config, lambda: voxelise(balls, (count, count, count), extinction_coefficient=0.01)
    )
    return {"seconds": seconds, "saved": occupied_blocks(cloud).saved}


def ray_table(result: dict[str, dict[str, float]]) -> str:
    """Markdown."""
    head = ["balls", "rays", "that hit", "Bezier [s / million]", "in float32", "brute force"]
    head += ["largest difference / box", "Bezier missed", "brute force missed or late"]
    rows = [
        [
            f"{name} ({found['balls']})",
            f"{found['rays']}",
            f"{found['hit']}",
            f"{found['bezier_s_per_million']:.3g}",
            f"{found['single_s_per_million']:.3g}",
            f"{found['brute_s_per_million']:.3g}",
            f"{found['root_error']:.1e}",
            f"{found['bezier_missed']}",
            f"{found['brute_missed']}",
        ]
        for name, found in result.items()
    ]
    return markdown(head, rows)


def voxel_table(result: dict[str, dict[int, dict[str, float]]]) -> str:
    """Markdown."""
    rows = [
        [name, f"{n}^3", f"{found['seconds']:.2f}", f"{100 * found['saved']:.0f} %"]
        for name, grids in result.items()
        for n, found in grids.items()
    ]
    return markdown(["cloud", "voxels", "seconds", "in empty blocks of 8^3"], rows)


def draw(config: Config, path: Path) -> None:
    """The presets before and after growth, seen level along y."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 9.4), layout="constrained")
    panels = figure.subplots(2, 2, height_ratios=[0.82, 1.0])
    for row, name in zip(panels, PRESETS, strict=True):
        low, high = box_around(cloud_preset(name))
        for panel, grown in zip(row, (False, True), strict=True):
            balls = cloud_preset(name, grown=grown)
            margin = 0.04 * (high[0] - low[0])
            box = (low[0] - margin, high[0] + margin, low[2] - margin, high[2] + margin)
            extent = [edge / 1e3 for edge in box]
            panel.imshow(shaded(balls, box, config.width), extent=extent, origin="lower")
            panel.set(xlabel="x [km]", ylabel="height [km]")
            panel.set_title(f"{name}, {balls.count} balls{', grown' if grown else ''}")
    figure.savefig(path, dpi=110)


def shaded(balls: Metaballs, box: tuple[float, ...], width: int) -> np.ndarray:
    """[z, x, 3]: sunlight by the normal, skylight from above, over a sky that pales downward."""
    left, right, bottom, top = box
    height = round(width * (top - bottom) / (right - left))
    # Four rays for each pixel, so that edges are smooth.
    x = np.linspace(left, right, 4 * width + 1)[1::2]
    z = np.linspace(bottom, top, 4 * height + 1)[1::2]
    away = 3 * float(np.abs(np.asarray(balls.centres)).max())
    origin = np.stack(np.broadcast_arrays(x[None, :], -away, z[:, None]), -1).astype(np.float32)
    hit = surface_hit(balls, origin, np.array([0.0, 1.0, 0.0], np.float32))
    met, normal = np.isfinite(hit.distance), np.asarray(hit.normal)
    place = origin[met]
    place[:, 1] += np.asarray(hit.distance)[met]
    place += (top - bottom) * 4e-3 * normal[met]
    toward = (SUN / np.linalg.norm(SUN)).astype(np.float32)
    sun = np.maximum(normal @ toward, 0.0)
    sun[met] *= np.where(np.isfinite(surface_hit(balls, place, toward).distance), 0.25, 1.0)
    sky = 0.5 + 0.5 * normal[..., 2]
    light = 0.72 * sun[..., None] * np.array([1.0, 0.95, 0.87])
    light = light + (0.16 + 0.42 * sky[..., None]) * np.array([0.62, 0.76, 1.0])
    up = np.linspace(0, 1, z.size)[:, None, None]
    behind = (1 - up) * np.array([0.74, 0.85, 0.94]) + up * np.array([0.22, 0.44, 0.74])
    image = np.where(met[..., None], light, np.broadcast_to(behind, light.shape))
    image = image.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
    return np.clip(image, 0.0, 1.0) ** (1 / 1.25)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
