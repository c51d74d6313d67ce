"""A few named parameters in known ranges: their places from -1 to 1, and what a search tells."""

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import choice, in_range, is_traced
from atmofit.fit.few_parameters import Valley
from atmofit.fit.words import parameter_lines
from atmofit.typing import Reals, RealsLike, Scalar

_LEFT_OPEN = 0.25  # standard error over half the range, from which data say nothing
Values = dict[str, Scalar]


@dataclasses.dataclass(frozen=True)
class Ranges:
    """Lowest and highest value of each parameter. Hashable.

    Attributes:
        bounds: Name, lowest, highest.
        logarithmic: Names of those that are searched by their logarithm, the others evenly.
    """

    bounds: tuple[tuple[str, float, float], ...]
    logarithmic: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """In their order."""
        return tuple(name for name, _, _ in self.bounds)

    def checked(self, known: Mapping[str, RealsLike] | None) -> Values:
        """Values that are not sought.

        Raises:
            ValueError: An unknown name, a value out of range, or nothing left to seek.
        """
        given = {} if known is None else known
        for name in given:
            choice("a name in known", name, self.names)
        if len(given) == len(self.names):
            raise ValueError(f"known must leave a parameter to be sought, got all of {self.names}")
        ends = {name: (low, high) for name, low, high in self.bounds}
        return {name: in_range(name, x, *ends[name]).reshape(()) for name, x in given.items()}

    def free(self, known: Values) -> tuple[str, ...]:
        """Names of those that are sought."""
        return tuple(name for name in self.names if name not in known)

    def at(self, place: Reals, known: Values) -> Values:
        """All parameters, the free ones from their places from -1 to 1."""
        sought = self._sought(place, self.free(known))
        return known | dict(zip(self.free(known), sought, strict=True))

    def places(self, values: Mapping[str, RealsLike], free: tuple[str, ...]) -> Reals:
        """Places from -1 to 1 of the free parameters among values given by name.

        Raises:
            ValueError: An unknown name, or a value out of range.
        """
        for name in values:
            choice("a name in start", name, self.names)
        found = []
        for name, (low, high, by_logarithm) in zip(free, self._ends(free), strict=True):
            value = in_range(name, values[name], low, high).reshape(())
            part = (value - low) / (high - low)
            if by_logarithm:
                part = jnp.log(value / low) / math.log(high / low)
            found.append(jnp.clip(2 * part - 1, -0.99, 0.99))  # at the very end the slopes vanish
        return jnp.stack(found)

    def worth(self, end: Valley, known: Values) -> dict[str, Array]:
        """What the end of a search says, over all parameters in their order.

        Returns:
            `values`, `standard_error` (0 where known), `covariance`, `condition_number` of the
            Jacobian with columns of unit length, `determined` (whether the standard error is below
            an eighth of the range, or of that of the logarithm, and the value not at its end),
            `residuals` and `reduced_chi_square` (NaN without degrees of freedom).
        """
        free, count = self.free(known), len(self.names)
        values = self.at(end.place, known)
        every = jnp.stack([values[name] for name in self.names])
        covariance, condition = _covariance(end.slope)
        told = (jnp.sqrt(jnp.diagonal(covariance)) < _LEFT_OPEN) & ~end.at_end
        per_place = self._per_place(self._sought(end.place, free), free)
        covariance = per_place[:, None] * covariance * per_place[None, :]
        error = jnp.sqrt(jnp.diagonal(covariance))
        left = end.residuals.size - len(free)
        chosen = np.array([self.names.index(name) for name in free])
        square = jnp.zeros((count, count), every.dtype)
        return {
            "values": every,
            "standard_error": jnp.zeros_like(every).at[chosen].set(error),
            "covariance": square.at[np.ix_(chosen, chosen)].set(covariance),
            "condition_number": condition,
            "determined": jnp.ones(count, bool).at[chosen].set(told),
            "residuals": end.residuals,
            "reduced_chi_square": end.loss / left if left else jnp.full_like(end.loss, jnp.nan),
        }

    def _ends(self, free: tuple[str, ...]) -> list[tuple[float, float, bool]]:
        ends = {name: (low, high, name in self.logarithmic) for name, low, high in self.bounds}
        return [ends[name] for name in free]

    def _sought(self, place: Reals, free: tuple[str, ...]) -> Reals:
        """Parameters of places."""

        def value(x: Scalar, low: float, high: float, by_logarithm: bool) -> Scalar:
            if by_logarithm:
                part = math.log(high / low) * (x + 1) / 2
                return jnp.clip(low * jnp.exp(part), low, high)
            return jnp.clip(low + (high - low) * (x + 1) / 2, low, high)

        return jnp.stack([value(x, *e) for x, e in zip(place, self._ends(free), strict=True)])

    def _per_place(self, values: Reals, free: tuple[str, ...]) -> Reals:
        """Derivatives of parameters by their places, also at the ends."""

        def slope(value: Scalar, low: float, high: float, by_logarithm: bool) -> Scalar:
            if by_logarithm:
                return value * (math.log(high / low) / 2)
            return jnp.full_like(value, (high - low) / 2)

        return jnp.stack([slope(x, *e) for x, e in zip(values, self._ends(free), strict=True)])


class RangedFit(eqx.Module):
    """What a search in known ranges found; lists of parameters are in the order of `NAMES`.

    Attributes:
        values: Of all parameters.
        standard_error: Of each; 0 where it was known.
        covariance: Of all.
        condition_number: Of the Jacobian, columns scaled to unit length; large where the
            measurements do not tell parameters apart. 1 for one parameter.
        determined: Whether the standard error is below an eighth of the parameter's range (of that
            of its logarithm where this is searched) and the value not at its end; true where known.
        residuals: In the order of the measurements, over their noise.
        reduced_chi_square: Their sum of squares over the degrees of freedom; about 1 if model and
            noise are right. NaN where there are none.
        converged: Whether the search ended at a minimum, in the range or at its end.
        steps: Of all searches.
        free: Names of what was sought. Static.
    """

    NAMES: ClassVar[tuple[str, ...]]
    values: Float[Array, " parameter"]
    standard_error: Float[Array, " parameter"]
    covariance: Float[Array, "parameter parameter"]
    condition_number: Scalar
    determined: Bool[Array, " parameter"]
    residuals: Float[Array, "*measured"]
    reduced_chi_square: Scalar
    converged: Bool[Array, ""]
    steps: Int[Array, ""]
    free: tuple[str, ...] = eqx.field(static=True)

    def __getitem__(self, name: str) -> Scalar:
        """A parameter by its name."""
        return self.values[self.NAMES.index(choice("name", name, self.NAMES))]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters that the measurements leave open."""
        told = np.asarray(self.determined)
        return tuple(name for name, known in zip(self.NAMES, told, strict=True) if not known)

    def __str__(self) -> str:
        """Values, errors, and what is not determined; of one fit."""
        if is_traced(self) or self.values.ndim > 1:
            return repr(self)
        lines = [f"reduced chi-square {self.reduced_chi_square:.2f}"]
        notes = ("(not determined)" if n in self.undetermined else "" for n in self.NAMES)
        lines += parameter_lines(self.NAMES, self.values, self.standard_error, notes)
        return "\n".join([*lines, f"  condition number {self.condition_number:.3g}"])


def _covariance(jacobian: Float[Array, "n p"]) -> tuple[Float[Array, "p p"], Scalar]:
    """Inverse of J^T J, and the condition number of J with columns of unit length."""
    norm = jnp.sqrt(jnp.sum(jacobian**2, axis=0))
    told = norm > 0
    unit = jnp.where(told, norm, 1.0)
    _, stretch, axes = jnp.linalg.svd(jacobian / unit[None, :], full_matrices=False)
    least = float(jnp.finfo(jacobian.dtype).eps)
    stretch = jnp.maximum(stretch, least * stretch[0] + float(jnp.finfo(stretch.dtype).tiny))
    # A parameter that changes nothing has no error to speak of; let it be as large as can be.
    per_unit = axes / jnp.where(told, norm, least)[None, :] / stretch[:, None]
    return per_unit.T @ per_unit, stretch[0] / stretch[-1]


def even_places(dimensions: int, count: int) -> np.ndarray:
    """Places from -.95 to .95 that fill a cube evenly: multiples of powers of a golden ratio."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    return 0.95 * (2 * ((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1) - 1)


def log_ratio(ratio: Reals, linear_below: float) -> Reals:
    """Logarithm, low down its tangent, so that a dark model has a finite misfit."""
    low = ratio < linear_below
    tangent = math.log(linear_below) + (ratio / linear_below - 1)
    return jnp.where(low, tangent, jnp.log(jnp.where(low, 1.0, ratio)))
