"""Slopes of the radiance: right, and finite at every edge of the domain."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_skies import PARAMETERS, WAVELENGTHS, as_arrays, atmosphere, radiance

import atmofit as af
from atmofit.sky.extremes import FEW_NODES

STEPS = {
    "turbidity": 1e-4,
    "asymmetry": 1e-5,
    "haze_albedo": 1e-4,
    "ground_albedo": 1e-4,
}
EDGES = {
    "view at the sun": ({}, np.radians(30.0)),
    "sun overhead": ({}, 0.0),
    "sun on the horizon": ({}, np.pi / 2),
    "turbidity 1": ({"turbidity": 1.0}, 0.5),
    "turbidity 64": ({"turbidity": 64.0}, 0.5),
    "black haze": ({"haze_albedo": 0.0}, 0.5),
    "isotropic haze": ({"asymmetry": 0.0}, 0.5),
    "sharp haze": ({"asymmetry": 0.999}, 0.5),
    "black ground": ({"ground_albedo": 0.0}, 1.0),
    "white ground": ({"ground_albedo": 1.0}, 1.0),
    "one scale height": ({"haze_scale_height": 8.8e3}, 1.0),
    "lowest haze": ({"haze_scale_height": 1.0}, 1.5),
    "highest air": ({"molecule_scale_height": 3e4}, np.pi / 2),
}
# Reverse mode compiles for a minute around a sphere, so there the slopes are taken forward.
UPPER = af.Directions(np.radians([0.0, 30.0, 60.0, 80.0]), np.radians([0.0, 0.0, 10.0, 100.0]))
KINDS = [("flat", "float64"), ("spherical", "float64"), ("spherical", "float32")]


@pytest.fixture(scope="module", params=KINDS, ids="-".join)
def with_slopes(request):
    """Radiance summed, and all its slopes; one compiled program for all tests of a kind."""
    geometry, dtype = request.param

    def total(parameters, sun):
        sky = radiance(parameters, sun, geometry, dtype)
        return sky.sum(), sky

    reverse = jax.jit(jax.value_and_grad(total, argnums=(0, 1), has_aux=True))
    forward = jax.jit(lambda at, along: jax.jvp(lambda p, s: total(p, s), at, along))

    def run(sun=0.6, **changes):
        at = (as_arrays(PARAMETERS | changes, dtype), jnp.asarray(sun, dtype))
        if geometry == "flat":
            return reverse(*at)
        leaves, tree = jax.tree.flatten(at)
        units = np.eye(len(leaves), dtype=dtype)
        found = [forward(at, jax.tree.unflatten(tree, list(map(jnp.asarray, u)))) for u in units]
        return found[0][0], jax.tree.unflatten(tree, [slopes[0] for _, slopes in found])

    return run, dtype


@pytest.mark.slow
@pytest.mark.parametrize("name", [*STEPS, "sun"])
def test_slopes_match_differences(with_slopes, name):
    run, dtype = with_slopes
    if dtype == "float32":
        pytest.skip("differences need float64")
    _, (by_parameter, by_sun) = run()
    slope = by_sun if name == "sun" else by_parameter[name]
    step = STEPS.get(name, 1e-5)

    def at(multiple):
        shifted = (0.6 if name == "sun" else PARAMETERS[name]) + multiple * step
        return run(**{name: shifted})[0][0]

    # Fourth order, so that the step may be large enough for rounding.
    difference = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)


@pytest.mark.slow
def test_slopes_by_scale_heights_are_those_of_the_light():
    """Nodes are held, so that few of them show the quadrature's error in differences."""

    def log_sky(log_heights):
        air, haze = jnp.exp(log_heights)
        heights = {"molecule_scale_height": air, "haze_scale_height": haze}
        sky = atmosphere(PARAMETERS | heights, "flat")
        plan = af.plan_sky(sky, solar_zenith_angle=0.6, rtol=1e-2, all_wavelengths=True)
        return jnp.log(af.simulate_sky(sky, 0.6, UPPER, WAVELENGTHS, plan=plan))

    at = jnp.log(jnp.array([8.8e3, 1.2e3]))
    run = jax.jit(lambda at, along: jax.jvp(log_sky, (at,), (along,)))
    step = 1e-3
    for along in np.eye(2):
        _, slope = run(at, along)
        above, below = (run(at + sign * step * along, along)[0] for sign in (1, -1))
        # The second difference is 1e-6; the rung promises 1e-2 of the light.
        np.testing.assert_allclose(slope, (above - below) / (2 * step), atol=1e-3)
        assert np.abs(slope).max() > 0.05


@pytest.mark.slow
def test_slopes_from_a_coarser_sky():
    """The value is the fine sky's; the slopes of its logarithm are the coarse one's."""
    air = atmosphere(PARAMETERS, "flat")
    choices = {"solar_zenith_angle": 0.6, "orders": 1, "all_wavelengths": True}
    fine, coarse, both = (
        af.plan_sky(air, **choices, rtol=rtol, slopes_rtol=slopes)
        for rtol, slopes in ((1e-2, None), (1e-1, None), (1e-2, 1e-1))
    )
    assert "left out: exact slopes" in str(both)

    def sky(turbidity, plan):
        hazy = atmosphere(PARAMETERS | {"turbidity": turbidity}, "flat")
        return af.simulate_sky(hazy, 0.6, UPPER, WAVELENGTHS, plan=plan)

    def log_slope(plan):
        value, slope = jax.jvp(lambda t: sky(t, plan), (3.0,), (1.0,))
        return value, slope / value

    found, slope = log_slope(both)
    np.testing.assert_allclose(found, log_slope(fine)[0], rtol=1e-12)
    np.testing.assert_allclose(slope, log_slope(coarse)[1], rtol=1e-12)
    back = jax.jacrev(lambda t: sky(t, both))(3.0)
    np.testing.assert_allclose(back, slope * found, rtol=1e-10)
    with pytest.raises(ValueError, match=r"slopes_rtol must be between 0\.01 and 1, got 0\.002"):
        af.plan_sky(air, rtol=1e-2, slopes_rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("edge", EDGES)
def test_value_and_slopes_are_finite_at_the_edges(with_slopes, edge):
    changes, sun = EDGES[edge]
    (_, sky), slopes = with_slopes[0](sun, **changes)
    assert np.isfinite(sky).all()
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(slopes))


@pytest.mark.slow
def test_absent_haze_above_all_air_has_its_slope_in_float32():
    """Air of one metre lies below most nodes, where the first trace of haze becomes everything."""
    up = af.Directions([0.0], [0.0])

    def sky(haze_depth, dtype):
        haze = af.Haze(haze_depth, 1.3, 50.0, 0.5, af.HenyeyGreenstein(0.3))
        ground = af.Ground(0.188)
        air = af.Atmosphere(af.Molecules(3.4e-4, 1.0), haze, (), ground, "pseudo-spherical")
        plan = af.plan_sky(air, orders="all", rtol=5e-2, dtype=dtype, all_wavelengths=True)
        plan = dataclasses.replace(plan, nodes=FEW_NODES)
        return af.simulate_sky(air, 0.0, up, 550.0, solar_irradiance=1.0, plan=plan)[0, 0]

    step = 1e-6
    found = jax.jacfwd(lambda depth: sky(depth, "float32"))(jnp.zeros((), "float32"))
    difference = (sky(jnp.asarray(step), "float64") - sky(jnp.zeros(()), "float64")) / step
    np.testing.assert_allclose(found, difference, rtol=5e-3)  # damped aloft by design
