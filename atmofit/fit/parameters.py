"""The parameters in which a Perez formula is fitted, where the search begins, and the prior.

A, B, C, D, E themselves are a poor choice. Where the sky falls in a straight line with the angle
from the sun (the chromaticity of a low sun), C runs to infinity while D runs to 0 and C D stays;
where the horizon does not differ from the zenith, B is free; where the sky grows like the air
mass, A and 1 / B run away together. So a fit searches in

    w = ln(1 + A exp B),   ln(-B),   C,   ln(-D),   E

which keeps the horizon's factor positive over the whole sky and both exponentials falling, with
a weak prior that decides what the data leave open.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.fit import least_squares
from atmofit.typing import Reals

RELEASE = (0.1, 0.01)  # strengths of the prior before its own
# Random starts: A, B, C, D, E, and the least 1 + A exp B where a draw has none that is positive.
LOWEST_START = (-1.3, -2.5, 0.0, -4.0, -0.5)
HIGHEST_START = (0.5, -0.05, 10.0, -0.1, 1.0)
DARKEST_START = 0.05
NAMES = ("A", "B", "C", "D", "E")


def _numbers(value: Any) -> np.ndarray:
    """A NumPy array, so that a prior can be made at import; it is traced all the same."""
    return np.asarray(value, float)


class PerezPrior(eqx.Module):
    """A weak prior on w = ln(1 + A exp B), ln(-B), C, ln(-D) and E.

    Attributes:
        strength: A parameter one width away from its centre counts like a residual of this size
            in every direction, relative to the value. 1e-3 is far below what the formula misses
            in any sky, and enough for every fit to have one finite minimum. Zero: no prior.
        centre: Of the five parameters; ln 0.3 and ln 2 stand for B = -0.3 and D = -2.
        width: Of the five parameters.
    """

    strength: np.ndarray = eqx.field(converter=_numbers, default=1e-3)
    centre: np.ndarray = eqx.field(
        converter=_numbers, default=(-0.3, math.log(0.3), 0.0, math.log(2.0), 0.0)
    )
    width: np.ndarray = eqx.field(converter=_numbers, default=(0.5, 0.7, 10.0, 1.0, 1.0))

    def __check_init__(self) -> None:
        """Check the numbers."""
        if self.strength.shape != () or not 0 <= self.strength < np.inf:
            raise ValueError(f"strength must be at least 0, got {self.strength}")
        for name in ("centre", "width"):
            values = getattr(self, name)
            if values.shape != (5,) or not np.isfinite(values).all():
                raise ValueError(f"{name} must hold 5 finite numbers, got {values}")
        if self.width.min() <= 0:
            raise ValueError(f"width must be positive, got {self.width}")

    def fresh(self) -> "PerezPrior":
        """A copy for one program: of an array that is kept, JAX remembers the precision."""
        return jax.tree.map(lambda leaf: leaf.copy(), self)

    def place(self, free: Reals) -> Reals:
        """Free parameters [..., 5] in widths from the centre, where the prior is a ridge."""
        centre, width = self._broadcast(free)
        return (free - centre) / width

    def free(self, place: Reals) -> Reals:
        """Free parameters from widths, both [..., 5]; the inverse of `place`."""
        centre, width = self._broadcast(place)
        return centre + width * place

    def _broadcast(self, array: Reals) -> tuple[Reals, Reals]:
        shape = (1,) * (array.ndim - 1) + (5,)
        centre = jnp.asarray(self.centre, array.dtype).reshape(shape)
        return centre, jnp.asarray(self.width, array.dtype).reshape(shape)

    def residuals(self, free: Reals) -> Reals:
        """Residuals of the prior, [..., 5] like the free parameters.

        They stand beside residuals of the data that are divided by the root of their number.
        """
        return jnp.asarray(self.strength, free.dtype) * self.place(free)


def to_coefficients(free: Reals) -> Reals:
    """A, B, C, D, E from the free parameters; both [..., 5]."""
    w, log_b, C, log_d, E = jnp.moveaxis(free, -1, 0)
    B = -jnp.exp(log_b)
    return jnp.stack([jnp.expm1(w) * jnp.exp(-B), B, C, -jnp.exp(log_d), E], axis=-1)


def to_free(coefficients: Reals) -> Reals:
    """The free parameters from A, B, C, D, E; the inverse of `to_coefficients`."""
    A, B, C, D, E = jnp.moveaxis(coefficients, -1, 0)
    return jnp.stack([jnp.log1p(A * jnp.exp(B)), jnp.log(-B), C, jnp.log(-D), E], axis=-1)


def random_starts(count: int, ends: int, seed: int) -> np.ndarray:
    """Free parameters drawn evenly from the box of A..E, shape [start, end, 5].

    Where 1 + A exp(B) is below 0.05 (in one draw of 200; below 0 there are no free parameters) it
    is set to that.
    """
    low, high = np.array(LOWEST_START), np.array(HIGHEST_START)
    draws = low + (high - low) * np.random.default_rng(seed).random((count, ends, 5))
    A, B, C, D, E = np.moveaxis(draws, -1, 0)
    w = np.log(np.maximum(1 + A * np.exp(B), DARKEST_START))
    return np.stack([w, np.log(-B), C, np.log(-D), E], axis=-1)


def paths(prior: PerezPrior, ends: int, dtype: jnp.dtype) -> least_squares.Paths:
    """The paths of a search: straight from its start, and released from a strong prior.

    The strong prior pulls toward three horizons: the prior's own, a dark one that reaches high,
    and a low one; for two ends, alike at both or low at the highest turbidity. These were enough
    to find the lowest known minimum of all 183 fits of the reference job.
    """
    usual = jnp.zeros(5, dtype)

    def with_horizon(w: float, b: float) -> Reals:
        place = prior.place(jnp.asarray([w, math.log(b), 0.0, 0.0, 0.0], dtype))
        return usual.at[:2].set(place[:2])

    high, low, lowest = with_horizon(-1.5, 0.1), with_horizon(-0.6, 1.0), with_horizon(0.0, 3.0)
    pulls = [(usual,), (high,), (low,)]
    if ends == 2:
        pulls = [(usual, usual), (high, high), (usual, lowest)]
    straight = jnp.zeros(5 * ends, dtype)
    strength = jnp.asarray(prior.strength, dtype)
    released = jnp.append(jnp.maximum(jnp.asarray(RELEASE, dtype), strength), strength)
    return least_squares.Paths(
        jnp.stack([jnp.full_like(released, strength), *[released] * len(pulls)]),
        jnp.stack([straight, *[jnp.concatenate(pull) for pull in pulls]]),
    )


def pull_back(
    coefficients: Callable[[Reals], Reals],
    place: Reals,
    gradient: Float[Array, "k 5"],
    hessian: Float[Array, "k 5 5"],
) -> tuple[Reals, Reals]:
    """Gradient and Hessian of a loss by what its coefficients are made of.

    Args:
        coefficients: From parameters to k sets of A..E.
        place: The parameters, shape [p].
        gradient: Of the loss by each set.
        hessian: Likewise; sets do not mix in the loss.

    Returns:
        Gradient [p] and Hessian [p, p].
    """
    jacobian = jax.jacfwd(coefficients)(place)
    bend = jax.hessian(lambda p: jnp.sum(gradient * coefficients(p)))(place)
    straight = jnp.einsum("kia,kij,kjb->ab", jacobian, hessian, jacobian)
    return jnp.einsum("ki,kia->a", gradient, jacobian), straight + bend


def candidates() -> np.ndarray:
    """Free parameters to begin from, shape [candidate, 5]."""
    # w and -B, from a bright to a dark horizon; C, -D and E, from no glare to a narrow one.
    horizon = ((-1.5, 0.2), (-0.3, 0.15), (-0.3, 0.5), (0.3, 0.3), (1.5, 0.2), (4.0, 0.2))
    sun = (
        (0.0, 2.0, 0.1),
        (0.2, 0.3, 0.05),
        (0.2, 1.0, 0.1),
        (2.0, 1.5, 0.1),
        (5.0, 2.5, 0.3),
        (20.0, 4.5, 0.3),
        (50.0, 4.5, 0.2),
    )
    rows = [
        (w, np.log(b), C, np.log(d), E) for (w, b), (C, d, E) in itertools.product(horizon, sun)
    ]
    return np.array(rows)
