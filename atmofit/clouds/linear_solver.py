"""A large linear system whose matrix is only known by its products, with derivatives."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from atmofit.numerics import safe_divide
from atmofit.typing import Reals, Scalar

Product = Callable[[Reals], Reals]
_DEGENERATE = 1e-6


class Effort(eqx.Module):
    """What a solution has cost.

    Attributes:
        products: With the matrix.
        residual: What is left of the right side, relative, in the Euclidean norm [-].
    """

    products: Int[Array, ""]
    residual: Scalar


class _State(eqx.Module):
    """Between two products. An iteration has two of them; `half` and `v` are of its first."""

    x: Reals
    residual: Reals
    step: Reals
    shadow: Reals
    half: Reals
    v: Reals
    rho: Scalar
    alpha: Scalar
    best: Reals
    least: Scalar
    count: Int[Array, ""]


def solve_linear(
    product: Product, right_side: Reals, rtol: float, most: int
) -> tuple[Reals, Effort]:
    """Solve product(x) = right_side; derivatives by the implicit function theorem.

    Args:
        product: Linear; what it closes over may be differentiated.
        right_side: Any shape.
        rtol: Residual over right side, in the Euclidean norm, also for the slopes' system.
        most: Iterations, of two products each, after which the best solution so far is returned.

    Returns:
        The solution and its cost.

    References:
        BiCGStab: van der Vorst (1992), SIAM J. Sci. Stat. Comput. 13, 631.
    """

    def solve(own: Product, b: Reals) -> tuple[Reals, Effort]:
        return _stabilised(own, b, rtol, most)

    return jax.lax.custom_linear_solve(product, right_side, solve, solve, has_aux=True)


def _stabilised(product: Product, b: Reals, rtol: float, most: int) -> tuple[Reals, Effort]:
    """Biconjugate gradients, for a right side of any size."""
    largest = jnp.max(jnp.abs(b))
    largest = jnp.where(largest > 0, largest, 1.0)
    b = b / largest
    size = _norm(b)
    zero, none = jnp.zeros_like(b), jnp.zeros_like(size)
    first = _State(zero, b, b, b, zero, zero, size**2, none, zero, size, jnp.asarray(0))

    def unfinished(state: _State) -> Bool[Array, ""]:
        return (state.least > rtol * size) & (state.count < 2 * most)

    def advance(state: _State) -> _State:
        # One call of the product, which may take long to compile, serves both halves.
        second = state.count % 2 == 1
        found = product(jnp.where(second, state.half, state.step))
        return jax.lax.cond(second, _second_half, _first_half, state, found)

    last = jax.lax.while_loop(unfinished, advance, first)
    share = jnp.where(size > 0, last.least / jnp.where(size > 0, size, 1.0), none)
    return last.best * largest, Effort(last.count, share)


def _first_half(state: _State, v: Reals) -> _State:
    alpha = safe_divide(state.rho, _dot(state.shadow, v))
    half = state.residual - alpha * v
    return _kept(
        state,
        state.x + alpha * state.step,
        half,
        lambda s: (s.half, s.v, s.alpha),
        (half, v, alpha),
    )


def _second_half(state: _State, t: Reals) -> _State:
    """Begins anew, from where it is, when the directions have degenerated."""
    omega = safe_divide(_dot(t, state.half), _dot(t, t))
    x = state.x + state.alpha * state.step + omega * state.half
    residual = state.half - omega * t
    rho = _dot(state.shadow, residual)
    beta = safe_divide(rho, state.rho) * safe_divide(state.alpha, omega)
    anew = jnp.abs(rho) < _DEGENERATE * _norm(residual) * _norm(state.shadow)
    step = jnp.where(anew, residual, residual + beta * (state.step - omega * state.v))
    shadow = jnp.where(anew, residual, state.shadow)
    rho = jnp.where(anew, _dot(residual, residual), rho)
    return _kept(
        state,
        x,
        residual,
        lambda s: (s.x, s.residual, s.step, s.shadow, s.rho),
        (x, residual, step, shadow, rho),
    )


def _kept(
    state: _State, x: Reals, residual: Reals, fields: Callable[[_State], Any], values: Any
) -> _State:
    """With new values, and the best solution so far."""
    norm = _norm(residual)
    better = norm < state.least
    new = eqx.tree_at(fields, state, values)
    return eqx.tree_at(
        lambda s: (s.best, s.least, s.count),
        new,
        (
            jnp.where(better, x, state.best),
            jnp.where(better, norm, state.least),
            state.count + 1,
        ),
    )


def _dot(one: Reals, other: Reals) -> Scalar:
    return jnp.sum(one * other)


def _norm(values: Reals) -> Scalar:
    return jnp.sqrt(_dot(values, values))
