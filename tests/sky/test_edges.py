"""Edges of the simulator's domain at which it once failed."""

import jax
import numpy as np
import pytest

import atmofit as af

TWO = af.Directions(np.radians([0.0, 60.0]), np.radians([0.0, 90.0]))
ALL_DOWN = af.Directions(np.radians([0.0, 30.0, 60.0, 80.0, 85.0, 89.0]), np.zeros(6))
WAVELENGTHS = np.arange(380.0, 781.0, 10.0)


@pytest.mark.parametrize(("turbidity", "sun"), [(0.5, 0.5), (2.0, 1.7), (np.nan, 0.5)])
def test_traced_bad_input_is_nan_also_between_wavelength_nodes(turbidity, sun):
    @jax.jit
    def sky(turbidity, sun):
        air = af.Atmosphere.from_turbidity(turbidity)
        return af.simulate_sky(air, sun, TWO, WAVELENGTHS, orders=1, rtol=5e-2)

    assert np.isnan(sky(turbidity, sun)).all()


def test_flat_horizon_is_the_same_in_both_precisions():
    air = af.Atmosphere.from_turbidity(3.0, "flat")
    views = np.array([np.float32(np.pi / 2), np.pi / 2])
    sky = [
        af.simulate_sky(
            air,
            0.5,
            af.Directions(views, 0 * views),
            [550.0],
            plan=af.plan_sky(air, orders=1, dtype=d),
        )
        for d in ("float32", "float64")
    ]
    np.testing.assert_allclose(np.ravel(sky), float(sky[1][1, 0]), rtol=1e-3)


@pytest.mark.parametrize(
    ("turbidity", "sun_deg", "geometry"),
    [
        (64.0, 60.0, "spherical"),
        (40.0, 85.0, "spherical"),
        (2.0, 90.0, "flat"),
        (64.0, 60.0, "flat"),
    ],
)
def test_radiance_is_never_negative(turbidity, sun_deg, geometry):
    air = af.Atmosphere.from_turbidity(turbidity, geometry)
    sky = af.simulate_sky(air, np.radians(sun_deg), ALL_DOWN, [450.0, 550.0, 650.0], rtol=5e-2)
    assert np.isfinite(sky).all()
    assert (np.asarray(sky) >= 0).all()


@pytest.mark.slow
def test_two_rungs_agree_in_thick_haze():
    """Turbidity 20 is an optical depth of 1.9, which thins the light by powers of ten."""
    air = af.Atmosphere.from_turbidity(20.0)
    coarse, fine = (
        np.asarray(af.simulate_sky(air, np.radians(60.0), ALL_DOWN, [550.0], rtol=rtol))
        for rtol in (5e-2, 1e-2)
    )
    np.testing.assert_allclose(coarse, fine, rtol=6e-2)


def test_haze_aloft_is_resolved():
    """Single scattering in a flat layer of one constituent does not depend on its altitudes."""
    aloft = af.Haze(0.1, 0.0, profile=af.Profile([1e4, 1.1e4], [1.0, 1.0]))
    low = af.Haze(0.1, 0.0, scale_height=1e3)
    sky = [
        np.asarray(
            af.simulate_sky(af.Atmosphere(haze=haze, geometry="flat"), 0.5, TWO, [550.0], orders=1)
        )
        for haze in (aloft, low)
    ]
    np.testing.assert_allclose(*sky, rtol=1e-3)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (lambda: af.Absorber(0.1, af.GaussianLayer(22e3, -5e3)), "width must be .* got -5000"),
        (lambda: af.Absorber(0.1, af.GaussianLayer(22e3, 0.0)), "width must be .* got 0"),
        (lambda: af.Absorber(0.1, af.GaussianLayer(np.nan, 5e3)), "centre must be .* got nan"),
        (lambda: af.Absorber(0.1, af.Exponential(-1.0)), "scale_height must be .* got -1"),
        (
            lambda: af.Haze(0.1, relative_efficiency=af.Spectrum([300.0, 900.0], [-1.0, 1.0])),
            "relative_efficiency must be .* got -1",
        ),
    ],
)
def test_impossible_constituents_are_refused(part, message):
    with pytest.raises(ValueError, match=message):
        part().checked()


@pytest.mark.parametrize("rings", [(3, -1), (1, 1, 0), (1,)])
def test_impossible_rings_are_refused(rings):
    with pytest.raises(ValueError, match="rings must be whole numbers"):
        af.Directions([0.0, 1.0], [0.0, 1.0], rings)


def test_message_prints_the_stated_limits():
    with pytest.raises(ValueError, match="between 380 and 780 nm, got 370"):
        af.simulate_sky(af.Atmosphere(af.Molecules()), 0.5, TWO, [370.0], orders=1)
