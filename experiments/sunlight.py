"""The sun by formula, by our own columns and by SPECTRL2; and how far one sees through haze.

Colour and illuminance of direct sunlight against the zenith angle to 88 degrees, at the turbidities
asked for: the five transmittances of the 1999 paper; exact columns through the same haze, ozone,
water and oxygen on a round Earth; and pvlib's SPECTRL2 with the haze that the formula has. Writes
result.json, table.md and a picture with the paper's figure 3 drawn anew.
"""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from pvlib.spectrum import spectrl2
from run_files import markdown, write_run

import atmofit as af
from atmofit.files import replace_file

TABLE_NM = np.arange(380.0, 781.0, 10.0)
PALETTE = ("#1f5fa8", "#c8553d", "#5a9367")
WAYS = ("formula", "columns", "SPECTRL2")


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    turbidity: tuple[float, ...] = (2.0, 6.0)
    zenith_deg: tuple[float, ...] = (0, 30, 50, 60, 70, 75, 80, 83, 85, 87, 88)
    ozone_m: float = 0.0035
    water_m: float = 0.02
    out: Path = Path("runs/sunlight")


def main(config: Config) -> None:
    """Compute, draw, print and write."""
    results: dict[str, dict[str, list[list[float]]]] = {}
    rows = []
    for turbidity in config.turbidity:
        found = {name: [] for name in WAYS}
        for zenith in config.zenith_deg:
            for name, xyY in zip(WAYS, three(config, turbidity, zenith), strict=True):
                found[name].append(xyY.tolist())
        results[f"{turbidity:g}"] = found
        for k, zenith in enumerate(config.zenith_deg):
            formula, *others = (np.asarray(found[name][k]) for name in WAYS)
            cells = [f"{turbidity:g}", f"{zenith:g}", f"{formula[2]:.3g}"]
            cells += [f"{v:.4f}" for v in formula[:2]]
            for other in others:
                difference = other[:2] - formula[:2]
                cells += [f"{other[2] / formula[2] - 1:+.1%}", *(f"{v:+.4f}" for v in difference)]
            rows.append(cells)
    head = ["T", "zenith [deg]", "formula E_v [lx]", "x", "y"]
    head += [f"{name} {what}" for name in WAYS[1:] for what in ("E_v", "x", "y")]
    text = markdown(head, rows)
    print(text)
    config.out.mkdir(parents=True, exist_ok=True)
    print(draw(config, config.out / "sunlight.png", results))
    write_run(config.out, config, {"xyY": results}, text + "\n")


def three(config: Config, turbidity: float, zenith_deg: float) -> tuple[np.ndarray, ...]:
    """x, y and illuminance [lx] of a surface that faces the sun."""
    zenith = np.radians(zenith_deg)
    sun = af.solar_irradiance_spectrum("preetham1999")
    share = af.sun_transmittance(turbidity, zenith, None, config.ozone_m, config.water_m).total
    formula = np.asarray(share) * np.asarray(sun(TABLE_NM))
    mass = float(af.optical_mass(zenith))
    beta, mass_of_band = float(af.angstrom_beta(turbidity)), min(max(mass, 1.0), 40.0)
    air = af.Atmosphere(
        molecules=af.Molecules(af.Spectrum(TABLE_NM, 0.008735 * (TABLE_NM / 1e3) ** -4.08)),
        haze=af.Haze(beta * 0.55**-1.3, 1.3),
        absorbers=(
            af.Absorber.ozone(config.ozone_m * 1e5),
            af.Absorber.water_vapour(config.water_m * 1e3, airmass=mass_of_band),
            af.Absorber.mixed_gases(airmass=mass_of_band),
        ),
    )
    columns = np.asarray(af.simulate_sun(air, zenith, TABLE_NM))
    other: Any = spectrl2(
        apparent_zenith=zenith_deg,
        aoi=0.0,
        surface_tilt=zenith_deg,
        ground_albedo=0.0,
        surface_pressure=101325.0,
        relative_airmass=mass,
        precipitable_water=config.water_m * 100,
        ozone=config.ozone_m * 100,
        aerosol_turbidity_500nm=beta * 0.5**-1.3,
        dayofyear=94,  # when the Earth is at its mean distance
        alpha=1.3,
    )
    spectrum = np.interp(TABLE_NM, other["wavelength"], np.ravel(other["dni"]))
    return tuple(np.asarray(af.spectrum_to_xyY(s, TABLE_NM)) for s in (formula, columns, spectrum))


def draw(config: Config, path: Path, results: dict[str, Any]) -> Path:
    """Illuminance, chromaticity and meteorological range."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.9), layout="constrained")
    bright, colour, far = figure.subplots(1, 3)
    for turbidity, found in results.items():
        for name, color in zip(WAYS, PALETTE, strict=True):
            x, y, Y = np.asarray(found[name]).T
            style = "-" if turbidity == f"{config.turbidity[0]:g}" else "--"
            label = f"{name}, T = {turbidity}"
            bright.plot(config.zenith_deg, Y, style, color=color, label=label)
            colour.plot(x, y, style, color=color)
    bright.set(yscale="log", xlabel="solar zenith angle [°]", ylabel="illuminance, facing sun [lx]")
    bright.legend(frameon=False, fontsize=7)
    colour.set(xlabel="chromaticity x [-]", ylabel="chromaticity y [-]")
    colour.set_title("from overhead (left) to 88° (right)")
    turbidity = np.geomspace(1.0, 64.0, 200)
    for n, style in ((1.000278, "-"), (1.0003, ":")):
        seen = np.asarray(af.meteorological_range(turbidity, n)) / 1e3
        far.plot(seen, turbidity, style, color=PALETTE[0], label=f"refractive index {n:g}")
    far.set(xscale="log", yscale="log", xlabel="meteorological range [km]", ylabel="turbidity [-]")
    far.legend(frameon=False, fontsize=8)
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
