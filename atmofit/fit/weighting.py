"""How the difference between model and data is measured."""

import jax.numpy as jnp
import numpy as np

from atmofit.checks import is_traced
from atmofit.typing import Reals, RealsLike, Scalar

WEIGHTINGS = ("relative", "absolute", "log")
_SMALLEST = 1e-6  # below this, the logarithm of a model continues as a straight line


def checked_values(name: str, values: RealsLike, weighting: str) -> Reals:
    """Data as an array of the default floating-point type, refused if they cannot be fitted.

    Raises:
        ValueError: Known data are none, not finite, or not positive where they must be.
    """
    array = jnp.asarray(values, jnp.result_type(float))
    if array.size == 0:
        raise ValueError(f"{name} must hold data, got shape {array.shape}")
    if is_traced(array):
        return array
    known = np.asarray(array)
    finite = np.isfinite(known)
    if not finite.all():
        bad = known[~finite]
        raise ValueError(f"{name} must be finite, got {bad[0]} ({bad.size} of {known.size} values)")
    if weighting != "absolute" and known.min() <= 0:
        count = int((known <= 0).sum())
        raise ValueError(
            f'{name} must be positive for weighting "{weighting}", got {known.min():.6g} '
            f"({count} of {known.size} values)"
        )
    if not known.any():
        raise ValueError(f"{name} must not all be 0, got {known.size} zeros")
    return array


def misfit(model: Reals, values: Reals, weighting: str) -> Reals:
    """Residuals, dimensionless.

    Args:
        model: Any shape.
        values: Data of the same shape.
        weighting: "relative" to each value, "absolute" in units of the values' root mean square,
            or "log", the difference of logarithms.
    """
    if weighting == "relative":
        return model / values - 1
    if weighting == "absolute":
        return (model - values) / jnp.sqrt(jnp.mean(values**2))
    return safe_log(model) - jnp.log(values)


def best_scale(shape: Reals, values: Reals, weighting: str) -> Scalar:
    """The factor on a model's shape that makes the sum of squared residuals smallest."""
    tiny = float(jnp.finfo(shape.dtype).tiny)
    if weighting == "log":
        return jnp.exp(jnp.mean(jnp.log(values) - safe_log(shape)))
    if weighting == "relative":
        ratio = shape / values
        return jnp.sum(ratio) / (jnp.sum(ratio**2) + tiny)
    return jnp.sum(shape * values) / (jnp.sum(shape**2) + tiny)


def safe_log(x: Reals) -> Reals:
    """Logarithm, continued by its tangent below 1e-6 so that a search can come back."""
    good = x > _SMALLEST
    straight = float(np.log(_SMALLEST)) + x / _SMALLEST - 1
    return jnp.where(good, jnp.log(jnp.where(good, x, 1.0)), straight)
