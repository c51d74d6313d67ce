"""Fits of a slab of dust: Saturn's phase curve, all orders, what data leave open."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from atmofit.fit.dust import NAMES, RANGES, SlabView, fit_dust
from atmofit.geometry import DirectionGrid
from atmofit.media.slab import slab_single_scattering
from atmofit.media.slab_plan import SlabPlan
from atmofit.media.slab_solution import solve_slab
from atmofit.optics.particle_phases import phase_of_phase_angle, saturn_ring_phase

SATURN = {
    "optical_depth": 1.0,
    "single_scattering_albedo": 0.6,
    "backward_weight": 0.596,
    "forward_asymmetry": 0.5,
    "backward_asymmetry": -0.5,
}
TRUTH = np.array([SATURN[name] for name in NAMES])
PHASE_ANGLE = np.radians(np.linspace(5.0, 170.0, 40))
LOW = 0.05  # cosine of sun and observer, so that nearly every phase angle can be
VIEW_ANGLE = np.pi - PHASE_ANGLE
VIEW = SlabView(LOW, LOW, VIEW_ANGLE)
# As Blinn writes it, not as the fit does.
CURVE = np.asarray(
    0.6
    * phase_of_phase_angle(saturn_ring_phase(), PHASE_ANGLE)
    / (4 * np.pi)
    * slab_single_scattering(1.0, LOW, LOW)
)
NOISE = 0.02


def noisy(values, seed, noise=NOISE):
    return values * (1 + noise * np.random.default_rng(seed).standard_normal(values.size))


def ring_fit(seed, depth=1.0):
    return fit_dust(VIEW, noisy(CURVE, seed), known={"optical_depth": depth})


def closed_form(p, view):
    """The model once more, in NumPy and without guards: albedo, weight and both lobes."""
    mu, sun, angle = (np.asarray(x) for x in (view.view_cosine, view.solar_cosine, VIEW_ANGLE))
    lobes = [
        (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * np.cos(angle)) ** 1.5) for g in (p[2], p[3])
    ]
    seen = sun / (sun + mu) * (1 - np.exp(-(1 / mu + 1 / sun)))
    return p[0] * ((1 - p[1]) * lobes[0] + p[1] * lobes[1]) * seen


def test_exact_data_give_saturn_back():
    found = fit_dust(VIEW, CURVE, known={"optical_depth": 1.0})
    assert found.converged
    assert found.undetermined == ()
    # A search ends within 1e-3 standard errors.
    error = np.asarray(found.standard_error)
    np.testing.assert_array_less(np.abs(found.values - TRUTH), 1e-3 * error + 1e-9)
    np.testing.assert_allclose(found.predict(VIEW), CURVE, rtol=1e-4)
    assert found["backward_weight"] == found.values[2]
    np.testing.assert_allclose(found.phase(VIEW_ANGLE), saturn_ring_phase()(VIEW_ANGLE), rtol=1e-4)


def test_the_minimum_and_its_errors_are_scipys():
    data = noisy(CURVE, 3)
    found = ring_fit(3)
    best = scipy.optimize.least_squares(
        lambda p: np.log(closed_form(p, VIEW) / data) / NOISE, TRUTH[1:], xtol=1e-14, ftol=1e-14
    )
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    error = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(found.values[1:] - best.x), 2e-3 * error)
    # scipy's derivatives are differences, good to some 1e-7.
    np.testing.assert_allclose(found.standard_error[1:], error, rtol=1e-3)
    np.testing.assert_allclose(
        found.covariance[1:, 1:] / error[:, None] / error[None, :],
        covariance / error[:, None] / error[None, :],
        atol=1e-3,
    )
    assert found.standard_error[0] == 0
    np.testing.assert_allclose(found.reduced_chi_square, 2 * best.cost / 36, rtol=1e-5)


def test_standard_errors_cover_the_truth():
    fits = [ring_fit(seed) for seed in range(100, 140)]
    assert all(bool(f.converged) for f in fits)
    off = np.stack([(f.values - TRUTH)[1:] / f.standard_error[1:] for f in fits])
    # 40 independent noises: each share within one error is 0.683 ± 0.074, each scatter 1 ± 0.11,
    # each mean 0 ± 0.16; three of those, for four parameters.
    inside = np.mean(np.abs(off) < 1, axis=0)
    np.testing.assert_allclose(inside, 0.683, atol=3 * 0.074)
    np.testing.assert_allclose(np.std(off, axis=0), 1.0, atol=0.34)
    np.testing.assert_allclose(np.mean(off, axis=0), 0.0, atol=3 * 0.16)
    assert np.mean([f.reduced_chi_square for f in fits]) == pytest.approx(1.0, abs=0.12)


def test_other_data_compile_nothing():
    first = ring_fit(0)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event)
    )
    second = ring_fit(1, depth=0.7)
    assert "/jax/core/compile/backend_compile_duration" not in compiled
    assert not np.allclose(first.values, second.values)


def test_phase_angles_seen_from_the_earth_leave_the_lobes_open():
    angle = np.radians(np.linspace(0.2, 6.0, 40))
    view = SlabView(0.4, 0.4, np.pi - angle)
    model = saturn_ring_phase()(np.pi - angle) * slab_single_scattering(1.0, 0.4, 0.4)
    found = fit_dust(view, noisy(np.asarray(0.6 * model), 5), known={"optical_depth": 1.0})
    assert found.condition_number > 100
    assert {"backward_weight", "forward_asymmetry"} <= set(found.undetermined)
    assert "not determined" in str(found)
    # What was seen is explained all the same.
    assert found.reduced_chi_square < 1.6


def test_a_thin_slab_tells_depth_times_albedo_only():
    turns = np.linspace(0.0, np.pi, 40)
    view = SlabView.from_angles(2.6, 0.5, turns)
    model = 0.6 * np.asarray(
        saturn_ring_phase()(view.scattering_angle)
        * slab_single_scattering(0.002, view.view_cosine, view.solar_cosine)
    )
    lobes = {name: SATURN[name] for name in NAMES[3:]}
    found = fit_dust(view, noisy(model, 6), known=lobes)
    assert found.condition_number > 100
    assert found.undetermined == NAMES[:2]


DIRECTIONS = DirectionGrid(np.array([0.5, 1.2, 1.9, 2.6]), np.array([0.3, 1.0, 1.6, 2.2, 2.9]))
SUNS = (0.4, 1.1)
PLAN = SlabPlan(8, 8, 16)


@pytest.mark.slow
def test_all_orders():
    solved = solve_slab(
        optical_depth=0.8,
        single_scattering_albedo=0.9,
        phase=saturn_ring_phase(),
        solar_zenith_angle=np.array(SUNS),
        plan=PLAN,
    )
    data = np.asarray(solved.radiance(DIRECTIONS)).ravel()
    zenith = np.asarray(DIRECTIONS.view_zenith_angle)[None, :, None]
    azimuth = np.asarray(DIRECTIONS.relative_azimuth)[None, None, :]
    sun = np.array(SUNS)[:, None, None]
    shape = (2, 4, 5)
    view = SlabView.from_angles(
        *(np.broadcast_to(x, shape).ravel() for x in (zenith, sun, azimuth))
    )
    lobes = {name: SATURN[name] for name in NAMES[3:]}
    found = fit_dust(view, noisy(data, 7), orders="all", known=lobes, starts=1, plan=PLAN)
    assert found.converged
    truth = np.array([0.8, 0.9, 0.596])
    assert np.all(np.abs(found.values[:3] - truth) < 3.5 * found.standard_error[:3])
    # Light scattered once cannot explain the same.
    once = fit_dust(view, data, known=lobes)
    assert once.reduced_chi_square > 20


def test_a_view_from_angles_is_the_one_from_cosines():
    zenith, sun, azimuth = np.array([0.4, 1.0, 2.0, 2.9]), 0.8, np.array([0.1, 1.0, 2.0, 3.1])
    view = SlabView.from_angles(zenith, sun, azimuth).checked()
    np.testing.assert_allclose(view.relative_azimuth(), azimuth, atol=1e-7)
    np.testing.assert_allclose(view.view_cosine, np.abs(np.cos(zenith)), rtol=1e-12)
    side = np.array([-1, -1, 1, 1])
    np.testing.assert_allclose(view.solar_cosine, side * np.cos(sun), rtol=1e-12)


def test_bad_input_is_refused():
    cases = [
        ({"orders": "two"}, r'orders must be one of "single", "all"'),
        ({"radiance": -CURVE}, "radiance must be between 1e-30 and 1e\\+30 1/sr, got -"),
        ({"radiance": CURVE[:3]}, "must fit the 40 geometries"),
        ({"relative_noise": 0.0}, "relative_noise must be between 1e-06 and 0.5, got 0"),
        ({"known": {"depth": 1.0}}, "a name in known must be one of"),
        ({"known": {"optical_depth": 500.0}}, "optical_depth must be between 0.001 and 100"),
        ({"known": SATURN}, "known must leave a parameter"),
        ({"starts": 0}, "starts must be between 1 and 32"),
        ({"view": SlabView(0.0, 0.5, VIEW_ANGLE)}, "view_cosine must be between 1e-06 and 1"),
        ({"view": SlabView(1.0, 0.5, VIEW_ANGLE)}, "scattering_angle must be between 2.0944 and"),
    ]
    for change, message in cases:
        arguments = {"view": VIEW, "radiance": CURVE} | change
        with pytest.raises(ValueError, match=message):
            fit_dust(**arguments)
    few = SlabView(LOW, LOW, VIEW_ANGLE[:3])
    with pytest.raises(ValueError, match="radiance must be at least 5 for 5 free"):
        fit_dust(few, CURVE[:3])


def test_traced_bad_input_gives_nan():
    def depth(noise):
        return fit_dust(
            VIEW, CURVE, relative_noise=noise, known={"optical_depth": 1.0}, starts=1
        ).values

    assert np.isnan(jax.jit(depth)(jnp.asarray(0.7))[1:]).all()


def test_values_stay_in_their_ranges():
    """Data that no slab gives."""
    found = fit_dust(VIEW, 1e4 * CURVE, known={"optical_depth": 1.0})
    assert found.converged
    for (_, low, high), value in zip(RANGES.bounds, np.asarray(found.values), strict=True):
        assert low <= value <= high
    assert "single_scattering_albedo" in found.undetermined
