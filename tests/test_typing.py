"""Arrays as the fields of our classes keep them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.typing import real_array


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        (np.ones(1, np.float32), jnp.float32),
        (jnp.float32(1.0), jnp.float32),
        (np.arange(3.0), jnp.float64),
        (np.arange(3), jnp.float64),
        (1, jnp.float64),
        ([0.5, 1], jnp.float64),
    ],
)
def test_dtype_is_kept_or_the_default(value, dtype):
    assert real_array(value).dtype == dtype


def test_an_array_first_traced_in_double_precision_becomes_single_in_single():
    table = np.arange(5.0)
    traced = jax.jit(lambda x: x * real_array(table))  # remembered while this name lives
    traced(jnp.asarray(1.0))
    with jax.enable_x64(False):
        assert real_array(table).dtype == jnp.float32
