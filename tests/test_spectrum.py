"""Quantities that vary with wavelength."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.spectrum import Spectrum, at, spectral

NODES = np.array([400.0, 500.0, 700.0])
VALUES = np.array([1.0, 3.0, 2.0])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_linear_between_the_nodes(dtype):
    spectrum = Spectrum(NODES, VALUES)
    wavelength = jnp.asarray([[400.0, 450.0], [600.0, 700.0]], dtype)
    values = spectrum(wavelength)
    assert values.dtype == dtype
    np.testing.assert_allclose(values, [[1.0, 2.0], [2.5, 2.0]], rtol=1e-6)


def test_one_node_holds_there():
    assert float(Spectrum(np.array([550.0]), np.array([2.0]))(550.0)) == 2.0


def test_at_takes_numbers_and_spectra():
    wavelength = np.array([450.0, 600.0])
    np.testing.assert_allclose(at(3, wavelength), [3.0, 3.0])
    np.testing.assert_allclose(at(Spectrum(NODES, VALUES), wavelength), [2.0, 2.5])
    assert at(jnp.asarray(0.5), wavelength.astype("float32")).dtype == "float32"


def test_spectral_keeps_spectra():
    spectrum = Spectrum(NODES, VALUES, smooth=True)
    assert spectral(spectrum) is spectrum
    number = spectral(2)
    assert not isinstance(number, Spectrum)
    assert number.shape == ()


def test_outside_the_range():
    spectrum = Spectrum(NODES, VALUES)
    with pytest.raises(ValueError, match=r"wavelength_nm.*400.*700.*nm.*got 399"):
        spectrum(399.0)
    traced = jax.jit(lambda w: spectrum(w))(np.array([399.0, 450.0]))
    np.testing.assert_allclose(traced, [np.nan, 2.0])
    both = jax.jit(lambda n, w: Spectrum(n, VALUES)(w))(NODES, np.array([450.0, 701.0]))
    np.testing.assert_allclose(both, [2.0, np.nan])


def test_derivatives():
    def of_values(values):
        return Spectrum(NODES, values)(450.0)

    np.testing.assert_allclose(jax.grad(of_values)(jnp.asarray(VALUES)), [0.5, 0.5, 0.0])
    slope = jax.grad(lambda w: Spectrum(NODES, VALUES)(w))(450.0)
    assert float(slope) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("nodes", "values", "message"),
    [
        ([500.0, 400.0], [1.0, 2.0], "must increase, got 400 after 500"),
        ([400.0, 400.0], [1.0, 2.0], "must increase"),
        ([400.0, np.nan], [1.0, 2.0], "positive and finite, got nan"),
        ([-400.0, 500.0], [1.0, 2.0], "positive and finite, got -400"),
        ([400.0, 500.0], [1.0, np.nan], "values must be finite, got nan"),
        ([400.0, 500.0], [1.0], r"shapes \(2,\) and \(1,\)"),
        ([], [], r"shapes \(0,\)"),
    ],
)
def test_bad_input(nodes, values, message):
    with pytest.raises(ValueError, match=message):
        Spectrum(np.asarray(nodes), np.asarray(values))
