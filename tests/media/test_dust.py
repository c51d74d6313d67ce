"""Blinn's layers: limits that the paper states, compositing, spheres dropped at random, rings."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import atmofit as af
from atmofit.media.dust import (
    dense_optical_depth,
    empty_probability,
    hapke_irvine,
    opposition_factor,
    over_background,
    slab_brightness,
    slab_transparency,
)
from atmofit.media.rings import (
    RingProfile,
    in_sphere_shadow,
    ring_brightness,
    synthetic_ring_profile,
)
from atmofit.media.slab import slab_single_scattering
from atmofit.optics.particle_phases import Isotropic, LambertSphere, phase_of_phase_angle

PROFILE = RingProfile([1e8, 1.5e8, 2e8], [2.0, 1.0, 2.0], [0.2, 0.5, 0.2], [0.1, 0.25, 0.1])


def test_transparency_adds_no_light():
    depth, mu = np.geomspace(1e-6, 1e3, 40)[:, None], np.array([[1e-3, 0.1, 0.5, 1.0]])
    for forward in (0.0, 0.6, 1.0):
        through = np.asarray(slab_transparency(depth, mu, forward))
        assert through.min() >= 0
        assert through.max() <= 1
    # Erratum 24: as printed, w phi(pi) alone is added: 1.6 of the light without a slab.
    forward = 0.1 * float(phase_of_phase_angle(af.HenyeyGreenstein(0.5), math.pi))
    assert forward == pytest.approx(0.6)
    assert float(slab_transparency(0.0, 0.7, forward)) == 1.0
    # The forward term is single scattering from straight behind.
    behind = forward * slab_single_scattering(0.8, 0.7, -0.7)
    expected = math.exp(-0.8 / 0.7) + float(behind)
    assert float(slab_transparency(0.8, 0.7, forward)) == pytest.approx(expected)


def test_compositing():
    assert float(over_background(0.0, slab_transparency(0.0, 0.5), 3.0)) == 3.0
    assert float(over_background(0.2, 0.25, 4.0)) == pytest.approx(1.2)
    # Two layers over one another are one layer of their sum, but for the light between them.
    through = slab_transparency(0.3, 0.6) * slab_transparency(0.5, 0.6)
    assert float(through) == pytest.approx(float(slab_transparency(0.8, 0.6)))
    lower = slab_brightness(*(0.5, 0.6, 0.4, 0.9), single_scattering_albedo=1.0, phase=Isotropic())
    upper = slab_brightness(*(0.3, 0.6, 0.4, 0.9), single_scattering_albedo=1.0, phase=Isotropic())
    both = slab_brightness(*(0.8, 0.6, 0.4, 0.9), single_scattering_albedo=1.0, phase=Isotropic())
    lit = lower * math.exp(-0.3 / 0.4)  # the upper shades the lower
    found = over_background(upper, slab_transparency(0.3, 0.6), lit)
    assert float(found) == pytest.approx(float(both), rel=1e-12)


def test_full_moon_is_flat():
    mu = np.array([1e-5, 0.1, 0.5, 1.0])
    np.testing.assert_allclose(hapke_irvine(mu, mu), 0.5, rtol=1e-15)
    assert not np.asarray(hapke_irvine(mu, -mu)).any()
    deep = slab_brightness(
        1e4, mu, mu[::-1], 0.7, single_scattering_albedo=0.1, phase=LambertSphere()
    )
    phase = phase_of_phase_angle(LambertSphere(), 0.7)
    np.testing.assert_allclose(deep, 0.1 * phase * hapke_irvine(mu, mu[::-1]), rtol=1e-12)


def test_brightness_is_four_pi_radiance_in_a_thin_slab():
    # Erratum 57: flux out of both sides over scattered power is 1 for B / (4 pi) x irradiance.
    tau, mu0 = 1e-6, 0.6
    x, w = np.polynomial.legendre.leggauss(40)
    mu, w = (x + 1) / 2, w / 2
    both = sum(np.asarray(slab_single_scattering(tau, mu, side * mu0)) for side in (1, -1))
    flux = 2 * np.pi * (w * mu * both).sum() / (4 * np.pi)
    # Light met per area is mu0 (1 - exp(-tau / mu0)) = tau; grazing light is held back by
    # tau / mu on the way, which is of the order of tau ln(1 / tau).
    assert flux == pytest.approx(tau, rel=2e-5)


def test_blinns_opposition_factors():
    for tau, factor in ((0.1, 1.10), (1.0, 1.76), (1e3, 2.00)):
        assert float(opposition_factor(tau, 0.5, 0.0, 0.1)) == pytest.approx(factor, abs=5e-3)
    # From his two integrals.
    tau, mu = 0.7, 0.4
    new, old = 1 - math.exp(-tau / mu), (1 - math.exp(-2 * tau / mu)) / 2
    assert float(opposition_factor(tau, mu, 0.0, 0.01)) == pytest.approx(new / old)
    angle = np.linspace(0.0, np.pi, 200)
    narrow, wide = (np.asarray(opposition_factor(1.0, 0.5, angle, D)) for D in (0.01, 0.3))
    assert (np.diff(narrow) < 0).all()
    assert (np.diff(wide) < 0).all()
    assert (narrow[1:-1] < wide[1:-1]).all()
    assert narrow[-1] == pytest.approx(1.0)
    assert wide[-1] == pytest.approx(1.0)


def overlap_of_ways(phase_angle, volume_fraction, tau):
    """New over old brightness, sun and observer on either side of the normal, by quadrature.

    Both ways are cylinders of radius 1. Across their bisector, which is the normal, they are equal
    ellipses whose centres part with height, and whose common area is that of two circles.
    """
    density = 3 * volume_fraction / (4 * np.pi)
    sine, cosine = np.sin(phase_angle / 2), np.cos(phase_angle / 2)
    depth = np.concatenate([[0.0], np.geomspace(1e-6, min(tau, 60.0), 4000)])
    height = depth / (density * np.pi)
    apart = np.minimum(2 * height * sine, 2.0)
    common = (2 * np.arccos(apart / 2) - apart / 2 * np.sqrt(4 - apart**2)) / cosine
    twice = integrate.cumulative_trapezoid(common, height, initial=0)
    new, old = (np.exp(-2 * depth / cosine + extra) for extra in (density * twice, 0.0))
    return np.trapezoid(new, depth) / np.trapezoid(old, depth)


@pytest.mark.parametrize("tau", [0.05, 0.5, 2.0, 1e3])
@pytest.mark.parametrize("fraction", [0.003, 0.03, 0.3])
def test_opposition_fades_like_two_cylinders_part(tau, fraction):
    angle = np.radians(np.geomspace(0.05, 60, 15))
    exact = [overlap_of_ways(a, fraction, tau) for a in angle]
    found = opposition_factor(tau, np.cos(angle / 2), angle, fraction)
    np.testing.assert_allclose(found, exact, atol=0.04)  # seen: 0.0374


def test_dense_layers():
    assert float(dense_optical_depth(0.8, 0.0)) == pytest.approx(0.8)
    assert float(dense_optical_depth(0.8, 0.2)) == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"volume_fraction must be between 0 and 0\.99, got 1"):
        dense_optical_depth(1.0, 1.0)


def test_spheres_at_random_leave_tubes_empty_as_poisson_says():
    """Centres in a tube of a sphere's width; all spheres may overlap."""
    random = np.random.default_rng(2)
    count, tubes, area = 400, 20_000, np.pi * 0.05**2
    free = np.empty(tubes, bool)
    for start in range(0, tubes, 1000):  # 1000 fresh clouds at a time, each with one tube
        xy = random.uniform(-0.5, 0.5, (1000, count, 2))
        free[start : start + 1000] = ~((xy**2).sum(axis=2) < 0.05**2).any(axis=1)
    expected = float(empty_probability(count * area))
    error = math.sqrt(expected * (1 - expected) / tubes)
    # Three standard errors, and the difference between count fixed and count at random.
    assert abs(free.mean() - expected) < 3 * error + expected * count * area**2
    assert float(empty_probability(1.0, 0.5)) == pytest.approx(math.exp(-2))


def test_rods_that_may_not_overlap_shade_more():
    """In one dimension Esposito's correction is exact: hard rods, dropped by Tonks's map.

    Points at random on the line without the rods, each then opened by a rod's length, are hard rods
    in equilibrium. A start at random outside them lies in a gap in proportion to its length.
    """
    random = np.random.default_rng(3)
    fraction, count = 0.3, 200_000  # one rod for each unit of length
    gaps = np.diff(np.sort(random.uniform(0.0, count * (1 - fraction), count)))
    for way in (0.1, 0.5, 1.0, 2.0):
        found = np.maximum(gaps - way, 0.0).sum() / gaps.sum()
        expected = float(empty_probability(way, fraction))
        # Three standard errors of a ratio of means of exponential gaps.
        assert found == pytest.approx(expected, rel=3 * math.sqrt((2 / expected + 2) / count))


def test_spheres_that_may_not_overlap_shade_more():
    """A tenth of the space filled, one mean free path: Poisson is 13 % off, Esposito 4 %."""
    random = np.random.default_rng(4)
    fraction, width, boxes = 0.1, 16.0, 40
    density = fraction * 3 / (4 * np.pi)  # of unit spheres
    free, way = [], 1 / (density * np.pi)
    for _ in range(boxes):
        centres = np.empty((0, 3))
        while len(centres) < round(density * width**3):
            new = random.uniform(0.0, width, 3)
            apart = (new - centres + width / 2) % width - width / 2
            if ((apart**2).sum(axis=1) > 4).all():
                centres = np.vstack([centres, new])
        starts = random.uniform(0.0, width, (600, 3))
        apart = (centres - starts[:, None] + width / 2) % width - width / 2
        across = 1 - (apart[..., :2] ** 2).sum(axis=2)
        half, hit = np.sqrt(np.maximum(across, 0.0)), across > 0
        outside = ~(hit & (np.abs(apart[..., 2]) < half)).any(axis=1)
        ahead = apart[..., 2] % width - half
        free.append((~(hit & (ahead < way)).any(axis=1))[outside].mean())
    error = float(np.std(free, ddof=1)) / math.sqrt(boxes)
    poisson, dense = (float(empty_probability(1.0, D)) for D in (0.0, fraction))
    assert np.mean(free) + 4 * error < poisson
    assert np.mean(free) == pytest.approx(dense, abs=3 * error + 0.04 * dense)


def test_rings_add_two_kinds_of_particles():
    radius, mu, mu0, a = np.array([1.25e8, 1.5e8, 0.9e8]), 0.4, 0.6, 0.3
    bright, through = ring_brightness(PROFILE, radius, mu, mu0, a)
    depth, w1, w2 = np.array([1.5, 1.0, 0]), np.array([0.35, 0.5, 0]), np.array([0.175, 0.25, 0])
    large = float(phase_of_phase_angle(LambertSphere(), a))
    small = (1 - 0.25) / (1 + 0.25 + math.cos(a)) ** 1.5  # HG(-.5, a), forward
    expected = (w1 * large + w2 * small) * slab_single_scattering(depth, mu, mu0)
    np.testing.assert_allclose(bright, expected, rtol=1e-12)
    np.testing.assert_allclose(through, np.exp(-depth / mu), rtol=1e-12)


def test_the_unlit_side_turns_thin_rings_bright():
    profile = synthetic_ring_profile()
    radius = np.array([85e6, 110e6, 119.5e6])  # C ring, B ring, Cassini division
    lit, _ = ring_brightness(profile, radius, 0.4, 0.4, 0.5)
    dark, _ = ring_brightness(profile, radius, 0.4, -0.4, 2.6)
    assert lit[1] > lit[0]
    assert lit[1] > lit[2]
    assert dark[1] < dark[0]
    assert dark[1] < dark[2]


def test_shadow_of_a_sphere():
    sun = jnp.array([1.0, 0.0, 0.0])
    place = jnp.array([[-3.0, 0.5, 0.5], [3.0, 0.5, 0.5], [-3.0, 0.9, 0.9], [-1e3, 0.0, 0.99]])
    assert in_sphere_shadow(place, sun, 1.0).tolist() == [True, False, False, True]


def test_ring_profiles_are_checked():
    with pytest.raises(ValueError, match="must increase"):
        RingProfile([2e8, 1e8], [1.0, 1.0], [0.5, 0.5], [0.1, 0.1])
    with pytest.raises(ValueError, match="4 lists of one length"):
        RingProfile([1e8, 2e8], [1.0], [0.5, 0.5], [0.1, 0.1])
    bad = RingProfile([1e8, 2e8], [1.0, 1.0], [0.5, 1.5], [0.1, 0.1])
    with pytest.raises(ValueError, match="back_albedo"):
        ring_brightness(bad, 1.5e8, 0.5, 0.5, 0.1)
