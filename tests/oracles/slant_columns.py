"""Slant columns of the quadrature oracle: integrated numerically, then tabulated in splines."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline

from oracles import Reals

TINY = 1e-300

SlantColumn = Callable[[Reals, Reals], Reals]


@lru_cache
def gauss_legendre(count: int) -> tuple[Reals, Reals]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2, weights / 2


def _slant_distance(low: Reals, high: Reals, cos_zenith: Reals, radius: float) -> Reals:
    """Straight distance upward from altitude low, at zenith cosine >= 0, to altitude high."""
    vertical = (radius + low) * cos_zenith
    rise = (high - low) * (2 * radius + low + high)
    return rise / (vertical + np.sqrt(vertical**2 + rise) + TINY)


def _integrated_column(
    density: Callable[[Reals], Reals],
    altitude: Reals,
    cos_zenith: Reals,
    length: Reals,
    radius: float,
    panels: int,
) -> Reals:
    """Integral of density along straight rays of a given length, by Gauss quadrature."""
    x, w = gauss_legendre(24)
    total = np.zeros(np.broadcast(altitude, cos_zenith).shape)
    r = (radius + altitude)[..., None]
    for panel in range(panels):
        s = length[..., None] * (panel + x) / panels
        change = (2 * r * cos_zenith[..., None] + s) * s
        rise = change / (np.sqrt(r**2 + change) + r)
        total += length / panels * (density(altitude[..., None] + rise) @ w)
    return total


def _cosine_grid(altitude: Reals, width: float) -> tuple[Reals, Reals, Reals]:
    """Nodes u = cos / (cos + width), horizon to zenith; the mesh of altitudes and cosines."""
    u = np.linspace(0, 1 / (1 + width), 121)
    z, v = np.meshgrid(altitude, u, indexing="ij")
    return u, z, np.minimum(width * v / (1 - v), 1.0)


@lru_cache
def exponential_column(scale_height: float, radius: float, top: float) -> SlantColumn:
    """Slant column of exp(-z/H)/H, upward to the top of a spherical atmosphere, within 1e-7.

    Args:
        scale_height: [m].
        radius: Of the planet [m].
        top: Altitude where the atmosphere ends [m].

    Returns:
        Function of altitude [m] and zenith cosine >= 0, arrays of one shape.
    """
    width = float(np.sqrt(2 * scale_height / radius))
    z_nodes = np.linspace(0, top, 9)
    u_nodes, z, cosine = _cosine_grid(z_nodes, width)
    # exp(z/H) times the column continued to infinity is smooth: table its logarithm.
    length = _slant_distance(z, z + 40 * scale_height, cosine, radius)
    zero = np.zeros_like(z)

    def relative(rise: Reals) -> Reals:
        return np.exp(-rise / scale_height) / scale_height

    # Passing the altitude as part of the radius leaves only the rise above the starting point.
    scaled = np.stack(
        [
            _integrated_column(relative, zero[i], cosine[i], length[i], radius + z_nodes[i], 6)
            for i in range(len(z_nodes))
        ]
    )
    smooth = np.log(scaled * (cosine + width))
    inside = RectBivariateSpline(z_nodes, u_nodes, smooth, kx=3, ky=5)
    beyond = CubicSpline(u_nodes, smooth[-1])
    at_top = np.exp(-top / scale_height)

    def column(altitude: Reals, cos_zenith: Reals) -> Reals:
        shifted = cos_zenith + width
        full = np.exp(inside.ev(altitude, cos_zenith / shifted) - altitude / scale_height) / shifted
        ratio = (radius + altitude) / (radius + top)
        above = np.sqrt(np.maximum(1 - ratio**2 * (1 - cos_zenith**2), 0)) + width
        return full - at_top * np.exp(beyond(1 - width / above)) / above

    return column


def density_column(
    density: Callable[[Reals], Reals], radius: float, top: float, *, spherical: bool
) -> SlantColumn:
    """Slant column of any smooth density, upward to the top, 1 for the whole vertical."""
    levels = np.linspace(0, top, 4001)
    cumulative = CubicSpline(levels, density(levels)).antiderivative()
    vertical = float(cumulative(top))
    if not spherical:
        return lambda altitude, cos_zenith: (1 - cumulative(altitude) / vertical) / cos_zenith
    width, z_nodes = 0.05, np.linspace(0, top, 241)
    u_nodes, z, cosine = _cosine_grid(z_nodes, width)
    length = _slant_distance(z, np.full_like(z, top), cosine, radius)
    column = _integrated_column(density, z, cosine, length, radius, 12) / vertical
    table = RectBivariateSpline(z_nodes, u_nodes, column * (cosine + width))
    return lambda altitude, cos_zenith: (
        table.ev(altitude, cos_zenith / (cos_zenith + width)) / (cos_zenith + width)
    )


def flat_exponential_column(scale_height: float, top: float) -> SlantColumn:
    """Slant column of exp(-z/H)/H, upward to the top of a flat atmosphere."""
    at_top = np.exp(-top / scale_height)
    return lambda altitude, cosine: (np.exp(-altitude / scale_height) - at_top) / cosine
