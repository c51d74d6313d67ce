"""Directions in all forms, bad input, compilation, and what absent parts cost."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_skies import DIRECTIONS, PARAMETERS, WAVELENGTHS, as_arrays, atmosphere, few_nodes

import atmofit as af

AIR = af.Atmosphere(af.Molecules())
ZENITH, AZIMUTH = np.radians([0.0, 40.0, 88.0]), np.radians([0.0, 60.0, 180.0])


@pytest.fixture(scope="module")
def field():
    """Over a plane, where programs compile fastest: how directions are put does not matter."""
    air = af.Atmosphere(af.Molecules(), geometry="flat")
    return af.solve_sky(air, [450.0, 650.0], plan=few_nodes(air))


def test_a_grid_is_a_list_with_or_without_rings(field):
    grid = af.DirectionGrid(ZENITH, AZIMUTH)
    on_grid = np.asarray(field.radiance(0.7, grid, 1.0))
    assert on_grid.shape == (3, 3, 2)
    view, azimuth = np.repeat(ZENITH, 3), np.tile(AZIMUTH, 3)
    for rings in (None, (3, 3, 3), (1, 2, 3, 1, 1, 1)):
        as_list = field.radiance(0.7, af.Directions(view, azimuth, rings), 1.0)
        np.testing.assert_allclose(as_list, on_grid.reshape(9, 2), rtol=1e-12)


def test_the_order_of_a_list_is_kept(field):
    order = np.array([4, 0, 3, 1, 2])
    dirs = af.Directions(DIRECTIONS.view_zenith_angle[order], DIRECTIONS.relative_azimuth[order])
    found = field.radiance(0.7, dirs, 1.0)
    np.testing.assert_allclose(found, field.radiance(0.7, DIRECTIONS, 1.0)[order], rtol=1e-12)


def test_one_field_serves_all_suns(field):
    suns = jnp.array([0.0, 0.7, np.pi / 2])
    together = jax.vmap(lambda sun: field.radiance(sun, DIRECTIONS, 1.0))(suns)
    alone = [field.radiance(sun, DIRECTIONS, 1.0) for sun in suns]
    np.testing.assert_allclose(together, np.stack(alone), rtol=1e-10)


def test_a_single_wavelength_may_be_a_number():
    sky = af.simulate_sky(AIR, 0.5, DIRECTIONS, 550, orders=1, rtol=5e-2)
    assert sky.shape == (5, 1)


def _simulate(**changes):
    arguments = {
        "atmosphere": AIR,
        "solar_zenith_angle": 0.5,
        "directions": DIRECTIONS,
        "wavelength_nm": [450.0, 650.0],
        "orders": 1,
        "rtol": 5e-2,
    }
    return af.simulate_sky(**(arguments | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"solar_zenith_angle": 1.7}, "solar_zenith_angle must be .* rad, got 1.7"),
        ({"solar_zenith_angle": -0.1}, "solar_zenith_angle must be .* rad, got -0.1"),
        ({"solar_zenith_angle": np.nan}, "solar_zenith_angle must be .* got nan"),
        ({"solar_zenith_angle": [0.1, 0.2]}, r"must be one number .* got shape \(2,\)"),
        ({"directions": af.Directions([1.6], [0.0])}, "view_zenith_angle must be .* got 1.6"),
        (
            {"directions": af.Directions([0.1], [np.nan])},
            "relative_azimuth must be finite, got nan",
        ),
        ({"directions": af.DirectionGrid([1.6], [0.0])}, "view_zenith_angle must be .* got 1.6"),
        ({"wavelength_nm": [100.0]}, "wavelength_nm must be between 200 and 3000 nm, got 100"),
        ({"wavelength_nm": [500.0, 400.0]}, "wavelength_nm must increase, got 400 after 500"),
        ({"wavelength_nm": [np.nan]}, "wavelength_nm must be .* got nan"),
        ({"wavelength_nm": []}, "wavelength_nm must be a list"),
        ({"wavelength_nm": [[500.0]]}, r"wavelength_nm must be a list, got shape \(1, 1\)"),
        (
            {
                "wavelength_nm": [370.0],
                "solar_irradiance": 1.0,
                "atmosphere": af.Atmosphere.from_turbidity(2.0),
            },
            "wavelength_nm must be between 380 and 780.* nm, got 370",
        ),
        ({"wavelength_nm": [370.0]}, "wavelength_nm must be between 380 and 780.* nm, got 370"),
        ({"rtol": -0.1}, "rtol must be .* got -0.1"),
        ({"orders": 21}, 'orders must be 1 to 20 or "all", got 21'),
        ({"solar_irradiance": -1.0}, "solar_irradiance must be at least 0 .* got -1"),
        ({"solar_irradiance": [1.0, 2.0, 3.0]}, r"one for each wavelength .* got shape \(3,\)"),
        ({"atmosphere": af.Atmosphere(af.Molecules(-0.1))}, "optical_depth must be .* got -0.1"),
    ],
)
def test_bad_input_is_refused_with_name_and_value(changes, message):
    with pytest.raises(ValueError, match=message):
        _simulate(**changes)


@pytest.mark.parametrize("bad", ["turbidity", "sun", "view"])
def test_traced_bad_input_gives_nan(bad):
    @jax.jit
    def sky(turbidity, sun, view):
        air = af.Atmosphere.from_turbidity(turbidity, geometry="flat")
        return af.simulate_sky(air, sun, af.Directions(view, view), [450.0, 650.0], 1, 5e-2)

    good = {"turbidity": 2.0, "sun": 0.5, "view": jnp.array([0.1, 0.9])}
    assert np.isfinite(sky(**good)).all()
    wrong = {"turbidity": 0.5, "sun": 1.7, "view": jnp.array([0.1, 1.7])}
    found = np.asarray(sky(**(good | {bad: wrong[bad]})))
    assert np.isnan(found[1]).all()
    assert np.isnan(found[0]).all() == (bad != "view")


def test_debug_checks_name_the_traced_culprit():
    with af.debug_checks(), pytest.raises(Exception, match="turbidity must be between 1 and 64"):
        jax.block_until_ready(
            jax.jit(
                lambda t: af.simulate_sky(
                    af.Atmosphere.from_turbidity(t), 0.5, DIRECTIONS, [550.0], 1, 5e-2
                )
            )(0.5)
        )


class _Compilations:
    """Counts programs that reach the compiler, also those found in the persistent cache."""

    def __init__(self):
        self.count = 0
        jax.monitoring.register_event_duration_secs_listener(self._listen)

    def _listen(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        del duration_secs, kwargs
        self.count += event == "/jax/core/compile/backend_compile_duration"


COMPILATIONS = _Compilations()


def test_changed_values_compile_nothing():
    def run(turbidity, sun, waves, shift):
        air = atmosphere(PARAMETERS | {"turbidity": turbidity, "asymmetry": 0.5 + shift}, "flat")
        view, azimuth = DIRECTIONS.angles()
        dirs = af.Directions(view * (1 - shift), azimuth + shift)
        plan = few_nodes(air)
        return af.simulate_sky(air, sun, dirs, waves, plan=plan).block_until_ready()

    run(2.0, 0.3, np.linspace(400.0, 700.0, 9), 0.0)
    before = COMPILATIONS.count
    assert before > 0
    first = run(2.0, 0.3, np.linspace(400.0, 700.0, 9), 0.0)
    second = run(5.0, 1.1, np.linspace(410.0, 720.0, 9), 0.1)
    assert COMPILATIONS.count == before
    assert not np.allclose(first, second)


def _operations(air, orders=2):
    """The program of a sky in text, one line for each operation, inner programs included."""
    plan = few_nodes(air, orders=orders)
    arrays, tree = jax.tree.flatten(air)

    def sky(arrays):
        air = jax.tree.unflatten(tree, arrays)
        return af.simulate_sky(air, 0.5, DIRECTIONS, WAVELENGTHS, solar_irradiance=1.0, plan=plan)

    return str(jax.make_jaxpr(sky)(arrays))


def test_absent_parts_leave_no_operation_behind():
    molecules, haze = af.Molecules(0.1), af.Haze(0.1)
    gas = af.Absorber(0.1, af.GaussianLayer(22e3, 5e3))
    full = af.Atmosphere(molecules, haze, (gas,), af.Ground(0.3), geometry="spherical")
    lines = len(_operations(full).splitlines())
    for less in (
        af.Atmosphere(molecules, haze, (gas,), geometry="spherical"),
        af.Atmosphere(molecules, haze, (), af.Ground(0.3), geometry="spherical"),
        af.Atmosphere(molecules, None, (gas,), af.Ground(0.3), geometry="spherical"),
        af.Atmosphere(None, haze, (gas,), af.Ground(0.3), geometry="spherical"),
    ):
        assert len(_operations(less).splitlines()) < 0.95 * lines
    assert len(_operations(full, orders=1).splitlines()) < 0.5 * lines
    # An empty atmosphere is a constant.
    assert len(_operations(af.Atmosphere()).splitlines()) < 60


def test_it_runs_with_double_precision_off():
    script = """
import numpy as np, atmofit as af
air = af.Atmosphere.from_turbidity(3.0)
view = np.radians([0.0, 30.0, 89.5, 90.0])
sky = af.simulate_sky(air, np.radians(30.0), af.Directions(view, 0 * view), [450, 550.0], 1, 5e-2)
print(sky.dtype, *np.asarray(sky).ravel().tolist())
"""
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    dtype, *values = run.stdout.split()
    assert dtype == "float32"
    view = np.radians([0.0, 30.0, 89.5, 90.0])
    exact = af.simulate_sky(
        af.Atmosphere.from_turbidity(3.0),
        np.radians(30.0),
        af.Directions(view, 0 * view),
        [450.0, 550.0],
        1,
        5e-2,
    )
    np.testing.assert_allclose(np.array(values, float), np.ravel(exact), rtol=1e-3)


@pytest.fixture(scope="module")
def any_sky():
    @jax.jit
    def sky(parameters, sun, view, azimuth):
        air = atmosphere(parameters)
        plan = af.plan_sky(air, rtol=5e-2)
        dirs = af.Directions(view, azimuth)
        return af.simulate_sky(air, sun, dirs, WAVELENGTHS, solar_irradiance=1.0, plan=plan)

    return sky


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    turbidity=st.floats(1, 10),
    molecules=st.floats(5e3, 1.2e4),
    haze=st.floats(200, 5e3),
    asymmetry=st.floats(-0.5, 0.9),
    albedos=st.tuples(st.floats(0, 1), st.floats(0, 1)),
    sun=st.floats(0, np.pi / 2),
    view=st.lists(st.floats(0, np.pi / 2), min_size=4, max_size=4),
    azimuth=st.lists(st.floats(-np.pi, np.pi), min_size=4, max_size=4),
)
def test_radiance_is_never_negative(
    any_sky, turbidity, molecules, haze, asymmetry, albedos, sun, view, azimuth
):
    parameters = {
        "turbidity": turbidity,
        "molecule_scale_height": molecules,
        "haze_scale_height": haze,
        "asymmetry": asymmetry,
        "haze_albedo": albedos[0],
        "ground_albedo": albedos[1],
    }
    sky = np.asarray(any_sky(as_arrays(parameters), sun, jnp.array(view), jnp.array(azimuth)))
    assert np.isfinite(sky).all()
    assert (sky >= 0).all()
