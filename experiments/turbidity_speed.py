"""How fast are the estimators of turbidity?

Estimates a second of many skies at once by analytic models, seconds a sky by the simulator, and
seconds for a thousand effective samples of turbidity and scale height of the haze through the
simulator by the no-U-turn sampler, with what the sampling gains over the parabola at the minimum.
Writes table.md and result.json.
"""

import dataclasses
import resource
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

import atmofit as af

DIRECTIONS = model_errors.DIRECTIONS.as_list()
SUN = np.radians(50.0)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    skies: int = 1000
    """At once, analytic models."""
    repeats: int = 5
    """Hot runs, of which the quickest counts."""
    samples: int = 600
    """Of each of two chains."""
    warmup: int = 60
    noise: float = 0.02
    out: Path = Path("runs/turbidity_speed")


def main(config: Config) -> None:
    """Time, print and write."""
    random = np.random.default_rng(3)
    rows: list[list[str]] = []
    results: dict[str, Any] = {}
    exact = np.asarray(af.ATMOFIT_2026(3.0, SUN, DIRECTIONS))[:, 2]
    many = exact * np.exp(config.noise * random.standard_normal((config.skies, exact.size)))

    def keep(name: str, first: float, hot: float, what: str) -> None:
        results[name] = {"first_s": first, "hot_s": hot, "found": what}
        rows.append([name, f"{first:.1f}", f"{hot:.3g}", what, f"{_peak():.0f}"])
        print(rows[-1], flush=True)

    for name, model, free in (
        ("1999, published, at once", "preetham", ("turbidity",)),
        ("ATMOFIT_2026, at once", af.ATMOFIT_2026, ("turbidity",)),
        ("ATMOFIT_2026, ground too, at once", af.ATMOFIT_2026, ("turbidity", "albedo")),
    ):

        def one(values: jax.Array, model: Any = model, free: Any = free) -> jax.Array:
            sky = af.Observation(DIRECTIONS, values, SUN, config.noise)
            found = af.estimate_turbidity(sky, model, free=free)
            return jnp.stack([found.value, found.converged.astype(float)])

        at_once = jax.jit(jax.vmap(one))
        first, hot, found = timed(lambda f=at_once: f(jnp.asarray(many)), config.repeats)
        failed = config.skies - int(np.asarray(found)[:, 1].sum())
        keep(name, first, hot, f"{config.skies / hot:.0f} skies/s, {failed} failed")

    sky = af.Observation(DIRECTIONS, many[0], SUN, config.noise)
    for name, model in (
        ("simulator, two orders, a sky", af.SimulatorModel()),
        ("simulator, two orders, rung 5e-2, a sky", af.SimulatorModel(rtol=5e-2)),
    ):
        first, hot, found = timed(
            lambda m=model: af.estimate_turbidity(sky, m).value, config.repeats
        )
        keep(name, first, hot, f"T {float(found):.3f}")

    coarse = af.SimulatorModel("continental", rtol=5e-2, ozone=False, ground=False)
    problem = af.turbidity_problem(sky, coarse, free=("turbidity", "asymmetry"))

    def sampled(seed: int) -> af.TurbiditySamples:
        best = af.estimate_turbidity(problem)
        return af.sample_turbidity(
            problem, best, samples=config.samples, warmup=config.warmup, seed=seed
        )

    begin = time.perf_counter()
    jax.block_until_ready(sampled(0).values)
    first = time.perf_counter() - begin
    begin = time.perf_counter()
    draws = sampled(1)
    jax.block_until_ready(draws.values)
    hot = time.perf_counter() - begin
    effective = float(np.min(draws.effective_samples))
    best = draws.estimate
    what = (
        f"{effective:.0f} effective samples of T and g, {1000 * hot / effective:.0f} s for 1000; "
        f"R-hat {float(np.max(draws.r_hat)):.3f}, {int(draws.gradients)} gradients; 95 % of T "
        f"{np.asarray(draws.interval())[:, 0].round(3)}, by the parabola "
        f"{np.asarray(best.interval).round(3)}"
    )
    keep("simulator, two orders, no-U-turn sampler", first, hot, what)
    text = markdown(["job", "first [s]", "hot [s]", "result", "peak so far [MB]"], rows)
    print(text)
    write_run(config.out, config, {"jobs": results}, text + "\n")


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def timed(call: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Seconds of the first call and of the quickest of the others, and what came out."""
    begin = time.perf_counter()
    found = jax.block_until_ready(call())
    first, hot = time.perf_counter() - begin, np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        hot = min(hot, time.perf_counter() - begin)
    return first, hot, found


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
