"""Joint fits of a sky model's coefficients to many skies, channel by channel."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import angle_in_range, in_range
from atmofit.fit.single_sky import direction_angles
from atmofit.fit.weighting import checked_values
from atmofit.geometry import DirectionGrid, Directions, scattering_angle
from atmofit.models.dependence import Dependence
from atmofit.models.sky_model import AnyShape
from atmofit.typing import Reals, RealsLike, Scalar

MAX_STEPS = 250
STARTS = 6
PRIOR_STRENGTH = 5e-3
_SETTLED = 1e-4  # share of the loss that steps still remove; of the rms, half of it
_EXACT = 1e-12  # loss of a sky below which differences mean nothing: an rms of 1e-6
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e12


class SkyModelFit(eqx.Module):
    """Coefficients fitted to skies.

    Attributes:
        coefficients: Of each channel, as in `SkyModel`.
        standard_error: Of the coefficients; each sky is taken as one cluster whose residuals may
            be correlated in any way. It says how well the skies fix a coefficient, not how true
            the shape is.
        rms: Root mean square of log(model / value), of each channel.
        largest: Largest residual by size, of each channel.
        converged: Whether the last steps hardly changed the loss, of each channel.
        steps: Of each channel.
        start_loss: Where the search of the first channel ended from each start.
    """

    coefficients: Float[Array, "channel number basis"]
    standard_error: Float[Array, "channel number basis"]
    rms: Float[Array, " channel"]
    largest: Float[Array, " channel"]
    converged: Bool[Array, " channel"]
    steps: Int[Array, " channel"]
    start_loss: Float[Array, " start"]


def fit_sky_model(
    directions: Directions | DirectionGrid,
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    albedo: RealsLike,
    values: RealsLike,
    shape: AnyShape,
    dependence: Dependence,
    *,
    prior_strength: float = PRIOR_STRENGTH,
    starts: int = STARTS,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> SkyModelFit:
    """Fit log values of every sky at once by Levenberg-Marquardt on accumulated normal equations.

    The free numbers of each sky follow from the coefficients by the dependence's basis, so the
    normal matrix is a sum over skies of products of a small matrix of the shape and one of the
    basis; the Jacobian is never held. Each sky counts the same. A weak prior, one residual for
    each number of each sky, decides what the skies leave open. The first channel is searched for
    from several starts; the best end, moved to each channel's level, starts the others.

    Args:
        directions: Of every sky.
        turbidity: Of each sky, shape [sky].
        solar_zenith_angle: Of each sky, shape [sky] [rad].
        albedo: Of each sky's ground, shape [sky].
        values: Positive, shape [channel, sky, direction axes].
        shape: Of the model.
        dependence: Of the model.
        prior_strength: A number one width from its centre counts like a residual of this size in
            every direction of its sky.
        starts: At least 1; the first is the prior's centre, the others are drawn around it.
        seed: Of the drawn ones.
        max_steps: Steps allowed for each search.

    Returns:
        The fit in float64, whose `converged` tells which channels may be used.

    Raises:
        ValueError: Values that are not positive, shapes that do not fit, or arguments outside the
            dependence's ranges.
    """
    data = checked_values("values", values, "log")
    in_range("prior_strength", prior_strength, 0.0, 1.0)
    in_range("starts", starts, 1.0, 1e3)
    in_range("max_steps", max_steps, 1.0, 1e4)
    view, azimuth = direction_angles(directions, data.dtype)
    T = in_range("turbidity", turbidity, *dependence.turbidity_range)
    s = angle_in_range(
        "solar_zenith_angle", solar_zenith_angle, 0.0, float(np.radians(dependence.latest_sun_deg))
    )
    a = in_range("albedo", albedo, 0.0, dependence.largest_albedo)
    if not (T.ndim == 1 and T.shape == s.shape == a.shape):
        raise ValueError(
            "turbidity, solar_zenith_angle and albedo must be lists of one length, got shapes "
            f"{T.shape}, {s.shape} and {a.shape}"
        )
    if data.ndim != 2 + len(directions.shape) or data.shape[1:] != T.shape + directions.shape:
        raise ValueError(
            "values must have shape [channel, sky, direction axes] = "
            f"(channels, {', '.join(map(str, T.shape + directions.shape))}), got {data.shape}"
        )
    skies = _skies(shape, dependence, view, azimuth, *(x.astype(data.dtype) for x in (T, s, a)))
    logs = jnp.log(data.reshape(*data.shape[:2], -1))
    draws = np.random.default_rng(seed).normal(size=(starts, len(shape.names)))
    draws[0] = 0.0
    strength = jnp.asarray(prior_strength, data.dtype)
    return _fit(skies, logs, strength, jnp.asarray(0.5 * draws, data.dtype), max_steps)


class Skies(NamedTuple):
    """What does not depend on the channel.

    Attributes:
        shape: Of the model.
        basis: Of the dependence, at each sky.
        cosine: Of the view zenith angle of each direction.
        γ: Angle from the sun.
        centre, width: Of the prior, in each free number; centres for a level of 1.
        is_level: 1 for logarithms of amplitudes, else 0.
    """

    shape: AnyShape
    basis: Float[Array, "sky basis"]
    cosine: Float[Array, " d"]
    γ: Float[Array, "sky d"]
    centre: Float[Array, " n"]
    width: Float[Array, " n"]
    is_level: Float[Array, " n"]


def _skies(
    shape: AnyShape,
    dependence: Dependence,
    view: Reals,
    azimuth: Reals,
    T: Reals,
    s: Reals,
    a: Reals,
) -> Skies:
    free, dtype = shape.free_numbers, T.dtype
    return Skies(
        shape,
        jax.vmap(dependence)(T, s, a),
        jnp.cos(view),
        scattering_angle(view[None, :], azimuth[None, :], s[:, None]),
        jnp.asarray([f.centre for f in free], dtype),
        jnp.asarray([f.width for f in free], dtype),
        jnp.asarray([f.is_level for f in free], dtype),
    )


class _Loss(NamedTuple):
    """The loss of one channel, its gradient and its Gauss-Newton matrix."""

    value: Scalar
    gradient: Float[Array, " p"]
    matrix: Float[Array, "p p"]


class _State(NamedTuple):
    """A search."""

    place: Float[Array, "n basis"]
    at: _Loss
    damping: Scalar
    removed: Scalar  # share of the loss that accepted steps removed, the last ones most
    steps: Array


class _Channel(NamedTuple):
    """The problem of one channel."""

    skies: Skies
    logs: Float[Array, "sky d"]
    strength: Scalar

    def residuals(self, place: Float[Array, "n basis"]) -> tuple[Reals, Reals]:
        """Of each sky: of the data [sky, d], and of the prior [sky, n]."""
        numbers = jnp.matmul(self.skies.basis, place.T)
        logs = jax.vmap(self.log_model)(numbers, self.skies.γ)
        return logs - self.logs, self.strength * self._away(numbers)

    def log_model(self, numbers: Float[Array, " n"], γ: Float[Array, " d"]) -> Float[Array, " d"]:
        """Logarithm of one sky."""
        return jnp.log(self.skies.shape(numbers, self.skies.cosine, γ))

    def centres(self) -> Float[Array, "sky n"]:
        """Of the prior: amplitudes follow the level of each sky."""
        level = jnp.mean(self.logs, axis=1)
        return self.skies.centre[None, :] + level[:, None] * self.skies.is_level[None, :]

    def _away(self, numbers: Reals) -> Reals:
        return (numbers - self.centres()) / self.skies.width[None, :]

    def loss(self, place: Float[Array, "n basis"]) -> Scalar:
        """Half the mean squared residual of each sky, summed over skies, prior included."""
        data, prior = self.residuals(place)
        return 0.5 * jnp.sum(jnp.mean(data**2, axis=1)) + 0.5 * jnp.sum(prior**2)

    def normal_equations(self, place: Float[Array, "n basis"]) -> _Loss:
        """The loss with gradient and Gauss-Newton matrix."""
        gradients, matrices = self.by_sky(place)
        basis = self.skies.basis
        skies, count = basis.shape
        n = gradients.shape[1]
        gradient = jnp.matmul(gradients.T, basis)
        products = (basis[:, :, None] * basis[:, None, :]).reshape(skies, -1)
        blocks = jnp.matmul(matrices.reshape(skies, -1).T, products)
        matrix = blocks.reshape(n, n, count, count).transpose(0, 2, 1, 3)
        size = n * count
        return _Loss(self.loss(place), gradient.ravel(), matrix.reshape(size, size))

    def by_sky(self, place: Float[Array, "n basis"]) -> tuple[Reals, Reals]:
        """Gradient [sky, n] and matrix [sky, n, n] of each sky's loss by its free numbers."""
        numbers = jnp.matmul(self.skies.basis, place.T)
        data, prior = self.residuals(place)
        slope = self.strength / self.skies.width

        def of_sky(numbers: Reals, γ: Reals, data: Reals, prior: Reals) -> tuple[Reals, Reals]:
            J = jax.jacfwd(self.log_model)(numbers, γ) / np.sqrt(γ.size)
            gradient = jnp.matmul(data, J) / np.sqrt(γ.size) + slope * prior
            return gradient, jnp.matmul(J.T, J) + jnp.diag(slope**2)

        # In blocks: a Jacobian of all skies at once would be the largest array of the fit.
        return jax.lax.map(
            lambda sky: of_sky(*sky), (numbers, self.skies.γ, data, prior), batch_size=32
        )


@eqx.filter_jit
def _fit(
    skies: Skies,
    logs: Float[Array, "channel sky d"],
    strength: Scalar,
    draws: Float[Array, "start n"],
    max_steps: int,
) -> SkyModelFit:
    """The jitted kernel of `fit_sky_model`."""
    first = _Channel(skies, logs[0], strength)
    # The coefficients that come nearest to constant numbers, or to those of the prior.
    inverse = jnp.linalg.pinv(skies.basis)

    def start_of(channel: _Channel, draw: Float[Array, " n"]) -> Float[Array, "n basis"]:
        return jnp.matmul(inverse, channel.centres() + draw[None, :] * skies.width[None, :]).T

    def from_start(draw: Float[Array, " n"]) -> _State:
        return _search(first, start_of(first, draw), max_steps)

    ends = jax.lax.map(from_start, draws)
    losses = jnp.where(jnp.isfinite(ends.at.value), ends.at.value, jnp.inf)
    best = ends.place[jnp.argmin(losses)] - start_of(first, jnp.zeros_like(draws[0]))

    def of_channel(logs: Float[Array, "sky d"]) -> dict[str, Array]:
        channel = _Channel(skies, logs, strength)
        end = _search(channel, start_of(channel, jnp.zeros_like(draws[0])) + best, max_steps)
        data, _ = channel.residuals(end.place)
        return {
            "coefficients": end.place,
            "standard_error": _standard_error(channel, end),
            "rms": jnp.sqrt(jnp.mean(data**2)),
            "largest": jnp.max(jnp.abs(data)),
            "converged": _has_settled(channel, end),
            "steps": end.steps,
        }

    return SkyModelFit(**jax.lax.map(of_channel, logs), start_loss=losses)


def _search(channel: _Channel, start: Float[Array, "n basis"], max_steps: int) -> _State:
    """Levenberg-Marquardt: steps that raise the loss are not taken."""
    one = jnp.ones_like(channel.strength)

    def step(state: _State) -> _State:
        diagonal = jnp.diag(state.at.matrix)
        ridge = state.damping * diagonal + 1e-12 * jnp.max(diagonal)
        factor = jax.scipy.linalg.cho_factor(state.at.matrix + jnp.diag(ridge))
        move = jax.scipy.linalg.cho_solve(factor, state.at.gradient)
        trial = state.place - move.reshape(state.place.shape)
        loss = channel.loss(trial)
        better = loss < state.at.value  # False for NaN
        removed = 1 - loss / state.at.value
        place = jnp.where(better, trial, state.place)
        at = jax.lax.cond(better, channel.normal_equations, lambda _: state.at, place)
        return _State(
            place=place,
            at=at,
            damping=jnp.where(better, state.damping / 6, state.damping * 4),
            # One short step that removes little is no end yet: half of what came before stays.
            removed=jnp.where(better, (removed + state.removed) / 2, state.removed),
            steps=state.steps + 1,
        )

    def goes_on(state: _State) -> Array:
        moving = ~_has_settled(channel, state) & (state.damping < _LARGEST_DAMPING)
        return moving & (state.steps < max_steps)

    first = channel.normal_equations(start)
    begin = _State(start, first, _FIRST_DAMPING * one, one, jnp.asarray(0))
    return jax.lax.while_loop(goes_on, step, begin)


def _has_settled(channel: _Channel, state: _State) -> Bool[Array, ""]:
    """Whether further steps would hardly change the loss; False for NaN."""
    exact = state.at.value < _EXACT * channel.logs.shape[0]
    return (exact | (state.removed < _SETTLED)) & jnp.isfinite(state.at.value)


def _standard_error(channel: _Channel, end: _State) -> Float[Array, "n basis"]:
    """From the scatter of the skies' gradients around their sum, which is 0 at the minimum."""
    gradients, _ = channel.by_sky(end.place)
    basis = channel.skies.basis
    skies, count = basis.shape
    scores = (gradients[:, :, None] * basis[:, None, :]).reshape(skies, -1)
    diagonal = jnp.diag(end.at.matrix)
    factor = jax.scipy.linalg.cho_factor(end.at.matrix + jnp.diag(1e-12 * diagonal))
    moves = jax.scipy.linalg.cho_solve(factor, scores.T)
    return jnp.sqrt(jnp.sum(moves**2, axis=1)).reshape(gradients.shape[1], count)
