"""How many skies per second on each kind of device at hand, and how near to what it can do?

The reference job (60 skies, 343 directions, 41 wavelengths, two orders) on the processor, and on a
GPU where there is one: skies per second; the share of the device's measured arithmetic (a matrix
product) and of its measured memory traffic (an addition over a large array) that the program uses,
by XLA's own count of both; and what float32 costs in accuracy there, beside float64 on the
processor. Where only one kind of device is at hand the table has its rows alone.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from error_vs_runtime_case import Case
from error_vs_runtime_oracle import WAVELENGTH_NM
from run_files import markdown, write_run

import atmofit as af
from atmofit.sky.ladder import LADDER


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    rungs: tuple[float, ...] = (5e-2, 1e-2)
    """Of the ladder."""
    repeats: int = 3
    """Hot calls, of which the median counts."""
    matrix: int = 4096
    """Rows of the matrix product that measures arithmetic."""
    megabytes: int = 512
    """Of the array that measures memory."""
    out: Path = Path("runs/accelerator")


def main(config: Config) -> None:
    """Measure each device, print and write."""
    turbidity = jnp.asarray(af.RefitSettings().turbidity)
    rows = []
    for device in devices():
        limit = limits(device, config)
        for rtol in config.rungs:
            rows.append(one(device, limit, rtol, turbidity, config.repeats))
            print(rows[-1], flush=True)
    text = markdown(
        [
            "device",
            "rung",
            "compile [s]",
            "hot [s]",
            "skies per second",
            "of arithmetic",
            "of memory traffic",
            "float32, largest error",
        ],
        [
            [
                row["device"],
                f"{row['rung']:g}",
                f"{row['compile']:.1f}",
                f"{row['hot']:.3g}",
                f"{row['skies_per_second']:.3g}",
                f"{row['of_arithmetic']:.1%}",
                f"{row['of_memory']:.1%}",
                f"{row['float32_error']:.1e}",
            ]
            for row in rows
        ],
    )
    print(text)
    write_run(config.out, config, {"rows": rows}, text)


def devices() -> list[Any]:
    """The processor, and one of each other kind."""
    found = {"cpu": jax.devices("cpu")[0]}
    for device in jax.devices():
        found.setdefault(device.platform, device)
    return list(found.values())


def limits(device: Any, config: Config) -> tuple[float, float]:
    """Arithmetic [operations/s] and memory traffic [byte/s] that simple programs reach."""
    n, size = config.matrix, config.megabytes * 2**20 // 4
    with jax.default_device(device):
        matrix, array = jnp.ones((n, n), jnp.float32), jnp.ones(size, jnp.float32)
        product = jax.jit(lambda x: jnp.dot(x, x, precision="highest"))
        addition = jax.jit(lambda x: x + 1)
        flops = 2 * n**3 / hot(lambda: product(matrix), config.repeats)
        return flops, 2 * array.nbytes / hot(lambda: addition(array), config.repeats)


def one(
    device: Any,
    limit: tuple[float, float],
    rtol: float,
    turbidity: jax.Array,
    repeats: int,
) -> dict[str, Any]:
    """A rung on a device, beside the same in float64 on the processor."""
    with jax.default_device(device):
        begin = time.perf_counter()
        compiled = jax.jit(job(rtol, "float32")).lower(turbidity).compile()
        seconds = time.perf_counter() - begin
        found = hot(lambda: compiled(turbidity), repeats)
        radiance = np.asarray(compiled(turbidity), float)
    count = compiled.cost_analysis() or {}
    with jax.default_device(jax.devices("cpu")[0]):
        exact = np.asarray(jax.jit(job(rtol, "float64"))(turbidity), float)
    skies = turbidity.size * len(af.RefitSettings().solar_zenith_angle)
    return {
        "device": f"{device.platform}: {device.device_kind}",
        "rung": rtol,
        "compile": seconds,
        "hot": found,
        "skies_per_second": skies / found,
        "of_arithmetic": count.get("flops", np.nan) / found / limit[0],
        "of_memory": count.get("bytes accessed", np.nan) / found / limit[1],
        "float32_error": float(np.max(np.abs(radiance / exact - 1))),
    }


def job(rtol: float, dtype: str) -> Callable[[jax.Array], jax.Array]:
    """Radiance of the dome under all suns, [turbidity, sun, direction, wavelength]."""
    plan = Case("ladder", f"{rtol:g}", LADDER[rtol], dtype).plan()
    suns, dome = jnp.asarray(af.RefitSettings().solar_zenith_angle), af.dome_343()

    def skies(turbidity: jax.Array) -> jax.Array:
        def of_one(T: jax.Array) -> jax.Array:
            air = af.Atmosphere.from_turbidity(T)
            field = af.solve_sky(air, jnp.asarray(WAVELENGTH_NM), plan=plan)
            return jax.vmap(lambda sun: field.radiance(sun, dome, 1.0))(suns)

        return jax.vmap(of_one)(turbidity)

    return skies


def hot(call: Callable[[], Any], repeats: int) -> float:
    """Seconds of a hot call, the median of some."""
    jax.block_until_ready(call())
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
