"""How light is spread over a sky: positive functions of direction with a few free numbers.

A shape is a sum of positive terms in γ, the angle from the sun, behind a factor for the horizon,

    (1 + A exp(B / c)) (sum of amplitude x term),    c = cos θ + 0.01,

with θ the view zenith angle. Its free numbers are unbounded: logarithms of amplitudes and rates,
and w, the logarithm of zenith over horizon in the factor. So no value makes a sky negative.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.typing import Reals, Scalar

COSINE_OFFSET = 0.01  # keeps the horizon finite, as in Hosek and Wilkie (2012)
_LARGEST = 60.0  # of a free number that is exponentiated; float32 overflows at 88
_LARGEST_RATIO = 10.0  # of w by size; beyond -16 float32 would make the zenith black


class FreeNumber(NamedTuple):
    """A free number: its name, where it is expected, and within what.

    A level is the logarithm of an amplitude: it is expected relative to the sky's own level.
    """

    name: str
    centre: float
    width: float
    is_level: bool = False


class Shape(eqx.Module):
    """A sum of terms behind a factor for the horizon.

    Attributes:
        terms: Names of what is summed. The first must be "constant", which keeps the sum positive:
            1. "exponential": exp(D γ), D < 0. "cosine_squared": cos² γ. "peak":
            (1 + cos² γ) / (1 + H² - 2 H cos γ)^1.5, 0 < H < 1. "root": sqrt(c). "aureole": the
            same peak behind a horizon factor of its own times exp(-(K + L cos γ) c), instead of
            the common one: light around the sun, and opposite to it, grows toward the horizon
            otherwise than the rest. Static.

    References:
        Perez, Seals and Michalsky (1993), Solar Energy 50, 235; Hosek and Wilkie (2012), ACM
        Transactions on Graphics 31, 95, Eq. 8. Amplitudes are positive here, and the aureole is
        ours.
    """

    terms: tuple[str, ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        """Check the names."""
        distinct = len(set(self.terms)) == len(self.terms)
        if self.terms[:1] != ("constant",) or not set(self.terms) <= set(_TERMS) or not distinct:
            raise ValueError(
                f'terms must be "constant" and then some of {sorted(_TERMS)}, got {self.terms}'
            )

    @property
    def free_numbers(self) -> tuple[FreeNumber, ...]:
        """Logarithms of amplitudes, the horizon's two, then the terms' own.

        The centres are those of a sky whose level is 1.
        """
        amplitudes = [FreeNumber(f"ln_{t}", _AMPLITUDE[t], 3.0, is_level=True) for t in self.terms]
        return (*amplitudes, *_HORIZON, *(own for t in self.terms for own in _OWN.get(t, ())))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free numbers."""
        return tuple(number.name for number in self.free_numbers)

    def __call__(
        self, numbers: Float[Array, " n"], cosine: Reals, scattering_angle: Reals
    ) -> Reals:
        """Value of one sky.

        Args:
            numbers: In the order of `free_numbers`.
            cosine: Of the view zenith angle, 0 to 1.
            scattering_angle: γ, 0 to pi [rad], of the same shape.

        Returns:
            The value, positive, of that shape, in the unit of the amplitudes.
        """
        of = dict(zip(self.names, numbers, strict=True))
        place = _Place(cosine + COSINE_OFFSET, scattering_angle, jnp.cos(scattering_angle))
        behind, before = jnp.zeros_like(cosine), jnp.zeros_like(cosine)
        for term in self.terms:
            value = _exp(of[f"ln_{term}"]) * _TERMS[term](of, place)
            if term == "aureole":
                before = before + value
            else:
                behind = behind + value
        return horizon_factor(of["w"], of["ln_B"], place.c) * behind + before


class _Place(NamedTuple):
    """A direction: c, γ and cos γ."""

    c: Reals
    γ: Reals
    toward_sun: Reals


def horizon_factor(w: Scalar, ln_B: Scalar, c: Reals) -> Reals:
    """1 + A exp(B / c), e^w at the zenith and 1 where c is 0."""
    ratio = jnp.expm1(jnp.clip(w, -_LARGEST_RATIO, _LARGEST_RATIO))
    return 1 + ratio * jnp.exp(-_exp(ln_B) * (1 / c - 1 / (1 + COSINE_OFFSET)))


def _exp(x: Reals) -> Reals:
    return jnp.exp(jnp.clip(x, -_LARGEST, _LARGEST))


def _constant(_: dict[str, Scalar], at: _Place) -> Reals:
    return jnp.ones_like(at.c)


def _exponential(of: dict[str, Scalar], at: _Place) -> Reals:
    return jnp.exp(-_exp(of["ln_rate"]) * at.γ)


def _cosine_squared(_: dict[str, Scalar], at: _Place) -> Reals:
    return at.toward_sun**2


def _peak(of: dict[str, Scalar], at: _Place) -> Reals:
    sharpness = of["sharpness"]
    # (1 - H)^2 + 2 H (1 - cos γ), by the half angle: no digits are lost near the sun.
    edge, H = jax.nn.sigmoid(-sharpness), jax.nn.sigmoid(sharpness)
    base = edge**2 + 4 * H * jnp.sin(at.γ / 2) ** 2
    return (1 + at.toward_sun**2) / (base * jnp.sqrt(base))


def _root(_: dict[str, Scalar], at: _Place) -> Reals:
    return jnp.sqrt(at.c)


def _aureole(of: dict[str, Scalar], at: _Place) -> Reals:
    own = horizon_factor(of["aureole_w"], of["aureole_ln_B"], at.c)
    slope = of["aureole_K"] + of["aureole_L"] * at.toward_sun
    return _peak(of, at) * own * _exp(-slope * at.c)


_TERMS = {
    "constant": _constant,
    "exponential": _exponential,
    "cosine_squared": _cosine_squared,
    "peak": _peak,
    "root": _root,
    "aureole": _aureole,
}
_AMPLITUDE = {
    "constant": -1.0,
    "exponential": 0.0,
    "cosine_squared": -1.5,
    "peak": -3.0,
    "root": -1.5,
    "aureole": -3.0,
}
_HORIZON = (FreeNumber("w", -1.0, 1.0), FreeNumber("ln_B", -1.2, 0.7))
_SHARPNESS = FreeNumber("sharpness", 1.0, 1.0)
_OWN = {
    "exponential": (FreeNumber("ln_rate", 1.0, 1.0),),
    "peak": (_SHARPNESS,),
    "aureole": (
        _SHARPNESS,
        FreeNumber("aureole_w", 0.3, 1.0),
        FreeNumber("aureole_ln_B", -1.2, 0.7),
        FreeNumber("aureole_K", 0.0, 1.5),
        FreeNumber("aureole_L", 0.0, 1.5),
    ),
}

PEREZ = Shape(("constant", "exponential", "cosine_squared"))
EXTENDED = Shape(("constant", "exponential", "cosine_squared", "peak", "root"))
AUREOLE = Shape(("constant", "exponential", "cosine_squared", "root", "aureole"))
