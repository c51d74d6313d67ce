"""Least squares for one parameter that is confined to an interval.

The parameter is x in [-1, 1], reached from a free variable by a sine. A scan finds the deepest
valley, since the curve of the squared residuals often has two; Levenberg-Marquardt goes to its
floor. Each of its steps takes forward derivatives only, and it ends where the step that remains
is a small part of the standard error, not where the last step was small.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from atmofit.numerics import chebyshev_basis, chebyshev_nodes, chebyshev_transform
from atmofit.typing import Reals, Scalar

_PLACES = 256  # where the interpolated residuals are compared
_OUTERMOST = 0.99  # start; at the very end of the interval the sine is flat
_PART = 1e-3  # of the standard error, that a converged search may still be away
_END = 1e-5  # so close to an end of the interval, the end itself is meant
_ROUNDING = 256.0  # units in the last place that the model may be off
_TYPICAL_SLOPE = 0.3  # of the logarithm of a model against x, so that the first steps are free
_UNDAMPED = 30.0  # the first damping of 1 is then 1e-3 relative

Residuals = Callable[[Scalar], Reals]


class Valley(eqx.Module):
    """Where a search ended, and what was known there.

    Attributes:
        place: x, -1 to 1.
        residuals: There.
        slope: Their derivatives with respect to x.
        curvature: Second derivative of half the sum of squares with respect to x.
    """

    place: Float[Array, ""]
    residuals: Float[Array, " n"]
    slope: Float[Array, " n"]
    curvature: Float[Array, ""]

    @property
    def gradient(self) -> Scalar:
        """Derivative of half the sum of squares with respect to x."""
        return jnp.dot(self.slope, self.residuals)

    @property
    def step(self) -> Scalar:
        """What a full Newton step would add to x, were there no interval."""
        size = jnp.abs(self.curvature)
        return -self.gradient / jnp.where(size > 0, size, 1.0)

    @property
    def at_end(self) -> Bool[Array, ""]:
        """Whether the minimum lies at an end of the interval or beyond."""
        return jnp.abs(self.place + self.step) >= 1 - _END

    def converged(self, rounding: Scalar) -> Bool[Array, ""]:
        """Whether what remains of the step inside the interval is negligible.

        It is if below 1e-3 of the standard error (times the rms residual where that is above 1)
        plus rounding, or below 1e-5 at an end of the interval.

        Args:
            rounding: Of the residuals, root of the sum of squares.
        """
        length = jnp.sqrt(jnp.sum(self.slope**2))
        inside = jnp.abs(jnp.clip(self.place + self.step, -1.0, 1.0) - self.place)
        rms = jnp.sqrt(jnp.mean(self.residuals**2))
        near = inside * length <= _PART * jnp.maximum(1.0, rms) + rounding
        at_end = (inside <= _END) & (1 - jnp.abs(self.place) <= _END)
        return (length > 0) & (near | at_end)


def scan(residuals: Residuals, count: int, start: Scalar) -> Scalar:
    """Place with the least sum of squares, among many places by interpolation, and a start.

    Args:
        residuals: From x; smooth enough for a polynomial through `count` nodes.
        count: Chebyshev nodes at which they are computed.
        start: Computed too.
    """
    dtype = start.dtype
    computed = jax.vmap(residuals)(jnp.append(jnp.asarray(chebyshev_nodes(count), dtype), start))
    places = jnp.asarray(np.linspace(-_OUTERMOST, _OUTERMOST, _PLACES), dtype)
    transform = jnp.asarray(chebyshev_transform(count), dtype)
    between = chebyshev_basis(places, count) @ (transform @ computed[:-1])
    loss = jnp.sum(jnp.concatenate([between, computed[-1:]]) ** 2, axis=1)
    loss = jnp.where(jnp.isfinite(loss), loss, jnp.inf)
    return jnp.append(places, start)[jnp.argmin(loss)]


def descend(
    residuals: Residuals,
    start: Scalar,
    weight: Scalar,
    precision: float,
    max_steps: int,
    exact: bool,
) -> tuple[Valley, Bool[Array, ""], Int[Array, ""]]:
    """Go down to the nearest minimum of the sum of squared residuals.

    Args:
        residuals: From x in [-1, 1], in units of their standard deviations.
        start: First x.
        weight: Root of the sum of the inverse squared noises, the size of the residuals if a
            model is off by its own size.
        precision: Relative rounding of the model.
        max_steps: Steps allowed, rejected ones too.
        exact: Whether the curvature includes the second derivatives of the residuals, without
            which the search can take a hundred steps where a model does not hold the data.

    Returns:
        The last accepted point, whether it is a minimum, and the steps.
    """
    scale = _UNDAMPED / (_TYPICAL_SLOPE * weight)
    rounding = _ROUNDING * precision * weight

    # Two rows with the same loss, gradient and curvature stand for all residuals; the solver
    # gets their derivative with them, in one pass.
    @jax.custom_jvp
    def rows(z: Scalar) -> tuple[Reals, Valley]:
        value, _, valley = _rows(residuals, z, scale, exact)
        return value, valley

    @rows.defjvp
    def _(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Any, Any]:
        value, slope, valley = _rows(residuals, primals[0], scale, exact)
        return (value, valley), (slope * tangents[0], jax.tree.map(jnp.zeros_like, valley))

    first = jnp.arcsin(jnp.clip(start, -_OUTERMOST, _OUTERMOST)) / scale
    found = optx.least_squares(
        lambda z, _: rows(z), _Descent(rounding=rounding), first, max_steps=max_steps, has_aux=True,
        throw=False,
    )  # fmt: skip
    valley = found.state.aux
    return valley, valley.converged(rounding), jnp.asarray(found.stats["num_steps"])


def _rows(
    residuals: Residuals, z: Scalar, scale: Scalar, exact: bool
) -> tuple[Float[Array, "2"], Float[Array, "2"], Valley]:
    """Two rows and their derivative for the solver, and what they stand for."""
    sine, cosine = jnp.sin(z * scale), jnp.cos(z * scale)
    one = jnp.ones_like(z)

    def with_slope(x: Scalar) -> tuple[Reals, Reals]:
        return jax.jvp(residuals, (x,), (one,))

    if exact:
        (value, slope), (_, bend) = jax.jvp(with_slope, (sine,), (one,))
        curvature = jnp.dot(slope, slope) + jnp.dot(value, bend)
    else:
        value, slope = with_slope(sine)
        curvature = jnp.dot(slope, slope)
    valley = Valley(sine, value, slope, curvature)
    tiny = float(jnp.finfo(z.dtype).tiny)
    loss = jnp.dot(value, value)
    gradient = valley.gradient * cosine * scale
    # Of the free variable; by its size, so that a step goes downhill, and never so small that a
    # step would promise more than the whole loss.
    curve = jnp.abs(cosine**2 * curvature - sine * valley.gradient) * scale**2
    curve = jnp.maximum(curve, gradient**2 / (loss + tiny)) + tiny
    root = jnp.sqrt(curve)
    rest = jnp.sqrt(jnp.maximum(loss - gradient**2 / curve, 0.0))
    return jnp.stack([gradient / root, rest]), jnp.stack([root, jnp.zeros_like(root)]), valley


class _Descent(optx.AbstractGaussNewton):
    """Levenberg-Marquardt that ends where the remaining step is negligible."""

    rounding: Float[Array, ""]
    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable[..., Any] = optx.max_norm
    descent: Any = optx.DampedNewtonDescent()
    search: Any = optx.ClassicalTrustRegion()
    verbose: Callable[..., None] = eqx.field(static=True, default=lambda **_: None)

    def terminate(
        self, fn: Any, y: Scalar, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Bool[Array, ""], Any]:
        """Whether to end; nothing has been computed before the first step."""
        return state.aux.converged(self.rounding) & ~state.first_step, state.result
