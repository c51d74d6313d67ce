"""Shapes of clouds: soft balls whose densities add up."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.clouds.volume import LARGEST_LENGTH
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

SMALLEST_RADIUS = 1e-3  # [m]
LARGEST_DENSITY = 1e6


class Metaballs(eqx.Module):
    """Soft balls; the surface is where the sum of their densities is the threshold.

    Attributes:
        centres: [ball, 3], x, y and z upward [m].
        radii: [ball], beyond which a ball's density is 0 [m].
        densities: [ball], each in its ball's centre [-].
        threshold: Density at the surface [-].
    """

    centres: Float[Array, "ball 3"] = eqx.field(converter=real_array)
    radii: Float[Array, " ball"] = eqx.field(converter=real_array)
    densities: Float[Array, " ball"] = eqx.field(converter=real_array)
    threshold: Scalar = eqx.field(converter=scalar)

    def __check_init__(self) -> None:
        """Check shapes only: values may be tracers here."""
        shapes = self.centres.shape, self.radii.shape, self.densities.shape
        count = shapes[1][:1]
        if shapes != ((*count, 3), count, count):
            raise ValueError(
                f"centres, radii and densities must be [n, 3], [n] and [n], got {shapes}"
            )

    @property
    def count(self) -> int:
        """How many balls."""
        return self.radii.size

    def density(self, position: RealsLike) -> Reals:
        """Sum of the balls' densities.

        Args:
            position: [..., 3], [m].

        Returns:
            [...], [-].

        Raises:
            ValueError: A known position is out of range, or the last axis is not of size 3.
        """
        places = in_range("position", position, -LARGEST_LENGTH, LARGEST_LENGTH, "m")
        if places.shape[-1:] != (3,):
            raise ValueError(f"position must end in an axis of size 3, got {places.shape}")
        return _fields(self, places.astype(self.radii.dtype)).density

    def checked(self) -> "Metaballs":
        """Refuse impossible values: ValueError where they are known, else NaN."""
        return Metaballs(
            in_range("centres", self.centres, -LARGEST_LENGTH, LARGEST_LENGTH, "m"),
            in_range("radii", self.radii, SMALLEST_RADIUS, LARGEST_LENGTH, "m"),
            in_range("densities", self.densities, 0.0, LARGEST_DENSITY),
            in_range("threshold", self.threshold, 1e-6, LARGEST_DENSITY),
        )


def metaballs(
    centres: RealsLike, radii: RealsLike, densities: RealsLike, threshold: RealsLike = 0.25
) -> Metaballs:
    """Balls of density (5 v^2 + 4 v^3) / 9 with v = 1 - (r / R)^2; of degree 6 in r.

    Args:
        centres: [ball, 3], x, y and z upward [m], to 1e6; there may be no balls.
        radii: [ball], R [m], 1e-3 to 1e6.
        densities: [ball], or one number for all: each in its ball's centre [-], 0 to 1e6.
        threshold: Density at the surface [-], 1e-6 to 1e6.

    Returns:
        The balls.

    Raises:
        ValueError: A known argument is out of range, or the shapes do not fit.

    References:
        Wyvill, McPheeters and Wyvill (1986), The Visual Computer 2, 227: the polynomial, there
        1 - 22/9 x^2 + 17/9 x^4 - 4/9 x^6 with x = r / R.
    """
    size = real_array(radii)
    places = real_array(centres).astype(size.dtype)
    if places.size == 0:
        places = places.reshape(0, 3)
    each = jnp.broadcast_to(real_array(densities).astype(size.dtype), size.shape)
    return Metaballs(places, size, each, real_array(threshold).astype(size.dtype)).checked()


extremes(
    Case("centre", {"position": (0.0, 0.0, 0.0), "centre": (0.0, 0.0, 0.0)}, 2.0),
    Case("edge", {"position": (1.0, 0.0, 0.0), "centre": (0.0, 0.0, 0.0), "radius": 1.0}, 0.0),
    Case("of no density", {"density": 0.0}, limit=0.0),
    call=lambda position, centre, radius, density: metaballs(
        jnp.stack([centre] * 2), jnp.stack([radius] * 2), density
    ).density(position),
    position=Domain((-LARGEST_LENGTH,) * 3, (LARGEST_LENGTH,) * 3),
    centre=Domain((-LARGEST_LENGTH,) * 3, (LARGEST_LENGTH,) * 3),
    radius=Domain(SMALLEST_RADIUS, LARGEST_LENGTH),
    density=Span(0.0, 2.0),
    least=0.0,
)(metaballs)


def ball_density(depth: Reals) -> Reals:
    """A ball's density over that of its centre; 0 outside.

    Args:
        depth: 1 - (r / R)^2 at distance r from the centre of a ball of radius R [-].
    """
    v = jnp.maximum(depth, 0.0)
    return v * v * (5 + 4 * v) / 9


extremes(
    Case("centre", {"depth": 1.0}, 1.0, {"depth": 22 / 9}),
    Case("edge", {"depth": 0.0}, 0.0, {"depth": 0.0}),
    Case("outside", {"depth": -5.0}, 0.0, {"depth": 0.0}),
    depth=Span(-1e30, 1.0),
    least=0.0,
)(ball_density)


class Fields(NamedTuple):
    """What the balls make at places.

    Attributes:
        density: [...], [-].
        outward: [..., 3], minus the density's gradient [1/m].
    """

    density: Reals
    outward: Reals


@eqx.filter_jit
def _fields(balls: Metaballs, places: Reals) -> Fields:
    """Ball after ball, and again on the way back, so that memory does not grow with their count."""

    @jax.checkpoint
    def add(total: Fields, ball: tuple[Reals, Reals, Reals]) -> tuple[Fields, None]:
        centre, radius, density = ball
        away = (places - centre.reshape((1,) * (places.ndim - 1) + (3,))) / radius
        v = jnp.maximum(1 - jnp.sum(away * away, axis=-1), 0.0)
        steepness = density * v * (20 + 24 * v) / (9 * radius)
        return Fields(
            total.density + density * ball_density(v),
            total.outward + steepness[..., None] * away,
        ), None

    start = Fields(jnp.zeros(places.shape[:-1], places.dtype), jnp.zeros_like(places))
    return jax.lax.scan(add, start, (balls.centres, balls.radii, balls.densities))[0]


def fields(balls: Metaballs, places: Reals) -> Fields:
    """Density and its fall at places [..., 3], [m], unchecked."""
    return _fields(balls, places)
