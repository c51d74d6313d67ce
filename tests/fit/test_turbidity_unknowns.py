"""Exposure, masks, clouds, ground and sun beside turbidity; many skies at once; intervals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af

DIRECTIONS = af.DirectionGrid(
    np.radians([8.0, 25.0, 42.0, 59.0, 76.0]), np.radians(np.arange(0.0, 321.0, 40.0))
)
MODEL, SUN, T = af.ATMOFIT_2026.only("colours"), np.radians(50.0), 3.0
EXACT = np.asarray(MODEL.XYZ(T, SUN, DIRECTIONS, 0.3))
RANDOM = np.random.default_rng(11)
NOISY = EXACT * np.exp(0.01 * RANDOM.standard_normal(EXACT.shape))


def observe(values=NOISY, **changes):
    observation = af.Observation(DIRECTIONS, values, SUN, 0.01, channels="XYZ")
    return dataclasses.replace(observation, **changes)


def estimate(observation, **options):
    return af.estimate_turbidity(observation, MODEL, known={"albedo": 0.3}, **options)


def pull(found, truth=T):
    return abs(float((found.value - truth) / found.standard_error))


def test_an_unknown_exposure_costs_certainty_only():
    known = estimate(observe())
    unknown = estimate(observe(1e-4 * NOISY, exposure="unknown"))
    white = estimate(observe(NOISY * np.array([2.0, 1.0, 0.5]), exposure="each channel"))
    for found in (known, unknown, white):
        assert found.converged
        assert pull(found) <= 3.5
    assert known.standard_error < unknown.standard_error < white.standard_error
    np.testing.assert_allclose(unknown.explained, np.log(1e4), atol=0.01)


def test_masked_directions_may_hold_anything():
    used = np.ones(DIRECTIONS.shape, bool)
    used[0, :3] = False
    spoilt = np.where(used[..., None], NOISY, np.nan)
    spoilt[0, 1] = -5.0
    found = estimate(observe(spoilt, mask=used))
    assert pull(found) <= 3.5
    assert np.isnan(found.log_ratio[0, 0]).all()
    assert found.weight[0, 0] == 0.0
    assert np.isfinite(np.asarray(found.log_ratio)[used]).all()


def test_clouds_are_found_and_do_not_matter_much():
    cloudy = NOISY.copy()
    cloudy[2:4, 3:5] *= 2.0
    plain, robust = estimate(observe(cloudy)), estimate(observe(cloudy), robust=True)
    assert abs(float(robust.value) - T) < 0.2 * abs(float(plain.value) - T)
    weight = np.asarray(robust.weight)
    assert weight[2:4, 3:5].max() < 0.1
    assert np.delete(weight.ravel(), [21, 22, 30, 31]).min() > 0.3


def test_ground_and_turbidity_come_back_together():
    found = af.estimate_turbidity(observe(), MODEL, free=("albedo", "turbidity"))
    assert found.names == ("turbidity", "albedo")
    error = np.asarray(found.parameters) - [T, 0.3]
    assert error @ np.linalg.solve(np.asarray(found.covariance), error) <= 14  # 0.1 % of chi-square
    assert found.untold == ()


def test_the_sun_is_found():
    turned = af.DirectionGrid(DIRECTIONS.view_zenith_angle, DIRECTIONS.relative_azimuth + 0.1)
    observation = observe(directions=turned, solar_zenith_angle=jnp.asarray(SUN + 0.08))
    found = estimate(observation, free=("turbidity", "solar_zenith_angle", "solar_azimuth"))
    np.testing.assert_allclose(found.parameters[1:], [SUN, 0.1], atol=2e-3)
    assert pull(found) <= 3.5


@pytest.mark.slow
def test_what_a_sky_does_not_tell_is_said():
    few = af.Directions(np.radians([5.0, 10.0, 15.0]), np.radians([0.0, 120.0, 240.0]))
    values = np.asarray(MODEL.XYZ(T, SUN, few, 0.3))[:, 1]
    observation = af.Observation(few, values, SUN, 0.2, exposure="unknown")
    found = af.estimate_turbidity(observation, MODEL, free=("turbidity", "albedo"))
    assert "albedo" in found.untold
    told = af.estimate_turbidity(
        observation, MODEL, free=("turbidity", "albedo"), prior={"albedo": (0.3, 0.01)}
    )
    np.testing.assert_allclose(told.parameters[1], 0.3, atol=0.01)


def test_many_skies_at_once_are_those_alone():
    skies = np.stack([NOISY, EXACT, 1.05 * EXACT])
    suns = jnp.full(3, SUN)

    def one(values, sun):
        return estimate(observe(values, solar_zenith_angle=sun))

    together = jax.jit(jax.vmap(one))(jnp.asarray(skies), suns)
    for k, values in enumerate(skies):
        alone = one(values, suns[k])
        np.testing.assert_allclose(together.value[k], alone.value, rtol=1e-6)
        np.testing.assert_allclose(together.standard_error[k], alone.standard_error, rtol=1e-4)


def test_a_model_error_widens_the_interval_to_hold_a_wrong_level():
    wrong = 1.15 * EXACT
    bare = estimate(observe(wrong))
    careful = estimate(observe(wrong), model_error=af.ModelError.of_size(0.15, 0.02))
    assert pull(bare) > 10
    assert pull(careful) <= 2
    named = estimate(observe(wrong), model_error="atmofit_2026")
    assert named.standard_error > 3 * bare.standard_error


@pytest.mark.slow
def test_spectra_and_cameras():
    λ = np.arange(400.0, 701.0, 20.0)
    model = af.ATMOFIT_2026
    radiance = np.asarray(model.radiance(T, SUN, DIRECTIONS, λ, 0.3))
    spectral = af.Observation(DIRECTIONS, radiance, SUN, 0.01, wavelength_nm=λ)
    found = af.estimate_turbidity(spectral, model, known={"albedo": 0.3})
    assert found.value == pytest.approx(T, abs=1e-4)
    assert found.log_ratio.shape == (*DIRECTIONS.shape, λ.size)
    camera = af.Camera((400.0, 500.0, 600.0, 700.0), ((0.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 0.0)))
    wide = np.arange(380.0, 781.0, 10.0)
    fine = np.asarray(model.radiance(T, SUN, DIRECTIONS, wide, 0.3))
    curves = np.array([np.interp(wide, camera.wavelength_nm, row) for row in camera.sensitivity])
    seen = np.trapezoid(fine[..., None, :] * curves, wide, axis=-1)
    observation = af.Observation(DIRECTIONS, seen, SUN, 0.01, channels=camera)
    found = af.estimate_turbidity(observation, model, known={"albedo": 0.3})
    assert found.value == pytest.approx(T, abs=0.01)  # another rule of integration


def test_single_precision_data_are_searched_in_double_precision():
    narrow = jax.tree.map(
        lambda leaf: leaf if leaf.dtype == bool else leaf.astype(jnp.float32), observe()
    )
    found, exact = estimate(narrow), estimate(observe())
    assert found.converged
    assert found.value.dtype == np.float64
    np.testing.assert_allclose(found.value, exact.value, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"mask": np.zeros(DIRECTIONS.shape, bool)}, {}, "mask must leave at least one direction"),
        ({"exposure": "unknown", "noise_floor": -1.0}, {}, "noise_floor must be at least 0"),
        ({}, {"free": ("turbidity", "ozone_dobson")}, "free may name .* got 'ozone_dobson'"),
        ({}, {"model_error": "weather"}, "model_error must be one of .* got 'weather'"),
        ({}, {"starts": 0}, "starts must be between 1 and 32, got 0"),
    ],
)
def test_bad_requests_are_refused(changes, options, message):
    with pytest.raises(ValueError, match=message):
        estimate(observe(**changes), **options)


def test_structure_is_checked():
    with pytest.raises(ValueError, match="mask must have the shape of the directions"):
        observe(mask=np.ones(3, bool))
    with pytest.raises(ValueError, match='exposure must be one of "known"'):
        observe(exposure="guessed")
    with pytest.raises(ValueError, match='channels must be one of "luminance"'):
        observe(channels="HSV")
    spectra = af.Observation(DIRECTIONS, EXACT, SUN, 0.01, wavelength_nm=[450.0, 550.0, 650.0])
    with pytest.raises(ValueError, match="observation must be of luminance or colour"):
        af.estimate_turbidity(spectra, "preetham")
    with pytest.raises(ValueError, match="observation must be of colours"):
        af.estimate_turbidity(spectra, MODEL)
    with pytest.raises(ValueError, match="sensitivity must hold 2 values"):
        af.Camera((400.0, 500.0), ((1.0,),))


@pytest.mark.parametrize("exposure", ["known", "each channel"])
def test_predicted_spread_is_that_of_the_linear_posterior(exposure):
    error = af.ModelError.of_size(0.05, 0.02, 0.0)
    problem = af.turbidity_problem(
        observe(exposure=exposure), MODEL, free=("turbidity", "albedo"), model_error=error
    )
    found = af.estimate_turbidity(problem)
    loss, place = problem.loss, problem.loss.search.place(found.parameters)
    h = 1e-5
    slopes = [
        (loss.log_ratio(problem.sky, place + step) - loss.log_ratio(problem.sky, place - step))
        / (2 * h)
        for step in h * np.eye(2)
    ]
    # The dense normal equations of all unknowns; 3 is one over the variance of an even spread.
    rows = np.column_stack([*slopes, loss.design])
    weight = np.asarray(loss.precision) ** 2
    information = rows.T @ (weight[:, None] * rows)
    information += np.diag([0.0, 3.0, *np.asarray(loss.informed)])
    variance = 1 / weight + np.sum(rows * np.linalg.solve(information, rows.T).T, axis=1)
    # Forward derivatives against central differences of step 1e-5: 1e-9 of the slopes.
    np.testing.assert_allclose(
        np.asarray(found.predicted_spread).ravel(), np.sqrt(variance), rtol=1e-6
    )
    # Of as many numbers with one degree of freedom each, six standard deviations.
    assert np.nanstd(found.standardised) == pytest.approx(1.0, abs=6 / np.sqrt(2 * 135))
