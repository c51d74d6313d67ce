"""Numerics against SciPy and against theorems."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special

from atmofit import Exponential
from atmofit.numerics import (
    chapman_factors,
    chebyshev_basis,
    chebyshev_nodes,
    chebyshev_transform,
    erfcx,
    gauss_nodes,
    harmonics,
    legendre_table,
    safe_divide,
    safe_sqrt,
)

RADIUS = 6371e3
DTYPES = [("float32", 3e-6), ("float64", 1e-12)]


@pytest.mark.parametrize(("dtype", "rtol"), DTYPES)
def test_erfcx_and_its_slope(dtype, rtol):
    # 9.19 to 9.42 is where JAX's own function fails in float32.
    x = np.concatenate(
        [np.linspace(0, 50, 501), np.linspace(9.19, 9.42, 200), [7.9999, 8.0, 8.0001]]
    )
    x = x.astype(dtype)
    value = erfcx(jnp.asarray(x))
    slope = jax.vmap(jax.grad(erfcx))(jnp.asarray(x))
    exact = special.erfcx(x.astype(float))
    np.testing.assert_allclose(value, exact, rtol)
    # The slope 2 x erfcx(x) - 2 / sqrt(pi) loses x^2 in digits; the error is taken from its terms.
    exact_slope = 2 * x.astype(float) * exact - 2 / np.sqrt(np.pi)
    np.testing.assert_allclose(slope, exact_slope, atol=2 * rtol)


@pytest.mark.parametrize(("dtype", "rtol"), [("float32", 7e-7), ("float64", 1e-13)])
def test_leading_chapman_factor_is_its_integral(dtype, rtol):
    x = np.array([0.0, 0.1, 1.0, 5.0, 7.99, 8.01, 9.3, 60.0]).astype(dtype)
    leading, _ = chapman_factors(jnp.asarray(x))
    # With v = t^2 - x^2 the root in the denominator disappears.
    exact = [2 * integrate.quad(lambda t, a=a: np.exp(-t * (t + 2 * a)), 0, 40)[0] for a in x]
    np.testing.assert_allclose(leading, exact, rtol=max(rtol, 1e-12))


def _slant_column(scale_height, altitude, cosine):
    """Column over vertical column along a straight ray, by adaptive quadrature over distance."""
    r0 = RADIUS + altitude
    along = r0 * cosine

    def density(s):
        more = s * (2 * along + s)
        return np.exp(-more / (np.sqrt(r0**2 + more) + r0) / scale_height)

    rise = 45 * scale_height
    end = rise * (2 * r0 + rise) / (along + np.sqrt(along**2 + rise * (2 * r0 + rise)))
    edges = end * np.array([0, 0.02, 0.1, 0.3, 1.0])
    parts = [
        integrate.quad(density, a, b, epsrel=1e-11, epsabs=0)[0]
        for a, b in itertools.pairwise(edges)
    ]
    return np.exp(-altitude / scale_height) / scale_height * sum(parts)


HEIGHTS = np.array([10.0, 100.0, 1.2e3, 8.8e3, 1e4])
ALTITUDES = np.array([0.0, 1e3, 2e4, 6e4])
COSINES = np.array([0.0, 1e-6, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0])


@pytest.mark.parametrize(("dtype", "rtol"), [("float32", 3e-6), ("float64", 1e-6)])
def test_slant_column_of_an_exponential_atmosphere(dtype, rtol):
    h, z, mu = (a.ravel() for a in np.meshgrid(HEIGHTS, ALTITUDES, COSINES, indexing="ij"))
    keep = z / h < 60  # what is left beyond underflows in float32
    h, z, mu = (a[keep].astype(dtype) for a in (h, z, mu))
    column = jax.vmap(lambda h, z, mu: Exponential(h).rising_column(z, mu, RADIUS))(h, z, mu)
    exact = np.array([_slant_column(*map(float, case)) for case in zip(h, z, mu, strict=True)])
    # exp(-z / h) alone carries z / h roundings.
    room = rtol + z / h * np.finfo(dtype).eps
    assert (np.abs(np.asarray(column, float) / exact - 1) < room).all()


def test_slope_of_the_slant_column():
    """By scale height, altitude and cosine, against differences of the quadrature."""

    def of(h, z, mu):
        return Exponential(h).rising_column(z, mu, RADIUS)

    for case in [(1.2e3, 500.0, 0.02), (8.8e3, 1e4, 0.1), (8.8e3, 0.0, 0.0), (10.0, 5.0, 1e-3)]:
        slopes = jax.grad(of, argnums=(0, 1, 2))(*map(jnp.asarray, case))
        for i, step in enumerate((case[0] * 1e-4, case[0] * 1e-4, 1e-6)):
            low, high = list(case), list(case)
            low[i], high[i] = case[i] - step, case[i] + step
            difference = (_slant_column(*high) - _slant_column(*low)) / (2 * step)
            np.testing.assert_allclose(slopes[i], difference, rtol=2e-4)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_slant_column_and_slopes_are_finite(dtype):
    h, z, mu = (
        a.ravel().astype(dtype)
        for a in np.meshgrid([1.0, 10.0, 3e4], [0.0, 6e4, 4e5], COSINES, indexing="ij")
    )
    value, slopes = jax.vmap(
        jax.value_and_grad(
            lambda h, z, mu: Exponential(h).rising_column(z, mu, RADIUS), argnums=(0, 1, 2)
        )
    )(*map(jnp.asarray, (h, z, mu)))
    assert np.isfinite(value).all()
    assert all(np.isfinite(slope).all() for slope in slopes)


def test_level_column_is_the_rising_column_at_cosine_0():
    profile, z = Exponential(8e3), jnp.array([0.0, 1e3, 3e4])
    rising = profile.rising_column(z, jnp.zeros(3), RADIUS)
    np.testing.assert_allclose(profile.level_column(z, RADIUS), rising, rtol=1e-13)


def test_harmonics_are_those_of_scipy():
    theta = np.linspace(0, np.pi, 13)
    found = harmonics(jnp.cos(theta), jnp.sin(theta), 30, 20)
    for m in range(20):
        exact = [special.sph_harm_y(degree, m, theta, 0.0).real for degree in range(30)]
        # SciPy carries the sign (-1)^m, which cancels in products.
        np.testing.assert_allclose(found[:, :, m], (-1) ** m * np.transpose(exact), atol=2e-12)


@pytest.mark.parametrize(("dtype", "atol"), [("float32", 2e-4), ("float64", 1e-11)])
def test_harmonics_add_to_legendre_polynomials(dtype, atol):
    a, b, phi = 0.4, 2.1, 0.7
    degrees = 36
    one, two = (
        harmonics(jnp.asarray(np.cos(t), dtype), jnp.asarray(np.sin(t), dtype), degrees, degrees)
        for t in (a, b)
    )
    m = np.arange(degrees)
    twice = jnp.asarray(np.where(m > 0, 2, 1) * np.cos(m * phi), dtype)
    total = (one * two * twice[None, :]).sum(1)
    cosine = np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b) * np.cos(phi)
    exact = (2 * m + 1) / (4 * np.pi) * special.eval_legendre(m, cosine)
    np.testing.assert_allclose(total, exact, atol=atol)


def test_harmonics_have_finite_slopes_at_the_poles():
    def total(theta):
        return harmonics(jnp.cos(theta), jnp.sin(theta), 12, 8).sum()

    assert np.isfinite(jax.vmap(jax.grad(total))(jnp.array([0.0, np.pi / 2, np.pi]))).all()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_safe_sqrt(dtype):
    x = jnp.asarray([-1.0, -0.0, 0.0, 4.0], dtype)
    value, slope = jax.vmap(jax.value_and_grad(safe_sqrt))(x)
    np.testing.assert_array_equal(value, [0, 0, 0, 2])
    np.testing.assert_array_equal(slope, [0, 0, 0, 0.25])


def test_safe_divide():
    value = safe_divide(jnp.array([1.0, 1.0, 0.0]), jnp.array([4.0, 0.0, 0.0]))
    np.testing.assert_array_equal(value, [0.25, 0, 0])
    by_both = jax.grad(lambda a, b: safe_divide(a, b), argnums=(0, 1))
    np.testing.assert_array_equal(by_both(1.0, 4.0), [0.25, -1 / 16])
    np.testing.assert_array_equal(by_both(1.0, 0.0), [0, 0])


@pytest.mark.parametrize("count", [1, 2, 5, 24])
def test_chebyshev_transform_is_exact_for_polynomials(count):
    rng = np.random.default_rng(count)
    polynomial = np.polynomial.Polynomial(rng.normal(size=count))
    coefficients = chebyshev_transform(count) @ polynomial(chebyshev_nodes(count))
    x = np.linspace(-1, 1, 31)
    found = chebyshev_basis(jnp.asarray(x), count) @ coefficients
    np.testing.assert_allclose(found, polynomial(x), rtol=0, atol=1e-12)
    assert (np.diff(chebyshev_nodes(count)) > 0).all()


def test_gauss_nodes_integrate_over_the_unit_interval():
    x, w = gauss_nodes(5)
    for power in range(10):
        assert w @ x**power == pytest.approx(1 / (power + 1), rel=1e-14)


def test_legendre_table():
    x = np.linspace(-1, 1, 7)
    exact = special.eval_legendre(np.arange(9), x[:, None])
    np.testing.assert_allclose(legendre_table(x, 9), exact, atol=1e-14)
