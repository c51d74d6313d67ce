"""H functions against their table, their integral equation and a thick slab."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.media.h_functions import h_function, half_space_radiance

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
NODES, WEIGHTS = (NODES + 1) / 2, WEIGHTS / 2


@pytest.mark.parametrize(
    ("albedo", "at_one"), [(0.1, 1.037), (0.3, 1.127), (0.6, 1.335), (0.9, 1.850)]
)
def test_values_at_one(albedo, at_one):
    assert float(h_function(1.0, albedo)) == pytest.approx(at_one, abs=5e-4)


@pytest.mark.parametrize(("albedo", "rtol"), [(0.5, 1e-9), (0.999, 1e-8), (1.0, 1e-5)])
def test_integral_equation(albedo, rtol):
    """1 / H = 1 - w / 2 mu int H / (mu + mu') dmu' (Chandrasekhar 1960, chapter V, equation 7)."""
    mu = np.array([1e-3, 0.1, 0.5, 1.0])
    H = np.asarray(h_function(NODES, albedo))
    integral = mu / 2 * albedo * ((WEIGHTS * H) / (mu[:, None] + NODES)).sum(axis=1)
    # The rule of 200 nodes misses 3e-9 at mu = 1e-3, where the integrand is steep.
    np.testing.assert_allclose(1 - integral, 1 / np.asarray(h_function(mu, albedo)), rtol=rtol)


def test_single_precision():
    mu = np.linspace(0.0, 1.0, 11)
    exact = np.asarray(h_function(mu, 0.99))
    with jax.enable_x64(False):
        found = h_function(jnp.asarray(mu, jnp.float32), jnp.float32(0.99))
    np.testing.assert_allclose(found, exact, rtol=5e-6)


@pytest.mark.parametrize("albedo", [0.3, 0.9])
def test_a_thick_slab_is_a_half_space(albedo):
    mu, sun = np.array([0.2, 0.7, 1.0]), 0.6
    plan = af.SlabPlan(64, 1, 14)
    slab = af.solve_slab(
        optical_depth=400.0, single_scattering_albedo=albedo, phase=af.HenyeyGreenstein(0.0),
        solar_zenith_angle=np.arccos(sun), plan=plan,
    )  # fmt: skip
    seen = slab.radiance(af.Directions(np.pi - np.arccos(mu), np.zeros(3)))
    # Double Gauss with 32 nodes a hemisphere: 2e-7 seen.
    np.testing.assert_allclose(seen, half_space_radiance(mu, sun, albedo), rtol=2e-6)


def test_bad_requests_are_refused():
    with pytest.raises(ValueError, match="cosine must be between 0 and 1"):
        h_function(1.5, 0.5)
    with pytest.raises(ValueError, match="single_scattering_albedo must be"):
        half_space_radiance(0.5, 0.5, -0.1)
