"""The loss of Perez skies with its first and second derivatives, written out.

The formula is a product of a factor of the horizon and a factor of the sun, so all second
derivatives of a sky's loss follow from two small matrix products over its directions. Automatic
differentiation of the same loss takes ten times as long, and a fit is little else.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.fit import weighting as weights
from atmofit.models.perez import COSINE_FLOOR
from atmofit.typing import Reals, Scalar

# Where the second derivatives by A, B, C, D, E stand in the table [horizon row, sun row] below,
# counted row by row; its last place, 30, is a zero.
_NONE = 30
_SECOND = np.array(
    [
        [_NONE, 18, 7, 8, 9],
        [18, 24, 13, 14, 15],
        [7, 13, _NONE, 4, _NONE],
        [8, 14, 4, 5, _NONE],
        [9, 15, _NONE, _NONE, _NONE],
    ],
    np.int32,  # as JAX indexes with and without 64 bits: it may be asked in both in one process
)
_FIRST = np.array([6, 12, 1, 2, 3], np.int32)


def relative_airmass(view_zenith_angle: Reals) -> Reals:
    """1 / cos of the view zenith angle, as the formula takes it."""
    return 1 / jnp.maximum(jnp.cos(view_zenith_angle), COSINE_FLOOR)


def horizon_rows(coefficients: Reals, airmass: Reals) -> Float[Array, "*c 5 d"]:
    """The horizon's factor h = 1 + A exp(B m) and its derivatives by A, B, A B, B B.

    Args:
        coefficients: A, B, C, D, E, shape [..., 5].
        airmass: m, shape [direction].
    """
    A, B = coefficients[..., 0, None], coefficients[..., 1, None]
    m = jnp.expand_dims(airmass, tuple(range(A.ndim - 1)))
    x = jnp.exp(B * m)
    return jnp.stack([1 + A * x, x, A * m * x, m * x, A * m**2 * x], axis=-2)


def sun_rows(coefficients: Reals, γ: Reals, square: Reals) -> Float[Array, "*c 6 d"]:
    """The sun's factor g = 1 + C exp(D γ) + E cos^2 γ and its derivatives by C, D, E, C D, D D.

    Args:
        coefficients: A, B, C, D, E, shape [..., 5]; broadcasts against the angles' leading axes.
        γ: Angle from the sun, shape [..., direction] [rad].
        square: cos^2 γ, of the same shape.
    """
    C, D, E = (coefficients[..., k, None] for k in (2, 3, 4))
    y = jnp.exp(D * γ)
    rows = (1 + C * y + E * square, y, C * γ * y, square, γ * y, C * γ**2 * y)
    return jnp.stack(jnp.broadcast_arrays(*rows), axis=-2)


def formula_derivatives(horizon: Reals, sun: Reals) -> tuple[Scalar, Reals, Reals]:
    """F in one direction with its gradient and Hessian by A..E, from rows of shape [5] and [6]."""
    table = jnp.append(jnp.outer(horizon, sun).ravel(), 0.0)
    return table[0], table[_FIRST], table[_SECOND]


def sky_loss(
    horizon: Float[Array, "5 d"],
    sun: Float[Array, "6 d"],
    scale: Scalar,
    data: Reals,
    measure: weights.Measure,
    share: Reals,
) -> tuple[Scalar, Reals, Reals]:
    """Half the weighted sum of squared residuals of one sky and its derivatives.

    Args:
        horizon: Rows of the horizon's factor.
        sun: Rows of the sun's factor.
        scale: The model is scale times the formula.
        data: Values, [direction].
        measure: What residuals are counted in.
        share: Weight of each squared residual.

    Returns:
        Value; gradient and Hessian by A, B, C, D, E and the scale, shapes [6] and [6, 6].
    """
    h, g = horizon[0], sun[0]
    formula = h * g
    residual, slope, bend = measure.misfit_derivatives(scale * formula, data)
    straight = share * residual * slope
    table = jnp.append(((horizon * straight[None, :]) @ sun.T).ravel(), 0.0)
    rows = jnp.concatenate(
        [horizon[1:3] * (scale * g)[None, :], sun[1:4] * (scale * h)[None, :], formula[None, :]]
    )
    gram = (rows * (share * (slope**2 + residual * bend))[None, :]) @ rows.T
    first, second = table[_FIRST], table[_SECOND]
    total = table[0]
    gradient = jnp.append(scale * first, total)
    curved = jnp.pad(scale * second, (0, 1)).at[5, :5].set(first).at[:5, 5].set(first)
    value = 0.5 * jnp.sum(share * residual**2)
    return value, gradient, gram + curved


def with_best_scale(value: Scalar, gradient: Reals, hessian: Reals) -> tuple[Scalar, Reals, Reals]:
    """Derivatives by A..E where the scale always is the best: what remains of the six."""
    cross = hessian[:5, 5]
    positive = hessian[5, 5] > 0
    bend = jnp.where(positive, hessian[5, 5], 1.0)
    reduced = hessian[:5, :5] - jnp.outer(cross, cross) / bend
    return value, gradient[:5], jnp.where(positive, reduced, hessian[:5, :5])


def with_given_scale(
    value: Scalar,
    gradient: Reals,
    hessian: Reals,
    scale_gradient: Reals,
    scale_hessian: Reals,
) -> tuple[Scalar, Reals, Reals]:
    """Derivatives by A..E where the scale follows from them, with known derivatives."""
    cross = jnp.outer(hessian[:5, 5], scale_gradient)
    return (
        value,
        gradient[:5] + gradient[5] * scale_gradient,
        hessian[:5, :5]
        + cross
        + cross.T
        + hessian[5, 5] * jnp.outer(scale_gradient, scale_gradient)
        + gradient[5] * scale_hessian,
    )
