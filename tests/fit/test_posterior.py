"""Profiles and samples against the parabola, where the problem is one."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import atmofit as af

DIRECTIONS = af.DirectionGrid(
    np.radians([8.0, 25.0, 42.0, 59.0, 76.0]), np.radians(np.arange(0.0, 321.0, 40.0))
)
MODEL, SUN = af.ATMOFIT_2026.only("colours"), np.radians(50.0)
LUMINANCE = np.asarray(MODEL.XYZ(3.0, SUN, DIRECTIONS, 0.3))[..., 1]
RANDOM = np.random.default_rng(2)
SEEN = LUMINANCE * np.exp(0.01 * RANDOM.standard_normal(LUMINANCE.shape))
SKY = af.Observation(DIRECTIONS, SEEN, SUN, 0.01)
FREE = ("turbidity", "albedo")


@pytest.fixture(scope="module")
def problem():
    return af.turbidity_problem(SKY, MODEL, free=FREE)


@pytest.fixture(scope="module")
def best(problem):
    return af.estimate_turbidity(problem)


@pytest.fixture(scope="module")
def samples(problem, best):
    return af.sample_turbidity(problem, best, samples=600, warmup=100)


def test_profile_is_the_parabola_of_a_good_sky(problem, best):
    found = af.profile_turbidity(problem, best)
    distance = (np.asarray(found.turbidity) - float(best.value)) / float(best.standard_error)
    # Narrow against the range, so the loss is nearly a parabola: third order within 3 %.
    np.testing.assert_allclose(found.rise, distance**2, rtol=0.05, atol=0.02)
    np.testing.assert_allclose([found.lower, found.upper], best.interval, rtol=1e-3)


def test_profile_of_turbidity_alone_follows_the_loss():
    alone = af.turbidity_problem(SKY, MODEL, known={"albedo": 0.3})
    found = af.profile_turbidity(alone, af.estimate_turbidity(alone), points=9)
    assert found.turbidity.shape == (9,)
    assert found.rise[4] == pytest.approx(0.0, abs=1e-6)
    assert found.lower < 3.0 < found.upper


def test_a_profile_that_ends_with_the_range_is_open():
    bright = af.Observation(DIRECTIONS, SEEN, SUN, 0.3, exposure="unknown")
    narrow = af.turbidity_problem(bright, MODEL, turbidity_range=(2.9, 3.1))
    found = af.profile_turbidity(narrow, af.estimate_turbidity(narrow))
    assert found.lower == -np.inf
    assert found.upper == np.inf


def test_draws_have_the_parabola_s_mean_and_covariance(samples):
    draws = np.asarray(samples.values).reshape(-1, 2)
    effective = np.asarray(samples.effective_samples)
    assert samples.divergences == 0
    assert effective.min() > 300
    assert np.abs(np.asarray(samples.r_hat) - 1).max() < 0.02
    best = samples.estimate
    error = np.asarray(best.standard_errors)
    # Four standard deviations of mean and standard deviation of so many independent draws; the
    # posterior's own skewness is below a tenth of its width.
    off = np.abs(draws.mean(axis=0) - np.asarray(best.parameters)) / error
    assert (off <= 4 / np.sqrt(effective) + 0.1).all()
    assert (np.abs(draws.std(axis=0) / error - 1) <= 4 / np.sqrt(2 * effective) + 0.05).all()
    correlation = np.asarray(best.covariance)[0, 1] / np.prod(error)
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(correlation, abs=0.1)


def test_intervals_hold_their_share(samples):
    low, high = np.asarray(samples.interval(0.9))
    draws = np.asarray(samples.values).reshape(-1, 2)
    inside = ((draws >= low) & (draws <= high)).mean(axis=0)
    np.testing.assert_allclose(inside, 0.9, atol=0.01)
    normal = stats.norm.ppf(0.95) * np.asarray(samples.estimate.standard_errors)
    np.testing.assert_allclose((high - low) / 2, normal, rtol=0.12)


def test_slopes_of_the_density_are_those_of_differences(problem):
    from atmofit.fit.posterior import log_posterior

    share = jnp.ones_like(problem.loss.precision)
    u, h = jnp.asarray([-0.2, 0.4]), 1e-5
    _, slope, _ = log_posterior(problem.sky, problem.loss, share, u)
    for k in range(2):
        ends = [
            log_posterior(problem.sky, problem.loss, share, u.at[k].add(s * h))[0] for s in (1, -1)
        ]
        np.testing.assert_allclose(slope[k], (ends[0] - ends[1]) / (2 * h), rtol=1e-5)


def test_bad_requests_are_refused(problem, best):
    with pytest.raises(ValueError, match="points must be between 5"):
        af.profile_turbidity(problem, best, points=3)
    with pytest.raises(ValueError, match="chains must be between 2 and 64, got 1"):
        af.sample_turbidity(problem, best, chains=1)
    with pytest.raises(ValueError, match="free must be given where the problem is made"):
        af.estimate_turbidity(problem, free=FREE)
    alone = af.turbidity_problem(SKY, MODEL)
    with pytest.raises(ValueError, match=r"estimate must be of the problem's .* got one of"):
        af.profile_turbidity(alone, best)
