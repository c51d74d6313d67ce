"""Single scattering in a slab against a quadrature that shares no formula with it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.media.slab import slab_single_scattering

CASES = 10_000
PANELS = np.concatenate([[0.0], np.geomspace(1e-3, 40.0, 24)])  # of the exponent's change
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


def random_cases():
    """Depth 1e-12 to 1e4, cosines 1e-4 to 1, of which a third are nearly opposite."""
    random = np.random.default_rng(8)
    depth = 10 ** random.uniform(-12, 4, CASES)
    seen = 10 ** random.uniform(-4, 0, CASES)
    seen[::7] = 1e-4
    size = np.where(random.uniform(size=CASES) < 0.5, 10 ** random.uniform(-4, 0, CASES), 0.5)
    sun = size * np.where(random.uniform(size=CASES) < 0.5, 1.0, -1.0)
    apart = 10 ** random.uniform(-16, -2, CASES) * random.choice([-1.0, 0.0, 1.0], CASES)
    opposite = -np.minimum(np.maximum(seen + np.minimum(np.abs(apart), seen / 2), 1e-4), 1.0)
    within = -seen * (1 + 1e-12 * random.uniform(-1, 1, CASES))
    kind = np.arange(CASES) % 6
    sun = np.where(kind == 0, within, np.where(kind == 1, opposite, sun))
    return depth, seen, np.clip(sun, -1.0, 1.0)


def by_quadrature(depth, seen, sun):
    """Integral over depth of what comes in times what comes out, in Gauss-Legendre panels.

    The exponent is linear in depth; panels are counted from its largest end, and end where less
    than exp(-40) of it is left.
    """
    out = depth / seen  # exponents of the whole slab
    into = depth / np.abs(sun)
    rise = np.where(sun > 0, into + out, out - into)
    start = np.where(sun > 0, 0.0, np.minimum(into, out))
    drop = np.abs(rise)[:, None]
    edges = np.minimum(PANELS[None, :] / np.maximum(drop, 1e-300), 1.0)
    edges[:, -1] = np.where(drop[:, 0] < 40, 1.0, edges[:, -1])
    middle, half = (edges[:, 1:] + edges[:, :-1]) / 2, np.diff(edges) / 2
    share = middle[..., None] + half[..., None] * NODES
    return out * np.exp(-start) * np.sum(np.exp(-drop[..., None] * share) @ WEIGHTS * half, axis=1)


DEPTH, SEEN, SUN = random_cases()


@pytest.mark.parametrize(
    ("dtype", "rtol", "floor"),
    # Below the floor the true value is under exp(-700) or, in float32, near its smallest number.
    [("float64", 1e-10, 1e-300), ("float32", 1e-5, 1e-33)],
)
def test_slab_is_quadrature(dtype, rtol, floor):
    given = [value.astype(dtype) for value in (DEPTH, SEEN, SUN)]
    found = np.asarray(slab_single_scattering(*given), float)
    exact = by_quadrature(*(value.astype(float) for value in given))
    np.testing.assert_allclose(found, exact, rtol, floor)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_derivatives_are_finite(dtype):
    given = [jnp.asarray(value.astype(dtype)) for value in (DEPTH, SEEN, SUN)]
    every = jax.jit(jax.vmap(jax.grad(slab_single_scattering, argnums=(0, 1, 2))))
    assert all(np.isfinite(slope).all() for slope in every(*given))


def test_slope_across_the_opposite_direction():
    tau, mu, step = 0.7, 0.4, 1e-4
    slope = jax.grad(slab_single_scattering, argnums=2)
    two = [slab_single_scattering(tau, mu, -mu + sign * step) for sign in (1, -1)]
    # (e^a - e^b) / (a - b) has the slope e^a / 2 at a = b.
    expected = tau**2 / (2 * mu**3) * np.exp(-tau / mu)
    assert (two[0] - two[1]) / (2 * step) == pytest.approx(-expected, rel=1e-5)
    for shift in (1e-9, 0.0, -1e-9):
        assert slope(tau, mu, -mu + shift) == pytest.approx(-expected, rel=1e-6)


def test_a_deep_slab_is_hapke_and_irvines():
    mu, mu0 = np.meshgrid([1e-4, 0.1, 0.7, 1.0], [1e-4, 0.2, 0.7, 1.0])
    found = slab_single_scattering(1e4, mu, mu0)
    np.testing.assert_allclose(found, mu0 / (mu0 + mu), rtol=1e-14)
    np.testing.assert_allclose(slab_single_scattering(1e4, mu, -mu0), 0.0, atol=1e-300)


@pytest.mark.parametrize(("mu", "mu0"), [(0.8, -0.3), (0.3, -0.8), (0.01, -0.9)])
def test_what_passes_is_most_at_a_known_depth(mu, mu0):
    best = np.log(-mu0 / mu) / (1 / mu + 1 / mu0)
    slope = jax.grad(slab_single_scattering)
    assert abs(slope(best, mu, mu0)) < 1e-12 * slope(0.0, mu, mu0)
    around = slab_single_scattering(best * np.array([0.9, 1.0, 1.1]), mu, mu0)
    assert np.argmax(around) == 1


def test_fluxes_in_and_out_are_reciprocal():
    # Turning light and view round leaves f / mu0 as it is.
    for mu, mu0, sign in ((0.3, 0.8, 1), (0.3, 0.8, -1), (1e-4, 1.0, -1)):
        there = slab_single_scattering(0.6, mu, sign * mu0) / mu0
        back = slab_single_scattering(0.6, mu0, sign * mu) / mu
        assert float(there) == pytest.approx(float(back), rel=1e-13)


@pytest.mark.parametrize("tau", [1000.0, 2.0, 0.5, 0.1])
@pytest.mark.parametrize("incident", [36.0, 72.0, 108.0, 144.0])
def test_figure_8(incident, tau):
    """Light and view followed through one slab that stays as it is, from both sides of it."""
    sun, emission = np.cos(np.radians(incident)), np.cos(np.radians(np.arange(2.5, 180, 5)))
    share = (NODES + 1) / 2
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 40)])
    edges = np.unique(np.concatenate([edges, 1 - edges]))  # dense at both faces
    depth = tau * (edges[:-1, None] + np.diff(edges)[:, None] * share)
    weight = tau * np.diff(edges)[:, None] * WEIGHTS / 2
    into = depth / sun if sun > 0 else (tau - depth) / -sun
    found, expected = [], []
    for mu in emission:
        out = depth / mu if mu > 0 else (tau - depth) / -mu
        expected.append((weight * np.exp(-into - out)).sum())  # B times the cosine of emission
        side = sun if mu > 0 else -sun
        found.append(abs(mu) * float(slab_single_scattering(tau, abs(mu), side)))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-15)


def test_144_degrees_is_36_from_the_other_side():
    emission, mu0 = np.cos(np.radians(np.arange(5.0, 90, 10))), np.cos(np.radians(36.0))

    def both_sides(sun):  # what leaves upward, and downward, of light that comes from above if > 0
        return [np.asarray(slab_single_scattering(0.5, emission, side * sun)) for side in (1, -1)]

    up, down = both_sides(mu0)
    up_turned, down_turned = both_sides(np.cos(np.radians(144.0)))
    np.testing.assert_allclose([up, down], [down_turned, up_turned], rtol=1e-14)


def test_refuses_what_is_no_direction():
    with pytest.raises(ValueError, match="view_cosine must be between 1e-06 and 1, got 0"):
        slab_single_scattering(1.0, 0.0, 0.5)
    with pytest.raises(ValueError, match="optical_depth"):
        slab_single_scattering(-1.0, 0.5, 0.5)
