"""Ways of sight and of sunlight through a layer of fog and the air above it.

Ways of sight are straight over a flat earth; sunlight's are too, or end at shells around a round
one: under a level sun the cosecant is infinite, the distance to a shell is not.
"""

import math

import equinox as eqx
import jax.numpy as jnp

from atmofit.constants import EARTH_RADIUS
from atmofit.media.two_layers import shell_distance
from atmofit.typing import Reals

LEAST_SINE = 1e-6  # of an elevation; what is flatter counts as this flat


class Piece(eqx.Module):
    """A part of a way of sight in an even medium.

    Attributes:
        length: [m], 0 where there is no such part.
        start: Altitude of the end toward the eye [m].
        end: Altitude of the other end [m].
    """

    length: Reals
    start: Reals
    end: Reals


def sine_of_elevation(zenith_angle: Reals) -> Reals:
    """Exactly 0 at the nearest number to pi / 2, as a cosine is not."""
    return jnp.sin(math.pi / 2 - zenith_angle)


def cut_way(
    far: Reals, sine: Reals, eye: Reals, top: Reals, air_top: Reals
) -> tuple[Piece, Piece, Piece]:
    """Cut a way of sight where it enters and leaves the fog.

    Args:
        far: Distance of what is seen [m].
        sine: Of the elevation of the line of sight.
        eye: Altitude [m].
        top: Of the fog [m].
        air_top: Of the air [m]; beyond it and below the ground nothing counts.

    Returns:
        Air before the fog, or all of a way that does not enter it; fog; air behind it.
    """
    steep, down = jnp.maximum(jnp.abs(sine), LEAST_SINE), sine < 0
    # An eye above the air sees as one where its way enters it.
    far = jnp.maximum(far - jnp.maximum(eye - air_top, 0.0) / steep, 0.0)
    eye = jnp.minimum(eye, air_top)
    whole = jnp.minimum(far, jnp.where(down, eye, air_top - eye) / steep)
    to_top = jnp.minimum(jnp.abs(top - eye) / steep, whole)
    # At the top itself a level way runs through air.
    inside = eye <= top
    before = jnp.where(inside, 0.0, jnp.where(down, to_top, whole))
    within = jnp.where(inside, jnp.where(down, whole, to_top), jnp.where(down, whole - before, 0.0))
    behind = whole - before - within
    entry = jnp.minimum(eye, top)

    def piece(length: Reals, start: Reals) -> Piece:
        return Piece(length, start, jnp.clip(start + sine * length, 0.0, air_top))

    return piece(before, eye), piece(within, entry), piece(behind, jnp.zeros_like(eye) + top)


def sun_distance(shell: Reals, altitude: Reals, sine: Reals, curved: bool) -> Reals:
    """Way of sunlight from a shell down to an altitude [m], 0 above the shell.

    Args:
        shell: Altitude of the shell [m].
        altitude: [m].
        sine: Of the sun's elevation where the light arrives, at least 0.
        curved: Whether the earth is round: equation 19 instead of 35, 37 and 38. Static.
    """
    height = jnp.maximum(shell - altitude, 0.0)
    if curved:
        return shell_distance(EARTH_RADIUS + altitude, height, jnp.maximum(sine, 0.0))
    return height / jnp.maximum(sine, LEAST_SINE)
