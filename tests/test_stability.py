"""The stability table: nothing fails, nothing public is missing, and faults are seen."""

import dataclasses
import itertools
import json
import types
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit import cli_stability, stability
from atmofit import fuzz as fuzz_module
from atmofit.checks import in_range
from atmofit.cli import main
from atmofit.extremes import DECLARATIONS, Case, Domain, Span, extremes
from atmofit.fuzz import POINTS, fuzz, somewhere

# Public names that need no declaration of their own.
EXEMPT = {
    "CloudFit": "result of fit_cloud",
    "fit_cloud": "converged_light many times; too long to compile here",
    "FogLayer": "declared through fog_transfer and fog_layer",
    "FogTransfer": "result of fog_transfer",
    "ScatteringOrders": "result of scattering_orders",
    "DustFit": "result of fit_dust",
    "TwoLayers": "made by two_layers, declared with layered_sky",
    "two_layers": "declared with layered_sky",
    "layered_sun": "declared with layered_sky",
    "haze_opacity": "declared with layered_sky",
    "plan_layered_sky": "counts and words",
    "reconstruct_layered_sky": "layered_sky at a few directions",
    "ReconstructionPlan": "counts and words",
    "adaptive_sky": "NumPy on the host, counted; no derivatives",
    "AdaptiveSky": "result of adaptive_sky",
    "in_sphere_shadow": "returns booleans",
    "synthetic_ring_profile": "takes only a seed",
    "SlabPlan": "counts and words",
    "SlabSolution": "result of solve_slab, declared with it",
    "plan_slab": "counts and words",
    "DensityProfile": "abstract",
    "SizeDistribution": "NumPy, checked when made",
    "junge_sizes": "NumPy, checked when made",
    "lognormal_sizes": "NumPy, checked when made",
    "modified_gamma_sizes": "NumPy, checked when made",
    "mie_haze": "NumPy, not traced; MieOptics is declared",
    "mie_optics": "NumPy, not traced; MieOptics is declared",
    "PhaseFunction": "abstract",
    "Plan": "counts and words",
    "plan_sky": "counts and words",
    "RefitSettings": "settings, checked when made",
    "debug_checks": "a switch",
    "dome_343": "constant directions",
    "read_coefficients": "reads a file",
    "solve_sky": "one half of simulate_sky",
    "SkyField": "the other half",
    "simulate_skies": "a table of simulate_sky",
    "PerezFit": "result of fit_perez",
    "ZenithFit": "result of the zenith fits",
    "DistributionFit": "result of fit_distribution",
    "RefitResult": "result of refit",
    "fit_distribution": "the search of fit_perez over a table; too long to compile here",
    "Identifiability": "result of the following",
    "identify_distribution": "fit_distribution from many starts",
    "identify_perez": "fit_perez from many starts",
    "identify_zenith": "arithmetic on a zenith fit",
    "Camera": "NumPy, checked when made",
    "ModelError": "part of estimate_turbidity",
    "Photograph": "NumPy, checked when made",
    "SimulatorModel": "static, part of estimate_turbidity",
    "DaylightSpectrum": "result of daylight_spectrum",
    "Light": "result of clear_light",
    "Picture": "result of render_landscape",
    "Terrain": "known heights",
    "View": "part of render_landscape",
    "clear_light": "light_around of a sky model",
    "overcast_light": "light_around of a formula",
    "procedural_terrain": "known heights",
    "read_elevation_grid": "reads a file",
    "render_landscape": "pictures: path_transfer and light_around at many pixels",
    "DepthFog": "a product and a sum",
    "LightAround": "result of light_around",
    "LowAir": "result of low_air",
    "Path": "part of path_transfer",
    "PathPlan": "static",
    "PathTransfer": "result of path_transfer",
    "SunTransmittance": "result of sun_transmittance",
    "WardLarson": "a product and a sum",
    "fit_depth_fog": "means of an array",
    "fit_ward_larson": "means of an array",
    "plan_path": "known numbers only",
    "Sought": "names of arguments",
    "SkyFromPhotograph": "result of sky_from_photograph",
    "SkySettings": "NumPy, checked when made",
    "TurbidityEstimate": "result of estimate_turbidity",
    "TurbidityProblem": "checked arguments of estimate_turbidity",
    "TurbidityProfile": "result of profile_turbidity",
    "TurbiditySamples": "result of sample_turbidity",
    "turbidity_problem": "checks for estimate_turbidity",
    "profile_turbidity": "many estimates, as estimate_turbidity",
    "read_observations": "reads a file",
    "read_photograph": "reads a file",
    "sample_turbidity": "random; its density is that of estimate_turbidity",
    "sky_from_photograph": "NumPy",
    "stored_model_error": "reads a file of the package",
    "sun_at": "an almanac of another package",
    "refit": "simulate_skies and the fits",
    "compare": "differences and means of results",
    "PREETHAM_1999": "a PreethamModel",
    "ATMOFIT_2026": "a SkyModel",
    "AUREOLE": "a Shape",
    "EXTENDED": "a Shape",
    "PEREZ": "a Shape",
    "CIEShape": "cie_general_sky with a level",
    "Basis": "declared with SkyModel",
    "Dependence": "declared with SkyModel",
    "Shape": "declared with SkyModel",
    "SkyModelFit": "result of fit_sky_model",
    "fit_sky_model": "a search over hundreds of skies; too long to compile here",
    "TrainedModel": "result of train",
    "TrainingSettings": "settings, checked when made",
    "simulate_training": "a table of simulate_sky",
    "train": "simulate_training and fit_sky_model",
    "read_sky_model": "reads a file",
    "BlockRun": "result of run_blocks",
    "BlockStore": "files",
    "FitWork": "fit_perez to many skies",
    "Hosts": "two counts, checked when made",
    "SeriesWork": "estimate_turbidity of many skies",
    "SkyWork": "a table of simulate_sky",
    "device_mesh": "known numbers only",
    "join_hosts": "words and known numbers",
    "over_devices": "another function's rows",
    "run_blocks": "writes files",
    "verify_store": "reads files",
}
ALL = stability.declarations()
SLOW = ("media.slab_solution.solve_slab alone", "media.slab_solution.solve_slab over a ground")
# `make stability` runs the heavy ones too, which take minutes to compile.
KINDS = [
    pytest.param(d, dtype, marks=pytest.mark.slow if d.name.startswith(SLOW) else ())
    for d in ALL
    if not d.heavy
    for dtype in stability.DTYPES
]


@pytest.fixture(scope="module")
def count():
    return {}


@pytest.mark.parametrize(("declaration", "dtype"), KINDS, ids=lambda x: getattr(x, "name", x))
def test_no_check_fails(declaration, dtype, count):
    checks = stability.run(declaration, dtype)
    count[declaration.name, dtype] = len(checks)
    failed = [f"{c.case}: {c.what}: {c.found}" for c in checks if not c.passed]
    assert checks
    assert not failed


def test_there_are_enough_checks(count):
    if len(count) < len(KINDS) - 2 * len(stability.DTYPES):  # the slow ones
        pytest.skip("some functions were not run")
    assert sum(count.values()) >= 600


def test_every_public_name_is_declared_or_exempt():
    declared = {d.subject.__name__ for d in ALL}
    assert not set(EXEMPT) - set(af.__all__)
    assert set(af.__all__) - declared - set(EXEMPT) == set()


def _declared(*cases, **keywords):
    before = len(DECLARATIONS)
    extremes(*cases, **keywords)(lambda: None)
    return DECLARATIONS.pop(before)


def _failures(declaration, dtype="float32"):
    return {(c.case, c.what) for c in stability.run(declaration, dtype) if not c.passed}


@pytest.mark.parametrize("derivative", ["reverse", "forward"])
def test_a_slope_that_is_not_finite_is_found(derivative):
    root = _declared(call=lambda x: jnp.sqrt(x), derivative=derivative, x=Span(0.0, 1.0))
    assert _failures(root) == {("x lowest", "slope by x finite")}


def test_a_wrong_limit_is_found():
    cases = (Case("wrong", {"x": 1.0}, 1.001, {"x": 2.5}), Case("right", {"x": 1.0}, 1, {"x": 2}))
    square = _declared(*cases, call=lambda x: x * x, x=Span(0.0, 1.0))
    assert _failures(square) == {
        ("wrong", "value is the limit"),
        ("wrong", "slope by x is the limit"),
    }
    assert not _failures(_declared(cases[1], call=lambda x: x * x, x=Span(0.0, 1.0)), "float64")


def test_arrays_and_forward_slopes_agree_with_reverse():
    spans = {"x": Span((0.0, 1.0), (2.0, 3.0)), "y": Span(-1.0, 1.0)}
    case = Case("known", {"x": (1.0, 2.0), "y": 1.0}, (2.0, 1.0), {"y": (0.0, 2.0)})
    for derivative in ("reverse", "forward"):
        found = _declared(
            case, call=lambda x, y: (x[0] * x[1], y * y), derivative=derivative, **spans
        )
        assert not _failures(found, "float64")
        middle = stability.program(found)(
            {"x": jnp.asarray([[1.0, 2.0]]), "y": jnp.asarray([1.0])}
        )[1]
        np.testing.assert_array_equal(middle["x"], [[[2.0, 1.0], [0.0, 0.0]]])


def test_a_domain_that_is_not_kept_is_found():
    lax = _declared(call=lambda x: 2 * x, x=Domain(0.0, 1.0))
    assert _failures(lax) == {
        ("x below", "traced: NaN"),
        ("x above", "traced: NaN"),
        ("x below", "known: ValueError"),
        ("x above", "known: ValueError"),
        ("x NaN", "known: ValueError"),
    }
    strict = _declared(call=lambda x: in_range("x", x, 0.0, 1.0), x=Domain(0.0, 1.0))
    assert not _failures(strict)


@pytest.mark.parametrize("dtype", stability.DTYPES)
def test_the_ends_belong_to_a_domain_in_both_precisions(dtype):
    for end in (0.999, 1.7, 0.1):  # the nearest float32 lies beyond the first two
        for value in (jnp.asarray(end, dtype), np.asarray(end, dtype)):
            assert in_range("x", value, -end, end) == value
            assert np.isfinite(jax.jit(lambda x, e=end: in_range("x", x, -e, e))(value))


def test_a_case_of_an_unknown_argument_is_refused():
    with pytest.raises(ValueError, match=r"case 'odd' names \['y'\], which have no span"):
        extremes(Case("odd", {"y": 0.0}), x=Span(0.0, 1.0))
    with pytest.raises(ValueError, match="derivative must be one of"):
        extremes(derivative="both", x=Span(0.0, 1.0))


def test_light_that_is_negative_is_found():
    dim = _declared(call=lambda x: x - 0.5, least=0.0, x=Span(0.0, 1.0))
    assert _failures(dim) == {(f"x {end}", "value not below 0") for end in ("lowest", "tiny")}


def test_the_command_reports_and_fails(tmp_path, monkeypatch, capsys):
    good = _declared(call=lambda x: x, x=Span(0.0, 1.0))
    bad = _declared(call=lambda x: jnp.sqrt(x), x=Span(0.0, 1.0))
    monkeypatch.setattr(cli_stability, "declarations", lambda: (good,))
    assert main(["stability", "--out", str(tmp_path)]) == 0
    monkeypatch.setattr(cli_stability, "declarations", lambda: (good, bad))
    assert main(["stability", "--out", str(tmp_path)]) == 1
    assert "2 failing" in capsys.readouterr().out
    report = json.loads((tmp_path / "stability.json").read_text())
    assert (report["checks"], report["failed"]) == (len(report["lines"]), 2)
    assert (tmp_path / "stability.md").read_text().count("**FAILS**") == 2
    assert main(["stability", "--only", "no such function", "--out", str(tmp_path)]) == 2
    assert "only must be part of a function's name" in capsys.readouterr().err


def test_a_hunt_finds_what_the_ends_do_not_show():
    # A hole of a thousandth of the span, and a root's slope at 0.
    hole = _declared(
        call=lambda x: jnp.where(jnp.abs(x - 0.3) < 5e-3, jnp.nan, x), x=Span(0.0, 1.0)
    )
    assert not _failures(hole)
    hunt = fuzz((hole,), 3.0)
    assert {check.what for check in hunt.findings} >= {"value finite"}
    assert abs(float(hunt.findings[0].case.removeprefix("x=")) - 0.3) < 5e-3
    assert (hunt.functions, hunt.of) == (2, 2)
    assert hunt.points >= 2 * POINTS
    sound = _declared(call=lambda x: x * x, least=0.0, x=Span((-1.0, 0.0), (1.0, 1e9)))
    assert not fuzz((sound,), 1.0).findings


def test_equal_seeds_hunt_at_equal_places():
    span = Span((0.0, 1.0), (1e-30, 1e6))
    places = [somewhere(span, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(places[0], places[1])
    assert (places[0] != places[2]).any()
    for low, high, column in zip(span.low, span.high, places[0].T, strict=True):
        assert (column >= low).all()
        assert (column <= high).all()


def test_a_hunt_keeps_few_programs(monkeypatch):
    monkeypatch.setattr(fuzz_module, "KEPT", 2)
    alive = []

    def counted(declaration):
        evaluate = stability.program(declaration)
        alive.append(weakref.ref(evaluate))
        return evaluate

    monkeypatch.setattr(fuzz_module, "program", counted)
    ticks = types.SimpleNamespace(monotonic=itertools.count().__next__)
    monkeypatch.setattr(fuzz_module, "time", ticks)  # two rounds, however fast they are
    several = [
        dataclasses.replace(_declared(call=lambda x: jnp.sin(x), x=Span(0.0, k)), part=str(k))
        for k in (1.0, 2.0, 3.0, 4.0)
    ]
    left = []
    hunt = fuzz(several, 20.0, tell=lambda _: left.append(sum(ref() is not None for ref in alive)))
    assert hunt.functions == hunt.of == 8
    assert len(left) > 8
    assert max(left) <= 2
