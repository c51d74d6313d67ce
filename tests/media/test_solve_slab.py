"""Multiple scattering in slabs: conservation, composition, other codes, derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from measured_data import data_folder
from reference.data import directions, groups, needs

import atmofit as af

HAZE = af.HenyeyGreenstein(0.85)
GRID = af.DirectionGrid(np.radians([0.0, 40.0, 75.0, 105.0, 140.0, 180.0]), [0.0, 1.0, np.pi])
COARSE = af.SlabPlan(16, 16, 14)


def solve(
    depth: Any = 1.0, albedo: Any = 0.9, phase: Any = HAZE, sun: Any = 0.6, plan=COARSE, **more: Any
):
    return af.solve_slab(
        optical_depth=depth, single_scattering_albedo=albedo, phase=phase, solar_zenith_angle=sun,
        plan=plan, **more,
    )  # fmt: skip


@pytest.mark.reference
@pytest.mark.slow
@needs("planeparallel_sky_radiance.csv")
def test_radiance_agrees_with_nanodisort():
    """Another code's radiance below the slab, 4 cases x 2 depths x 2 albedos x 2 suns."""
    of_slab = {
        key: values
        for key, values in groups("planeparallel_sky_radiance.csv").items()
        if key[0].startswith("f_")
    }
    assert len(of_slab) == 16
    solve_64 = jax.jit(
        lambda tau, w, sun, dirs: solve(tau, w, HAZE, sun, af.SlabPlan(64, 64, 14)).radiance(dirs)
    )
    for (case, sun), columns in of_slab.items():
        assert columns["g"][0] == 0.85
        found = solve_64(
            columns["tauH"][0], columns["ssaH"][0], np.radians(sun), directions(columns)
        )
        # 1.4e-6 seen; the floor is the table's.
        np.testing.assert_allclose(
            found, columns["nanodisort"], rtol=1e-5, atol=1e-12, err_msg=case
        )


@pytest.mark.reference
@needs("slab_fluxes.csv")
def test_fluxes_agree_with_another_code():
    path = data_folder() / "reference" / "slab_fluxes.csv"
    table = np.genfromtxt(path, delimiter=",", names=True, usecols=range(1, 8))
    for row in table:
        found = solve(row["tau"], row["ssa"], HAZE, np.radians(row["sun_zenith"]))
        names = ("reflectance", "diffuse_transmittance", "direct_transmittance")
        for name in names:
            # 16 streams; the table has six digits.
            np.testing.assert_allclose(getattr(found, name), row[name], rtol=3e-3, atol=1e-12)


@pytest.mark.parametrize("phase", [HAZE, af.Rayleigh()], ids=["haze", "Rayleigh"])
@pytest.mark.parametrize("depth", [1e-6, 1.0, 1e3])
def test_white_slabs_keep_all_light(depth, phase):
    found = solve(depth, 1.0, phase, [0.0, 0.6, 1.5], af.SlabPlan(32, 32, 20))
    total = found.reflectance + found.diffuse_transmittance + found.direct_transmittance
    np.testing.assert_allclose(total, 1.0, atol=1e-10)


@pytest.mark.parametrize("streams", [8, 32])
def test_thick_slabs_keep_their_light_in_single_precision(streams):
    # Through 1e4 comes 1e-4 of the light, which the rounding of 20 doublings must not reach.
    def through(dtype, albedo, depth):
        with jax.enable_x64(dtype == "float64"):
            found = af.solve_slab(
                optical_depth=jnp.asarray(depth, dtype),
                single_scattering_albedo=jnp.asarray(albedo, dtype),
                phase=af.HenyeyGreenstein(jnp.asarray(0.0, dtype)),
                solar_zenith_angle=jnp.asarray(0.785, dtype),
                plan=af.SlabPlan(streams, 4, 20),
            )
            return float(found.reflectance), float(found.diffuse_transmittance)

    for depth in (1e3, 1e4):
        reflected, passed = through("float32", 1.0, depth)
        # A few roundings of a number of size 1.
        assert abs(1 - reflected - passed) < 1e-6
        np.testing.assert_allclose(passed, through("float64", 1.0, depth)[1], rtol=5e-3)
    # Absorption has an error of its own: 1 - albedo in float32.
    passed = through("float32", 1 - 2.0**-17, 5e3)[1]
    np.testing.assert_allclose(passed, through("float64", 1 - 2.0**-17, 5e3)[1], rtol=5e-3)


def test_white_slab_over_a_white_ground_sends_all_back():
    found = solve([0.5, 3.0], 1.0, (HAZE, af.Rayleigh()), 0.9, ground_albedo=1.0)
    np.testing.assert_allclose(found.reflectance, 1.0, atol=1e-12)


def test_two_halves_are_a_whole():
    whole = solve(3.0)
    halves = solve([1.2, 1.8])
    np.testing.assert_allclose(halves.reflectance, whole.reflectance, rtol=1e-7)
    # The first layers' series is good to 1e-7 for light that gets far.
    np.testing.assert_allclose(halves.radiance(GRID), whole.radiance(GRID), rtol=1e-6)


@pytest.mark.slow
def test_order_of_layers_matters_and_reciprocity_holds():
    """Exchanging sun and view of a stack leaves L / mu0 as it is, seen from above."""
    stack = ([0.7, 2.0], [0.8, 0.95], (af.Rayleigh(), HAZE))
    angles = np.array([0.4, 1.1])
    seen = [
        float(solve(*stack, sun=a).radiance(af.Directions([np.pi - b], [1.0]))[0] / np.cos(a))
        for a, b in (angles, angles[::-1])
    ]
    np.testing.assert_allclose(*seen, rtol=1e-10)
    turned = solve([2.0, 0.7], [0.95, 0.8], (HAZE, af.Rayleigh()), 0.4)
    ratio = np.asarray(turned.radiance(GRID) / solve(*stack, sun=0.4).radiance(GRID))
    assert np.abs(ratio - 1).max() > 0.05


def test_no_slab_shows_the_ground():
    found = solve(0.0, ground_albedo=0.3, sun=0.5)
    assert float(found.reflectance) == pytest.approx(0.3, abs=1e-12)
    up = np.asarray(found.radiance(GRID))[3:]
    np.testing.assert_allclose(up, 0.3 / np.pi * np.cos(0.5), rtol=1e-12)


def test_thin_slabs_scatter_once():
    found = solve(1e-7, 0.5, af.HenyeyGreenstein(0.3), 0.6).radiance(GRID)
    zenith, azimuth = GRID.angles()
    up = np.cos(np.asarray(zenith))
    factor = af.slab_single_scattering(1e-7, np.abs(up), np.where(up > 0, -1, 1) * np.cos(0.6))
    phase = af.HenyeyGreenstein(0.3)(af.scattering_angle(zenith, azimuth, 0.6))
    # What is scattered twice is of the order of the slanted depth.
    np.testing.assert_allclose(found, 0.5 * phase * factor, rtol=2e-6)


def test_suns_and_views_on_the_nodes_are_nothing_special():
    """Where discrete ordinates divide by zero."""
    node = float(np.arccos((np.polynomial.legendre.leggauss(8)[0][3] + 1) / 2))
    at, beside = (
        solve(2.0, sun=s).radiance(af.Directions([s, np.pi - s], [0.0, 2.0]))
        for s in (node, node + 1e-9)
    )
    np.testing.assert_allclose(at, beside, rtol=1e-6)


def test_convergence_with_streams():
    """Error falls faster than any fixed power: by over 30 from 8 to 16 to 32 streams."""
    exact = np.asarray(solve(2.0, plan=af.SlabPlan(64, 64, 14)).radiance(GRID))
    errors = [
        np.abs(np.asarray(solve(2.0, plan=af.SlabPlan(n, n, 14)).radiance(GRID)) / exact - 1).max()
        for n in (8, 16, 32)
    ]
    assert errors[1] < errors[0] / 5
    assert errors[2] < errors[1] / 30


@pytest.mark.slow
@pytest.mark.parametrize("at", [(1.5, 0.9, 0.7), (300.0, 0.999, 0.85), (1e-3, 1.0, 0.0)])
def test_slopes_agree_with_differences(at):
    def seen(values):
        found = solve(values[0], values[1], af.HenyeyGreenstein(values[2]))
        return jnp.append(found.radiance(GRID).ravel(), found.reflectance)

    values = jnp.asarray(at)
    slope = jax.jit(jax.jacfwd(seen))(values)
    step = np.array([1e-5 * at[0], -1e-6, 1e-6])
    for k in range(3):
        d = step[k] * np.eye(3)[k]
        ends = [np.asarray(seen(values + n * d)) for n in (0, 1, 2)]
        difference = (-3 * ends[0] + 4 * ends[1] - ends[2]) / (2 * step[k])  # one-sided: albedo 1
        np.testing.assert_allclose(slope[:, k], difference, rtol=2e-4, atol=1e-6)
    weights = jnp.linspace(0.5, 1.5, slope.shape[0])
    reverse = jax.jit(jax.grad(lambda v: seen(v) @ weights))(values)
    np.testing.assert_allclose(reverse, weights @ slope, rtol=1e-8)


def test_single_precision_is_near():
    exact = np.asarray(solve(5.0, 0.95).radiance(GRID))
    with jax.enable_x64(False):
        found = solve(np.float32(5.0), np.float32(0.95), HAZE, np.float32(0.6)).radiance(GRID)
        assert found.dtype == np.float32
    np.testing.assert_allclose(found, exact, rtol=1e-4)  # the phase function of cos 3e-4 beside


def test_changed_values_compile_nothing():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event)
    )
    solve(2.0).radiance(GRID)
    compiled.clear()
    solve(3.0, 0.8, af.HenyeyGreenstein(0.5), 0.9).radiance(GRID)
    assert "/jax/core/compile/backend_compile_duration" not in compiled


@pytest.mark.slow
def test_a_plan_takes_what_it_needs():
    case = {"single_scattering_albedo": 0.9, "solar_zenith_angle": 0.6, "rtol": 1e-2}
    smooth = af.plan_slab(optical_depth=1.0, phase=af.Rayleigh(), **case)
    sharp = af.plan_slab(optical_depth=1.0, phase=af.HenyeyGreenstein(0.75), **case)
    assert smooth.streams <= 16
    assert smooth.modes <= 4
    assert sharp.streams > smooth.streams
    assert dict(sharp.errors)[sharp.streams] <= 1e-2
    assert "left out: azimuthal modes from" in str(smooth)
    assert "left out: a ground" in str(smooth)
    overhead = case | {"solar_zenith_angle": 0.0}
    assert af.plan_slab(optical_depth=1.0, phase=af.Rayleigh(), **overhead).modes == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: solve(-1.0), "optical_depth must be between 0 and 10000"),
        (lambda: solve(1.0, 1.5), "single_scattering_albedo must be"),
        (lambda: solve([1.0, 2.0], [0.1, 0.2, 0.3]), "numbers or lists of one length"),
        (lambda: solve([1.0, 2.0], 0.5, (HAZE,)), "phase must be one or 2"),
        (lambda: solve(1.0, sun=2.0), "solar_zenith_angle must be between"),
        (lambda: solve(1.0, ground_albedo=-0.5), "ground_albedo must be"),
        (lambda: solve(1.0).radiance(af.Directions([4.0], [0.0])), "view_zenith_angle must be"),
        (lambda: af.SlabPlan(7), "streams must be even"),
        (lambda: af.SlabPlan(8, 9), "modes must be between 1 and streams = 8"),
        (lambda: af.SlabPlan(8, 8, 0), "doublings must be"),
    ],
)
def test_bad_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_traced_plan_is_refused():
    with pytest.raises(TypeError, match="plan_slab must be known"):
        jax.jit(
            lambda tau: (
                af.plan_slab(
                    optical_depth=tau,
                    single_scattering_albedo=0.9,
                    phase=HAZE,
                    solar_zenith_angle=0.1,
                ).streams
            )
        )(1.0)


def test_traced_bad_values_give_nan():
    assert np.isnan(jax.jit(lambda tau: solve(tau).reflectance)(-1.0))
