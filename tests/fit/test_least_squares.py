"""The solver and the uncertainty of its result."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.fit.least_squares import Paths, derivatives, minimise
from atmofit.fit.uncertainty import uncertainty

RNG = np.random.default_rng(3)
DESIGN = RNG.normal(size=(200, 4)) * np.array([1.0, 30.0, 0.01, 1.0])
TARGET = RNG.normal(size=200)


def no_prior(p):
    return 0 * p


def search(residuals, start, max_steps=100, ridges=(0.0,)):
    """One search along one path."""
    start = jnp.asarray(start)
    paths = Paths(jnp.asarray([ridges]), jnp.zeros((1, start.size)))
    ends = minimise(lambda _, p: derivatives(residuals, p), start[None, :], paths, max_steps, 1)
    return jax.tree.map(lambda leaf: leaf[0], ends)


def test_valley():
    """Rosenbrock's function: a bent valley."""
    end = search(lambda p: jnp.stack([1 - p[0], 10 * (p[1] - p[0] ** 2)]), [-1.2, 1.0])
    assert end.converged
    np.testing.assert_allclose(end.parameters, [1.0, 1.0], atol=1e-6)


def test_large_residuals_converge_fast():
    """Where J^T J alone goes wrong: data far from any curve of the family."""
    x = np.linspace(0, 3, 100)
    data = np.sin(6 * x)

    end = search(lambda p: 0.1 * (p[0] * jnp.exp(-jnp.exp(p[1]) * x) - data), [1.0, 0.0])
    assert end.converged
    assert int(end.steps) < 40
    a, b = np.asarray(end.parameters)[:, None, None] + 0.01 * RNG.normal(size=(2, 200, 1))
    losses = np.sum((a * np.exp(-np.exp(b) * x) - data) ** 2, axis=1)
    assert float(end.loss) <= 0.005 * losses.min()


def test_too_few_steps_do_not_count_as_converged():
    end = search(lambda p: jnp.stack([1 - p[0], 10 * (p[1] - p[0] ** 2)]), [-1.2, 1.0], 3)
    assert not end.converged
    assert float(end.decrement) > 1e-3


def test_linear_problem_is_solved():
    end = search(lambda p: jnp.asarray(DESIGN) @ p - TARGET, np.ones(4))
    solution, _, _, _ = np.linalg.lstsq(DESIGN, TARGET)
    assert end.converged
    np.testing.assert_allclose(end.parameters, solution, rtol=1e-6)


def test_many_searches_in_few_lanes():
    """Each ends where it would alone, in its own order, though lanes take what comes next."""
    target = RNG.normal(size=(37, 2))

    def objective(number, p):
        far = p - jnp.asarray(target)[number]
        return derivatives(lambda q: jnp.stack([q[0], 10 * (q[1] - q[0] ** 2)]), far)

    paths = Paths(jnp.asarray([[0.0]]), jnp.zeros((1, 2)))
    starts = jnp.asarray(target + RNG.normal(size=(37, 2)))
    ends = jax.jit(lambda starts: minimise(objective, starts, paths, 200, 5))(starts)
    assert ends.converged.all()
    np.testing.assert_allclose(ends.parameters, target, atol=1e-5)
    assert np.unique(ends.steps).size > 3


def test_a_strong_ridge_released_finds_the_deeper_minimum():
    """(q^2 - 1)^2 with a tilt: from the wrong side, only the path by the ridge crosses over."""

    def residuals(p):
        return jnp.stack([p[0] ** 2 - 1, 0.3 * (p[0] - 1)])

    straight = search(residuals, [-2.0])
    released = search(residuals, [-2.0], ridges=(3.0, 1.0, 0.0))
    assert straight.converged
    assert released.converged
    assert float(straight.parameters[0]) < 0
    np.testing.assert_allclose(released.parameters, 1.0, atol=1e-6)


def test_bad_start_is_no_number():
    end = search(lambda p: jnp.log(p), [-1.0])
    assert not end.converged
    assert np.isnan(end.parameters).all()
    assert np.isnan(end.loss)


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
