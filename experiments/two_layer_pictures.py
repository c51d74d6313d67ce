"""Pictures of the two-layer sky: the error of the paper's geometry, spheres, Figures 8 to 13."""

from pathlib import Path
from typing import Any

import numpy as np

import atmofit as af
from atmofit.files import replace_file
from atmofit.media.two_layers import layered_sky, two_layers
from atmofit.optics.spheres import sphere_scattering
from atmofit.render.film import on_film

HEIGHTS = (1e3, 2e3, 8e3)  # [m]
WIDTH = 72
SHARES = (0.25, 0.5, 1.0, 2.0, 4.0)


def draw(path: Path) -> Path:
    """All panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 12.5), layout="constrained")
    upper, lower = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=[1, 2.2])))
    panels = upper.subplots(1, 4, width_ratios=[1, 1, 1, 1.15])
    images = [errors(panel, height) for panel, height in zip(panels, HEIGHTS, strict=False)]
    panels[0].set_ylabel("elevation of the sun [°]")
    upper.colorbar(images[0], ax=panels[:3], label="paper's integral / exact - 1 [%]", shrink=0.9)
    efficiency(panels[3])
    sweeps(lower)
    return replace_file(path, lambda name: figure.savefig(name, dpi=110))


def error_of_the_paper(height: float, view: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Relative error of the haze's light at 550 nm, mean of toward and away, [sun, view]."""
    layers = two_layers(5e-5, height, 9e3, wavelength_nm=(550.0,))
    grid = af.DirectionGrid(np.pi / 2 - view, [0.0, np.pi])
    found = [
        [
            np.asarray(layered_sky(layers, np.pi / 2 - s, grid, blue=[0.0], geometry=g, nodes=48))
            for g in ("paper", "exact")
        ]
        for s in sun
    ]
    return np.array([(paper / exact - 1)[..., 0].mean(axis=1) for paper, exact in found])


def errors(panel: Any, height: float) -> Any:
    """Map over the elevations of view and sun, both on a scale that opens the horizon."""
    view, sun = (np.radians(90 * np.linspace(0, 1, n) ** 2) for n in (61, 41))
    error = 100 * error_of_the_paper(height, view, sun)
    shown = (np.degrees(view), np.degrees(sun), np.clip(error, -100, 100))
    image = panel.pcolormesh(*shown, vmin=-100, vmax=100, cmap="RdBu_r", shading="gouraud")
    lines = panel.contour(*shown[:2], np.abs(error), [1, 10], colors="k", linewidths=0.8)
    panel.clabel(lines, fmt={1: "1 %", 10: "10 %"}, fontsize=8)
    panel.set(xlabel="elevation of the view [°]", title=f"haze up to {height / 1e3:g} km")
    for axis in ("x", "y"):
        getattr(panel, f"set_{axis}scale")("function", functions=(_root, np.square))
        getattr(panel, f"set_{axis}ticks")([0, 1, 5, 15, 30, 60, 90])
    return image


def _root(value: Any) -> Any:
    return np.sqrt(np.maximum(value, 0.0))


def efficiency(panel: Any) -> None:
    """Figure 3."""
    share = np.geomspace(1e-2, 1e2, 500)
    spheres = sphere_scattering(1.333, 2 * np.pi * share, np.zeros(1))
    panel.loglog(share, spheres.scattering_efficiency, color="#1f5fa8")
    panel.axhline(2.0, color="0.6", linewidth=0.8)
    panel.set(xlabel="radius / wavelength [-]", ylabel="scattering efficiency [-]")
    panel.set(ylim=(1e-6, 10), title="water spheres (Figure 3)")


def sky_picture(sun_zenith: float, **changed: Any) -> np.ndarray:
    """What a camera shows, in sRGB: the horizon at its lower edge, the sun in the middle."""
    across, up = np.meshgrid(
        (np.arange(WIDTH) + 0.5) / WIDTH * 2 - 1, 1 - (np.arange(WIDTH // 2) + 0.5) * 2 / WIDTH
    )
    zenith, azimuth = np.arccos(up / np.sqrt(1 + across**2 + up**2)), np.arctan2(across, 1.0)
    layers = two_layers(**changed)
    irradiance = np.asarray(af.solar_irradiance_spectrum("standard")(layers.wavelength_nm))
    directions = af.Directions(zenith.ravel(), azimuth.ravel())
    sky = layered_sky(layers, sun_zenith, directions, solar_irradiance=irradiance)
    xyY = np.asarray(af.spectrum_to_xyY(sky, layers.wavelength_nm))
    return on_film(xyY, float(np.percentile(xyY[:, 2], 70))).reshape(WIDTH // 2, WIDTH, 3)


def sweeps(figure: Any) -> None:
    """Figures 8 to 13: one row each, every picture with its own exposure."""
    sunset, forty = np.radians([88.0, 50.0])
    rows = {
        "haze density\n(sunset)": [(sunset, {"haze_extinction": 5e-5 * x}) for x in SHARES],
        "haze thickness\n(sunset)": [(sunset, {"haze_top": 2e3 * x}) for x in SHARES],
        "air density\n(sunset)": [(sunset, {"air_top": 8.4e3 * x}) for x in SHARES],
        "haze density\n(sun at 40°)": [(forty, {"haze_extinction": 5e-5 * x}) for x in SHARES],
    }
    labels = [[f"x {x:g}" for x in SHARES]] * len(rows)
    rows["elevation\nof the sun"] = [(np.radians(90 - e), {}) for e in (0.0, 2.0, 5.0, 20.0, 60.0)]
    labels.append([f"{e:g}°" for e in (0, 2, 5, 20, 60)])
    panels = figure.subplots(len(rows), len(SHARES))
    for line, (name, pictures), words in zip(panels, rows.items(), labels, strict=True):
        for panel, (sun, changed), word in zip(line, pictures, words, strict=True):
            panel.imshow(sky_picture(float(sun), **changed), interpolation="bilinear")
            panel.set(xticks=[], yticks=[])
            panel.set_title(word, fontsize=9)
        line[0].set_ylabel(name)
