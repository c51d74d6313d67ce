"""What a scene does not need is not in the compiled program, and the plan says so."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_skies import DIRECTIONS, FEW_NODES, atmosphere
from small_skies import PARAMETERS as SKY

import atmofit as af
from atmofit.sky.luminance import luminance_nodes

EVERYTHING = atmosphere(SKY)
# Compiled in a third of the time, and what is absent is absent alike.
FLAT = dataclasses.replace(EVERYTHING, geometry="flat")
HAZY = af.Atmosphere.from_turbidity(6.0)
OVERHEAD = af.Directions([0.0], [0.0])
WAVELENGTHS = np.arange(380.0, 781.0, 10.0)


def few(air, **choices):
    """A plan on few nodes that keeps what `plan_sky` left out."""
    plan = af.plan_sky(air, rtol=5e-2, **choices)
    return dataclasses.replace(plan, nodes=FEW_NODES)


def operations(air, **choices):
    """Floating-point operations of the compiled simulation; loops count once."""
    plan = few(air, **choices)
    directions = choices.get("directions", DIRECTIONS)

    def job(air, sun):
        if plan.quantity == "luminance":
            return af.simulate_luminance(air, sun, directions, plan=plan)
        radiance = af.simulate_sky(air, sun, directions, WAVELENGTHS, plan=plan)
        return af.spectrum_to_xyY(radiance, WAVELENGTHS)

    compiled = jax.jit(job).lower(air, jnp.asarray(0.7)).compile()
    cost = compiled.cost_analysis()
    assert cost is not None
    return cost["flops"]


@pytest.fixture(scope="module")
def full():
    return operations(FLAT)


# The largest share of the full program that may be left. One order has no tables, sources or
# harmonics. A second scatterer costs a twentieth at least (a quarter on a sphere): its columns and
# phase functions, while the harmonics are shared. The ground is one more point on rays that sink.
# The zenith needs one azimuth mode of three and one direction of five; luminance three wavelengths
# where the spectrum is interpolated between four.
PARTS = {
    "no haze": ({"haze": None}, {}, 0.95),
    "no molecules": ({"molecules": None}, {}, 0.95),
    "no ground": ({"ground": None}, {}, 0.999),
    "one order": ({}, {"orders": 1}, 0.25),
    "only the zenith": ({}, {"directions": OVERHEAD}, 0.75),
    "only luminance": ({}, {"quantity": "luminance"}, 0.9),
}


@pytest.mark.parametrize(("absent", "choices", "share"), PARTS.values(), ids=PARTS)
def test_what_is_absent_costs_nothing(full, absent, choices, share):
    air = dataclasses.replace(FLAT, **absent)
    assert operations(air, **choices) < share * full


@pytest.mark.parametrize(
    ("choices", "computed", "left_out"),
    [
        ({"directions": OVERHEAD}, "the zenith", "azimuth modes and other directions"),
        ({"quantity": "luminance"}, "luminance from 3 wavelengths", "spectrum and chromaticity"),
        ({"orders": 1}, "single scattering", "second order: orders=1"),
    ],
)
def test_the_printed_plan_says_so(choices, computed, left_out):
    text = str(af.plan_sky(EVERYTHING, rtol=5e-2, **choices))
    assert f"computed: {computed}" in text
    assert f"left out: {left_out}" in text


def test_only_the_zenith_is_the_same_zenith():
    air = EVERYTHING
    for sun in (0.3, 1.5):
        whole = af.simulate_sky(air, sun, DIRECTIONS, [450.0], plan=few(air))
        alone = af.simulate_sky(air, sun, OVERHEAD, [450.0], plan=few(air, directions=OVERHEAD))
        # The azimuth modes that were left out vanish overhead.
        np.testing.assert_allclose(alone[0], whole[0], rtol=1e-12)


def test_a_field_for_the_zenith_refuses_other_directions():
    field = af.solve_sky(EVERYTHING, [450.0], plan=few(EVERYTHING, directions=OVERHEAD))
    with pytest.raises(ValueError, match=r"view_zenith_angle must be between 0 and 1e-06 rad"):
        field.radiance(0.3, DIRECTIONS)
    traced = jax.jit(lambda dirs: field.radiance(0.3, dirs))(DIRECTIONS)
    np.testing.assert_array_equal(np.isnan(np.asarray(traced)[:, 0]), [False, *[True] * 4])


def test_directions_below_the_horizon_and_traced_ones_are_refused():
    with pytest.raises(ValueError, match="view_zenith_angle must be"):
        af.plan_sky(EVERYTHING, directions=af.Directions([1.7], [0.0]))
    with pytest.raises(TypeError, match="directions of plan_sky must be known"):
        jax.jit(lambda dirs: af.plan_sky(EVERYTHING, directions=dirs) and dirs)(OVERHEAD)


@pytest.mark.parametrize("preset", ["preetham1999", "standard"])
def test_luminance_from_every_wavelength_is_the_tristimulus_value(preset):
    every = luminance_nodes(0, preset)
    irradiance = np.asarray(af.solar_irradiance_spectrum(preset)(WAVELENGTHS))
    exact = float(af.spectrum_to_XYZ(irradiance, WAVELENGTHS)[1])
    assert every.weight.sum() == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("count", [3, 4, 7, 10])
def test_luminance_nodes_are_those_of_gauss(count):
    nodes = luminance_nodes(count, "preetham1999")
    assert nodes.interpolation is not None
    x, at_nodes = (550 / WAVELENGTHS) ** 2, (550 / nodes.wavelength_nm) ** 2
    # A polynomial of degree 2 n - 1 interpolated at Gauss nodes keeps its integral.
    for degree in range(2 * count):
        found = nodes.weight @ (nodes.interpolation @ at_nodes**degree)
        assert found == pytest.approx(nodes.weight @ x**degree, rel=1e-9)


@pytest.fixture(scope="module")
def whole_spectrum():
    """Luminance of a hazy sky from its whole spectrum, by sun; two orders."""
    field = af.solve_sky(HAZY, WAVELENGTHS, plan=few(HAZY, all_wavelengths=True))
    spectra = {sun: field.radiance(sun, DIRECTIONS) for sun in (0.3, 1.4)}
    return {sun: af.spectrum_to_XYZ(sky, WAVELENGTHS)[..., 1] for sun, sky in spectra.items()}


@pytest.mark.parametrize(("rtol", "count"), [(5e-2, 3), (5e-4, 10)])
def test_luminance_is_that_of_the_spectrum(rtol, count, whole_spectrum):
    plan = dataclasses.replace(few(HAZY, quantity="luminance"), luminance_nodes=count)
    field = af.solve_sky(HAZY, None, plan=plan)
    for sun, exact in whole_spectrum.items():
        # On few nodes the second order is rough in wavelength, and the haze has kinks there.
        np.testing.assert_allclose(field.luminance(sun, DIRECTIONS), exact, rtol=rtol)


def test_luminance_with_an_absorber_takes_every_wavelength():
    gas = af.Absorber(0.1, af.GaussianLayer(22e3, 5e3))
    air = af.Atmosphere(af.Molecules(), absorbers=(gas,))
    spectrum = af.simulate_sky(air, 0.7, DIRECTIONS, WAVELENGTHS, plan=few(air, orders=1))
    found = af.simulate_luminance(
        air, 0.7, DIRECTIONS, plan=few(air, orders=1, quantity="luminance")
    )
    exact = af.spectrum_to_XYZ(spectrum, WAVELENGTHS)[..., 1]
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_a_field_of_one_kind_refuses_the_other():
    plan = few(EVERYTHING, quantity="luminance")
    with pytest.raises(ValueError, match="wavelength_nm must be None with a plan"):
        af.solve_sky(EVERYTHING, [450.0], plan=plan)
    with pytest.raises(ValueError, match="wavelength_nm may be None only with a plan"):
        af.solve_sky(EVERYTHING, None)
    field = af.solve_sky(EVERYTHING, [450.0], plan=few(EVERYTHING))
    with pytest.raises(ValueError, match='plan must be made for quantity "luminance"'):
        field.luminance(0.3, DIRECTIONS)
    with pytest.raises(ValueError, match="quantity must be one of"):
        af.plan_sky(EVERYTHING, quantity="colour")
