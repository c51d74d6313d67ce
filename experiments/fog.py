"""How wrong are the paper's shortcuts for fog, and how does fog look?

Klassen (1987), sections 9 to 12. The constant way of sunlight in the fog and the flat earth against
exact ones, the time of the closed form against a quadrature, how gray fog is by Mie's theory; and
Figures 15 to 18 staged: balls and posts on a plain, lit from the front and from behind, without and
with fog. Writes result.json, table.md and a picture.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from fog_scene import MIE_NM, stage
from run_files import markdown, write_run

import atmofit as af
from atmofit.constants import EARTH_RADIUS
from atmofit.files import replace_file
from atmofit.media.fog import fog_transfer
from atmofit.media.fog_medium import FogLayer, fog_layer
from atmofit.media.two_layers import shell_distance
from atmofit.numerics import gauss_nodes, mean_decay
from atmofit.optics.mie import mie_optics
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.optics.sizes import modified_gamma_sizes

MODES_UM = (1.0, 1.5, 2.0, 8.0)
PLACES = ((2.0, 10.0), (5.0, 10.0), (10.0, 20.0))  # eye and top of the fog [m]
LAYERS = (100.0, 1e3, 9250.0, 1e5)  # [m]


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    width: int = 420
    """Of each scene [pixels]."""
    samples: int = 2
    """Rays of a pixel, in each direction."""
    pixels: int = 131_072
    """Of the timed images."""
    nodes: int = 32
    """Of the timed quadrature."""
    repeats: int = 7
    """Hot runs, of which the quickest counts."""
    radii: int = 1200
    """Of droplets of mode radius 1 um; of larger ones fewer, down to 400."""
    out: Path = Path("runs/fog")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    rows: list[list[str]] = []
    result: dict[str, Any] = {}
    for eye, top in PLACES:
        error = constant_way(np.radians(np.linspace(3, 30, 109)), np.array([eye]), top)[0]
        result[f"constant way, eye {eye:g} m in {top:g} m"] = ends = [error.max(), error.min()]
        rows.append([f"constant way, eye at {eye:g} m, fog to {top:g} m", percent(*ends)])
    for layer in LAYERS:
        error = float(flat_earth(np.array([layer]), np.radians([15.0]))[0, 0])
        result[f"flat earth, layer of {layer:g} m"] = error
        rows.append([f"flat earth, layer of {layer:g} m, sun at 15°", f"{100 * error:.3f} %"])
    spectra = [extinction_spectrum(mode, config.radii) for mode in MODES_UM]
    for mode, spectrum in zip(MODES_UM, spectra, strict=True):
        result[f"selectivity, mode radius {mode:g} um"] = spread = float(np.ptp(spectrum))
        rows.append(
            [f"extinction, 400 to 700 nm, mode radius {mode:g} µm", f"{100 * spread:.1f} %"]
        )
    result |= (timing := times(config))
    rows += [[name, f"{value:.3g}"] for name, value in timing.items()]
    scenes, looks = stage(config.width, config.samples)
    result |= looks
    rows += [[name, f"{value:.3g}"] for name, value in looks.items()]
    text = markdown(["what", "found"], rows)
    print(text)
    config.out.mkdir(parents=True, exist_ok=True)
    print(draw(config.out / "fog.png", scenes, spectra))
    write_run(config.out, config, result, text + "\n")


def percent(first: float, last: float) -> str:
    """A range of relative errors."""
    return f"{100 * first:.1f} to {100 * last:.1f} %"


def even_fog(top: float) -> FogLayer:
    """Droplets alone, 25 per km."""
    return FogLayer(top, [25e-3], [25e-3], [0.0], [550.0], HenyeyGreenstein(0.85))


def constant_way(down: np.ndarray, eye: np.ndarray, top: float) -> np.ndarray:
    """Relative error of the fog's light with the sun 30 degrees high, [eye, angle downward]."""
    paper, exact = (
        fog_transfer(
            even_fog(top), math.inf, math.pi / 2 + down[None, :], 0.0, math.pi / 3, eye[:, None],
            sunlight=name,
        ).in_scattered[..., 0]
        for name in ("constant", "exact")
    )  # fmt: skip
    return np.asarray(paper / exact) - 1


def flat_earth(layer: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """By how much the cosecant overrates the way through a layer, [elevation, layer]."""
    sine, height = jnp.sin(elevation)[:, None], jnp.asarray(layer)[None, :]
    return np.asarray(height / sine / shell_distance(jnp.asarray(EARTH_RADIUS), height, sine)) - 1


def extinction_spectrum(mode_um: float, radii: int) -> np.ndarray:
    """Of water droplets over its mean, Deirmendjian's exponent 6."""
    sizes = modified_gamma_sizes(mode_um * 1e-6, 6.0)
    count = max(round(radii / mode_um), 400)
    found = mie_optics(sizes, 1.333, MIE_NM, scattering_angle=[0.0, 1.0], radius_count=count)
    return found.extinction_cross_section / found.extinction_cross_section.mean()


def times(config: Config) -> dict[str, float]:
    """Seconds of a gray pixel in single precision, and how far the quadrature is off."""
    random = np.random.default_rng(1)
    down = 10 ** random.uniform(-3.7, -0.3, config.pixels)
    distance = np.minimum(10 ** random.uniform(0.0, 4.0, config.pixels), 2.0 / np.sin(down))
    fog = fog_layer("thin", 10.0)

    def closed(fog: FogLayer, far: Any, down: Any) -> Any:
        return fog_transfer(fog, far, math.pi / 2 + down, 0.0, 1.0, 2.0).in_scattered[:, 0]

    def nodes(fog: FogLayer, far: Any, down: Any) -> Any:
        return by_quadrature(fog, far, down, 1.0, 2.0, config.nodes)

    def bare(fog: FogLayer, far: Any, down: Any) -> Any:
        return by_closed_form(fog, far, down, 1.0, 2.0)

    exact, found, alone = (
        np.asarray(jax.jit(f)(fog, distance, down)) for f in (closed, nodes, bare)
    )
    result = {"largest error of the quadrature": float(np.abs(found / alone - 1).max())}
    whole = alone * np.asarray(scattering(fog, down, 1.0))
    assert np.abs(whole / exact - 1).max() < 1e-11
    with jax.enable_x64(False):
        single = tuple(jnp.asarray(x, jnp.float32) for x in (distance, down))
        runs = {
            "fog_transfer, all of it": closed,
            "integral, closed form": bare,
            f"integral, {config.nodes} nodes": nodes,
        }
        for name, function in runs.items():
            result[f"{name} [s/pixel]"] = quickest(
                config, jax.jit(function), fog.in_dtype(np.float32), *single
            )
    return result


def by_quadrature(fog: FogLayer, far: Any, down: Any, sun: float, eye: float, count: int) -> Any:
    """Integral of transmittance to sun and eye, from an eye in fog, by Gauss-Legendre nodes [m]."""

    def add(total: Any, at: Any) -> tuple[Any, None]:
        node, weight = at
        return total + weight * jnp.exp(-depth_at(fog, node * far, down, sun, eye)), None

    rule = tuple(jnp.asarray(x, far.dtype) for x in gauss_nodes(count))
    total, _ = jax.lax.scan(add, jnp.zeros_like(far), rule)
    return far * total


def by_closed_form(fog: FogLayer, far: Any, down: Any, sun: float, eye: float) -> Any:
    """The same without a general geometry: the depth changes linearly along the way."""
    first, last = (depth_at(fog, x, down, sun, eye) for x in (jnp.zeros_like(far), far))
    mean = jnp.exp(-jnp.minimum(first, last)) * mean_decay(jnp.abs(last - first))
    return far * mean


def depth_at(fog: FogLayer, way: Any, down: Any, sun: float, eye: float) -> Any:
    """Optical depth from the sun to a place on the line of sight, and on to the eye."""
    air, drops = fog.molecular_extinction[0], fog.extinction[0]
    z = eye - way * jnp.sin(down)
    arriving = (air * (fog.air_top - z) + drops * (fog.top - z)) / math.cos(sun)
    return arriving + (air + drops) * way


def scattering(fog: FogLayer, down: Any, sun: float) -> Any:
    """Coefficient per solid angle [1/m/sr]."""
    angle = af.scattering_angle(math.pi / 2 + down, 0.0, sun)
    air, drops = fog.molecular_extinction[0], fog.scattering[0]
    return air * af.Rayleigh()(angle) + drops * fog.phase(angle)


def quickest(config: Config, function: Callable[..., Any], *arguments: Any) -> float:
    """Of some hot runs, for each pixel [s]."""
    jax.block_until_ready(function(*arguments))
    taken = []
    for _ in range(config.repeats):
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        taken.append(time.perf_counter() - begin)
    return min(taken) / config.pixels


def draw(path: Path, scenes: list[tuple[str, np.ndarray]], spectra: list[np.ndarray]) -> Path:
    """The four scenes, two maps of errors and how gray fog is."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 11.2), layout="constrained")
    upper, lower = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=[1.95, 1])))
    for panel, (title, picture) in zip(upper.subplots(2, 2).flat, scenes, strict=True):
        panel.imshow(picture)
        panel.set(title=title, xticks=[], yticks=[])
    panels = lower.subplots(1, 3)
    _draw_constant_way(lower, panels[0])
    _draw_flat_earth(lower, panels[1])
    for mode, spectrum in zip(MODES_UM, spectra, strict=True):
        panels[2].plot(MIE_NM, spectrum, label=f"{mode:g} µm")
    panels[2].legend(title="mode radius", fontsize=8)
    panels[2].set(xlabel="wavelength [nm]", ylabel="extinction / its mean [-]")
    panels[2].set_title("water droplets are nearly gray\n")
    return replace_file(path, lambda name: figure.savefig(name, dpi=120))


def _draw_constant_way(figure: Any, panel: Any) -> None:
    down, eye = np.geomspace(0.5, 60, 90), np.linspace(0.05, 10, 80)
    error = 100 * constant_way(np.radians(down), eye, 10.0)
    panel.set(xscale="log", xlabel="view below the horizon [°]", ylabel="eye above the ground [m]")
    image = panel.pcolormesh(down, eye, error, cmap="cividis", shading="gouraud")
    lines = panel.contour(
        down, eye, error, [-30, -20, -15, -10, -5, -2], colors="w", linewidths=0.8
    )
    panel.clabel(lines, fmt="%g %%", fontsize=8)
    panel.set_title("sunlight's way taken as constant\n10 m of fog, 25 per km, sun at 30°")
    panel.set_xticks([0.5, 1, 3, 10, 30], ["0.5", "1", "3", "10", "30"])
    figure.colorbar(image, ax=panel, label="fog's light, paper / exact - 1 [%]")


def _draw_flat_earth(figure: Any, panel: Any) -> None:
    from matplotlib.colors import LogNorm

    elevation, layer = np.geomspace(0.5, 60, 90), np.geomspace(10, 1e5, 90)
    error = 100 * flat_earth(layer, np.radians(elevation)).T
    panel.set(xscale="log", yscale="log", xlabel="elevation of the sun [°]", ylabel="layer [m]")
    image = panel.pcolormesh(
        elevation, layer, error, cmap="cividis", norm=LogNorm(1e-4, 1e2), shading="gouraud"
    )
    lines = panel.contour(elevation, layer, error, [0.01, 0.1, 1, 10], colors="w", linewidths=0.8)
    panel.clabel(lines, fmt="%g %%", fontsize=8)
    panel.set_title("earth taken as flat\n")
    panel.set_xticks([0.5, 1, 3, 15, 60], ["0.5", "1", "3", "15", "60"])
    figure.colorbar(image, ax=panel, label="way, flat / round - 1 [%]")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
