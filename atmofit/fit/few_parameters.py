"""Least squares for a few parameters, each confined to an interval.

Every parameter is x in [-1, 1], reached from a free variable by a sine. A scan along the first
finds the deepest valleys, since the curve of the squared residuals often has two;
Levenberg-Marquardt goes to their floors. Each of its steps takes forward derivatives only, and it
ends where the step that remains is a small part of the standard error, not where the last step was
small.
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
_UNDAMPED = 30.0  # the first damping of 1 is then 1e-3 relative

Residuals = Callable[[Float[Array, " p"]], Reals]


class Valley(eqx.Module):
    """Where a search ended, and what was known there.

    Attributes:
        place: x, each -1 to 1.
        residuals: There.
        slope: Their derivatives with respect to x.
        curvature: Second derivatives of half the sum of squares with respect to x.
    """

    place: Float[Array, " p"]
    residuals: Float[Array, " n"]
    slope: Float[Array, "n p"]
    curvature: Float[Array, "p p"]

    @property
    def loss(self) -> Scalar:
        """Sum of squared residuals."""
        return jnp.sum(self.residuals**2)

    @property
    def gradient(self) -> Float[Array, " p"]:
        """Derivatives of half the sum of squares with respect to x."""
        return self.residuals @ self.slope

    @property
    def _held(self) -> Bool[Array, " p"]:
        """Which parameters lie at an end of their interval and are drawn beyond."""
        return (1 - jnp.abs(self.place) <= _END) & (self.gradient * self.place < 0)

    @property
    def step(self) -> Float[Array, " p"]:
        """What a full Newton step of the free parameters would add to x, were there no end."""
        held = self._held
        gradient = jnp.where(held, 0.0, self.gradient)
        apart = held[:, None] | held[None, :]
        curvature = jnp.where(apart, jnp.eye(held.size, dtype=gradient.dtype), self.curvature)
        size, axes = _modulus(curvature)
        return -axes @ ((gradient @ axes) / size)

    @property
    def at_end(self) -> Bool[Array, " p"]:
        """Which parameters have their minimum at an end of the interval or beyond."""
        return self._held | (jnp.abs(self.place + self.step) >= 1 - _END)

    def converged(self, rounding: Scalar) -> Bool[Array, ""]:
        """Whether what remains of the step inside the intervals is negligible.

        It is if below 1e-3 of the standard error (times the rms residual where that is above 1)
        plus rounding, or where every parameter that still moves is within 1e-5 of an end.

        Args:
            rounding: Of the residuals, root of the sum of squares.
        """
        inside = jnp.clip(self.place + self.step, -1.0, 1.0) - self.place
        length = jnp.sqrt(jnp.sum((self.slope @ inside) ** 2))
        rms = jnp.sqrt(jnp.mean(self.residuals**2))
        near = length <= _PART * jnp.maximum(1.0, rms) + rounding
        still = (jnp.abs(inside) <= _END) & (1 - jnp.abs(self.place) <= _END)
        seen = jnp.any(jnp.sum(self.slope**2, axis=0) > 0)
        return seen & (near | jnp.all(still))


def _modulus(matrix: Float[Array, "p p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    """Eigenvalues by their size, none of them 0, and the eigenvectors."""
    if matrix.shape == (1, 1):
        value, axes = matrix[0], jnp.ones_like(matrix)
    else:
        value, axes = jnp.linalg.eigh(matrix)
    size = jnp.abs(value)
    least = 10 * float(jnp.finfo(size.dtype).eps) * jnp.max(size)
    return jnp.maximum(size, least + float(jnp.finfo(size.dtype).tiny)), axes


def scan(
    residuals: Residuals, count: int, start: Float[Array, " p"], valleys: int
) -> Float[Array, "valley p"]:
    """The deepest valleys along the first parameter, by interpolation, and the start.

    Args:
        residuals: From x; smooth enough along the first for a polynomial through `count` nodes.
        count: Chebyshev nodes at which they are computed.
        start: Computed too; the other parameters stay there.
        valleys: How many places to return, deepest first; where there are fewer, some repeat.
    """
    dtype = start.dtype
    nodes = jnp.append(jnp.asarray(chebyshev_nodes(count), dtype), start[0])
    computed = jax.vmap(lambda first: residuals(start.at[0].set(first)))(nodes)
    places = jnp.asarray(np.linspace(-_OUTERMOST, _OUTERMOST, _PLACES), dtype)
    transform = jnp.asarray(chebyshev_transform(count), dtype)
    between = chebyshev_basis(places, count) @ (transform @ computed[:-1])
    loss = jnp.sum(jnp.concatenate([between, computed[-1:]]) ** 2, axis=1)
    loss = jnp.where(jnp.isfinite(loss), loss, jnp.inf)
    beside = jnp.concatenate([loss[1:_PLACES], jnp.full(1, jnp.inf, dtype)])
    before = jnp.concatenate([jnp.full(1, jnp.inf, dtype), loss[: _PLACES - 1]])
    floor = jnp.append((loss[:-1] <= beside) & (loss[:-1] <= before), True)
    depth, index = jax.lax.top_k(-jnp.where(floor, loss, jnp.inf), valleys)
    index = jnp.where(jnp.isfinite(depth), index, index[0])
    first = jnp.append(places, start[0])[index]
    return jnp.repeat(start[None], valleys, axis=0).at[:, 0].set(first)


def descend(
    residuals: Residuals,
    start: Float[Array, " p"],
    size: Float[Array, " p"],
    rounding: Scalar,
    max_steps: int,
    exact: bool,
) -> tuple[Valley, Bool[Array, ""], Int[Array, ""]]:
    """Go down to the nearest minimum of the sum of squared residuals.

    Args:
        residuals: From x in [-1, 1], in units of their standard deviations.
        start: First x.
        size: Typical length of the residuals' derivatives by each x, so that the first steps are
            free; above 0.
        rounding: Of the residuals, root of the sum of squares.
        max_steps: Steps allowed, rejected ones too.
        exact: Whether the curvature includes the second derivatives of the residuals, without
            which the search can take a hundred steps where a model does not hold the data.

    Returns:
        The last accepted point, whether it is a minimum, and the steps.
    """
    scale = _UNDAMPED / size

    # A few rows with the same loss, gradient and curvature stand for all residuals; the solver
    # gets their derivatives with them, in one pass.
    @jax.custom_jvp
    def rows(z: Reals) -> tuple[Reals, Valley]:
        value, _, valley = _rows(residuals, z, scale, exact)
        return value, valley

    @rows.defjvp
    def _(primals: tuple[Reals], tangents: tuple[Reals]) -> tuple[Any, Any]:
        value, slope, valley = _rows(residuals, primals[0], scale, exact)
        return (value, valley), (slope @ tangents[0], jax.tree.map(jnp.zeros_like, valley))

    first = jnp.arcsin(jnp.clip(start, -_OUTERMOST, _OUTERMOST)) / scale
    found = optx.least_squares(
        lambda z, _: rows(z), _Descent(rounding=rounding), first, max_steps=max_steps, has_aux=True,
        throw=False,
    )  # fmt: skip
    valley = found.state.aux
    return valley, valley.converged(rounding), jnp.asarray(found.stats["num_steps"])


def rounding_of(weight: Scalar, precision: float) -> Scalar:
    """Rounding of residuals, root of the sum of squares.

    Args:
        weight: Root of the sum of the inverse squared noises, the size of the residuals if a
            model is off by its own size.
        precision: Relative rounding of the model.
    """
    return _ROUNDING * precision * weight


def look(residuals: Residuals, x: Float[Array, " p"], exact: bool) -> Valley:
    """Residuals with their derivatives at a place, in one forward pass."""
    directions = jnp.eye(x.size, dtype=x.dtype)

    def with_slope(x: Reals) -> tuple[Reals, Reals]:
        value, slope = jax.vmap(
            lambda along: jax.jvp(residuals, (x,), (along,)), out_axes=(None, 1)
        )(directions)
        return value, slope

    if exact:
        (value, slope), (_, bend) = jax.vmap(
            lambda along: jax.jvp(with_slope, (x,), (along,)), out_axes=((None, None), (1, 2))
        )(directions)
        curvature = slope.T @ slope + jnp.tensordot(value, bend, 1)
    else:
        value, slope = with_slope(x)
        curvature = slope.T @ slope
    return Valley(x, value, slope, curvature)


def _rows(
    residuals: Residuals, z: Reals, scale: Reals, exact: bool
) -> tuple[Reals, Float[Array, "rows p"], Valley]:
    """A few rows and their derivatives for the solver, and what they stand for."""
    sine, cosine = jnp.sin(z * scale), jnp.cos(z * scale)
    valley = look(residuals, sine, exact)
    tiny = float(jnp.finfo(z.dtype).tiny)
    by_x = valley.gradient
    per_z = cosine * scale
    gradient = by_x * per_z
    # Of the free variables; by its size, so that a step goes downhill, and never so small that a
    # step would promise more than the whole loss.
    curve = per_z[:, None] * valley.curvature * per_z[None, :]
    curve = curve - jnp.diag(sine * by_x * scale**2)
    size, axes = _modulus(curve)
    along = gradient @ axes
    promise = jnp.sum(along**2 / size)
    size = size * jnp.maximum(1.0, promise / (valley.loss + tiny))
    root = jnp.sqrt(size)
    rest = jnp.sqrt(jnp.maximum(valley.loss - jnp.sum(along**2 / size), 0.0))
    value = jnp.append(along / root, rest)
    return value, jnp.pad(root[:, None] * axes.T, ((0, 1), (0, 0))), valley


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
        self, fn: Any, y: Reals, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Bool[Array, ""], Any]:
        """Whether to end; nothing has been computed before the first step."""
        return state.aux.converged(self.rounding) & ~state.first_step, state.result
