"""Light that turns toward the eye: balances, symmetries, and sums done otherwise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson

import atmofit as af

WAVELENGTHS = [450.0, 600.0]
AIR = af.low_air(
    af.Atmosphere(af.Molecules(), af.Haze(0.1, phase=af.HenyeyGreenstein(0.7))), WAVELENGTHS
)
SUN = 0.9


def uniform(directions):
    return jnp.ones((*directions.shape, 2))


def peaked(directions):
    view, azimuth = directions.angles()
    angle = af.scattering_angle(view, azimuth, SUN)
    return (jnp.exp(-3 * angle) + 0.1)[:, None] * jnp.asarray([[1.0, 2.0]])


LIGHT = af.light_around(AIR, SUN, [1.0, 2.0], peaked, 0.2)


def test_light_that_is_alike_all_around_stays_so():
    around = af.light_around(AIR, SUN, 0.0, uniform, 1.0)
    # The phase functions integrate to 1; level ground under a uniform sky receives pi.
    np.testing.assert_allclose(around.sky_irradiance, np.pi, rtol=1e-6)
    np.testing.assert_allclose(around.ground_radiance, 1.0, rtol=1e-6)
    np.testing.assert_allclose(around.diffuse, 1.0, rtol=1e-6)
    toward = around.toward(AIR, [0.1, 2.0], [0.0, 2.0])
    np.testing.assert_allclose(toward, np.broadcast_to(AIR.scattering, (2, 2, 2)), rtol=1e-6)


def test_the_sun_s_share_is_exact():
    alone = af.light_around(AIR, SUN, [1.0, 2.0])
    view, azimuth = np.array([0.3, 1.6]), np.array([0.2, 3.0])
    angle = jnp.asarray(np.asarray(af.scattering_angle(view, azimuth, SUN)))
    expected = (
        AIR.scattering[None] * AIR.phase_functions(angle) * jnp.asarray([1.0, 2.0])[None, None]
    )
    np.testing.assert_allclose(alone.toward(AIR, view, azimuth), expected, rtol=1e-12)


def test_the_table_is_the_integral():
    """Against random directions, evenly spread over the upper half of the sphere."""
    random = np.random.default_rng(5)
    z = np.arccos(random.random(200_000))
    a = random.uniform(0, 2 * np.pi, z.size)
    sky = np.asarray(peaked(af.Directions(z, a)))
    dark_ground = af.light_around(AIR, SUN, 0.0, peaked)
    for view, azimuth in ((0.9, 0.0), (1.5, 0.7), (1.5, 3.0), (2.4, 1.0)):
        # On the table's own directions: interpolation is looked at below.
        i, j = round(view / np.pi * 36), round(azimuth / np.pi * 24)
        at = (i * np.pi / 36, j * np.pi / 24)
        angle = af.scattering_angle(z, a - at[1], at[0])
        light = np.asarray(AIR.phase_functions(angle)) * sky[:, None, :]
        mean, error = light.mean(axis=0), light.std(axis=0) / np.sqrt(z.size)
        found = np.asarray(dark_ground.diffuse[i, j])
        # Four standard errors, and the quadrature's 0.1 %.
        assert (np.abs(found - 2 * np.pi * mean) <= 8 * np.pi * error + 1e-3 * found).all()


def test_both_sides_of_the_sun_are_alike_and_azimuth_turns_round():
    view = np.full(4, 1.3)
    found = np.asarray(LIGHT.toward(AIR, view, [0.5, -0.5, 0.5 + 2 * np.pi, 0.5 - 4 * np.pi]))
    np.testing.assert_allclose(found, found[:1].repeat(4, axis=0), rtol=1e-10)


def test_interpolation_between_the_directions():
    view, azimuth = np.meshgrid(np.linspace(0, np.pi, 37), np.linspace(0, np.pi, 25), indexing="ij")
    on = LIGHT.diffuse_toward(jnp.asarray(view), jnp.asarray(azimuth))
    np.testing.assert_allclose(on, LIGHT.diffuse, rtol=1e-9)
    # Half way: what a table of half as many directions misses is four times as much.
    coarse = np.asarray(LIGHT.diffuse)[::2]
    middle = (coarse[:-1] + coarse[1:]) / 2
    off = np.abs(middle / np.asarray(LIGHT.diffuse)[1::2] - 1) / 4
    assert off.max() < 0.01


def test_derivatives_go_through():
    def seen(sun):
        around = af.light_around(AIR, sun, 1.0, peaked, 0.2)
        return around.toward(AIR, 1.4, 0.3).sum()

    h = 1e-4
    differences = (seen(SUN + h) - seen(SUN - h)) / (2 * h)
    np.testing.assert_allclose(jax.grad(seen)(jnp.asarray(SUN)), differences, rtol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((AIR, 1.7, 1.0), "solar_zenith_angle must be"),
        ((AIR, [0.1, 0.2], 1.0), "solar_zenith_angle must be one number"),
        ((AIR, SUN, -1.0), "sun_irradiance must be"),
        ((AIR, SUN, [1.0, 2.0, 3.0]), "sun_irradiance must be a number or one for each"),
        ((AIR, SUN, 1.0, None, 1.5), "ground_albedo must be"),
        ((AIR, SUN, 1.0, lambda d: jnp.ones(d.shape)), r"sky must give \[direction, wavelength\]"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        af.light_around(*arguments)


def test_a_simulated_field_is_a_sky():
    """The simulator's own sky, and its balance: what the field says of level ground."""
    whole = af.Atmosphere.from_turbidity(3.0)
    plan = af.plan_sky(whole, orders=1, rtol=1e-1, dtype="float32")
    field = af.solve_sky(whole, WAVELENGTHS, plan=plan)
    air = af.low_air(whole, WAVELENGTHS)
    around = af.light_around(air, SUN, 0.0, lambda dirs: field.radiance(SUN, dirs, 1.0))
    # Simpson's rule over zenith angles and the trapezoidal one over azimuths, on another grid.
    zenith, azimuth = np.linspace(0, np.pi / 2, 41), np.linspace(0, np.pi, 37)
    seen = np.asarray(field.radiance(SUN, af.DirectionGrid(zenith, azimuth), 1.0), float)
    rings = 2 * np.trapezoid(seen, azimuth, axis=1) * (np.sin(zenith) * np.cos(zenith))[:, None]
    expected = simpson(rings, x=zenith, axis=0)
    # The coarsest rung in single precision; azimuths every five degrees through the aureole.
    np.testing.assert_allclose(around.sky_irradiance, expected, rtol=5e-3)
