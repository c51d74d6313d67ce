"""Functions that stay finite, with their derivatives, where formulas do not."""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erfcx as jax_erfcx

from atmofit.extremes import Case, Span, extremes
from atmofit.typing import Reals

_ASYMPTOTIC_FROM = 8.0  # the scaled error function's series is exact to rounding from here
_SQRT_PI = math.sqrt(math.pi)
_SERIES_TO, _SERIES_TERMS = 0.5, 14  # of the mean decay, whose terms are then below 1e-16


@extremes(
    Case("zero", {"x": 0.0}, limit=0.0, slope={"x": 0.0}),
    Case("negative", {"x": -4.0}, limit=0.0, slope={"x": 0.0}),
    Case("four", {"x": 4.0}, limit=2.0, slope={"x": 0.25}),
    x=Span(-1e30, 1e30),
)
def safe_sqrt(x: Reals) -> Reals:
    """Square root, with value and slope 0 at and below 0."""
    # Asked this way round so that NaN stays NaN.
    none = x <= 0
    return jnp.where(none, 0.0, jnp.sqrt(jnp.where(none, 1.0, x)))


@extremes(
    Case("0 / 0", {"numerator": 0.0, "denominator": 0.0}, 0.0, {"numerator": 0.0}),
    Case("1 / 0", {"numerator": 1.0, "denominator": 0.0}, 0.0, {"denominator": 0.0}),
    Case("3 / 4", {"numerator": 3.0, "denominator": 4.0}, 0.75, {"denominator": -3 / 16}),
    Case("small / small", {"numerator": 1e-15, "denominator": 1e-15}, 1.0),
    numerator=Span(-1e30, 1e30),
    denominator=Span(-1e30, 1e30),
)
def safe_divide(numerator: Reals, denominator: Reals) -> Reals:
    """Quotient, with value and slope 0 where the denominator is 0."""
    nonzero = denominator != 0
    return jnp.where(nonzero, _quotient(numerator, jnp.where(nonzero, denominator, 1.0)), 0.0)


@extremes(
    Case("apart", {"value": 2.0, "other": 4.0}, limit=2.0, slope={"other": 0.5, "value": 0.0}),
    Case("dark", {"value": 0.0, "other": 0.0}, limit=0.0, slope={"other": 1.0}),
    value=Span(0.0, 1e8),
    other=Span(1e-8, 1e8),
)
@jax.custom_jvp
def with_slopes_of(value: Reals, other: Reals) -> Reals:
    """A value at least 0 that changes in proportion to another: d log(value) = d log(other)."""
    del other
    return value


@with_slopes_of.defjvp
def _slopes_of_other(values: tuple[Any, Any], slopes: tuple[Any, Any]) -> tuple[Any, Any]:
    """Where the other is 0 they change alike."""
    value, other = values
    bright = other > 0
    ratio = jnp.where(bright, value / jnp.where(bright, other, 1.0), 1.0)
    return value, ratio * slopes[1]


@jax.custom_jvp
def _quotient(numerator: Any, denominator: Any) -> Any:
    return numerator / denominator


@_quotient.defjvp
def _quotient_slope(values: tuple[Any, Any], slopes: tuple[Any, Any]) -> tuple[Any, Any]:
    """JAX's own rule squares the denominator, which turns 0 over a tiny number into NaN."""
    quotient = values[0] / values[1]
    return quotient, (slopes[0] - quotient * slopes[1]) / values[1]


@extremes(
    Case("zero", {"x": 0.0}, limit=1.0, slope={"x": -0.5}),
    Case("one", {"x": 1.0}, limit=1 - math.exp(-1), slope={"x": 2 / math.e - 1}),
    Case("far", {"x": 1e30}, limit=1e-30),
    Case("growing", {"x": -60.0}, limit=math.expm1(60.0) / 60),
    x=Span(-60.0, 1e30),
)
def mean_decay(x: Reals) -> Reals:
    """Mean of exp(-t) over t from 0 to x, (1 - exp(-x)) / x, for x of at least -60."""
    near = jnp.abs(x) < _SERIES_TO
    series = jnp.zeros_like(x)
    small = jnp.where(near, x, 0.0)
    for k in reversed(range(_SERIES_TERMS)):
        series = series * small + (-1) ** k / math.factorial(k + 1)
    far = jnp.where(near, 1.0, x)
    # Nothing cancels there, and exp is quicker than expm1.
    return jnp.where(near, series, _quotient(1 - jnp.exp(-far), far))


@extremes(
    Case("zero", {"x": 0.0}, limit=1.0, slope={"x": -2 / _SQRT_PI}),
    Case("where JAX's own fails in float32", {"x": 9.25}, limit=0.06064311514114366),
    Case("far", {"x": 2.0**30}, 2.0**-30 / _SQRT_PI, {"x": -(2.0**-60) / _SQRT_PI}),
    x=Span(0.0, 1e30),
)
def erfcx(x: Reals) -> Reals:
    """Scaled complementary error function exp(x^2) erfc(x) for x >= 0.

    JAX's own function is up to 100 % wrong in float32 for 9.19 <= x <= 9.42 (jax 0.10.2 on a
    CPU), so the asymptotic series takes over above 8.
    """
    far = x > _ASYMPTOTIC_FROM
    near_value = jax_erfcx(jnp.where(far, 0.0, x))
    y = jnp.where(far, x, _ASYMPTOTIC_FROM)
    return jnp.where(far, series_in_inverse_square(y, _ERFCX_SERIES) / (_SQRT_PI * y), near_value)


def series_in_inverse_square(x: Reals, coefficients: tuple[float, ...]) -> Reals:
    """Sum of coefficients[k] / x^(2 k)."""
    inverse = 1 / (x * x)
    total = jnp.zeros_like(x)
    for coefficient in reversed(coefficients):
        total = total * inverse + coefficient
    return total


def _erfcx_series_term(k: int) -> float:
    """(-1)^k (2k - 1)!! / 2^k, the coefficients of sqrt(pi) x erfcx(x) in 1 / x^2."""
    return (-1) ** k * math.prod(range(1, 2 * k, 2)) / 2**k


_ERFCX_SERIES = tuple(_erfcx_series_term(k) for k in range(11))
# (3/8 - a/2 + a^2/2) G + 3x/4 - x^3/2 with a = x^2, G = sqrt(pi) erfcx(x): the large terms cancel.
_CURVATURE_SERIES = tuple(
    3 / 8 * _erfcx_series_term(k) - _erfcx_series_term(k + 1) / 2 + _erfcx_series_term(k + 2) / 2
    for k in range(9)
)


@extremes(
    Case("level", {"x": 0.0}, limit=(_SQRT_PI, 0.375 * _SQRT_PI)),
    Case("far", {"x": 2.0**30}, limit=2.0**-30),
    x=Span(0.0, 1e30),
)
def chapman_factors(x: Reals) -> tuple[Reals, Reals]:
    """The two integrals of an exponential atmosphere's slant column (see `Exponential`).

    Args:
        x: cos(zenith angle) sqrt(radius / (2 scale height)), at least 0.

    Returns:
        G = integral of exp(-v) / sqrt(x^2 + v) over v from 0 to infinity (relative error 7e-7 in
        float32), and the first-order correction for curvature (2e-4 in float32; it is at most
        1e-3 of the column).
    """
    leading = _SQRT_PI * erfcx(x)
    far = x > _ASYMPTOTIC_FROM
    near = jnp.where(far, 0.0, x)
    a = near * near
    closed = (0.375 - 0.5 * a + 0.5 * a * a) * leading + near * (0.75 - 0.5 * a)
    y = jnp.where(far, x, _ASYMPTOTIC_FROM)
    return leading, jnp.where(far, series_in_inverse_square(y, _CURVATURE_SERIES) / y, closed)


def chebyshev_basis(x: Reals, count: int) -> Reals:
    """Chebyshev polynomials T_0 .. T_(count-1) at x in [-1, 1], on a new last axis.

    Each pass doubles how many there are, by T_(n+k) = 2 T_n T_k - T_(n-k): few operations, which
    compile fast.
    """
    terms = jnp.stack([jnp.ones_like(x), x], axis=-1)
    while terms.shape[-1] < count:
        terms = jnp.concatenate(
            [terms, 2 * terms[..., -1:] * terms[..., 1:] - terms[..., -2::-1]], axis=-1
        )
    return terms[..., :count]


extremes(
    Case("left end", {"x": -1.0}, (1, -1) * 6, {"x": [-((-1) ** n) * n * n for n in range(12)]}),
    Case("right end", {"x": 1.0}, limit=1.0, slope={"x": [n * n for n in range(12)]}),
    call=lambda x: chebyshev_basis(x, 12),
    x=Span(-1.0, 1.0),
)(chebyshev_basis)


def powers(x: Reals, count: int) -> Reals:
    """1, x, x^2, ... x^(count-1) on a new last axis, with finite slopes at 0."""
    terms = jnp.stack([jnp.ones_like(x), x], axis=-1)
    while terms.shape[-1] < count:
        terms = jnp.concatenate([terms, terms[..., 1:] * terms[..., -1:]], axis=-1)
    return terms[..., :count]


extremes(
    Case("zero", {"x": 0.0}, limit=(1, 0, 0, 0, 0), slope={"x": (0, 1, 0, 0, 0)}),
    call=lambda x: powers(x, 5),
    x=Span(-1e6, 1e6),
)(powers)


def chebyshev_nodes(count: int) -> np.ndarray:
    """Roots of T_count, from -1 to 1."""
    return -np.cos(np.pi * (np.arange(count) + 0.5) / count)


def chebyshev_transform(count: int) -> np.ndarray:
    """Matrix from values at `chebyshev_nodes` to Chebyshev coefficients."""
    angle = np.arccos(chebyshev_nodes(count))
    matrix = 2 / count * np.cos(np.arange(count)[:, None] * angle[None, :])
    matrix[0] /= 2
    return matrix


@functools.cache
def gauss_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2, weights / 2


def batched_product(matrices: Reals, values: Reals, batch: int) -> Reals:
    """Matrix products over the first axes: [*batch, i, k] times [*batch, k, ...].

    In this order, whatever is large stays in place; `einsum` may swap the two.
    """
    axes = tuple(range(batch))
    dimensions = (((batch + 1,), (batch,)), (axes, axes))
    return jax.lax.dot_general(matrices, values, dimensions)


def legendre_table(cosine: np.ndarray, count: int) -> np.ndarray:
    """Legendre polynomials P_0 .. P_(count-1), on a new last axis."""
    return np.polynomial.legendre.legvander(cosine, count - 1)


@functools.cache
def legendre_to_chebyshev(count: int) -> np.ndarray:
    """Matrix from the coefficients of P_0 .. P_(count-1) to those of T_0 .. T_(count-1)."""
    nodes = chebyshev_nodes(count)
    return chebyshev_transform(count) @ legendre_table(nodes, count)


def harmonics(cosine: Reals, sine: Reals, degrees: int, modes: int) -> Reals:
    """Normalised associated Legendre functions of the spherical harmonics.

    They are orthonormal: the integral of Y_lm(mu) Y_km(mu) over mu is delta_lk / (2 pi), and
    sum over m of (2 - delta_m0) Y_lm(mu) Y_lm(mu') cos(m phi) = (2l + 1) / (4 pi) P_l.

    Args:
        cosine: Cosine of the polar angle, any shape.
        sine: Its sine, given beside it so that slopes stay finite at the poles.
        degrees: l runs from 0 to degrees - 1.
        modes: m runs from 0 to modes - 1.

    Returns:
        [..., degree, mode]; zero where m > l.
    """
    m = np.arange(modes)
    factor = np.cumprod(
        np.concatenate([[math.sqrt(1 / (4 * math.pi))], np.sqrt((2 * m[1:] + 1) / (2 * m[1:]))])
    )
    diagonal = powers(sine, modes) * _constant(factor, sine[..., None])
    up, back = np.stack([_recurrence(degree, modes) for degree in range(degrees)], axis=1)
    on_diagonal = (m[None, :] == np.arange(degrees)[:, None]).astype(float)

    def next_degree(
        two: tuple[Reals, Reals], row: tuple[Reals, Reals, Reals]
    ) -> tuple[tuple[Reals, Reals], Reals]:
        before, last = two
        up, back, here = (values.reshape((1,) * sine.ndim + (-1,)) for values in row)
        new = (cosine[..., None] * last - back * before) * up + diagonal * here
        return (last, new), new

    dtype = sine.dtype
    rows = (jnp.asarray(up, dtype), jnp.asarray(back, dtype), jnp.asarray(on_diagonal, dtype))
    _, result = jax.lax.scan(next_degree, (0 * diagonal, 0 * diagonal), rows)
    return jnp.moveaxis(result, 0, -2)


extremes(
    Case("zenith", {"cosine": 1.0, "sine": 0.0}),
    Case("nadir", {"cosine": -1.0, "sine": 0.0}),
    Case("level", {"cosine": 0.0, "sine": 1.0}),
    call=lambda cosine, sine: harmonics(cosine, sine, 12, 6),
    derivative="forward",
    cosine=Span(-1.0, 1.0),
    sine=Span(0.0, 1.0),
)(harmonics)


def _recurrence(degree: int, modes: int) -> tuple[np.ndarray, np.ndarray]:
    """Factors of Y_lm = up (mu Y_(l-1)m - back Y_(l-2)m), zero where m >= l."""
    m = np.arange(modes)
    below = m < degree
    m2, l2 = np.where(below, m, 0) ** 2, float(degree) ** 2
    up = np.sqrt(np.where(below, (4 * l2 - 1) / np.maximum(l2 - m2, 1), 0.0))
    last2 = (degree - 1.0) ** 2
    back = np.sqrt(np.where(m < degree - 1, (last2 - m2) / max(4 * last2 - 1, 1), 0.0))
    return up, back


def _constant(values: np.ndarray, like: Reals) -> Reals:
    """A NumPy vector in the dtype of `like`, with its axes before the last."""
    return jnp.asarray(values, like.dtype).reshape((1,) * (like.ndim - 1) + (-1,))
