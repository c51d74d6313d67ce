"""Intervals that ask more than a parabola at the minimum: profile likelihood and sampling."""

import importlib.util
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.checks import in_range
from atmofit.fit import few_parameters
from atmofit.fit.candidates import Sky
from atmofit.fit.problem import TurbidityProblem
from atmofit.fit.profile_likelihood import crossing
from atmofit.fit.sky_loss import SkyLoss
from atmofit.fit.turbidity import MAX_STEPS, TurbidityEstimate
from atmofit.typing import Reals, Scalar

_REACH = 4.0  # standard errors on both sides of the best turbidity
_LEAST_REACH = 0.02  # of the range in x, should the standard error be tiny
_STEP = 0.5  # of the sampler, where the parabola at the minimum has a width of 1
_WEAK = 0.1  # inverse variance of a free variable that the sky says nothing of


class TurbidityProfile(eqx.Module):
    """The loss against turbidity, with all other unknowns at their best.

    Attributes:
        turbidity: Increasing; ends at four standard errors or at the range's ends.
        rise: Of the sum of squared residuals above its lowest; NaN where a search failed.
        lower: Where the rise reaches 3.84, the 95 % interval's end; -inf where it does not.
        upper: Likewise, inf.
        estimate: The best fit.
    """

    turbidity: Float[Array, " point"]
    rise: Float[Array, " point"]
    lower: Float[Array, ""]
    upper: Float[Array, ""]
    estimate: TurbidityEstimate


class TurbiditySamples(eqx.Module):
    """Draws from the posterior of turbidity and the other unknowns.

    Attributes:
        values: Of the unknowns, [chain, draw, unknown].
        effective_samples: Of each unknown, all chains together.
        r_hat: Spread of all chains over that inside them, near 1 if they have mixed.
        divergences: Draws at which the integration failed.
        gradients: Evaluations of the model with its slopes, warm-up left out.
        estimate: The best fit, around which the chains began.
        names: Of the unknowns. Static.
    """

    values: Float[Array, "chain draw p"]
    effective_samples: Float[Array, " p"]
    r_hat: Float[Array, " p"]
    divergences: Int[Array, ""]
    gradients: Int[Array, ""]
    estimate: TurbidityEstimate
    names: tuple[str, ...] = eqx.field(static=True)

    def interval(self, share: float = 0.95) -> Float[Array, "2 p"]:
        """Ends of the central interval that holds a share of the draws, of each unknown."""
        in_range("share", share, 0.0, 1.0)
        ends = jnp.asarray([(1 - share) / 2, (1 + share) / 2])
        return jnp.quantile(self.values.reshape(-1, len(self.names)), ends, axis=0)


def profile_turbidity(
    problem: TurbidityProblem,
    estimate: TurbidityEstimate,
    *,
    points: int = 17,
    max_steps: int = MAX_STEPS,
) -> TurbidityProfile:
    """Profile likelihood of turbidity.

    Args:
        problem: What was searched.
        estimate: Its best fit, whose weights are kept if it was robust.
        points: At which turbidity is held, an odd number from 5. Static.
        max_steps: Of the search at each point. Static.

    Raises:
        ValueError: Too few points, or an estimate of other unknowns.
    """
    in_range("points", points, 5.0, 1e3)
    best = _of_problem(problem, estimate)
    turbidity, rise = _profile(
        problem.sky, problem.loss, best.parameters, best.standard_error, best.weight, points,
        max_steps,
    )  # fmt: skip
    middle = points // 2
    return TurbidityProfile(
        turbidity=turbidity,
        rise=rise,
        lower=-crossing(-turbidity[middle::-1], rise[middle::-1]),
        upper=crossing(turbidity[middle:], rise[middle:]),
        estimate=best,
    )


def sample_turbidity(
    problem: TurbidityProblem,
    estimate: TurbidityEstimate,
    *,
    chains: int = 2,
    samples: int = 500,
    warmup: int = 50,
    seed: int = 0,
) -> TurbiditySamples:
    """Sample the posterior with the no-U-turn sampler.

    The density is that of the normal noise, with model error and exposures integrated out; before
    the sky was looked at, every unknown without a prior was spread evenly over its range, in
    logarithm where it is searched in even ratios. The chains run in variables in which the best
    fit's parabola is round, so that one length of step suits all; slopes go forward through the
    model.

    Args:
        problem: What was searched.
        estimate: Its best fit, whose weights are kept if it was robust.
        chains: Independent ones, at least 2. Static.
        samples: Of each chain. Static.
        warmup: Draws before them, in which the start is forgotten. Static.
        seed: Of the draws.

    Raises:
        ValueError: A count out of range, or an estimate of other unknowns.
        ImportError: blackjax is not installed (`pip install 'atmofit[bayes]'`).

    References:
        Hoffman and Gelman (2014), J. Mach. Learn. Res. 15, 1593, for the sampler.
    """
    if importlib.util.find_spec("blackjax") is None:
        raise ImportError("sampling needs blackjax: pip install 'atmofit[bayes]'")
    in_range("chains", chains, 2.0, 64.0)
    in_range("samples", samples, 10.0, 1e6)
    in_range("warmup", warmup, 0.0, 1e6)
    best = _of_problem(problem, estimate)
    values, divergent, gradients = _sample(
        problem.sky, problem.loss, best.parameters, best.weight, jax.random.key(seed), chains,
        samples, warmup,
    )  # fmt: skip
    effective, r_hat = _mixing(values)
    return TurbiditySamples(
        values=values,
        effective_samples=effective,
        r_hat=r_hat,
        divergences=divergent,
        gradients=gradients,
        estimate=best,
        names=best.names,
    )


def _of_problem(problem: TurbidityProblem, estimate: TurbidityEstimate) -> TurbidityEstimate:
    """The estimate, if it is of the problem's unknowns and directions."""
    asked = (problem.loss.search.names, problem.loss.observation.directions.shape)
    given = (estimate.names, estimate.weight.shape)
    if asked != given:
        raise ValueError(f"estimate must be of the problem's {asked}, got one of {given}")
    return estimate


def log_posterior(
    sky: Sky, loss: SkyLoss, share: Float[Array, " value"], u: Float[Array, " p"]
) -> tuple[Scalar, Reals, Reals]:
    """Log density of free variables u with its gradient, and the residuals' slopes by u.

    u goes over all numbers; x = 2 / (1 + exp(-u)) - 1.
    """
    up = jax.nn.sigmoid(u)
    found = few_parameters.look(loss.residuals(sky, share), 2 * up - 1, exact=False)
    bend = 2 * up * (1 - up)  # dx / du
    spread = jnp.sum(jax.nn.log_sigmoid(u) + jax.nn.log_sigmoid(-u))
    density = -0.5 * found.loss + spread
    return density, -found.gradient * bend + (1 - 2 * up), found.slope * bend[None, :]


def _value_share(loss: SkyLoss, weight: Reals) -> Float[Array, " value"]:
    """Root of each direction's weight, for each of its values."""
    channels = loss.observation.by_channel.shape[-1]
    return jnp.repeat(jnp.sqrt(weight.ravel()), channels).astype(loss.precision.dtype)


@eqx.filter_jit
def _profile(
    sky: Sky,
    loss: SkyLoss,
    best: Float[Array, " p"],
    error: Scalar,
    weight: Reals,
    points: int,
    max_steps: int,
) -> tuple[Reals, Reals]:
    """Turbidities and the rise of the loss."""
    search = loss.search
    share = _value_share(loss, weight)
    residuals = loss.residuals(sky, share)
    place = search.place(best)
    half = points // 2
    reach = jnp.maximum(_REACH * error / search.slope(place)[0], _LEAST_REACH)
    # The best one is among the points, and those on each side are even.
    below = jnp.linspace(jnp.maximum(place[0] - reach, -1.0), place[0], half + 1)
    above = jnp.linspace(place[0], jnp.minimum(place[0] + reach, 1.0), half + 1)
    first = jnp.concatenate([below, above[1:]])
    size = search.typical_slope[1:] * loss.weight
    rounding = few_parameters.rounding_of(loss.weight, sky.precision)

    def held(x: Scalar) -> Scalar:
        if place.size == 1:
            return jnp.sum(residuals(x[None]) ** 2)
        found, converged, _ = few_parameters.descend(
            lambda rest: residuals(jnp.concatenate([x[None], rest])),
            place[1:],
            size,
            rounding,
            max_steps,
            exact=False,
        )
        return jnp.where(converged, found.loss, jnp.nan)

    losses = jax.lax.map(held, first)
    turbidity = jax.vmap(lambda x: search.value(place.at[0].set(x))[0])(first)
    return turbidity, losses - jnp.nanmin(losses)


@eqx.filter_jit
def _sample(
    sky: Sky,
    loss: SkyLoss,
    best: Float[Array, " p"],
    weight: Reals,
    key: Array,
    chains: int,
    samples: int,
    warmup: int,
) -> tuple[Reals, Array, Array]:
    """Draws of all chains, divergences, and evaluations."""
    import blackjax

    sampler: Any = blackjax  # its types are too narrow
    search = loss.search
    share = _value_share(loss, weight)
    place = jnp.clip(search.place(best), -0.999, 0.999)
    centre = jnp.log1p(place) - jnp.log1p(-place)
    slope = log_posterior(sky, loss, share, centre)[2]
    size = best.size
    information = slope.T @ slope + _WEAK * jnp.eye(size, dtype=best.dtype)
    root = jnp.linalg.inv(jnp.linalg.cholesky(information)).T  # of the covariance

    @jax.custom_jvp
    def density(v: Reals) -> Scalar:
        return log_posterior(sky, loss, share, centre + root @ v)[0]

    @density.defjvp
    def _(primals: tuple[Reals], tangents: tuple[Reals]) -> tuple[Any, Any]:
        value, gradient, _ = log_posterior(sky, loss, share, centre + root @ primals[0])
        return value, jnp.dot(gradient, root @ tangents[0])

    kernel = sampler.nuts(density, step_size=_STEP, inverse_mass_matrix=jnp.ones(size, best.dtype))

    def chain(key: Array) -> tuple[Reals, Array, Array]:
        begin, run = jax.random.split(key)
        state = kernel.init(jax.random.normal(begin, (size,), best.dtype))

        def draw(state: Any, key: Array) -> tuple[Any, tuple[Reals, Array, Array]]:
            state, info = kernel.step(key, state)
            return state, (state.position, info.is_divergent, info.num_integration_steps)

        keys = jax.random.split(run, warmup + samples)
        _, drawn = jax.lax.scan(draw, state, keys)
        position, divergent, steps = jax.tree.map(lambda leaf: leaf[warmup:], drawn)
        return position, jnp.sum(divergent), jnp.sum(steps)

    positions, divergent, steps = jax.lax.map(chain, jax.random.split(key, chains))

    def value(v: Reals) -> Reals:
        return search.value(2 * jax.nn.sigmoid(centre + root @ v) - 1)

    return jax.vmap(jax.vmap(value))(positions), jnp.sum(divergent), jnp.sum(steps)


def _mixing(values: Float[Array, "chain draw p"]) -> tuple[Reals, Reals]:
    """Effective samples and R-hat of each unknown."""
    from blackjax.diagnostics import effective_sample_size, potential_scale_reduction

    return (
        jnp.asarray(np.asarray(effective_sample_size(values))),
        jnp.asarray(np.asarray(potential_scale_reduction(values))),
    )
