"""Does turbidity come back from simulated skies with noise, and through which model?

The skies are simulated on a finer rung of the ladder than the estimator's own. Every model then
estimates the turbidity of the same noisy luminances. Writes config.json, result.json, table.md and
a picture.
"""

import dataclasses
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from measured_models import regenerated_model
from run_files import markdown, write_run
from turbidity_pictures import draw_recovery

import atmofit as af
from atmofit.fit.observation import Observation
from atmofit.fit.turbidity import estimate_turbidity

# 81 directions: 9 rings of 9 azimuths over the full circle.
DIRECTIONS = af.DirectionGrid(
    np.radians(np.arange(5.0, 86.0, 10.0)), np.radians(np.arange(0.0, 321.0, 40.0))
)
TURBIDITY, SUN_DEG, START = (1.8, 8.0), (10.0, 75.0), (1.7, 12.0)
HEADER = [
    "model", "skies", "mean error", "rms error", "median standard error", "inside 95 %",
    "inside 95 %, scaled", "median reduced chi-square", "not converged", "at edge", "s / estimate",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    turbidities: int = 20
    """Random ones, one in each of so many equal parts of 1.8 to 8."""
    suns: int = 15
    """Random suns over each of them, 10 to 75 degrees from the zenith."""
    relative_noise: float = 0.01
    seed: int = 1999
    truth_rtol: float = 5e-4
    """Rung on which the skies are simulated."""
    rtol: float = 2e-3
    """Rung of the estimator."""
    started_skies: int = 40
    """Skies whose search is begun at every start, on the rung 1e-2."""
    starts: int = 8
    """From 1.7 to 12, in equal ratios."""
    coefficients: Path | None = None
    """coefficients.json written by `atmofit refit`; without it the refit is run."""
    out: Path = Path("runs/turbidity_recovery")
    """Folder of the results."""


@dataclasses.dataclass(frozen=True)
class Skies:
    """Simulated skies and what was measured of them; the first axis is the sky.

    Attributes:
        turbidity: The truth.
        solar_zenith_angle: [rad].
        luminance: With noise, [sky, direction axes], cd m^-2.
    """

    turbidity: np.ndarray
    solar_zenith_angle: np.ndarray
    luminance: np.ndarray

    def observation(self, index: int, relative_noise: float) -> Observation:
        """One of them."""
        return Observation(
            directions=DIRECTIONS,
            values=self.luminance[index],
            solar_zenith_angle=self.solar_zenith_angle[index],
            relative_noise=relative_noise,
        )


def main(config: Config) -> None:
    """Simulate, estimate by every model, begin anywhere, report."""
    begin = time.perf_counter()
    skies = simulate(config)
    print(f"{skies.turbidity.size} skies: {time.perf_counter() - begin:.0f} s", flush=True)
    models = {
        "simulator": "simulator",
        "published (1999)": af.PREETHAM_1999,
        "regenerated": regenerated_model(config.coefficients),
    }
    results = {name: estimate_all(config, skies, model) for name, model in models.items()}
    summaries = {name: summary(skies, result, config) for name, result in results.items()}
    starts = {
        name: begin_anywhere(config, skies, model)
        for name, model in models.items()
        if name != "regenerated"
    }
    table = report(config, summaries, starts)
    print(table)
    out = {"summary": summaries, "starts": starts, "skies": _lists(skies, results)}
    write_run(config.out, config, out, table)
    print(draw_recovery(config.out / "recovery.png", skies.turbidity, results))
    print(f"{time.perf_counter() - begin:.0f} s in all")


def simulate(config: Config) -> Skies:
    """Random skies with noise; every turbidity's light is solved once for all its suns."""
    random = np.random.default_rng(config.seed)
    low, high = TURBIDITY
    place = (np.arange(config.turbidities) + random.random(config.turbidities)) / config.turbidities
    turbidity = low + (high - low) * place
    suns = np.radians(random.uniform(*SUN_DEG, (config.turbidities, config.suns)))
    plan = af.plan_sky(
        af.Atmosphere.from_turbidity(low),
        quantity="luminance",
        rtol=config.truth_rtol,
        dtype="float32",
    )

    @jax.jit
    def of_turbidity(T: jax.Array, suns: jax.Array) -> jax.Array:
        field = af.solve_sky(af.Atmosphere.from_turbidity(T), None, plan=plan)
        return jax.lax.map(lambda sun: field.luminance(sun, DIRECTIONS), suns)

    pairs = zip(turbidity, suns, strict=True)
    exact = [of_turbidity(jnp.asarray(T), jnp.asarray(some)) for T, some in pairs]
    luminance = np.concatenate([np.asarray(sky, float) for sky in exact])
    luminance *= 1 + config.relative_noise * random.standard_normal(luminance.shape)
    return Skies(np.repeat(turbidity, config.suns), suns.ravel(), luminance)


def estimate_all(config: Config, skies: Skies, model: str | af.PreethamModel) -> dict[str, Any]:
    """One model's estimate of every sky, and the seconds that each took once compiled."""
    rows = []
    found = estimate_turbidity(skies.observation(0, config.relative_noise), model, rtol=config.rtol)
    for index in range(skies.turbidity.size):
        observation = skies.observation(index, config.relative_noise)
        begin = time.perf_counter()
        found = estimate_turbidity(observation, model, rtol=config.rtol)
        value = float(found.value)
        seconds = time.perf_counter() - begin
        rows.append(
            {
                "value": value,
                "standard_error": float(found.standard_error),
                "reduced_chi_square": float(found.reduced_chi_square),
                "rms": float(found.rms),
                "converged": bool(found.converged),
                "at_edge": bool(found.at_edge),
                "steps": int(found.steps),
                "seconds": seconds,
            }
        )
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns | {"range": found.turbidity_range}


def summary(skies: Skies, result: dict[str, Any], config: Config) -> dict[str, Any]:
    """Errors over the skies whose turbidity lies inside the model's range."""
    low, high = result["range"]
    used = (skies.turbidity >= low) & (skies.turbidity <= high)
    error = (result["value"] - skies.turbidity)[used]
    width = result["standard_error"][used]
    chi_square = result["reduced_chi_square"][used]
    scaled = width * np.sqrt(np.maximum(1.0, chi_square))
    return {
        "skies": int(used.sum()),
        "mean_error": float(error.mean()),
        "rms_error": float(np.sqrt((error**2).mean())),
        "standard_error": float(np.median(width)),
        "coverage": float((np.abs(error) <= 1.96 * width).mean()),
        "coverage_scaled": float((np.abs(error) <= 1.96 * scaled).mean()),
        "reduced_chi_square": float(np.median(chi_square)),
        "not_converged": int((~result["converged"][used]).sum()),
        "at_edge": int(result["at_edge"][used].sum()),
        "seconds": float(np.median(result["seconds"])),
    }


def begin_anywhere(config: Config, skies: Skies, model: str | af.PreethamModel) -> dict[str, Any]:
    """Where searches end that begin at every start, with the scan and from the start alone."""
    chosen = np.linspace(0, skies.turbidity.size - 1, config.started_skies).astype(int)
    starts = np.geomspace(*START, config.starts)
    out: dict[str, Any] = {"searches": int(chosen.size * starts.size)}
    for scan in (True, False):
        away, lost, failed = [], 0, 0
        for index in chosen:
            observation = skies.observation(index, config.relative_noise)
            default = estimate_turbidity(observation, model, rtol=1e-2)
            for start in starts:
                found = estimate_turbidity(observation, model, rtol=1e-2, start=start, scan=scan)
                away.append(abs(float((found.value - default.value) / default.standard_error)))
                lost += away[-1] > 0.1
                failed += not bool(found.converged)
        out["with scan" if scan else "start alone"] = {
            "largest_distance_in_standard_errors": max(away),
            "ended_elsewhere": lost,
            "not_converged": failed,
        }
    return out


def report(config: Config, summaries: dict[str, Any], starts: dict[str, Any]) -> str:
    """The tables in Markdown."""
    rows = [
        [
            name,
            str(s["skies"]),
            f"{s['mean_error']:+.4f}",
            f"{s['rms_error']:.4f}",
            f"{s['standard_error']:.4f}",
            f"{s['coverage']:.1%}",
            f"{s['coverage_scaled']:.1%}",
            f"{s['reduced_chi_square']:.2f}",
            str(s["not_converged"]),
            str(s["at_edge"]),
            f"{s['seconds']:.3f}",
        ]
        for name, s in summaries.items()
    ]
    begun = [
        [
            name,
            way,
            str(result["searches"]),
            str(result[way]["ended_elsewhere"]),
            str(result[way]["not_converged"]),
            f"{result[way]['largest_distance_in_standard_errors']:.2g}",
        ]
        for name, result in starts.items()
        for way in ("with scan", "start alone")
    ]
    note = (
        f"Skies simulated at rtol {config.truth_rtol:g}, two orders, T 1.8 to 8, sun 10 to 75 "
        f"degrees, {config.relative_noise:.0%} noise in 81 directions; simulator of the estimate "
        f"at rtol {config.rtol:g}. Only skies inside a model's range of T count."
    )
    header = [
        "model", "search", "searches", "ended elsewhere", "not converged",
        "largest distance [standard errors]",
    ]  # fmt: skip
    return "\n\n".join([markdown(HEADER, rows), note, markdown(header, begun)])


def _lists(skies: Skies, results: dict[str, Any]) -> dict[str, Any]:
    """Every sky and estimate, for JSON."""
    out: dict[str, Any] = {
        "turbidity": skies.turbidity.tolist(),
        "solar_zenith_angle_deg": np.degrees(skies.solar_zenith_angle).tolist(),
    }
    for name, columns in results.items():
        out[name] = {key: values.tolist() for key, values in columns.items() if key != "range"}
    return out


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
