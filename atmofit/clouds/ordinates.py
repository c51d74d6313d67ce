"""Directions that stand for all: quadrature over the sphere, and scattering among them."""

import functools
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.clouds.volume import Vector
from atmofit.numerics import legendre_table
from atmofit.optics.phase import PhaseFunction, resolved
from atmofit.typing import Reals, Scalar

# Number of directions: the degree to which the rule is exact, and its orbits, each a direction
# with all permutations and changes of sign of its components, and the weight of each member.
_RULES: dict[int, tuple[int, tuple[tuple[tuple[float, float], float], ...]]] = {
    14: (5, (((0.0, 0.0), 1 / 15), ((3**-0.5, 3**-0.5), 0.075))),
    26: (
        7,
        (((0.0, 0.0), 1 / 21), ((0.0, 0.5**0.5), 4 / 105), ((3**-0.5, 3**-0.5), 9 / 280)),
    ),
    38: (
        9,
        (
            ((0.0, 0.0), 1 / 105),
            ((0.0, 0.4597008433809831), 1 / 35),
            ((3**-0.5, 3**-0.5), 9 / 280),
        ),
    ),
    50: (
        11,
        (
            ((0.0, 0.0), 4 / 315),
            ((0.0, 0.5**0.5), 64 / 2835),
            ((11**-0.5, 11**-0.5), 14641 / 725760),
            ((3**-0.5, 3**-0.5), 27 / 1280),
        ),
    ),
    86: (
        15,
        (
            ((0.0, 0.0), 0.01154401154401154),
            ((0.0, 0.3742430390903412), 0.01181230374690448),
            ((0.18906355288539498, 0.6943540066026664), 0.01187650129453714),
            ((0.3696028464541502, 0.3696028464541502), 0.0111105557106034),
            ((3**-0.5, 3**-0.5), 0.01194390908585628),
        ),
    ),
    110: (
        17,
        (
            ((0.0, 0.0), 0.0038282704949371615),
            ((0.0, 0.4783690288121502), 0.009694996361663029),
            ((0.1851156353447362, 0.1851156353447362), 0.008211737283191111),
            ((0.21595729184584844, 0.6904210483822922), 0.009942814891178103),
            ((0.3956894730559419, 0.3956894730559419), 0.009595471336070962),
            ((3**-0.5, 3**-0.5), 0.009793737512487513),
        ),
    ),
}
COUNTS = tuple(_RULES)


def degree_held(count: int) -> int:
    """The last Legendre degree of a phase function that this many directions scatter exactly."""
    return (_RULES[count][0] - 1) // 2


@functools.cache
def ordinates(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature over the sphere that treats x, y and z and their signs alike.

    Args:
        count: Of the directions, one of `COUNTS`.

    Returns:
        Unit vectors [direction, 3], those with the same longest component together,
        and weights [sr] that add to 4 pi.

    References:
        Lebedev (1976), USSR Comp. Math. Math. Phys. 16 (2), 10.
    """
    found = []
    for (one, other), weight in _RULES[count][1]:
        third = math.sqrt(1 - one**2 - other**2)
        members = {
            tuple(np.round(np.multiply(signs, order), 15) + 0.0)
            for order in itertools.permutations((one, other, third))
            for signs in itertools.product((1.0, -1.0), repeat=3)
        }
        found += [(member, 4 * math.pi * weight) for member in sorted(members)]
    directions = np.array([member for member, _ in found])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    axis = dominant_axis(directions, (1.0, 1.0, 1.0))
    order = np.argsort(axis, kind="stable")
    return directions[order], np.array([weight for _, weight in found])[order]


def dominant_axis(directions: np.ndarray, size: tuple[float, ...]) -> np.ndarray:
    """Along which each direction crosses the most voxels of a size."""
    steps = np.abs(directions) / np.asarray(size)
    # The first of those that differ by rounding only.
    return np.argmax(steps > steps.max(axis=1, keepdims=True) * (1 - 1e-6), axis=1)


def groups(axis: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Directions alike in the axis that they follow: the axis, and which."""
    return [(a, np.flatnonzero(axis == a)) for a in range(3) if np.any(axis == a)]


class ScaledPhase(eqx.Module):
    """A phase function without the part of its forward peak that directions cannot hold.

    Attributes:
        moments: Legendre moments of the rest [-].
        peak: Share of the scattered light that the peak is [-]; it counts as not scattered.

    References:
        Wiscombe (1977), J. Atmos. Sci. 34, 1408.
    """

    moments: Float[Array, " l"]
    peak: Scalar

    @classmethod
    def of(cls, phase: PhaseFunction, count: int, wavelength: Float[Array, "1"]) -> "ScaledPhase":
        """Cut so that this number of directions holds the rest."""
        degrees = degree_held(count) + 1
        moments = phase.moments(degrees + 1, wavelength)[:, 0].astype(wavelength.dtype)
        return cls(*resolved(moments))

    def matrix(self, count: int) -> Float[Array, "into out_of"]:
        """Share of the light of one direction that is scattered into another; columns add to 1."""
        directions, weight = ordinates(count)
        table = legendre_table(directions @ directions.T, self.moments.size)
        series = jnp.asarray(table * weight[:, None, None], self.moments.dtype)
        return series @ self._coefficients()

    def between(self, count: int, direction: Vector) -> Float[Array, " direction"]:
        """Phase function [1/sr] between one direction and each of the quadrature."""
        directions, _ = ordinates(count)
        return self.value(jnp.asarray(directions, direction.dtype) @ direction)

    def value(self, cosine: Reals) -> Reals:
        """Phase function [1/sr] by the cosine of the scattering angle."""
        return legendre(cosine, self.moments.size) @ self._coefficients()

    def _coefficients(self) -> Float[Array, " l"]:
        two_l = 2 * np.arange(self.moments.size) + 1
        return self.moments * jnp.asarray(two_l / (4 * math.pi), self.moments.dtype)


def legendre(cosine: Reals, count: int) -> Reals:
    """P_0 .. P_(count-1) on a new last axis, count at least 2."""
    n = np.arange(1, count - 1)
    factors = ((2 * n + 1) / (n + 1), n / (n + 1))

    def next_degree(
        two: tuple[Reals, Reals], factor: tuple[Scalar, Scalar]
    ) -> tuple[tuple[Reals, Reals], Reals]:
        before, last = two
        new = factor[0] * cosine * last - factor[1] * before
        return (last, new), new

    start = (jnp.ones_like(cosine), cosine)
    one, other = (jnp.asarray(factor, cosine.dtype) for factor in factors)
    _, more = jax.lax.scan(next_degree, start, (one, other))
    return jnp.moveaxis(jnp.concatenate([jnp.stack(start), more]), 0, -1)
