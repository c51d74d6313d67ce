"""The three works on a few small skies; as a script, in a process of its own.

python run_works.py FOLDER DEVICES [COORDINATOR PROCESSES PROCESS]
"""

import dataclasses
import os
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import atmofit as af
from atmofit.scale.store import BlockStore
from atmofit.sky.extremes import FEW_NODES

SKY = af.TrainingSettings(
    turbidity=(2.0, 3.5, 6.0),
    solar_zenith_angle_deg=(20.0, 75.0, 91.0),
    albedo=(0.0, 0.4),
    wavelength_nm=(450.0,),
    rtol=1.0,
    dtype="float64",
)
WORKS = ("skies", "fits", "series")
BLOCK = 2  # airs
SKIES_IN_BLOCK = 5  # of the series


def sky_work() -> af.SkyWork:
    """Skies of single scattering on few nodes, in 29 directions."""
    dome = af.dome_343()
    directions = af.Directions(
        np.asarray(dome.view_zenith_angle)[::12], np.asarray(dome.relative_azimuth)[::12]
    )
    with jax.enable_x64(True):
        plan = af.plan_sky(
            SKY.atmosphere(jnp.asarray(2.0), jnp.asarray(0.0)),
            solar_zenith_angle=np.radians([0.0, 91.0]),
            orders=1,
            rtol=1.0,
            all_wavelengths=True,
            dtype="float64",
        )
    return af.SkyWork(SKY, directions, dataclasses.replace(plan, nodes=FEW_NODES))


def series_work(skies: Path) -> af.SeriesWork:
    """The skies by day as a series, every second one with fewer directions."""
    with BlockStore.open(skies).dataset() as data:
        view, azimuth = data["view_zenith_angle"].values, data["relative_azimuth"].values
        suns, Y = data["solar_zenith_angle"].values, data["xyY"].values[..., 2]
    observations = []
    for air in range(len(Y)):
        for sun in range(2):
            some = slice(None) if sun == 0 else slice(0, None, 2)
            where = af.Directions(view[some], azimuth[some])
            observations.append(af.Observation(where, Y[air, sun, some], suns[sun], 0.02))
    return af.SeriesWork(observations)


def run_all(folder: Path, mesh, hosts=af.Hosts()) -> dict[str, af.BlockRun]:  # noqa: B008
    """Fill the three stores; what was done for each."""
    where = {"mesh": mesh, "hosts": hosts}
    skies, done = folder / "skies", {}
    done["skies"] = af.run_blocks(sky_work(), skies, rows_per_block=BLOCK, **where)
    fits, series = af.FitWork(skies), series_work(skies)
    done["fits"] = af.run_blocks(fits, folder / "fits", rows_per_block=BLOCK, **where)
    done["series"] = af.run_blocks(
        series, folder / "series", rows_per_block=SKIES_IN_BLOCK, **where
    )
    return done


def main(folder: str, devices: str, *place: str) -> None:
    """Run, and print what was done."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_rank_promotion", "raise")
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(cache / "atmofit" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    jax.config.update("jax_num_cpu_devices", int(devices))
    coordinator, *numbers = place or (None,)
    hosts = af.join_hosts(coordinator, *(int(number) for number in numbers))
    mesh = af.device_mesh()
    if mesh.size != int(devices):
        raise SystemExit(f"{mesh.size} devices, expected {devices}")
    for name, done in run_all(Path(folder), mesh, hosts).items():
        sys.stdout.write(f"{name} {done.computed} {done.found}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
