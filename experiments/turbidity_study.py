"""How well does turbidity come back, by which estimator, and do its intervals hold?

Four parts. Recovery: skies of a model with noise, inverted with the same model, over turbidity,
sun, noise, number of directions and unknown exposure; by the analytic model and by the simulator,
which also begins at every turbidity. Mismatch: skies over a continent with all orders and ozone,
random haze and ground, inverted with poorer models, with and without the model-error term, with the
seconds that each takes. One thing wrong: such skies in which only ground, phase function or
absorption differs from what the analytic model was trained on. Clouds: part of the view is brighter
than any clear sky. Writes result.json, table.md and a picture.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import model_errors
import numpy as np
import tyro
from run_files import markdown, write_run
from turbidity_pictures import draw_study

import atmofit as af
from atmofit.fit.unknowns import UNKNOWNS

NINE_BY_NINE = model_errors.DIRECTIONS.as_list()
HEAD = ["skies", "bias", "spread", "standard error", "inside 95 %", "failed", "at edge"]


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    turbidity: tuple[float, ...] = (1.5, 2.0, 3.0, 4.5, 7.0, 9.5)
    """Of the recovery."""
    suns_deg: tuple[float, ...] = (5.0, 25.0, 45.0, 65.0, 85.0)
    """Solar zenith angles [degree]."""
    noises: tuple[float, ...] = (0.005, 0.01, 0.05, 0.2)
    """Relative."""
    directions: tuple[int, ...] = (10, 81, 1000)
    repeats: int = 40
    """Noises on each sky, analytic model."""
    simulator_repeats: int = 2
    """Likewise, simulator."""
    starts: tuple[float, ...] = (1.2, 2.0, 4.0, 7.0, 12.0)
    """Turbidities at which the simulator's search begins."""
    mismatched: int = 100
    """Random skies."""
    seed: int = 77
    """Of noise and skies; model_errors.py draws others."""
    out: Path = Path("runs/turbidity_study")


def main(config: Config) -> None:
    """Run the parts, print and write."""
    rows, results = [], {}
    for name, found in (*recovery(config), *through_simulator(config), *clouds(config)):
        results[name] = found
        rows.append([name, *cells(found)])
        print(rows[-1], flush=True)
    mismatch, timing = mismatched(config)
    for name, found in (*mismatch.items(), *one_thing_wrong(config)):
        results[name] = found
        rows.append([name, *cells(found)])
        print(rows[-1], flush=True)
    text = markdown(["case", *HEAD], rows) + "\n\n" + markdown(*timing)
    print(text)
    config.out.mkdir(parents=True, exist_ok=True)
    print(draw_study(config.out / "study.png", results))
    write_run(config.out, config, {"cases": results, "timing": timing}, text + "\n")


def cells(found: dict[str, Any]) -> list[str]:
    """A row of the table."""
    return [
        str(found["skies"]),
        f"{found['bias']:+.4f}",
        f"{found['spread']:.4f}",
        f"{found['standard_error']:.4f}",
        f"{found['inside']:.1%}",
        str(found["failed"]),
        str(found["at_edge"]),
    ]


def summary(truth: np.ndarray, estimate: af.TurbidityEstimate) -> dict[str, Any]:
    """Errors of many estimates; an edge counts for coverage where the interval is cut there."""
    value, error = np.asarray(estimate.value), np.asarray(estimate.standard_error)
    off = value - truth
    failed = ~np.asarray(estimate.converged)
    return {
        "skies": int(off.size),
        "bias": float(np.mean(off)),
        "spread": float(np.std(off)),
        "standard_error": float(np.median(error)),
        "inside": float(np.mean(np.abs(off) <= 1.96 * error)),
        "failed": int(failed.sum()),
        "at_edge": int(np.asarray(estimate.at_edge).sum()),
        "most_steps": int(np.asarray(estimate.steps).max()),
        "truth": truth.tolist(),
        "value": value.tolist(),
        "error": error.tolist(),
    }


def dome(count: int) -> af.Directions:
    """Directions spread evenly over the dome to 5 degrees above the horizon; 81: nine by nine."""
    if count == NINE_BY_NINE.shape[0]:
        return NINE_BY_NINE
    k = np.arange(count) + 0.5
    lowest = np.cos(np.radians(85.0))
    view = np.arccos(1 - (1 - lowest) * k / count)
    return af.Directions(view, np.mod(k * np.pi * (1 + 5**0.5), 2 * np.pi))


def grid(config: Config, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Turbidity and sun [rad] of every sky."""
    suns = np.radians(config.suns_deg)
    T, sun, _ = np.meshgrid(config.turbidity, suns, np.arange(repeats), indexing="ij")
    return T.ravel(), sun.ravel()


def estimator(
    directions: af.Directions, model: Any, exposure: str = "known", **options: Any
) -> Any:
    """Compiled estimates of many skies: from luminances, suns and noises."""

    def one(values: jax.Array, sun: jax.Array, noise: jax.Array) -> af.TurbidityEstimate:
        observation = af.Observation(directions, values, sun, noise, exposure=exposure)
        return af.estimate_turbidity(observation, model, **options)

    return one


def recovery(config: Config) -> list[tuple[str, dict[str, Any]]]:
    """The analytic model inverted with itself."""
    random = np.random.default_rng(config.seed)
    T, sun = grid(config, config.repeats)
    found = []
    for count in config.directions:
        directions = dome(count)
        exact = analytic_luminance(T, sun, directions)
        for exposure in ("known", "unknown") if count == NINE_BY_NINE.shape[0] else ("known",):
            many = jax.jit(jax.vmap(estimator(directions, af.ATMOFIT_2026, exposure)))
            for noise in config.noises:
                seen = exact * np.exp(noise * random.standard_normal(exact.shape))
                estimates = many(
                    jnp.asarray(seen if exposure == "known" else 1e-3 * seen),
                    jnp.asarray(sun),
                    jnp.full(T.size, noise),
                )
                name = f"analytic, {count} directions, {noise:.1%}, exposure {exposure}"
                found.append((name, summary(T, estimates)))
    return found


def analytic_luminance(T: np.ndarray, sun: np.ndarray, directions: af.Directions) -> np.ndarray:
    """Luminance of the analytic model, [sky, direction]."""
    sky = jax.vmap(lambda t, s: af.ATMOFIT_2026.XYZ(t, s, directions)[:, 1])
    return np.asarray(jax.jit(sky)(jnp.asarray(T), jnp.asarray(sun)))


def through_simulator(config: Config) -> list[tuple[str, dict[str, Any]]]:
    """Two orders inverted with two orders, from a finer rung, and from every start."""
    random = np.random.default_rng(config.seed + 1)
    T, sun = grid(config, config.simulator_repeats)
    plan = af.plan_sky(
        af.Atmosphere.from_turbidity(3.0),
        quantity="luminance",
        solar_zenith_angle=np.array([0.0, np.pi / 2]),
        rtol=2e-3,
        dtype="float32",
    )

    @jax.jit
    def sky(T: jax.Array, sun: jax.Array) -> jax.Array:
        air = af.Atmosphere.from_turbidity(T)
        return af.simulate_luminance(air, sun, NINE_BY_NINE, plan=plan)

    exact = np.stack([sky(*map(jnp.asarray, place)) for place in zip(T, sun, strict=True)])
    seen = exact * np.exp(0.01 * random.standard_normal(exact.shape))
    one = estimator(NINE_BY_NINE, "simulator")
    begin = time.perf_counter()
    every = [one(values, s, 0.01) for values, s in zip(seen, sun, strict=True)]
    seconds = (time.perf_counter() - begin) / T.size
    found = [("simulator, 81 directions, 1.0%, exposure known", summary(T, _stacked(every)))]
    found[0][1]["seconds"] = seconds
    seen = 1e-3 * exact * np.exp(0.05 * random.standard_normal(exact.shape))
    one = estimator(NINE_BY_NINE, "simulator", "unknown")
    every = [one(values, s, 0.05) for values, s in zip(seen, sun, strict=True)]
    found.append(("simulator, 81 directions, 5.0%, exposure unknown", summary(T, _stacked(every))))
    seen = exact * np.exp(0.01 * random.standard_normal(exact.shape))
    alone = [
        estimator(NINE_BY_NINE, "simulator", start=start)(seen[k], sun[k], 0.01)
        for k in range(0, T.size, config.simulator_repeats)
        for start in config.starts
    ]
    truth = np.repeat(T[:: config.simulator_repeats], len(config.starts))
    found.append(("simulator, from every start", summary(truth, _stacked(alone))))
    return found


def clouds(config: Config) -> list[tuple[str, dict[str, Any]]]:
    """A fifth of the view, in one piece, 1.3 to 3 times as bright as the clear sky."""
    random = np.random.default_rng(config.seed + 2)
    T, sun = grid(config, 4)
    directions = dome(NINE_BY_NINE.shape[0])
    exact = analytic_luminance(T, sun, directions)
    seen = exact * np.exp(0.01 * random.standard_normal(exact.shape))
    view, azimuth = (np.asarray(angle) for angle in directions.angles())
    for values in seen:
        middle = random.integers(view.size)
        apart = np.asarray(af.scattering_angle(view, azimuth - azimuth[middle], view[middle]))
        cloud = np.argsort(apart)[: view.size // 5]
        values[cloud] *= random.uniform(1.3, 3.0, cloud.size)
    found = []
    for robust in (False, True):
        many = jax.jit(jax.vmap(estimator(directions, af.ATMOFIT_2026, robust=robust, starts=2)))
        estimates = many(jnp.asarray(seen), jnp.asarray(sun), jnp.full(T.size, 0.01))
        name = f"analytic, clouds in a fifth of the view, {'robust' if robust else 'not robust'}"
        found.append((name, summary(T, estimates)))
    return found


# Models with which skies over a continent are inverted, and the names of their errors.
POORER: dict[str, tuple[Any, str]] = {
    "two orders, the paper's air": ("simulator", "simulator"),
    "two orders, the paper's air, rung 5e-2": (af.SimulatorModel(rtol=5e-2), "simulator"),
    "ATMOFIT_2026": (af.ATMOFIT_2026, "atmofit_2026"),
    "1999, published": ("preetham", "preetham"),
}


# What is wrong with skies of which the analytic model knows the rest.
ONE_WRONG: dict[str, dict[str, float]] = {
    "nothing wrong": {},
    "wrong albedo: .6, assumed .2": {"albedo": 0.6},
    "wrong phase: asymmetry .62, assumed .70": {"asymmetry": 0.62},
    "wrong phase: asymmetry .78, assumed .70": {"asymmetry": 0.78},
    "wrong absorption: .85, assumed .925": {"single_scattering_albedo": 0.85},
}


def mismatched(
    config: Config,
) -> tuple[dict[str, dict[str, Any]], tuple[list[str], list[list[str]]]]:
    """Skies with all orders, ozone, other haze and ground, inverted with poorer models."""
    random = np.random.default_rng(config.seed + 3)
    places = model_errors.draw(config.mismatched, config.seed)
    places["turbidity"] = np.maximum(places["turbidity"], 1.7)
    truth = af.SimulatorModel("continental", orders="all")
    luminance = model_errors.simulate(places, truth)[..., 1].reshape(config.mismatched, -1)
    seen = luminance * np.exp(0.01 * random.standard_normal(luminance.shape))
    T, sun = places["turbidity"], places["solar_zenith_angle"]
    found, rows = {}, []
    for name, (model, error) in POORER.items():
        for with_error in (False, True):
            options = {"model_error": error} if with_error else {}
            many = _all_skies(model, **options)
            many(seen, sun)
            begin = time.perf_counter()
            every = jax.block_until_ready(many(seen, sun))
            seconds = (time.perf_counter() - begin) / T.size
            label = f"mismatch: {name}, {'with' if with_error else 'without'} model error"
            found[label] = summary(T, every) | {"seconds": seconds}
            rms = np.sqrt(np.mean((np.asarray(found[label]["value"]) - T) ** 2))
            rows.append([label, f"{seconds:.3f}", f"{rms:.3f}", f"{found[label]['inside']:.0%}"])
    return found, (["estimator", "s / sky", "rms error of T", "inside 95 %"], rows)


def one_thing_wrong(config: Config) -> list[tuple[str, dict[str, Any]]]:
    """Skies that differ in one thing from those that the analytic model was trained on."""
    random = np.random.default_rng(config.seed + 4)
    T, sun = (each.ravel() for each in np.meshgrid(config.turbidity, np.radians(config.suns_deg)))
    T = np.maximum(T, 1.7)
    truth = af.SimulatorModel("continental", orders="all")
    usual = {name: np.full(T.size, UNKNOWNS[name].start) for name in truth.unknowns}
    usual |= {"turbidity": T, "solar_zenith_angle": sun}
    found = []
    for name, wrong in ONE_WRONG.items():
        places = usual | {key: np.full(T.size, value) for key, value in wrong.items()}
        luminance = model_errors.simulate(places, truth)[..., 1].reshape(T.size, -1)
        seen = luminance * np.exp(0.01 * random.standard_normal(luminance.shape))
        for with_error in (False, True):
            options = {"model_error": "atmofit_2026"} if with_error else {}
            every = _all_skies(af.ATMOFIT_2026, **options)(seen, sun)
            label = f"{name}, {'with' if with_error else 'without'} model error"
            found.append((label, summary(T, every)))
    return found


def _all_skies(model: Any, **options: Any) -> Callable[..., af.TurbidityEstimate]:
    """Estimates of many skies: by closed formulas at once, through the simulator one by one."""
    one = estimator(NINE_BY_NINE, model, **options)
    if model == "simulator" or isinstance(model, af.SimulatorModel):
        return lambda seen, sun: _stacked(
            [one(values, s, 0.01) for values, s in zip(seen, sun, strict=True)]
        )
    at_once = jax.jit(jax.vmap(lambda values, s: one(values, s, 0.01)))
    return lambda seen, sun: at_once(jnp.asarray(seen), jnp.asarray(sun))


def _stacked(estimates: list[af.TurbidityEstimate]) -> af.TurbidityEstimate:
    """Many estimates as one."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *estimates)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
