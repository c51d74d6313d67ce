"""Checks of arguments: an error where values are known, NaN where they are traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.checks import angle_in_range, choice, in_range, is_traced


def test_known_values_inside_pass_and_keep_their_dtype():
    assert in_range("x", 1, 0.0, 2.0).dtype == jnp.float64
    assert in_range("x", np.float32(1), 0.0, 2.0).dtype == jnp.float32
    np.testing.assert_array_equal(in_range("x", [0, 1, 2], 0.0, 2.0), [0, 1, 2])
    in_range("x", jnp.array([0.0, 1e300]), 0.0, np.inf)


@pytest.mark.parametrize("bad", [-0.1, 2.1, np.nan, np.inf, -np.inf])
def test_known_values_outside_raise_with_name_value_and_range(bad):
    message = rf"^depth must be between 0 and 2 m, got {bad:.6g}$"
    with pytest.raises(ValueError, match=message):
        in_range("depth", bad, 0.0, 2.0, "m")


def test_messages():
    with pytest.raises(ValueError, match=r"x must be at least 0, got -1 \(2 of 3 values\)"):
        in_range("x", [-1.0, 1.0, -2.0], 0.0, np.inf)
    with pytest.raises(ValueError, match=r"x must be finite, got nan"):
        in_range("x", np.nan, -np.inf, np.inf)
    with pytest.raises(ValueError, match=r"x must be at least 0, got inf"):
        in_range("x", np.inf, 0.0, np.inf)


def test_traced_values_outside_become_nan():
    found = jax.jit(lambda x: in_range("x", x, 0.0, 2.0))(jnp.array([-1.0, 0, 2, 3, np.nan]))
    np.testing.assert_array_equal(found, [np.nan, 0, 2, np.nan, np.nan])
    assert jax.grad(lambda x: in_range("x", x, 0.0, 2.0))(2.0) == 1
    assert jax.jit(lambda x: in_range("x", x, 0.0, 2.0))(np.float32(1)).dtype == jnp.float32


def test_debug_checks_raise_at_run_time_and_only_inside():
    def program(x):
        return jax.jit(lambda x: in_range("depth", x, 0.0, 2.0))(x)

    with af.debug_checks():
        assert program(1.0) == 1
        with pytest.raises(Exception, match="depth must be between 0 and 2"):
            jax.block_until_ready(program(3.0))
    assert np.isnan(jax.jit(lambda x: in_range("depth", x, 0.0, 2.0))(3.0))


def test_debug_checks_end_with_an_error():
    with pytest.raises(RuntimeError, match="mine"), af.debug_checks():
        raise RuntimeError("mine")
    assert np.isnan(jax.jit(lambda x: in_range("x", x, 0.0, 2.0))(3.0))


def test_angles_have_room_for_the_rounding_of_float32():
    for right in (np.float32(np.pi / 2), np.radians(90.0), 0.0):
        angle_in_range("angle", right, 0.0, np.pi / 2)
    with pytest.raises(ValueError, match=r"angle must be between .* rad, got 1\.5709"):
        angle_in_range("angle", 1.5709, 0.0, np.pi / 2)


def test_is_traced_and_choice():
    seen = []
    jax.jit(lambda x: seen.append((is_traced(x), is_traced(1.0, (x,)))) or x)(1.0)
    assert seen == [(True, True)]
    assert not is_traced(1.0, jnp.ones(3), None)
    assert choice("colour", "red", ("red", "blue")) == "red"
    with pytest.raises(ValueError, match='colour must be one of "red", "blue", got \'green\''):
        choice("colour", "green", ("red", "blue"))
