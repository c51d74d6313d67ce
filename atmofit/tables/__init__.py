"""Tables of the papers, read once into NumPy arrays that cannot be written to.

The CSV files beside this module hold the numbers; their first lines say source and unit.
"""

import csv
import dataclasses
import functools
from importlib import resources

import numpy as np

SUN_FIT_FROM_NM = 700.0  # the sun's radiance beyond the table continues the slope from here


@dataclasses.dataclass(frozen=True)
class Phase:
    """Angular scattering term of haze, Preetham et al. (1999) Table 1.

    Attributes:
        scattering_angle: 1 to 180 degrees [rad], shape [angle].
        wavelength_nm: [nm], shape [wavelength].
        eta: Dimensionless, shape [angle, wavelength].
    """

    scattering_angle: np.ndarray
    wavelength_nm: np.ndarray
    eta: np.ndarray


@dataclasses.dataclass(frozen=True)
class Spectra:
    """Spectra of Preetham et al. (1999) Table 2; every array has shape [wavelength].

    Attributes:
        wavelength_nm: 380, 390, ..., 780 [nm].
        K: Total scattering term of haze, dimensionless.
        S0: Mean daylight spectrum, relative.
        S1: First daylight component, relative.
        S2: Second daylight component, relative.
        sun_radiance: Extraterrestrial mean radiance of the solar disk [W m^-2 sr^-1 nm^-1]. The
            paper gives none at 760 to 780 nm; there its logarithm continues in a straight line
            with the mean slope from 700 to 750 nm.
        sun_is_extrapolated: Where `sun_radiance` is that continuation.
        k_ozone: Absorption coefficient of ozone [m^-1], 0 where the paper prints a dash.
        k_water: Of water vapour [m^-1], likewise.
        k_gas: Of mixed gases [no unit in the paper], likewise.
    """

    wavelength_nm: np.ndarray
    K: np.ndarray
    S0: np.ndarray
    S1: np.ndarray
    S2: np.ndarray
    sun_radiance: np.ndarray
    sun_is_extrapolated: np.ndarray
    k_ozone: np.ndarray
    k_water: np.ndarray
    k_gas: np.ndarray

    @property
    def sun_irradiance(self) -> np.ndarray:
        """Extraterrestrial solar irradiance [W m^-2 nm^-1], at normal incidence."""
        return self.sun_radiance * constant("sun_solid_angle")


@dataclasses.dataclass(frozen=True)
class Coefficients:
    """Sky model coefficients, Preetham et al. (1999) appendix A.2.

    Attributes:
        distribution: Perez coefficients of "Y", "x" and "y"; each array [A..E, (T, 1)].
        zenith_chromaticity: Of "x" and "y"; each array [(T^2, T, 1), (s^3, s^2, s, 1)], with the
            solar zenith angle s [rad].
        zenith_luminance: a, b, c, d of the zenith luminance [kcd m^-2].
    """

    distribution: dict[str, np.ndarray]
    zenith_chromaticity: dict[str, np.ndarray]
    zenith_luminance: np.ndarray


@dataclasses.dataclass(frozen=True)
class Constant:
    """One constant of the paper.

    Attributes:
        printed: As the paper prints it, in the unit given; None if the paper does not.
        used: As this package uses it.
        unit: Empty if dimensionless.
        reason: What the number is, or why the two differ.
    """

    printed: float | None
    used: float
    unit: str
    reason: str


@dataclasses.dataclass(frozen=True)
class ColourMatching:
    """CIE 1931 2 degree standard observer.

    Attributes:
        wavelength_nm: 380, 381, ..., 780 [nm], shape [wavelength].
        xyz: The curves xbar, ybar, zbar, shape [wavelength, 3].
    """

    wavelength_nm: np.ndarray
    xyz: np.ndarray


@dataclasses.dataclass(frozen=True)
class ExponentialFit:
    """Layers in each of which a density is exponential.

    Attributes:
        base: Altitude where each begins [m], shape [layer].
        scale_height: Of the density [m], shape [layer].
    """

    base: np.ndarray
    scale_height: np.ndarray


@functools.cache
def preetham1999_phase() -> Phase:
    """Table 1 of the paper."""
    rows = _rows("preetham1999_phase.csv")
    names = [name for name in rows[0] if name.startswith("eta_")]
    return Phase(
        scattering_angle=_frozen(np.radians(_column(rows, "theta_deg"))),
        wavelength_nm=_frozen([float(name[4:-2]) for name in names]),
        eta=_frozen(np.stack([_column(rows, name) for name in names], axis=-1)),
    )


@functools.cache
def preetham1999_spectra() -> Spectra:
    """Table 2 of the paper."""
    rows = _rows("preetham1999_spectra.csv")
    wavelength = _column(rows, "wavelength_nm")
    printed = _column(rows, "sun_radiance")
    missing = np.isnan(printed)
    first = np.flatnonzero(wavelength == SUN_FIT_FROM_NM)[0]
    last = np.flatnonzero(~missing)[-1]
    slope = np.log(printed[last] / printed[first]) / (wavelength[last] - wavelength[first])
    beyond = printed[last] * np.exp(slope * (wavelength - wavelength[last]))
    return Spectra(
        wavelength_nm=_frozen(wavelength),
        K=_frozen(_column(rows, "K")),
        S0=_frozen(_column(rows, "S0")),
        S1=_frozen(_column(rows, "S1")),
        S2=_frozen(_column(rows, "S2")),
        sun_radiance=_frozen(np.where(missing, beyond, printed)),
        sun_is_extrapolated=_frozen(missing),
        k_ozone=_frozen(np.nan_to_num(_column(rows, "k_o"))),
        k_water=_frozen(np.nan_to_num(_column(rows, "k_wa"))),
        k_gas=_frozen(np.nan_to_num(_column(rows, "k_g"))),
    )


@functools.cache
def preetham1999_coefficients() -> Coefficients:
    """Coefficients of appendix A.2."""
    cells: dict[str, list[float]] = {}
    for row in _rows("preetham1999_coefficients.csv"):
        cells.setdefault(row["matrix"], []).append(float(row["value"]))
    return Coefficients(
        distribution={q: _frozen(np.reshape(cells[q], (5, 2))) for q in ("Y", "x", "y")},
        zenith_chromaticity={
            q: _frozen(np.reshape(cells[f"{q}_zenith"], (3, 4))) for q in ("x", "y")
        },
        zenith_luminance=_frozen(cells["Y_zenith"]),
    )


@functools.cache
def preetham1999_constants() -> dict[str, Constant]:
    """Constants of the appendix by name, printed and corrected."""
    return {
        row["name"]: Constant(
            printed=float(row["printed"]) if row["printed"] else None,
            used=float(row["used"]),
            unit=row["unit"],
            reason=row["reason"],
        )
        for row in _rows("preetham1999_constants.csv")
    }


def constant(name: str) -> float:
    """The value in use of one of `preetham1999_constants`."""
    return preetham1999_constants()[name].used


@functools.cache
def cie1931_2deg() -> ColourMatching:
    """Colour matching functions of the CIE 1931 2 degree observer."""
    rows = _rows("cie1931_2deg.csv")
    curves = [_column(rows, name) for name in ("xbar", "ybar", "zbar")]
    return ColourMatching(
        wavelength_nm=_frozen(_column(rows, "wavelength_nm")),
        xyz=_frozen(np.stack(curves, axis=-1)),
    )


@functools.cache
def us_standard_1976_layers() -> ExponentialFit:
    """The density of the US Standard Atmosphere 1976, fitted by exponential layers."""
    rows = _rows("us_standard_1976_layers.csv")
    return ExponentialFit(
        base=_frozen(_column(rows, "base")),
        scale_height=_frozen(_column(rows, "scale_height")),
    )


def _rows(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file after its comment lines."""
    text = resources.files(__name__).joinpath(name).read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


def _column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    """A column as numbers; an empty cell is NaN."""
    return np.array([float(row[name] or "nan") for row in rows])


def _frozen(values: object) -> np.ndarray:
    """An array that cannot be written to, since every caller gets the same one."""
    array = np.array(values)
    array.flags.writeable = False
    return array
