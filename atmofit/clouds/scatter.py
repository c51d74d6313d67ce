"""Directions of scattered light: a phase function, and chance that follows it."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.clouds.volume import Vector
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Scalar

_ANGLES = 4096  # of the table that stands for phase functions without closed form


class Scatter(eqx.Module):
    """A phase function by versine, 1 - cos of the scattering angle: exact in a narrow peak."""

    @abc.abstractmethod
    def value(self, versine: Scalar) -> Scalar:
        """Phase function [1/sr]."""

    @abc.abstractmethod
    def draw(self, number: Scalar) -> Scalar:
        """A versine from a random number."""

    @abc.abstractmethod
    def density(self, versine: Scalar) -> Scalar:
        """What `draw` draws by [1/sr], about the phase function."""


class _HenyeyScatter(Scatter):
    """Henyey-Greenstein, in forms without cancellation at any asymmetry."""

    asymmetry: Scalar

    def value(self, versine: Scalar) -> Scalar:
        """Phase function [1/sr]."""
        g = self.asymmetry
        return (1 - g**2) / (4 * math.pi * ((1 - g) ** 2 + 2 * g * versine) ** 1.5)

    def density(self, versine: Scalar) -> Scalar:
        """The phase function itself [1/sr]."""
        return self.value(versine)

    def draw(self, number: Scalar) -> Scalar:
        """By the inverse of the distribution."""
        g = self.asymmetry
        d = (1 - g) + 2 * g * number
        versine = (1 - g) ** 2 * (1 - number) * (1 + g + d) / d**2
        return jnp.clip(versine, 0.0, 2.0)


class _TableScatter(Scatter):
    """Any phase function, linear between angles pi (k / count)^2."""

    values: Float[Array, " angle"]
    share: Float[Array, " angle"]  # drawn below each angle

    def value(self, versine: Scalar) -> Scalar:
        """Phase function [1/sr]."""
        k, t = self._place(versine)
        return (1 - t) * self.values[k] + t * self.values[k + 1]

    def density(self, versine: Scalar) -> Scalar:
        """The same between two angles [1/sr]."""
        k, _ = self._place(versine)
        versines = jnp.asarray(_versines(), versine.dtype)
        return (self.share[k + 1] - self.share[k]) / (2 * math.pi * (versines[k + 1] - versines[k]))

    def draw(self, number: Scalar) -> Scalar:
        """Evenly in the versine between two angles, chosen by the trapezium between them."""
        k = jnp.clip(jnp.searchsorted(self.share, number, side="right") - 1, 0, _ANGLES - 1)
        versines = jnp.asarray(_versines(), number.dtype)
        part, width = self.share[k + 1] - self.share[k], versines[k + 1] - versines[k]
        return versines[k] + width * (number - self.share[k]) / part

    def _place(self, versine: Scalar) -> tuple[Int[Array, ""], Scalar]:
        """Number of the angle below, and the way to the next [-]."""
        half = jnp.clip(jnp.sqrt(versine / 2), 0.0, 1.0)
        place = jnp.sqrt(2 * jnp.arcsin(half) / math.pi) * _ANGLES
        k = jnp.clip(place.astype(int), 0, _ANGLES - 1)
        return k, place - k.astype(place.dtype)


def scatter_of(phase: PhaseFunction, wavelength: Float[Array, "1"]) -> Scatter:
    """How a phase function scatters at a wavelength [nm]."""
    if isinstance(phase, HenyeyGreenstein):
        return _HenyeyScatter(phase.moments(2, wavelength)[1, 0].astype(wavelength.dtype))
    angle = math.pi * (np.arange(_ANGLES + 1) / _ANGLES) ** 2
    values = phase.at_wavelengths(jnp.asarray(angle, wavelength.dtype), wavelength)[:, 0]
    part = (values[1:] + values[:-1]) * jnp.asarray(np.diff(_versines()), values.dtype)
    share = jnp.concatenate([jnp.zeros(1, values.dtype), jnp.cumsum(part)])
    return _TableScatter(values, share / share[-1])


def _versines() -> np.ndarray:
    """Of the table's angles."""
    return 2 * np.sin(math.pi / 2 * (np.arange(_ANGLES + 1) / _ANGLES) ** 2) ** 2


def versine_between(one: Vector, other: Vector) -> Scalar:
    """1 - cos of the angle between unit vectors."""
    return jnp.sum((one - other) ** 2) / 2


def turned(direction: Vector, versine: Scalar, azimuth: Scalar) -> Vector:
    """A unit vector turned by a scattering angle, about itself by an azimuth.

    References:
        The two vectors across: Duff et al. (2017), J. Computer Graphics Techniques 6 (1), 1.
    """
    x, y, z = direction
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    across = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x])
    other = jnp.stack([b, sign + y * y * a, -y])
    sine = jnp.sqrt(versine * (2 - versine))
    new = (1 - versine) * direction + sine * (jnp.cos(azimuth) * across + jnp.sin(azimuth) * other)
    return new / jnp.sqrt(jnp.sum(new**2))  # rounding must not add up
