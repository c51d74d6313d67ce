"""The report of an estimate: data, model, residuals and the profile of turbidity on one page."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from atmofit.fit.judgement import Judgement
from atmofit.render import html
from atmofit.render.image import new_figure, png_bytes, save_bytes, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_THRESHOLD = 3.84  # of the rise of the loss, at the ends of the 95 % interval
_CAPTION = (
    "Measured sky, model at its best, and what is left, in percent and in standard deviations of "
    "what the posterior predicts for a measurement (noise, model error and unknowns together), in "
    "each direction that was used; zenith in the middle, circles at 30°, 60° and the horizon, sun "
    "at the top (orange ring). Right: rise of "
    "the sum of squares against turbidity with all other unknowns at their best; dotted the "
    "parabola of the standard error; grey the 95 % interval, widened where residuals ask for it."
)


def write_turbidity_report(found: Sequence[Judgement], folder: Path) -> list[Path]:
    """Write report.html, turbidity.json and a picture for each sky.

    Raises:
        OSError: A file cannot be written; no part of it is left behind.
    """
    pictures = []
    with style():
        for judgement in found:
            pictures.append(png_bytes(estimate_picture(judgement)))
    numbers = {"skies": [judgement.numbers() for judgement in found]}
    files: dict[str, bytes] = {
        "report.html": report_page(found, pictures).encode(),
        "turbidity.json": (json.dumps(numbers, indent=1) + "\n").encode(),
    }
    for k, picture in enumerate(pictures):
        files[f"sky_{k + 1:02d}.png"] = picture
    return [save_bytes(content, folder / name) for name, content in files.items()]


def report_page(found: Sequence[Judgement], pictures: Sequence[bytes]) -> str:
    """The page, which needs no other file."""
    head = ["sky", "turbidity", "95 % interval", "haze optical depth, 550 nm", "rms", "chi-square"]
    rows = []
    for judgement in found:
        n = judgement.numbers()
        low, high = n["turbidity_interval_95"]
        told = not judgement.refusal
        rows.append(
            [
                n["sky"],
                f"{n['turbidity']:.2f}" if told else "refused",
                f"{low:.2f} to {high:.2f}" if told else "",
                f"{n['haze_optical_depth_550']:.3f}" if told else "",
                f"{n['rms']:.1%}",
                f"{n['reduced_chi_square']:.2f}",
            ]
        )
    parts = [html.paragraph(f"Model: {found[0].profile.estimate.model}."), html.table(head, rows)]
    for judgement, picture in zip(found, pictures, strict=True):
        parts += [html.heading(judgement.name), html.paragraph(judgement.sentence() + ".")]
        said = [*judgement.warnings, *judgement.notes]
        if said:
            parts.append(html.bullets(line[0].upper() + line[1:] + "." for line in said))
        unknowns = judgement.numbers()["unknowns"]
        if len(unknowns) > 1:
            cells = [
                [name, f"{one['value']:.4g}", f"{one['standard_error']:.2g}"]
                for name, one in unknowns.items()
            ]
            parts.append(html.table(["unknown", "value", "standard error"], cells))
        parts.append(html.picture(picture, _CAPTION))
    return html.page("Turbidity of measured skies", parts)


def estimate_picture(judgement: Judgement) -> "Figure":
    """Four domes and the profile."""
    estimate, observation = judgement.profile.estimate, judgement.observation
    channel = _middle_channel(judgement)
    log_ratio = np.asarray(estimate.log_ratio)[..., channel].ravel()
    explained = np.asarray(estimate.explained)[..., channel].ravel()
    seen = np.isfinite(log_ratio)
    view, azimuth = (np.asarray(a).ravel()[seen] for a in observation.directions.angles())
    measured = np.log10(np.asarray(observation.by_channel)[..., channel].ravel()[seen])
    left = (log_ratio - explained)[seen]
    standardised = np.asarray(estimate.standardised)[..., channel].ravel()[seen]
    model = measured + left / np.log(10)
    values = dict(zip(estimate.names, np.asarray(estimate.parameters), strict=True))
    sun = (
        float(values.get("solar_zenith_angle", observation.solar_zenith_angle)),
        float(values.get("solar_azimuth", 0.0)),
    )
    figure = new_figure(13.0, 3.1)
    axes = figure.subplots(1, 5, width_ratios=[1, 1, 1, 1, 1.15])
    limits = {"vmin": float(measured.min()), "vmax": float(measured.max())}
    name = observation.channel_names[channel]
    for ax, shown, title in ((axes[0], measured, "measured"), (axes[1], model, "model")):
        points = _dome(ax, view, azimuth, shown, sun, cmap="cividis", **limits)
        ax.set_title(f"{title}: log₁₀ {name}")
        figure.colorbar(points, ax=ax, shrink=0.7)
    for ax, shown, title in (
        (axes[2], 100 * left, "ln(model / measured) [%]"),
        (axes[3], standardised, "the same [predicted σ]"),
    ):
        size = max(1.0, float(np.percentile(np.abs(shown), 98)))
        points = _dome(ax, view, azimuth, shown, sun, cmap="RdBu_r", vmin=-size, vmax=size)
        ax.set_title(title)
        figure.colorbar(points, ax=ax, shrink=0.7)
    _profile(axes[4], judgement)
    return figure


def _middle_channel(judgement: Judgement) -> int:
    """Luminance, Y, green, or the wavelength nearest to 550 nm."""
    λ = judgement.observation.wavelength_nm
    if λ is not None:
        return int(np.argmin(np.abs(np.asarray(λ) - 550.0)))
    return len(judgement.observation.channel_names) // 2


def _dome(
    ax: "Axes",
    view: np.ndarray,
    azimuth: np.ndarray,
    values: np.ndarray,
    sun: tuple[float, float],
    **colours: Any,
) -> Any:
    """Directions as dots; where the sun stands above the picture's top as it was given."""
    ring = np.linspace(0, 2 * np.pi, 181)
    for radius in (30.0, 60.0, 90.0):
        ax.plot(radius * np.sin(ring), radius * np.cos(ring), color="#bbbbbb", lw=0.5, zorder=0)
    z = np.degrees(view)
    dots = 90.0 * (60.0 / max(view.size, 40)) ** 0.9
    points = ax.scatter(z * np.sin(azimuth), z * np.cos(azimuth), c=values, s=dots, **colours)
    at = np.degrees(sun[0])
    ax.plot(at * np.sin(sun[1]), at * np.cos(sun[1]), "o", mfc="none", mec="#e66100", mew=1.4, ms=8)
    ax.set(xlim=(-97, 97), ylim=(-97, 97), aspect="equal")
    ax.axis("off")
    return points


def _profile(ax: "Axes", judgement: Judgement) -> None:
    profile, estimate = judgement.profile, judgement.profile.estimate
    T, rise = np.asarray(profile.turbidity), np.asarray(profile.rise)
    wider = max(1.0, float(estimate.reduced_chi_square))
    low, high = judgement.interval
    ax.axvspan(low, high, color="#dddddd", lw=0)
    ax.plot(T, rise / wider, color="#1a5fb4")
    parabola = ((T - float(estimate.value)) / float(estimate.standard_error)) ** 2 / wider
    ax.plot(T, parabola, ":", color="#555555")
    ax.axhline(_THRESHOLD, color="#999999", lw=0.6)
    reach = 1.3 * max(high - float(estimate.value), float(estimate.value) - low)
    ax.set(
        xlabel="turbidity T [-]",
        ylabel="rise of the loss [-]",
        ylim=(0, 8),
        xlim=(float(estimate.value) - reach, float(estimate.value) + reach),
    )
