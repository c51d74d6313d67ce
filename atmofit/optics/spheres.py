"""Scattering by single spheres, by the theory of Mie (1908).

The series coefficients come from the package miepython (extra `mie`); here they are summed over the
orders for many angles at once. The environment variable MIEPYTHON_USE_JIT=1 makes miepython compile
itself, which is worth it from some 10,000 spheres on.
"""

import dataclasses
from types import ModuleType

import numpy as np
from jaxtyping import Float

from atmofit.checks import in_range

SMALLEST_SIZE_PARAMETER, LARGEST_SIZE_PARAMETER = 1e-5, 1e4
_LEAST_CONTRAST = 1e-6  # below it rounding is all that scatters
_SPHERES_AT_A_TIME = 32


@dataclasses.dataclass(frozen=True)
class Spheres:
    """What single spheres do with unpolarised light, by size parameter.

    Attributes:
        extinction_efficiency: Cross section over that of the shadow [-], shape [sphere].
        scattering_efficiency: Likewise, of scattering alone.
        asymmetry: Mean cosine of the scattering angle [-], shape [sphere].
        intensity: i1 + i2 = |S1|^2 + |S2|^2 [-], shape [angle, sphere]; divided by 2 k^2, with the
            wavenumber k, it is the scattering cross section per solid angle.
    """

    extinction_efficiency: Float[np.ndarray, " n"]
    scattering_efficiency: Float[np.ndarray, " n"]
    asymmetry: Float[np.ndarray, " n"]
    intensity: Float[np.ndarray, "k n"]


def sphere_scattering(
    refractive_index: complex | float,
    size_parameter: Float[np.ndarray, " n"],
    scattering_angle: Float[np.ndarray, " k"],
) -> Spheres:
    """Efficiencies and intensities of single spheres.

    Args:
        refractive_index: Relative to the air [-], as for `mie_optics`.
        size_parameter: Circumference over wavelength [-], increasing, 0.00001 to 10,000.
        scattering_angle: [rad].

    Raises:
        ValueError: A number lies outside its range.
        ModuleNotFoundError: The extra `mie` is not installed.
    """
    index = complex(refractive_index)
    in_range("real part of refractive_index", index.real, 0.1, 10.0)
    in_range("imaginary part of refractive_index", index.imag, -10.0, 10.0)
    if abs(index - 1) < _LEAST_CONTRAST:
        raise ValueError(
            f"refractive_index must differ from 1 by at least {_LEAST_CONTRAST:g}, got {index:.9g}"
        )
    in_range("size_parameter", size_parameter, SMALLEST_SIZE_PARAMETER, LARGEST_SIZE_PARAMETER)
    starts = range(0, size_parameter.size, _SPHERES_AT_A_TIME)
    groups = [size_parameter[start : start + _SPHERES_AT_A_TIME] for start in starts]
    series = [_coefficients(index, group) for group in groups]
    angular = _angular_functions(np.cos(scattering_angle), max(a.shape[0] for a, _ in series))
    blocks = [
        _sums(index, group, pair, angular) for group, pair in zip(groups, series, strict=True)
    ]
    joined = [np.concatenate(part, axis=-1) for part in zip(*blocks, strict=True)]
    return Spheres(*joined)


def _sums(
    index: complex,
    size_parameter: np.ndarray,
    coefficients: tuple[np.ndarray, np.ndarray],
    angular: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The fields of `Spheres` for spheres of similar size."""
    a, b = coefficients
    n = np.arange(1.0, a.shape[0] + 1)
    scale = ((2 * n + 1) / (n * (n + 1)))[:, None]
    pi, tau = (function[:, : n.size] for function in angular)
    even, odd = (pi + tau) @ (scale * (a + b)), (pi - tau) @ (scale * (a - b))
    # |S1|^2 + |S2|^2, where S1 + S2 = even and S1 - S2 = odd.
    intensity = (np.abs(even) ** 2 + np.abs(odd) ** 2) / 2
    per_x2 = 2 / size_parameter**2
    scattering = per_x2 * ((2 * n + 1) @ (np.abs(a) ** 2 + np.abs(b) ** 2))
    extinction = per_x2 * ((2 * n + 1) @ np.real(a + b))
    if index.imag == 0:
        extinction = scattering  # equal but for rounding
    following = np.real(a[:-1] * a[1:].conj() + b[:-1] * b[1:].conj())
    asymmetry = (n * (n + 2) / (n + 1))[:-1] @ following + scale[:, 0] @ np.real(a * b.conj())
    return extinction, scattering, 2 * per_x2 * asymmetry / scattering, intensity


def _coefficients(index: complex, size_parameter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mie coefficients a and b, [order, sphere], 0 where a sphere needs no more orders."""
    mie = _miepython()
    absorbing = complex(index.real, -abs(index.imag))  # miepython's sign
    both = [mie.coefficients(absorbing, float(x)) for x in size_parameter]
    found = np.zeros((2, max(pair.shape[1] for pair in both), len(both)), complex)
    for place, pair in enumerate(both):
        found[:, : pair.shape[1], place] = pair
    return found[0], found[1]


def _angular_functions(cosine: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The functions pi_n and tau_n, [angle, n = 1 to count]; Bohren and Huffman eq. 4.47."""
    pi = np.zeros((cosine.size, count + 1))
    tau = np.zeros_like(pi)
    pi[:, 1] = 1.0
    for n in range(1, count + 1):
        if n > 1:
            pi[:, n] = ((2 * n - 1) * cosine * pi[:, n - 1] - n * pi[:, n - 2]) / (n - 1)
        tau[:, n] = n * cosine * pi[:, n] - (n + 1) * pi[:, n - 1]
    return pi[:, 1:], tau[:, 1:]


def _miepython() -> ModuleType:
    try:
        import miepython
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            'Mie scattering needs the package miepython: pip install "atmofit[mie]"'
        ) from error
    return miepython
