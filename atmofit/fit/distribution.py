"""The paper's joint fit of the Perez formula, over suns and turbidities."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.fit import least_squares, parameters, perez_loss
from atmofit.fit import weighting as weights
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.single_sky import (
    DEFAULT_PRIOR,
    MAX_STEPS,
    direction_angles,
    search,
)
from atmofit.fit.uncertainty import Uncertainty, uncertainty
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.perez import perez_formula
from atmofit.typing import Reals, RealsLike


class DistributionFit(eqx.Module):
    """Perez coefficients that are linear in turbidity, fitted to all skies of a table at once.

    Attributes:
        matrix: A..E as rows, slope in T and intercept as columns, like the paper's.
        standard_error: Of the matrix, residuals taken as independent; see
            `uncertainty.uncertainty` for what it means.
        robust_standard_error: Of the matrix, each sky (turbidity and sun) taken as one cluster
            whose residuals may be correlated in any way.
        covariance: Of the matrix row by row (A slope, A intercept, B slope, ...).
        condition_number: Of the data's Jacobian, columns scaled to unit length.
        rms: Root mean square residual over all data, in the measure of the weighting; a weighted
            mean where data have weights.
        largest: Largest residual by size, where the weight is not 0.
        rms_per_sky: Root mean square residual of each turbidity and sun; NaN where all weights
            are 0.
        converged: Whether a further Newton step would change nothing.
        steps: Steps of the search.
        weighting: Static.
        prior: The one in use, on the coefficients at the lowest and the highest turbidity.
    """

    matrix: Float[Array, "5 2"]
    standard_error: Float[Array, "5 2"]
    robust_standard_error: Float[Array, "5 2"]
    covariance: Float[Array, "10 10"]
    condition_number: Float[Array, ""]
    rms: Float[Array, ""]
    largest: Float[Array, ""]
    rms_per_sky: Float[Array, "turbidity sun"]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]
    weighting: str = eqx.field(static=True, default="relative")
    prior: PerezPrior = DEFAULT_PRIOR

    def coefficients(self, turbidity: RealsLike) -> Reals:
        """A, B, C, D, E at a turbidity of any shape, on a last axis of 5."""
        T = jnp.asarray(turbidity, self.matrix.dtype)[..., None]
        shape = (*T.shape[:-1], 5)
        slope = jnp.broadcast_to(self.matrix[:, 0], shape)
        return slope * T + jnp.broadcast_to(self.matrix[:, 1], shape)


def fit_distribution(
    directions: Directions | DirectionGrid,
    solar_zenith_angle: RealsLike,
    turbidity: RealsLike,
    values: RealsLike,
    *,
    zenith_value: RealsLike | None = None,
    weight: RealsLike | None = None,
    weighting: str = "relative",
    prior: PerezPrior = DEFAULT_PRIOR,
    max_steps: int = MAX_STEPS,
) -> DistributionFit:
    """The paper's joint fit: value / zenith value = F(θ, γ) / F(0, θ_sun), A..E linear in T.

    B and D stay negative and 1 + A exp(B) positive at the ends of the turbidities, by the same
    free parameters as in `fit_perez`, there.

    Args:
        directions: Of every sky.
        solar_zenith_angle: θ_sun, 0 to pi/2, shape [sun] [rad].
        turbidity: T, at least two different values, shape [turbidity].
        values: Shape [turbidity, sun, direction axes], any unit; positive unless weighting is
            "absolute".
        zenith_value: Shape [turbidity, sun]. None: the value in the direction at the zenith.
        weight: Of each squared residual, at least 0, the shape of the values. Where it is 0 a
            direction is left out: of the loss, rms, largest residual and standard errors. Only
            ratios of weights matter. None: equal.
        weighting: Of the ratios: "relative", "absolute" or "log", see `weighting.measure`.
        prior: What decides where data leave a parameter open.
        max_steps: Steps allowed.

    Returns:
        The fit, whose `converged` tells whether it may be used.

    Raises:
        ValueError: Empty, non-finite or non-positive data, shapes or angles that do not fit, no
            direction at the zenith, a single turbidity, or weights that are negative or all 0.

    References:
        Preetham et al. (1999), section 3.2 and appendix A.2.
    """
    problem = checked_problem(
        directions, solar_zenith_angle, turbidity, values, zenith_value, weight, weighting, prior
    )
    return DistributionFit(
        **_fit_table(problem, max_steps), weighting=weighting, prior=prior.fresh()
    )


def checked_problem(
    directions: Directions | DirectionGrid,
    solar_zenith_angle: RealsLike,
    turbidity: RealsLike,
    values: RealsLike,
    zenith_value: RealsLike | None,
    weight: RealsLike | None,
    weighting: str,
    prior: PerezPrior,
) -> "RatioProblem":
    """The problem of `fit_distribution`, whose arguments and errors these are."""
    choice("weighting", weighting, weights.WEIGHTINGS)
    data = weights.checked_values("values", values, weighting)
    view, azimuth = direction_angles(directions, data.dtype)
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    T = in_range("turbidity", turbidity, -np.inf, np.inf)
    if sun.ndim != 1 or T.ndim != 1 or data.shape != T.shape + sun.shape + directions.shape:
        raise ValueError(
            "values must have shape [turbidity, sun, direction axes] = "
            f"{T.shape + sun.shape + directions.shape}, got {data.shape}"
        )
    if not is_traced(T) and np.ptp(np.asarray(T)) == 0:
        raise ValueError(f"turbidity must hold two different values, got {np.unique(T)}")
    weight = weights.checked_weight(weight, data.shape, data.dtype)
    data, weight = (array.reshape(*T.shape, *sun.shape, -1) for array in (data, weight))
    if zenith_value is None:
        zenith = data[:, :, _zenith_index(view)]
    else:
        zenith = weights.checked_values("zenith_value", zenith_value, "relative")
        if zenith.shape != data.shape[:2]:
            raise ValueError(f"zenith_value must have shape {data.shape[:2]}, got {zenith.shape}")
    ratios = data / zenith[..., None]
    measure = weights.measure(ratios, weighting, weight=weight)
    sun, T = sun.astype(data.dtype), T.astype(data.dtype)
    return ratio_problem(view, azimuth, sun, T, ratios, weight, measure, prior.fresh())


def _zenith_index(view: Reals) -> int:
    if is_traced(view):
        raise TypeError("zenith_value is needed where view_zenith_angle is traced")
    known = np.asarray(view)
    lowest = int(known.argmin())
    if known[lowest] > 1e-6:
        raise ValueError(
            "directions must hold the zenith or zenith_value be given, got view_zenith_angle "
            f"from {known[lowest]:.6g} rad"
        )
    return lowest


class RatioProblem(eqx.Module):
    """A table of skies to be fitted by coefficients that are linear in turbidity.

    The ten parameters are those of the coefficients at the lowest turbidity, then at the highest,
    in widths of the prior. Number 0 is the only fit; it is asked for all the same, so that one
    search serves single skies and tables.

    Attributes:
        view, airmass: Of each direction.
        suns, turbidity: Of the table.
        upper: Share of the highest turbidity in each.
        γ, square: Angle from the sun and its squared cosine.
        ratios: Values over zenith values.
        share: Weight of each squared residual; their sum is 1.
        measure: Of the ratios.
        prior: Its strength is the search's ridge, at both ends.
    """

    view: Float[Array, " d"]
    airmass: Float[Array, " d"]
    suns: Float[Array, " sun"]
    turbidity: Float[Array, " turbidity"]
    upper: Float[Array, " turbidity"]
    γ: Float[Array, "sun d"]
    square: Float[Array, "sun d"]
    ratios: Float[Array, "turbidity sun d"]
    share: Float[Array, "turbidity sun d"]
    measure: weights.Measure
    prior: PerezPrior
    ends: int = eqx.field(static=True, default=2)
    lanes: int = eqx.field(static=True, default=2)  # whose tables fit in a processor's cache

    def coefficients(self, place: Reals) -> Float[Array, "2 5"]:
        """A..E at the lowest and the highest turbidity, from parameters."""
        return parameters.to_coefficients(self.prior.free(place.reshape(2, 5)))

    def mixed(self, ends: Float[Array, "2 5"]) -> Float[Array, "turbidity 5"]:
        """A..E at each turbidity from those at the ends."""
        return ends[0][None, :] * (1 - self.upper[:, None]) + ends[1][None, :] * self.upper[:, None]

    def derivatives(self, _: Int[Array, ""], place: Reals) -> least_squares.Derivatives:
        """Half the weighted mean squared residual, with gradient and Hessian."""

        def mixed(place: Reals) -> Reals:
            return self.mixed(self.coefficients(place))

        c = mixed(place)
        horizon = perez_loss.horizon_rows(c, self.airmass)
        sun = perez_loss.sun_rows(c[:, None, :], self.γ[None], self.square[None])
        # Toward the zenith the air mass is 1, and the angle from the sun is the sun's own.
        overhead = perez_loss.horizon_rows(c, jnp.ones_like(self.suns[:1]))
        squares = jnp.cos(self.suns) ** 2
        apart = perez_loss.sun_rows(c, self.suns[None, :], squares[None, :])
        unit = self.measure.unit

        def of_sky(h: Reals, g: Reals, up: Reals, away: Reals, *data: Reals) -> tuple:
            zenith, first, second = perez_loss.formula_derivatives(up, away)
            scale = 1 / zenith
            slope = -(scale**2) * first
            bend = -(scale**2) * second + 2 * scale**3 * jnp.outer(first, first)
            values, unit, share = data
            measure = weights.Measure(unit, self.measure.log)
            all_six = perez_loss.sky_loss(h, g, scale, values, measure, share)
            return perez_loss.with_given_scale(*all_six, slope, bend)

        of_suns = jax.vmap(of_sky, in_axes=(None, 0, None, 1, 0, 0, 0))
        value, gradient, hessian = jax.vmap(of_suns)(
            horizon, sun, overhead[..., 0], apart, self.ratios, unit, self.share
        )
        gradient, hessian = jnp.sum(gradient, axis=1), jnp.sum(hessian, axis=1)
        return jnp.sum(value), *parameters.pull_back(mixed, place, gradient, hessian)

    def residuals(self, ends: Float[Array, "2 5"]) -> Float[Array, "turbidity sun d"]:
        """Residuals, not weighted."""
        c = self.mixed(ends)[:, None, :]
        zenith = perez_formula(c, jnp.zeros_like(self.suns)[None, :], self.suns[None, :])
        shape = perez_formula(c[:, :, None, :], self.view[None, None, :], self.γ[None])
        return self.measure.misfit(shape / zenith[..., None], self.ratios)

    def known(self, _: Int[Array, ""], place: Reals) -> tuple[Reals, Uncertainty]:
        """A..E at the lowest, then at the highest turbidity, with their uncertainty."""
        published = self.coefficients(place).ravel()
        return published, self.uncertainty(lambda p: p.reshape(2, 5), published)

    def uncertainty(self, to_ends: Callable[[Reals], Reals], published: Reals) -> Uncertainty:
        """Uncertainty of any parameters from which the coefficients at both ends follow."""

        def of_data(p: Reals) -> Reals:
            return (self.residuals(to_ends(p)) * jnp.sqrt(self.share)).ravel()

        def of_prior(p: Reals) -> Reals:
            return self.prior.residuals(parameters.to_free(to_ends(p))).ravel()

        return uncertainty(
            of_data,
            of_prior,
            published,
            used=(self.share > 0).ravel(),
            clusters=self.turbidity.size * self.suns.size,
        )


@eqx.filter_jit
def ratio_problem(
    view: Reals,
    azimuth: Reals,
    suns: Reals,
    turbidity: Reals,
    ratios: Float[Array, "turbidity sun direction"],
    weight: Float[Array, "turbidity sun direction"],
    measure: weights.Measure,
    prior: PerezPrior,
) -> RatioProblem:
    """The problem of a table whose arguments were checked."""
    γ = scattering_angle(view[None, :], azimuth[None, :], suns[:, None])
    low, high = jnp.min(turbidity), jnp.max(turbidity)
    return RatioProblem(
        view=view,
        airmass=perez_loss.relative_airmass(view),
        suns=suns,
        turbidity=turbidity,
        upper=(turbidity - low) / (high - low),
        γ=γ,
        square=jnp.cos(γ) ** 2,
        ratios=ratios,
        share=weight / jnp.sum(weight),
        measure=measure,
        prior=prior,
    )


@eqx.filter_jit
def _fit_table(problem: RatioProblem, max_steps: int) -> dict[str, Array]:
    low, high = jnp.min(problem.turbidity), jnp.max(problem.turbidity)
    minimum = search(problem, 1, max_steps)
    ends = problem.coefficients(minimum.parameters[0])
    slope = (ends[1] - ends[0]) / (high - low)
    matrix = jnp.stack([slope, ends[0] - slope * low], axis=-1)

    def to_ends(p: Reals) -> Reals:
        rows = p.reshape(5, 2)
        return jnp.stack([rows[:, 0] * T + rows[:, 1] for T in (low, high)])

    known = problem.uncertainty(to_ends, matrix.ravel())
    residuals, weight = problem.residuals(ends), problem.share
    square = jnp.sum(weight * residuals**2, axis=-1)
    per_sky = jnp.sum(weight, axis=-1)
    return {
        "matrix": matrix,
        "standard_error": known.standard_error.reshape(5, 2),
        "robust_standard_error": known.robust_standard_error.reshape(5, 2),
        "covariance": known.covariance,
        "condition_number": known.condition_number,
        "rms": jnp.sqrt(jnp.sum(square)),
        "largest": jnp.max(jnp.where(weight > 0, jnp.abs(residuals), 0.0)),
        "rms_per_sky": jnp.sqrt(square / jnp.where(per_sky > 0, per_sky, jnp.nan)),
        "converged": minimum.converged[0],
        "steps": minimum.steps[0],
    }
