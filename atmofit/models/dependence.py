"""How a sky model's free numbers depend on turbidity, sun and ground: products of three bases.

Each of the three is first brought to a coordinate from 0 to 1 in which skies change evenly: the
logarithm of turbidity; the sun's zenith angle, stretched near the horizon; the albedo itself.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import choice, refuse_beyond
from atmofit.typing import Scalar

KINDS = ("polynomial", "spline")
_STRETCH_DEG, _STRETCH_SCALE_DEG = 30.0, 6.0


class Basis(eqx.Module):
    """Functions of a coordinate from 0 to 1.

    Attributes:
        kind: "polynomial", Chebyshev's of the first kind; or "spline", cubic B-splines on even
            knots. Static.
        size: How many functions: at least 1, for splines 4. Static.
    """

    kind: str = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        """Check what shapes the program."""
        choice("kind", self.kind, KINDS)
        refuse_beyond("size", self.size, 4.0 if self.kind == "spline" else 1.0, 64.0)

    def __call__(self, coordinate: Scalar) -> Float[Array, " size"]:
        """The functions' values."""
        if self.kind == "polynomial":
            x, values = 2 * coordinate - 1, [jnp.ones_like(coordinate)]
            if self.size > 1:
                values.append(x)
            while len(values) < self.size:
                values.append(2 * x * values[-1] - values[-2])
            return jnp.stack(values)
        centres = jnp.asarray(np.arange(self.size) - 1.0, coordinate.dtype)
        away = jnp.abs(coordinate * (self.size - 3) - centres)
        inner = jnp.maximum(1 - away, 0.0)
        return (jnp.maximum(2 - away, 0.0) ** 3 - 4 * inner**3) / 6


class Dependence(eqx.Module):
    """A product of bases in turbidity, sun and ground albedo.

    Attributes:
        turbidity, sun, albedo: The three bases.
        turbidity_range: Where it is valid. Static.
        latest_sun_deg: Largest solar zenith angle [degree]; the smallest is 0. Static.
        largest_albedo: The smallest is 0. Static.
    """

    turbidity: Basis
    sun: Basis
    albedo: Basis
    turbidity_range: tuple[float, float] = eqx.field(static=True, default=(1.7, 10.0))
    latest_sun_deg: float = eqx.field(static=True, default=92.0)
    largest_albedo: float = eqx.field(static=True, default=0.8)

    def __check_init__(self) -> None:
        """Check the ranges."""
        low, high = self.turbidity_range
        if not 1 <= low < high < math.inf:
            raise ValueError(
                f"turbidity_range must increase from at least 1, got ({low:.6g}, {high:.6g})"
            )
        refuse_beyond("latest_sun_deg", self.latest_sun_deg, 1.0, 96.0, "degree")
        refuse_beyond("largest_albedo", self.largest_albedo, 0.01, 1.0)

    @property
    def size(self) -> int:
        """How many functions the product has."""
        return self.turbidity.size * self.sun.size * self.albedo.size

    def __call__(
        self, turbidity: Scalar, solar_zenith_angle: Scalar, albedo: Scalar
    ) -> Float[Array, " size"]:
        """All products of the three bases, albedo's running fastest.

        Args:
            turbidity: [-].
            solar_zenith_angle: [rad].
            albedo: Of the ground [-].
        """
        t, s, a = self.coordinates(turbidity, solar_zenith_angle, albedo)
        b, c, d = self.turbidity(t), self.sun(s), self.albedo(a)
        return (b[:, None, None] * c[None, :, None] * d[None, None, :]).ravel()

    def coordinates(
        self, turbidity: Scalar, solar_zenith_angle: Scalar, albedo: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """The three coordinates, each from 0 to 1 in the valid range."""
        low, high = self.turbidity_range
        t = jnp.log(turbidity / low) / math.log(high / low)
        whole, none = _stretched(self.latest_sun_deg), _stretched(0.0)
        degrees = jnp.degrees(solar_zenith_angle)
        stretch = _STRETCH_DEG * jnp.exp((degrees - 90) / _STRETCH_SCALE_DEG)
        s = (degrees + stretch - none) / (whole - none)
        return t, s, albedo / self.largest_albedo


def _stretched(degrees: float) -> float:
    """Place of a sun on the stretched scale."""
    return degrees + _STRETCH_DEG * math.exp((degrees - 90) / _STRETCH_SCALE_DEG)
