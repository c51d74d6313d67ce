"""The sun above the atmosphere."""

import functools
import warnings

import numpy as np

from atmofit.checks import choice
from atmofit.extremes import Domain, extremes
from atmofit.spectrum import Spectrum
from atmofit.tables import preetham1999_spectra


def solar_irradiance_spectrum(preset: str) -> Spectrum:
    """Extraterrestrial solar irradiance at normal incidence.

    Args:
        preset: "preetham1999": Table 2 of the paper, 380 to 780 nm, of which 760 to 780 nm are
            extrapolated; "standard": ASTM G-173, as colour-science carries it, 280 to 4000 nm.

    Returns:
        Spectrum [W m^-2 nm^-1].
    """
    choice("preset", preset, ("preetham1999", "standard"))
    if preset == "preetham1999":
        table = preetham1999_spectra()
        return Spectrum(table.wavelength_nm, table.sun_irradiance)
    return Spectrum(*_astm_g173())


extremes(
    call=lambda wavelength_nm: solar_irradiance_spectrum("preetham1999")(wavelength_nm),
    wavelength_nm=Domain(380.0, 780.0),
)(solar_irradiance_spectrum)


@functools.cache
def _astm_g173() -> tuple[np.ndarray, np.ndarray]:
    """Wavelength [nm] and irradiance [W m^-2 nm^-1] of ASTM G-173, extraterrestrial."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science speaks of optional packages
        from colour.plotting.datasets import astm_g_173

    table = astm_g_173.SD_ASTMG173_ETR
    return np.asarray(table.wavelengths, float), np.asarray(table.values, float)
