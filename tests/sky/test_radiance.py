"""Physics of the sky: closed forms, limits, symmetries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af

SUN = 0.8
VIEWS = np.radians([0.0, 25.0, 60.0, 80.0, 88.0])
DIRECTIONS = af.Directions(VIEWS, np.radians([0.0, 200.0, 90.0, 180.0, 5.0]))


def _simulate(air, sun=SUN, directions=DIRECTIONS, wavelength_nm=(550.0,), **keywords):
    keywords = {"orders": 1, "rtol": 5e-2, "solar_irradiance": 1.0} | keywords
    return np.asarray(af.simulate_sky(air, sun, directions, list(wavelength_nm), **keywords))


def _slab(phase, depth, albedo, sun, view, azimuth):
    """Light scattered once by a flat layer of one constituent, seen from below [1/sr]."""
    mu0, mu = np.cos(sun), np.cos(view)
    cosine = mu * mu0 + np.sin(view) * np.sin(sun) * np.cos(azimuth)
    x = depth * (1 / mu - 1 / mu0)
    same = np.abs(x) < 1e-9
    mean = np.where(same, 1.0, -np.expm1(-x) / np.where(same, 1.0, x))
    return albedo * phase(cosine) * depth / mu * np.exp(-depth / mu0) * mean


@pytest.mark.parametrize("sun", [0.0, 0.8, np.radians(60.0)])  # 60 degrees: view and sun alike
def test_a_flat_layer_of_one_constituent_is_a_closed_form(sun):
    view, azimuth = (np.asarray(a) for a in DIRECTIONS.angles())
    molecules = af.Atmosphere(af.Molecules(0.4), geometry="flat")
    expected = _slab(lambda c: 3 / (16 * np.pi) * (1 + c**2), 0.4, 1.0, sun, view, azimuth)
    np.testing.assert_allclose(_simulate(molecules, sun)[:, 0], expected, rtol=1e-4)
    haze = af.Haze(2.0, 0.0, single_scattering_albedo=0.7, phase=af.HenyeyGreenstein(0.6))
    expected = _slab(
        lambda c: 0.64 / (4 * np.pi * (1.36 - 1.2 * c) ** 1.5), 2.0, 0.7, sun, view, azimuth
    )
    found = _simulate(af.Atmosphere(haze=haze, geometry="flat"), sun)[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_single_scattering_in_a_flat_layer_is_reciprocal():
    """For light passing through: L(sun, view) cos(view) / cos(sun) does not change on exchange.

    Seen from below, layers of one constituent also look the same upside down.
    """
    air = af.Atmosphere(haze=af.Haze(0.7, phase=af.HenyeyGreenstein(0.5)), geometry="flat")
    one, two = 0.3, 1.2
    there = _simulate(air, one, af.Directions([two], [2.0]))[0, 0]
    back = _simulate(air, two, af.Directions([one], [2.0]))[0, 0]
    assert there * np.cos(two) == pytest.approx(back * np.cos(one), rel=1e-5)


def test_the_second_order_fades_with_the_square_of_a_thin_atmosphere():
    @jax.jit
    def orders(depth):
        air = af.Atmosphere(af.Molecules(depth), geometry="flat")
        one, two = (
            af.simulate_sky(air, SUN, DIRECTIONS, [550.0], n, 5e-2, 1.0)[:4, 0] for n in (1, 2)
        )
        return one, two - one

    ratios = []
    for depth in (1e-3, 1e-4, 1e-5):
        first, second = (np.asarray(x) for x in orders(depth))
        assert (second > 0).all()
        ratios.append(second / first)
    assert ratios[0].max() < 0.01
    # The ratio is near depth times log(1 / depth), from light that travels level.
    assert (ratios[0] / ratios[1] > 7).all()
    assert (ratios[0] / ratios[1] < 10.1).all()
    assert (ratios[1] / ratios[2] > 7.5).all()
    assert (ratios[1] / ratios[2] < 10.1).all()


@pytest.mark.parametrize("orders", [1, 2])
def test_without_scatterers_the_sky_is_black(orders):
    gas = af.Absorber(0.1, af.GaussianLayer(22e3, 5e3))
    for air in (af.Atmosphere(), af.Atmosphere(absorbers=(gas,), ground=af.Ground(1.0))):
        assert not _simulate(air, orders=orders).any()
        grid = af.DirectionGrid(VIEWS, np.array([0.0, 1.0]))
        assert af.simulate_sky(air, SUN, grid, [550.0], orders).shape == (5, 2, 1)


def test_absent_haze_is_haze_of_no_optical_depth():
    molecules = af.Molecules(0.1, 8.8e3)
    clear = _simulate(af.Atmosphere(molecules, geometry="flat"), orders=2)
    thin = _simulate(af.Atmosphere(molecules, af.Haze(0.0), geometry="flat"), orders=2)
    np.testing.assert_allclose(thin, clear, rtol=5e-3)


def test_an_absorber_only_dims():
    gas = af.Absorber(0.2, af.GaussianLayer(22e3, 5e3))
    clear = _simulate(af.Atmosphere(af.Molecules(0.1)))
    dimmed = _simulate(af.Atmosphere(af.Molecules(0.1), absorbers=(gas,)))
    ratio = dimmed / clear
    # The layer lies above nearly all the air, so the way through it is the sun's.
    np.testing.assert_allclose(ratio[0], np.exp(-0.2 / np.cos(SUN)), rtol=0.03)
    assert (ratio < 1).all()
    nothing = af.Absorber(0.0, af.GaussianLayer(22e3, 5e3))
    same = _simulate(af.Atmosphere(af.Molecules(0.1), absorbers=(nothing,)))
    np.testing.assert_allclose(same, clear, rtol=1e-12)


def test_the_sky_is_linear_in_the_suns_irradiance():
    air = af.Atmosphere(af.Molecules())
    one = _simulate(air, wavelength_nm=(450.0, 550.0))
    given = _simulate(air, wavelength_nm=(450.0, 550.0), solar_irradiance=[2.0, 3.0])
    np.testing.assert_allclose(given, one * np.array([2.0, 3.0]), rtol=1e-12)
    spectrum = _simulate(
        air, wavelength_nm=(450.0, 550.0), solar_irradiance=af.Spectrum([400.0, 600.0], [1.0, 3.0])
    )
    np.testing.assert_allclose(spectrum, one * np.array([1.5, 2.5]), rtol=1e-12)
    preset = _simulate(air, wavelength_nm=(450.0, 550.0), solar_irradiance=None)
    sun = af.solar_irradiance_spectrum("preetham1999")([450.0, 550.0])
    np.testing.assert_allclose(preset, one * np.asarray(sun), rtol=1e-12)


def test_the_sky_is_symmetric_and_constant_around_a_sun_overhead():
    air = af.Atmosphere.from_turbidity(3.0, geometry="flat")
    azimuth = np.array([0.0, 0.7, 2.0, -0.7, -2.0, 2 * np.pi])
    ring = af.Directions(np.full(6, 1.2), azimuth)
    field = af.solve_sky(air, [550.0], rtol=5e-2)
    sky = np.asarray(field.radiance(0.8, ring, 1.0))[:, 0]
    np.testing.assert_allclose(sky[1:3], sky[3:5], rtol=1e-10)
    assert sky[0] == pytest.approx(sky[5], rel=1e-10)
    overhead = np.asarray(field.radiance(0.0, ring, 1.0))[:, 0]
    np.testing.assert_allclose(overhead, overhead[0], rtol=1e-3)
    zenith = af.Directions(np.zeros(6), azimuth)
    up = np.asarray(field.radiance(0.8, zenith, 1.0))[:, 0]
    np.testing.assert_allclose(up, up[0], rtol=1e-3)


def test_paper_geometry_is_flat_below_70_degrees_and_spherical_beyond():
    views = np.radians([0.0, 40.0, 69.9, 70.1, 85.0])
    dirs = af.Directions(views, np.full(5, 0.4))
    for sun in np.radians([20.0, 69.0, 71.0]):
        sky = {
            geometry: _simulate(af.Atmosphere(af.Molecules(), geometry=geometry), sun, dirs)[:, 0]
            for geometry in ("flat", "spherical", "paper")
        }
        flat = (views < np.radians(70)) & (sun < np.radians(70))
        expected = np.where(flat, sky["flat"], sky["spherical"])
        np.testing.assert_allclose(sky["paper"], expected, rtol=1e-12)
        assert not np.allclose(sky["flat"], sky["spherical"], rtol=1e-4)


def test_a_large_planet_is_flat():
    air = [
        af.Atmosphere(af.Molecules(0.2), geometry="spherical", radius=1e9),
        af.Atmosphere(af.Molecules(0.2), geometry="flat"),
    ]
    spherical, flat = (_simulate(a, sun=1.2) for a in air)
    np.testing.assert_allclose(spherical[:4], flat[:4], rtol=1e-3)


def test_light_from_the_ground_adds_to_the_second_order_only():
    dark = af.Atmosphere(af.Molecules(0.2), geometry="flat")
    lit = af.Atmosphere(af.Molecules(0.2), ground=af.Ground(0.5), geometry="flat")
    np.testing.assert_allclose(_simulate(lit), _simulate(dark), rtol=1e-12)
    assert (_simulate(lit, orders=2) > 1.05 * _simulate(dark, orders=2)).all()
    black = af.Atmosphere(af.Molecules(0.2), ground=af.Ground(0.0), geometry="flat")
    np.testing.assert_allclose(_simulate(black, orders=2), _simulate(dark, orders=2), rtol=1e-12)


def test_few_wavelengths_replace_many():
    air, waves = af.Atmosphere.from_turbidity(6.0, geometry="flat"), np.arange(380.0, 781.0, 10.0)
    sky = {
        every: _simulate(
            air, wavelength_nm=waves, plan=af.plan_sky(air, orders=1, all_wavelengths=every)
        )
        for every in (True, False)
    }
    # Seen: 2.8e-3 near the horizon at 420 nm, under 2e-3 elsewhere; luminance is closer.
    np.testing.assert_allclose(sky[False], sky[True], rtol=4e-3)
    Y = {every: np.asarray(af.spectrum_to_XYZ(sky[every], waves))[..., 1] for every in sky}
    np.testing.assert_allclose(Y[False], Y[True], rtol=1e-3)


def test_float32_agrees_with_float64():
    air = af.Atmosphere.from_turbidity(4.0)
    sky = [
        _simulate(air, 1.3, plan=af.plan_sky(air, orders=2, rtol=5e-2, dtype=dtype))
        for dtype in ("float32", "float64")
    ]
    assert sky[0].dtype == np.float32
    assert np.abs(sky[0].astype(float) / sky[1] - 1).max() < 1e-3


def test_haze_in_a_table_of_altitudes_is_the_exponential_haze():
    z = np.concatenate([np.linspace(0, 6e3, 121), np.linspace(6e3, 3e4, 60)[1:]])
    closed = af.Atmosphere(af.Molecules(0.1), af.Haze(0.2, scale_height=1.2e3))
    table = af.Haze(0.2, profile=af.Profile(z, np.exp(-z / 1.2e3)))
    found = _simulate(af.Atmosphere(af.Molecules(0.1), table))
    np.testing.assert_allclose(found, _simulate(closed), rtol=5e-3)


def test_traced_everything():
    """jit, vmap and grad of one user's function."""

    def brightness(turbidity, sun):
        air = af.Atmosphere.from_turbidity(turbidity, geometry="flat")
        return af.simulate_sky(air, sun, DIRECTIONS, [500.0, 600.0], 1, 5e-2).sum()

    turbidity, sun = jnp.array([2.0, 4.0]), jnp.array([0.3, 1.2])
    batch = jax.jit(jax.vmap(brightness))(turbidity, sun)
    for i in range(2):
        assert float(batch[i]) == pytest.approx(float(brightness(turbidity[i], sun[i])), rel=1e-12)
    assert np.isfinite(jax.jit(jax.vmap(jax.grad(brightness)))(turbidity, sun)).all()
