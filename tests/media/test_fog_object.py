"""What the sun lights in fog, and fog under a low sun over a round earth."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from atmofit.constants import EARTH_RADIUS
from atmofit.media.fog import fog_transfer
from atmofit.media.fog_medium import FogLayer
from atmofit.media.fog_object import diffuse_fog, fog_object, fog_sunlight
from atmofit.media.two_layers import shell_distance
from atmofit.optics.phase import HenyeyGreenstein

AIR, DROPS, TOP, AIR_TOP = 1e-5, 25e-3, 10.0, 8e3


def fog():
    return FogLayer(TOP, [DROPS], [DROPS], [AIR], [550.0], HenyeyGreenstein(0.0), AIR_TOP)


@pytest.mark.parametrize("height", [0.5, 5.0, 10.0])
@pytest.mark.parametrize("elevation", [0.05, 0.3, 1.2])
def test_object_component_is_equation_40_and_corrected_47(height, elevation):
    phi, ambient, light, reflectance = 0.6, 0.03, 2.0, 0.2
    csc, to_eye = 1 / math.sin(phi), height / math.sin(elevation)
    both = AIR + DROPS
    arriving = math.exp(-csc * (AIR * AIR_TOP + DROPS * TOP))
    eq40 = math.exp(-to_eye * both) * (ambient + light * reflectance * arriving)
    exponent = -to_eye * both - AIR * (AIR_TOP - TOP) * csc - both * TOP * csc
    eq47 = ambient * math.exp(-to_eye * both) + reflectance * light * math.exp(exponent)
    got = fog_object(
        fog(),
        reflectance,
        to_eye,
        math.pi / 2 + elevation,
        math.pi / 2 - phi,
        height,
        irradiance=light,
        ambient=ambient,
    )
    np.testing.assert_allclose(got[0], eq40, 1e-14)
    np.testing.assert_allclose(eq47, eq40, 1e-14)


def test_with_the_plus_of_print_the_object_brightens_in_fog():
    csc, both = 1 / math.sin(0.6), AIR + DROPS
    printed = math.exp(-AIR * (AIR_TOP - TOP) * csc + both * TOP * csc)
    assert printed > 1 > float(fog_sunlight(fog(), 0.0, math.pi / 2 - 0.6)[0])


def test_spectra_and_images_of_reflectance():
    f = FogLayer(TOP, [DROPS] * 2, [DROPS] * 2, [AIR] * 2, [500.0, 600.0], HenyeyGreenstein(0.0))
    distance = np.array([[3.0, 5.0, 7.0]])
    got = fog_object(f, np.full((1, 3, 2), 0.1), distance, 1.5, 1.0, 1.0, irradiance=[1.0, 2.0])
    assert got.shape == (1, 3, 2)
    np.testing.assert_allclose(got[..., 1], 2 * got[..., 0], 1e-14)


def way_of_sun(shell, altitude, sine):
    """By the law of cosines in the triangle of the earth's centre, the place and the shell."""
    if shell <= altitude:
        return 0.0
    inner, outer = EARTH_RADIUS + altitude, EARTH_RADIUS + shell
    # Area of the thin ring over the sum of roots, without a difference of large squares.
    ring = (shell - altitude) * (inner + outer)
    return ring / (inner * sine + math.hypot(inner * sine, math.sqrt(ring)))


def arriving(altitude, sine):
    ways = (way_of_sun(shell, altitude, sine) for shell in (AIR_TOP, TOP))
    return math.exp(-sum(x * way for x, way in zip((AIR, DROPS), ways, strict=True)))


@pytest.mark.parametrize("elevation_degrees", [0.0, 0.05, 0.5, 3.0, 30.0])
@pytest.mark.parametrize("altitude", [0.0, 9.0, 9.99, 50.0])
def test_low_sun_comes_as_far_as_the_shells_are(elevation_degrees, altitude):
    phi = math.radians(elevation_degrees)
    got = fog_sunlight(fog(), altitude, math.pi / 2 - phi, "curved")[0]
    np.testing.assert_allclose(got, arriving(altitude, math.sin(phi)), 1e-11, 1e-300)


def test_a_high_sun_sees_the_earth_flat():
    # 10 m of fog and 8 km of air: 1e-6 and .8 % of an optical depth of .16 at 15 degrees.
    flat, round_ = (
        fog_transfer(fog(), 50.0, 1.7, 1.0, math.radians(75), 5.0, 1.0, name).in_scattered[0]
        for name in ("exact", "curved")
    )
    assert 0 < round_ / flat - 1 < 0.01 * AIR * AIR_TOP / math.sin(math.radians(15))


@pytest.mark.parametrize("eye", [8.0, 500.0])
@pytest.mark.parametrize(
    ("elevation_degrees", "tolerance"), [(0.5, 8e-3), (2.0, 5e-4), (10.0, 1e-5)]
)
def test_low_sun_in_scattered_is_near_a_quadrature(elevation_degrees, tolerance, eye):
    phi, view = math.radians(elevation_degrees), 2.0
    sine, down = math.sin(phi), -math.cos(view)
    cut = max(eye - TOP, 0.0) / down
    cos = -down * sine + math.sin(view) * math.cos(phi)
    by_air = 3 / (16 * math.pi) * (1 + cos**2) * AIR
    by_fog = by_air + DROPS / (4 * math.pi)

    def source(x, scattering):
        passed = math.exp(-AIR * x - DROPS * max(x - cut, 0.0))
        return scattering * arriving(eye - x * down, sine) * passed

    want = sum(
        quad(source, *ends, args=(s,), epsabs=0, epsrel=1e-9)[0]
        for *ends, s in ((0.0, cut, by_air), (cut, eye / down, by_fog))
        if ends[1] > ends[0]
    )
    got = fog_transfer(fog(), math.inf, view, 0.0, math.pi / 2 - phi, eye, 1.0, "curved")
    # Straight between the ends of each piece; the sun's way bends as elevation^-2.
    np.testing.assert_allclose(got.in_scattered[0], want, tolerance)


def test_level_sun_leaves_no_direct_light_and_a_red_diffuse_one():
    f = FogLayer(
        50.0,
        [DROPS] * 3,
        [DROPS] * 3,
        [2.6e-5, 1.16e-5, 6e-6],
        [450.0, 550.0, 650.0],
        HenyeyGreenstein(0.0),
    )
    assert float(fog_sunlight(f, 0.0, math.pi / 2, "curved").max()) < 1e-100
    light = diffuse_fog(f, math.pi / 2)
    assert float(light[2]) > 5 * float(light[0])
    far = fog_transfer(f, 1e5, math.pi / 2, 1.0, math.pi / 2, 2.0, 1.0, "diffuse").in_scattered
    np.testing.assert_allclose(far, light, 1e-12)
    alone = fog_object(f, 0.3, 10.0, 1.6, math.pi / 2, 2.0, ambient=0.5, sunlight="diffuse")
    through = fog_transfer(f, 10.0, 1.6, 0.0, 1.5, 2.0).transmittance
    np.testing.assert_allclose(alone, 0.5 * through, 1e-13)


@pytest.mark.parametrize(("top", "error"), [(9250.0, 0.01), (1000.0, 0.0011), (1e5, 0.098)])
def test_flat_earth_error_at_15_degrees(top, error):
    sine = math.sin(math.radians(15))
    round_ = shell_distance(*(jnp.asarray(x) for x in (EARTH_RADIUS, top, sine)))
    assert float(top / sine / round_ - 1) == pytest.approx(error, rel=0.05)
