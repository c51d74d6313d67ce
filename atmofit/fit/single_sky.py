"""Fits of the Perez formula to single skies, to many at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.fit import least_squares, parameters
from atmofit.fit import weighting as weights
from atmofit.fit.parameters import PerezPrior
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.perez import perez_formula
from atmofit.typing import Reals, RealsLike, Scalar

MAX_STEPS = 200
DEFAULT_PRIOR = PerezPrior()


class PerezFit(eqx.Module):
    """Perez formulas fitted to skies; `...` are the axes of the skies.

    Attributes:
        coefficients: A, B, C, D, E.
        scale: Factor on the formula, in the unit of the values; 1 if it was not fitted.
        standard_error: Of A, B, C, D, E and the scale; see `least_squares.uncertainty` for what
            it means. The scale's is 0 if it was not fitted.
        covariance: Of the six.
        condition_number: Of the data's Jacobian, columns scaled to unit length.
        rms: Root mean square residual, dimensionless in the measure of the weighting.
        largest: Largest residual by size, likewise.
        converged: Whether a further Newton step would change nothing.
        steps: Steps of the search.
        weighting: Static.
        prior: The one in use.
    """

    coefficients: Float[Array, "*sky 5"]
    scale: Float[Array, "*sky"]
    standard_error: Float[Array, "*sky 6"]
    covariance: Float[Array, "*sky 6 6"]
    condition_number: Float[Array, "*sky"]
    rms: Float[Array, "*sky"]
    largest: Float[Array, "*sky"]
    converged: Bool[Array, "*sky"]
    steps: Int[Array, "*sky"]
    weighting: str = eqx.field(static=True, default="relative")
    prior: PerezPrior = DEFAULT_PRIOR

    def predict(
        self, directions: Directions | DirectionGrid, solar_zenith_angle: RealsLike
    ) -> Reals:
        """The fitted skies, [..., direction axes], in the unit of the values."""
        view, azimuth = directions.angles()
        dtype = self.coefficients.dtype
        axes = tuple(range(-view.ndim, 0))
        sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON).astype(dtype)
        sun = jnp.expand_dims(jnp.broadcast_to(sun, self.scale.shape), axes)
        γ = scattering_angle(view.astype(dtype), azimuth.astype(dtype), sun)
        coefficients = jnp.expand_dims(self.coefficients, tuple(a - 1 for a in axes))
        return jnp.expand_dims(self.scale, axes) * perez_formula(
            coefficients, view.astype(dtype), γ
        )


def fit_perez(
    directions: Directions | DirectionGrid,
    solar_zenith_angle: RealsLike,
    values: RealsLike,
    *,
    weighting: str = "relative",
    fit_scale: bool = True,
    prior: PerezPrior = DEFAULT_PRIOR,
    max_steps: int = MAX_STEPS,
) -> PerezFit:
    """Fit values = scale F(θ, γ) to one sky or to many at once.

    The search keeps B and D negative and 1 + A exp(B) positive (`fit.parameters`), which holds
    for every published sky, and begins from the two best of 42 skies. It runs in float64 where
    JAX allows it.

    Args:
        directions: At least as many as parameters.
        solar_zenith_angle: 0 to pi/2 [rad]; broadcasts against the axes of the skies.
        values: Shape [..., direction axes], any unit; positive unless weighting is "absolute".
        weighting: "relative", "absolute" or "log", see `weighting.measure`.
        fit_scale: Fit the scale too; False fixes it at 1.
        prior: What decides where data leave a parameter open.
        max_steps: Steps allowed.

    Returns:
        The fits, whose `converged` tells which may be used.

    Raises:
        ValueError: Empty, non-finite or non-positive data, or shapes or angles that do not fit.
    """
    choice("weighting", weighting, weights.WEIGHTINGS)
    data = weights.checked_values("values", values, weighting)
    view, azimuth = direction_angles(directions, data.dtype)
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    skies = data.shape[: data.ndim - len(directions.shape)]
    if data.shape != skies + directions.shape:
        raise ValueError(
            f"values must have shape [..., {', '.join(map(str, directions.shape))}], "
            f"got {data.shape}"
        )
    if view.size < 5 + fit_scale:
        raise ValueError(f"directions must be at least {5 + fit_scale}, got {view.size}")
    try:
        sun = jnp.broadcast_to(sun, skies).astype(data.dtype)
    except ValueError:
        raise ValueError(
            f"solar_zenith_angle must broadcast to the skies' shape {skies}, got {sun.shape}"
        ) from None
    data = data.reshape(-1, view.size)
    measure = weights.measure(data, weighting, axes=1)
    fitted = _fit_skies(view, azimuth, sun.ravel(), data, measure, prior, fit_scale, max_steps)
    arrays = jax.tree.map(lambda leaf: leaf.reshape(skies + leaf.shape[1:]), fitted)
    return PerezFit(**arrays, weighting=weighting, prior=prior)


def direction_angles(
    directions: Directions | DirectionGrid, dtype: jnp.dtype
) -> tuple[Reals, Reals]:
    """Checked view zenith angles and relative azimuths as two lists."""
    view, azimuth = directions.angles()
    view = angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
    azimuth = in_range("relative_azimuth", azimuth, -np.inf, np.inf)
    return view.ravel().astype(dtype), azimuth.ravel().astype(dtype)


@eqx.filter_jit
def _fit_skies(
    view: Reals,
    azimuth: Reals,
    suns: Reals,
    values: Float[Array, "sky direction"],
    measure: weights.Measure,
    prior: PerezPrior,
    fit_scale: bool,
    max_steps: int,
) -> dict[str, Array]:
    def one(sun: Scalar, data: Reals, measure: weights.Measure) -> dict[str, Array]:
        γ = scattering_angle(view, azimuth, sun)
        # The unit of the data must not matter for the guards.
        unit = jnp.sqrt(jnp.mean(data**2)) if fit_scale else jnp.ones_like(sun)
        measure = weights.Measure(measure.unit / unit, measure.log)
        fitted = _fit_sky(view, γ, data / unit, measure, prior, fit_scale, max_steps)
        units = jnp.append(jnp.ones(5, unit.dtype), unit)
        fitted["scale"] = fitted["scale"] * unit
        fitted["standard_error"] = fitted["standard_error"] * units
        fitted["covariance"] = fitted["covariance"] * units[:, None] * units[None, :]
        return fitted

    return jax.vmap(one)(suns, values, measure)


def _fit_sky(
    view: Reals,
    γ: Reals,
    data: Reals,
    measure: weights.Measure,
    prior: PerezPrior,
    fit_scale: bool,
    max_steps: int,
) -> dict[str, Array]:
    share = 1 / np.sqrt(data.size)

    def best(shape: Reals) -> Scalar:
        return measure.best_scale(shape, data) if fit_scale else jnp.ones_like(shape[0])

    def of_data(free: Reals) -> Reals:
        shape = perez_formula(parameters.to_coefficients(free), view, γ)
        return measure.misfit(best(shape) * shape, data) * share

    def of_all(free: Reals) -> Reals:
        return jnp.append(of_data(free), prior.residuals(free))

    minimum = search(of_all, view.dtype, 1, max_steps, starts=2)
    coefficients = parameters.to_coefficients(minimum.parameters)
    shape = perez_formula(coefficients, view, γ)
    scale = best(shape)
    residuals = measure.misfit(scale * shape, data)

    def of_published(p: Reals) -> Reals:
        factor = p[5] if fit_scale else jnp.ones_like(p[0])
        return measure.misfit(factor * perez_formula(p[:5], view, γ), data) * share

    def of_prior(p: Reals) -> Reals:
        return prior.residuals(parameters.to_free(p[:5]))

    published = jnp.append(coefficients, scale) if fit_scale else coefficients
    known = least_squares.uncertainty(of_published, of_prior, published)
    missing = 6 - published.size
    return {
        "coefficients": coefficients,
        "scale": scale,
        "standard_error": jnp.pad(known.standard_error, (0, missing)),
        "covariance": jnp.pad(known.covariance, (0, missing)),
        "condition_number": known.condition_number,
        "rms": jnp.sqrt(jnp.mean(residuals**2)),
        "largest": jnp.max(jnp.abs(residuals)),
        "converged": minimum.converged,
        "steps": minimum.steps,
    }


def search(
    residuals: least_squares.Residuals,
    dtype: jnp.dtype,
    copies: int,
    max_steps: int,
    starts: int,
) -> least_squares.Minimum:
    """Minimise from the best candidates, each with another horizon, and keep the lowest."""
    table = jnp.asarray(parameters.candidates(), dtype)
    first = jnp.tile(table, (1, 1, copies))
    losses = jax.vmap(jax.vmap(lambda free: jnp.sum(residuals(free) ** 2)))(first)
    best_sun = jnp.argmin(losses, axis=1)
    rows = jnp.arange(table.shape[0])
    horizons = jnp.argsort(losses[rows, best_sun])[:starts]
    begin = first[horizons, best_sun[horizons]]
    if starts == 1:
        return least_squares.minimise(residuals, begin[0], max_steps)
    ends = jax.vmap(lambda free: least_squares.minimise(residuals, free, max_steps))(begin)
    lowest = jnp.argmin(jnp.where(jnp.isnan(ends.loss), jnp.inf, ends.loss))
    return jax.tree.map(lambda leaf: leaf[lowest], ends)
