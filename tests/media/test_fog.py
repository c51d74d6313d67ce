"""Fog against quadrature, the paper's own numbers and its errors."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from atmofit.media.fog import (
    FogLayer,
    apply_fog,
    fog_layer,
    fog_transfer,
    shell_path,
    sunlight_below,
)
from atmofit.optics.phase import HenyeyGreenstein

EVEN = HenyeyGreenstein(0.0)


def fog(beta=25e-3, top=10.0, air=1e-5):
    return FogLayer(top, [beta], [beta], [air], [550.0], EVEN, 8e3)


@pytest.mark.parametrize("zenith", [0.2, 1.0, 1.2, math.pi / 2, 1.8, 2.9])
@pytest.mark.parametrize("eye", [0.5, 10.0, 50.0])
@pytest.mark.parametrize("distance", [5.0, math.inf])
def test_equals_quadrature(zenith, eye, distance):
    f, sun = fog(), 1.0
    up = math.cos(zenith) if abs(zenith - math.pi / 2) > 1e-9 else 0.0
    edge = 8e3 - eye if up >= 0 else eye
    length = min(distance, 1e6, edge / max(abs(up), 1e-6))
    got = fog_transfer(f, distance, zenith, 2.0, sun, eye)
    cos = math.cos(zenith) * math.cos(sun) + math.sin(zenith) * math.sin(sun) * math.cos(2.0)
    ray = 3 / (16 * math.pi) * (1 + cos**2) * 1e-5

    # Beyond 1500 m of fog exp(-37) is left, below the tolerance.
    if abs(up) < 1e-9 and eye < 10.0:
        length = min(length, 1500.0)
    # Split at the fog's top, where both integrands jump.
    cut = (10.0 - eye) / up if up else -1.0
    cuts = [0.0, *([cut] if 0 < cut < length else []), length]

    def depth(x):
        low, high = sorted((eye, eye + up * x))
        share = (
            (max(min(high, 10.0) - low, 0.0) / (high - low)) if high > low else float(eye < 10.0)
        )
        return 1e-5 * x + 25e-3 * x * share

    def source(x, mid):
        z = eye + up * x
        fogged = eye + up * mid < 10.0  # at the top, level: air
        sunlit = math.exp(-(1e-5 * (8e3 - z) + 25e-3 * max(10.0 - z, 0.0)) / math.cos(sun))
        return (ray + (25e-3 / (4 * math.pi) if fogged else 0.0)) * sunlit * math.exp(-depth(x))

    want = 0.0
    for a, b in itertools.pairwise(cuts):
        pieces = np.concatenate([[0.0], np.geomspace(min(1.0, (b - a) / 2), b - a, 40)]) + a
        want += sum(
            quad(source, p, q, args=((a + b) / 2,), epsabs=0, epsrel=1e-13)[0]
            for p, q in itertools.pairwise(pieces)
        )
    np.testing.assert_allclose(got.in_scattered[0], want, 1e-11)
    np.testing.assert_allclose(got.transmittance[0], math.exp(-depth(length)), 1e-11, 1e-15)


def test_far_and_level_is_source_over_extinction():
    f = fog(air=0.0)
    got = fog_transfer(f, math.inf, math.pi / 2, 0.0, 1.0, 2.0)
    want = math.exp(-25e-3 * 8 / math.cos(1.0)) / (4 * math.pi)
    np.testing.assert_allclose(got.in_scattered[0], want, 1e-12)


@pytest.mark.parametrize(("eye", "top", "error"), [(2, 10, -0.05), (5, 10, -0.14), (10, 20, -0.3)])
def test_error_of_the_papers_constant_way(eye, top, error):
    f, sun = fog(top=float(top), air=0.0), math.radians(60)
    exact, paper = (
        fog_transfer(f, math.inf, math.radians(95), 0.0, sun, float(eye), 1.0, name).in_scattered
        for name in ("exact", "constant")
    )
    assert float(paper[0] / exact[0] - 1) == pytest.approx(error, abs=0.01)


def test_object_component_is_equation_40_and_corrected_47():
    f, csc = fog(), 1 / math.sin(0.6)
    got = sunlight_below(f, 0.0, math.pi / 2 - 0.6)[0]
    eq40 = math.exp(-csc * (1e-5 * 8e3 + 25e-3 * 10))
    eq47 = math.exp(-1e-5 * (8e3 - 10) * csc - (25e-3 + 1e-5) * 10 * csc)
    np.testing.assert_allclose([float(got), eq47], eq40, 1e-14)


def test_two_pieces_equal_one():
    f, z, sun = fog(), 1.2, 0.9
    one = fog_transfer(f, 12.0, z, 1.0, sun, 1.0)
    a = fog_transfer(f, 5.0, z, 1.0, sun, 1.0)
    b = fog_transfer(f, 7.0, z, 1.0, sun, 1.0 + 5 * math.cos(z))
    np.testing.assert_allclose(one.transmittance, a.transmittance * b.transmittance, 1e-13)
    both = a.in_scattered + a.transmittance * b.in_scattered
    np.testing.assert_allclose(one.in_scattered, both, 1e-13)


def test_image_equals_pixels_and_back_light_is_brighter():
    f = fog_layer("thin", 30.0)
    distance, azimuth = np.array([[3.0, math.inf]]), np.array([[0.0, math.pi]])
    image = np.full((1, 2, 1), 0.1)
    got = apply_fog(image, f, distance, math.pi / 2, azimuth, 1.0, 2.0)
    for j in range(2):
        pixel = apply_fog([0.1], f, distance[0, j], math.pi / 2, azimuth[0, j], 1.0, 2.0)
        np.testing.assert_allclose(got[0, j], pixel, 1e-14)
    toward, away = (
        fog_transfer(f, 50.0, math.pi / 2, a, 1.0, 2.0).in_scattered[0] for a in (0.0, math.pi)
    )
    assert toward > 10 * away


@pytest.mark.parametrize(("top", "error"), [(9250.0, 0.01), (1000.0, 0.0011), (1e5, 0.098)])
def test_flat_earth_error_at_15_degrees(top, error):
    flat = top / math.sin(math.radians(15))
    assert flat / float(shell_path(top, math.radians(75))) - 1 == pytest.approx(error, rel=0.05)
