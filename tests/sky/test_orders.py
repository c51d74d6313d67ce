"""All orders: energy, reciprocity, series, geometries, twilight, peaks and observers aloft."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_skies import FEW_NODES

import atmofit as af
from atmofit.optics.medium import optical_properties
from atmofit.sky.ladder import LADDER
from atmofit.sky.orders import Light, transport
from atmofit.sky.paths import FlatPaths, stretched
from atmofit.sky.sun_angles import sun_nodes
from atmofit.sky.turning import turns

GREEN = [550.0]
SLAB = af.Atmosphere(haze=af.Haze(0.5, 0.0, 1.2e3, 1.0, af.HenyeyGreenstein(0.5)), geometry="flat")
VIEWS = af.Directions(np.radians([0.0, 50.0, 80.0]), np.radians([0.0, 60.0, 170.0]))


def few(air, **choices):
    """A plan on few nodes."""
    plan = af.plan_sky(air, rtol=5e-2, all_wavelengths=True, **choices)
    return dataclasses.replace(plan, nodes=FEW_NODES)


def sky(air, sun, views=VIEWS, **choices):
    plan = few(air, **choices)
    return np.asarray(af.simulate_sky(air, sun, views, GREEN, plan=plan, solar_irradiance=1.0))[
        :, 0
    ]


def test_orders_apart_add_up():
    air = af.Atmosphere.from_turbidity(4.0)
    field = af.solve_sky(air, GREEN, plan=few(air, orders=4, by_order=True))
    apart = np.asarray(field.radiance_by_order(1.2, VIEWS, 1.0))
    assert apart.shape == (4, 3, 1)
    assert (apart > 0).all()
    np.testing.assert_allclose(apart.sum(axis=0), field.radiance(1.2, VIEWS, 1.0), rtol=1e-12)
    np.testing.assert_allclose(apart[0, :, 0], sky(air, 1.2, orders=1), rtol=1e-12)
    with pytest.raises(ValueError, match="by_order=True"):
        af.solve_sky(air, GREEN, plan=few(air, orders=1)).radiance_by_order(1.2, VIEWS)


def test_many_orders_tend_to_all():
    """Without forward peaks, which all orders treat otherwise than eight of them."""
    air = af.Atmosphere(af.Molecules(0.3, 8e3), geometry="flat")
    field = af.solve_sky(air, GREEN, plan=few(air, orders=8, by_order=True))
    apart = np.asarray(field.radiance_by_order(1.0, VIEWS, 1.0))[..., 0]
    eight = apart.sum(axis=0)
    # The ninth order and above hold the share 0.3^8 at most.
    np.testing.assert_allclose(sky(air, 1.0, orders="all"), eight, rtol=1e-3)
    assert (apart[:3].sum(axis=0) < eight).all()


def test_a_bright_ground_makes_a_bright_sky():
    air = af.Atmosphere.from_turbidity(3.0, "pseudo-spherical")
    dark, bright = (
        sky(dataclasses.replace(air, ground=af.Ground(albedo)), 0.8, orders="all")
        for albedo in (0.0, 1.0)
    )
    assert (bright > 1.1 * dark).all()
    assert (bright < 3 * dark).all()


def test_reciprocity():
    """A homogeneous slab transmits alike if sun and observer change places."""
    plan = af.plan_sky(SLAB, orders="all", rtol=2e-3)
    field = af.solve_sky(SLAB, GREEN, plan=plan)
    angles = np.radians([20.0, 45.0, 70.0])

    def seen(sun):
        views = af.Directions(angles, np.full(3, 2.0))
        return np.asarray(field.radiance(sun, views, 1.0))[:, 0] * np.cos(angles)

    ways = np.stack([seen(sun) for sun in angles])  # [sun, view]
    np.testing.assert_allclose(ways, ways.T, rtol=2e-3)  # the rung's promise


@jax.jit
def _next_of_even_light(albedo):
    """What isotropic light of 1 in the slab becomes, and the altitudes."""
    suns = 2
    nodes = dataclasses.replace(LADDER[2e-3], sun=suns)
    air = dataclasses.replace(SLAB, ground=af.Ground(albedo))
    medium = optical_properties(air, jnp.asarray(GREEN))
    unit = jnp.asarray((np.polynomial.chebyshev.chebpts1(nodes.altitude) + 1) / 2)
    altitude, _ = stretched(unit, medium.top, medium.scale)
    step = transport(medium, FlatPaths(), altitude, nodes, (0.0, np.pi / 2), whole=True)
    shape = (altitude.size, nodes.higher_modes, nodes.higher_degrees, 1, suns)
    even = jnp.zeros(shape).at[:, :, 0, 0].set(np.sqrt(4 * np.pi))
    return step(Light(even, jnp.full((1, suns), np.pi))), altitude


@pytest.mark.parametrize("albedo", [0.4, 1.0])
def test_even_light_in_a_closed_room_stays(albedo):
    """Isotropic light of 1 under a ground of 1 loses just what leaves at the top."""
    after, altitude = _next_of_even_light(albedo)
    depth = 0.5 * np.exp(-np.asarray(altitude) / 1.2e3)
    mu, weight = np.polynomial.legendre.leggauss(64)
    mu, weight = (mu + 1) / 2, weight / 2
    above = 1 - np.exp(-depth[:, None] / mu)
    below = 1 - (1 - albedo) * np.exp(-(0.5 - depth[:, None]) / mu)
    mean = ((above + below) @ weight) / 2
    found = np.asarray(after.moments)[:, 0, 0, 0, 0] / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(found, mean, rtol=2e-3)  # the promise of the rung
    flux = 2 * np.pi * (above[0] * mu) @ weight
    np.testing.assert_allclose(np.asarray(after.irradiance)[0, 0], flux, rtol=2e-3)


def turn(light, angle, local_suns):
    """Light [mode, sun] as seen from elsewhere."""
    moved = light.copy()
    for parity, some in enumerate(turns(*light.shape, local_suns)):
        for each in some:
            those = light[each.of :: 2].ravel()[: each.matrix.shape[0]]
            change = (angle**each.power * those @ each.matrix).reshape(-1, light.shape[1])
            moved[parity::2][: len(change)] += change
    return moved


@pytest.mark.parametrize("latest_deg", [101.5, 107.5])  # local suns by day, and in twilight
def test_turning_leaves_even_light_alone(latest_deg):
    modes, suns = 4, 12
    even = np.zeros((modes, suns))
    even[0] = 1.0
    turned = turn(even, np.radians(2.0), (0.0, np.radians(latest_deg)))
    np.testing.assert_allclose(turned, even, atol=1e-8)


def test_turning_moves_the_sun():
    """cos(sun) here is, an angle on along azimuth phi, cos(sun) cos + sin(sun) sin cos(phi)."""
    modes, suns, limit, angle = 4, 24, np.radians(101.5), np.radians(1.0)
    sun = sun_nodes(suns, (0.0, limit))
    light = np.zeros((modes, suns))
    light[0] = np.cos(sun)
    moved = turn(light, angle, (0.0, limit))
    expected = np.zeros_like(light)
    expected[0] = np.cos(sun) * np.cos(angle)
    expected[1] = np.sin(sun) * np.sin(angle) / 2
    # Straight to 3 degrees: a sine of 1 degree is missed by 4e-4 of itself.
    inside = sun < limit - np.radians(3.0)  # beyond, the sun is held at the limit
    np.testing.assert_allclose(moved[:, inside], expected[:, inside], atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_twilight_is_finite_and_fades(dtype):
    air = af.Atmosphere.from_turbidity(3.0)
    plan = af.plan_sky(air, orders="all", rtol=5e-2, dtype=dtype, all_wavelengths=True)
    field = af.solve_sky(air, GREEN, plan=plan)
    suns = jnp.radians(jnp.asarray([91.0, 96.0], dtype))

    def seen(sun):
        def look(sun):
            return field.radiance(sun, VIEWS, 1.0)[:, 0]

        return jax.jvp(look, (sun,), (jnp.ones((), dtype),))

    value, slope = jax.vmap(seen)(suns)
    assert np.isfinite(value).all()
    assert np.isfinite(slope).all()
    assert (np.asarray(value) > 0).all()
    assert (np.asarray(slope) < 0).all()


def test_suns_that_a_plan_leaves_out_are_refused():
    air = af.Atmosphere.from_turbidity(3.0)
    day = af.solve_sky(air, GREEN, plan=few(air, orders=1, solar_zenith_angle=1.0))
    with pytest.raises(ValueError, match=r"solar_zenith_angle must be .* got 1\.6"):
        day.radiance(1.6, VIEWS)


def test_pseudo_spherical_lies_between():
    """High suns see a flat Earth; low ones still shine, and less than over a plane."""
    suns = (0.3, np.radians(87.0))
    flat, pseudo = (
        [sky(af.Atmosphere(af.Molecules(), geometry=name), sun, orders=2) for sun in suns]
        for name in ("flat", "pseudo-spherical")
    )
    np.testing.assert_allclose(pseudo[0], flat[0], rtol=1e-2)
    assert (pseudo[1] > 1.05 * flat[1]).all()  # the slant column over a plane is longer


def test_an_observer_aloft():
    air = af.Atmosphere(af.Molecules(1e-3, 8e3), geometry="flat")
    field = af.solve_sky(air, GREEN, plan=af.plan_sky(air, orders=1))
    low, high = (
        np.asarray(field.radiance(0.5, VIEWS, 1.0, observer_altitude=z))[:, 0] for z in (0.0, 8e3)
    )
    # Above one scale height lies the share 1/e; along 80 degrees the depth 6e-3 dims it.
    np.testing.assert_allclose(high / low, np.exp(-1.0), rtol=1e-2)
    both = af.solve_sky(air, GREEN, plan=few(air, orders="all"))
    assert float(both.radiance(0.5, VIEWS, 1.0, observer_altitude=1e5)[0, 0]) >= 0
    with pytest.raises(ValueError, match="observer_altitude must be between 0 and 100000 m"):
        field.radiance(0.5, VIEWS, observer_altitude=2e5)


@pytest.mark.parametrize("asymmetry", [-0.9, 0.0, 0.9])
def test_sharp_peaks_are_finite_with_their_slopes(asymmetry):
    def total(g):
        haze = af.Haze(0.3, 0.0, 1.2e3, 1.0, af.HenyeyGreenstein(g))
        air = af.Atmosphere(haze=haze, geometry="flat")
        plan = few(air, orders="all")
        return af.simulate_sky(air, 0.7, VIEWS, GREEN, plan=plan, solar_irradiance=1.0).sum()

    value, slope = jax.jvp(total, (jnp.asarray(asymmetry),), (jnp.ones(()),))
    assert np.isfinite(value)
    assert np.isfinite(slope)
    assert value > 0


def test_new_values_do_not_recompile():
    air = af.Atmosphere.from_turbidity(3.0, "flat")
    plan, traces = few(air, orders="all"), []

    @eqx.filter_jit
    def run(air, sun):
        traces.append(None)
        return af.simulate_sky(air, sun, VIEWS, GREEN, plan=plan, solar_irradiance=1.0)

    for turbidity in (2.0, 5.0):
        run(af.Atmosphere.from_turbidity(turbidity, "flat"), jnp.asarray(0.3 * turbidity))
    assert len(traces) == 1


@pytest.mark.parametrize("depth", [3.3, 6.7])
def test_thick_haze_agrees_with_a_slab(depth):
    """Doubling shares no method with this. Thin air's orders missed 27 and 87 %."""
    lobe, suns = af.HenyeyGreenstein(0.7), jnp.radians(jnp.array([0.0, 60.0, 80.0, 86.0]))
    ground = af.Ground(0.3)
    air = af.Atmosphere(haze=af.Haze(depth, 1.3, 1.2e3, 1.0, lobe), ground=ground, geometry="flat")
    field = af.solve_sky(air, GREEN, orders="all", rtol=5e-2)
    found = jax.vmap(lambda sun: field.radiance(sun, VIEWS, 1.0)[:, 0])(suns)
    slab = af.solve_slab(
        optical_depth=depth,
        single_scattering_albedo=1.0,
        phase=lobe,
        solar_zenith_angle=suns,
        ground_albedo=0.3,
        rtol=2e-3,
    )
    np.testing.assert_allclose(found, slab.radiance(VIEWS), rtol=5e-2)  # what the rung promises


@pytest.mark.slow
def test_too_thick_a_haze_stays_positive_and_bounded():
    """Where no number of orders is enough too little light is left, not any amount."""
    haze = af.Haze(100.0, 1.3, 1.2e3, 1.0, af.HenyeyGreenstein(0.7))
    air = af.Atmosphere(haze=haze, ground=af.Ground(0.3), geometry="flat")
    plan = af.plan_sky(air, orders="all", rtol=5e-2)
    assert any("more often" in line for line in plan.left_out)
    found = np.asarray(af.simulate_sky(air, 0.5, VIEWS, GREEN, plan=plan, solar_irradiance=1.0))
    assert (found >= 0).all()
    assert (found < 1 / np.pi).all()  # a white sky under an overhead sun
