"""What do derivatives cost, and how good are those of a coarser sky?

One sky of 342 directions and 41 wavelengths, all orders: its Jacobian for ten parameters (two scale
heights and g among them), exact and with the slopes of a coarser rung, and the gradient of a scalar
loss. Then the gradient of a loss over the whole reference job, 12 suns by 5 turbidities, with its
peak memory. Errors of slopes are those of the logarithm of radiance against exact ones at a finer
rung, over the root of their mean square. Every case runs in a process of its own.
"""

import dataclasses
import functools
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af

SUN = 0.9  # [rad]
WAVELENGTH_NM = np.linspace(380.0, 780.0, 41)
DIRECTIONS = af.DirectionGrid(
    np.radians([*range(5, 86, 5), 89.0]), np.radians(np.arange(0, 181, 10))
)
# As factors of usual values or as they are.
PARAMETERS = {
    "optical depth of air": 1.0,
    "scale height of air": 8e3,
    "optical depth of haze": 0.2,
    "exponent of haze": 1.3,
    "scale height of haze": 1.2e3,
    "albedo of haze": 0.95,
    "asymmetry": 0.76,
    "albedo of ground": 0.2,
    "sun": SUN,
    "irradiance": 1.0,
}
CASES = ("value", "jacobian", "gradient", "job", "job gradient")
HEAD = ["what", "rtol", "slopes", "compile [s]", "hot [s]", "over one run", "peak [MB]"]


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    rtol: tuple[float, ...] = (1e-2, 2e-3)
    """Rungs of the sky."""
    slopes_rtol: float = 1e-1
    """Rung whose slopes are taken in place of exact ones."""
    repeats: int = 3
    """Hot calls; the fastest is reported."""
    out: Path = Path("runs/slopes")


def main(config: Config) -> None:
    """Run every case in its own process; print and write the table."""
    results = []
    for rtol in config.rtol:
        for task in CASES:
            for slopes in (None, config.slopes_rtol) if task == "jacobian" else (None,):
                results.append(_apart(task, rtol, slopes, config))
                print(json.dumps(results[-1]), flush=True)
    runs = {(r["rtol"], r["task"]): r["hot"] for r in results if r["slopes"] is None}
    rows = []
    for each in results:
        base = "job" if each["task"].startswith("job") else "value"
        ratio = each["hot"] / runs[each["rtol"], base]
        numbers = [f"{each['compile']:.1f}", f"{each['hot']:.3f}", f"{ratio:.2f}"]
        slopes = "exact" if each["slopes"] is None else f"{each['slopes']:g}"
        rows.append([each["task"], f"{each['rtol']:g}", slopes, *numbers, f"{each['peak_MB']:.0f}"])
    errors = slope_errors(config)
    text = markdown(HEAD, rows) + "\n\nSlopes of the coarse sky, errors over their rms:\n\n"
    text += markdown(["parameter", "rms", "largest"], [[k, *v] for k, v in errors.items()])
    print(text)
    write_run(config.out, config, {"cases": results, "slope_errors": errors}, text)


def atmosphere(values: jax.Array) -> af.Atmosphere:
    """Air, haze and ground of the first eight parameters."""
    depth = 0.0973 * values[0] * (550 / WAVELENGTH_NM) ** 4
    return af.Atmosphere(
        af.Molecules(af.Spectrum(WAVELENGTH_NM, depth, smooth=True), values[1]),
        af.Haze(values[2], values[3], values[4], values[5], af.HenyeyGreenstein(values[6])),
        ground=af.Ground(values[7]),
    )


def sky_of(plan: af.Plan) -> Callable[[jax.Array], jax.Array]:
    """Radiance from all ten parameters."""

    def sky(values: jax.Array) -> jax.Array:
        field = af.solve_sky(atmosphere(values), WAVELENGTH_NM, plan=plan)
        return field.radiance(values[8], DIRECTIONS, values[9])

    return sky


def plan_of(rtol: float, slopes: float | None, dtype: str = "float32") -> af.Plan:
    """Of one sky."""
    air = atmosphere(jnp.asarray(list(PARAMETERS.values())))
    return af.plan_sky(
        air, solar_zenith_angle=SUN, orders="all", rtol=rtol, slopes_rtol=slopes, dtype=dtype
    )


def slope_errors(config: Config) -> dict[str, tuple[str, str]]:
    """Rms and largest error of each parameter's slopes, over the rms of the exact ones."""
    values = jnp.asarray(list(PARAMETERS.values()))
    fine = sky_of(plan_of(2e-3, None, "float64"))
    run = jax.jit(lambda at, along: jax.jvp(fine, (at,), (along,)))
    every = [run(values, unit) for unit in jnp.eye(values.size)]
    exact = np.stack([slope / value for value, slope in every], axis=-1)
    coarse = sky_of(plan_of(config.slopes_rtol, None))
    radiance, slopes = jax.jit(lambda at: (coarse(at), jax.jacfwd(coarse)(at)))(values)
    apart = np.asarray(slopes / radiance[..., None]) - exact
    size = np.sqrt((exact**2).mean(axis=(0, 1, 2)))
    rms = np.sqrt((apart**2).mean(axis=(0, 1, 2))) / size
    largest = np.abs(apart).max(axis=(0, 1, 2)) / size
    return {
        name: (f"{a:.1%}", f"{b:.1%}")
        for name, a, b in zip(PARAMETERS, rms.tolist(), largest.tolist(), strict=True)
    }


def _job(turbidity: jax.Array, rtol: float) -> jax.Array:
    """A loss over 12 suns and 5 turbidities, one turbidity after the other."""
    suns = jnp.radians(jnp.asarray([*range(0, 81, 8), 87.0]))
    air = af.Atmosphere.from_turbidity(2.0)
    plan = af.plan_sky(
        air, solar_zenith_angle=np.radians([0, 87]), orders="all", rtol=rtol, dtype="float32"
    )

    def of_one(T: jax.Array) -> jax.Array:
        field = af.solve_sky(af.Atmosphere.from_turbidity(T), WAVELENGTH_NM, plan=plan)
        skies = jax.vmap(lambda sun: field.radiance(sun, DIRECTIONS, 1.0))(suns)
        return (jnp.log(skies + 1e-9) ** 2).sum()

    return jax.lax.map(jax.checkpoint(of_one), turbidity).sum()


def _task(task: str, rtol: float, slopes: float | None) -> tuple[Callable, jax.Array]:
    if task.startswith("job"):
        job = functools.partial(_job, rtol=rtol)
        return (jax.grad(job) if "gradient" in task else job), jnp.arange(2.0, 7.0)
    sky = sky_of(plan_of(rtol, slopes))
    kinds = {
        "value": sky,
        "jacobian": lambda at: (sky(at), jax.jacfwd(sky)(at)),
        "gradient": jax.grad(lambda at: (sky(at) ** 2).sum()),
    }
    return kinds[task], jnp.asarray(list(PARAMETERS.values()))


def _measured(task: str, rtol: float, slopes: float | None, repeats: int) -> dict[str, Any]:
    run, at = _task(task, rtol, slopes)
    begin = time.perf_counter()
    compiled = jax.jit(run).lower(at).compile()
    compile_seconds = time.perf_counter() - begin
    jax.block_until_ready(compiled(at))
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(compiled(at))
        times.append(time.perf_counter() - begin)
    return {
        "task": task,
        "rtol": rtol,
        "slopes": slopes,
        "compile": compile_seconds,
        "hot": min(times),
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def _apart(task: str, rtol: float, slopes: float | None, config: Config) -> dict[str, Any]:
    facts = json.dumps([task, rtol, slopes, config.repeats])
    surroundings = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    command = [sys.executable, __file__, "--case", facts]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=surroundings)
    if done.returncode != 0:
        raise RuntimeError(f"{task} at rtol {rtol:g} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    if sys.argv[1:2] == ["--case"]:
        print(json.dumps(_measured(*json.loads(sys.argv[2]))))
    else:
        main(tyro.cli(Config))
