"""Least squares of a few confined parameters, against scipy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from atmofit.fit import few_parameters
from atmofit.fit.unknowns import Search, make_search

POINTS = np.linspace(0.0, 3.0, 40)
RANGES = {"turbidity": (1.0, 30.0), "albedo": (0.0, 1.0), "scale_height": (300.0, 6000.0)}


def residuals(x):
    """A curve that is not linear in any of three parameters."""
    t = jnp.asarray(POINTS)
    curve = jnp.exp(0.8 * x[0]) * jnp.cos(t * (1 + x[1])) + jnp.tanh(x[2]) * t
    return 20 * (curve - jnp.asarray(DATA))


TRUTH = np.array([0.3, -0.4, 0.5])
DATA = (
    np.exp(0.8 * TRUTH[0]) * np.cos(POINTS * (1 + TRUTH[1]))
    + np.tanh(TRUTH[2]) * POINTS
    + 0.05 * np.random.default_rng(0).standard_normal(POINTS.size)
)


@jax.jit
def descend(start):
    size = jnp.full(3, 30.0)
    rounding = few_parameters.rounding_of(jnp.asarray(100.0), 2e-16)
    return few_parameters.descend(residuals, start, size, rounding, 60, False)


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (-0.9, 0.5, 0.9), (0.9, -0.9, -0.5)])
def test_it_ends_where_scipy_does(start):
    found, converged, steps = descend(jnp.asarray(start))
    best = scipy.optimize.least_squares(
        lambda x: np.asarray(residuals(jnp.asarray(x))), TRUTH, bounds=(-1, 1), xtol=1e-14
    )
    assert converged
    assert steps < 40
    # What remains of the step is below 1e-3 standard errors.
    error = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    np.testing.assert_array_less(np.abs(found.place - best.x), 1e-3 * error)
    np.testing.assert_allclose(found.loss, 2 * best.cost, rtol=1e-6)


def test_a_minimum_beyond_an_end_leaves_the_others_free():
    def beyond(x):
        return jnp.stack([3 * (x[0] - 1.5), 5 * (x[1] - 0.2) + x[0], 1.0 * x[1]])

    size, rounding = jnp.full(2, 5.0), jnp.asarray(1e-12)
    found, converged, _ = few_parameters.descend(
        beyond, jnp.zeros(2), size, rounding, 60, exact=True
    )
    best = scipy.optimize.least_squares(
        lambda x: np.asarray(beyond(jnp.asarray(x))), [0.5, 0.0], bounds=(-1, 1), xtol=1e-14
    )
    assert converged
    np.testing.assert_array_equal(found.at_end, [True, False])
    np.testing.assert_allclose(found.place, best.x, atol=2e-4)


def test_look_gives_the_derivatives():
    x = jnp.asarray([0.1, 0.2, -0.3])
    exact = few_parameters.look(residuals, x, True)
    np.testing.assert_allclose(exact.slope, jax.jacfwd(residuals)(x), rtol=1e-12)
    loss = lambda x: 0.5 * jnp.sum(residuals(x) ** 2)  # noqa: E731
    np.testing.assert_allclose(exact.curvature, jax.hessian(loss)(x), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(exact.gradient, jax.grad(loss)(x), rtol=1e-10)


def test_scan_returns_the_valleys_deepest_first():
    def two_valleys(x):
        return jnp.stack([(x[0] - 0.6) * (x[0] + 0.5) * 4, 0.2 * (x[0] - 0.6)])

    places = few_parameters.scan(two_valleys, 24, jnp.asarray([0.0, 0.3]), 3)
    np.testing.assert_allclose(places[:2, 0], [0.6, -0.5], atol=0.03)
    np.testing.assert_array_equal(places[:, 1], 0.3)  # the second parameter stays


def search_of(**options) -> Search:
    free, allowed = ("albedo", "turbidity", "scale_height"), tuple(RANGES)
    arguments: dict[str, Any] = {
        "ranges": RANGES,
        "values": {},
        "priors": {},
        "dtype": jnp.dtype("float64"),
    }
    return make_search(free, allowed, **(arguments | options))


def test_values_and_places_are_inverse_and_slopes_are_theirs():
    search = search_of(values={"turbidity": 4.0})
    assert search.names == ("turbidity", "albedo", "scale_height")
    np.testing.assert_allclose(search.start, [4.0, 0.2, 1200.0])
    for x in (np.array([-1.0, -1.0, -1.0]), np.array([0.3, 0.9, -0.2]), np.ones(3)):
        np.testing.assert_allclose(search.place(search.value(jnp.asarray(x))), x, atol=1e-12)
    x = jnp.asarray([0.3, 0.9, -0.2])
    slope = jnp.diagonal(jax.jacfwd(search.value)(x))
    np.testing.assert_allclose(search.slope(x), slope, rtol=1e-12)
    np.testing.assert_allclose(search.value(jnp.zeros(3))[0], np.sqrt(30.0))  # even ratios


def test_a_prior_counts_distances_in_its_own_width():
    search = search_of(priors={"albedo": (0.3, 0.1), "scale_height": (2000.0, 500.0)})
    at = search.place(jnp.asarray([3.0, 0.45, 2500.0]))
    expected = [0.0, 1.5, np.log(2500 / 2000) / 0.25]
    np.testing.assert_allclose(search.prior_residuals(at), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"values": {"ozone_dobson": 1.0}}, "known may name .* got 'ozone_dobson'"),
        ({"values": {"albedo": 2.0}}, "albedo must be between 0 and 1, got 2"),
        ({"values": {"albedo": [0.1, 0.2]}}, "albedo must be one number"),
        ({"priors": {"albedo": (0.3, 0.0)}}, "prior of albedo must be a finite mean"),
        ({"priors": {"scale_height": (-1.0, 1.0)}}, "prior of scale_height must be"),
    ],
)
def test_bad_searches_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        search_of(**options)


def test_free_unknowns_are_checked():
    common: dict[str, Any] = {
        "ranges": RANGES, "values": {}, "priors": {}, "dtype": jnp.dtype("float64")
    }  # fmt: skip
    for free, message in (
        (("albedo",), 'free must contain "turbidity"'),
        (("turbidity", "albedo", "albedo"), "free must name each unknown once"),
        (("turbidity", "rain"), "free may name .* got 'rain'"),
    ):
        with pytest.raises(ValueError, match=message):
            make_search(free, tuple(RANGES), **common)
    common["priors"] = {"albedo": (0.2, 0.1)}
    with pytest.raises(ValueError, match="prior must be of free unknowns"):
        make_search(("turbidity",), tuple(RANGES), **common)
