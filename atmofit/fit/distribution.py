"""The paper's joint fit of the Perez formula, over suns and turbidities."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.fit import least_squares, parameters
from atmofit.fit import weighting as weights
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.single_sky import (
    DEFAULT_PRIOR,
    MAX_STEPS,
    direction_angles,
    search,
)
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.perez import perez_formula
from atmofit.typing import Reals, RealsLike, Scalar


class DistributionFit(eqx.Module):
    """Perez coefficients that are linear in turbidity, fitted to all skies of a table at once.

    Attributes:
        matrix: A..E as rows, slope in T and intercept as columns, like the paper's.
        standard_error: Of the matrix; see `least_squares.uncertainty` for what it means.
        covariance: Of the matrix row by row (A slope, A intercept, B slope, ...).
        condition_number: Of the data's Jacobian, columns scaled to unit length.
        rms: Root mean square residual over all data, in the measure of the weighting.
        largest: Largest residual by size.
        rms_per_sky: Root mean square residual of each turbidity and sun.
        converged: Whether a further Newton step would change nothing.
        steps: Steps of the search.
        weighting: Static.
        prior: The one in use, on the coefficients at the lowest and the highest turbidity.
    """

    matrix: Float[Array, "5 2"]
    standard_error: Float[Array, "5 2"]
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
        weighting: Of the ratios: "relative", "absolute" or "log", see `weighting.measure`.
        prior: What decides where data leave a parameter open.
        max_steps: Steps allowed.

    Returns:
        The fit, whose `converged` tells whether it may be used.

    Raises:
        ValueError: Empty, non-finite or non-positive data, shapes or angles that do not fit, no
            direction at the zenith, or a single turbidity.

    References:
        Preetham et al. (1999), section 3.2 and appendix A.2.
    """
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
    data = data.reshape(*T.shape, *sun.shape, -1)
    if zenith_value is None:
        zenith = data[:, :, _zenith_index(view)]
    else:
        zenith = weights.checked_values("zenith_value", zenith_value, "relative")
        if zenith.shape != data.shape[:2]:
            raise ValueError(f"zenith_value must have shape {data.shape[:2]}, got {zenith.shape}")
    ratios = data / zenith[..., None]
    measure = weights.measure(ratios, weighting)
    sun, T = sun.astype(data.dtype), T.astype(data.dtype)
    arrays = _fit_table(view, azimuth, sun, T, ratios, measure, prior, max_steps)
    return DistributionFit(**arrays, weighting=weighting, prior=prior)


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


@eqx.filter_jit
def _fit_table(
    view: Reals,
    azimuth: Reals,
    suns: Reals,
    turbidity: Reals,
    ratios: Float[Array, "turbidity sun direction"],
    measure: weights.Measure,
    prior: PerezPrior,
    max_steps: int,
) -> dict[str, Array]:
    γ = scattering_angle(view[None, :], azimuth[None, :], suns[:, None])
    low, high = jnp.min(turbidity), jnp.max(turbidity)
    upper = (turbidity - low) / (high - low)
    share = 1 / np.sqrt(ratios.size)

    def shape(coefficients: Float[Array, "turbidity 5"]) -> Float[Array, "turbidity sun direction"]:
        c = coefficients[:, None, :]
        at_zenith = perez_formula(c, jnp.zeros_like(suns)[None, :], suns[None, :])
        return perez_formula(c[:, :, None, :], view[None, None, :], γ[None]) / at_zenith[..., None]

    def of_ends(ends: Float[Array, "2 5"]) -> Float[Array, "turbidity sun direction"]:
        mix = ends[0][None, :] * (1 - upper[:, None]) + ends[1][None, :] * upper[:, None]
        return measure.misfit(shape(mix), ratios)

    def of_all(free: Reals) -> Reals:
        ends = free.reshape(2, 5)
        residuals = of_ends(parameters.to_coefficients(ends)) * share
        return jnp.append(residuals.ravel(), prior.residuals(ends).ravel())

    minimum = search(of_all, view.dtype, 2, max_steps, starts=1)
    ends = parameters.to_coefficients(minimum.parameters.reshape(2, 5))
    slope = (ends[1] - ends[0]) / (high - low)
    matrix = jnp.stack([slope, ends[0] - slope * low], axis=-1)
    residuals = of_ends(ends)

    def at(p: Reals, T: Scalar) -> Reals:
        return p.reshape(5, 2)[:, 0] * T + p.reshape(5, 2)[:, 1]

    def of_published(p: Reals) -> Reals:
        return of_ends(jnp.stack([at(p, low), at(p, high)])).ravel() * share

    def of_prior(p: Reals) -> Reals:
        return prior.residuals(parameters.to_free(jnp.stack([at(p, low), at(p, high)]))).ravel()

    known = least_squares.uncertainty(of_published, of_prior, matrix.ravel())
    return {
        "matrix": matrix,
        "standard_error": known.standard_error.reshape(5, 2),
        "covariance": known.covariance,
        "condition_number": known.condition_number,
        "rms": jnp.sqrt(jnp.mean(residuals**2)),
        "largest": jnp.max(jnp.abs(residuals)),
        "rms_per_sky": jnp.sqrt(jnp.mean(residuals**2, axis=-1)),
        "converged": minimum.converged,
        "steps": minimum.steps,
    }
