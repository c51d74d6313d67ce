"""Single scattering in a flat slab of small particles, in one expression for every geometry.

A slab of an optical depth, lit by parallel light of unit irradiance across its rays, sends back (or
lets through) a radiance of albedo x phase function x a factor that geometry alone sets: how much of
the slab is both lit and seen. Blinn (1982), section 2.4, gives it lit from the top, from the bottom
and, for opposite directions, as a limit; here the three are one expression without a singularity.
"""

import math

import jax.numpy as jnp

from atmofit.checks import in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.numerics import mean_decay
from atmofit.typing import Reals, RealsLike

SMALLEST_COSINE = 1e-6  # of a direction, beside a level one
THICKEST = 1e6


@extremes(
    Case("nothing", {"optical_depth": 0.0}, limit=0.0),
    Case(
        "thick, lit from above",
        {"optical_depth": 1e6, "view_cosine": 0.5, "solar_cosine": 0.5},
        limit=0.5,
    ),
    Case("thick, lit from below", {"optical_depth": 1e6, "solar_cosine": -0.5}, limit=0.0),
    Case(
        "straight through",
        {"optical_depth": 2.0, "view_cosine": 0.5, "solar_cosine": -0.5},
        limit=4 * math.exp(-4),
    ),
    Case(
        "thin",
        {"optical_depth": 2.0**-30, "view_cosine": 1.0, "solar_cosine": 1.0},
        limit=2.0**-30,
        rtol=2e-8,
    ),
    Case("grazing", {"view_cosine": 1e-6, "solar_cosine": -1e-6}, limit=0.0),
    optical_depth=Domain(0.0, THICKEST),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    solar_cosine=Domain(-1.0, 1.0),
    least=0.0,
)
def slab_single_scattering(
    optical_depth: RealsLike, view_cosine: RealsLike, solar_cosine: RealsLike
) -> Reals:
    """How much of a slab is lit and seen [-]; radiance over albedo, phase function and irradiance.

    With the normal on the observer's side. Lit from there (solar cosine mu0 > 0) it is
    mu0 / (mu0 + mu) (1 - exp(-tau (1/mu + 1/mu0))), lit from behind (mu0 < 0)
    mu0 / (mu0 + mu) (exp(tau / mu0) - exp(-tau / mu)), whose limit at mu0 = -mu is
    tau / mu exp(-tau / mu).

    Args:
        optical_depth: Vertical [-], 0 to 1,000,000.
        view_cosine: Of the angle between normal and observer, 1e-6 to 1 [-].
        solar_cosine: Of the angle between normal and sun, -1 to 1 [-]; within 1e-6 of 0 it is
            taken as that, on the side of its sign. The three broadcast.

    Returns:
        The factor [-]. With phase functions that integrate to 1, times albedo, phase function and
        irradiance, it is a radiance; times albedo and 4 pi phase function it is Blinn's B.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 2.4, with the signs of the bottom-lit case
        and in a form that stays finite at mu0 = -mu.
    """
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST)
    seen = in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0)
    sun = in_range("solar_cosine", solar_cosine, -1.0, 1.0)
    return lit_and_seen(depth, seen, sun)


def lit_and_seen(optical_depth: Reals, view_cosine: Reals, solar_cosine: Reals) -> Reals:
    """The kernel of `slab_single_scattering`; all broadcast."""
    size = jnp.maximum(jnp.abs(solar_cosine), SMALLEST_COSINE)
    from_behind = solar_cosine < 0
    # Depth over which lit and seen part: the two ways add up, or one takes the other's place.
    there = optical_depth / size
    back = optical_depth / view_cosine
    # One choice orders both: minimum and abs each make their own slope of a tie.
    first = there < back
    less, more = jnp.where(first, there, back), jnp.where(first, back, there)
    apart = jnp.where(from_behind, more - less, there + back)
    common = jnp.where(from_behind, jnp.exp(-less), 1.0)
    return back * common * mean_decay(apart)
