"""How well the data of a fit determine its parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from atmofit.fit.least_squares import Residuals
from atmofit.typing import Reals


class Uncertainty(eqx.Module):
    """How well parameters are determined, see `uncertainty`.

    Attributes:
        variance: Of one residual.
        covariance: Of the parameters.
        standard_error: Residuals taken as independent.
        robust_standard_error: Only clusters taken as independent.
        condition_number: Of the data's Jacobian, columns scaled to unit length.
        column_norm: Length of each column: what the parameter alone changes, per unit.
        weakest_direction: Unit vector over the parameters, each in units of 1 / column_norm, along
            which residuals change least; its largest component is positive.
        weakest_change: Length of the change of the residuals along it, per unit; 1 for a
            parameter alone.
    """

    variance: Float[Array, ""]
    covariance: Float[Array, "p p"]
    standard_error: Float[Array, " p"]
    robust_standard_error: Float[Array, " p"]
    condition_number: Float[Array, ""]
    column_norm: Float[Array, " p"]
    weakest_direction: Float[Array, " p"]
    weakest_change: Float[Array, ""]


def uncertainty(
    residuals: Residuals,
    prior: Residuals,
    parameters: Reals,
    *,
    used: Bool[Array, " n"] | None = None,
    clusters: int | None = None,
) -> Uncertainty:
    """Covariance and condition number at a minimum.

    Standard errors take the data's residuals as independent and of equal variance, estimated from
    them. The error of a model is correlated from one direction to the next, so they tell how well
    the data fix a parameter and not how far it is from any truth. The robust ones allow any
    correlation and any variance inside a cluster and take only the clusters as independent: the
    sandwich formula with the usual factor G / (G - 1) (N - 1) / (N - p) for G clusters.

    Args:
        residuals: Of the data, from parameters.
        prior: Residuals of the prior, from the same parameters.
        parameters: At the minimum.
        used: Which residuals are data; the others must be 0. None: all.
        clusters: Residuals are so many clusters of equal size, one after the other. None: each
            residual is one.

    Returns:
        Covariance and standard errors, prior included; and the condition number of the data's
        Jacobian with columns scaled to unit length, which saturates at eps^-1/2 (7e7). Robust
        standard errors are NaN for a single cluster, and too small for fewer than parameters.

    References:
        Liang and Zeger (1986), Biometrika 73, 13. Cameron and Miller (2015), J. Human Resources
        50, 317.
    """
    values = residuals(parameters)
    size = parameters.shape[0]
    jacobian, of_prior = jax.jacfwd(residuals)(parameters), jax.jacfwd(prior)(parameters)
    groups = (values.shape[0] if clusters is None else clusters, -1)
    counted = jnp.ones(values.shape, bool) if used is None else used
    count = jnp.sum(counted).astype(values.dtype)
    degrees = jnp.maximum(count - size, 1)
    variance = jnp.dot(values, values) / degrees
    data = jacobian.T @ jacobian
    _, stretch, axes = _scaled_inverse(data)
    inverse, _, _ = _scaled_inverse(data + of_prior.T @ of_prior)
    covariance = variance * inverse
    scores = jnp.sum((jacobian * values[:, None]).reshape(*groups, size), axis=1)
    number = jnp.sum(jnp.any(counted.reshape(groups), axis=1)).astype(values.dtype)
    several = number > 1
    factor = jnp.where(several, number / jnp.where(several, number - 1, 1.0), jnp.nan)
    spread = scores @ inverse
    robust = factor * (count - 1) / degrees * jnp.sum(spread**2, axis=0)
    return Uncertainty(
        variance=variance,
        covariance=covariance,
        standard_error=jnp.sqrt(jnp.diagonal(covariance)),
        robust_standard_error=jnp.sqrt(robust),
        condition_number=jnp.sqrt(stretch[-1] / stretch[0]),
        column_norm=jnp.sqrt(jnp.diagonal(data)),
        weakest_direction=pointing_up(axes[:, 0]),
        weakest_change=jnp.sqrt(stretch[0]),
    )


def pointing_up(direction: Float[Array, " p"]) -> Float[Array, " p"]:
    """The direction or its opposite, so that the largest component is positive."""
    return direction * jnp.sign(direction[jnp.argmax(jnp.abs(direction))])


def _scaled_inverse(
    matrix: Float[Array, "p p"],
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, "p p"]]:
    """Inverse of a symmetric matrix; eigenvalues and axes with its diagonal scaled to 1."""
    dtype = matrix.dtype
    diagonal = jnp.diagonal(matrix)
    positive = diagonal > 0
    factor = jnp.where(positive, 1 / jnp.sqrt(jnp.where(positive, diagonal, 1.0)), 1.0)
    values, axes = jnp.linalg.eigh(matrix * factor[:, None] * factor[None, :])
    values = jnp.maximum(values, float(jnp.finfo(dtype).eps) * values[-1])
    scaled = axes * factor[:, None]
    return (scaled / values[None, :]) @ scaled.T, values, axes
