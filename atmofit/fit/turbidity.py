"""Turbidity, and what else a sky tells of the air, from a measured sky."""

import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import in_range
from atmofit.fit import few_parameters
from atmofit.fit.candidates import AnalyticSky, Model, Sky, name_of, skies
from atmofit.fit.few_parameters import Valley
from atmofit.fit.model_error import ModelError, stored_model_error
from atmofit.fit.sky_loss import SkyLoss, sky_loss
from atmofit.fit.unknowns import Search, make_search
from atmofit.observe.observation import Observation
from atmofit.typing import Reals, RealsLike, Scalar

MAX_STEPS = 40
_TWO_SIDED_95 = 1.959964  # of the normal distribution
_SCAN_ANALYTIC, _SCAN_SIMULATED = 48, 12  # nodes in log T; they follow log luminance to 0.4 %
_ROUNDS = 4  # of robust weights
_UNIFORM = 3.0  # inverse variance of x, spread evenly over [-1, 1]
_HARDLY = 0.7  # of what was known before, that the uncertainty still is


class TurbidityEstimate(eqx.Module):
    """A turbidity, other unknowns that were searched for with it, and what they are worth.

    The standard error is that of the noise and, if it was given, of the model error. Without it,
    a model that does not hold the sky shifts the estimate by an amount that no standard error
    shows; `reduced_chi_square` far above 1 tells that it does not, and `scaled_by_residual` widens
    the interval accordingly.

    Attributes:
        value: Turbidity.
        standard_error: Of the value.
        parameters: Of all unknowns that were searched for, turbidity first.
        covariance: Of these.
        reduced_chi_square: Sum of the squared residuals in units of their noise, over their number
            less that of the unknowns; near 1 if the model holds the sky to within the noise.
        rms: Root mean square of ln(model / measured), exposure and model error taken out.
        log_ratio: Logarithm of model over measured, [direction axes, channel]; NaN where masked.
        explained: What of it exposure and model error explain, likewise.
        weight: Of each direction, 1 unless robust, [direction axes]; near 0: an outlier.
        converged: Whether the search ended at a minimum, in the range or at its end.
        at_edge: Whether turbidity's minimum lies at an end of the range or beyond; the true one may
            then be far beyond, and the standard error means nothing.
        at_edges: The same for each unknown.
        known_before: Standard deviation of each unknown before the sky was looked at: the prior's,
            or that of an even spread over the range.
        start_value: Turbidity where the search ended from each start.
        start_loss: Half the sum of squares there.
        steps: Steps of the searches.
        names: Of the unknowns. Static.
        model: Its name. Static.
        turbidity_range: That was searched. Static.
    """

    value: Float[Array, ""]
    standard_error: Float[Array, ""]
    parameters: Float[Array, " p"]
    covariance: Float[Array, "p p"]
    reduced_chi_square: Float[Array, ""]
    rms: Float[Array, ""]
    log_ratio: Float[Array, "*direction channel"]
    explained: Float[Array, "*direction channel"]
    weight: Float[Array, "*direction"]
    converged: Bool[Array, ""]
    at_edge: Bool[Array, ""]
    at_edges: Bool[Array, " p"]
    known_before: Float[Array, " p"]
    start_value: Float[Array, " start"]
    start_loss: Float[Array, " start"]
    steps: Int[Array, ""]
    names: tuple[str, ...] = eqx.field(static=True)
    model: str = eqx.field(static=True)
    turbidity_range: tuple[float, float] = eqx.field(static=True)

    @property
    def interval(self) -> Float[Array, "2"]:
        """Lower and upper end of the 95 % interval; it may reach beyond the range."""
        half = _TWO_SIDED_95 * self.standard_error
        return jnp.stack([self.value - half, self.value + half])

    @property
    def standard_errors(self) -> Float[Array, " p"]:
        """Of all unknowns."""
        return jnp.sqrt(jnp.diagonal(self.covariance))

    @property
    def untold(self) -> tuple[str, ...]:
        """Unknowns of which the sky told hardly anything beyond what was known before."""
        share = np.asarray(self.standard_errors / self.known_before)
        return tuple(name for name, s in zip(self.names, share, strict=True) if not s < _HARDLY)

    def scaled_by_residual(self) -> "TurbidityEstimate":
        """The same with errors times the root of the reduced chi-square, if above 1.

        Right if the noise was given too small; if it is the model that is wrong, residuals of
        neighbouring directions are alike, and even this interval is too narrow.
        """
        factor = jnp.maximum(1.0, self.reduced_chi_square)
        return eqx.tree_at(
            lambda e: (e.standard_error, e.covariance),
            self,
            replace=(self.standard_error * jnp.sqrt(factor), self.covariance * factor),
        )


def estimate_turbidity(
    observation: Observation,
    model: Model = "preetham",
    *,
    free: tuple[str, ...] = ("turbidity",),
    known: Mapping[str, RealsLike] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    turbidity_range: tuple[float, float] | None = None,
    model_error: ModelError | str | None = None,
    robust: bool = False,
    start: RealsLike | None = None,
    starts: int = 1,
    scan: bool = True,
    max_steps: int = MAX_STEPS,
) -> TurbidityEstimate:
    """Estimate turbidity, and other unknowns, from one sky.

    Least squares of ln(model / measured) / noise over the directions and channels, by
    Levenberg-Marquardt in free variables, with forward derivatives through the model. The sum of
    squares often has two minima (a clear sky can be as bright as a very hazy one), so a scan over
    turbidity chooses where the search begins. Works under vmap over a stack of observations.

    Args:
        observation: Luminances, colours or spectra; unknown exposures are found with the rest.
        model: "preetham", the published model of 1999; "simulator", `SimulatorModel()`: two orders
            of scattering in the paper's air; a `SimulatorModel`; or a fitted model such as
            `refit().model` or `ATMOFIT_2026`.
        free: Unknowns to search for beside turbidity, of those that the model has: for the
            continental air "angstrom_exponent", "single_scattering_albedo", "asymmetry",
            "scale_height" [m], "ozone_dobson", "albedo"; for a `SkyModel` "albedo"; for all
            "solar_zenith_angle" and "solar_azimuth" [rad], the sun's place relative to where the
            directions have it. Static.
        known: Values of the model's other unknowns by name, and starts of the free ones.
        prior: Mean and standard deviation of free unknowns, by name. Static.
        turbidity_range: Searched; inside the model's own range. None: all of it, 1 to 30 for the
            simulator. Static.
        model_error: What the model misses of real skies: a `ModelError`, or a name of
            `stored_model_error`. None: nothing; the interval then holds noise alone.
        robust: Directions that no smooth sky explains (clouds, masts) count less. Static.
        start: Candidate for the beginning of the search beside the scan; brought inside the range.
        starts: Searches, from the deepest valleys of the scan; the best end is kept. Static.
        scan: False: search from `start` alone, which may end in another minimum. Static.
        max_steps: Steps allowed. Static.

    Returns:
        The estimate; nothing is raised if the search fails, see `converged`. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: Impossible observation, unknown model or name, or a range outside the model's.

    References:
        Preetham, Shirley and Smits (1999), Computer Graphics Proceedings, for turbidity and model.
    """
    problem = turbidity_problem(
        observation, model, free, known, prior, turbidity_range, model_error, start
    )
    if max_steps < 1:
        raise ValueError(f"max_steps must be at least 1, got {max_steps}")
    in_range("starts", starts, 1.0, 32.0)
    if start is None and not scan:
        raise ValueError("start must be given where scan is False, got None")
    numbers = _estimate(
        problem.sky,
        problem.coarse if scan else None,
        problem.loss,
        robust=robust,
        starts=starts if scan else 1,
        max_steps=max_steps,
    )
    return TurbidityEstimate(
        **numbers,
        names=problem.loss.search.names,
        model=name_of(model),
        turbidity_range=problem.limits,
    )


class TurbidityProblem(eqx.Module):
    """What is searched, and in what.

    Attributes:
        sky: The model.
        coarse: What stands for it in a scan.
        loss: The data and the unknowns.
        limits: Of turbidity. Static.
    """

    sky: Sky
    coarse: Sky
    loss: SkyLoss
    limits: tuple[float, float] = eqx.field(static=True)


def turbidity_problem(
    observation: Observation,
    model: Model,
    free: tuple[str, ...],
    known: Mapping[str, RealsLike] | None,
    prior: Mapping[str, tuple[float, float]] | None,
    turbidity_range: tuple[float, float] | None,
    model_error: ModelError | str | None,
    start: RealsLike | None = None,
) -> TurbidityProblem:
    """Check the arguments of `estimate_turbidity`, and put the problem together."""
    dtype = jnp.result_type(float)
    observation = jax.tree.map(
        lambda leaf: leaf if leaf.dtype == bool else leaf.astype(dtype), observation.checked()
    )
    sky, coarse = skies(model, observation)
    limits = _limits(turbidity_range, sky.ranges["turbidity"])
    first = math.sqrt(limits[0] * limits[1]) if start is None else start
    first = in_range("start", first, -np.inf, np.inf)
    if first.ndim != 0:
        raise ValueError(f"start must be one number, got shape {first.shape}")
    values = dict(known or {})
    if "turbidity" in values:
        raise ValueError("known must not hold turbidity, which is searched for: use start")
    values |= {"turbidity": jnp.clip(first, *limits)}
    values = {"solar_zenith_angle": observation.solar_zenith_angle} | values
    search = make_search(
        tuple(free),
        sky.unknowns,
        ranges=sky.ranges | {"turbidity": limits},
        values=values,
        priors=dict(prior or {}),
        dtype=dtype,
    )
    error = stored_model_error(model_error) if isinstance(model_error, str) else model_error
    return TurbidityProblem(sky, coarse, sky_loss(observation, search, error), limits)


def _limits(asked: tuple[float, float] | None, valid: tuple[float, float]) -> tuple[float, float]:
    """The range that is searched."""
    low, high = valid if asked is None else (float(asked[0]), float(asked[1]))
    if not valid[0] <= low < high <= valid[1]:
        raise ValueError(
            f"turbidity_range must increase inside the model's {valid[0]:g} to {valid[1]:g}, "
            f"got ({low:g}, {high:g})"
        )
    return low, high


@eqx.filter_jit
def _estimate(
    sky: Sky,
    coarse: Sky | None,
    loss: SkyLoss,
    *,
    robust: bool,
    starts: int,
    max_steps: int,
) -> dict[str, Array]:
    """The jitted kernel: one sky, everything but the models' structure traced."""
    search, exact = loss.search, isinstance(sky, AnalyticSky)
    even = jnp.ones_like(loss.precision)
    begin = search.place(search.start)[None]
    if coarse is not None:
        nodes = _SCAN_ANALYTIC if isinstance(coarse, AnalyticSky) else _SCAN_SIMULATED
        begin = few_parameters.scan(loss.residuals(coarse, even), nodes, begin[0], starts)
    rounding = few_parameters.rounding_of(loss.weight, sky.precision)
    size = search.typical_slope * loss.weight

    def descend(place: Reals, share: Reals) -> tuple[Valley, Array, Array]:
        residuals = loss.residuals(sky, share)
        return few_parameters.descend(residuals, place, size, rounding, max_steps, exact)

    def again(_: Array, state: _Search) -> _Search:
        """Weights from where the last search ended, and a search with them."""
        place, _, steps, share = state
        share, _ = loss.robust_share(place, loss.log_ratio(sky, place), share)
        found, converged, more = descend(place, share)
        return found.place, converged, steps + more, share

    def search_from(place: Reals) -> tuple[Reals, Array, Array, Reals, Scalar]:
        if not robust:
            found, converged, steps = descend(place, even)
            return found.place, converged, steps, even, found.loss
        state = (place, jnp.asarray(False), jnp.asarray(0), even)
        place, converged, steps, share = jax.lax.fori_loop(0, _ROUNDS, again, state)
        _, depth = loss.robust_share(place, loss.log_ratio(sky, place), share)
        return place, converged, steps, share, depth

    ends = jax.vmap(search_from)(begin) if starts > 1 else _alone(search_from(begin[0]))
    depth = ends[4]
    best = jnp.argmin(jnp.where(jnp.isfinite(depth), depth, jnp.inf))
    place, converged, _, share, _ = jax.tree.map(lambda leaf: leaf[best], ends)
    found = few_parameters.look(loss.residuals(sky, share), place, exact)
    numbers = _worth(loss, search, found, share, loss.log_ratio(sky, place))
    return numbers | {
        "converged": converged,
        "start_value": jax.vmap(search.value)(ends[0])[:, 0],
        "start_loss": depth / 2,
        "steps": jnp.sum(ends[2]),
    }


_Search = tuple[Reals, Array, Array, Reals]  # place, converged, steps, share of the precision


def _alone(leaves: Any) -> Any:
    """The same with a first axis of one."""
    return jax.tree.map(lambda leaf: leaf[None], leaves)


def _worth(
    loss: SkyLoss, search: Search, found: Valley, share: Reals, log_ratio: Reals
) -> dict[str, Array]:
    """Values, errors and residuals at the end of a search."""
    observation = loss.observation
    value, slope = search.value(found.place), search.slope(found.place)
    informed = jnp.isfinite(search.prior_width)
    # Turbidity is left to the data alone; what else is searched for has its range for a prior.
    beyond = jnp.where(informed | (jnp.arange(value.size) == 0), 0.0, _UNIFORM)
    information = found.slope.T @ found.slope + jnp.diag(beyond)
    covariance = _inverse(information) * slope[:, None] * slope[None, :]
    explained = jnp.zeros_like(log_ratio)
    if loss.design.shape[1]:
        explained = loss.design @ loss.linear(found.place, log_ratio, share)
    used = loss.precision > 0
    left = jnp.where(used, log_ratio - explained, 0.0)
    finite = jnp.isfinite(found.loss)
    shape = observation.by_channel.shape

    def seen(values: Reals) -> Reals:
        return jnp.where(used, values, jnp.nan).reshape(shape)

    weight = (share**2).reshape(shape)[..., 0]
    evenly = (search.high - search.low) / math.sqrt(12)
    width = jnp.where(search.prior_width < jnp.inf, search.prior_width, evenly)
    return {
        "value": jnp.where(finite, value[0], jnp.nan),
        "standard_error": jnp.sqrt(covariance[0, 0]),
        "parameters": jnp.where(finite, value, jnp.nan),
        "covariance": covariance,
        "reduced_chi_square": found.loss / loss.freedom,
        "rms": jnp.sqrt(jnp.sum(left**2) / jnp.sum(used).astype(left.dtype)),
        "log_ratio": seen(log_ratio),
        "explained": seen(explained),
        "weight": jnp.where(observation.used, weight, 0.0),
        "at_edge": found.at_end[0],
        "at_edges": found.at_end,
        "known_before": jnp.where(informed & search.in_logarithm, width * value, width),
    }


def _inverse(information: Float[Array, "p p"]) -> Float[Array, "p p"]:
    """Of a symmetric matrix, in units in which its diagonal is 1."""
    tiny = float(jnp.finfo(information.dtype).tiny)
    unit = 1 / jnp.sqrt(jnp.maximum(jnp.diagonal(information), tiny))
    scaled = information * unit[:, None] * unit[None, :]
    return jnp.linalg.inv(scaled) * unit[:, None] * unit[None, :]
