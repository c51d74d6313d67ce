"""Plans by value: what a scene needs within a tolerance, by predicted errors."""

import dataclasses

import jax
import numpy as np
import pytest

import atmofit as af
from atmofit.sky import predicted
from atmofit.sky.ladder import LADDER
from atmofit.sky.luminance import COUNTS

NOON, LATE = np.radians(20.0), np.radians(85.0)


def air(turbidity, sun=NOON, **choices):
    """A plan by value of the 1999 paper's air."""
    return af.plan_sky(
        af.Atmosphere.from_turbidity(turbidity), solar_zenith_angle=sun, orders=None, **choices
    )


def test_every_rung_and_omission_was_measured():
    names = {f"{kind} {rtol:g}" for kind in ("rung", "wavelengths") for rtol in LADDER}
    names |= {f"luminance {count}" for count in COUNTS.values()}
    names |= {"orders 1", "orders 2", "flat", "pseudo-spherical"}
    names |= {f"without {name}" for name in ("haze", "ground", "absorbers")}
    assert set(predicted.stored()["laws"]) == names
    for law in predicted.stored()["laws"].values():
        assert law["margin"] >= 1
        assert law["median"] <= law["largest"]


def test_molecules_only():
    plan = af.plan_sky(
        af.Atmosphere(af.Molecules()), solar_zenith_angle=NOON, orders=None, rtol=1e-2
    )
    for name in ("haze", "ground", "absorbers"):
        assert f"{name}: absent from the atmosphere" in plan.left_out
    # Smooth scattering needs no fine quadrature, but more than one order.
    assert plan.rtol > 1e-2
    assert plan.orders == "all"
    assert 0 < plan.predicted_error <= 1e-2


def test_a_hazy_noon_needs_less_than_a_hazy_evening():
    noon, evening = air(2.0, rtol=1e-2), air(6.0, LATE, rtol=2e-3)
    assert noon.predicted_error <= 1e-2
    assert noon.rtol > evening.rtol
    assert noon.dtype == "float32"
    assert noon.nodes.sun < evening.nodes.sun
    assert evening.geometry is None
    assert "predicted error: quadrature" in str(evening)


def test_nothing_small_is_computed():
    bare = af.Atmosphere.from_turbidity(2.0)
    trace = dataclasses.replace(bare, ground=af.Ground(1e-4), absorbers=(af.Absorber.ozone(1.0),))
    plan = af.plan_sky(trace, solar_zenith_angle=NOON, orders=None, rtol=5e-2)
    assert set(plan.without) == {"ground", "absorbers"}
    assert "ground: within the tolerance" in plan.left_out
    real = dataclasses.replace(trace, ground=af.Ground(0.5))
    assert (
        "ground" not in af.plan_sky(real, solar_zenith_angle=NOON, orders=None, rtol=5e-2).without
    )


def test_views_far_from_the_horizon_need_no_sphere():
    high = af.DirectionGrid(np.radians([0.0, 40.0]), np.radians([0.0, 90.0]))
    plan = air(2.0, directions=high, rtol=1e-1)
    assert plan.geometry in ("flat", "pseudo-spherical")
    assert f"{plan.geometry} paths are within the tolerance" in str(plan)
    assert air(2.0, LATE, rtol=2e-3).geometry is None


def test_only_the_zenith_only_luminance_only_one_wavelength():
    zenith = air(2.0, directions=af.Directions([0.0], [0.0]))
    assert zenith.zenith_only
    luminance = air(2.0, quantity="luminance")
    assert "luminance from" in str(luminance)
    assert not luminance.all_wavelengths
    # One wavelength is never interpolated, whatever the plan.
    field = af.solve_sky(af.Atmosphere.from_turbidity(2.0), [550.0], plan=zenith)
    assert field.samples.wavelength_nm.size == 1


def test_only_the_colour_of_the_sun():
    plan = air(2.0, quantity="sun")
    assert plan.orders == 0
    assert "unscattered sunlight" in plan.computed
    assert "left out: every scattering order" in str(plan)
    with pytest.raises(ValueError, match='plan for quantity "sun" computes no sky'):
        af.solve_sky(af.Atmosphere.from_turbidity(2.0), [550.0], plan=plan)


def test_values_must_be_known():
    with pytest.raises(TypeError, match="atmosphere of plan_sky must be known"):
        jax.jit(lambda T: air(T) and T)(2.0)
    # Where the orders are given, they need not be.
    jax.jit(lambda T: af.plan_sky(af.Atmosphere.from_turbidity(T), orders="all") and T)(2.0)


@pytest.mark.slow
def test_a_planned_sky_is_the_sky():
    """Against a finer rung with nothing left out."""
    hazy = dataclasses.replace(af.Atmosphere.from_turbidity(3.0), ground=af.Ground(0.2))
    views = af.DirectionGrid(np.radians([0.0, 45.0, 80.0]), np.radians([0.0, 90.0, 180.0]))
    sun, rtol = np.radians(50.0), 5e-2
    plan = af.plan_sky(hazy, solar_zenith_angle=sun, directions=views, orders=None, rtol=rtol)
    fine = af.plan_sky(hazy, solar_zenith_angle=sun, orders="all", rtol=1e-2)
    found, exact = (
        np.asarray(af.simulate_sky(hazy, sun, views, [550.0], plan=each)) for each in (plan, fine)
    )
    assert 0 < np.abs(found / exact - 1).max() < rtol
