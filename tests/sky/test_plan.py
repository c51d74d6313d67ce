"""Plans: what is computed, what is left out, and what is refused."""

import itertools

import jax
import numpy as np
import pytest

import atmofit as af
from atmofit.sky.ladder import LADDER

AIR = af.Atmosphere(af.Molecules())


@pytest.mark.parametrize(
    ("rtol", "rung"),
    [
        (1.0, 1e-1),
        (6e-2, 5e-2),
        (5e-2, 5e-2),
        (4e-2, 1e-2),
        (1e-2, 1e-2),
        (1e-3, 5e-4),
        (5e-4, 5e-4),
    ],
)
def test_the_next_finer_rung_is_taken(rtol, rung):
    assert af.plan_sky(AIR, rtol=rtol).rtol == rung


def test_finer_rungs_have_more_nodes():
    nodes = [vars(af.plan_sky(AIR, rtol=r).nodes) for r in (1e-1, 5e-2, 1e-2, 2e-3, 5e-4)]
    for coarse, fine in itertools.pairwise(nodes):
        assert all(fine[name] >= coarse[name] for name in fine if name != "wavelength")


def test_plans_compare_by_what_shapes_the_program():
    one, two = af.plan_sky(AIR), af.plan_sky(af.Atmosphere.from_turbidity(2.0))
    assert one.left_out != two.left_out
    assert one == two
    assert hash(one) == hash(two)
    assert one != af.plan_sky(AIR, orders=1)


def test_a_printed_plan_says_what_is_left_out():
    text = str(af.plan_sky(AIR, orders=1))
    for words in ("second order: orders=1", "haze: absent", "ground: absent", "absorbers: absent"):
        assert f"left out: {words}" in text
    assert "computed: molecules" in text
    everything = af.Atmosphere(
        af.Molecules(),
        af.Haze(0.1),
        (af.Absorber(0.1, af.GaussianLayer(22e3, 5e3)),),
        af.Ground(0.1),
    )
    text = str(af.plan_sky(everything))
    for words in ("molecules", "haze", "1 absorber(s)", "ground", "every wavelength asked for"):
        assert f"computed: {words}" in text
    assert "left out: polarisation and refraction" in text


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"orders": 21}, 'orders must be 1 to 20 or "all", got 21'),
        ({"orders": 0}, 'orders must be 1 to 20 or "all", got 0'),
        ({"orders": "many"}, "orders must be 1 to 20 or \"all\", got 'many'"),
        ({"orders": "all", "by_order": True}, 'orders must be a number .* got "all"'),
        ({"rtol": -1e-2}, "rtol must be between 0.0005 and 1, got -0.01"),
        ({"rtol": 0.0}, "rtol must be .* got 0$"),
        ({"rtol": np.nan}, "rtol must be .* got nan"),
        ({"dtype": "float16"}, 'dtype must be "float32" or "float64", got \'float16\''),
        ({"solar_zenith_angle": 1.7}, "solar_zenith_angle must be .* rad, got 1.7"),
        ({"solar_zenith_angle": [0.1, np.nan]}, r"got nan \(1 of 2 values\)"),
    ],
)
def test_what_is_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        af.plan_sky(AIR, **keywords)


def test_a_tracer_is_refused():
    with pytest.raises(TypeError, match="solar_zenith_angle of plan_sky must be known"):
        jax.jit(lambda sun: af.plan_sky(AIR, solar_zenith_angle=sun) and sun)(0.5)


def test_known_suns_above_the_horizon_leave_twilight_out():
    day = af.plan_sky(AIR, solar_zenith_angle=np.radians([0.0, 90.0]))
    assert day.suns == (0.0, np.pi / 2)
    assert day.nodes.sun < af.plan_sky(AIR).nodes.sun
    assert "left out: twilight" in str(day)
    assert af.plan_sky(AIR, solar_zenith_angle=np.radians([0.0, 95.9])) == af.plan_sky(AIR)
    assert "twilight" not in str(af.plan_sky(AIR))


def test_flat_air_has_no_twilight():
    flat = af.Atmosphere(af.Molecules(), geometry="flat")
    assert af.plan_sky(flat).suns == (0.0, np.pi / 2)
    assert af.plan_sky(flat) == af.plan_sky(flat, solar_zenith_angle=[0.0, 1.5])
    with pytest.raises(ValueError, match=r"solar_zenith_angle must be .* got 1\.6"):
        af.plan_sky(flat, solar_zenith_angle=1.6)


def test_one_known_sun_leaves_the_others_out():
    noon, near = (af.plan_sky(AIR, solar_zenith_angle=np.radians(sun)) for sun in (42.0, 43.9))
    assert noon == near  # changing the sun a little compiles nothing new
    np.testing.assert_allclose(np.degrees(noon.suns), [40.0, 45.0])
    assert 2 * noon.nodes.sun < af.plan_sky(AIR, solar_zenith_angle=[0.0, 1.5]).nodes.sun
    assert "left out: suns outside 40 to 45 degrees" in str(noon)
    field = af.solve_sky(AIR, [550.0], plan=noon)
    with pytest.raises(ValueError, match=r"solar_zenith_angle must be between 0\.698132 and 0"):
        field.radiance(np.radians(50.0), af.Directions([0.0], [0.0]))


def test_known_thick_haze_takes_more_orders():
    def steps(turbidity, **asked):
        air = af.Atmosphere.from_turbidity(turbidity)
        return af.plan_sky(air, rtol=1e-2, **asked).nodes.steps

    rung = LADDER[1e-2].steps
    assert steps(8.0, orders="all") == rung
    assert steps(64.0, orders="all") == rung + 20
    assert steps(64.0, orders=2) == rung
    seen = []
    jax.jit(lambda turbidity: seen.append(steps(turbidity, orders="all")))(64.0)
    assert seen == [rung]  # values are not known there
