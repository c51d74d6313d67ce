"""What does the reference job cost, how far is it from the exact oracle, and what does that cost?

Every case runs in a process of its own, so that its peak memory is its own. Errors are those of
luminance against nested quadrature that shares no code with the simulator (tests/oracles), over
sampled directions of the dome for sun 0, 60 and 85 degrees and turbidity 2 and 6.
"""

import dataclasses
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import atmofit as af

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.nested_quadrature import sky_radiance
from oracles.paper_air import paper_constituents

VIEWS_DEG = ((0, 0), (15, 60), (45, 0), (45, 180), (70, 90), (80, 0), (85, 30), (89, 0), (89, 180))
SUNS_DEG, TURBIDITIES = (0.0, 60.0, 85.0), (2.0, 6.0)
HEADER = (
    "| rtol | dtype | trace + compile [s] | first call [s] | hot call [s] | peak memory [MB] "
    "| largest error of Y | rms error of Y |"
)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    rtol: tuple[float, ...] = (5e-2, 1e-2, 2e-3)
    """Rungs of the ladder."""
    dtype: tuple[str, ...] = ("float32", "float64")
    """Of the simulation."""
    orders: int = 2
    repeats: int = 3
    """Hot calls; the median is reported."""
    resolution: float = 0.8
    """Of the oracle; 0.8 is good to 3e-4."""
    out: Path = Path("runs/benchmark")


def main(config: Config) -> None:
    """Run every case in its own process, then the oracle, and print the table."""
    config.out.mkdir(parents=True, exist_ok=True)
    exact, seconds = oracle(config)
    rows = [HEADER, "|" + " --- |" * HEADER.count(" |")]
    results = []
    for dtype in config.dtype:
        for rtol in config.rtol:
            case = run_apart(config, rtol, dtype)
            error = np.abs(np.asarray(case.pop("luminance")) / exact - 1)
            case |= {
                "largest_error": float(error.max()),
                "rms_error": float((error**2).mean() ** 0.5),
            }
            results.append(case)
            rows.append(
                f"| {rtol:g} | {dtype} | {case['compile']:.1f} | {case['first']:.2f} "
                f"| {case['hot']:.2f} | {case['peak_MB']:.0f} "
                f"| {case['largest_error']:.2%} | {case['rms_error']:.2%} |"
            )
            print(rows[-1] if len(results) > 1 else "\n".join(rows), flush=True)
    skies = 60 * 343
    rows.append(
        f"\nThe oracle took {seconds:.2f} s a direction for {len(WAVELENGTH_NM)} wavelengths; the "
        f"reference job's {skies} directions would take it {skies * seconds / 3600:.1f} hours."
    )
    print(rows[-1])
    (config.out / "table.md").write_text("\n".join(rows) + "\n", encoding="utf-8")
    stored = {
        "config": dataclasses.asdict(config) | {"out": str(config.out)},
        "processors": os.cpu_count(),
        "oracle_seconds_per_direction": seconds,
        "cases": results,
    }
    (config.out / "benchmark.json").write_text(json.dumps(stored, indent=1), encoding="utf-8")


WAVELENGTH_NM = np.array(af.RefitSettings().wavelength_nm)


def oracle(config: Config) -> tuple[np.ndarray, float]:
    """Luminance [turbidity, sun, view] of the nested quadrature, and its seconds a direction."""
    sun = af.solar_irradiance_spectrum("preetham1999")(WAVELENGTH_NM)
    begin = time.perf_counter()
    spectra = [
        [
            [
                sky_radiance(
                    paper_constituents(turbidity, WAVELENGTH_NM),
                    *np.radians([sun_deg, *view_deg]),
                    orders=config.orders,
                    resolution=config.resolution,
                ).sum(0)
                for view_deg in VIEWS_DEG
            ]
            for sun_deg in SUNS_DEG
        ]
        for turbidity in TURBIDITIES
    ]
    count = len(TURBIDITIES) * len(SUNS_DEG) * len(VIEWS_DEG)
    seconds = (time.perf_counter() - begin) / count
    xyY = af.spectrum_to_xyY(np.asarray(spectra) * np.asarray(sun), WAVELENGTH_NM)
    return np.asarray(xyY[..., 2]), seconds


def run_apart(config: Config, rtol: float, dtype: str) -> dict[str, object]:
    """One case in a process of its own, without the compilation cache."""
    command = [sys.executable, __file__, "--case", str(rtol), dtype, str(config.orders)]
    surroundings = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    done = subprocess.run(
        [*command, str(config.repeats)],
        check=True,
        capture_output=True,
        text=True,
        env=surroundings,
    )
    return json.loads(done.stdout.splitlines()[-1])


def run_case(rtol: float, dtype: str, orders: int, repeats: int) -> dict[str, object]:
    """Compile and time the reference job; then the luminance in the oracle's directions."""
    jax.config.update("jax_enable_x64", True)
    settings = af.RefitSettings(rtol=rtol, dtype=dtype, orders=orders)
    dome, wavelength = af.dome_343(), jnp.asarray(settings.wavelength_nm)

    def job(turbidity: jax.Array, suns: jax.Array, directions: af.Directions) -> jax.Array:
        def of_turbidity(T: jax.Array) -> jax.Array:
            field = af.solve_sky(af.Atmosphere.from_turbidity(T), wavelength, plan=settings.plan())
            return jax.vmap(lambda sun: field.radiance(sun, directions))(suns)

        return jax.vmap(of_turbidity)(turbidity)

    arguments = (jnp.asarray(settings.turbidity), jnp.asarray(settings.solar_zenith_angle), dome)
    begin = time.perf_counter()
    compiled = jax.jit(job).lower(*arguments).compile()
    times = [time.perf_counter() - begin]
    for _ in range(1 + repeats):
        begin = time.perf_counter()
        compiled(*arguments).block_until_ready()
        times.append(time.perf_counter() - begin)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    views = af.Directions(*np.radians(np.array(VIEWS_DEG, float)).T)
    radiance = jax.jit(job)(jnp.asarray(TURBIDITIES), jnp.radians(jnp.asarray(SUNS_DEG)), views)
    luminance = af.spectrum_to_xyY(radiance.astype(float), wavelength)[..., 2]
    return {
        "rtol": rtol,
        "dtype": dtype,
        "compile": times[0],
        "first": times[1],
        "hot": float(np.median(times[2:])),
        "peak_MB": peak,
        "luminance": np.asarray(luminance).tolist(),
    }


if __name__ == "__main__":
    if sys.argv[1:2] == ["--case"]:
        rtol, dtype, orders, repeats = sys.argv[2:6]
        print(json.dumps(run_case(float(rtol), dtype, int(orders), int(repeats))))
    else:
        jax.config.update("jax_enable_x64", True)
        main(tyro.cli(Config))
