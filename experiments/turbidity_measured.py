"""What turbidity does each model see in ten measured skies?

Writes config.json, result.json, table.md and a picture. The scans are read from the folder that
ATMOFIT_DATA names, else from ../shared/data beside the checkout.
"""

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from measured_data import FAULTY, NEAR_SUN, DataMissing, Skies, data_folder, read_skies
from measured_models import regenerated_model, turbidity_from_optical_depth
from run_files import markdown, write_run
from turbidity_pictures import draw_measured

import atmofit as af
from atmofit.fit.observation import Observation
from atmofit.fit.turbidity import TurbidityEstimate, estimate_turbidity

NOTE = """\
T ± standard error from {noise:.0%} noise alone (standard error scaled by the residual); rms of
log(model / measured). {used} of 81 directions: without the faulty one and the {near} nearest to the
sun, among them all within 10 degrees. The aerosol of the May day gives T = {low:.2f} to {high:.2f}
(optical depth {depths[0]:g} to {depths[1]:g} at 550 nm); September's is not known. Luminance at
T = 2, model / measured, mean over May: {ratios}."""


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    relative_noise: float = 0.02
    """Of one direction: the repeatability of a good scan, an assumption."""
    aerosol_optical_depth: tuple[float, float] = (0.065, 0.106)
    """At 550 nm: what the 2013 comparison took for the site, and the most that AERONET gives for
    the May day, 300 km away."""
    coefficients: Path | None = None
    """coefficients.json written by `atmofit refit`; without it the refit is run."""
    out: Path = Path("runs/turbidity_measured")
    """Folder of the results."""


def main(config: Config) -> None:
    """Read, estimate by every model, report."""
    try:
        skies = read_skies(data_folder())
    except DataMissing as error:
        print(f"turbidity_measured: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    models = {
        "simulator": "simulator",
        "published (1999)": af.PREETHAM_1999,
        "regenerated": regenerated_model(config.coefficients),
    }
    scans, near = observations(config, skies)
    results: dict[str, list[TurbidityEstimate]] = {}
    for name, model in models.items():
        begin = time.perf_counter()
        results[name] = [estimate_turbidity(scan, model) for scan in scans]
        print(f"{name}: {time.perf_counter() - begin:.1f} s", file=sys.stderr)
    table = report(config, skies, scans, near, models, results)
    print(table)
    numbers = {name: [_numbers(one) for one in found] for name, found in results.items()}
    write_run(config.out, config, {"time": skies.time, "estimates": numbers}, table)
    site = [turbidity_from_optical_depth(depth) for depth in config.aerosol_optical_depth]
    sun_deg = np.degrees(skies.solar_zenith_angle)
    print(draw_measured(config.out / "measured.png", sun_deg, skies.groups["may"], numbers, site))


def observations(config: Config, skies: Skies) -> tuple[list[Observation], int]:
    """The scans without bad directions, all of one size; and how many near the sun are left out."""
    near = int((skies.scattering_angle < NEAR_SUN).sum(axis=1).max())
    scans = []
    for k, sun in enumerate(skies.solar_zenith_angle):
        order = np.argsort(skies.scattering_angle[k])[near:]
        kept = np.sort(order[order != FAULTY][: skies.view_zenith_angle.size - near - 1])
        scans.append(
            Observation(
                directions=af.Directions(
                    skies.view_zenith_angle[kept], skies.relative_azimuth[k, kept]
                ),
                values=skies.luminance[k, kept],
                solar_zenith_angle=sun,
                relative_noise=config.relative_noise,
            )
        )
    return scans, near


def report(
    config: Config,
    skies: Skies,
    scans: list[Observation],
    near: int,
    models: dict[str, Any],
    results: dict[str, list[TurbidityEstimate]],
) -> str:
    """The table in Markdown, with what has to be known to read it."""
    header = ["scan", "sun [°]"]
    for name in results:
        header += [f"{name}: T", "reduced chi-square", "rms"]
    rows = []
    for k, moment in enumerate(skies.time):
        row = [moment[:16], f"{np.degrees(skies.solar_zenith_angle[k]):.1f}"]
        for found in results.values():
            row += _cells(found[k])
        rows.append(row)
    depths = config.aerosol_optical_depth
    low, high = (turbidity_from_optical_depth(depth) for depth in depths)
    may = np.flatnonzero(skies.groups["may"])
    ratios = ", ".join(
        f"{name} {np.mean([_ratio(scans[k], model) for k in may]):.2f}"
        for name, model in models.items()
    )
    note = NOTE.format(
        noise=config.relative_noise,
        used=scans[0].values.size,
        near=near,
        low=low,
        high=high,
        depths=depths,
        ratios=ratios,
    )
    return markdown(header, rows) + "\n\n" + note


def _cells(found: TurbidityEstimate) -> list[str]:
    scaled = float(found.scaled_by_residual().standard_error)
    mark = " (edge)" if found.at_edge else "" if found.converged else " (not converged)"
    return [
        f"{found.value:.3f} ± {found.standard_error:.3f} ({scaled:.3f}){mark}",
        f"{found.reduced_chi_square:.0f}",
        f"{found.rms:.1%}",
    ]


def _ratio(scan: Observation, model: str | af.PreethamModel) -> float:
    """Mean over the directions of model / measured at turbidity 2."""
    sun, directions = scan.solar_zenith_angle, scan.directions
    if isinstance(model, str):
        sky = af.simulate_luminance(af.Atmosphere.from_turbidity(2.0), sun, directions)
    else:
        sky = model(2.0, sun, directions)[..., 2]
    return float(np.mean(np.asarray(sky) / np.asarray(scan.values)))


def _numbers(found: TurbidityEstimate) -> dict[str, Any]:
    return {
        "value": float(found.value),
        "standard_error": float(found.standard_error),
        "scaled_standard_error": float(found.scaled_by_residual().standard_error),
        "reduced_chi_square": float(found.reduced_chi_square),
        "rms": float(found.rms),
        "converged": bool(found.converged),
        "at_edge": bool(found.at_edge),
        "steps": int(found.steps),
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
