"""Do the 1999 paper's tables of haze, eta and K, follow from the theory of Mie?

The paper prints them (Tables 1 and 2, from Bullrich 1964) for Junge's power law with v = 4, without
the refractive index and the smallest and largest radius. Here they are computed for the plausible
ones, and the three numbers are fitted to the tables. Writes config.json, result.json, table.md and
a picture.
"""

import dataclasses
import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from mie_pictures import draw_tables
from run_files import markdown, write_run
from scipy.optimize import least_squares

from atmofit.optics.mie import mie_optics
from atmofit.optics.sizes import junge_sizes
from atmofit.tables import constant, preetham1999_phase, preetham1999_spectra

# Refractive index, smallest and largest radius [um].
CANDIDATES: list[tuple[complex, float, float]] = [
    (1.33, 0.04, 10.0), (1.40, 0.04, 10.0), (1.44, 0.04, 10.0), (1.48, 0.04, 10.0),
    (1.50, 0.04, 10.0), (1.52, 0.04, 10.0), (1.55, 0.04, 10.0), (1.50 + 0.01j, 0.04, 10.0),
    (1.50, 0.02, 10.0), (1.50, 0.08, 10.0), (1.50, 0.04, 5.0), (1.50, 0.04, 20.0),
]  # fmt: skip
BEST = (1.50, 0.04, 10.0)
FIT_STEP = 0.01  # relative, of the derivatives: wide against the noise of the sums over radii


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    radii: int = 1600
    """In the sums over size; the candidates use half."""
    fit: bool = True
    """Whether to fit index and radii, which takes a minute."""
    out: Path = Path("runs/mie_haze")
    """Folder of the results."""


def main(config: Config) -> None:
    """Compare, fit, report."""
    begin = time.perf_counter()
    rows = [compare(candidate, config.radii // 2) for candidate in CANDIDATES]
    print(f"{len(rows)} candidates: {time.perf_counter() - begin:.0f} s", flush=True)
    spectra, table = preetham1999_spectra(), preetham1999_phase()
    K, _ = terms(BEST, spectra.wavelength_nm, np.zeros(1), config.radii)
    _, eta = terms(BEST, table.wavelength_nm, table.scattering_angle, config.radii)
    again = terms(BEST, table.wavelength_nm, table.scattering_angle, 2 * config.radii)[1]
    degrees = np.concatenate([np.linspace(0, 2, 41), np.linspace(2.5, 180, 356)])
    _, curve = terms(BEST, table.wavelength_nm, np.radians(degrees), config.radii)
    result: dict[str, Any] = {
        "candidates": rows,
        "K": K.tolist(),
        "eta": eta.tolist(),
        "largest_change_with_twice_the_radii": float(np.abs(again / eta - 1).max()),
        "between_the_rows": between_the_rows(degrees, curve, table),
        "fit": fit(config.radii) if config.fit else None,
    }
    report = "\n\n".join([candidate_table(rows), words(result, K, eta), cells(eta)])
    print(report)
    write_run(config.out, config, result, report)
    print(draw_tables(config.out / "tables.png", degrees, curve, eta, K))
    print(f"{time.perf_counter() - begin:.0f} s in all")


def terms(
    candidate: tuple[complex, float, float],
    wavelength_nm: np.ndarray,
    scattering_angle: np.ndarray,
    radii: int,
) -> tuple[np.ndarray, np.ndarray]:
    """K [wavelength] and eta [angle, wavelength] of the paper's appendix A.3.

    With dn / dlog10(r) = c r^-4, that is 0.434 c r^-4 per natural logarithm, the scattering
    coefficient is 0.434 c pi k^2 K, and per solid angle 0.434 c k^2 eta / 2 (k: wavenumber).
    """
    index, smallest, largest = candidate[0], candidate[1] * 1e-6, candidate[2] * 1e-6
    v = constant("junge_exponent")
    optics = mie_optics(
        junge_sizes(v, smallest, largest),
        index,
        wavelength_nm,
        scattering_angle=scattering_angle,
        radius_count=radii,
    )
    number = (smallest**-v - largest**-v) / v  # of particles, over 0.434 c
    wavenumber = 2 * math.pi / (wavelength_nm * 1e-9)
    K = number * optics.scattering_cross_section / (math.pi * wavenumber ** (v - 2))
    return K, 2 * math.pi * K * optics.phase_function


def compare(candidate: tuple[complex, float, float], radii: int) -> dict[str, Any]:
    """How far one candidate's K and eta are from the printed ones, in shares of these."""
    spectra, table = preetham1999_spectra(), preetham1999_phase()
    K, eta = terms(candidate, table.wavelength_nm, table.scattering_angle, radii)
    inside = table.wavelength_nm <= spectra.wavelength_nm[-1]
    K_off = K[inside] / np.interp(table.wavelength_nm[inside], spectra.wavelength_nm, spectra.K) - 1
    off = eta / table.eta - 1
    index = complex(candidate[0])
    return {
        "refractive_index": [index.real, index.imag],
        "radii_um": list(candidate[1:]),
        "K_mean": float(K_off.mean()),
        "K_rms": float(np.sqrt((K_off**2).mean())),
        "eta_rms": float(np.sqrt((off**2).mean())),
        "eta_worst": float(off.flat[np.abs(off).argmax()]),
    }


def fit(radii: int) -> dict[str, Any]:
    """Index and radii by least squares from a start that is wrong in all three.

    Without the row at 180 degrees: there the ripples of single spheres are strongest, and a table
    of 1964 may hold them less well.
    """
    spectra, table = preetham1999_spectra(), preetham1999_phase()
    wavelength = table.wavelength_nm
    inside = wavelength <= spectra.wavelength_nm[-1]
    K_printed = np.interp(wavelength[inside], spectra.wavelength_nm, spectra.K)

    def residuals(p: np.ndarray) -> np.ndarray:
        candidate = (float(p[0]), float(np.exp(p[1])), float(np.exp(p[2])))
        K, eta = terms(candidate, wavelength, table.scattering_angle[:-1], radii)
        return np.concatenate([K[inside] / K_printed - 1, (eta / table.eta[:-1] - 1).ravel()])

    found = least_squares(
        residuals, [1.45, math.log(0.06), math.log(7.0)], x_scale=[0.01, 0.1, 0.1],
        diff_step=FIT_STEP, xtol=1e-6, ftol=1e-8,
    )  # fmt: skip
    freedom = found.fun.size - 3
    spread = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * 2 * found.cost / freedom)
    smallest, largest = np.exp(found.x[1:])
    return {
        "refractive_index": [float(found.x[0]), float(spread[0])],
        "smallest_radius_um": [float(smallest), float(smallest * spread[1])],
        "largest_radius_um": [float(largest), float(largest * spread[2])],
        "rms": float(np.sqrt((found.fun**2).mean())),
        "evaluations": int(found.nfev),
    }


def between_the_rows(degrees: np.ndarray, curve: np.ndarray, table: Any) -> dict[str, float]:
    """How well the package's curve through the 13 printed angles follows the theory.

    Both are compared as shares of the scattered light per solid angle, at 550 nm.
    """
    from atmofit.optics.haze import bullrich_phase

    column = int(np.flatnonzero(table.wavelength_nm == 550.0)[0])
    angle = np.radians(degrees)
    exact = curve[:, column]
    norm = 2 * math.pi * np.trapezoid(exact * np.sin(angle), angle)
    off = np.asarray(bullrich_phase()(angle, 550.0), float) / (exact / norm) - 1
    found = {"at_0_degrees": float(off[0])}
    for name, low, high in (("first", 1.0, 150.0), ("last", 150.0, 180.0)):
        place = np.flatnonzero((degrees >= low) & (degrees <= high))
        worst = place[np.abs(off[place]).argmax()]
        found |= {name: float(off[worst]), f"{name}_at_degrees": float(degrees[worst])}
    return found


def candidate_table(rows: list[dict[str, Any]]) -> str:
    """One line for each candidate."""
    header = ["refractive index", "radii [um]", "K mean", "K rms", "eta rms", "eta worst"]
    lines = []
    for row in rows:
        real, imaginary = row["refractive_index"]
        index = f"{real:.2f}" + (f" + {imaginary:.2f} i" if imaginary else "")
        low, high = row["radii_um"]
        numbers = [f"{row[key]:+.2%}" for key in ("K_mean", "K_rms", "eta_rms", "eta_worst")]
        lines.append([index, f"{low:g} to {high:g}", *numbers])
    return markdown(header, lines)


def words(result: dict[str, Any], K: np.ndarray, eta: np.ndarray) -> str:
    """How far the best candidate is from the tables, in sentences."""
    spectra, table = preetham1999_spectra(), preetham1999_phase()
    between = result["between_the_rows"]
    K_units = np.abs(K - spectra.K) / 1e-3
    off = eta / table.eta - 1
    rest = off.copy()
    rest[-1] = 0
    lines = [
        f"Index 1.50, 0.04 to 10 um: K is within {K_units.max():.2f} units of its last printed "
        f"digit at all {K.size} wavelengths, within half a unit at {(K_units <= 0.5).sum()}; "
        f"rms {np.sqrt(((K / spectra.K - 1) ** 2).mean()):.2%}.",
        f"eta from 1 to 150 degrees is within {np.abs(rest).max():.2%}, at 180 degrees within "
        f"{np.abs(off[-1, :-1]).max():.2%}, but {off[-1, -1]:+.2%} at 850 nm: "
        f"{table.eta[-1, -1]} is printed, {eta[-1, -1]:.4f} follows.",
        "Twice the radii change eta by at most "
        f"{result['largest_change_with_twice_the_radii']:.1e}.",
        "The package's curve through the printed angles, both normalised, differs from the theory "
        f"by at most {between['first']:+.1%} from 1 to 150 degrees "
        f"(at {between['first_at_degrees']:g}), {between['last']:+.1%} beyond "
        f"(at {between['last_at_degrees']:g}), and {between['at_0_degrees']:+.1%} at 0 degrees, "
        "where it keeps the value of 1 degree.",
    ]
    found = result["fit"]
    if found is not None:
        (n, dn), (low, d_low), (high, d_high) = (
            found[key] for key in ("refractive_index", "smallest_radius_um", "largest_radius_um")
        )
        lines.append(
            f"Fitted: index {n:.5f} ± {dn:.5f}, radii {low:.5f} ± {d_low:.5f} to {high:.2f} ± "
            f"{d_high:.2f} um, rms {found['rms']:.2%} ({found['evaluations']} steps)."
        )
    return "\n".join(f"- {line}" for line in lines)


def cells(eta: np.ndarray) -> str:
    """Theory over print at every cell of Table 1, in per cent."""
    table = preetham1999_phase()
    header = ["eta, theory / paper - 1", *(f"{one:.0f} nm" for one in table.wavelength_nm)]
    off = eta / table.eta - 1
    degrees = np.degrees(table.scattering_angle)
    rows = [
        [f"{angle:.0f} degrees", *(f"{one:+.2%}" for one in row)]
        for angle, row in zip(degrees, off, strict=True)
    ]
    return markdown(header, rows)


if __name__ == "__main__":
    os.environ.setdefault("MIEPYTHON_USE_JIT", "1")  # read when miepython is imported
    main(tyro.cli(Config))
