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


def _atmosphere(columns, whole):
    """The case's atmosphere of the parts it has.

    If `whole`, molecules and haze stand over a ground and under a gas, be it of nothing.
    """
    first = {name: values[0] for name, values in columns.items()}
    molecules = af.Molecules(first["tauR"], 8.8e3) if first["tauR"] > 0 else None
    haze = None
    if first["tauH"] > 0:
        phase = af.HenyeyGreenstein(first["g"])
        haze = af.Haze(first["tauH"], 0.0, 1.2e3, first["ssaH"], phase)
    whole = whole and molecules is not None and haze is not None
    gas = af.Absorber(first["tauAbs"], af.GaussianLayer(22e3, 5e3))
    return af.Atmosphere(
        molecules,
        haze,
        (gas,) if whole or first["tauAbs"] > 0 else (),
        af.Ground(first["albedo"]) if whole or first["albedo"] > 0 else None,
        geometry="flat",
    )


def _simulate(wanted, whole=False, **choices):
    """Radiance of the wanted cases, by order where the plan says so.

    All suns of a case share its field, and cases of one structure a compiled program.
    """
    alike = {}
    for (case, sun), columns in groups(TABLE).items():
        if wanted(case):
            atmosphere, dirs = _atmosphere(columns, whole), directions(columns)
            kind = (jax.tree.structure(atmosphere), dirs.shape)
            alike.setdefault(kind, {}).setdefault(case, []).append((sun, columns, atmosphere, dirs))
    found = {}
    for members in alike.values():
        suns = np.radians([[each[0] for each in case] for case in members.values()])
        air, dirs = (
            jax.tree.map(lambda *x: jnp.stack(x), *[case[0][part] for case in members.values()])
            for part in (2, 3)
        )
        radiance = np.asarray(_skies(air, jnp.asarray(suns), dirs, choices))
        for (name, case), of_suns in zip(members.items(), radiance, strict=True):
            for (sun, columns, _, _), values in zip(case, of_suns, strict=True):
                found[name, sun] = (values, columns)
    return found


def _skies(atmospheres, suns, dirs, choices):
    """Radiance [case, sun, ..., direction]."""

    @eqx.filter_jit
    def skies(atmospheres, suns, dirs):
        def of_case(atmosphere, suns, dirs):
            plan = af.plan_sky(atmosphere, **choices)
            field = af.solve_sky(atmosphere, [550.0], plan=plan)
            look = field.radiance_by_order if plan.by_order else field.radiance
            return jax.lax.map(lambda sun: look(sun, dirs, 1.0)[..., 0], suns)

        return jax.vmap(of_case)(atmospheres, suns, dirs)

    return skies(atmospheres, suns, dirs)


def _is_single_scattering_case(case):
    return not case.startswith("f_10")


@pytest.fixture(scope="module")
def first_order():
    return _simulate(_is_single_scattering_case, orders=1, rtol=5e-4)


@pytest.fixture(scope="module")
def orders_apart():
    """Five orders of each case of molecules, alone or with haze over black ground."""
    return _simulate(lambda case: case[0] in "abe", whole=True, orders=5, rtol=2e-3, by_order=True)


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
def test_second_order_alone(orders_apart, letters, rtol):
    second = {key: (values[1], columns) for key, (values, columns) in orders_apart.items()}
    error, case = _largest_error(second, "sos_order2", letters)
    assert error < rtol, case


@pytest.mark.parametrize("order", [3, 4, 5])
def test_third_to_fifth_order_alone(orders_apart, order):
    """Without gas, whose layer the rung follows less closely in what it adds to these orders."""
    for key, (values, columns) in orders_apart.items():
        if key[0][0] in "ab":
            error = np.abs(values[order - 1] / columns[f"sos_order{order}"] - 1).max()
            assert error < 1e-2, key


@pytest.mark.parametrize(
    ("cases", "rtol", "promise"),
    [(("a",), 2e-3, 3e-3), (("b", "c", "e"), 2e-3, 7e-3), (("f_0.1_", "f_1_"), 5e-4, 7e-3)],
    ids=["air", "with haze, ground or absorbers", "sharp haze alone"],
)
def test_all_orders(cases, rtol, promise):
    found = _simulate(lambda case: case.startswith(cases), whole=True, orders="all", rtol=rtol)
    assert len(found) >= 4
    for key, (value, columns) in found.items():
        assert np.abs(value / columns["nanodisort"] - 1).max() < promise, key
