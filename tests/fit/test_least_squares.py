"""The solver and the uncertainty of its result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.fit.least_squares import minimise, uncertainty

RNG = np.random.default_rng(3)
DESIGN = RNG.normal(size=(200, 4)) * np.array([1.0, 30.0, 0.01, 1.0])
TARGET = RNG.normal(size=200)


def no_prior(p):
    return 0 * p


def test_valley():
    """Rosenbrock's function: a bent valley."""
    end = jax.jit(
        lambda start: minimise(lambda p: jnp.stack([1 - p[0], 10 * (p[1] - p[0] ** 2)]), start, 100)
    )(jnp.asarray([-1.2, 1.0]))
    assert end.converged
    np.testing.assert_allclose(end.parameters, [1.0, 1.0], atol=1e-6)


def test_large_residuals_converge_fast():
    """Where J^T J alone goes wrong: data far from any curve of the family."""
    x = np.linspace(0, 3, 100)
    data = np.sin(6 * x)

    @jax.jit
    def run(start):
        return minimise(lambda p: 0.1 * (p[0] * jnp.exp(-jnp.exp(p[1]) * x) - data), start, 100)

    end = run(jnp.asarray([1.0, 0.0]))
    assert end.converged
    assert int(end.steps) < 40
    a, b = np.asarray(end.parameters)[:, None, None] + 0.01 * RNG.normal(size=(2, 200, 1))
    losses = np.sum((a * np.exp(-np.exp(b) * x) - data) ** 2, axis=1)
    assert float(end.loss) <= 0.01 * losses.min()


def test_too_few_steps_do_not_count_as_converged():
    end = minimise(
        lambda p: jnp.stack([1 - p[0], 10 * (p[1] - p[0] ** 2)]), jnp.asarray([-1.2, 1.0]), 3
    )
    assert not end.converged
    assert float(end.decrement) > 1e-3


def test_linear_problem_is_solved():
    end = minimise(lambda p: jnp.asarray(DESIGN) @ p - TARGET, jnp.ones(4), 100)
    solution, _, _, _ = np.linalg.lstsq(DESIGN, TARGET)
    assert end.converged
    np.testing.assert_allclose(end.parameters, solution, rtol=1e-6)


@pytest.mark.parametrize(("dtype", "rtol"), [("float64", 1e-9), ("float32", 1e-4)])
def test_uncertainty_is_the_textbooks(dtype, rtol):
    solution, loss, _, _ = np.linalg.lstsq(DESIGN, TARGET)
    covariance = loss / 196 * np.linalg.inv(DESIGN.T @ DESIGN)
    design, target = jnp.asarray(DESIGN, dtype), jnp.asarray(TARGET, dtype)
    known = uncertainty(lambda p: design @ p - target, no_prior, jnp.asarray(solution, dtype))
    error = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(known.standard_error, error, rtol=rtol)
    np.testing.assert_allclose(known.covariance, covariance, atol=rtol * covariance.max())
    scaled = DESIGN / np.linalg.norm(DESIGN, axis=0)
    np.testing.assert_allclose(known.condition_number, np.linalg.cond(scaled), rtol=rtol)


def test_undetermined_parameter():
    """Its standard error comes from the prior, and the condition number saturates."""

    def residuals(p):
        return (p[0] - TARGET) / 10

    known = uncertainty(residuals, lambda p: 0.01 * p, jnp.asarray([0.0, 5.0]))
    assert float(known.condition_number) > 1e7
    assert np.isfinite(known.standard_error).all()
    spread = np.sqrt(np.sum(TARGET**2) / 100 / 198)
    np.testing.assert_allclose(known.standard_error[1], spread / 0.01, rtol=1e-6)
