"""Searches from many starts, the weakest direction, profiles; few directions, few compilations."""

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.fit import identifiability, identifiability_words, profile_likelihood
from atmofit.fit.distribution import fit_distribution
from atmofit.fit.identifiability import identify_distribution, identify_perez, identify_zenith
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.single_sky import fit_perez
from atmofit.fit.zenith import fit_zenith_luminance
from atmofit.geometry import Directions, scattering_angle
from atmofit.models.perez import perez
from atmofit.models.preetham import PREETHAM_1999

RNG = np.random.default_rng(12)
RINGS, AZIMUTHS = np.linspace(0.15, 1.5, 9), np.linspace(0, np.pi, 7)
VIEW = np.append(0.0, np.repeat(RINGS, 7))
DOME = Directions(VIEW, np.append(0.0, np.tile(AZIMUTHS, 9)))
SUN = 0.9
GAMMA = np.asarray(scattering_angle(*DOME.angles(), SUN))
NO_PRIOR = PerezPrior(strength=0.0)
# A clear sky; one without the sun's glow, so that C and D have no effect; one whose glow is so
# wide that it is a straight line.
SKIES = np.array(
    [[-0.9, -0.4, 4.0, -2.2, 0.3], [-0.9, -0.4, 0.0, -2.2, 0.0], [-0.5, -0.3, 0.6, -0.02, 0.1]]
)
CLEAN = np.array([30.0 * np.asarray(perez(c, VIEW, GAMMA)) for c in SKIES])
NOISY = CLEAN * (1 + 1e-3 * RNG.normal(size=CLEAN.shape))


@pytest.fixture(scope="module")
def noisy():
    return identify_perez(DOME, SUN, NOISY, starts=24)


@pytest.fixture(scope="module")
def exact():
    return identify_perez(DOME, SUN, CLEAN, starts=24, prior=NO_PRIOR)


def ends(found, fit):
    """Parameter numbers of a profile, and their intervals."""
    numbers = np.asarray(found.profile.parameter[fit])
    return numbers, np.asarray(found.profile.lower[fit]), np.asarray(found.profile.upper[fit])


def test_exact_sky_is_found_from_every_start(exact):
    assert exact.good[0].all()
    known = np.append(SKIES[0], 30.0)
    np.testing.assert_allclose(exact.estimate[0], known, rtol=1e-5)
    numbers, low, high = ends(exact, 0)
    assert (low < known[numbers]).all()
    assert (known[numbers] < high).all()
    assert (high - low < 0.01).all()


def test_noisy_sky(noisy):
    """Good from every start; estimates are the default fit's; intervals are those of its errors."""
    fit = fit_perez(DOME, SUN, NOISY)
    assert noisy.good[0].all()
    assert noisy.names == ("A", "B", "C", "D", "E", "scale")
    np.testing.assert_allclose(noisy.default[0], 1.0, atol=1e-6)
    own = np.asarray(noisy.standard_error[0])
    np.testing.assert_allclose(own, fit.standard_error[0], rtol=1e-3)
    np.testing.assert_allclose(
        noisy.estimate[0][:5] / own[:5], fit.coefficients[0] / own[:5], atol=1e-2
    )
    numbers, low, high = ends(noisy, 0)
    known = np.append(SKIES[0], 30.0)
    assert (low < known[numbers]).all()
    assert (known[numbers] < high).all()
    # The errors of 0.1 % are so small that the loss is a parabola, to a few per cent.
    np.testing.assert_allclose(high - low, 2 * 1.95996 * own[numbers], rtol=0.05)


def test_profile_is_a_parabola_with_the_standard_error(noisy):
    fit = 0
    for k, number in enumerate(np.asarray(noisy.profile.parameter[fit])):
        distance = (
            noisy.profile.value[fit, k] - noisy.estimate[fit, number]
        ) / noisy.standard_error[fit, number]
        near = np.abs(distance) <= 2.1
        assert near.sum() >= 9
        np.testing.assert_allclose(noisy.profile.rise[fit, k][near], distance[near] ** 2, atol=0.3)
        assert (np.diff(noisy.profile.value[fit, k]) > 0).all()


def test_weakest_direction_is_that_of_a_numeric_jacobian(noisy):
    c = np.asarray(noisy.estimate[0])

    def residuals(p):
        model = p[5] * np.asarray(perez(p[:5], VIEW, GAMMA))
        return (model / NOISY[0] - 1) / np.sqrt(VIEW.size)

    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5 * max(abs(c[k]), 0.1)
        columns.append((residuals(c + step) - residuals(c - step)) / (2 * step[k]))
    jacobian = np.array(columns).T
    norm = np.linalg.norm(jacobian, axis=0)
    _, stretch, axes = np.linalg.svd(jacobian / norm)
    np.testing.assert_allclose(noisy.column_norm[0], norm, rtol=1e-6)
    np.testing.assert_allclose(noisy.condition_number[0], stretch[0] / stretch[-1], rtol=1e-4)
    np.testing.assert_allclose(noisy.weakest_change[0], stretch[-1], rtol=1e-4)
    assert abs(axes[-1] @ np.asarray(noisy.weakest_direction[0])) == pytest.approx(1.0, abs=1e-6)
    assert np.asarray(noisy.weakest_direction[0])[np.abs(noisy.weakest_direction[0]).argmax()] > 0


@pytest.fixture(scope="module")
def loose():
    return identify_perez(DOME, SUN, NOISY, starts=24, prior=NO_PRIOR)


def test_sky_without_a_glow_leaves_D_open(loose):
    """C is 0 within its error, so that any D will do: first of the weakest, open at both ends."""
    numbers, low, high = ends(loose, 1)
    assert numbers[0] == 3
    assert np.isinf(low[0])
    assert np.isinf(high[0])
    assert identifiability_words.interval(loose, 0, (1,)).endswith("(open to open)")


def test_straight_glow_is_named(loose):
    """A glow that is a straight line: C, D and the scale go together, and only that is said."""
    assert float(loose.condition_number[2]) > 10 * float(loose.condition_number[0])
    leading = np.argsort(-np.abs(np.asarray(loose.weakest_direction[2])))[:2]
    assert set(leading) <= {2, 3, 5}
    words = identifiability_words.weakest_direction(loose, (2,))
    assert "the glow is" in words
    assert "together by only" in words
    assert identifiability_words.weakest_fit(loose) == (2,)


def test_other_data_do_not_compile_again(noisy):
    program: Any = identifiability._identify
    before = program._cached._cache_size()
    other = identify_perez(
        DOME, 0.5, 2.0 * NOISY[:, ::-1], starts=24, seed=5, prior=PerezPrior(2e-3)
    )
    assert program._cached._cache_size() == before
    assert np.isfinite(other.estimate).all()


@pytest.fixture(scope="module")
def table():
    suns, turbidity = np.array([0.2, 0.7, 1.2]), np.array([2.0, 6.0])
    view, azimuth = DOME.angles()
    gamma = np.asarray(scattering_angle(view[None, :], azimuth[None, :], suns[:, None]))
    skies = []
    for T in turbidity:
        c = PREETHAM_1999.luminance_distribution @ np.array([T, 1.0])
        skies.append(perez(c, VIEW[None, :], gamma) / perez(c, 0.0, suns)[:, None])
    values = np.array(skies) * (1 + 1e-3 * RNG.normal(size=(2, 3, VIEW.size)))
    return suns, turbidity, values


def test_joint_fit(table):
    suns, turbidity, values = table
    found = identify_distribution(DOME, suns, turbidity, values, starts=12)
    fit = fit_distribution(DOME, suns, turbidity, values)
    assert found.good.shape == (12,)
    assert found.good.mean() >= 0.95
    assert found.names[0] == "A at T=2"
    assert found.names[9] == "E at T=6"
    ends = np.concatenate([fit.coefficients(2.0), fit.coefficients(6.0)])
    errors = np.asarray(found.standard_error)
    np.testing.assert_allclose(found.estimate / errors, ends / errors, atol=2e-2)
    low, high = np.asarray(found.profile.lower), np.asarray(found.profile.upper)
    numbers = np.asarray(found.profile.parameter)
    assert (low < ends[numbers]).all()
    assert (ends[numbers] < high).all()
    stored = json.dumps(identifiability_words.to_dict({"Y": found}), allow_nan=False)
    assert json.loads(stored)["Y"]["parameters"] == list(found.names)


def test_zenith_form():
    turbidity, suns = np.arange(2.0, 7.0), np.linspace(0.0, 1.5, 12)
    T, s = np.meshgrid(turbidity, suns, indexing="ij")
    luminance = np.asarray(PREETHAM_1999.zenith(T, s))[..., 2]
    luminance = luminance * (1 + 0.01 * RNG.normal(size=T.shape))
    fit = fit_zenith_luminance(turbidity, suns, luminance)
    found = identify_zenith(fit)
    assert found.linear
    assert found.good.all()
    assert found.names == ("a", "b", "c", "d")
    # The inverse of the scaled normal matrix holds the variance inflation on its diagonal.
    scaled = np.asarray(fit.covariance) * np.outer(found.column_norm, found.column_norm)
    inflation = np.sqrt(np.diag(scaled) / (float(fit.rms) ** 2 / (60 - 4)))
    np.testing.assert_allclose(found.inflation, inflation, rtol=1e-6)
    direction = np.asarray(found.weakest_direction)
    variances = np.linalg.eigvalsh(scaled)
    assert direction @ scaled @ direction == pytest.approx(variances[-1], rel=1e-6)
    assert "together by only" in identifiability_words.weakest_direction(found)


def test_bad_input():
    with pytest.raises(ValueError, match="starts must be at least 1, got 0"):
        identify_perez(DOME, SUN, NOISY, starts=0)
    with pytest.raises(ValueError, match="values must be finite"):
        identify_perez(DOME, SUN, np.nan * NOISY)


def test_crossing():
    value = jnp.arange(5.0)
    crossing = jax.jit(profile_likelihood.crossing)
    np.testing.assert_allclose(crossing(value, value**2), 3.841459**0.5, rtol=1e-6)
    assert np.isinf(crossing(value, 0.1 * value))
    # Beside a search that failed, the next value outward.
    assert float(crossing(value, jnp.asarray([0.0, 1.0, jnp.nan, 9.0, 16.0]))) == 3.0
