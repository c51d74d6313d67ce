"""One function of a user's, compiled in one process for single and for double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af

A, B, C, D, E = -1.0, -0.3, 5.0, -2.5, 0.3
SUN = 0.5
VIEW, AZIMUTH = np.linspace(0.1, 1.5, 40), np.linspace(0.0, 9.0, 40) % 3.1
COSINE = np.cos(VIEW) * np.cos(SUN) + np.sin(VIEW) * np.sin(SUN) * np.cos(AZIMUTH)
VALUES = (1 + A * np.exp(B / np.cos(VIEW))) * (
    1 + C * np.exp(D * np.arccos(COSINE)) + E * COSINE**2
)


@pytest.mark.slow
def test_a_fit_is_compiled_for_both():
    # JAX takes an array that is kept, such as the default prior's, for what it was at first.
    @jax.jit
    def coefficients(values, sun):
        return af.fit_perez(af.Directions(VIEW, AZIMUTH), sun, values).coefficients

    found = []
    for dtype in ("float32", "float64", "float32"):
        with jax.enable_x64(dtype == "float64"):
            values = jnp.asarray(VALUES, dtype)
            found.append(coefficients(values, jnp.asarray(SUN, dtype)))
            assert found[-1].dtype == dtype
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_allclose(found[0], (A, B, C, D, E), rtol=1e-2)  # the prior pulls
    np.testing.assert_allclose(found[1], (A, B, C, D, E), rtol=1e-2)
