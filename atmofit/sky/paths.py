"""Straight rays through a spherical or a flat atmosphere, and the columns along them."""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from atmofit.numerics import safe_divide, safe_sqrt
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.profiles import DensityProfile
from atmofit.sky.sun_angles import SunRange
from atmofit.typing import Reals, Scalar

Bools = Bool[Array, "..."]

_FARTHEST_TURN = math.radians(11.5)  # from the ground to 118 km along a level ray, and a margin
_SMALLEST_COSINE = 1e-6  # of a ray in a flat atmosphere, which has no end at 0


class Point(eqx.Module):
    """Where a ray is after some distance, and its direction seen from there.

    Attributes:
        altitude: [m].
        cosine, sine: Of the angle between the ray and the local zenith.
        turn_cosine, turn_sine: Of the angle at the planet's centre between start and here.
    """

    altitude: Reals
    cosine: Reals
    sine: Reals
    turn_cosine: Reals
    turn_sine: Reals


class Paths(eqx.Module):
    """Geometry of rays; cosines are those of the zenith angle at the ray's start.

    Attributes:
        curved: Whether zenith and local sun turn along a ray.
    """

    curved: ClassVar[bool] = False

    @abc.abstractmethod
    def local_suns(self, suns: SunRange) -> SunRange:
        """Least and largest local solar zenith angle that a view ray meets [rad].

        Args:
            suns: Likewise at the observer.
        """

    @abc.abstractmethod
    def length_up(self, altitude: Reals, cosine: Reals, level: Reals) -> Reals:
        """Distance to a level at or above the start, on the way out [m]."""

    @abc.abstractmethod
    def length_to_ground(self, altitude: Reals, cosine: Reals) -> Reals:
        """Distance to the ground for a ray that meets it [m]."""

    @abc.abstractmethod
    def horizon_cosine(self, altitude: Reals) -> Reals:
        """Cosine of the zenith angle at which the ground begins; at most 0."""

    @abc.abstractmethod
    def advance(self, altitude: Reals, cosine: Reals, sine: Reals, distance: Reals) -> Point:
        """The point at a distance along a ray."""

    @abc.abstractmethod
    def rising_column(self, profile: DensityProfile, altitude: Reals, cosine: Reals) -> Reals:
        """Column over vertical column to space along a ray with cosine >= 0 [-]."""

    @abc.abstractmethod
    def level_column(self, profile: DensityProfile, altitude: Reals) -> Reals:
        """Column over vertical column to space along a ray that starts out level [-]."""

    @abc.abstractmethod
    def sun_column(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals
    ) -> tuple[Reals, Reals]:
        """Column over vertical column toward the sun [-], and whether the sun is up (1 or 0)."""

    def column_between(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals, sine: Reals, end: Point
    ) -> Reals:
        """Column over vertical column from a ray's start to points on it [-], never negative.

        A ray that first sinks is seen from its lowest point, from which both ends rise.

        Args:
            profile: What is in the column.
            altitude: Of the start; this and the next two are 1 long in their last axis.
            cosine: Likewise.
            sine: Likewise.
            end: The points, along the last axis.
        """
        start, finish = self._rising_at_both(profile, altitude, cosine, end)
        low, _ = self._lowest(altitude, cosine, sine)
        at_lowest = self.level_column(profile, low)
        passes = (cosine < 0) & (end.cosine >= 0)
        sinks = (cosine < 0) & (end.cosine < 0)
        column = jnp.where(sinks, finish - start, start - finish)
        column = jnp.where(passes, 2 * at_lowest - start - finish, column)
        return jnp.maximum(column, 0.0)

    def column_up(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals, end: Point
    ) -> Reals:
        """The same along a ray that rises."""
        start, finish = self._rising_at_both(profile, altitude, cosine, end)
        return jnp.maximum(start - finish, 0.0)

    def _rising_at_both(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals, end: Point
    ) -> tuple[Reals, Reals]:
        """Columns to space from the start and from the points, as if the ray rose there.

        In one call, which halves what is compiled.
        """
        altitudes = jnp.concatenate([altitude, end.altitude], axis=-1)
        cosines = jnp.abs(jnp.concatenate([cosine, end.cosine], axis=-1))
        both = self.rising_column(profile, altitudes, cosines)
        return both[..., :1], both[..., 1:]

    @abc.abstractmethod
    def _lowest(self, altitude: Reals, cosine: Reals, sine: Reals) -> tuple[Reals, Bools]:
        """Altitude of a ray's lowest point, the ground at least, and where the ground is hit."""


class SphericalPaths(Paths):
    """Rays around a planet.

    Attributes:
        radius: Of the ground [m]. Static.
    """

    radius: float = eqx.field(static=True)
    curved: ClassVar[bool] = True

    def local_suns(self, suns: SunRange) -> SunRange:
        """The observer's and the largest angle turned on the way to the highest altitudes [rad]."""
        return max(suns[0] - _FARTHEST_TURN, 0.0), suns[1] + _FARTHEST_TURN

    def length_up(self, altitude: Reals, cosine: Reals, level: Reals) -> Reals:
        """Distance to a level at or above the start, on the way out [m]."""
        start = (self.radius + altitude) * cosine
        rise = (level - altitude) * (2 * self.radius + level + altitude)
        root = safe_sqrt(start**2 + rise)
        # Two forms of one root: the first cancels for rays that rise, the second for sinking ones.
        return jnp.where(cosine > 0, safe_divide(rise, start + root), root - start)

    def length_to_ground(self, altitude: Reals, cosine: Reals) -> Reals:
        """Distance to the ground for a ray that meets it [m]."""
        start = (self.radius + altitude) * cosine
        fall = altitude * (2 * self.radius + altitude)
        return safe_divide(fall, safe_sqrt(start**2 - fall) - start)

    def horizon_cosine(self, altitude: Reals) -> Reals:
        """Cosine of the zenith angle at which the ground begins; at most 0."""
        return -safe_sqrt(altitude * (2 * self.radius + altitude)) / (self.radius + altitude)

    def advance(self, altitude: Reals, cosine: Reals, sine: Reals, distance: Reals) -> Point:
        """The point at a distance along a ray."""
        start = self.radius + altitude
        more = distance * (2 * start * cosine + distance)
        here = jnp.sqrt(start**2 + more)
        return Point(
            jnp.maximum(altitude + more / (start + here), 0.0),
            (start * cosine + distance) / here,
            start * sine / here,
            (start + distance * cosine) / here,
            distance * sine / here,
        )

    def rising_column(self, profile: DensityProfile, altitude: Reals, cosine: Reals) -> Reals:
        """Column over vertical column to space along a ray with cosine >= 0 [-]."""
        return profile.rising_column(altitude, cosine, self.radius)

    def level_column(self, profile: DensityProfile, altitude: Reals) -> Reals:
        """Column over vertical column to space along a ray that starts out level [-]."""
        return profile.level_column(altitude, self.radius)

    def sun_column(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals
    ) -> tuple[Reals, Reals]:
        """Column over vertical column toward the sun [-], and whether the sun is up (1 or 0)."""
        cosine = jnp.clip(cosine, -1.0, 1.0)
        low, hidden = self._lowest(altitude, cosine, safe_sqrt(1 - cosine**2))
        rising = self.rising_column(profile, altitude, jnp.abs(cosine))
        at_lowest = self.level_column(profile, low)
        column = jnp.where(cosine < 0, 2 * at_lowest - rising, rising)
        return column, jnp.where(hidden, 0.0, 1.0).astype(column.dtype)

    def _lowest(self, altitude: Reals, cosine: Reals, sine: Reals) -> tuple[Reals, Bools]:
        """Altitude of a ray's lowest point, the ground at least, and where the ground is hit."""
        sinking = jnp.minimum(cosine, 0.0)
        low = altitude - (self.radius + altitude) * sinking**2 / (1 + sine)
        return jnp.maximum(low, 0.0), (low < 0) & (cosine < 0)


class FlatPaths(Paths):
    """Rays over a plane: the zenith is the same everywhere."""

    def local_suns(self, suns: SunRange) -> SunRange:
        """The observer's, to the horizon: over a plane, a sun below it gives no light [rad]."""
        return suns[0], min(suns[1], math.pi / 2)

    def length_up(self, altitude: Reals, cosine: Reals, level: Reals) -> Reals:
        """Distance to a level at or above the start [m]."""
        return (level - altitude) / _away_from_zero(cosine)

    def length_to_ground(self, altitude: Reals, cosine: Reals) -> Reals:
        """Distance to the ground for a ray that meets it [m]."""
        return altitude / _away_from_zero(-cosine)

    def horizon_cosine(self, altitude: Reals) -> Reals:
        """Cosine of the zenith angle at which the ground begins: 0."""
        return jnp.zeros_like(altitude)

    def advance(self, altitude: Reals, cosine: Reals, sine: Reals, distance: Reals) -> Point:
        """The point at a distance along a ray."""
        one = jnp.ones_like(distance)
        climb = jnp.where(cosine < 0, -1.0, 1.0) * _away_from_zero(jnp.abs(cosine))
        return Point(
            jnp.maximum(altitude + climb * distance, 0.0),
            climb * one,
            sine * one,
            one,
            jnp.zeros_like(one),
        )

    def rising_column(self, profile: DensityProfile, altitude: Reals, cosine: Reals) -> Reals:
        """Column over vertical column to space along a ray with cosine >= 0 [-]."""
        return profile.vertical_column(altitude) / _away_from_zero(cosine)

    def level_column(self, profile: DensityProfile, altitude: Reals) -> Reals:
        """The same at the smallest cosine, since a level ray never leaves a flat atmosphere."""
        return self.rising_column(profile, altitude, jnp.zeros_like(altitude))

    def sun_column(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals
    ) -> tuple[Reals, Reals]:
        """Column over vertical column toward the sun [-], and whether the sun is up (1 or 0)."""
        up = jnp.where(cosine > 0, 1.0, 0.0).astype(cosine.dtype)
        return self.rising_column(profile, altitude, cosine), up

    def _lowest(self, altitude: Reals, cosine: Reals, sine: Reals) -> tuple[Reals, Bools]:
        """A sinking ray always meets the ground."""
        return jnp.where(cosine < 0, 0.0, altitude), cosine < 0


class PseudoSphericalPaths(FlatPaths):
    """Sunlight comes through a spherical atmosphere, scattered light through a flat one.

    Attributes:
        sphere: The geometry of sunlight.
    """

    sphere: SphericalPaths

    def local_suns(self, suns: SunRange) -> SunRange:
        """The observer's: the sun is at the same place everywhere [rad]."""
        return suns

    def sun_column(
        self, profile: DensityProfile, altitude: Reals, cosine: Reals
    ) -> tuple[Reals, Reals]:
        """Column over vertical column toward the sun [-], and whether the sun is up (1 or 0)."""
        return self.sphere.sun_column(profile, altitude, cosine)


def paths_of(atmosphere: Atmosphere) -> tuple[Paths, ...]:
    """One geometry, or for "paper" flat and spherical."""
    flat, sphere = FlatPaths(), SphericalPaths(atmosphere.radius)
    if atmosphere.geometry == "paper":
        return (flat, sphere)
    pseudo = PseudoSphericalPaths(sphere)
    return ({"flat": flat, "spherical": sphere, "pseudo-spherical": pseudo}[atmosphere.geometry],)


def _away_from_zero(cosine: Reals) -> Reals:
    return jnp.maximum(cosine, _SMALLEST_COSINE)


def stretched(unit: Reals, length: Reals, scale: Reals) -> tuple[Reals, Reals]:
    """Map [0, 1] to [0, length], dense near 0 on all scales down to far below `scale`.

    Returns:
        The distance scale (exp(a u^2) - 1), where a makes 1 the length, and its slope.
    """
    a = jnp.log1p(length / scale)
    return scale * jnp.expm1(a * unit**2), scale * jnp.exp(a * unit**2) * 2 * a * unit


def unstretched(distance: Reals, length: Scalar, scale: Scalar) -> Reals:
    """The inverse of `stretched`."""
    return safe_sqrt(jnp.log1p(distance / scale) / jnp.log1p(length / scale))
