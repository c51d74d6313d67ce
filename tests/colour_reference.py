"""colour-science for the tests: it warns on import, and warnings are errors here."""

import functools
import importlib.util
import types
import warnings

import numpy as np
import pytest

needed = pytest.mark.skipif(
    importlib.util.find_spec("colour") is None, reason="colour-science is not installed"
)


@functools.cache
def colour_science() -> types.ModuleType:
    """The package, imported without its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
        import colour.colorimetry
    return colour


def colour_matching_functions(wavelength_nm: np.ndarray) -> np.ndarray:
    """CIE 1931 2 degree curves, [wavelength, 3]."""
    curves = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.array([curves[wavelength] for wavelength in wavelength_nm])
