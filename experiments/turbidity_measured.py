"""How much haze does each estimator see in ten measured skies, and do the intervals agree?

Estimates of turbidity, and with it of the haze's optical depth at 550 nm, from every scan alone:
from luminances and from spectra, by the analytic model, by the simulator in the 1999 paper's air
and by the simulator in real air, with the model-error term. Directions within 10 degrees of the sun
are left out, for the field of view is not known. Writes result.json, table.md and a picture. The
scans are read from the folder that ATMOFIT_DATA names, else from ../shared/data beside the
checkout.
"""

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from measured_data import NEAR_SUN, DataMissing, data_file, data_folder
from run_files import markdown, write_run
from turbidity_pictures import draw_measured

import atmofit as af

SITE, AERONET = 0.065, (0.088, 0.106)
NOTE = """\
Haze optical depth at 550 nm, mean over the eight scans of May and their scatter (standard
deviation); 95 % interval of a scan, mean half width, widened where the residuals ask for it; scans
whose interval holds the value that the 2013 comparison took for the site, {site:g}, and the range
of an AERONET station 300 km away, {low:g} to {high:g}. rms of ln(model / measured) after exposure
and model error; reduced chi-square with {noise:.0%} noise."""


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    relative_noise: float = 0.02
    """Of one direction: the repeatability of a good scan, an assumption."""
    wavelength_nm: tuple[float, ...] = tuple(float(λ) for λ in range(420, 681, 20))
    """Of the spectra: without the bands of water and oxygen."""
    channel_error: float = 0.03
    """Of each wavelength's own level: sun's spectrum, calibration."""
    albedo: float = 0.066
    """Of the ground: grass, the share of sunlight's luminance that it reflects."""
    ozone_dobson: float = 368.0
    """Van Heuklon (1979) for site and day."""
    out: Path = Path("runs/turbidity_measured")
    """Folder of the results."""


@dataclasses.dataclass(frozen=True)
class Estimator:
    """One way to estimate.

    Attributes:
        model: Of the sky.
        error: Its stored error.
        spectral: Whether spectra are fitted, not luminances.
        free: Unknowns beside turbidity.
    """

    model: Any
    error: str
    spectral: bool = False
    free: tuple[str, ...] = ()


CONTINENT = af.SimulatorModel("continental", orders="all")
ESTIMATORS = {
    "ATMOFIT_2026, luminance": Estimator(af.ATMOFIT_2026, "atmofit_2026"),
    "ATMOFIT_2026, spectra": Estimator(af.ATMOFIT_2026, "atmofit_2026", spectral=True),
    "two orders, the paper's air, luminance": Estimator("simulator", "simulator"),
    "all orders, real air, spectra": Estimator(CONTINENT, "continental all", spectral=True),
    "all orders, real air, spectra; exponent, absorption free": Estimator(
        CONTINENT,
        "continental all",
        spectral=True,
        free=("angstrom_exponent", "single_scattering_albedo"),
    ),
}


def main(config: Config) -> None:
    """Read, estimate in every way, report."""
    try:
        scans = data_file(data_folder(), "measured_sky_2013/scans.npz")
    except DataMissing as error:
        print(f"turbidity_measured: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    rows, results = [], {}
    for name, way in ESTIMATORS.items():
        begin = time.perf_counter()
        found = [estimate(config, way, sky) for sky in observations(config, scans, way)]
        seconds = time.perf_counter() - begin
        results[name] = [numbers(one) for one in found]
        rows.append([name, *summary(results[name][:8]), f"{seconds / len(found):.1f}"])
        print(rows[-1], flush=True)
    head = ["estimator", "mean", "scatter", "half width", "hold the site's", "reach AERONET's",
            "rms", "chi-square", "s / scan, compilation too"]  # fmt: skip
    low, high = AERONET
    note = NOTE.format(site=SITE, low=low, high=high, noise=config.relative_noise)
    table = markdown(head, rows) + "\n\n" + note
    print(table)
    write_run(config.out, config, {"estimates": results}, table + "\n")
    print(draw_measured(config.out / "measured.png", results, SITE, AERONET))


def observations(config: Config, scans: Path, way: Estimator) -> list[af.Observation]:
    """The ten scans without bad directions."""
    read = af.read_observations(
        scans,
        relative_noise=config.relative_noise,
        spectral=way.spectral,
        wavelength_nm=config.wavelength_nm,
    )
    kept = []
    for sky in read:
        view, azimuth = sky.directions.angles()
        far = af.scattering_angle(view, azimuth, sky.solar_zenith_angle) >= NEAR_SUN
        kept.append(dataclasses.replace(sky, mask=sky.used & far))
    return kept


def estimate(config: Config, way: Estimator, sky: af.Observation) -> af.TurbidityEstimate:
    """One scan."""
    known: dict[str, float] = {}
    if isinstance(way.model, af.SkyModel | af.SimulatorModel):
        known["albedo"] = config.albedo
    if isinstance(way.model, af.SimulatorModel):
        known["ozone_dobson"] = config.ozone_dobson
    error = dataclasses.replace(
        af.stored_model_error(way.error), channel=np.asarray(config.channel_error)
    )
    return af.estimate_turbidity(
        sky, way.model, free=("turbidity", *way.free), known=known, model_error=error
    )


def numbers(found: af.TurbidityEstimate) -> dict[str, Any]:
    """Plain values; optical depths of the haze at 550 nm."""
    scaled = found.scaled_by_residual()
    depth = float(af.rayleigh_optical_depth(550.0))
    return {
        "turbidity": float(found.value),
        "optical_depth": (float(found.value) - 1) * depth,
        "interval": ((np.asarray(scaled.interval) - 1) * depth).tolist(),
        "unknowns": dict(zip(found.names, np.asarray(found.parameters).tolist(), strict=True)),
        "standard_errors": np.asarray(scaled.standard_errors).tolist(),
        "reduced_chi_square": float(found.reduced_chi_square),
        "rms": float(found.rms),
        "converged": bool(found.converged),
        "at_edge": bool(found.at_edge),
        "untold": list(found.untold),
    }


def summary(scans: list[dict[str, Any]]) -> list[str]:
    """Cells of a row."""
    depth = np.array([scan["optical_depth"] for scan in scans])
    low, high = np.array([scan["interval"] for scan in scans]).T
    site = int(np.sum((low <= SITE) & (high >= SITE)))
    station = int(np.sum((low <= AERONET[1]) & (high >= AERONET[0])))
    return [
        f"{depth.mean():.3f}",
        f"{depth.std(ddof=1):.3f}",
        f"{np.mean(high - low) / 2:.3f}",
        f"{site} of {len(scans)}",
        f"{station} of {len(scans)}",
        f"{np.mean([scan['rms'] for scan in scans]):.1%}",
        f"{np.mean([scan['reduced_chi_square'] for scan in scans]):.1f}",
    ]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
