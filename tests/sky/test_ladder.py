"""The stored ladder: complete, consistent, and measured to keep its promises."""

import dataclasses
import itertools

import pytest

import atmofit as af
from atmofit.sky import ladder
from atmofit.sky.ladder import LADDER

DTYPES = ("float32", "float64")
FINEST_FIRST = sorted(LADDER)


def test_the_ladder_is_what_is_stored():
    rungs = ladder.stored()["rungs"]
    assert [rung["rtol"] for rung in rungs] == [1e-1, 5e-2, 1e-2, 2e-3, 5e-4]
    for rung in rungs:
        assert dataclasses.asdict(LADDER[rung["rtol"]]) == rung["nodes"]
        assert set(rung["measured"]) == set(DTYPES)
        assert all(type(count) is int and count > 0 for count in rung["nodes"].values())


@pytest.mark.parametrize("rtol", FINEST_FIRST)
def test_plans_take_the_stored_nodes(rtol):
    air = af.Atmosphere.from_turbidity(2.0)
    plan = af.plan_sky(air, solar_zenith_angle=[0.0, 1.5], rtol=rtol)
    assert (plan.rtol, plan.nodes) == (rtol, LADDER[rtol])
    twilight = af.plan_sky(air, rtol=rtol)
    assert twilight.nodes == dataclasses.replace(LADDER[rtol], sun=twilight.nodes.sun)
    assert twilight.nodes.sun >= 1.3 * plan.nodes.sun


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("rtol", FINEST_FIRST)
def test_every_rung_was_measured_to_keep_its_promise(rtol, dtype):
    found = ladder.measured(rtol, dtype)
    for name in ("reference", "random"):
        largest, rms = (getattr(found, f"{name}_{kind}") for kind in ("largest", "rms"))
        assert 0 < rms < largest < rtol
    assert found.largest == max(found.reference_largest, found.random_largest)


@pytest.mark.parametrize("dtype", DTYPES)
def test_finer_rungs_err_less_and_cost_more(dtype):
    every = [ladder.measured(rtol, dtype) for rtol in FINEST_FIRST]
    for fine, coarse in itertools.pairwise(every):
        assert fine.largest < coarse.largest
        assert fine.hot_seconds > coarse.hot_seconds > 0
    # The coarse rungs peak in the compiler, all alike to a megabyte or so: only the ends differ.
    assert every[0].peak_megabytes > every[-1].peak_megabytes > 0


def test_what_was_not_measured_is_refused():
    with pytest.raises(KeyError, match=r"no rung of the ladder has rtol 0\.003, float32"):
        ladder.measured(3e-3, "float32")
    with pytest.raises(KeyError, match=r"no rung of the ladder has rtol 0\.01, float16"):
        ladder.measured(1e-2, "float16")
