"""The few wavelengths at which a sky must be known for its luminance alone. Python only.

Luminance is one integral over the spectrum, with a known weight: the sun's irradiance times the
eye's response. The nodes of Gauss quadrature for that weight are the best places to know the
spectrum at; between them its logarithm is interpolated, which a low sun's steep spectrum needs.
"""

import dataclasses
import functools
from types import MappingProxyType

import jax
import numpy as np
from numpy.typing import NDArray

from atmofit.colour import spectrum_to_XYZ
from atmofit.sun import solar_irradiance_spectrum

# The spectrum that stands behind a luminance: what 380 to 780 nm by 10 nm would give.
_WAVELENGTH_NM = np.arange(380.0, 781.0, 10.0)


# How many, for each rung of the ladder.
COUNTS = MappingProxyType({1e-1: 3, 5e-2: 3, 1e-2: 4, 2e-3: 7, 5e-4: 10})


@dataclasses.dataclass(frozen=True)
class LuminanceNodes:
    """From radiance over solar irradiance at a few wavelengths to luminance.

    Attributes:
        wavelength_nm: The few wavelengths, increasing [nm], [node].
        interpolation: Takes log radiance from them to all wavelengths, [wavelength, node]; None
            if all are computed.
        weight: Of all wavelengths in luminance [cd m^-2 per 1/sr], [wavelength].
    """

    wavelength_nm: NDArray[np.float64]
    interpolation: NDArray[np.float64] | None
    weight: NDArray[np.float64]


@functools.cache
def luminance_nodes(count: int, preset: str) -> LuminanceNodes:
    """Nodes of Gauss quadrature for luminance, in 1 / wavelength^2, and the way on from there.

    Args:
        count: Number of wavelengths; 0: all, 380 to 780 nm by 10 nm.
        preset: Of the sun's spectrum, see `solar_irradiance_spectrum`.

    References:
        Golub and Welsch (1969), Math. Comp. 23, 221, for nodes as eigenvalues.
    """
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        irradiance = np.asarray(solar_irradiance_spectrum(preset)(_WAVELENGTH_NM), float)
        each = np.asarray(spectrum_to_XYZ(np.eye(_WAVELENGTH_NM.size), _WAVELENGTH_NM))[:, 1]
    weight = each * irradiance
    if count == 0:
        return LuminanceNodes(_WAVELENGTH_NM, None, weight)
    low, high = _WAVELENGTH_NM[-1] ** -2, _WAVELENGTH_NM[0] ** -2
    place = 2 * (_WAVELENGTH_NM**-2 - low) / (high - low) - 1
    polynomials = np.polynomial.chebyshev.chebvander(place, count - 1)
    orthonormal, _ = np.linalg.qr(np.sqrt(weight)[:, None] * polynomials)
    nodes = np.linalg.eigvalsh(orthonormal.T @ (place[:, None] * orthonormal))[::-1]
    at_nodes = np.polynomial.chebyshev.chebvander(nodes, count - 1)
    wavelength = (low + (high - low) * (nodes + 1) / 2) ** -0.5
    return LuminanceNodes(wavelength, polynomials @ np.linalg.inv(at_nodes), weight)
