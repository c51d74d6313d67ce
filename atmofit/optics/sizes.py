"""How many particles there are of each size."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from atmofit.checks import in_range
from atmofit.numerics import gauss_nodes

_NEGLIGIBLE = 1e-6
_NODES_IN_A_PANEL = 16
_SEARCHED = 1e5  # ratio to the typical radius within which the bounds are looked for


@dataclasses.dataclass(frozen=True)
class SizeDistribution:
    """Particles between two radii.

    Attributes:
        density: Particles per radius dn/dr at radii [m], in any unit: only ratios count. Takes and
            returns an array of shape [radius]; 0 or more.
        smallest_radius: [m], above 0.
        largest_radius: [m], above the smallest.
    """

    density: Callable[[np.ndarray], np.ndarray]
    smallest_radius: float
    largest_radius: float

    def __post_init__(self) -> None:
        """Check the bounds."""
        _positive("smallest_radius", self.smallest_radius, "m")
        _positive("largest_radius", self.largest_radius, "m")
        if self.largest_radius <= self.smallest_radius:
            raise ValueError(
                f"largest_radius must be above smallest_radius = {self.smallest_radius:.6g} m, "
                f"got {self.largest_radius:.6g}"
            )

    def quadrature(self, count: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Radii and the share of the particles that each stands for.

        Args:
            count: About how many radii, at least 2: Gauss-Legendre nodes in the logarithm, in equal
                panels of 16 or fewer.

        Returns:
            Radii [m], increasing, and shares that add to 1.

        Raises:
            ValueError: The count is too small, or the density is negative or nowhere above 0.
        """
        if count < 2:
            raise ValueError(f"radius_count must be at least 2, got {count}")
        # Panels, because the ripples of large spheres need nodes that are evenly spread.
        panels = math.ceil(count / _NODES_IN_A_PANEL)
        node, share = gauss_nodes(math.ceil(count / panels))
        u = ((np.arange(panels)[:, None] + node[None, :]) / panels).ravel()
        weight = np.tile(share, panels)
        radius = self.smallest_radius * np.exp(
            u * math.log(self.largest_radius / self.smallest_radius)
        )
        density = np.asarray(self.density(radius), float)
        if density.shape != radius.shape:
            raise ValueError(f"density must have the shape {radius.shape}, got {density.shape}")
        in_range("density", density, 0.0, math.inf)
        number = density * radius * weight
        if not number.sum() > 0:
            raise ValueError("density must be above 0 somewhere between the bounds, got 0")
        return radius, number / number.sum()


def junge_sizes(
    exponent: float = 4.0, smallest_radius: float = 0.04e-6, largest_radius: float = 10e-6
) -> SizeDistribution:
    """Junge's power law: particles per logarithm of the radius fall as radius^-exponent.

    Args:
        exponent: Junge's v [-], 0 to 10; 4 is usual, and between wide bounds the optical depth then
            falls as wavelength^-(v - 2).
        smallest_radius: [m].
        largest_radius: [m].

    References:
        Junge (1963), Air Chemistry and Radioactivity; Preetham et al. (1999), appendix A.3.
    """
    in_range("exponent", float(exponent), 0.0, 10.0)
    # Relative to a bound: no power of a small number overflows.
    return SizeDistribution(
        lambda radius: (radius / smallest_radius) ** -(exponent + 1),
        smallest_radius,
        largest_radius,
    )


def lognormal_sizes(
    median_radius: float,
    geometric_standard_deviation: float,
    bounds: tuple[float, float] | None = None,
) -> SizeDistribution:
    """A normal distribution of the logarithm of the radius.

    Args:
        median_radius: Of the number of particles [m].
        geometric_standard_deviation: [-], 1.01 to 5.
        bounds: Smallest and largest radius [m]; None: where all but a millionth of the particles,
            and of their radius^4, has been counted.

    References:
        Hansen and Travis (1974), Space Sci. Rev. 16, 527, eq. 2.60.
    """
    _positive("median_radius", median_radius, "m")
    in_range("geometric_standard_deviation", float(geometric_standard_deviation), 1.01, 5.0)
    width = math.log(geometric_standard_deviation)

    def density(radius: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * (np.log(radius / median_radius) / width) ** 2) / radius

    return SizeDistribution(
        density, *(_bounds(density, median_radius) if bounds is None else bounds)
    )


def modified_gamma_sizes(
    mode_radius: float,
    exponent: float,
    tail: float = 1.0,
    bounds: tuple[float, float] | None = None,
) -> SizeDistribution:
    """Deirmendjian's r^exponent exp(-(exponent / tail) (r / mode_radius)^tail).

    Args:
        mode_radius: Where dn/dr is largest [m].
        exponent: Of the rise below the mode, Deirmendjian's alpha [-], 0.1 to 20.
        tail: Of the fall above it, his gamma [-], 0.2 to 5.
        bounds: As for `lognormal_sizes`.

    References:
        Deirmendjian (1969), Electromagnetic Scattering on Spherical Polydispersions, eq. 90: haze M
        has mode 0.05 um, exponent 1, tail 0.5; cloud C1 has 4 um, 6, 1.
    """
    _positive("mode_radius", mode_radius, "m")
    in_range("exponent", float(exponent), 0.1, 20.0)
    in_range("tail", float(tail), 0.2, 5.0)

    def density(radius: np.ndarray) -> np.ndarray:
        ratio = radius / mode_radius
        # 1 at the mode, so that the numbers neither overflow nor vanish.
        return np.exp(exponent * np.log(ratio) - exponent / tail * (ratio**tail - 1))

    return SizeDistribution(density, *(_bounds(density, mode_radius) if bounds is None else bounds))


def _bounds(density: Callable[[np.ndarray], np.ndarray], typical: float) -> tuple[float, float]:
    """Radii beyond which the particles, or their radius^4, have become negligible."""
    radius = typical * np.geomspace(1 / _SEARCHED, _SEARCHED, 2001)
    number = np.cumsum(density(radius) * radius)
    fourth = np.cumsum((density(radius) * radius**5)[::-1])[::-1]
    first = np.flatnonzero(number > _NEGLIGIBLE * number[-1])[0]
    last = np.flatnonzero(fourth > _NEGLIGIBLE * fourth[0])[-1]
    return float(radius[first]), float(radius[last])


def _positive(name: str, value: float, unit: str) -> None:
    in_range(name, float(value), float(np.finfo(float).tiny), math.inf, unit)
