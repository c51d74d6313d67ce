"""Paths through air against quadrature and a differential equation that share no code with them."""

import itertools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import atmofit as af
from atmofit.media.path_planning import LADDER

RANDOM = np.random.default_rng(3)
BLUE = 450.0
EXACT = af.PathPlan("gauss", 64)


def air_of(turbidity):
    return af.low_air(af.Atmosphere.from_turbidity(turbidity), [BLUE])


def oracle(air, distance, zenith, altitude):
    """Integral of each scatterer's density times transmittance, adaptive and in pieces."""
    extinction, decay = np.asarray(air.extinction)[:, 0], np.asarray(air.decay)
    upward = np.cos(zenith)

    def depth(x):
        y = decay * upward * x
        safe = np.where(np.abs(y) < 1e-8, 1.0, y)
        mean = np.where(np.abs(y) < 1e-8, 1 - y / 2, -np.expm1(-safe) / safe)
        return np.sum(extinction * np.exp(-decay * altitude) * x * mean)

    share = np.geomspace(1e-6, 1.0, 30)
    pieces = np.unique(np.clip(np.concatenate([[0.0], share, 1 - share, [1.0]]), 0, 1)) * distance
    return [
        sum(
            quad(
                lambda x, a=a: np.exp(-a * (altitude + x * upward) - depth(x)), *ends, epsrel=1e-11
            )[0]
            for ends in itertools.pairwise(pieces)
        )
        for a in decay
    ]


def random_paths(count):
    """1 m to 300 km, up, level and down, ending above the ground."""
    distance = 10 ** RANDOM.uniform(0, np.log10(3e5), count)
    zenith = RANDOM.uniform(0.0, np.pi, count)
    zenith[::5] = np.pi / 2 + 1e-3 * RANDOM.standard_normal(zenith[::5].size)
    altitude = np.maximum(-distance * np.cos(zenith), 0.0) + 10 ** RANDOM.uniform(0, 4, count)
    return distance, zenith, np.minimum(altitude, 1e5) + np.where(altitude > 1e5, np.nan, 0.0)


def test_quadrature_is_exact():
    distance, zenith, altitude = random_paths(60)
    checked = 0
    for s, z, h in zip(distance, zenith, altitude, strict=True):
        if np.isnan(h):
            continue
        air = air_of(RANDOM.uniform(1.0, 30.0))
        truth = oracle(air, s, z, h)
        for nodes, rtol in ((64, 1e-9), (16, 1e-4)):
            plan = af.PathPlan("gauss", nodes)
            found = af.path_transfer(air, af.Path(s, z, h), 1.0, plan).integrals[:, 0]
            np.testing.assert_allclose(found, truth, rtol=rtol)
        checked += 1
    assert checked >= 40


@pytest.mark.slow
def test_plans_keep_their_tolerance_in_ten_thousand_random_cases():
    chosen = set()
    for _ in range(100):
        air = air_of(RANDOM.uniform(1.0, 30.0))
        longest = 10 ** RANDOM.uniform(1, np.log10(3e5))
        low = RANDOM.uniform(0.3, np.pi / 2)
        high = min(low + RANDOM.uniform(0.0, 1.0), np.pi)
        # So high that no way leads below the ground.
        eye = max(-longest * np.cos(high), 0.0)
        eyes = (eye, min(eye + 10 ** RANDOM.uniform(0, 3.5), 1e5))
        if eyes[0] > eyes[1]:
            continue
        rtol = 10 ** RANDOM.uniform(-5, -1)
        plan = af.plan_path(air, (1.0, longest), (low, high), eyes, rtol)
        chosen.add(plan.name)
        path = af.Path(
            longest ** RANDOM.random(100),
            RANDOM.uniform(low, high, 100),
            RANDOM.uniform(*eyes, 100),
        )
        found, exact = (af.path_transfer(air, path, 1.0, p) for p in (plan, EXACT))
        error = np.abs(np.asarray(found.integrals / exact.integrals) - 1).max()
        passing = np.abs(np.asarray(found.transmittance - exact.transmittance)).max()
        assert max(error, passing) <= rtol, (plan.name, longest, low, high, eyes)
    assert {"constant", "horizontal"} < chosen
    assert len(chosen) >= 6


def test_the_hermite_form_is_refused_where_it_is_wrong():
    air = air_of(2.0)
    good = dict(af.plan_path(air, (1.0, 2e3), (0.0, 1.5), rtol=1e-7).errors)
    far = dict(af.plan_path(air, (1.0, 8e4), (0.0, 1.5), rtol=1e-8).errors)
    assert good["hermite"] < 0.02
    assert far["hermite"] > 1.0
    plan = af.plan_path(air, (1.0, 8e4), (0.0, 1.5), rtol=1e-3)
    assert plan.solver == "gauss"
    assert dict(plan.errors)[plan.name] <= 1e-3
    assert "hermite: error" in str(plan)


@pytest.mark.parametrize(
    ("solver", "zenith_deg", "climb", "least", "most"),
    # How far off the haze's integral is by the climb in scale heights, as found in advance by
    # other code: .1 % at .036 and 1 % at .124; 1 % at 2.1, 10 % at 4.0, x 110 at 12.5, 1e13 at 42.
    [
        ("horizontal", 89.0, 0.036, 8e-4, 1.5e-3),
        ("horizontal", 89.0, 0.124, 8e-3, 1.5e-2),
        ("hermite", 80.0, 2.1, 5e-3, 2e-2),
        ("hermite", 80.0, 4.0, 5e-2, 0.2),
        ("hermite", 80.0, 12.5, 50.0, 300.0),
        ("hermite", 80.0, 42.0, 3e12, 1e14),
    ],
)
def test_closed_forms_are_as_wrong_as_was_found_elsewhere(solver, zenith_deg, climb, least, most):
    air = af.low_air(af.Atmosphere.from_turbidity(2.0), [550.0])
    zenith = np.radians(zenith_deg)
    path = af.Path(climb * 1.2e3 / np.cos(zenith), zenith)
    found, exact = (
        af.path_transfer(air, path, 1.0, plan).integrals[1, 0]
        for plan in (af.PathPlan(solver, 0), EXACT)
    )
    assert least <= abs(found / exact - 1) <= most


@pytest.mark.parametrize(("x64", "rtol"), [(True, 1e-10), (False, 1e-5)])
def test_hoffman_s_form_solves_the_differential_equation(x64, rtol):
    with jax.enable_x64(True):
        air = air_of(3.0)
        extinction = air.extinction[:, 0]
        distances = np.geomspace(1e-2, 1e6, 25)

        def slope(_, radiance, __):
            return -jnp.sum(extinction) * radiance + extinction[0]

        solved = diffrax.diffeqsolve(
            diffrax.ODETerm(slope), diffrax.Dopri8(), 0.0, 1e6, 1e-2, jnp.asarray(0.0),
            stepsize_controller=diffrax.PIDController(rtol=1e-13, atol=1e-20),
            saveat=diffrax.SaveAt(ts=jnp.asarray(distances)), max_steps=20_000,
        )  # fmt: skip
        truth = np.asarray(solved.ys)
    with jax.enable_x64(x64):
        source = np.zeros((25, 2, 1))
        source[:, 0, 0] = extinction[0]
        found = af.path_transfer(
            jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, float)), air),
            af.Path(jnp.asarray(distances), jnp.asarray(np.pi / 2)),
            jnp.asarray(source),
            af.PathPlan("constant", 0),
        )
        # The solver's own tolerance is 1e-13 a step.
        np.testing.assert_allclose(found.in_scattered[:, 0], truth, rtol=rtol)


@pytest.mark.parametrize("plan", [*LADDER[:2], af.PathPlan()], ids=lambda p: p.name)
def test_transfer_composes(plan):
    """Without falling density one way after another is one way."""
    air = air_of(4.0)
    level = jnp.asarray(np.pi / 2)
    once, first, rest = (
        af.path_transfer(air, af.Path(s, level, 100.0), 1.0, plan) for s in (900.0, 300.0, 600.0)
    )
    np.testing.assert_allclose(once.transmittance, first.transmittance * rest.transmittance, 1e-12)
    np.testing.assert_allclose(once(2.0), first(rest(2.0)), rtol=1e-6)


def test_sky_is_what_a_long_path_adds():
    """With a source equal to the extinction, light in balance stays as it is."""
    air = af.low_air(af.Atmosphere(molecules=af.Molecules()), [450.0, 650.0])
    source = jnp.broadcast_to(air.extinction, (3, 1, 2))
    path = af.Path([10.0, 1e4, 1e6], 1.2, 0.0)
    found = af.path_transfer(air, path, source, af.PathPlan("gauss", 32))
    np.testing.assert_allclose(found(1.0), 1.0, rtol=1e-10)


def test_changed_values_compile_nothing():
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event)
    )
    af.path_transfer(air_of(2.0), af.Path(1e3, 1.5, 10.0), 1.0)
    compiled.clear()
    af.path_transfer(air_of(5.0), af.Path(2e3, 1.4, 20.0), 1.0)
    assert "/jax/core/compile/backend_compile_duration" not in compiled


def test_single_precision_is_near():
    distance, zenith, altitude = random_paths(200)
    known = ~np.isnan(altitude)
    path = [x[known] for x in (distance, zenith, altitude)]
    exact = af.path_transfer(air_of(3.0), af.Path(*path), 1.0)
    with jax.enable_x64(False):
        found = af.path_transfer(air_of(3.0), af.Path(*map(jnp.asarray, path)), 1.0)
        assert found.integrals.dtype == np.float32
    # Altitudes to 1e5 m over scale heights of 1.2e3 m: 83 roundings of 6e-8, and some.
    np.testing.assert_allclose(found.integrals, exact.integrals, rtol=3e-5)
    np.testing.assert_allclose(found.transmittance, exact.transmittance, atol=1e-5)


def test_what_lies_aloft_is_left_out():
    whole = af.Atmosphere.standard(af.Haze(0.1), ozone_dobson=300.0)
    air = af.low_air(whole, [450.0, 550.0])
    assert air.left_out == 1
    assert air.extinction.shape == (2, 2)
    # Sea-level Rayleigh scattering of standard air at 550 nm: Bodhaine et al. (1999), 1.149e-5.
    assert air.extinction[0, 1] == pytest.approx(1.149e-5, rel=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: af.Path(-1.0, 1.0).checked(), "distance must be between 0 and"),
        (lambda: af.Path(1.0, 4.0).checked(), "view_zenith_angle must be"),
        (lambda: af.Path(1e4, 3.0, 100.0).checked(), "altitude of the path's end must be"),
        (lambda: af.path_transfer(air_of(2.0), af.Path(1.0, 1.0), [1.0, 2.0]), "source must be"),
        (lambda: af.PathPlan("magic"), 'solver must be one of "constant"'),
        (lambda: af.PathPlan("gauss", 5), "nodes must be one of"),
        (lambda: af.plan_path(air_of(2.0), (9.0, 1.0), (1.0, 1.5)), "distance must be a least"),
        (lambda: af.plan_path(air_of(2.0), (1.0, 9.0), (1.0, 1.5), rtol=0.0), "rtol must be"),
        (lambda: af.low_air(af.Atmosphere(), [550.0]), "atmosphere must have molecules or haze"),
        (
            lambda: af.low_air(
                af.Atmosphere(haze=af.Haze(0.1, profile=af.GaussianLayer(2e3, 5e2))), [550.0]
            ),
            "haze.profile must fall exponentially",
        ),
    ],
)
def test_bad_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_traced_range_is_refused():
    with pytest.raises(TypeError, match="distance of plan_path must be known"):
        jax.jit(lambda s: af.plan_path(air_of(2.0), (1.0, s), (1.0, 1.5)).nodes)(5.0)
