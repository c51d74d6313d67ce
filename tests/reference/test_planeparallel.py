"""Flat skies against the closed form, successive orders of another code, and nanodisort."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.data import directions, groups, needs

import atmofit as af

TABLE = "planeparallel_sky_radiance.csv"
pytestmark = [pytest.mark.reference, pytest.mark.slow, needs(TABLE)]
FLOOR = 1e-12  # below, the table has lost its digits


def _atmosphere(columns):
    """The case's atmosphere and which parts it has."""
    first = {name: values[0] for name, values in columns.items()}
    molecules = af.Molecules(first["tauR"], 8.8e3) if first["tauR"] > 0 else None
    haze = None
    if first["tauH"] > 0:
        phase = af.HenyeyGreenstein(first["g"])
        haze = af.Haze(first["tauH"], 0.0, 1.2e3, first["ssaH"], phase)
    gas = af.Absorber(first["tauAbs"], af.GaussianLayer(22e3, 5e3))
    return af.Atmosphere(
        molecules,
        haze,
        (gas,) if first["tauAbs"] > 0 else (),
        af.Ground(first["albedo"]) if first["albedo"] > 0 else None,
        geometry="flat",
    )


def _simulate(plan_of, wanted):
    """Radiance of the wanted cases; those of one structure share a compiled program by vmap."""
    alike = {}
    for key, columns in groups(TABLE).items():
        if wanted(key[0]):
            atmosphere = _atmosphere(columns)
            dirs = directions(columns)
            kind = (jax.tree.structure(atmosphere), dirs.shape)
            alike.setdefault(kind, []).append((key, columns, atmosphere, dirs))
    found = {}
    for members in alike.values():
        keys, columns, atmospheres, dirs = zip(*members, strict=True)
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *atmospheres)
        one_dirs = jax.tree.map(lambda *x: jnp.stack(x), *dirs)
        suns = jnp.asarray(np.radians([key[1] for key in keys]))

        @eqx.filter_jit
        def simulate(atmosphere, sun, directions):
            def one(atmosphere, sun, directions):
                plan = plan_of(atmosphere)
                return af.simulate_sky(
                    atmosphere, sun, directions, [550.0], solar_irradiance=1.0, plan=plan
                )[:, 0]

            return jax.vmap(one)(atmosphere, sun, directions)

        radiance = np.asarray(simulate(stacked, suns, one_dirs))
        found.update(
            {
                key: (value, column)
                for key, value, column in zip(keys, radiance, columns, strict=True)
            }
        )
    return found


def _is_single_scattering_case(case):
    return not case.startswith("f_10")


@pytest.fixture(scope="module")
def first_order():
    return _simulate(lambda a: af.plan_sky(a, orders=1, rtol=5e-4), _is_single_scattering_case)


@pytest.fixture(scope="module")
def second_order():
    def wanted(case):
        return case[0] in "abe"

    both = _simulate(lambda a: af.plan_sky(a, orders=2, rtol=1e-3), wanted)
    one = _simulate(lambda a: af.plan_sky(a, orders=1, rtol=1e-3), wanted)
    return {key: (both[key][0] - one[key][0], both[key][1]) for key in both}


def _largest_error(found, column, letters):
    errors = {}
    for key, (value, columns) in found.items():
        if key[0][0] in letters:
            reference = columns[column]
            trusted = reference > FLOOR
            assert trusted.any()
            error = np.abs(value / np.where(trusted, reference, 1) - 1)[trusted].max()
            errors[key] = float(error)
    case = max(errors, key=lambda key: errors[key])
    return errors[case], case


@pytest.mark.parametrize(("letters", "rtol"), [("af", 1e-5), ("bce", 5e-4)])
def test_single_scattering(first_order, letters, rtol):
    error, case = _largest_error(first_order, "single_analytic", letters)
    assert error < rtol, case


@pytest.mark.parametrize(("letters", "rtol"), [("a", 1e-3), ("be", 5e-3)])
def test_second_order_alone(second_order, letters, rtol):
    error, case = _largest_error(second_order, "sos_order2", letters)
    assert error < rtol, case


@pytest.fixture(scope="module")
def orders_apart():
    """Five orders of a and b; `wanted` keeps the compiled programs few."""
    wanted = ("a_0.3", "b_0.1", "b_0.5")

    def plan(atmosphere):
        return af.plan_sky(atmosphere, orders=5, rtol=2e-3, by_order=True)

    found = {}
    for key, columns in groups(TABLE).items():
        if key[0] in wanted:
            atmosphere = _atmosphere(columns)
            field = af.solve_sky(atmosphere, [550.0], plan=plan(atmosphere))
            sky = field.radiance_by_order(np.radians(key[1]), directions(columns), 1.0)
            found[key] = (np.asarray(sky)[:, :, 0], columns)
    return found


@pytest.mark.parametrize("order", [3, 4, 5])
def test_third_to_fifth_order_alone(orders_apart, order):
    for key, (values, columns) in orders_apart.items():
        error = np.abs(values[order - 1] / columns[f"sos_order{order}"] - 1).max()
        assert error < 1e-2, key


@pytest.mark.parametrize(
    ("cases", "rtol", "promise"),
    [(("a",), 2e-3, 3e-3), (("b", "c", "e"), 2e-3, 7e-3), (("f_0.1_", "f_1_"), 5e-4, 7e-3)],
    ids=["air", "with haze, ground or absorbers", "sharp haze alone"],
)
def test_all_orders(cases, rtol, promise):
    found = _simulate(
        lambda a: af.plan_sky(a, orders="all", rtol=rtol), lambda case: case.startswith(cases)
    )
    assert len(found) >= 4
    for key, (value, columns) in found.items():
        assert np.abs(value / columns["nanodisort"] - 1).max() < promise, key
