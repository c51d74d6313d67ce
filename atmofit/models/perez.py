"""The five-parameter formula for the distribution of light over the sky."""

import jax.numpy as jnp
import numpy as np

from atmofit.checks import angle_in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.typing import Reals, RealsLike, real_array

COSINE_FLOOR = 1e-3  # of the view zenith angle; reached 0.06 degrees above the horizon
EXPONENT_CAP = 30.0  # the product of two, 1e26, leaves room for derivatives in float32


@extremes(
    Case(
        "overhead at the sun",
        {"coefficients": (1, 0, 2, -1, 3), "view_zenith_angle": 0.0, "scattering_angle": 0.0},
        limit=12.0,
        slope={"view_zenith_angle": 0.0, "scattering_angle": -4.0},
    ),
    Case(
        "horizon",
        {"coefficients": (1, -1, 2, -1, 3), "view_zenith_angle": np.pi / 2, "scattering_angle": 0},
        limit=6.0,
        slope={"view_zenith_angle": 0.0},
    ),
    Case("horizon that overflows", {"coefficients": (1, 9, 1, 1, 1), "view_zenith_angle": 1.57}),
    Case("sun that overflows", {"coefficients": (1, -1, 1, 99, 1), "scattering_angle": 3.0}),
    Case("narrow sun", {"coefficients": (1, -1, 1e6, -1e6, 1), "scattering_angle": 0.01}),
    coefficients=Span((-10, -100, -100, -100, -10), (10, 10, 100, 100, 10)),
    view_zenith_angle=Domain(0.0, np.pi / 2),
    scattering_angle=Domain(0.0, np.pi),
)
def perez(
    coefficients: RealsLike, view_zenith_angle: RealsLike, scattering_angle: RealsLike
) -> Reals:
    """Relative value of the sky, F = (1 + A exp(B / cos θ)) (1 + C exp(D γ) + E cos² γ).

    Finite, with its derivatives, in float32 and float64: closer than 0.06 degrees to the horizon
    cos θ stays at 1e-3, and both exponents stop at 30 (no published sky comes near it).

    Args:
        coefficients: A, B, C, D, E, dimensionless, shape [..., 5]; the leading axes broadcast
            against the angles. Their dtype is that of the result.
        view_zenith_angle: θ, 0 to pi/2 [rad].
        scattering_angle: γ between view direction and sun, 0 to pi [rad].

    Returns:
        F, dimensionless, of the broadcast shape. NaN where a traced angle is out of range.

    Raises:
        ValueError: An angle out of range, or a last axis that is not 5 long.

    References:
        Perez et al. (1993), Solar Energy 50, 235; Preetham et al. (1999), Eq. 3.
    """
    known = real_array(coefficients)
    if known.ndim == 0 or known.shape[-1] != 5:
        raise ValueError(f"coefficients must have shape [..., 5], got {known.shape}")
    θ = angle_in_range("view_zenith_angle", view_zenith_angle, 0.0, np.pi / 2)
    γ = angle_in_range("scattering_angle", scattering_angle, 0.0, np.pi)
    return perez_formula(known, θ.astype(known.dtype), γ.astype(known.dtype))


def perez_formula(coefficients: Reals, view_zenith_angle: Reals, scattering_angle: Reals) -> Reals:
    """`perez` without checks, for arrays of one dtype."""
    rank = max(coefficients.ndim - 1, view_zenith_angle.ndim, scattering_angle.ndim)
    # Ranks are made equal, sizes are not: the horizon's factor stays as small as its arguments.
    A, B, C, D, E, θ, γ = (
        jnp.expand_dims(array, tuple(range(rank - array.ndim)))
        for array in (
            *(coefficients[..., k] for k in range(5)),
            view_zenith_angle,
            scattering_angle,
        )
    )
    horizon = jnp.minimum(B / jnp.maximum(jnp.cos(θ), COSINE_FLOOR), EXPONENT_CAP)
    around_sun = jnp.minimum(D * γ, EXPONENT_CAP)
    return (1 + A * jnp.exp(horizon)) * (1 + C * jnp.exp(around_sun) + E * jnp.cos(γ) ** 2)
