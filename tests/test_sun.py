"""The sun's spectra."""

import numpy as np
import pytest

import atmofit as af
from atmofit.tables import preetham1999_spectra


def test_irradiance_of_the_paper():
    spectrum = af.solar_irradiance_spectrum("preetham1999")
    table = preetham1999_spectra()
    np.testing.assert_allclose(spectrum.values, table.sun_radiance * 6.7637e-5, rtol=1e-12)
    np.testing.assert_allclose(spectrum([380.0, 390.0, 400.0]), [1.120, 1.098, 1.429], atol=6e-4)
    inside = np.asarray(spectrum.wavelength_nm) <= 750
    total = np.asarray(spectrum.values)[inside].sum() * 10
    assert total == pytest.approx(616.6, rel=2e-3)  # sum of the printed table, see the errata


def test_standard_spectrum():
    spectrum = af.solar_irradiance_spectrum("standard")
    wavelength, values = np.asarray(spectrum.wavelength_nm), np.asarray(spectrum.values)
    assert (wavelength[0], wavelength[-1]) == (280, 4000)
    total = ((values[1:] + values[:-1]) / 2 * np.diff(wavelength)).sum()
    assert total == pytest.approx(1348, rel=5e-3)  # solar constant, less 1.4 % outside 280-4000 nm
    # Two sources of one sun: the paper's is Neckel and Labs', within 8 % over 50 nm.
    old = af.solar_irradiance_spectrum("preetham1999")
    for low in range(400, 750, 50):
        band = np.arange(low, low + 50.0)
        assert float(spectrum(band).mean()) == pytest.approx(float(old(band).mean()), rel=0.08)


def test_unknown_preset():
    with pytest.raises(ValueError, match='preset must be one of "preetham1999", "standard"'):
        af.solar_irradiance_spectrum("moon")
