"""Independent reference solutions of the sky, for the tests only.

They share no code with the library: only NumPy and SciPy are imported. The two solvers share no
code with each other either, apart from this description of what the air is made of.

- `oracles.nested_quadrature`: orders 1 and 2 by nested quadrature, all wavelengths at once.
- `oracles.backward_monte_carlo`: any order by backward Monte Carlo, one wavelength, with errors.

Conventions: SI units, radians; `relative_azimuth` is 0 toward the sun; phase functions integrate
to 1 over the sphere [sr^-1] and take the cosine of the scattering angle (1 = forward); the results
are downward radiance at the ground divided by the solar irradiance at the top [sr^-1].
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Reals = NDArray[np.float64]
PhaseFunction = Callable[[Reals, NDArray[np.intp]], Reals]

EARTH_RADIUS = 6371e3  # [m]
ATMOSPHERE_TOP = 120e3  # [m]


@dataclasses.dataclass(frozen=True)
class Scatterer:
    """A constituent with extinction optical_depth / scale_height exp(-z / scale_height).

    Attributes:
        optical_depth: Vertical, of the profile continued to infinity [-], number or [wavelength].
        scale_height: [m].
        phase_function: Called as phase_function(cos_scattering_angle, wavelength_index) with arrays
            that broadcast against each other; returns what broadcasts to their common shape
            [sr^-1].
        single_scattering_albedo: [-], number or [wavelength].
    """

    optical_depth: ArrayLike
    scale_height: float
    phase_function: PhaseFunction
    single_scattering_albedo: ArrayLike = 1.0


@dataclasses.dataclass(frozen=True)
class Absorber:
    """A gas that only absorbs.

    Attributes:
        optical_depth: Vertical, from the ground to the top [-], number or [wavelength].
        density: Relative density as a function of altitude [m]; smooth over half a kilometre.
    """

    optical_depth: ArrayLike
    density: Callable[[Reals], Reals]


Constituents = Sequence[Scatterer | Absorber]


def rayleigh_phase(cos_scattering_angle: Reals, wavelength_index: NDArray[np.intp]) -> Reals:
    """Scattering by molecules without depolarisation [sr^-1]."""
    del wavelength_index
    return 3 / (16 * np.pi) * (1 + cos_scattering_angle**2)


def henyey_greenstein_phase(asymmetry: float) -> PhaseFunction:
    """The Henyey-Greenstein phase function with the given mean cosine [sr^-1]."""

    def phase(cos_scattering_angle: Reals, wavelength_index: NDArray[np.intp]) -> Reals:
        del wavelength_index
        g = asymmetry
        return (1 - g**2) / (4 * np.pi) * (1 + g**2 - 2 * g * cos_scattering_angle) ** -1.5

    return phase
