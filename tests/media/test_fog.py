"""Fog against quadrature, the paper's own numbers and its errors."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from atmofit.media.fog import apply_fog, fog_transfer
from atmofit.media.fog_medium import FogLayer, fog_layer
from atmofit.optics.mie import mie_optics
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.optics.sizes import modified_gamma_sizes

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
    # The quadrature's own sum of 80 parts is good to some 1e-13.
    np.testing.assert_allclose(got.in_scattered[0], want, 1e-12)
    np.testing.assert_allclose(got.transmittance[0], math.exp(-depth(length)), 1e-12, 1e-15)


def test_far_and_level_is_source_over_extinction():
    f = fog(air=0.0)
    got = fog_transfer(f, math.inf, math.pi / 2, 0.0, 1.0, 2.0)
    want = math.exp(-25e-3 * 8 / math.cos(1.0)) / (4 * math.pi)
    np.testing.assert_allclose(got.in_scattered[0], want, 1e-12)


@pytest.mark.parametrize(
    ("eye", "top", "smallest", "largest"),
    [(2.0, 10.0, 0.050, 0.057), (5.0, 10.0, 0.124, 0.1585), (10.0, 20.0, 0.245, 0.332)],
)
def test_error_of_the_papers_constant_way(eye, top, smallest, largest):
    # Sun 30 degrees high, droplets alone, over views of the ground 3 to 30 degrees down.
    f, sun = fog(top=top, air=0.0), math.radians(60)
    view = np.radians(90 + np.linspace(3, 30, 28))
    exact, paper = (
        np.asarray(fog_transfer(f, math.inf, view, 0.0, sun, eye, 1.0, name).in_scattered)
        for name in ("exact", "constant")
    )
    error = 1 - paper / exact
    assert error.min() == pytest.approx(smallest, abs=5e-4)
    assert error.max() == pytest.approx(largest, abs=5e-4)


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


def test_a_spectrum_is_its_wavelengths():
    spectrum, light = [450.0, 550.0, 650.0], [1.0, 2.0, 3.0]
    where = ([5.0, 50.0], 1.7, 0.3, 1.0, 200.0)
    every = fog_transfer(fog_layer("dense", 100.0, spectrum), *where, light)
    for k in range(3):
        one = fog_transfer(fog_layer("dense", 100.0, spectrum[k : k + 1]), *where, light[k])
        np.testing.assert_allclose(every.in_scattered[:, k], one.in_scattered[:, 0], 1e-14)


def test_single_precision():
    # A depth of up to 100, rounded to 6e-8 of itself, stands in an exponent.
    random = np.random.default_rng(1)
    view, azimuth, sun = (random.uniform(0, high, 2000) for high in (math.pi, math.pi, 1.4))
    distance, eye = 10 ** random.uniform(-1, 5, 2000), random.uniform(0, 60, 2000)
    where = (distance, view, azimuth, sun, eye)
    single = tuple(x.astype(np.float32) for x in where)
    transfer = functools.partial(fog_transfer, fog(top=30.0))
    for sunlight in ("exact", "constant", "curved", "diffuse"):
        # The same rounded places, so that only the arithmetic differs.
        wide = transfer(*(x.astype(float) for x in single), sunlight=sunlight)
        narrow = transfer(*single, sunlight=sunlight)
        assert narrow.in_scattered.dtype == np.float32
        np.testing.assert_allclose(narrow.in_scattered, wide.in_scattered, 2e-5, 1e-9)
        np.testing.assert_allclose(narrow.transmittance, wide.transmittance, 2e-5, 1e-9)


def test_slopes_equal_differences():
    start = jnp.asarray([40.0, 1.7, 0.4, 1.1, 6.0, 2.5])

    @jax.jit
    def light(x):
        extinction = x[5:] / 100
        f = FogLayer(30.0, extinction, extinction, [1e-5], [550.0], HenyeyGreenstein(0.7))
        return fog_transfer(f, x[0], x[1], x[2], x[3], x[4]).in_scattered[0]

    found = jax.jit(jax.grad(light))(start)
    for k in range(6):
        step = 1e-4 * np.eye(6)[k]
        want = (light(start + step) - light(start - step)) / 2e-4
        # A central difference with this step leaves some 1e-8 of the third derivative.
        np.testing.assert_allclose(found[k], want, 1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"top": -1.0},
        {"extinction": [-1.0]},
        {"scattering": [0.03]},
        {"molecular_extinction": [math.nan]},
        {"air_top": 5.0},
        {"wavelength_nm": [100.0]},
    ],
)
def test_refuses_impossible_fog(change):
    values = {
        "top": 10.0,
        "extinction": [25e-3],
        "scattering": [25e-3],
        "molecular_extinction": [1e-5],
        "wavelength_nm": [550.0],
        "phase": EVEN,
        "air_top": 8e3,
    }
    with pytest.raises(ValueError, match=next(iter(change))):
        fog_transfer(FogLayer(**(values | change)), 1.0, 1.0, 0.0, 1.0)


def test_refuses_shapes_and_words():
    with pytest.raises(ValueError, match="scattering must have the shape"):
        FogLayer(10.0, [1.0, 1.0], [1.0], [0.0, 0.0], [500.0, 600.0], EVEN)
    with pytest.raises(ValueError, match="density"):
        fog_layer("thick", 10.0)
    with pytest.raises(ValueError, match="sunlight"):
        fog_transfer(fog(), 1.0, 1.0, 0.0, 1.0, sunlight="none")


def test_water_droplets_are_gray_from_a_mode_radius_of_a_micrometre_and_a_half():
    pytest.importorskip("miepython")
    spread = []
    for mode in (1e-6, 1.5e-6):
        sizes = modified_gamma_sizes(mode, 6.0)
        found = mie_optics(
            sizes, 1.333, [400.0, 550.0, 700.0], scattering_angle=[0.0, 1.0], radius_count=200
        ).extinction_cross_section
        spread.append(np.ptp(found) / found.mean())
    # The paper: below 5 %, its fog from 1 um. 200 radii hold these to some .3 %.
    assert spread[0] == pytest.approx(0.060, abs=0.004)
    assert spread[1] == pytest.approx(0.040, abs=0.005)


def test_presets_have_the_air_of_sea_level():
    # 1.16e-5 per metre at 550 nm, and the fourth power of the wavelength within 3 %.
    f = fog_layer("thin", 100.0, (450.0, 550.0, 650.0))
    want = 1.16e-5 * (550 / np.array([450.0, 550.0, 650.0])) ** 4
    np.testing.assert_allclose(f.molecular_extinction, want, 0.03)
    np.testing.assert_allclose(f.extinction, 15e-3)
