"""Fits of the Perez formula to single skies, to many at once."""

from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.fit import least_squares, parameters, perez_loss
from atmofit.fit import weighting as weights
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.uncertainty import Uncertainty, uncertainty
from atmofit.fit.words import parameter_lines
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.perez import perez_formula
from atmofit.typing import Reals, RealsLike, Scalar

if TYPE_CHECKING:
    from atmofit.fit.distribution import RatioProblem

MAX_STEPS = 200
DEFAULT_PRIOR = PerezPrior()


class PerezFit(eqx.Module):
    """Perez formulas fitted to skies; `...` are the axes of the skies.

    Attributes:
        coefficients: A, B, C, D, E.
        scale: Factor on the formula, in the unit of the values; 1 if it was not fitted.
        standard_error: Of A, B, C, D, E and the scale; see `uncertainty.uncertainty` for what
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

    def __str__(self) -> str:
        """Coefficients with their errors; of one sky."""
        if is_traced(self) or self.rms.ndim:
            return repr(self)
        values = jnp.append(self.coefficients, self.scale)
        state = "" if self.converged else ", not converged"
        return "\n".join(
            [
                f"Perez, rms {self.rms:.3g}, {self.weighting}{state}",
                *parameter_lines((*"ABCDE", "scale"), values, self.standard_error, [""] * 6),
                f"  condition number {self.condition_number:.3g}",
            ]
        )

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
    for every published sky, and begins from the best of 42 skies. It runs in float64 where JAX
    allows it.

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
    problem, unit, skies = checked_problem(
        directions, solar_zenith_angle, values, weighting, fit_scale, prior
    )
    fitted = _fit_skies(problem, unit, max_steps)
    arrays = jax.tree.map(lambda leaf: leaf.reshape(skies + leaf.shape[1:]), fitted)
    return PerezFit(**arrays, weighting=weighting, prior=prior.fresh())


def checked_problem(
    directions: Directions | DirectionGrid,
    solar_zenith_angle: RealsLike,
    values: RealsLike,
    weighting: str,
    fit_scale: bool,
    prior: PerezPrior,
) -> tuple["SkyProblem", Float[Array, " sky"], tuple[int, ...]]:
    """The problem of `fit_perez`, whose arguments and errors these are; units; skies' axes."""
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
    problem, unit = sky_problem(view, azimuth, sun.ravel(), data, measure, prior.fresh(), fit_scale)
    return problem, unit, skies


def direction_angles(
    directions: Directions | DirectionGrid, dtype: jnp.dtype
) -> tuple[Reals, Reals]:
    """Checked view zenith angles and relative azimuths as two lists."""
    view, azimuth = directions.angles()
    view = angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
    azimuth = in_range("relative_azimuth", azimuth, -np.inf, np.inf)
    return view.ravel().astype(dtype), azimuth.ravel().astype(dtype)


class SkyProblem(eqx.Module):
    """Skies to be fitted one by one, each with five parameters in widths of the prior.

    Attributes:
        view, airmass: Of each direction.
        γ, square: Angle from the sun and its squared cosine.
        values: Of each sky, in units of their root mean square if the scale is fitted.
        measure: Of the values, its unit of their shape.
        prior: Its strength is the search's ridge.
        fit_scale: Static.
    """

    view: Float[Array, " d"]
    airmass: Float[Array, " d"]
    γ: Float[Array, "sky d"]
    square: Float[Array, "sky d"]
    values: Float[Array, "sky d"]
    measure: weights.Measure
    prior: PerezPrior
    fit_scale: bool = eqx.field(static=True)
    ends: int = eqx.field(static=True, default=1)
    lanes: int = eqx.field(static=True, default=64)  # whose tables fit in a processor's cache

    def coefficients(self, place: Reals) -> Float[Array, "1 5"]:
        """A..E from parameters."""
        return parameters.to_coefficients(self.prior.free(place))[None, :]

    def derivatives(self, sky: Int[Array, ""], place: Reals) -> least_squares.Derivatives:
        """Half the mean squared residual of one sky, with gradient and Hessian."""
        c, data, measure = self.coefficients(place)[0], self.values[sky], self._measure(sky)
        horizon = perez_loss.horizon_rows(c, self.airmass)
        sun = perez_loss.sun_rows(c, self.γ[sky], self.square[sky])
        scale = self._scale(horizon[0] * sun[0], data, measure)
        share = jnp.full_like(data, 1 / data.size)
        all_six = perez_loss.sky_loss(horizon, sun, scale, data, measure, share)
        if self.fit_scale:
            value, gradient, hessian = perez_loss.with_best_scale(*all_six)
        else:
            value, gradient, hessian = all_six[0], all_six[1][:5], all_six[2][:5, :5]
        return value, *parameters.pull_back(
            self.coefficients, place, gradient[None, :], hessian[None, :, :]
        )

    def summary(self, sky: Int[Array, ""], place: Reals) -> "SkySummary":
        """What a fit says about one sky, its uncertainty included."""
        data, measure, γ = self.values[sky], self._measure(sky), self.γ[sky]
        coefficients = self.coefficients(place)[0]
        shape = perez_formula(coefficients, self.view, γ)
        scale = self._scale(shape, data, measure)
        residuals = measure.misfit(scale * shape, data)

        def of_published(p: Reals) -> Reals:
            factor = p[5] if self.fit_scale else jnp.ones_like(p[0])
            model = factor * perez_formula(p[:5], self.view, γ)
            return measure.misfit(model, data) / np.sqrt(data.size)

        def of_prior(p: Reals) -> Reals:
            return self.prior.residuals(parameters.to_free(p[:5]))

        published = jnp.append(coefficients, scale) if self.fit_scale else coefficients
        known = uncertainty(of_published, of_prior, published)
        return SkySummary(coefficients, scale, residuals, known)

    def _measure(self, sky: Int[Array, ""]) -> weights.Measure:
        return weights.Measure(self.measure.unit[sky], self.measure.log)

    def _scale(self, shape: Reals, data: Reals, measure: weights.Measure) -> Scalar:
        return measure.best_scale(shape, data) if self.fit_scale else jnp.ones_like(shape[0])

    def known(self, sky: Int[Array, ""], place: Reals) -> tuple[Reals, Uncertainty]:
        """A..E and the scale, if it was fitted, with their uncertainty."""
        best = self.summary(sky, place)
        scale = best.scale[None] if self.fit_scale else best.scale[None][:0]
        return jnp.append(best.coefficients, scale), best.known

    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return (*parameters.NAMES, "scale") if self.fit_scale else parameters.NAMES


class SkySummary(NamedTuple):
    """Coefficients A..E, their scale, residuals and uncertainty of one sky."""

    coefficients: Reals
    scale: Scalar
    residuals: Reals
    known: Uncertainty


@eqx.filter_jit
def _fit_skies(problem: SkyProblem, unit: Float[Array, " sky"], max_steps: int) -> dict[str, Array]:
    skies = unit.size
    minimum = search(problem, skies, max_steps)
    best = jax.vmap(problem.summary)(jnp.arange(skies), minimum.parameters)
    missing = 5 + 1 - best.known.standard_error.shape[-1]
    error = jnp.pad(best.known.standard_error, ((0, 0), (0, missing)))
    covariance = jnp.pad(best.known.covariance, ((0, 0), (0, missing), (0, missing)))
    units = jnp.concatenate([jnp.ones((unit.size, 5), unit.dtype), unit[:, None]], axis=1)
    return {
        "coefficients": best.coefficients,
        "scale": best.scale * unit,
        "standard_error": error * units,
        "covariance": covariance * units[:, :, None] * units[:, None, :],
        "condition_number": best.known.condition_number,
        "rms": jnp.sqrt(jnp.mean(best.residuals**2, axis=1)),
        "largest": jnp.max(jnp.abs(best.residuals), axis=1),
        "converged": minimum.converged,
        "steps": minimum.steps,
    }


@eqx.filter_jit
def sky_problem(
    view: Reals,
    azimuth: Reals,
    suns: Reals,
    values: Float[Array, "sky direction"],
    measure: weights.Measure,
    prior: PerezPrior,
    fit_scale: bool,
) -> tuple[SkyProblem, Float[Array, " sky"]]:
    """The problem, and the unit in which it holds the values of each sky."""
    γ = scattering_angle(view[None, :], azimuth[None, :], suns[:, None])
    size = jnp.sqrt(jnp.mean(values**2, axis=1))
    # The unit of the data must not matter for the guards.
    unit = size if fit_scale else jnp.ones_like(size)
    problem = SkyProblem(
        view=view,
        airmass=perez_loss.relative_airmass(view),
        γ=γ,
        square=jnp.cos(γ) ** 2,
        values=values / unit[:, None],
        measure=weights.Measure(measure.unit / unit[:, None], measure.log),
        prior=prior,
        fit_scale=fit_scale,
    )
    return problem, unit


def search(
    problem: "SkyProblem | RatioProblem", fits: int, max_steps: int
) -> least_squares.Minimum:
    """Minimise each fit of a problem from the best of the candidates.

    The minima have the derivatives by all that the problem holds, which follow from the problem at
    the minimum alone (the implicit function theorem): nothing is differentiated through the search.
    """
    still = jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_array(x) else x, problem)
    starts = best_candidates(still, fits)
    paths = parameters.paths(still.prior, still.ends, starts.dtype)
    found = least_squares.minimise(still.derivatives, starts, paths, max_steps, still.lanes)
    ridge = jnp.asarray(problem.prior.strength, starts.dtype) ** 2

    def followed(fit: Int[Array, ""], place: Reals) -> Reals:
        _, gradient, hessian = problem.derivatives(fit, place)
        curvature = jax.lax.stop_gradient(hessian) + ridge * jnp.eye(place.size, dtype=place.dtype)
        step = -jnp.linalg.solve(curvature, gradient + ridge * place)
        # No step is taken; only its slope counts.
        return place + (step - jax.lax.stop_gradient(step))

    places = jax.lax.map(lambda at: followed(*at), (jnp.arange(fits), found.parameters))
    return eqx.tree_at(lambda m: m.parameters, found, places)


def best_candidates(problem: "SkyProblem | RatioProblem", fits: int) -> Float[Array, "fit p"]:
    """Where the search for each fit of a problem begins."""
    table = jnp.asarray(parameters.candidates(), jnp.result_type(float))
    table = jnp.tile(problem.prior.place(table), (1, problem.ends))

    def best(fit: Int[Array, ""]) -> Reals:
        losses = jax.vmap(lambda place: problem.derivatives(fit, place)[0])(table)
        return table[jnp.argmin(jnp.where(jnp.isnan(losses), jnp.inf, losses))]

    return jax.lax.map(best, jnp.arange(fits), batch_size=min(fits, 8))
