"""Turbidity, and what else a sky tells of the air, from a measured sky."""

import math
from typing import Any, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import in_range, is_traced
from atmofit.fit import few_parameters
from atmofit.fit.candidates import AnalyticSky, Model, Sky
from atmofit.fit.few_parameters import Valley
from atmofit.fit.problem import Sought, TurbidityProblem, turbidity_problem
from atmofit.fit.sky_loss import SkyLoss
from atmofit.fit.unknowns import Search
from atmofit.fit.words import parameter_lines
from atmofit.observe.observation import Observation
from atmofit.typing import Reals, Scalar

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
        predicted_spread: Standard deviation, as the posterior has it, of another measurement's
            log_ratio - explained: of noise, model error and all unknowns together, likewise.
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
    predicted_spread: Float[Array, "*direction channel"]
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
    def standardised(self) -> Float[Array, "*direction channel"]:
        """What is left, in units of the predicted spread: far beyond 3, the model misses it."""
        return (self.log_ratio - self.explained) / self.predicted_spread

    @property
    def untold(self) -> tuple[str, ...]:
        """Unknowns of which the sky told hardly anything beyond what was known before."""
        share = np.asarray(self.standard_errors / self.known_before)
        return tuple(name for name, s in zip(self.names, share, strict=True) if not s < _HARDLY)

    def __str__(self) -> str:
        """Unknowns with their errors, and whether to trust them; of one sky."""
        if is_traced(self) or self.value.ndim:
            return repr(self)
        low, high = self.interval
        notes = np.where(self.at_edges, "(at an end of its range)", "")
        notes = [
            "(the sky tells nothing)" if n in self.untold else str(note)
            for n, note in zip(self.names, notes, strict=True)
        ]
        state = "" if self.converged else ", not converged"
        return "\n".join(
            [
                f"{self.model}, reduced chi-square {self.reduced_chi_square:.2f}{state}",
                *parameter_lines(self.names, self.parameters, self.standard_errors, notes),
                f"  95 % interval of turbidity {low:.4g} to {high:.4g}",
            ]
        )

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
    sky: Observation | TurbidityProblem,
    model: Model = "preetham",
    *,
    robust: bool = False,
    starts: int = 1,
    scan: bool = True,
    max_steps: int = MAX_STEPS,
    **sought: Unpack[Sought],
) -> TurbidityEstimate:
    """Estimate turbidity, and other unknowns, from one sky.

    Least squares of ln(model / measured) / noise over the directions and channels, by
    Levenberg-Marquardt in free variables, with forward derivatives through the model. The sum of
    squares often has two minima (a clear sky can be as bright as a very hazy one), so a scan over
    turbidity chooses where the search begins. Works under vmap over a stack of observations.

    Args:
        sky: An observation, of which `turbidity_problem` makes a problem with `model` and `sought`;
            or a problem, which has them already.
        model: Of the sky, as there.
        robust: Directions that no smooth sky explains (clouds, masts) count less. Static.
        starts: Searches, from the deepest valleys of the scan; the best end is kept. Static.
        scan: False: search from `start` alone, which may end in another minimum. Static.
        max_steps: Steps allowed. Static.
        **sought: free, known, prior, turbidity_range, model_error and start, see `Sought`.

    Returns:
        The estimate; nothing is raised if the search fails, see `converged`. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: As `turbidity_problem`; no start without a scan.
    """
    if isinstance(sky, TurbidityProblem):
        if sought:
            raise ValueError(f"{', '.join(sought)} must be given where the problem is made")
        problem = sky
    else:
        problem = turbidity_problem(sky, model, **sought)
    if max_steps < 1:
        raise ValueError(f"max_steps must be at least 1, got {max_steps}")
    in_range("starts", starts, 1.0, 32.0)
    if not (problem.has_start or scan):
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
        model=problem.model,
        turbidity_range=problem.limits,
    )


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
    inverse = _inverse(information)
    covariance = inverse * slope[:, None] * slope[None, :]
    by_value = found.slope[: log_ratio.size]
    leverage = jnp.sum((by_value @ inverse) * by_value, axis=1)
    explained = jnp.zeros_like(log_ratio)
    if loss.design.shape[1]:
        explained = loss.design @ loss.linear(found.place, log_ratio, share)
        leverage += jnp.sum(loss.projection(share)[0][: log_ratio.size] ** 2, axis=1)
    used = loss.precision > 0
    noise = 1 / jnp.where(used, loss.precision, 1.0)
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
        "predicted_spread": seen(noise * jnp.sqrt(1 + leverage / share**2)),
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
