"""A planet's rings: a flat layer of particles whose depth and albedos vary with radius.

Each radius has an optical depth and two albedos, of white spheres that reflect by Lambert's law and
of small particles that scatter forward (Blinn 1982, section 4.3); brightness follows `media.dust`.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.media.slab import SMALLEST_COSINE, THICKEST, lit_and_seen
from atmofit.optics.particle_phases import (
    LambertSphere,
    henyey_greenstein_of_phase_angle,
    phase_of_phase_angle,
)
from atmofit.typing import Reals, RealsLike, real_array

SATURN_RADIUS = 60_268e3  # [m], at the equator and 1 bar
_FORWARD_G = -0.5  # of the phase angle: small particles scatter forward
_FURTHEST = 1e12  # [m]


class RingProfile(eqx.Module):
    """What a ring is made of at every radius; linear between the knots, nothing outside them.

    Attributes:
        radius: From the planet's centre [m], increasing, at least 2.
        optical_depth: Vertical [-], at least 0.
        back_albedo: w1, albedo times share of the large particles [-], 0 to 1.
        forward_albedo: w2, albedo times share of the small particles [-], 0 to 1.
    """

    radius: Float[Array, " knot"] = eqx.field(converter=real_array)
    optical_depth: Float[Array, " knot"] = eqx.field(converter=real_array)
    back_albedo: Float[Array, " knot"] = eqx.field(converter=real_array)
    forward_albedo: Float[Array, " knot"] = eqx.field(converter=real_array)

    def __check_init__(self) -> None:
        """Check the number of knots, and that known radii increase."""
        shapes = {
            x.shape
            for x in (self.radius, self.optical_depth, self.back_albedo, self.forward_albedo)
        }
        if len(shapes) != 1 or self.radius.ndim != 1 or self.radius.size < 2:
            raise ValueError(
                f"a RingProfile needs 4 lists of one length, at least 2, got {sorted(shapes)}"
            )
        if not is_traced(self.radius) and np.any(np.diff(np.asarray(self.radius, float)) <= 0):
            raise ValueError("radius of a RingProfile must increase")

    def checked(self) -> "RingProfile":
        """Refuse impossible values."""
        return RingProfile(
            in_range("radius", self.radius, 0.0, _FURTHEST, "m"),
            in_range("optical_depth", self.optical_depth, 0.0, THICKEST),
            in_range("back_albedo", self.back_albedo, 0.0, 1.0),
            in_range("forward_albedo", self.forward_albedo, 0.0, 1.0),
        )

    def at(self, radius: Reals) -> tuple[Reals, Reals, Reals]:
        """Optical depth and both albedos at radii of any shape [m]; 0 outside the knots."""

        def between(values: Float[Array, " knot"]) -> Reals:
            known = values.astype(radius.dtype)
            return jnp.interp(radius, self.radius.astype(radius.dtype), known, left=0.0, right=0.0)

        return between(self.optical_depth), between(self.back_albedo), between(self.forward_albedo)


def ring_brightness(
    profile: RingProfile,
    radius: RealsLike,
    view_cosine: RealsLike,
    solar_cosine: RealsLike,
    phase_angle: RealsLike,
) -> tuple[Reals, Reals]:
    """Brightness and transparency of rings, lit or seen from either side.

    Args:
        profile: Of the rings.
        radius: From the planet's centre [m], 0 to 1e12.
        view_cosine: Of the angle between the normal on the observer's side and the observer,
            1e-6 to 1 [-].
        solar_cosine: Of that between the same normal and the sun, -1 to 1 [-]; below 0 the
            unlit side is seen.
        phase_angle: Between sun and observer, 0 to pi [rad]. The last four broadcast.

    Returns:
        Blinn's brightness (w1 L(a) + w2 HG(-0.5, a)) S [-], that is 4 pi times radiance over the
        sun's irradiance, and the transparency exp(-tau / mu) for what lies behind.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 4.3.
    """
    return _ring_brightness(
        profile.checked(),
        in_range("radius", radius, 0.0, _FURTHEST, "m"),
        in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0),
        in_range("solar_cosine", solar_cosine, -1.0, 1.0),
        angle_in_range("phase_angle", phase_angle, 0.0, math.pi),
    )


@eqx.filter_jit
def _ring_brightness(
    profile: RingProfile, radius: Reals, seen: Reals, sun: Reals, phase_angle: Reals
) -> tuple[Reals, Reals]:
    depth, back, forward = profile.at(radius)
    large = phase_of_phase_angle(LambertSphere(), phase_angle)
    small = phase_of_phase_angle(henyey_greenstein_of_phase_angle(_FORWARD_G), phase_angle)
    brightness = (back * large + forward * small) * lit_and_seen(depth, seen, sun)
    return brightness, jnp.exp(-depth / seen)


extremes(
    Case("nothing", {"depth": 0.0}, limit=(0, 1)),
    Case(
        "full, deep",
        {
            "depth": 1e6,
            "back": 1.0,
            "forward": 0.0,
            "view_cosine": 0.5,
            "solar_cosine": 0.5,
            "phase_angle": 0.0,
        },
        limit=(4 / 3, 0),
    ),
    call=lambda depth, back, forward, view_cosine, solar_cosine, phase_angle: ring_brightness(
        RingProfile(
            (1e8, 2e8),
            *(jnp.stack([value, value]) for value in (depth, back, forward)),
        ),
        1.5e8,
        view_cosine,
        solar_cosine,
        phase_angle,
    ),
    depth=Domain(0.0, THICKEST),
    back=Domain(0.0, 1.0),
    forward=Domain(0.0, 1.0),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    solar_cosine=Domain(-1.0, 1.0),
    phase_angle=Domain(0.0, math.pi),
    least=0.0,
)(ring_brightness)
extremes(
    Case("at a knot", {"radius": 1.5e8}, limit=(1, 0.5, 0.25)),
    Case("inside all", {"radius": 0.0}, limit=0.0),
    Case("outside all", {"radius": 3e8}, limit=0.0),
    call=lambda radius: RingProfile(
        (1e8, 1.5e8, 2e8), (2.0, 1.0, 2.0), (0.2, 0.5, 0.2), (0.1, 0.25, 0.1)
    ).at(radius),
    radius=Span(0.0, 4e8),
)(RingProfile)


def in_sphere_shadow(position: RealsLike, sun_direction: RealsLike, radius: RealsLike) -> Array:
    """Whether points lie in the shadow of a sphere around the origin, under a far sun.

    Args:
        position: Of the points [m], [..., 3].
        sun_direction: Unit vector toward the sun, [3].
        radius: Of the sphere [m], a number.

    Returns:
        Booleans of the shape [...]; points in the night half of the sphere count as shadowed.
    """
    place = real_array(position)
    toward = real_array(sun_direction).astype(place.dtype)
    along = place @ toward
    aside = place - along[..., None] * toward.reshape((1,) * along.ndim + (3,))
    limit = real_array(radius).astype(place.dtype) ** 2
    return (along < 0) & (jnp.sum(aside * aside, axis=-1) < limit)


def synthetic_ring_profile(seed: int = 0) -> RingProfile:
    """Rings like Saturn's: typical depths of C, B and A ring, ringlets of random noise.

    Not measured: the edges and mean depths are round values as commonly quoted, the fine structure
    is smoothed noise, and both albedos are guesses that keep icy rings bright and dusty ones dark.

    Args:
        seed: Of the noise.

    Returns:
        A profile of 2,000 knots from 74,500 to 136,775 km.
    """
    random = np.random.default_rng(seed)
    km = np.linspace(74_400.0, 136_875.0, 2_000)
    edges = (74_500.0, 92_000.0, 99_000.0, 104_500.0, 117_507.0, 122_170.0, 127_000.0, 136_775.0)
    depths = (0.10, 0.9, 1.3, 1.8, 0.10, 0.8, 0.5)
    part = np.searchsorted(edges, km) - 1
    inside = (part >= 0) & (part < len(depths)) & ~(np.abs(km - 133_589.0) < 325 / 2)  # Encke
    depth = np.where(inside, np.take(depths, np.clip(part, 0, len(depths) - 1)), 0.0)
    waves = [
        np.convolve(random.standard_normal(km.size + 80), _bell(w), "same") for w in (3.0, 20.0)
    ]
    noise = sum(wave[40:-40] / wave.std() for wave in waves) / 2
    depth = depth * np.exp(np.where(depth > 0.3, 0.35, 0.5) * noise)
    icy = 1 - np.exp(-depth / 0.3)
    icy = icy * np.clip(1 + 0.12 * np.roll(noise, 500), 0.5, 1.5)  # its own noise
    return RingProfile(1e3 * km, depth, 0.15 + 0.45 * icy, 0.08 + 0.02 * icy)


def _bell(width: float) -> np.ndarray:
    x = np.arange(-40, 41) / width
    return np.exp(-(x**2) / 2)
