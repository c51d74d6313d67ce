"""How close do the models come to ten measured skies, and how close do other codes come?

Writes scores.json, table.md, pictures and config.json. The scans and the codes' radiances are read
from the folder that ATMOFIT_DATA names, else from ../shared/data beside the checkout.
"""

import dataclasses
import json
import sys
import time
from pathlib import Path

import jax
import tyro
from measured_air import describe, real_air
from measured_data import (
    DataMissing,
    Prediction,
    Score,
    Skies,
    data_folder,
    read_codes,
    read_skies,
    score,
)
from measured_fitted import FittedScore, fitted_scores, site_albedo
from measured_models import (
    analytic,
    free_perez,
    regenerated_model,
    simulation,
    site_atmosphere,
    turbidity_from_optical_depth,
)
from measured_pictures import draw_all
from run_files import commit

import atmofit as af

FITTED = """\
Turbidity (and nothing else) fitted to every second direction of each scan, the others scored;
ground albedo {albedo:.3f}; shared: 360 to 712 nm, where all models have spectra. Codes: in the same
directions, with the aerosol that they were given.

| model | group | RMS | RMS, shared | luminance, relative RMS | turbidity |
|---|---|---|---|---|---|"""
HEADER = ["model", "group", "RMS", "RMS far from the sun", "luminance, relative RMS"]
HEADER += ["level", "pattern"]

NOTE = """\
RMS in mW m^-2 sr^-1 nm^-1 over all directions and 40 wavelengths (360 to 818 nm); far: without
directions within 10 degrees of the sun. Measured spectra are interpolated linearly at the 40
wavelengths. Luminance: relative to the measured luminance of each direction; level: the model's
over the measured, geometric mean; pattern: RMS of this ratio's logarithm, each scan's mean taken
out.

Both analytic models have turbidity {turbidity:.2f} (from the aerosol optical depth {depth:g} at
550 nm, no lower than 2); their spectra are daylight spectra (CIE D series) of the model's
chromaticity, scaled to its luminance. perez_free is fitted to each scan, and for the spectral
figures to each wavelength. simulation_order_1, simulation_order_2 and simulation_all_orders have
the atmosphere of the codes; a reflection at the ground counts as an order.
September had another aerosol than the codes and the simulation were given."""
RESAMPLING = """\
What the resampling does: measured spectra averaged over the 11.75 nm that begin at each
wavelength, as the solar spectrum given to the codes was."""
LOWEST_FITTED = 2.0  # turbidity where the fits of both analytic models begin


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    out: Path = Path("runs/measured_skies")
    """Folder of the results."""
    coefficients: Path | None = None
    """coefficients.json written by `atmofit refit`; without it the refit is run."""
    aerosol_optical_depth: float = 0.097
    """At 550 nm, for the turbidity of the analytic models on both days: the middle of the 0.088 to
    0.106 that AERONET gives for the May day, 300 km from the site. It gives 1.96; as all fits begin
    at 2, lower values become 2."""


def main(config: Config) -> None:
    """Read, predict, score, draw."""
    # References and fits are in double precision.
    jax.config.update("jax_enable_x64", True)
    folder = data_folder()
    try:
        skies, codes = read_skies(folder), read_codes(folder)
        config.out.mkdir(parents=True, exist_ok=True)
        model = regenerated_model(config.coefficients)
        predictions = [*predict(config, folder, skies, model), *codes]
        other = score(read_skies(folder, band=True), codes)
        air = describe(folder)
    except (DataMissing, OSError, ValueError) as error:
        print(f"measured_skies: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    scores = score(skies, predictions)
    atmosphere, irradiance = site_atmosphere(folder)
    assert atmosphere.ground is not None
    albedo = site_albedo(atmosphere.ground.albedo, irradiance)
    fitted = fitted_scores(skies, codes, model, irradiance, albedo)
    table = report(config, scores, other, air) + "\n\n" + fitted_table(fitted, albedo)
    print(table)
    (config.out / "table.md").write_text(table + "\n")
    stored = {"given": scores, "fitted": fitted}
    (config.out / "scores.json").write_text(json.dumps(stored, indent=1) + "\n")
    settings = {**dataclasses.asdict(config), "commit": commit(), "jax": jax.__version__}
    (config.out / "config.json").write_text(json.dumps(settings, indent=1, default=str) + "\n")
    for path in draw_all(config.out, skies, predictions):
        print(path)


def predict(
    config: Config, folder: Path, skies: Skies, regenerated: af.PreethamModel
) -> list[Prediction]:
    """What every model of atmofit says."""
    turbidity = _turbidity(config)
    atmosphere, irradiance = site_atmosphere(folder)
    return [
        _timed(free_perez, skies),
        _timed(analytic, "preetham_1999", af.PREETHAM_1999, turbidity, skies),
        _timed(analytic, "regenerated", regenerated, turbidity, skies),
        _timed(simulation, skies, atmosphere, irradiance, 1),
        _timed(simulation, skies, atmosphere, irradiance, 2),
        _timed(simulation, skies, atmosphere, irradiance, "all"),
        _timed(real_air, skies, folder),
    ]


def report(config: Config, scores: list[Score], other: list[Score], air: str) -> str:
    """The table in Markdown, with what has to be known to read it."""
    depth, turbidity = config.aerosol_optical_depth, _turbidity(config)
    note = NOTE.format(depth=depth, turbidity=turbidity)
    lines = [*_table(scores), "", note, "", air, "", RESAMPLING, "", *_table(other)]
    return "\n".join(lines)


def fitted_table(scores: list[FittedScore], albedo: float) -> str:
    """The table of models with fitted turbidity, in Markdown."""
    lines = [FITTED.format(albedo=albedo)]
    for row in scores:
        whole, relative = row["rms_mW"], row["luminance_rms_relative"]
        cells = [
            row["model"],
            row["group"],
            "-" if whole is None else f"{whole:.1f}",
            f"{row['rms_shared_mW']:.1f}",
            "-" if relative is None else f"{100 * relative:.1f} %",
            " ".join(f"{value:.2f}" for value in row["turbidity"]) or "-",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _table(scores: list[Score]) -> list[str]:
    rows = [
        [
            row["model"],
            row["group"],
            f"{row['rms_mW']:.1f}",
            f"{row['rms_far_mW']:.1f}",
            f"{100 * row['luminance_rms_relative']:.1f} %",
            f"{row['luminance_level']:.2f}",
            f"{100 * row['luminance_pattern_rms']:.1f} %",
        ]
        for row in scores
    ]
    widths = [max(len(row[k]) for row in [HEADER, *rows]) for k in range(len(HEADER))]
    lines = [HEADER, ["-" * width for width in widths], *rows]
    return [
        "| "
        + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        + " |"
        for line in lines
    ]


def _turbidity(config: Config) -> float:
    return max(LOWEST_FITTED, turbidity_from_optical_depth(config.aerosol_optical_depth))


def _timed(predict_one, *arguments) -> Prediction:
    start = time.perf_counter()
    prediction = predict_one(*arguments)
    print(f"{prediction.name}: {time.perf_counter() - start:.1f} s", file=sys.stderr)
    return prediction


if __name__ == "__main__":
    main(tyro.cli(Config))
