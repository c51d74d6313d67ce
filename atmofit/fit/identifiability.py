"""How far data determine a fit: searches from many starts, the weakest direction, profiles."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from atmofit.checks import is_traced
from atmofit.fit import distribution, least_squares, parameters, single_sky
from atmofit.fit.distribution import RatioProblem
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.profile_likelihood import CHI_SQUARE, Profile, both_sides, profiles
from atmofit.fit.single_sky import DEFAULT_PRIOR, MAX_STEPS, SkyProblem
from atmofit.fit.zenith import ZenithFit
from atmofit.geometry import DirectionGrid, Directions
from atmofit.typing import Reals, RealsLike

GOOD = 1.01  # largest loss of a good end, relative to the lowest


class Identifiability(eqx.Module):
    """How far data determine fits; `...` are the axes of the fits, none for a joint fit.

    The parameters are those that users read: A..E and the scale of a sky; A..E at the lowest and
    at the highest turbidity of a table; the coefficients of a zenith form. All figures but the
    profiles' rise take residuals in the measure of the weighting.

    Attributes:
        names: Of the parameters. Static.
        estimate: Parameters at the lowest loss found.
        standard_error: Of them, residuals taken as independent.
        relative_loss: End of the search from each start over the lowest loss of all searches; 1
            is the best, NaN where a search ran into no number.
        good: Whether the search from a start converged to a loss within 1 % of the lowest.
        straight: The same for the path of a search that goes straight from its start.
        default: The relative loss of the fit that `fit_perez` or `fit_distribution` makes.
        condition_number: Of the data's Jacobian, columns scaled to unit length.
        column_norm: Root mean square change of the residuals by each parameter alone, per unit.
        weakest_direction: Unit vector over the parameters, each in units of 1 / column_norm,
            along which the residuals change least.
        weakest_change: Root mean square change of the residuals along it, per unit; 1 for a
            parameter alone.
        inflation: Standard error of each parameter over what it would be with all others known.
        spread: Standard error of the free parameters that belong to A..E (`fit.parameters`), in
            widths of their prior: the share of what is thought possible that data leave open.
            For a zenith form, the inflation.
        profile: Of the two parameters with the largest spread, the larger first.
        linear: Whether the fit has no start, but a closed solution. Static.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    estimate: Float[Array, "*fit p"]
    standard_error: Float[Array, "*fit p"]
    relative_loss: Float[Array, "*fit start"]
    good: Bool[Array, "*fit start"]
    straight: Bool[Array, "*fit start"]
    default: Float[Array, "*fit"]
    condition_number: Float[Array, "*fit"]
    column_norm: Float[Array, "*fit p"]
    weakest_direction: Float[Array, "*fit p"]
    weakest_change: Float[Array, "*fit"]
    inflation: Float[Array, "*fit p"]
    spread: Float[Array, "*fit q"]
    profile: Profile
    linear: bool = eqx.field(static=True, default=False)


def identify_distribution(
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
    starts: int = 64,
    seed: int = 0,
) -> Identifiability:
    """How far a table of skies determines its joint fit.

    Args:
        directions: This and all that follows as in `fit_distribution`.
        solar_zenith_angle: [rad].
        turbidity: T.
        values: Shape [turbidity, sun, direction axes].
        zenith_value: Shape [turbidity, sun].
        weight: Of each squared residual.
        weighting: Of the ratios.
        prior: What decides where data leave a parameter open.
        max_steps: Steps allowed along each path of a search.
        starts: Random starts, drawn anew at both ends of the turbidities, see
            `parameters.random_starts`.
        seed: Of the draws.

    Returns:
        Arrays without axes of fits; ten parameters.

    Raises:
        ValueError: As `fit_distribution`, or no starts.
    """
    problem = distribution.checked_problem(
        directions, solar_zenith_angle, turbidity, values, zenith_value, weight, weighting, prior
    )
    traced = is_traced(problem.turbidity)
    ends = (
        ("low T", "high T")
        if traced
        else [f"T={float(T):g}" for T in (problem.turbidity.min(), problem.turbidity.max())]
    )
    names = tuple(f"{name} at {end}" for end in ends for name in parameters.NAMES)
    found = _identify(problem, _places(problem, starts, seed), 1, max_steps)
    return Identifiability(names=names, **jax.tree.map(lambda leaf: leaf[0], found))


def identify_perez(
    directions: Directions | DirectionGrid,
    solar_zenith_angle: RealsLike,
    values: RealsLike,
    *,
    weighting: str = "relative",
    fit_scale: bool = True,
    prior: PerezPrior = DEFAULT_PRIOR,
    max_steps: int = MAX_STEPS,
    starts: int = 64,
    seed: int = 0,
) -> Identifiability:
    """How far skies determine their own fits, each by itself.

    Args:
        directions: This and all that follows as in `fit_perez`.
        solar_zenith_angle: [rad].
        values: Shape [..., direction axes].
        weighting: Of the values.
        fit_scale: Whether the scale is fitted.
        prior: What decides where data leave a parameter open.
        max_steps: Steps allowed along each path of a search.
        starts: Random starts, the same for every sky, see `parameters.random_starts`.
        seed: Of the draws.

    Returns:
        Arrays with the axes of the skies; A..E and the scale, if it is fitted.

    Raises:
        ValueError: As `fit_perez`, or no starts.
    """
    problem, unit, skies = single_sky.checked_problem(
        directions, solar_zenith_angle, values, weighting, fit_scale, prior
    )
    found = _identify(problem, _places(problem, starts, seed), unit.size, max_steps)
    found = jax.tree.map(lambda leaf: leaf.reshape(skies + leaf.shape[1:]), found)
    result = Identifiability(names=problem.names(), **found)
    if not fit_scale:
        return result
    units = jnp.append(jnp.ones((*skies, 5), unit.dtype), unit.reshape(*skies, 1), axis=-1)
    return eqx.tree_at(
        lambda r: (r.estimate, r.standard_error, r.column_norm),
        result,
        (result.estimate * units, result.standard_error * units, result.column_norm / units),
    )


def identify_zenith(fit: ZenithFit) -> Identifiability:
    """How far a table determines the coefficients of a zenith form, which are linear.

    There is nothing to search and the loss is a parabola, so this says in the same words what the
    fit knows already; the one "start" is the closed solution.

    Args:
        fit: From `fit_zenith_luminance` or `fit_zenith_chromaticity`.

    Returns:
        Arrays without axes of fits; a, b, c, d or the twelve coefficients row by row.
    """
    fit = jax.tree.map(jnp.asarray, fit)  # of a result that was stored as NumPy arrays
    estimate, error = fit.coefficients.ravel(), fit.standard_error.ravel()
    names = ("a", "b", "c", "d")
    if estimate.size == 12:
        powers = [f"{t}{s}" for t in ("T²", "T", "") for s in ("s³", "s²", "s", "")]
        names = tuple(power or "1" for power in powers)
    noise = fit.rms * np.sqrt(fit.residuals.size / max(fit.residuals.size - estimate.size, 1))
    inflation = error * fit.column_norm * np.sqrt(fit.residuals.size) / noise
    weakest = jnp.argsort(-inflation)[:2]
    offsets = jnp.asarray(both_sides(), estimate.dtype)
    centre, width = estimate[weakest], error[weakest]
    reach = width * CHI_SQUARE**0.5
    one = jnp.ones(1, estimate.dtype)
    return Identifiability(
        names=names,
        estimate=estimate,
        standard_error=error,
        relative_loss=one,
        good=one > 0,
        straight=one > 0,
        default=one[0],
        condition_number=fit.condition_number,
        column_norm=fit.column_norm,
        weakest_direction=fit.weakest_direction,
        weakest_change=fit.weakest_change,
        inflation=inflation,
        spread=inflation,
        profile=Profile(
            parameter=weakest,
            value=centre[:, None] + width[:, None] * offsets[None, :],
            rise=jnp.broadcast_to(offsets**2, (2, offsets.size)),
            lower=centre - reach,
            upper=centre + reach,
        ),
        linear=True,
    )


def _places(problem: SkyProblem | RatioProblem, starts: int, seed: int) -> Float[Array, "start p"]:
    if starts < 1:
        raise ValueError(f"starts must be at least 1, got {starts}")
    free = parameters.random_starts(starts, problem.ends, seed)
    free = jnp.asarray(free, jnp.result_type(float))
    return problem.prior.place(free).reshape(starts, -1)


@eqx.filter_jit
def _identify(
    problem: SkyProblem | RatioProblem, places: Float[Array, "start p"], fits: int, max_steps: int
) -> dict[str, Array | Profile]:
    """What `Identifiability` holds, with an axis of fits."""
    dtype, count = places.dtype, places.shape[0] + 1
    every = jnp.broadcast_to(places[None], (fits, *places.shape))
    begin = jnp.concatenate([every, single_sky.best_candidates(problem, fits)[:, None]], axis=1)
    ends = least_squares.minimise(
        lambda search, place: problem.derivatives(search // count, place),
        begin.reshape(fits * count, -1),
        parameters.paths(problem.prior, problem.ends, dtype),
        max_steps,
        problem.lanes,
    )
    ends = jax.tree.map(lambda leaf: leaf.reshape(fits, count, *leaf.shape[1:]), ends)
    loss = jnp.where(ends.converged, ends.loss, jnp.inf)
    lowest = jnp.min(loss, axis=1, keepdims=True)
    bound = GOOD * lowest + least_squares.resolution(dtype)
    relative = ends.loss / lowest
    best = ends.parameters[jnp.arange(fits), jnp.argmin(loss, axis=1)]
    estimate, known = jax.vmap(problem.known)(jnp.arange(fits), best)
    noise = jnp.sqrt(known.variance)[:, None]
    spread = jax.vmap(lambda place, known: _spread(problem, place, known))(best, known.covariance)
    _, weakest = jax.lax.top_k(spread, 2)
    return {
        "estimate": estimate,
        "standard_error": known.standard_error,
        "relative_loss": relative[:, :-1],
        "good": (loss <= bound)[:, :-1],
        "straight": (ends.path_loss[..., 0] <= bound)[:, :-1],
        "default": relative[:, -1],
        "condition_number": known.condition_number,
        "column_norm": known.column_norm,
        "weakest_direction": known.weakest_direction,
        "weakest_change": known.weakest_change,
        "inflation": known.standard_error * known.column_norm / noise,
        "spread": spread,
        "profile": profiles(problem, best, lowest[:, 0], known, weakest, max_steps),
    }


def _spread(
    problem: SkyProblem | RatioProblem, place: Reals, covariance: Float[Array, "p p"]
) -> Float[Array, " q"]:
    """Standard errors of the search's parameters, which are in widths of the prior."""
    slope = jnp.linalg.inv(jax.jacfwd(lambda z: problem.coefficients(z).ravel())(place))
    size = slope.shape[0]
    return jnp.sqrt(jnp.sum((slope @ covariance[:size, :size]) * slope, axis=1))
