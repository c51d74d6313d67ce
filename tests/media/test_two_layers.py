"""Klassen's two-layer sun and sky against quadrature in space, and his approximations."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import atmofit as af
from atmofit.media.sky_reconstruction import (
    ReconstructionPlan,
    plan_layered_sky,
    reconstruct_layered_sky,
)
from atmofit.media.two_layers import (
    haze_opacity,
    layered_sky,
    layered_sun,
    shell_distance,
    two_layers,
)

R = 6371e3
HAZY = two_layers(2e-4, 2e3, wavelength_nm=(450.0, 650.0))
BLACK = np.zeros(2)


def to_shell(place, direction, radius):
    """Distance along a ray to a sphere around the origin, by the quadratic."""
    along = place @ direction
    return -along + np.sqrt(along**2 - place @ place + radius**2)


def oracle(layers, sun, zenith, azimuth, wavelength):
    """Radiance of the haze by vectors in space and adaptive quadrature."""
    eye = np.array([0.0, 0.0, R])
    look = np.array(
        [np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]
    )
    light = np.array([np.sin(sun), 0.0, np.cos(sun)])
    top, air = R + float(layers.haze_top), R + float(layers.air_top)
    m, p = (float(x[wavelength]) for x in (layers.molecular_extinction, layers.haze_extinction))

    def integrand(s):
        place = eye + s * look
        if place @ light < 0 and np.linalg.norm(np.cross(place, light)) < R:
            return 0.0
        in_haze = to_shell(place, light, top)
        in_air = to_shell(place, light, air)
        return np.exp(-m * (in_air + s) - p * (in_haze + s))

    end = to_shell(eye, look, top)
    pieces = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 12)]) * end
    value = sum(quad(integrand, a, b, epsrel=1e-10)[0] for a, b in itertools.pairwise(pieces))
    g, cos = 0.75, look @ light
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cos) ** 1.5)
    return float(layers.haze_scattering[wavelength]) * phase * value


@pytest.mark.parametrize(
    ("sun", "zenith", "azimuth"),
    [
        (0.5, 0.3, 1.0),
        (1.2, 1.5, 0.0),
        (1.4, np.pi / 2, 2.0),
        (1.5, 1.45, 3.0),
        (np.pi / 2, 1.5, 0.2),
    ],
)
def test_exact_sky_equals_quadrature_in_space(sun, zenith, azimuth):
    found = layered_sky(HAZY, sun, af.Directions([zenith], [azimuth]), blue=BLACK, nodes=48)
    for k in (0, 1):
        # The oracle's square of the radius keeps 1e-16 of 4e13 m2: 4e-3 m2 of 1e7 or more.
        assert float(found[0, k]) == pytest.approx(oracle(HAZY, sun, zenith, azimuth, k), rel=1e-6)


@pytest.mark.parametrize(
    ("sun", "rtol"), [(0.3, 2e-6), (1.3, 2e-6), (1.56, 2e-6), (np.pi / 2, 1e-4)]
)
def test_the_default_nodes_do(sun, rtol):
    """Under a level sun the light ends in a square root at the top of the haze."""
    dirs = af.DirectionGrid(np.linspace(0.0, np.pi / 2, 20), [0.0, 1.5, np.pi])
    exact, default = (layered_sky(HAZY, sun, dirs, blue=BLACK, nodes=n) for n in (96, 24))
    np.testing.assert_allclose(default, exact, rtol=rtol)


@pytest.mark.parametrize(("haze_top", "extinction"), [(2e3, 5e-5), (2e3, 2e-4), (8e3, 5e-5)])
def test_how_wrong_the_constant_slope_is(haze_top, extinction):
    """The integral of equation 29: below 1 % apart from 15 degrees up, -64 to -97 % level."""
    layers = two_layers(extinction, haze_top, 8.4e3, angstrom_exponent=0.0, wavelength_nm=(550.0,))
    layers = eqx.tree_at(lambda x: x.molecular_extinction, layers, jnp.zeros(1))
    zenith = np.pi / 2 - np.radians([0.0, 15.0, 90.0])
    dirs = af.Directions(zenith, np.zeros(3))
    paper, exact = (
        np.asarray(layered_sky(layers, 0.0, dirs, blue=[0.0], geometry=g, nodes=96)[:, 0])
        for g in ("paper", "exact")
    )
    error = paper / exact - 1
    assert -0.98 < error[0] < -0.6
    assert abs(error[1]) < 0.02
    # Straight up the two differ in the sun's local elevation only, which is the same there.
    assert abs(error[2]) < 1e-6


def test_shells_land_where_they_should():
    for elevation in np.radians([0.0, 1.0, 30.0, 90.0]):
        for height in (1.0, 2e3, 1e5):
            y = float(shell_distance(jnp.asarray(R), jnp.asarray(height), jnp.sin(elevation)))
            x, z = y * np.cos(elevation), R + y * np.sin(elevation)
            assert np.hypot(x, z) - R == pytest.approx(height, abs=5e-9)
    with jax.enable_x64(False):
        y = shell_distance(jnp.float32(R), jnp.float32(1.0), jnp.float32(0.01))
        exact = -R * 0.01 + np.sqrt((R * 0.01) ** 2 + 2 * R + 1)
        assert float(y) == pytest.approx(exact, rel=1e-5)


def test_angles_at_the_upper_shell():
    """A level ray meets the shell 98.3 km up at 10.0 degrees; the paper takes 0."""
    height = 98.3e3
    way = float(shell_distance(jnp.asarray(R), jnp.asarray(height), jnp.asarray(0.0)))
    assert np.degrees(np.arcsin(way / (R + height))) == pytest.approx(10.0, abs=0.05)
    layers = two_layers(5e-5, 2e3, 100e3)
    depth = {
        g: -np.log(np.asarray(layered_sun(layers, [np.pi / 2, np.radians(75)], g)))
        for g in ("paper", "exact")
    }
    ratio = depth["paper"][:, 0] / depth["exact"][:, 0] - 1
    assert 0.08 < ratio[0] < 0.18
    assert abs(ratio[1]) < 5e-3


def test_colour_of_the_sun_and_trends_of_the_sky():
    layers = two_layers()
    zenith = np.radians(np.arange(0, 91, 10.0))
    passed = np.asarray(layered_sun(layers, zenith))
    assert (passed <= 1).all()
    assert (np.diff(passed[:, -1] / passed[:, 0]) > 0).all()
    E = af.solar_irradiance_spectrum("standard")(layers.wavelength_nm)

    def xyY(haze, sun, view):
        sky = layered_sky(
            two_layers(haze), sun, af.Directions(view, np.zeros(len(view))), solar_irradiance=E
        )
        return np.asarray(af.spectrum_to_xyY(sky, layers.wavelength_nm))

    noon = xyY(5e-5, 0.1, [0.6, 1.5])
    assert noon[1, 0] > noon[0, 0]  # whiter at the horizon
    assert xyY(2e-4, 0.1, [0.6])[0, 0] > noon[0, 0]  # and with more haze
    sunset = xyY(5e-5, 1.54, [1.5])
    assert sunset[0, 0] > noon[1, 0] + 0.05
    opacity = np.asarray(haze_opacity(layers, [0.0, 1.0, np.pi / 2]))
    assert ((opacity >= 0) & (opacity <= 1)).all()
    assert (np.diff(opacity, axis=0) > 0).all()


def red_and_bright(elevation, **layers):
    """x and Y at 17, 69 and 86 degrees from the zenith, toward the sun."""
    layers = two_layers(**layers)
    sky = layered_sky(
        layers,
        np.radians(90 - elevation),
        af.Directions(np.array([0.3, 1.2, 1.5]), np.zeros(3)),
        solar_irradiance=af.solar_irradiance_spectrum("standard")(layers.wavelength_nm),
    )
    return np.moveaxis(np.asarray(af.spectrum_to_xyY(sky, layers.wavelength_nm)), -1, 0)[[0, 2]]


def test_what_the_parameters_do_in_klassens_plates():
    # Figures 8 to 13 show it without numbers. Haze reddens everywhere, at sunset and at midday ...
    densities = [1e-5, 3e-5, 1e-4, 3e-4]
    sunset = np.stack([red_and_bright(2, haze_extinction=haze) for haze in densities])
    midday = np.stack([red_and_bright(40, haze_extinction=haze) for haze in densities])
    deep = np.stack([red_and_bright(2, haze_top=top) for top in (500.0, 1e3, 2e3, 4e3)])
    for sweep in (sunset, midday, deep):
        assert (np.diff(sweep[:, 0], axis=0) > 0).all()
    # ... darkens the top of the sky at sunset, and brightens it at midday.
    assert (np.diff(sunset[:, 1, 0]) < 0).all()
    assert (np.diff(deep[:, 1, 0]) < 0).all()
    assert (np.diff(midday[:, 1, 0]) > 0).all()
    # More air brightens it at sunset.
    air = np.stack([red_and_bright(2, air_top=top) for top in (4.5e3, 8.4e3, 1.6e4, 3e4)])
    assert (np.diff(air[:, 1, 0]) > 0).all()
    # While the sun sinks, its side of the horizon reddens and the top of the sky turns blue.
    sinking = np.stack([red_and_bright(elevation) for elevation in (40, 20, 10, 5, 2)])
    assert (np.diff(sinking[:, 0, 2]) > 0).all()
    assert (np.diff(sinking[:, 0, 0]) < 0).all()


@pytest.mark.parametrize("sun", [0.1, 1.5])
def test_a_planned_picture_is_right_to_eight_bits(sun):
    plan = plan_layered_sky(HAZY, sun)
    assert plan.error is not None
    assert plan.error <= 1 / 510
    assert str(plan).startswith(f"sky from {plan.elevations} x {plan.azimuths} directions")
    grid = af.DirectionGrid(np.linspace(0.0, np.pi / 2, 33), np.linspace(0.0, np.pi, 17))
    found = np.asarray(reconstruct_layered_sky(HAZY, sun, grid, plan=plan))
    exact = np.asarray(layered_sky(HAZY, sun, grid, nodes=96))
    np.testing.assert_allclose(found, exact, rtol=1 / 255)


def test_single_precision_and_slopes():
    dirs = af.Directions([0.5, 1.5, 1.57], [0.0, 1.0, 3.0])
    exact = np.asarray(layered_sky(HAZY, 1.3, dirs))
    with jax.enable_x64(False):
        small = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), HAZY)
        found = layered_sky(
            small, jnp.float32(1.3), jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), dirs)
        )
        assert found.dtype == np.float32
    np.testing.assert_allclose(found, exact, rtol=2e-4)

    def seen(values):
        return layered_sky(two_layers(*values, wavelength_nm=(450.0, 650.0)), 1.3, dirs).ravel()

    at = jnp.array([1e-4, 2e3])
    slope = jax.jit(jax.jacfwd(lambda v: seen((v[0], v[1]))))(at)
    for k, step in ((0, 1e-9), (1, 1e-2)):
        d = step * np.eye(2)[k]
        difference = (seen(tuple(at + d)) - seen(tuple(at - d))) / (2 * step)
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: two_layers(-1.0), "haze_extinction must be between 0 and 0.02"),
        (lambda: two_layers(1e-4, 9e3, 8e3), "air_top - haze_top must be"),
        (lambda: layered_sky(HAZY, 2.0, af.Directions([0.0], [0.0])), "solar_zenith_angle must"),
        (lambda: layered_sky(HAZY, 1.0, af.Directions([0.0], [0.0]), nodes=7), "nodes must be one"),
        (lambda: layered_sun(HAZY, 1.0, "round"), 'geometry must be one of "exact"'),
        (lambda: plan_layered_sky(HAZY, 1.0, 0.0), "rtol must be above 0"),
    ],
)
def test_bad_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_traced_plan_is_refused():
    with pytest.raises(TypeError, match="plan_layered_sky must be known"):
        jax.jit(lambda sun: plan_layered_sky(HAZY, sun).nodes)(1.0)
    assert ReconstructionPlan() == ReconstructionPlan(rtol=0.1)
