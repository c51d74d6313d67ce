"""The sun above the atmosphere."""

import functools
import math
import warnings

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import choice, in_range
from atmofit.extremes import Domain, extremes
from atmofit.spectrum import Spectrum, at
from atmofit.tables import preetham1999_spectra
from atmofit.typing import RealsLike


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
    least=0.0,
)(solar_irradiance_spectrum)


@functools.cache
def _astm_g173() -> tuple[np.ndarray, np.ndarray]:
    """Wavelength [nm] and irradiance [W m^-2 nm^-1] of ASTM G-173, extraterrestrial."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science speaks of optional packages
        from colour.plotting.datasets import astm_g_173

    table = astm_g_173.SD_ASTMG173_ETR
    return np.asarray(table.wavelengths, float), np.asarray(table.values, float)


def irradiance_at(
    wavelength_nm: Float[Array, " w"], given: RealsLike | Spectrum | None, preset: str
) -> Float[Array, " w"]:
    """Solar irradiance at some wavelengths [W m^-2 nm^-1].

    Args:
        wavelength_nm: [nm].
        given: A number, one for each wavelength, or a `Spectrum`; None: that of the preset.
        preset: As `solar_irradiance_spectrum`.

    Raises:
        ValueError: The shape does not fit, or a value is negative.
    """
    if given is None:
        given = solar_irradiance_spectrum(preset)
    if isinstance(given, Spectrum):
        return at(given, wavelength_nm)
    values = in_range("solar_irradiance", given, 0.0, math.inf, "W m^-2 nm^-1")
    if values.shape not in ((), wavelength_nm.shape):
        raise ValueError(
            "solar_irradiance must be a number or one for each wavelength "
            f"{wavelength_nm.shape}, got shape {values.shape}"
        )
    return jnp.broadcast_to(values.astype(wavelength_nm.dtype), wavelength_nm.shape)
