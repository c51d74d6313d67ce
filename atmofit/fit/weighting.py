"""How the difference between model and data is measured."""

import equinox as eqx
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

    def best_scale(self, shape: Reals, values: Reals) -> Scalar:
        """The factor on a model's shape that makes the sum of squared residuals smallest."""
        if self.log:
            return jnp.exp(jnp.mean(jnp.log(values) - safe_log(shape)))
        tiny = float(jnp.finfo(shape.dtype).tiny)
        model, data = shape / self.unit, values / self.unit
        return jnp.sum(model * data) / (jnp.sum(model**2) + tiny)


def measure(values: Reals, weighting: str, axes: int | None = None) -> Measure:
    """How residuals of the values are counted.

    Args:
        values: Data.
        weighting: "relative" to each value, "absolute" in units of the values' root mean square,
            or "log", the difference of logarithms.
        axes: The last so many axes hold one set of data; None: all.
    """
    if weighting == "relative":
        return Measure(values, log=False)
    last = None if axes is None else tuple(range(-axes, 0))
    size = jnp.sqrt(jnp.mean(values**2, axis=last, keepdims=True))
    return Measure(jnp.broadcast_to(size, values.shape), log=weighting == "log")


def safe_log(x: Reals) -> Reals:
    """Logarithm, continued by its tangent below 1e-6 so that a search can come back."""
    good = x > _SMALLEST
    straight = float(np.log(_SMALLEST)) + x / _SMALLEST - 1
    return jnp.where(good, jnp.log(jnp.where(good, x, 1.0)), straight)
