"""How the difference between model and data is measured."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range, is_traced
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


def checked_weight(weight: RealsLike | None, shape: tuple[int, ...], dtype: jnp.dtype) -> Reals:
    """Weights of data of a shape, ones for None.

    Raises:
        ValueError: Known weights are not finite, negative, all 0 or of another shape.
    """
    if weight is None:
        return jnp.ones(shape, dtype)
    array = in_range("weight", weight, 0.0, np.inf).astype(dtype)
    if array.shape != shape:
        raise ValueError(f"weight must have the shape of the values, {shape}, got {array.shape}")
    if not is_traced(array) and not np.asarray(array).any():
        raise ValueError(f"weight must not all be 0, got {array.size} zeros")
    return array


class Measure(eqx.Module):
    """What a residual is counted in; a traced unit, so that weightings share compiled programs.

    Attributes:
        unit: Of each residual, of the shape of the values; not used for logarithms.
        log: Whether residuals are differences of logarithms. Static.
    """

    unit: Reals
    log: bool = eqx.field(static=True)

    def misfit(self, model: Reals, values: Reals) -> Reals:
        """Residuals, dimensionless."""
        if self.log:
            return safe_log(model) - jnp.log(values)
        return (model - values) / self.unit

    def misfit_derivatives(self, model: Reals, values: Reals) -> tuple[Reals, Reals, Reals]:
        """Residuals with their first and second derivatives by the model."""
        if self.log:
            good = model > _SMALLEST
            slope = 1 / jnp.where(good, model, _SMALLEST)
            return self.misfit(model, values), slope, jnp.where(good, -(slope**2), 0.0)
        return self.misfit(model, values), 1 / self.unit, jnp.zeros_like(model)

    def best_scale(self, shape: Reals, values: Reals) -> Scalar:
        """The factor on a model's shape that makes the sum of squared residuals smallest."""
        if self.log:
            return jnp.exp(jnp.mean(jnp.log(values) - safe_log(shape)))
        tiny = float(jnp.finfo(shape.dtype).tiny)
        model, data = shape / self.unit, values / self.unit
        return jnp.sum(model * data) / (jnp.sum(model**2) + tiny)


def measure(
    values: Reals, weighting: str, axes: int | None = None, weight: Reals | None = None
) -> Measure:
    """How residuals of the values are counted.

    Args:
        values: Data.
        weighting: "relative" to each value, "absolute" in units of the values' root mean square,
            or "log", the difference of logarithms.
        axes: The last so many axes hold one set of data; None: all.
        weight: Of each value in that root mean square, of the shape of the values; None: equal.
    """
    if weighting == "relative":
        return Measure(values, log=False)
    last = None if axes is None else tuple(range(-axes, 0))
    size = jnp.sqrt(jnp.average(values**2, axis=last, weights=weight, keepdims=True))
    return Measure(jnp.broadcast_to(size, values.shape), log=weighting == "log")


def safe_log(x: Reals) -> Reals:
    """Logarithm, continued by its tangent below 1e-6 so that a search can come back."""
    good = x > _SMALLEST
    straight = float(np.log(_SMALLEST)) + x / _SMALLEST - 1
    return jnp.where(good, jnp.log(jnp.where(good, x, 1.0)), straight)
