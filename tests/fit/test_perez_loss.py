"""The loss of Perez skies against automatic differentiation of the formula itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.fit import distribution, least_squares, single_sky
from atmofit.fit.parameters import PerezPrior
from atmofit.geometry import Directions

RNG = np.random.default_rng(11)
VIEW = np.append(0.0, RNG.uniform(0, 1.57, 30))
LIST = Directions(VIEW, np.append(0.0, RNG.uniform(0, 6, 30)))
SUNS, TURBIDITY = np.array([0.0, 0.7, 1.5]), np.array([2.0, 3.0, 5.0])
PRIOR = PerezPrior()
NUMBER = jnp.asarray(1)  # of the sky; a table has no numbers


def closeness(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * max(1.0, np.abs(other).max()))


@pytest.mark.parametrize("fit_scale", [True, False])
@pytest.mark.parametrize("weighting", ["relative", "absolute", "log"])
def test_derivatives_of_a_sky(weighting, fit_scale):
    values = np.exp(RNG.normal(size=(3, 31)))
    problem, _, _ = single_sky.checked_problem(LIST, SUNS, values, weighting, fit_scale, PRIOR)

    def residuals(place):
        return problem.summary(NUMBER, place).residuals / np.sqrt(31)

    place = jnp.asarray(0.3 * RNG.normal(size=5))
    closeness(
        jax.jit(lambda place: problem.derivatives(NUMBER, place))(place),
        jax.jit(lambda p: least_squares.derivatives(residuals, p))(place),
    )


@pytest.mark.parametrize("weighting", ["relative", "absolute", "log"])
def test_derivatives_of_a_table(weighting):
    values = np.exp(RNG.normal(size=(3, 3, 31)))
    weight = RNG.uniform(0, 2, size=values.shape)
    problem = distribution.checked_problem(
        LIST, SUNS, TURBIDITY, values, None, weight, weighting, PRIOR
    )

    def residuals(place):
        table = problem.residuals(problem.coefficients(place)) * jnp.sqrt(problem.share)
        return table.ravel()

    place = jnp.asarray(0.3 * RNG.normal(size=10))
    closeness(
        jax.jit(lambda place: problem.derivatives(NUMBER, place))(place),
        jax.jit(lambda p: least_squares.derivatives(residuals, p))(place),
    )
