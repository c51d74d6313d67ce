"""What a trained sky model is worth: a table, and a map of its errors over turbidity and sun."""

from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np

from atmofit.fit.training import TrainedModel
from atmofit.render.image import new_figure, png_bytes, save_bytes, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GOOD_PERCENT, _POOR_PERCENT = 0.0, 10.0  # ends of the colour scale


def luminance_errors(trained: TrainedModel) -> np.ndarray:
    """Model over simulated luminance less 1, [turbidity, albedo, sun, direction]."""
    skies, model = trained.skies, trained.model.only("colours")
    with jax.enable_x64(True):
        place = skies.place

        @jax.jit
        def luminance(T: jax.Array, sun: jax.Array, albedo: jax.Array) -> jax.Array:
            return model.XYZ(T, sun, skies.directions, albedo)[..., 1]

        modelled = np.asarray(jax.lax.map(lambda at: luminance(*at), place))
    s = skies.settings
    table = (len(s.turbidity), len(s.albedo), len(s.solar_zenith_angle_deg), -1)
    return (modelled / skies.XYZ()[..., 1] - 1).reshape(table)


def training_text(trained: TrainedModel, errors: np.ndarray) -> str:
    """The table in Markdown."""
    s, fit = trained.skies.settings, trained.fit
    size = np.abs(errors)
    overall = (
        f"Luminance against the simulation, {errors[..., 0].size} skies of {errors.shape[-1]} "
        f"directions: rms {_percent(_rms(errors))}, 99th percentile "
        f"{_percent(np.percentile(size, 99))}, largest {_percent(size.max())}."
    )
    rows = ["| solar zenith angle | rms | 99th percentile |", "|---|---|---|"]
    for k, sun in enumerate(s.solar_zenith_angle_deg):
        part = errors[:, :, k]
        rows.append(
            f"| {sun:g}° | {_percent(_rms(part))} | {_percent(np.percentile(abs(part), 99))} |"
        )
    model = trained.model
    counts = f"{model.coefficients.shape[0]} channels of {model.coefficients[0].size} coefficients"
    done = f"{int(np.sum(fit.converged))} of {fit.converged.size} fits converged"
    best = np.min(fit.start_loss)
    same = int(np.sum(fit.start_loss < 1.01 * best))
    starts = f"{same} of {fit.start_loss.size} starts end within 1 % of the lowest loss"
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in trained.seconds.items())
    facts = f"{counts}; {done}; {starts}. Seconds: {seconds}."
    return "\n".join([overall, "", *rows, "", facts])


def error_map(trained: TrainedModel, errors: np.ndarray) -> "Figure":
    """Root mean square error of luminance over the dome, by turbidity and sun, for each ground."""
    s = trained.skies.settings
    figure = new_figure(3.6 * len(s.albedo) + 1, 3.6)
    axes = figure.subplots(1, len(s.albedo), sharey=True, squeeze=False)[0]
    image = None
    for k, (axis, albedo) in enumerate(zip(axes, s.albedo, strict=True)):
        rms = 100 * np.sqrt(np.mean(errors[:, k] ** 2, axis=-1))
        image = axis.imshow(
            rms,
            aspect="auto",
            origin="lower",
            cmap="cividis",
            vmin=_GOOD_PERCENT,
            vmax=_POOR_PERCENT,
        )
        axis.set_title(f"ground albedo {albedo:g}")
        axis.set_xlabel("solar zenith angle [°]")
        axis.set_xticks(range(len(s.solar_zenith_angle_deg)))
        axis.set_xticklabels([f"{sun:g}" for sun in s.solar_zenith_angle_deg], rotation=90)
        axis.set_yticks(range(len(s.turbidity)), [f"{T:g}" for T in s.turbidity])
    axes[0].set_ylabel("turbidity")
    if image is not None:
        figure.colorbar(image, ax=list(axes), label="rms error of luminance over the dome [%]")
    return figure


def write_training_report(trained: TrainedModel, folder: Path) -> tuple[str, list[Path]]:
    """Write table.md and errors.png; the table, and the paths."""
    errors = luminance_errors(trained)
    text = training_text(trained, errors)
    table = save_bytes((text + "\n").encode(), folder / "table.md")
    with style():
        picture = save_bytes(png_bytes(error_map(trained, errors)), folder / "errors.png")
    return text, [table, picture]


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _percent(value: float | np.floating) -> str:
    return f"{100 * value:.1f} %"
