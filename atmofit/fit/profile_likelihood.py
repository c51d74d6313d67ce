"""Profile likelihoods: the loss against one parameter, with all others at their best."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.fit import least_squares
from atmofit.fit.distribution import RatioProblem
from atmofit.fit.single_sky import SkyProblem
from atmofit.fit.uncertainty import Uncertainty
from atmofit.typing import Reals, Scalar

CHI_SQUARE = 3.841459  # 95 % of chi-square with one degree of freedom
# Points of a profile, in standard errors from the best value.
OFFSETS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
_STIFFNESS = 100.0  # of the spring that holds a profiled parameter, relative to the data's


class Profile(eqx.Module):
    """The loss against one parameter, with all others at their best; `...` as of the fits.

    Attributes:
        parameter: Its place among the names.
        value: Increasing.
        rise: Of the loss above its lowest, in units of the variance of one residual: the square
            of the distance in standard errors where the loss is a parabola. NaN where a search
            did not converge.
        lower: Where the rise reaches 3.84, the 95 % interval's end; -inf where it does not within
            ten standard errors (or, for B and D, before 0).
        upper: Likewise, inf.
    """

    parameter: Int[Array, "*fit two"]
    value: Float[Array, "*fit two point"]
    rise: Float[Array, "*fit two point"]
    lower: Float[Array, "*fit two"]
    upper: Float[Array, "*fit two"]


def both_sides() -> np.ndarray:
    """Points of a profile on both sides of the best value, in standard errors."""
    return np.concatenate([-np.array(OFFSETS[:0:-1]), OFFSETS])


def profiles(
    problem: SkyProblem | RatioProblem,
    best: Float[Array, "fit p"],
    lowest: Float[Array, " fit"],
    known: Uncertainty,
    weakest: Int[Array, "fit two"],
    max_steps: int,
) -> Profile:
    """Profiles of the two weakest parameters by a spring that pulls each to its values.

    Where the spring and the data balance, the data's loss is the lowest for the value that the
    parameter has there, which is what is kept: so the spring's stiffness does not matter.
    """
    dtype, fits = best.dtype, best.shape[0]
    variance = jnp.maximum(known.variance, least_squares.resolution(dtype))
    error = jnp.take_along_axis(known.standard_error, weakest, axis=1)
    error = error * jnp.sqrt(variance / known.variance)[:, None]
    stiffness = _STIFFNESS * variance[:, None] / error**2
    offsets = jnp.asarray(both_sides(), dtype)
    points = offsets.size
    now = jax.vmap(lambda place: problem.coefficients(place).ravel())(best)
    centre = jnp.take_along_axis(now, weakest, axis=1)
    target = centre[..., None] + error[..., None] * offsets[None, None, :]

    def of(search: Int[Array, ""], place: Reals) -> Scalar:
        return problem.coefficients(place).ravel()[weakest.ravel()[search // points]]

    def spring(search: Int[Array, ""], place: Reals) -> Scalar:
        stretch = of(search, place) - target.ravel()[search]
        return 0.5 * stiffness.ravel()[search // points] * stretch**2

    def objective(search: Int[Array, ""], place: Reals) -> least_squares.Derivatives:
        value, gradient, hessian = problem.derivatives(search // (2 * points), place)
        return (
            value + spring(search, place),
            gradient + jax.grad(spring, argnums=1)(search, place),
            hessian + jax.hessian(spring, argnums=1)(search, place),
        )

    strength = jnp.asarray(problem.prior.strength, dtype)
    straight = least_squares.Paths(strength.reshape(1, 1), jnp.zeros((1, best.shape[1]), dtype))
    starts = jnp.repeat(best, 2 * points, axis=0)
    ends = least_squares.minimise(objective, starts, straight, max_steps, problem.lanes)
    searches = jnp.arange(starts.shape[0])
    value = jax.vmap(of)(searches, ends.parameters).reshape(fits, 2, points)
    loss = (ends.loss - jax.vmap(spring)(searches, ends.parameters)).reshape(fits, 2, points)
    rise = 2 * (loss - lowest[:, None, None]) / variance[:, None, None]
    rise = jnp.where(ends.converged.reshape(rise.shape), rise, jnp.nan)
    middle = points // 2
    side = jax.vmap(jax.vmap(crossing))
    return Profile(
        parameter=weakest,
        value=value,
        rise=rise,
        lower=-side(-value[..., middle::-1], rise[..., middle::-1]),
        upper=side(value[..., middle:], rise[..., middle:]),
    )


def crossing(value: Float[Array, " k"], rise: Float[Array, " k"]) -> Scalar:
    """Where the rise, from its lowest outward, first reaches the threshold; inf: nowhere.

    The root of the rise is nearly straight, and so interpolated.
    """
    root, threshold = jnp.sqrt(jnp.maximum(rise, 0.0)), CHI_SQUARE**0.5
    beyond = root >= threshold
    after = jnp.argmax(beyond)
    before = jnp.maximum(after - 1, 0)
    slope = root[after] - root[before]
    share = (threshold - root[before]) / jnp.where(slope > 0, slope, 1.0)
    crossing = value[before] + share * (value[after] - value[before])
    crossing = jnp.where(jnp.isfinite(root[before]), crossing, value[after])
    return jnp.where(jnp.any(beyond), crossing, jnp.inf)
