"""Density profiles: columns against quadrature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import atmofit as af

RADIUS = 6371e3
TABLE = ([0.0, 1e3, 3e3, 1e4], [2.0, 1.0, 1.5, 0.0])
CASES = {
    "exponential": (lambda: af.Exponential(2e3), 9e4, []),
    "gaussian": (lambda: af.GaussianLayer(22e3, 5e3), 9e4, [12e3, 22e3, 32e3]),
    "gaussian at the ground": (lambda: af.GaussianLayer(0.0, 3e3), 4e4, [3e3, 9e3]),
    "table": (lambda: af.Profile(*TABLE), 1e4, TABLE[0][1:3]),
    "table aloft": (lambda: af.Profile([2e3, 3e3], [1.0, 3.0]), 4e3, [2e3, 3e3]),
}


def _integral(function, low, high, breaks):
    inside = [b for b in breaks if low < b < high]
    return integrate.quad(function, low, high, points=inside or None, limit=200, epsabs=1e-12)[0]


@pytest.fixture(params=CASES, scope="module")
def case(request):
    make, top, breaks = CASES[request.param]
    profile = make()
    density = jax.jit(lambda z: profile.density(z))
    return profile, lambda z: float(density(z)), top, breaks


def test_normalised_and_vertical_column(case):
    profile, density, top, breaks = case
    assert _integral(density, 0, top, breaks) == pytest.approx(1, rel=1e-6)
    for z in (0.0, 500.0, 2.5e3, 9e3):
        exact = _integral(density, z, top, breaks)
        found = float(profile.vertical_column(jnp.asarray(z)))
        assert found == pytest.approx(exact, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("cosine", [0.0, 0.01, 0.3])
@pytest.mark.parametrize("z", [0.0, 2.5e3])
def test_slant_column(case, z, cosine):
    profile, density, top, breaks = case
    r0 = RADIUS + z
    along = r0 * cosine

    def distance(level):
        rise = max(level - z, 0) * (2 * r0 + level - z)
        return rise / (along + np.sqrt(along**2 + rise)) if rise else 0.0

    def at(s):
        more = s * (2 * along + s)
        return density(z + more / (np.sqrt(r0**2 + more) + r0))

    exact = _integral(at, 0, distance(top), [distance(b) for b in [*breaks, z + 2e3]])
    found = float(profile.rising_column(jnp.asarray(z), jnp.asarray(cosine), RADIUS))
    assert found == pytest.approx(exact, rel=2e-4, abs=1e-8)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_slopes_are_finite(case, dtype):
    profile = jax.tree.map(lambda x: x.astype(dtype), case[0])

    def column(profile, z, cosine):
        return profile.rising_column(z, cosine, RADIUS) + profile.vertical_column(z)

    z, cosine = (
        jnp.asarray(a.ravel(), dtype) for a in np.meshgrid([0.0, 1e3, 5e4], [0.0, 0.5, 1.0])
    )
    with_slopes = jax.value_and_grad(column, argnums=(0, 1, 2))
    found = jax.jit(jax.vmap(with_slopes, in_axes=(None, 0, 0)))(profile, z, cosine)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


def test_a_fine_exponential_table_is_exponential():
    z = np.concatenate([np.linspace(0, 2e4, 400), np.linspace(2e4, 1e5, 200)[1:]])
    table, closed = af.Profile(z, np.exp(-z / 8e3)), af.Exponential(8e3)
    for altitude in (0.0, 3e3, 3e4):
        at = jnp.asarray(altitude)
        for cosine in (0.0, 0.1, 1.0):
            mu = jnp.asarray(cosine)
            np.testing.assert_allclose(
                table.rising_column(at, mu, RADIUS), closed.rising_column(at, mu, RADIUS), rtol=2e-3
            )
        np.testing.assert_allclose(table.density(at), closed.density(at), rtol=2e-3)


def test_relative_density_is_relative():
    one, two = af.Profile(*TABLE), af.Profile(TABLE[0], 1e6 * np.asarray(TABLE[1]))
    z = jnp.array([0.0, 5e2, 5e3, 2e4])
    np.testing.assert_allclose(one.density(z), two.density(z), rtol=1e-12)
    assert one.density(z)[-1] == 0
    assert one.vertical_column(z)[-1] == 0


@pytest.mark.parametrize(
    ("altitude", "density", "message"),
    [
        ([0.0], [1.0], r"at least 2, got shapes \(1,\)"),
        ([0.0, 1.0], [1.0, 1.0, 1.0], r"got shapes \(2,\) and \(3,\)"),
        ([0.0, -1.0], [1.0, 1.0], "altitude must be between 0 and 1e.06 m, got -1"),
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "altitude must increase"),
        ([0.0, 1.0], [1.0, -2.0], "relative_density must be at least 0, got -2"),
        ([0.0, 1.0], [1.0, np.nan], "relative_density must be at least 0, got nan"),
        ([0.0, 1.0], [0.0, 0.0], "relative_density must be above 0 somewhere"),
    ],
)
def test_tables_that_are_refused(altitude, density, message):
    with pytest.raises((ValueError, TypeError), match=message):
        af.Profile(altitude, density)
