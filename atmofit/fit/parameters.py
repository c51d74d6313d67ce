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
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from atmofit.typing import Reals

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

    def residuals(self, free: Reals) -> Reals:
        """Residuals of the prior, [..., 5] like the free parameters.

        They stand beside residuals of the data that are divided by the root of their number.
        """
        dtype, shape = free.dtype, (1,) * (free.ndim - 1) + (5,)
        centre = jnp.asarray(self.centre, dtype).reshape(shape)
        width = jnp.asarray(self.width, dtype).reshape(shape)
        return jnp.asarray(self.strength, dtype) * (free - centre) / width


def to_coefficients(free: Reals) -> Reals:
    """A, B, C, D, E from the free parameters; both [..., 5]."""
    w, log_b, C, log_d, E = jnp.moveaxis(free, -1, 0)
    B = -jnp.exp(log_b)
    return jnp.stack([jnp.expm1(w) * jnp.exp(-B), B, C, -jnp.exp(log_d), E], axis=-1)


def to_free(coefficients: Reals) -> Reals:
    """The free parameters from A, B, C, D, E; the inverse of `to_coefficients`."""
    A, B, C, D, E = jnp.moveaxis(coefficients, -1, 0)
    return jnp.stack([jnp.log1p(A * jnp.exp(B)), jnp.log(-B), C, jnp.log(-D), E], axis=-1)


def candidates() -> np.ndarray:
    """Free parameters to begin from, shape [horizon, sun, 5]."""
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
    return np.reshape(rows, (len(horizon), len(sun), 5))
