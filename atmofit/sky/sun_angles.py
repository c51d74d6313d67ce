"""Local solar zenith angles at which light is known, dense about the horizon. NumPy only."""

import math

import numpy as np

from atmofit.numerics import chebyshev_nodes, chebyshev_transform

TWILIGHT_WIDTH = math.radians(3.5)  # sun angles are dense within this of the horizon

SunRange = tuple[float, float]  # least and largest solar zenith angle [rad]


def sun_ends(suns: SunRange) -> SunRange:
    """Ends of the coordinate asinh((angle - pi/2) / width)."""
    low, high = (math.asinh((end - math.pi / 2) / TWILIGHT_WIDTH) for end in suns)
    return low, high


def sun_nodes(count: int, suns: SunRange) -> np.ndarray:
    """Solar zenith angles [rad] at the Chebyshev nodes of that coordinate."""
    low, high = sun_ends(suns)
    unit = (chebyshev_nodes(count) + 1) / 2
    return math.pi / 2 + TWILIGHT_WIDTH * np.sinh(low + (high - low) * unit)


def sun_basis(angle: np.ndarray, count: int, suns: SunRange) -> np.ndarray:
    """Weights of the nodes in the value at an angle [rad], on a new last axis."""
    low, high = sun_ends(suns)
    place = 2 * (np.arcsinh((angle - math.pi / 2) / TWILIGHT_WIDTH) - low) / (high - low) - 1
    chebyshev = np.cos(np.arange(count) * np.arccos(np.clip(place, -1.0, 1.0))[..., None])
    return chebyshev @ chebyshev_transform(count)
