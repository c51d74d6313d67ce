"""Matrices over the nodes of a quadrature, with a border of directions that have no weight in it.

A direction to look into is reached by light but sends none on, and a sun sends light but is reached
by none. So an operator on all of them is block triangular: sums, products and inverses keep the
form, and cost little more than those of the nodes alone. No two directions need to differ.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.typing import Scalar


class Bordered(eqx.Module):
    """A block triangular operator. The first axis of the blocks is the azimuthal mode.

    Attributes:
        nodes: From the nodes to the nodes.
        below: From the nodes to the views.
        beside: From the suns to the nodes.
        corner: From the suns to the views.
        views: From each view to itself.
        suns: From each sun to itself.
    """

    nodes: Float[Array, "mode node node"]
    below: Float[Array, "mode view node"]
    beside: Float[Array, "mode node sun"]
    corner: Float[Array, "mode view sun"]
    views: Float[Array, " view"]
    suns: Float[Array, " sun"]

    def __add__(self, other: "Bordered") -> "Bordered":
        """Block by block."""
        return jax.tree.map(jnp.add, self, other)

    def __sub__(self, other: "Bordered") -> "Bordered":
        """Block by block."""
        return jax.tree.map(jnp.subtract, self, other)

    def __mul__(self, factor: Scalar | float) -> "Bordered":
        """Times a number."""
        return jax.tree.map(lambda block: block * factor, self)

    def __matmul__(self, other: "Bordered") -> "Bordered":
        """The other first, then this one."""
        of_views, of_suns = self.views[None, :, None], other.suns[None, None, :]
        return Bordered(
            self.nodes @ other.nodes,
            self.below @ other.nodes + of_views * other.below,
            self.nodes @ other.beside + self.beside * of_suns,
            self.below @ other.beside + of_views * other.corner + self.corner * of_suns,
            self.views * other.views,
            self.suns * other.suns,
        )

    def plus(self, number: Scalar | float) -> "Bordered":
        """A number added to the diagonal."""
        one = jnp.eye(self.nodes.shape[1], dtype=self.nodes.dtype)
        diagonal = number * one
        return Bordered(
            self.nodes + diagonal[None],
            self.below,
            self.beside,
            self.corner,
            self.views + number,
            self.suns + number,
        )

    def inverse(self, *, definite: bool = True) -> "Bordered":
        """The operator that undoes this one.

        Args:
            definite: Whether the block of the nodes is symmetric and positive. Static.
        """
        nodes = (inverse_of_definite if definite else jnp.linalg.inv)(self.nodes)
        views, suns = 1 / self.views, 1 / self.suns
        of_views, of_suns = -views[None, :, None], suns[None, None, :]
        beside = -(nodes @ self.beside) * of_suns
        return Bordered(
            nodes,
            of_views * (self.below @ nodes),
            beside,
            of_views * (self.corner * of_suns + self.below @ beside),
            views,
            suns,
        )


@jax.custom_jvp
def inverse_of_definite(matrix: Float[Array, "*m n n"]) -> Float[Array, "*m n n"]:
    """Inverse of symmetric positive matrices, by Gauss-Jordan elimination.

    All matrices take each step together, along the last axis: for hundreds of small ones that is
    twice as fast as LAPACK, one after the other. None needs pivoting.
    """
    n = matrix.shape[-1]
    together = jnp.moveaxis(matrix.reshape(-1, n, n), 0, -1)
    place = jnp.arange(n)

    def eliminate(k: Array, x: Float[Array, "n n m"]) -> Float[Array, "n n m"]:
        pivot = 1 / x[k, k]
        row, column = x[k] * pivot[None, :], x[:, k]
        here = (place == k)[:, None, None]
        across = (place == k)[None, :, None]
        rest = x - column[:, None, :] * row[None, :, :]
        rest = jnp.where(across, -(column * pivot[None, :])[:, None, :], rest)
        in_row = jnp.where(across, pivot[None, None, :], row[None, :, :])
        return jnp.where(here, in_row, rest)

    inverse = jax.lax.fori_loop(0, n, eliminate, together)
    return jnp.moveaxis(inverse, -1, 0).reshape(matrix.shape)


@inverse_of_definite.defjvp
def _slope_of_inverse(values: tuple[Array], slopes: tuple[Array]) -> tuple[Array, Array]:
    inverse = inverse_of_definite(values[0])
    return inverse, -inverse @ slopes[0] @ inverse
