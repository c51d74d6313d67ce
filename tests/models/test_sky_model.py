"""Sky models made of parts."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import atmofit as af
from atmofit.models.dependence import Basis, Dependence
from atmofit.models.shapes import AUREOLE, EXTENDED, PEREZ, Shape
from atmofit.models.sky_model import SkyModel
from atmofit.models.stored import from_dict, to_dict

DOME = af.dome_343()
MODEL = af.ATMOFIT_2026


def test_perez_shape_is_perez():
    """The same sky from free numbers as from A to E."""
    A, B, C, D, E = -0.9, -0.3, 4.0, -2.5, 0.4
    view, γ = np.linspace(0.0, 1.4, 7), np.linspace(0.0, 3.0, 7)
    # The shape's horizon factor is that of Perez at a cosine that is 0.01 larger.
    horizon = 1 + A * np.exp(B / (np.cos(view) + 0.01))
    expected = horizon * (1 + C * np.exp(D * γ) + E * np.cos(γ) ** 2)
    w = math.log(1 + A * math.exp(B / 1.01))
    numbers = jnp.asarray([0.0, math.log(C), math.log(E), w, math.log(-B), math.log(-D)])
    np.testing.assert_allclose(PEREZ(numbers, jnp.cos(view), jnp.asarray(γ)), expected, rtol=1e-12)


def test_peak_and_root_are_those_of_hosek_and_wilkie():
    H, γ, view = 0.7, np.linspace(0.0, 3.1, 9), np.linspace(0.0, 1.5, 9)
    numbers = dict.fromkeys(EXTENDED.names, 0.0)
    levels = {"ln_constant": 0.3, "ln_exponential": -60.0, "ln_cosine_squared": -60.0}
    numbers |= levels | {"ln_peak": 0.2, "ln_root": -0.4, "sharpness": math.log(H / (1 - H))}
    χ = (1 + np.cos(γ) ** 2) / (1 + H**2 - 2 * H * np.cos(γ)) ** 1.5
    root = np.sqrt(np.cos(view) + 0.01)
    expected = math.exp(0.3) + math.exp(0.2) * χ + math.exp(-0.4) * root
    found = EXTENDED(jnp.asarray(list(numbers.values())), jnp.cos(view), jnp.asarray(γ))
    np.testing.assert_allclose(found, expected, rtol=1e-12)  # w = 0: no horizon


@pytest.mark.parametrize("kind", ["polynomial", "spline"])
def test_bases_hold_cubics(kind):
    """Coefficients of a cubic exist, and its slope is smooth across the knots."""
    basis, x = Basis(kind, 7), jnp.linspace(0.0, 1.0, 50)
    values = jax.vmap(basis)(x)
    cubic = 1 - 2 * x + 3 * x**2 - 5 * x**3
    found, *_ = jnp.linalg.lstsq(values, cubic)
    np.testing.assert_allclose(values @ found, cubic, atol=1e-12)
    slope = jax.vmap(jax.jacfwd(basis))(x) @ found
    np.testing.assert_allclose(slope, -2 + 6 * x - 15 * x**2, atol=1e-10)


def test_coordinates_run_from_0_to_1():
    d = MODEL.dependence
    low, high = d.turbidity_range
    ends = [d.coordinates(jnp.asarray(T), jnp.radians(s), jnp.asarray(a)) for T, s, a in
            ((low, 0.0, 0.0), (high, d.latest_sun_deg, d.largest_albedo))]  # fmt: skip
    np.testing.assert_allclose(ends, [[0.0] * 3, [1.0] * 3], atol=1e-12)


def test_shipped_model_is_positive_and_smooth_to_its_edges_in_single_precision():
    """A dense grid to the horizon and through the sun; no jump between neighbours."""
    view = jnp.linspace(0.0, np.pi / 2, 61).astype("float32")
    grid = af.DirectionGrid(view, jnp.linspace(0.0, np.pi, 25).astype("float32"))
    suns = jnp.radians(jnp.linspace(0.0, MODEL.dependence.latest_sun_deg, 93)).astype("float32")
    low, high = MODEL.turbidity_range

    @jax.jit
    def sky(T, sun, albedo):
        return MODEL.XYZ(T, sun, grid, albedo)

    for T in (low, 2.0, 3.7, high):
        for albedo in (0.0, 0.8):
            at = [np.asarray(sky(jnp.float32(T), s, jnp.float32(albedo))) for s in suns]
            XYZ = np.stack(at)
            assert np.isfinite(XYZ).all()
            assert XYZ.min() > 0
            # Halved steps halve the largest change; a jump would stay.
            for axis in (0, 1, 2):
                logs = np.moveaxis(np.log(XYZ), axis, 0)
                changes = [np.abs(np.diff(logs[::every], axis=0)).max() for every in (1, 2)]
                assert changes[0] < 0.8 * changes[1]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_gradients_are_finite_at_the_corners(dtype):
    view = jnp.asarray([0.0, 1.0, np.pi / 2, np.pi / 2], dtype)
    dirs = af.Directions(view, jnp.asarray([0.0, 0.0, 0.0, np.pi], dtype))
    d = MODEL.dependence

    @jax.jit
    def slopes(T, s, a):
        def total(T, s, a):
            return jnp.log(MODEL.XYZ(T, s, dirs, a)).sum()

        return jax.grad(total, (0, 1, 2))(T, s, a)

    for T in d.turbidity_range:
        for sun in (0.0, 1.0, np.radians(d.latest_sun_deg)):
            for a in (0.0, d.largest_albedo):
                found = slopes(*(jnp.asarray(x, dtype) for x in (T, sun, a)))
                assert np.isfinite(found).all()


def test_outside_is_refused():
    low, high = MODEL.turbidity_range
    with pytest.raises(ValueError, match=f"turbidity must be between {low:g} and {high:g}, got 11"):
        MODEL(11.0, 1.0, DOME)
    with pytest.raises(ValueError, match="solar_zenith_angle must be between 0 and"):
        MODEL(3.0, 1.7, DOME)
    with pytest.raises(ValueError, match=r"albedo must be between 0 and 0.8, got 0.9"):
        MODEL(3.0, 1.0, DOME, 0.9)
    with pytest.raises(ValueError, match="wavelength_nm must be between 360 and 820"):
        MODEL.radiance(3.0, 1.0, DOME, [900.0])
    with pytest.raises(ValueError, match="colours must be True"):
        MODEL.only("wavelengths").XYZ(3.0, 1.0, DOME)
    with pytest.raises(ValueError, match="wavelength_nm must be empty"):
        MODEL.only("colours").radiance(3.0, 1.0, DOME, [500.0])
    assert np.isnan(jax.jit(lambda T: MODEL(T, 1.0, DOME))(11.0)).all()


def test_what_is_not_asked_for_is_not_computed():
    """Colours alone and spectra alone are the same numbers as together, from fewer operations."""
    λ = MODEL.wavelength_nm[3:6]
    np.testing.assert_allclose(
        MODEL.only("wavelengths").radiance(3.0, 1.0, DOME, λ), MODEL.radiance(3.0, 1.0, DOME, λ)
    )
    np.testing.assert_allclose(MODEL.only("colours")(3.0, 1.0, DOME), MODEL(3.0, 1.0, DOME))
    assert MODEL.only("colours").coefficients.shape[0] == 3


def test_spectrum_gives_the_colour():
    """Two fits of their own: within what both miss, a few per cent."""
    λ = np.arange(380.0, 781.0, 10.0)
    Y = af.spectrum_to_XYZ(MODEL.radiance(3.0, 1.0, DOME, λ), λ)[:, 1]
    np.testing.assert_allclose(MODEL(3.0, 1.0, DOME)[:, 2], Y, rtol=0.05)


def test_stored_model_comes_back_and_damage_is_seen():
    small = eqx.tree_at(lambda m: m.coefficients, MODEL, MODEL.coefficients[-3:])
    small = SkyModel(small.coefficients, MODEL.shape, MODEL.dependence)
    stored = to_dict(small)
    np.testing.assert_array_equal(from_dict(stored).coefficients, small.coefficients)
    stored["coefficients"][0][0][0] += 1e-3
    with pytest.raises(ValueError, match="hash"):
        from_dict(stored)


def test_parts_are_checked():
    with pytest.raises(ValueError, match='terms must be "constant"'):
        Shape(("exponential",))
    with pytest.raises(ValueError, match="size must be between 4 and 64"):
        Basis("spline", 3)
    with pytest.raises(ValueError, match="turbidity_range must increase"):
        Dependence(
            Basis("polynomial", 2), Basis("polynomial", 2), Basis("polynomial", 1), (3.0, 2.0)
        )
    with pytest.raises(ValueError, match="coefficients must have shape"):
        SkyModel(np.zeros((3, 2, 2)), AUREOLE, MODEL.dependence)


def test_new_values_compile_nothing():
    traced = []

    @jax.jit
    def sky(T, s, a):
        traced.append(T)
        return MODEL(T, s, DOME, a)

    for T in (2.0, 3.0, 5.0):
        sky(T, 0.1 * T, 0.01 * T)
    assert len(traced) == 1


def test_turbidity_of_the_models_own_sky():
    """A sky made by the model is found again at its turbidity."""
    luminance = MODEL(3.3, 1.0, DOME)[:, 2]
    seen = af.Observation(DOME, luminance, 1.0, relative_noise=0.01)
    estimate = af.estimate_turbidity(seen, MODEL)
    assert estimate.converged
    np.testing.assert_allclose(estimate.value, 3.3, rtol=1e-6)


def test_cie_skies():
    """Zenith 1; overcast horizon 1/3 nearly; uniform sky; the known clear formula."""
    view, γ, sun = jnp.asarray([0.0, np.pi / 2, 1.0]), jnp.asarray([1.0, 1.5, 0.2]), 1.0
    for number in range(1, 16):
        sky = af.cie_general_sky(number, view, γ, sun)
        assert sky[0] == pytest.approx(1.0)
        assert (sky > 0).all()
    overcast = af.cie_general_sky(1, view, γ, sun)
    # 1 / (1 + 4 exp(-0.7)): the standard's gradation, close to the traditional third.
    assert overcast[1] == pytest.approx(1 / (1 + 4 * math.exp(-0.7)), rel=1e-12)
    np.testing.assert_allclose(af.cie_general_sky(5, view, γ, sun), 1.0)
    # Type 12 is the CIE clear sky of 1973 (Preetham et al. 1999, Eq. 1): f = .91 + 10 e^-3γ + ...
    f = lambda γ: 0.91 + 10 * np.exp(-3 * γ) + 0.45 * np.cos(γ) ** 2  # noqa: E731
    known = f(0.2) * (1 - np.exp(-0.32 / np.cos(1.0))) / (0.27385 * f(1.0))
    assert af.cie_general_sky(12, view, γ, sun)[2] == pytest.approx(known, rel=2e-3)
    with pytest.raises(ValueError, match="sky_type must be a whole number from 1 to 15, got 16"):
        af.cie_general_sky(16, 0.0, 0.0, 0.0)


@jax.jit
def _value_and_slopes(place):
    def logs(p):
        return jnp.log(MODEL.XYZ(p[0], p[1], af.Directions(p[3:4], p[4:5]), p[2])).sum()

    return jax.value_and_grad(logs)(place)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(0.0, 1.0)] * 5), st.sampled_from(["float32", "float64"]))
def test_finite_and_positive_with_finite_slopes_anywhere(shares, dtype):
    """The float32 nearest to an end of a range counts as inside, in single precision."""
    low = np.array([1.2, 0.0, 0.0, 0.0, -10.0])
    high = np.array([10.0, np.radians(92.0), 0.8, np.pi / 2, 10.0])
    place = np.minimum(low + np.asarray(shares) * (high - low), high)
    value, slopes = _value_and_slopes(jnp.asarray(place, dtype))
    assert np.isfinite(value)  # the logarithm of a positive number
    assert np.isfinite(slopes).all()
