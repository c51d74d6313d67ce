"""The Neumann series of a slab: its sum, its order in the step, its slopes; Blinn's 5.3."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.slab_random_walk import walk_slab

import atmofit as af
from atmofit.media.scattering_orders import scattering_orders


def orders(
    depth: Any = 2.0, albedo: Any = 0.9, asymmetry: Any = 0.5, sun: Any = 1.2, count=60, **counts
):
    return scattering_orders(
        optical_depth=depth, single_scattering_albedo=albedo,
        phase=af.HenyeyGreenstein(asymmetry), solar_zenith_angle=sun, orders=count, **counts,
    )  # fmt: skip


def whole(depth=2.0, albedo=0.9, asymmetry=0.5, sun=1.2):
    return af.solve_slab(
        optical_depth=depth, single_scattering_albedo=albedo,
        phase=af.HenyeyGreenstein(asymmetry), solar_zenith_angle=sun, plan=af.SlabPlan(32, 32, 14),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("case", "count", "rtol"),
    [((2.0, 0.9, 0.5, 1.2), 60, 2e-4), ((10.0, 0.9, 0.85, 1.0), 200, 2e-3)],
    ids=["thin", "haze"],
)
def test_the_sum_is_all_the_light(case, count, rtol):
    """By default steps; in haze 16 moments of 64 leave 1.5e-3."""
    found, exact = orders(*case, count=count), whole(*case)
    np.testing.assert_allclose(jnp.sum(found.reflectance), exact.reflectance, rtol)
    np.testing.assert_allclose(
        jnp.sum(found.diffuse_transmittance), exact.diffuse_transmittance, rtol
    )


def test_second_order_in_the_step():
    exact = whole()
    errors = [
        [
            abs(float(jnp.sum(found.reflectance) / exact.reflectance) - 1),
            abs(float(jnp.sum(found.diffuse_transmittance) / exact.diffuse_transmittance) - 1),
        ]
        for found in (orders(count=80, streams=32, steps=n) for n in (16, 32, 64, 128))
    ]
    slopes = np.diff(np.log2(errors), axis=0)
    np.testing.assert_allclose(slopes, -2.0, atol=0.1)


def test_each_order_agrees_with_a_random_walk():
    """Albedo 1: order by order within 3 standard errors of 2e5 photons (24 values)."""
    up, down = walk_slab(2.0, 0.5, 1.2, photons=200_000).by_order()
    found = orders(albedo=1.0, count=12, streams=32)
    for (mean, error), shares in ((up, found.reflectance), (down, found.diffuse_transmittance)):
        assert np.all(np.abs(mean[1:13] - np.asarray(shares)) < 3 * error[1:13])


def test_the_first_order_is_exact():
    """Isotropic, against its integral over directions: no error of the step at all."""
    found = orders(asymmetry=0.0, count=1, streams=64, steps=2)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    mu, weights, sun = (nodes + 1) / 2, weights / 2, math.cos(1.2)
    # Radiance .9 / (4 pi) x factor, times 2 pi mu dmu / mu0.
    up = sun / (sun + mu) * -np.expm1(-2 * (1 / mu + 1 / sun))
    down = sun / (mu - sun) * (np.exp(-2 / mu) - np.exp(-2 / sun))
    back, through = (0.45 * np.sum(weights * mu * way) / sun for way in (up, down))
    np.testing.assert_allclose(found.reflectance, [back], rtol=1e-7)
    np.testing.assert_allclose(found.diffuse_transmittance, [through], rtol=1e-6)


def test_order_by_order_albedo_comes_in_as_its_power():
    bright, dark = orders(albedo=1.0, count=5), orders(albedo=0.5, count=5)
    half = 0.5 ** np.arange(1, 6)
    np.testing.assert_allclose(dark.reflectance, bright.reflectance * half, rtol=1e-12)


@pytest.mark.slow
def test_slopes_agree_with_differences():
    def share(values):
        found = orders(*values, count=10, steps=32)
        return jnp.append(found.reflectance[1:4], jnp.sum(found.diffuse_transmittance))

    values = jnp.asarray([2.0, 0.9, 0.5, 1.2])
    slope = jax.jit(jax.jacfwd(share))(values)
    compiled = jax.jit(share)
    for k in range(4):
        d = 1e-5 * np.eye(4)[k]
        difference = (compiled(values + d) - compiled(values - d)) / 2e-5
        np.testing.assert_allclose(slope[:, k], difference, rtol=1e-7, atol=1e-9)
    reverse = jax.jit(jax.grad(lambda v: jnp.sum(share(v))))(values)
    np.testing.assert_allclose(reverse, jnp.sum(slope, axis=0), rtol=1e-10)


def test_single_precision_is_near():
    exact = orders(10.0, 0.99, 0.85, 1.0, count=30)
    with jax.enable_x64(False):
        found = orders(*map(np.float32, (10.0, 0.99, 0.85, 1.0)), count=30)
        assert found.reflectance.dtype == np.float32
    np.testing.assert_allclose(found.reflectance, exact.reflectance, rtol=2e-5)


@pytest.mark.parametrize(("cosine", "ratio"), [(1.0, 1.27), (0.5, 1.20)])
def test_blinn_multiple_over_single(cosine, ratio):
    """Blinn 5.3 by his H functions: isotropic, albedo .3, without end; sun behind the observer."""
    angle = math.acos(cosine)
    view = af.Directions([math.pi - angle], [math.pi])
    found = whole(1e3, 0.3, 0.0, angle).radiance(view)[0]
    single = 0.3 / (4 * math.pi) * af.slab_single_scattering(1e3, cosine, cosine)
    assert float(found / single) == pytest.approx(ratio, abs=0.005)
    by_h = af.half_space_radiance(cosine, cosine, 0.3)
    np.testing.assert_allclose(found, by_h, rtol=1e-5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: orders(-1.0), "optical_depth must be between 0 and 100"),
        (lambda: orders(albedo=1.5), "single_scattering_albedo must be between 0 and 1"),
        (lambda: orders(sun=2.0), "solar_zenith_angle must be between"),
        (lambda: orders(count=0), "orders must be between 1 and 1000, got 0"),
        (lambda: orders(streams=7), "streams must be even, got 7"),
        (lambda: orders(steps=1), "steps must be between 2 and 1000, got 1"),
    ],
)
def test_bad_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
