"""The pictures of a refit: coefficients, residuals, comparison, zenith curves, skies.

Each function returns a figure; `refit_pictures` draws them all as PNG bytes.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import QUANTITIES, SimulatedSkies
from atmofit.models.preetham import CANDELA_PER_KILOCANDELA, PREETHAM_1999, PreethamModel
from atmofit.render import heat_maps
from atmofit.render.coefficients import PUBLISHED, REGENERATED, draw_matrices
from atmofit.render.image import new_figure, png_bytes, style
from atmofit.render.panorama import DIFFERENCES, draw_dome, draw_sky

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RESIDUAL_NAMES = {"Y": "luminance", "x": "x", "y": "y"}
_UNITS = {"Y": "Y [kcd m⁻²]", "x": "x [-]", "y": "y [-]"}


def refit_pictures(result: RefitResult) -> dict[str, bytes]:
    """All pictures of a refit, as PNG by file name."""
    with style(), jax.enable_x64(True):
        figures = {"matrices.png": draw_matrices(result)}
        for quantity, name in RESIDUAL_NAMES.items():
            figures[f"residuals_{name}.png"] = draw_residuals(result, quantity)
        figures["comparison.png"] = heat_maps.draw_comparison(
            result.comparisons, result.skies.settings
        )
        figures["zenith.png"] = draw_zenith(result)
        figures["skies.png"] = draw_skies(result.skies)
        return {name: png_bytes(figure) for name, figure in figures.items()}


def nearest(values: Sequence[float], wanted: Sequence[float]) -> list[int]:
    """Indices of the values nearest to the wanted ones, each once, in increasing value."""
    found = {int(np.abs(np.asarray(values) - one).argmin()) for one in wanted}
    return sorted(found, key=lambda index: values[index])


def draw_residuals(
    result: RefitResult,
    quantity: str,
    *,
    turbidity: Sequence[float] | None = None,
    solar_zenith_angle_deg: Sequence[float] = (0.0, 48.0, 80.0),
) -> "Figure":
    """Regenerated minus simulated over the dome, one dome for each turbidity and sun.

    Args:
        result: Of the refit.
        quantity: "Y" (in percent of the simulation), "x" or "y".
        turbidity: The simulated ones nearest to these. None: lowest, middle and highest.
        solar_zenith_angle_deg: Likewise [degree].
    """
    s = result.skies.settings
    low, high = min(s.turbidity), max(s.turbidity)
    rows = nearest(s.turbidity, turbidity or (low, (low + high) / 2, high))
    columns = nearest(s.solar_zenith_angle_deg, solar_zenith_angle_deg)
    with jax.enable_x64(True):
        residuals = result.residuals[..., QUANTITIES.index(quantity)]
    if quantity == "Y":
        residuals = 100 * residuals / result.skies.quantity("Y")
    shown = residuals[np.ix_(rows, columns)]
    # A few directions beside the sun would otherwise bleach the rest.
    reach = float(np.nanpercentile(np.abs(shown), 99)) or 1.0
    figure = new_figure(2.55 * len(columns) + 1.3, 2.55 * len(rows) + 0.4)
    axes = figure.subplots(len(rows), len(columns), squeeze=False)
    image = None
    for (i, j), ax in np.ndenumerate(axes):
        sun = s.solar_zenith_angle_deg[columns[j]]
        image = draw_dome(
            ax, result.skies.directions, shown[i, j], limits=(-reach, reach),
            colour_map=DIFFERENCES, solar_zenith_angle=np.radians(sun),
        )  # fmt: skip
        rms = np.sqrt(np.mean(shown[i, j] ** 2))
        size = f"{rms:.0f} %" if quantity == "Y" else f"{rms:.4f}"
        ax.set_title(f"T = {s.turbidity[rows[i]]:g}, sun {sun:g}°: rms {size}")
    assert image is not None
    label = "Y: (regenerated − simulated) / simulated [%]"
    if quantity != "Y":
        label = f"{quantity}: regenerated − simulated [-]"
    figure.colorbar(image, ax=axes, label=label, extend="both", shrink=0.6, aspect=30)
    return figure


def draw_zenith(result: RefitResult, *, panels: int = 5) -> "Figure":
    """Zenith values against the sun's angle, simulation and both models, for each turbidity."""
    s = result.skies.settings
    chosen = nearest(s.turbidity, np.linspace(min(s.turbidity), max(s.turbidity), panels).tolist())
    suns = np.asarray(s.solar_zenith_angle_deg)
    curve = np.linspace(suns.min(), suns.max(), 100)
    figure = new_figure(1.0 + 2.05 * len(chosen), 6.6)
    axes = figure.subplots(3, len(chosen), sharex=True, sharey="row", squeeze=False)
    for (i, j), ax in np.ndenumerate(axes):
        quantity = ("Y", "x", "y")[i]
        T, scale = s.turbidity[chosen[j]], CANDELA_PER_KILOCANDELA if quantity == "Y" else 1.0
        points = result.skies.zenith[chosen[j], :, QUANTITIES.index(quantity)] / scale
        ax.plot(suns, points, "o", ms=4, mfc="none", mec="black", label="simulation")
        for model, name, colour, line in (
            (PREETHAM_1999, "published", PUBLISHED, "--"),
            (result.model, "regenerated", REGENERATED, "-"),
        ):
            values = _zenith_curve(model, T, curve)[:, QUANTITIES.index(quantity)] / scale
            ax.plot(curve, values, line, color=colour, lw=1.5, label=name)
        if i == 0:
            ax.set_title(f"T = {T:g}")
        if i == 2:
            ax.set_xlabel("sun from zenith [°]")
            ax.set_xticks([0, 30, 60, 90])
        if j == 0:
            ax.set_ylabel(f"zenith {_UNITS[quantity]}")
        if quantity == "Y":
            ax.set_yscale("log", nonpositive="mask")
            ax.yaxis.set_major_formatter("{x:g}")
        ax.grid(alpha=0.25, lw=0.5)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _zenith_curve(model: PreethamModel, turbidity: float, suns_deg: np.ndarray) -> np.ndarray:
    """x, y, Y at the zenith, [sun, 3]; NaN where the model is not valid."""
    low, high = model.turbidity_range
    if not low <= turbidity <= high:
        return np.full((*suns_deg.shape, 3), np.nan)
    with jax.enable_x64(True):
        return np.asarray(model.zenith(turbidity, np.radians(suns_deg)))


def draw_skies(
    skies: SimulatedSkies,
    *,
    turbidity: Sequence[float] | None = None,
    solar_zenith_angle_deg: Sequence[float] = (0.0, 48.0, 72.0, 87.0),
) -> "Figure":
    """Simulated skies in their colours; all skies of one sun share one exposure."""
    s = skies.settings
    low, high = min(s.turbidity), max(s.turbidity)
    rows = nearest(s.turbidity, turbidity or (low, (low + high) / 2, high))
    columns = nearest(s.solar_zenith_angle_deg, solar_zenith_angle_deg)
    figure = new_figure(2.3 * len(columns) + 0.5, 2.3 * len(rows) + 0.5)
    axes = figure.subplots(len(rows), len(columns), squeeze=False)
    for (i, j), ax in np.ndenumerate(axes):
        sun = s.solar_zenith_angle_deg[columns[j]]
        white = exposure(skies.quantity("Y")[rows, columns[j]])
        draw_sky(
            ax, skies.directions, skies.xyY[rows[i], columns[j]], white_luminance=white,
            solar_zenith_angle=np.radians(sun),
        )  # fmt: skip
        if i == 0:
            kilo = white / CANDELA_PER_KILOCANDELA
            ax.set_title(f"sun {sun:g}°, exposure {kilo:.2g} kcd m⁻²")
        if j == 0:
            ax.text(
                -0.02, 0.5, f"T = {s.turbidity[rows[i]]:g}", transform=ax.transAxes,
                rotation=90, ha="right", va="center",
            )  # fmt: skip
    return figure


def exposure(luminance: Any) -> float:
    """A white luminance that shows a typical direction of these skies in a middle tone."""
    return 2.0 * float(np.exp(np.mean(np.log(luminance))))
