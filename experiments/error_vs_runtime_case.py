"""One way to compute the reference job, run in a process of its own so that its cost is its own.

The parent names a case, the child compiles, times and returns luminance and chromaticity.
"""

import dataclasses
import functools
import hashlib
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from error_vs_runtime_oracle import (
    SUNS_DEG,
    TURBIDITIES,
    WAVELENGTH_NM,
    Reals,
    Sky,
    luminance,
    random_skies,
)

import atmofit as af
from atmofit.sky.ladder import Nodes
from atmofit.sky.plan import Plan

# Finer than the finest rung; in float64 and at every wavelength.
FINE = Nodes(
    view=96,
    view_second=40,
    altitude=40,
    sun=88,
    polar=36,
    limb=16,
    azimuth=52,
    bend=6,
    path=36,
    degrees=36,
    higher_modes=18,
    higher_degrees=28,
    streams=24,
    steps=14,
    wavelength=0,
    rough=0,
)
_CHUNKS = ((0, 11), (10, 21), (20, 31), (30, 41))  # wavelengths worked on together, for memory


@dataclasses.dataclass(frozen=True)
class Case:
    """One way to compute the reference job.

    Attributes:
        family: What is varied.
        label: Its value.
        nodes: Node counts.
        dtype: "float32" or "float64".
        geometry: Of the atmosphere.
        orders: Scattering orders.
    """

    family: str
    label: str
    nodes: Nodes
    dtype: str = "float32"
    geometry: str = "spherical"
    orders: int = 2

    @property
    def key(self) -> str:
        """Of all that its result depends on, and not of its name."""
        facts = {k: v for k, v in dataclasses.asdict(self).items() if k not in ("family", "label")}
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]

    def plan(self) -> Plan:
        """The plan of a rung with these nodes in place of its own."""
        air = af.Atmosphere.from_turbidity(TURBIDITIES[0], self.geometry)
        suns = af.RefitSettings().solar_zenith_angle
        plan = af.plan_sky(air, solar_zenith_angle=suns, orders=self.orders, dtype=self.dtype)
        every = self.nodes.wavelength == 0
        return dataclasses.replace(plan, nodes=self.nodes, all_wavelengths=every)


def run_apart(case: Case, task: str, file: Path, repeats: int = 3) -> None:
    """Run a task in a process of its own, without the compilation cache, that writes a file.

    Args:
        case: What to compute.
        task: "job", "fine" or "random", see `_TASKS`.
        file: An .npz.
        repeats: Hot calls of the job.

    Raises:
        RuntimeError: The process failed.
    """
    surroundings = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    facts = json.dumps(dataclasses.asdict(case))
    command = [sys.executable, __file__, task, facts, str(repeats), str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=surroundings)
    if done.returncode != 0:
        raise RuntimeError(f"{task} of {case.family} {case.label} failed:\n{done.stderr[-2000:]}")


def _job(case: Case, repeats: int) -> dict[str, Any]:
    """Compile and time the reference job, at last under the suns of the error."""
    settings, plan, dome = af.RefitSettings(), case.plan(), af.dome_343()
    wavelength = jnp.asarray(WAVELENGTH_NM)

    def job(turbidity: jax.Array, suns: jax.Array, directions: af.Directions) -> jax.Array:
        def of_turbidity(T: jax.Array) -> jax.Array:
            air = af.Atmosphere.from_turbidity(T, case.geometry)
            field = af.solve_sky(air, wavelength, plan=plan)
            return jax.vmap(lambda sun: field.radiance(sun, directions))(suns)

        return jax.vmap(of_turbidity)(turbidity)

    turbidity = jnp.asarray(settings.turbidity)
    suns = jnp.asarray(settings.solar_zenith_angle)
    begin = time.perf_counter()
    compiled = jax.jit(job).lower(turbidity, suns, dome).compile()
    times = [time.perf_counter() - begin]
    # The last call is under the suns of the error, at the same cost.
    of_error = suns.at[: len(SUNS_DEG)].set(jnp.radians(jnp.asarray(SUNS_DEG)))
    radiance = jnp.empty(())
    for asked in (*[suns] * repeats, of_error):
        begin = time.perf_counter()
        radiance = compiled(turbidity, asked, dome).block_until_ready()
        times.append(time.perf_counter() - begin)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    chosen = [settings.turbidity.index(T) for T in TURBIDITIES]
    seen = np.asarray(radiance, float)[chosen, : len(SUNS_DEG)]
    return {
        "compile": times[0],
        "first": times[1],
        "hot": np.median(times[2:]),
        "peak_MB": peak,
        "xyY": af.spectrum_to_xyY(seen, WAVELENGTH_NM),
    }


def _fine(case: Case, _: int) -> dict[str, Any]:
    """Radiance of the dome under the suns of the error, little by little."""
    plan, dome = case.plan(), af.dome_343()
    suns = jnp.radians(jnp.asarray(SUNS_DEG))

    @jax.jit
    def skies(T: jax.Array, wavelength: jax.Array) -> jax.Array:
        air = af.Atmosphere.from_turbidity(T, case.geometry)
        field = af.solve_sky(air, wavelength, plan=plan)
        return jax.lax.map(lambda sun: field.radiance(sun, dome, 1.0), suns)

    radiance = np.empty((len(TURBIDITIES), len(SUNS_DEG), *dome.shape, WAVELENGTH_NM.size))
    for first, last in _CHUNKS:
        for i, T in enumerate(TURBIDITIES):
            found = skies(jnp.asarray(T), jnp.asarray(WAVELENGTH_NM[first:last]))
            radiance[i, ..., first:last] = found
    return {"radiance": radiance}


def _random(case: Case, _: int) -> dict[str, Any]:
    """Luminance in the directions of the random skies, [sky, view]."""
    plan, wavelength = case.plan(), jnp.asarray(WAVELENGTH_NM)

    @jax.jit
    def sky(T: jax.Array, sun: jax.Array, directions: af.Directions) -> jax.Array:
        air = af.Atmosphere.from_turbidity(T, case.geometry)
        return af.solve_sky(air, wavelength, plan=plan).radiance(sun, directions, 1.0)

    def of(each: Sky) -> Reals:
        sun = jnp.radians(each.sun_deg)
        return luminance(np.asarray(sky(jnp.asarray(each.turbidity), sun, each.directions), float))

    return {"luminance": np.stack([of(each) for each in random_skies()])}


_TASKS = {"job": _job, "fine": _fine, "random": _random}


@functools.cache
def source_hash() -> str:
    """Hash of the source that the radiances depend on."""
    folder = Path(af.__file__).parent
    files = sorted([*folder.glob("sky/*.py"), *folder.glob("optics/*.py"), folder / "numerics.py"])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    task, facts, repeats, file = sys.argv[1:]
    given = json.loads(facts)
    case = Case(**given | {"nodes": Nodes(**given["nodes"])})
    np.savez(file, source=source_hash(), **_TASKS[task](case, int(repeats)))
