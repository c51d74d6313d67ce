"""Turbidity from skies whose turbidity is known."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_skies import FEW_NODES

import atmofit as af
from atmofit.fit.turbidity import estimate_turbidity
from atmofit.observe.observation import Observation

GRID = af.DirectionGrid(np.radians([8.0, 35.0, 62.0, 85.0]), np.radians([0.0, 50.0, 110.0, 180.0]))
SUN = np.radians(40.0)
FITTED = dataclasses.replace(af.PREETHAM_1999, turbidity_range=(2.0, 6.0))
AIR = af.Atmosphere.from_turbidity(2.0)
# One order on few nodes compiles in seconds; the search does not mind what sky it is.
PLAN = dataclasses.replace(
    af.plan_sky(AIR, quantity="luminance", orders=1, rtol=5e-2, dtype="float64"), nodes=FEW_NODES
)
MODELS = {"preetham": "preetham", "fitted": FITTED, "simulator": af.SimulatorModel(plan=PLAN)}


def luminance(name, turbidity, sun=SUN, directions=GRID):
    """What a model says."""
    if name == "simulator":
        return simulate(jnp.asarray(turbidity, float), jnp.asarray(sun, float), directions)
    model = FITTED if name == "fitted" else af.PREETHAM_1999
    return np.asarray(model(turbidity, sun, directions)[..., 2])


@jax.jit
def simulate(turbidity, sun, directions):
    air = af.Atmosphere.from_turbidity(turbidity)
    return af.simulate_luminance(air, sun, directions, plan=PLAN)


def observe(values, noise: float | np.ndarray = 0.01, sun=SUN, directions=GRID):
    return Observation(
        directions=directions, values=values, solar_zenith_angle=sun, relative_noise=noise
    )


def estimate(name, observation, **options):
    return estimate_turbidity(observation, MODELS[name], **options)


def noisy(name, turbidity, count, sun=SUN, noise=0.01):
    random = np.random.default_rng(7)
    exact = np.asarray(luminance(name, turbidity, sun))
    return exact * (1 + noise * random.standard_normal((count, *GRID.shape)))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("turbidity", [2.1, 3.3, 5.7])
def test_turbidity_comes_back_without_noise(name, turbidity):
    found = estimate(name, observe(luminance(name, turbidity)))
    assert found.converged
    assert not found.at_edge
    # The search ends where less than 1e-3 of the standard error remains.
    assert abs(found.value - turbidity) <= 1e-3 * found.standard_error
    assert found.reduced_chi_square <= 1e-6
    assert found.rms <= 1e-5
    assert found.steps <= 5  # seen: 2 or 3, which is what a search through the simulator costs


@pytest.mark.parametrize("name", MODELS)
def test_standard_error_is_that_of_finite_differences(name):
    noise = np.linspace(0.005, 0.03, 16).reshape(GRID.shape)
    values = noisy(name, 3.3, 1)[0]
    found = estimate(name, observe(values, noise))
    T, h = float(found.value), 1e-4
    above, below = (np.log(np.asarray(luminance(name, T + k * h))) for k in (1, -1))
    slope = (above - below) / (2 * h) / noise
    # The difference quotient is within h^2 of the slope, relative to the scale of T: 1e-8.
    np.testing.assert_allclose(found.standard_error, 1 / np.sqrt((slope**2).sum()), rtol=1e-6)
    residual = np.log(np.asarray(luminance(name, T)) / values) / noise
    np.testing.assert_allclose(found.reduced_chi_square, (residual**2).sum() / 15, rtol=1e-8)
    np.testing.assert_allclose(found.rms, np.sqrt(((residual * noise) ** 2).mean()), rtol=1e-8)
    # At a minimum the residuals have no part along the slope that a step could remove.
    assert abs((residual * slope).sum()) * found.standard_error <= 2e-3
    half = 1.959964 * found.standard_error
    np.testing.assert_allclose(found.interval, [T - half, T + half], rtol=1e-12)


@pytest.mark.parametrize(("name", "count"), [("preetham", 200), ("simulator", 100)])
def test_errors_are_as_large_as_their_standard_errors(name, count):
    found = [estimate(name, observe(values)) for values in noisy(name, 3.3, count)]
    assert all(one.converged and not one.at_edge for one in found)
    pulls = np.array([float((one.value - 3.3) / one.standard_error) for one in found])
    # Three standard deviations of the mean, of the standard deviation and of a share of 95 %.
    assert abs(pulls.mean()) <= 3 / np.sqrt(count)
    assert abs(pulls.std() - 1) <= 3 / np.sqrt(2 * count)
    assert (np.abs(pulls) <= 1.96).mean() >= 0.95 - 3 * np.sqrt(0.05 * 0.95 / count)
    chi_square = np.array([float(one.reduced_chi_square) for one in found])
    # Chi-square with 15 degrees of freedom has variance 30.
    assert abs(chi_square.mean() - 1) <= 3 * np.sqrt(30 / count) / 15


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("turbidity", [2.2, 5.5])
def test_every_start_ends_at_the_same_turbidity(name, turbidity):
    observation = observe(noisy(name, turbidity, 1, sun=0.2)[0], sun=0.2)
    ends = [
        estimate(name, observation, start=start) for start in (None, *np.geomspace(1.7, 12.0, 7))
    ]
    assert all(one.converged for one in ends)
    spread = np.ptp([float(one.value) for one in ends])
    assert spread <= 2e-3 * ends[0].standard_error  # each within 1e-3


def test_scan_finds_the_deeper_of_two_valleys():
    # Toward T = 1.64 the published luminance grows without bound, so a clear sky can be as bright
    # as a hazy one: a second valley, which a search from there does not leave.
    sun = np.radians(10.0)
    observation = observe(luminance("preetham", 9.0, sun), sun=sun)
    alone = estimate("preetham", observation, start=1.7, scan=False)
    scanned = estimate("preetham", observation, start=1.7)
    assert alone.converged
    assert alone.value < 2
    assert scanned.value == pytest.approx(9.0, abs=1e-4)
    assert scanned.reduced_chi_square < 1e-3 * alone.reduced_chi_square


@pytest.mark.parametrize("name", ["preetham", "simulator"])
@pytest.mark.parametrize("end", [0, 1])
def test_a_sky_beyond_the_range_ends_at_its_edge(name, end):
    asked = (2.0, 5.0)
    observation = observe(luminance(name, (1.75, 6.0)[end], sun=0.9), sun=0.9)
    found = estimate(name, observation, turbidity_range=asked)
    assert found.at_edge
    assert found.converged
    assert found.turbidity_range == asked
    assert found.value == pytest.approx(asked[end], abs=1e-4)
    assert asked[0] <= found.value <= asked[1]


def test_a_model_that_does_not_hold_the_sky_says_so():
    values = 2 * luminance("preetham", 3.0) * np.linspace(0.6, 1.4, 16).reshape(GRID.shape)
    found = estimate("preetham", observe(values))
    assert found.converged
    assert found.reduced_chi_square > 100
    scaled = found.scaled_by_residual()
    ratio = scaled.standard_error / found.standard_error
    assert ratio == pytest.approx(np.sqrt(found.reduced_chi_square))
    exact = estimate("preetham", observe(luminance("preetham", 3.0)))
    assert exact.scaled_by_residual().standard_error == exact.standard_error


def test_a_spectrum_is_integrated_with_its_noise():
    wavelength = np.arange(360.0, 811.0, 15.0)
    shape = np.linspace(1.3, 0.7, wavelength.size)
    per_watt = af.spectrum_to_XYZ(np.interp(np.arange(380.0, 781.0, 5.0), wavelength, shape),
                                  np.arange(380.0, 781.0, 5.0))[1]  # fmt: skip
    Y = luminance("preetham", 3.3)
    spectral = Observation(
        directions=GRID,
        values=np.asarray(Y)[..., None] / np.asarray(per_watt) * shape,
        wavelength_nm=wavelength,
        solar_zenith_angle=SUN,
        relative_noise=0.03,
    )
    photometric = spectral.to_luminance()
    found, noise = photometric.values, photometric.relative_noise
    np.testing.assert_allclose(found, Y, rtol=1e-5)  # both are linear between the same nodes
    random = np.random.default_rng(3)
    again = np.asarray(spectral.values[0, 0]) * (
        1 + 0.03 * random.standard_normal((4000, wavelength.size))
    )
    many = Observation(
        directions=af.Directions(np.zeros(4000), np.zeros(4000)),
        values=again,
        wavelength_nm=wavelength,
        solar_zenith_angle=SUN,
        relative_noise=0.03,
    )
    scatter = np.std(np.asarray(many.to_luminance().values)) / Y[0, 0]
    np.testing.assert_allclose(noise, scatter, rtol=3 / np.sqrt(2 * 4000))
    assert estimate("preetham", photometric).value == pytest.approx(3.3, abs=1e-4)


def test_changed_data_compile_nothing():
    def run(shift):
        directions = af.DirectionGrid(GRID.view_zenith_angle * (1 - shift), GRID.relative_azimuth)
        values = np.full(GRID.shape, 5e3) * (1 + shift)
        observation = observe(values, 0.01 + shift, SUN + shift, directions)
        return [
            float(estimate(name, observation, start=2.5 + shift).value)
            for name in ("preetham", "simulator")
        ]

    first = run(0.0)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event)
    )
    again, second = run(0.0), run(0.1)
    assert "/jax/core/compile/backend_compile_duration" not in compiled
    assert first == again
    assert not np.allclose(first, second)


@pytest.mark.slow
def test_single_precision():
    zenith, azimuth = np.asarray(GRID.view_zenith_angle), np.asarray(GRID.relative_azimuth)
    plans = {"preetham": None, "simulator": dataclasses.replace(PLAN, dtype="float32")}
    skies = {name: np.asarray(luminance(name, 3.3), np.float32) for name in plans}
    with jax.enable_x64(False):
        grid = af.DirectionGrid(zenith, azimuth)
        for name, plan in plans.items():
            model = "preetham" if plan is None else af.SimulatorModel(plan=plan)
            found = estimate_turbidity(
                observe(skies[name], directions=grid), model, start=3, scan=False
            )
            assert found.value.dtype == np.float32
            assert found.converged
            # Rounding of 256 units in each of 16 residuals: 0.01 standard errors.
            assert abs(found.value - 3.3) <= 0.02 * found.standard_error


VALUES = np.full(GRID.shape, 5e3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": VALUES[:2]}, r"values must have shape \[direction axes\] = \(4, 4\), got"),
        ({"values": VALUES * np.nan}, "values must be finite, got nan"),
        ({"values": VALUES - 5e3}, r"values must be above 0, got 0 \(16 of 16 values\)"),
        ({"relative_noise": 0.0}, "relative_noise must be above 0, got 0"),
        ({"relative_noise": np.inf}, "relative_noise must be finite, got inf"),
        ({"relative_noise": [0.1, 0.2]}, r"relative_noise must be a number or .* got \(2,\)"),
        ({"solar_zenith_angle": 1.6}, "solar_zenith_angle must be .* rad, got 1.6"),
        (
            {"directions": af.DirectionGrid([0.1, 0.2, 0.3, 1.6], GRID.relative_azimuth)},
            "view_zenith_angle must be .* got 1.6",
        ),
        (
            {"directions": af.Directions([0.1, 1.6], [0.0, 0.0]), "values": [1.0, 1.0]},
            "view_zenith_angle must be .* got 1.6",
        ),
        ({"wavelength_nm": [500.0, 600.0]}, r"\[direction axes, wavelength\] = \(4, 4, 2\), got"),
    ],
)
def test_bad_observations_are_refused(changes, message):
    arguments = {
        "directions": GRID,
        "values": VALUES,
        "solar_zenith_angle": SUN,
        "relative_noise": 0.01,
    }
    with pytest.raises(ValueError, match=message):
        estimate_turbidity(Observation(**(arguments | changes)))


@pytest.mark.parametrize(
    ("wavelength_nm", "message"),
    [
        (np.arange(400.0, 701.0, 10.0), "must cover 380 to 780 nm .* got 400 to 700 nm"),
        (np.array([380.0, 420.0, 780.0]), "must have gaps of at most 20 nm .* got 360 nm"),
        (np.arange(780.0, 379.0, -10.0), "wavelength_nm must increase, got 770 after 780"),
    ],
)
def test_spectra_that_give_no_luminance_are_refused(wavelength_nm, message):
    with pytest.raises(ValueError, match=message):
        Observation(
            directions=GRID,
            values=np.ones((*GRID.shape, wavelength_nm.size)),
            wavelength_nm=wavelength_nm,
            solar_zenith_angle=SUN,
            relative_noise=0.01,
        ).to_luminance()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "perez"}, 'model must be one of "preetham", "simulator", got \'perez\''),
        ({"turbidity_range": (1.0, 5.0)}, r"inside the model's 1.7 to 10, got \(1, 5\)"),
        ({"turbidity_range": (5.0, 3.0)}, r"must increase .* got \(5, 3\)"),
        ({"start": np.nan}, "start must be finite, got nan"),
        ({"start": [2.0, 3.0]}, r"start must be one number, got shape \(2,\)"),
        ({"scan": False}, "start must be given where scan is False, got None"),
        ({"max_steps": 0}, "max_steps must be at least 1, got 0"),
        (
            {"model": af.SimulatorModel(plan=af.plan_sky(AIR, quantity="sun"))},
            'plan must be for .* got "sun"',
        ),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        estimate_turbidity(observe(VALUES), **options)
