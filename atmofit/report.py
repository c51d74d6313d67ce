"""The report of a refit: pictures, and one page that holds them with the numbers and a verdict."""

import datetime
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from atmofit.fit.dataset import versions
from atmofit.fit.movement import stored_movements
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import RefitSettings
from atmofit.render import html, identifiability, verdict
from atmofit.render.coefficients import DISTRIBUTIONS
from atmofit.render.image import save_bytes
from atmofit.render.refit_pictures import refit_pictures
from atmofit.render.text import (
    coefficient_rows,
    comparison_text,
    condition,
    number,
    summary_text,
    zenith_rows,
)
from atmofit.render.verdict_pictures import verdict_pictures

__all__ = ["comparison_text", "report_html", "summary_text", "write_report"]

_TRIPLE = ("published", "regenerated", "standard error")
_CAPTIONS = {
    "matrices.png": "Every coefficient as published and as regenerated. The bars are two standard "
    "errors of the fits, which take residuals as independent.",
    "zenith.png": "Luminance and chromaticity at the zenith against the sun's angle, one column "
    "for each turbidity. The luminance axis is logarithmic.",
    "residuals_luminance.png": "Regenerated minus simulated luminance over the dome, relative. "
    "Zenith in the middle, horizon outside, the white dot is the sun; the half circle that was "
    "simulated is mirrored. Colours end at the 99th percentile.",
    "residuals_x.png": "The same for the chromaticity x, absolute.",
    "residuals_y.png": "The same for the chromaticity y, absolute.",
    "skies.png": "The simulated skies in sRGB. A luminance Y is shown as 1 - exp(-Y / exposure) "
    "of the screen's white; the skies of one sun share their exposure.",
}
_IDENTIFIABILITY_CAPTION = (
    "Top: where the search from each random start ended, over the lowest loss; the dotted line is "
    "1 %. Below: the loss against the two least determined parameters, all others at their best "
    "(of skies fitted alone: of the one determined worst); dashed the parabola of the standard "
    "error, dotted the threshold of the 95 % interval."
)


def write_report(result: RefitResult, folder: str | Path) -> list[Path]:
    """Write the pictures of a refit and report.html, which holds them all and needs no other file.

    Args:
        result: Of the refit.
        folder: Where to; made if it is missing. Files of the same names are replaced.

    Returns:
        The paths: report.html, then the pictures.

    Raises:
        OSError: The folder or a file in it cannot be written; no part of a file is left behind.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {
        **refit_pictures(result),
        **verdict_pictures(result, stored_movements()),
    }
    if result.identifiability:
        pictures["identifiability.png"] = identifiability.picture(result.identifiability)
    files = {"report.html": report_html(result, pictures).encode(), **pictures}
    return [save_bytes(content, folder / name) for name, content in files.items()]


def report_html(result: RefitResult, pictures: Mapping[str, bytes]) -> str:
    """The page.

    Args:
        result: Of the refit.
        pictures: PNGs by file name, of `refit_pictures` and `verdict_pictures`.
    """
    shown = {name: html.picture(pictures[name], words) for name, words in _CAPTIONS.items()}
    parts = [
        _introduction(result),
        *verdict.section(result, pictures, stored_movements()),
        shown["zenith.png"],
        *_coefficients(result),
        shown["matrices.png"],
        *_quality(result),
        *_identifiability(result, pictures),
        html.heading("Where the regenerated model misses the simulation"),
        *(shown[name] for name in shown if name.startswith("residuals_")),
        html.heading("The simulated skies"),
        shown["skies.png"],
        *_run(result),
    ]
    return html.page("Sky model refitted to simulated skies", parts)


def _introduction(result: RefitResult) -> str:
    s = result.skies.settings
    suns, directions = s.solar_zenith_angle_deg, result.skies.directions.shape[0]
    return html.paragraph(
        f"{len(s.turbidity) * len(suns)} clear skies were simulated: turbidity "
        f"{min(s.turbidity):g} to {max(s.turbidity):g}, sun {min(suns):g}° to {max(suns):g}° "
        f"from the zenith, {directions} directions, {_orders(s.orders)}. The model of "
        "Preetham, Shirley and Smits (1999) was fitted to them again, and both the published "
        "and the regenerated model were held against them."
    )


def _orders(orders: int) -> str:
    return "single scattering" if orders == 1 else f"scattering orders 1 to {orders}"


def _coefficients(result: RefitResult) -> list[str]:
    parts = [
        html.heading("Coefficients"),
        html.paragraph(
            "Distribution over the dome: each Perez coefficient is slope times T plus intercept."
        ),
    ]
    head = ["", *(f"slope, {name}" for name in _TRIPLE), *(f"intercept, {n}" for n in _TRIPLE)]
    for quantity in DISTRIBUTIONS:
        rows = coefficient_rows(result, quantity)
        parts += [html.heading(quantity, 3), html.table(head, rows)]
    forms = {
        "Y": "Zenith Y [kcd m⁻²] = (a T + b) tan((4/9 − T/120)(π − 2 s)) + c T + d, s in rad",
        "x": "Zenith x: a polynomial in T and the solar zenith angle s [rad]",
        "y": "Zenith y: likewise",
    }
    for quantity, form in forms.items():
        rows = zenith_rows(result, quantity)
        parts += [html.heading(form, 3), html.table(["", *_TRIPLE], rows)]
    return parts


def _quality(result: RefitResult) -> list[str]:
    head = (
        "fit", "measure", "rms residual", "largest", "condition number", "steps", "converged",
    )  # fmt: skip
    rows = []
    for quantity in DISTRIBUTIONS:
        joint, single = result.distributions[quantity], result.single_skies[quantity]
        at_zenith = result.zeniths[quantity]
        rows += [
            [f"{quantity}, all skies together", *_quality_cells(joint)],
            [f"{quantity}, zenith", *_quality_cells(at_zenith)],
            [f"{quantity}, each sky alone", *_quality_cells(single)],
        ]
    return [
        html.heading("Quality of the fits"),
        html.table(head, rows),
        html.paragraph(
            "Residuals are relative to each value, or (absolute) in units of the data's root mean "
            "square, or differences of logarithms. Of the skies fitted alone: the rms over all of "
            "them, else the worst. Zenith fits are linear least squares."
        ),
        html.paragraph(_prior(result.distributions["Y"].prior)),
    ]


def _identifiability(result: RefitResult, pictures: Mapping[str, bytes]) -> list[str]:
    if not result.identifiability:
        return []
    s = result.skies.settings
    labels = (
        [f"T = {T:g}" for T in s.turbidity],
        [f"sun {sun:g}°" for sun in s.solar_zenith_angle_deg],
    )
    return [
        *identifiability.section(result.identifiability, labels),
        html.picture(pictures["identifiability.png"], _IDENTIFIABILITY_CAPTION),
    ]


def _quality_cells(fit: Any) -> list[str]:
    steps = f"{int(np.max(fit.steps))}" if hasattr(fit, "steps") else "-"
    flags = np.ravel(fit.converged) if hasattr(fit, "converged") else np.array([])
    converged = f"{int(flags.sum())} of {flags.size}" if flags.size else "-"
    return [
        fit.weighting,
        number(float(np.sqrt(np.mean(np.square(fit.rms))))),
        number(float(np.max(fit.largest))),
        condition(float(np.max(fit.condition_number))),
        steps,
        converged,
    ]


def _prior(prior: PerezPrior) -> str:
    names = ("ln(1 + A exp B)", "ln(-B)", "C", "ln(-D)", "E")
    each = ", ".join(
        f"{name} about {centre:.3g} with width {width:.3g}"
        for name, centre, width in zip(names, prior.centre, prior.width, strict=True)
    )
    return (
        "The prior of the searches, which decides what the skies leave open, has strength "
        f"{float(prior.strength):g} (a parameter one width from its centre counts like a residual "
        f"of this size everywhere): {each}."
    )


def _run(result: RefitResult) -> list[str]:
    now = datetime.datetime.now(datetime.UTC)
    packages = [f"{name} {version}" for name, version in versions().items()]
    stages = [[stage, f"{seconds:.2f}"] for stage, seconds in result.seconds.items()]
    stages.append(["all", f"{sum(result.seconds.values()):.2f}"])
    return [
        html.heading("The run"),
        html.table((), _settings(result.skies.settings), words=True),
        html.block(str(result.skies.settings.plan())),
        html.heading("Seconds of each stage", 3),
        html.table(("stage", "seconds"), stages),
        html.paragraph("The first run of a program on a machine includes its compilation."),
        html.paragraph(
            f"Written {now:%Y-%m-%d %H:%M} UTC with Python {platform.python_version()}, "
            f"{', '.join(packages)}."
        ),
    ]


def _settings(s: RefitSettings) -> list[tuple[str, str]]:
    return [
        ("turbidity", ", ".join(f"{T:g}" for T in s.turbidity)),
        ("sun from zenith", ", ".join(f"{sun:g}°" for sun in s.solar_zenith_angle_deg)),
        (
            "wavelengths",
            f"{len(s.wavelength_nm)} from {min(s.wavelength_nm):g} to {max(s.wavelength_nm):g} nm",
        ),
        ("scattering orders", str(s.orders)),
        ("promised relative error", f"{s.rtol:g}"),
        ("geometry", s.geometry),
        ("number type of the simulation", s.dtype),
        ("measure of luminance in the fits", s.weighting),
    ]
