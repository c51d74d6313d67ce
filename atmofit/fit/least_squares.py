"""Nonlinear least squares for few parameters and many residuals, and what the result is worth.

Levenberg-Marquardt sees the residuals only through loss, gradient and second derivatives, summed
over all data in one pass: a problem of as many rows as parameters. The second derivatives are
exact, not the product J^T J: these fits have large residuals (a five-parameter formula does not
hold a sky), and along a weakly determined direction the part that J^T J leaves out then dominates.
With it, what took hundreds of steps takes ten to forty.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from atmofit.typing import Reals, Scalar

_UNDAMPED = 30.0  # length of a scaled column; the first damping of 1 is then 1e-3 relative
Residuals = Callable[[Reals], Reals]


class Minimum(eqx.Module):
    """Where a search ended.

    Attributes:
        parameters: The best ones found; NaN where the residuals are.
        loss: Sum of squared residuals there.
        decrement: Share of the loss that a full Newton step would still remove.
        converged: Whether that share is below `tolerance(dtype)`, or what it would remove below
            1e-12 (1e-5 in float32), as for data that the model holds exactly. The solver's own
            flag, which says only that the last step was small, is not used.
        steps: Steps taken, rejected ones too.
    """

    parameters: Float[Array, " p"]
    loss: Float[Array, ""]
    decrement: Float[Array, ""]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]


class Uncertainty(eqx.Module):
    """How well parameters are determined, see `uncertainty`."""

    covariance: Float[Array, "p p"]
    standard_error: Float[Array, " p"]
    condition_number: Float[Array, ""]


def tolerance(dtype: jnp.dtype) -> float:
    """Largest relative decrement of a converged fit: 1e-6 in float64, 0.02 in float32."""
    return 64 * float(jnp.finfo(dtype).eps) ** 0.5


def minimise(residuals: Residuals, start: Reals, max_steps: int) -> Minimum:
    """Minimise the sum of squared residuals by Levenberg-Marquardt.

    Args:
        residuals: From parameters to residuals whose sum of squares is of order 1 or less; smooth.
        start: First parameters, of the default floating-point type; they also set the scales.
        max_steps: Steps allowed, rejected ones too.

    Returns:
        The end of the search, converged or not; nothing is raised.
    """
    dtype = start.dtype
    jacobian = jax.jacfwd(residuals)(start)
    length2 = jnp.sum(jacobian**2, axis=0)
    scale = _UNDAMPED / jnp.sqrt(length2 + 1e-8 * jnp.max(length2) + jnp.finfo(dtype).tiny)

    def scaled(z: Reals) -> Reals:
        return residuals(z * scale)

    @jax.custom_jvp
    def rows(z: Reals) -> Reals:
        return _equivalent_rows(scaled, z)[0]

    @rows.defjvp
    def _(primals: tuple[Reals], tangents: tuple[Reals]) -> tuple[Reals, Reals]:
        value, matrix = _equivalent_rows(scaled, primals[0])
        return value, matrix @ tangents[0]

    precision = max(1e-7, 1e4 * float(jnp.finfo(dtype).eps))
    solution = optx.least_squares(
        lambda z, _: rows(z),
        optx.LevenbergMarquardt(rtol=precision, atol=precision),
        start / scale,
        max_steps=max_steps,
        throw=False,
    )
    parameters = solution.value * scale
    loss = jnp.sum(residuals(parameters) ** 2)
    parameters = jnp.where(jnp.isfinite(loss), parameters, jnp.nan)
    # What the solver holds at its last accepted point, which is the solution.
    removable = jnp.sum(solution.state.f_info.residual[:-1] ** 2)
    decrement = removable / (loss + jnp.finfo(dtype).tiny)
    converged = removable <= tolerance(dtype) * loss + (10 * precision) ** 2
    return Minimum(
        parameters=parameters,
        loss=loss,
        decrement=decrement,
        converged=converged,
        steps=jnp.asarray(solution.stats["num_steps"]),
    )


def _equivalent_rows(residuals: Residuals, z: Reals) -> tuple[Reals, Float[Array, "q p"]]:
    """Few residuals, and their Jacobian, with the same loss, gradient and curvature.

    Curvature that is negative counts with its size, so that a step always goes downhill; and
    where a full step would promise more than the whole loss, curvature is raised until it
    promises just that.
    """
    dtype = z.dtype
    tiny, eps = float(jnp.finfo(dtype).tiny), float(jnp.finfo(dtype).eps)

    def half(z: Reals) -> Scalar:
        r = residuals(z)
        return 0.5 * jnp.dot(r, r)

    def slope(z: Reals) -> tuple[Reals, tuple[Reals, Scalar]]:
        value, gradient = jax.value_and_grad(half)(z)
        return gradient, (gradient, value)

    hessian, (gradient, value) = jax.jacfwd(slope, has_aux=True)(z)
    curvature, axes = jnp.linalg.eigh(hessian)
    curvature = jnp.abs(curvature)
    curvature = jnp.maximum(curvature, 10 * eps * jnp.max(curvature) + tiny)
    along = (gradient @ axes) / jnp.sqrt(curvature)
    excess = jnp.sqrt(jnp.maximum(1.0, jnp.dot(along, along) / (2 * value + tiny)))
    along = along / excess
    rest = jnp.sqrt(jnp.maximum(2 * value - jnp.dot(along, along), 0.0))
    matrix = (jnp.sqrt(curvature) * excess)[:, None] * axes.T
    return jnp.append(along, rest), jnp.pad(matrix, ((0, 1), (0, 0)))


def uncertainty(residuals: Residuals, prior: Residuals, parameters: Reals) -> Uncertainty:
    """Covariance and condition number at a minimum.

    Standard errors take the data's residuals as independent and of equal variance, estimated from
    them. The error of a model is correlated from one direction to the next, so they tell how well
    the data fix a parameter and not how far it is from any truth.

    Args:
        residuals: Of the data, from parameters.
        prior: Residuals of the prior, from the same parameters.
        parameters: At the minimum.

    Returns:
        Covariance and standard errors, prior included; and the condition number of the data's
        Jacobian with columns scaled to unit length, which saturates at eps^-1/2 (7e7).
    """
    values = residuals(parameters)
    count, size = values.shape[0], parameters.shape[0]
    variance = jnp.dot(values, values) / max(count - size, 1)
    jacobian, of_prior = jax.jacfwd(residuals)(parameters), jax.jacfwd(prior)(parameters)
    data = jacobian.T @ jacobian
    _, smallest, largest = _scaled_inverse(data)
    inverse, _, _ = _scaled_inverse(data + of_prior.T @ of_prior)
    covariance = variance * inverse
    return Uncertainty(
        covariance=covariance,
        standard_error=jnp.sqrt(jnp.diagonal(covariance)),
        condition_number=jnp.sqrt(largest / smallest),
    )


def _scaled_inverse(matrix: Float[Array, "p p"]) -> tuple[Float[Array, "p p"], Scalar, Scalar]:
    """Inverse of a symmetric matrix, and the extreme eigenvalues with its diagonal scaled to 1."""
    dtype = matrix.dtype
    diagonal = jnp.diagonal(matrix)
    positive = diagonal > 0
    factor = jnp.where(positive, 1 / jnp.sqrt(jnp.where(positive, diagonal, 1.0)), 1.0)
    values, axes = jnp.linalg.eigh(matrix * factor[:, None] * factor[None, :])
    values = jnp.maximum(values, float(jnp.finfo(dtype).eps) * values[-1])
    scaled = axes * factor[:, None]
    return (scaled / values[None, :]) @ scaled.T, values[0], values[-1]
