"""Dome pictures and spectra of the measured skies and of the models."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from measured_data import NEAR_SUN, Prediction, Skies

TICKS = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)


def draw_all(folder: Path, skies: Skies, predictions: list[Prediction]) -> list[Path]:
    """Write every picture into the folder and return the paths."""
    paths = []
    for group, scans in skies.groups.items():
        rows = {"measured": skies.luminance[scans] / 1e3}
        rows |= {p.name: p.luminance[scans] / 1e3 for p in predictions}
        paths.append(folder / f"luminance_{group}.png")
        _domes(skies, scans, rows, "luminance [kcd m$^{-2}$]", "viridis", None).savefig(paths[-1])
        rows = {p.name: p.luminance[scans] / skies.luminance[scans] for p in predictions}
        paths.append(folder / f"ratio_{group}.png")
        label = "model luminance / measured luminance"
        _domes(skies, scans, rows, label, "cividis", (1 / 3, 3.0)).savefig(paths[-1])
    paths.append(folder / "spectra.png")
    _spectra(skies, predictions).savefig(paths[-1])
    return paths


def _domes(
    skies: Skies,
    scans: np.ndarray,
    rows: dict[str, np.ndarray],
    label: str,
    colour_map: str,
    limits: tuple[float, float] | None,
) -> Figure:
    """One row of domes for each model, one column for each scan; the sun's side is up."""
    values = np.concatenate([row.ravel() for row in rows.values()])
    low, high = limits or (float(np.percentile(values, 1)), float(values.max()))
    norm = LogNorm(low, high)
    columns = np.flatnonzero(scans)
    names = 0.25 + 0.055 * max(map(len, rows))  # inches, as are the others
    width, height = 1.3 * columns.size + names + 0.2, 1.3 * len(rows) + 1.5
    left = names / width
    figure = Figure(figsize=(width, height), dpi=110)
    grid = figure.subplots(
        len(rows), columns.size, squeeze=False, subplot_kw={"projection": "polar"}
    )
    figure.subplots_adjust(left, 1.05 / height, 0.98, 1 - 0.45 / height, wspace=0.1, hspace=0.1)
    for axes_row, (name, row) in zip(grid, rows.items(), strict=True):
        for axes, scan, sky in zip(axes_row, columns, row, strict=True):
            _dome(axes, skies, scan, mpl.colormaps[colour_map](norm(sky)))
        axes_row[0].set_ylabel(name, rotation=0, ha="right", va="center", labelpad=12, fontsize=8)
    for axes, scan in zip(grid[0], columns, strict=True):
        sun = np.degrees(skies.solar_zenith_angle[scan])
        axes.set_title(f"{skies.time[scan][5:16].replace('T', ' ')}\nsun {sun:.0f}°", fontsize=7)
    bar = figure.colorbar(
        ScalarMappable(norm, colour_map),
        cax=figure.add_axes((left, 0.75 / height, min(0.98 - left, 4 / width), 0.12 / height)),
        orientation="horizontal",
        extend="both" if limits else "min",
        ticks=[tick for tick in TICKS if low <= tick <= high],
        format="%g",
    )
    bar.ax.minorticks_off()
    note = "radius: view zenith angle 0 to 90°\nup: toward the sun"
    bar.set_label(f"{label}\n{note}", fontsize=7)
    return figure


def _dome(axes: Axes, skies: Skies, scan: np.intp, colours: np.ndarray) -> None:
    """Draw each measured direction as its cell of the dome."""
    zenith = np.degrees(skies.view_zenith_angle)
    rings, ring, counts = np.unique(zenith, return_inverse=True, return_counts=True)
    edges = np.concatenate([[0.0], (rings[1:] + rings[:-1]) / 2, [90.0]])
    axes.bar(
        skies.relative_azimuth[scan],
        np.diff(edges)[ring],
        width=(2 * np.pi / counts)[ring],
        bottom=edges[ring],
        color=colours,
        edgecolor=colours,
        linewidth=0.5,
    )
    sun = np.degrees(skies.solar_zenith_angle[scan])
    axes.plot(0.0, sun, marker="*", color="white", markeredgecolor="black", markersize=5, mew=0.4)
    axes.set(theta_offset=np.pi / 2, ylim=(0, 90), xticks=[], yticks=[])


def _spectra(skies: Skies, predictions: list[Prediction]) -> Figure:
    """Spectra averaged over the directions that are not near the sun, and over the scans."""
    far = (skies.scattering_angle >= NEAR_SUN)[..., None]
    figure = Figure(figsize=(10, 4), dpi=110, layout="constrained")
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.95, len(predictions)))
    for axes, (group, scans) in zip(figure.subplots(1, 2), skies.groups.items(), strict=True):

        def mean(radiance: np.ndarray, scans: np.ndarray = scans) -> np.ndarray:
            return 1e3 * radiance[scans].mean(axis=(0, 1), where=far[scans])

        axes.plot(skies.wavelength_nm, mean(skies.radiance), "k", linewidth=2.5, label="measured")
        for k, prediction in enumerate(predictions):
            style = {"color": colours[k], "linestyle": ("-", "--", "-.", ":")[k % 4]}
            axes.plot(
                skies.wavelength_nm, mean(prediction.radiance), label=prediction.name, **style
            )
        axes.set_title(f"{group}: mean over directions more than 10° from the sun", fontsize=9)
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("radiance [mW m$^{-2}$ sr$^{-1}$ nm$^{-1}$]")
    figure.axes[0].legend(fontsize=7)
    return figure
