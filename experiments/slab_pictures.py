"""What do Blinn's layers of particles look like?

Four pictures after his paper of 1982: polar plots of the light that a slab scatters (his Figure 8),
Saturn's rings from the lit and the unlit side (9), a planet under a textured cloud layer (10), and
the full moon beside Lambert's. All single scattering. The ring profile is synthetic, after typical
values; planet, clouds and squares are made up. Writes result.json, table.md and the pictures.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from run_files import markdown, write_run
from slab_scenes import PLANET_ALBEDO, cloudy_planet, full_moon, saturn

from atmofit.files import replace_file
from atmofit.media.slab import slab_single_scattering

INCIDENT_DEG = (36.0, 72.0, 108.0, 144.0)
DEPTHS = (1000.0, 2.0, 0.5, 0.1)
LINE = "#1f5fa8"


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    rows: int = 500
    """Of each picture of a planet."""
    seed: int = 1
    out: Path = Path("runs/slab_pictures")


def main(config: Config) -> None:
    """Draw, measure, print and write."""
    config.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {"polar": polar(config.out / "slab_polar.png")}
    found["rings"] = rings(config, config.out / "rings.png")
    found["cloudy_planet"] = clouds(config, config.out / "cloudy_planet.png")
    found["moon"] = moon(config, config.out / "moon.png")
    rows = [
        [picture, name, f"{value:.4g}"]
        for picture, values in found.items()
        for name, value in values.items()
    ]
    text = markdown(["picture", "quantity", "value"], rows)
    print(text)
    write_run(config.out, config, found, text + "\n")


def scattered(depth: float, incident_deg: float, emission: np.ndarray) -> np.ndarray:
    """B times the cosine of emission, with a phase function and an albedo of 1.

    Emission angles run from 0 on the upper side, which the incident angle counts from, to pi below.
    """
    cosine = np.cos(emission)
    upper = np.maximum(np.abs(cosine), 1e-6)
    sun = np.where(cosine > 0, 1.0, -1.0) * math.cos(math.radians(incident_deg))
    return np.asarray(slab_single_scattering(depth, upper, sun)) * upper


def polar(path: Path) -> dict[str, float]:
    """Figure 8: sixteen polar plots, and how the slab turned over compares."""
    from matplotlib.figure import Figure

    angle = ((np.arange(720) + 0.5) / 360 - 1) * math.pi  # none is level
    figure = Figure(figsize=(11, 11.6), layout="constrained")
    grid = figure.subplots(4, 4, subplot_kw={"projection": "polar"})
    most = 0.0
    for row, depth in zip(grid, DEPTHS, strict=True):
        for ax, incident in zip(row, INCIDENT_DEG, strict=True):
            size = scattered(depth, incident, np.abs(angle))
            ax.set_theta_zero_location("N")
            ax.set_theta_direction(-1)
            ax.plot(angle, size, color=LINE, linewidth=1.2)
            ax.fill(angle, size, color=LINE, alpha=0.25, linewidth=0)
            ax.plot([math.pi / 2] * 2 + [-math.pi / 2], [0.5, 0, 0.5], color="0.4", linewidth=2.5)
            ax.annotate(
                "",
                (math.radians(incident), 0.02),
                (math.radians(incident), 0.5),
                arrowprops={"arrowstyle": "->", "color": "#c8553d", "linewidth": 1.4},
            )
            ax.set_ylim(0, 0.5)
            ax.set_yticks([0.25, 0.5])
            ax.set_xticks([])
            ax.tick_params(labelsize=7)
            ax.set_title(f"depth {depth:g}, light from {incident:g} deg", fontsize=9)
            turned = scattered(depth, 180 - incident, math.pi - np.abs(angle))
            most = max(most, float(np.abs(size - turned).max()))
    figure.suptitle("B cos(emission) of a slab [-], phase function and albedo 1 (Blinn's Figure 8)")
    replace_file(path, lambda name: figure.savefig(name, dpi=90))
    up = np.array([0.0])
    return {
        "largest difference, slab turned over": most,
        "depth 1000, 36 deg, straight up": float(scattered(1000.0, 36.0, up)[0]),
        "depth 0.1, 36 deg, straight up": float(scattered(0.1, 36.0, up)[0]),
        "depth 0.1, 144 deg, straight up": float(scattered(0.1, 144.0, up)[0]),
        "depth 1000, 144 deg, straight up": float(scattered(1000.0, 144.0, up)[0]),
    }


def rings(config: Config, path: Path) -> dict[str, float]:
    """Figure 9: Saturn's rings, lit and unlit side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 9.4), layout="constrained")
    found = {}
    upper, lower = figure.subplots(2, 1)
    for ax, name, solar_elevation in ((upper, "lit", 20.0), (lower, "unlit", -20.0)):
        scene = saturn(config.rows, solar_elevation, view_elevation=14.0)
        extent = [edge / 1e6 for edge in scene.extent]
        white = np.quantile(scene.brightness[scene.ring], 0.999)
        shown = np.clip(scene.brightness / white, 0, 1) ** (1 / 2.2)
        ax.imshow(shown, cmap="gray", extent=extent, vmin=0, vmax=1)
        ax.set_title(
            f"{name} side, B up to {white:.2g} shown as white, phase angle "
            f"{math.degrees(scene.phase_angle):.0f} deg",
            fontsize=10,
        )
        ax.set_xlabel("across [1,000 km]")
        ax.set_ylabel("up [1,000 km]")
        for part, value in scene.parts.items():
            found[f"{name} side, B of the {part}"] = value
    figure.suptitle(
        "Rings like Saturn's by single scattering: synthetic profile after typical values,\n"
        f"around a Lambert sphere of albedo {PLANET_ALBEDO:g}"
    )
    replace_file(path, lambda name: figure.savefig(name, dpi=90))
    return found


def clouds(config: Config, path: Path) -> dict[str, float]:
    """Figure 10: squares, clouds, and squares under clouds."""
    from matplotlib.figure import Figure

    scene = cloudy_planet(config.rows, config.seed)
    figure = Figure(figsize=(12, 4.1), layout="constrained")
    panels = (
        ("planet's surface", scene.surface),
        ("cloud layer", scene.layer),
        ("planet under clouds", scene.both),
    )
    for ax, (title, picture) in zip(figure.subplots(1, 3), panels, strict=True):
        ax.imshow(np.clip(picture, 0, 1) ** (1 / 2.2), extent=[-1, 1, -1, 1])
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("across [planet's radii]")
        ax.set_ylabel("up [planet's radii]")
    replace_file(path, lambda name: figure.savefig(name, dpi=90))
    return scene.limb


def moon(config: Config, path: Path) -> dict[str, float]:
    """Full and half moon of dust, beside Lambert's."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.6), layout="constrained", facecolor="white")
    axes = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.5])
    found = {}
    for ax, (law, phase) in zip(
        axes, (("dust", 0.0), ("Lambert", 0.0), ("dust", 60.0)), strict=False
    ):
        picture = full_moon(config.rows, law, math.radians(phase))
        shown = np.nan_to_num(picture / np.nanmax(picture)) ** (1 / 2.2)
        ax.imshow(shown, cmap="gray", vmin=0, vmax=1, extent=[-1, 1, -1, 1])
        ax.set_title(f"{law}, phase angle {phase:g} deg", fontsize=10)
        ax.set_xlabel("across [moon's radii]")
        if phase:
            continue
        middle = picture[config.rows // 2]
        across = (np.arange(config.rows) + 0.5) * 2 / config.rows - 1
        axes[3].plot(across, middle / middle[config.rows // 2], label=law)
        at = np.argmin(np.abs(across - 0.95))
        found[f"full moon, {law}: brightness at 0.95 of the radius over the centre"] = float(
            middle[at] / middle[config.rows // 2]
        )
    axes[0].set_ylabel("up [moon's radii]")
    axes[3].set_ylim(0, 1.1)
    axes[3].set_box_aspect(0.7)
    axes[3].set_xlabel("across the full moon [moon's radii]")
    axes[3].set_ylabel("brightness over the centre's [-]")
    axes[3].legend(loc="lower center", frameon=False)
    replace_file(path, lambda name: figure.savefig(name, dpi=90))
    return found


if __name__ == "__main__":
    main(tyro.cli(Config))
