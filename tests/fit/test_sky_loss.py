"""Residuals without exposure and model error, against generalised least squares."""

import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.fit.model_error import PATTERNS, amplitudes_design, features, patterns

GRID = af.DirectionGrid(np.radians([8.0, 35.0, 62.0, 85.0]), np.radians([0.0, 50.0, 110.0, 180.0]))
SUN = 0.7
RANDOM = np.random.default_rng(4)
ERROR = af.ModelError.of_size(0.1, 0.05, 0.01)


def observe(channels="XYZ", exposure="known", mask: bool | np.ndarray = True, model=None):
    model = model or af.PREETHAM_1999
    xyY = model(3.0, SUN, GRID)
    XYZ = np.asarray(af.xyY_to_XYZ(xyY))
    values = XYZ if channels == "XYZ" else XYZ[..., 1]
    values = values * np.exp(0.02 * RANDOM.standard_normal(values.shape))
    return af.Observation(GRID, values, SUN, 0.02, channels=channels, exposure=exposure, mask=mask)


def problem_of(observation, error):
    found = af.turbidity_problem(observation, model_error=error)
    return found.sky, found.loss


@pytest.mark.parametrize("channels", ["luminance", "XYZ"])
def test_model_error_is_the_marginal_likelihood(channels):
    mask = np.ones(GRID.shape, bool)
    mask[1, 2] = False
    observation = observe(channels, mask=mask)
    error = af.ModelError(
        0.03 * RANDOM.standard_normal((5, 16)), ERROR.covariance + 1e-3 * np.ones((16, 16)), 0.01
    )
    sky, loss = problem_of(observation, error)
    even = jnp.ones_like(loss.precision)
    design = np.asarray(amplitudes_design(observation)).reshape(-1, 16)
    used = np.asarray(loss.precision) > 0
    assert used.sum() == 15 * len(observation.channel_names)
    noise = np.diag(np.full(used.sum(), 0.02**2 + 0.01**2))
    total = (
        noise + design[used] @ (np.asarray(error.covariance) + 1e-12 * np.eye(16)) @ design[used].T
    )
    for x in (-0.5, 0.1):
        place = jnp.asarray([x])
        at = features(loss.search.value(place)[0], jnp.asarray(SUN))
        mean = np.asarray(at @ error.mean)
        off = np.asarray(loss.log_ratio(sky, place))[used] - design[used] @ mean
        rows = loss.residuals(sky, even)(place)
        np.testing.assert_allclose(jnp.sum(rows**2), off @ np.linalg.solve(total, off), rtol=1e-7)


def test_an_unknown_exposure_is_the_best_one():
    observation = observe("luminance", exposure="unknown")
    sky, loss = problem_of(observation, None)
    off = np.asarray(loss.log_ratio(sky, jnp.asarray([0.2])))
    rows = loss.residuals(sky, jnp.ones_like(loss.precision))(jnp.asarray([0.2]))
    np.testing.assert_allclose(jnp.sum(rows**2), np.sum((off - off.mean()) ** 2) / 0.02**2)
    level = loss.linear(jnp.asarray([0.2]), jnp.asarray(off), jnp.ones_like(loss.precision))
    np.testing.assert_allclose(level, [off.mean()])


def test_each_channel_may_have_its_own_exposure():
    observation = observe("XYZ", exposure="each channel")
    sky, loss = problem_of(observation, None)
    off = np.asarray(loss.log_ratio(sky, jnp.asarray([0.2]))).reshape(-1, 3)
    rows = loss.residuals(sky, jnp.ones_like(loss.precision))(jnp.asarray([0.2]))
    left = (off - off.mean(axis=0)) / 0.02
    np.testing.assert_allclose(jnp.sum(rows**2), np.sum(left**2))


def test_outliers_count_less_and_the_others_as_before():
    observation = observe("luminance")
    values = np.array(observation.values)
    values[0, 1] *= 3
    sky, loss = problem_of(af.Observation(GRID, values, SUN, 0.02), None)
    place = loss.search.place(jnp.asarray([3.0]))
    ratio = loss.log_ratio(sky, place)
    share, _ = loss.robust_share(place, ratio, jnp.ones_like(ratio))
    weight = np.asarray(share).reshape(GRID.shape) ** 2
    assert weight[0, 1] < 0.05
    assert np.delete(weight.ravel(), 1).min() > 0.3


def test_patterns_have_their_names_and_are_finite_at_the_ends():
    ends = af.Directions([0.0, np.pi / 2, np.pi / 2, 0.6], [0.0, 0.0, np.pi, 0.0])
    found = patterns(ends, jnp.asarray(0.6))
    assert found.shape == (4, len(PATTERNS))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[3, 3:5], 1.0)  # at the sun


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 0.1), "level must be between 1e-06 and 10, got 0"),
        ((0.1, 11.0), "pattern must be .* got 11"),
        ((0.1, 0.1, -1.0), "rough must be .* got -1"),
    ],
)
def test_bad_model_errors_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        af.ModelError.of_size(*arguments)


def test_stored_model_errors_are_covariances_and_unknown_names_are_refused():
    for name in ("preetham", "simulator", "simulator all", "continental all", "atmofit_2026"):
        found = af.stored_model_error(name)
        assert np.linalg.eigvalsh(found.covariance).min() > 0
        assert 0 < found.rough < 0.1
    with pytest.raises(ValueError, match=r"model_error must be one of .* got 'weather'"):
        af.stored_model_error("weather")
    with pytest.raises(ValueError, match="mean and covariance must have shapes"):
        af.ModelError(np.zeros(3), np.eye(3), 0.1)
