"""The commands that compute many skies in blocks, on any number of devices and processes."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from jax.sharding import Mesh

from atmofit.fit.training import TrainingSettings
from atmofit.models.stored import ATMOFIT_2026
from atmofit.observe.tables import read_observations
from atmofit.scale.blocks import run_blocks
from atmofit.scale.devices import count_cpu_devices, device_mesh
from atmofit.scale.fit_work import FitWork
from atmofit.scale.hosts import Hosts, join_hosts
from atmofit.scale.series_work import SeriesWork
from atmofit.scale.sky_work import SkyWork
from atmofit.scale.works import Work


@dataclasses.dataclass(frozen=True)
class Machines:
    """Where the blocks of a store are computed."""

    devices: int | None = None
    """Devices of each process; all if not given. On the CPU any number: shares of the processor."""
    coordinator: str | None = None
    """HOST:PORT of the first of several processes, a port that is free there."""
    processes: int | None = None
    """How many processes; SLURM and MPI tell it."""
    process: int | None = None
    """Which of them this is, from 0; SLURM and MPI tell it."""

    def join(self) -> tuple[Mesh, Hosts]:
        """The devices of this process, and its place among the others."""
        if self.devices is not None and self.devices < 1:
            raise ValueError(f"devices must be at least 1, got {self.devices}")
        if self.devices is not None:
            count_cpu_devices(self.devices)
        hosts = join_hosts(self.coordinator, self.processes, self.process)
        return device_mesh(self.devices), hosts


def _fill(work: Work, folder: Path, block: int | None, mesh: Mesh, hosts: Hosts) -> None:
    """Fill a store, with a progress bar where this process is alone or the first."""
    from tqdm import tqdm

    look = {"bar_format": "{desc} [{elapsed}]", "leave": False, "disable": not hosts.first}
    with tqdm(desc=work.name, **look) as bar:
        done = run_blocks(
            work,
            folder,
            rows_per_block=block,
            mesh=mesh,
            hosts=hosts,
            progress=lambda text: bar.set_description(f"{work.name}: {text}"),
        )
    damaged = f" ({len(done.damaged)} of them were damaged)" if done.damaged else ""
    place = f", process {hosts.process} of {hosts.processes}" if hosts.processes > 1 else ""
    print(
        f"{folder}: {done.computed} blocks computed{damaged}, {done.found} found, in "
        f"{done.seconds:.1f} s on {mesh.size} devices{place}"
    )


_Common = Annotated[Machines, tyro.conf.arg(name="")]


@dataclasses.dataclass(frozen=True)
class Dataset:
    """Simulate skies over turbidity x albedo x sun into one store, block by block.

    Real air over a continent, all orders, down to twilight: what atmofit's own sky model is fitted
    to. The store is the folder skies of --out: zarr arrays radiance and xyY, a manifest with all
    settings, and a checksum for each block. Killed at any moment, the same command goes on where it
    was; so it does with other --devices or --processes.

    Each process computes its share of the blocks; --out is a folder that all of them see.

    One machine; SLURM; Open MPI and MPICH; by hand, once for each K from 0:

        atmofit dataset --devices 8 --fit

        srun --ntasks 4 atmofit dataset --out /shared/skies

        mpirun -n 4 atmofit dataset --out /shared/skies --coordinator node1:12345

        atmofit dataset --out /shared/skies --coordinator node1:12345 --processes 2 --process K
    """

    turbidity: tuple[float, ...] | None = None
    """Increasing, 1.001 to 64; those of the shipped model if not given."""
    suns: tuple[float, ...] | None = None
    """Solar zenith angles in degrees, increasing, 0 to 96; likewise."""
    albedo: tuple[float, ...] | None = None
    """Of a grey ground, increasing, 0 to 1; likewise."""
    wavelengths: tuple[float, ...] | None = None
    """In nm, increasing, 350 to 830, beside those that colours need; likewise."""
    rtol: float = 1e-2
    """Promised relative error, 5e-4 to 1."""
    dtype: Literal["float32", "float64"] = "float32"
    """Of the simulation."""
    fit: bool = False
    """Then fit the Perez formula to every luminance dome, into the folder fits."""
    out: Path = Path("runs/dataset")
    """Folder of the stores."""
    block: int | None = None
    """Airs (one turbidity over one ground, all suns) in a block; four times those that all devices
    take at once if not given."""
    machines: _Common = dataclasses.field(default_factory=Machines)

    def run(self) -> None:
        """Do it."""
        mesh, hosts = self.machines.join()
        given: dict[str, Any] = {
            "turbidity": self.turbidity,
            "solar_zenith_angle_deg": self.suns,
            "albedo": self.albedo,
            "wavelength_nm": self.wavelengths,
        }
        chosen = {name: values for name, values in given.items() if values is not None}
        settings = TrainingSettings(rtol=self.rtol, dtype=self.dtype, **chosen)
        skies = self.out / "skies"
        _fill(SkyWork(settings), skies, self.block, mesh, hosts)
        if self.fit:
            _fill(FitWork(skies), self.out / "fits", self.block, mesh, hosts)


@dataclasses.dataclass(frozen=True)
class Series:
    """Estimate the turbidity of every sky of a series by an analytic model, block by block.

    The series is a table with a column scan (.csv, .nc) or the scans of Kider et al. (.npz), as
    atmofit turbidity reads them. The store is the folder series of --out: zarr arrays of turbidity,
    its standard error, chi-square and whether the search ended well, with a manifest and checksums.
    Killed at any moment, the same command goes on where it was.

    One machine; SLURM; Open MPI and MPICH; by hand, once for each K from 0:

        atmofit series scans.csv --devices 8

        srun --ntasks 4 atmofit series scans.csv --out /shared/series

        mpirun -n 4 atmofit series scans.csv --out /shared/series --coordinator node1:12345

        atmofit series scans.csv --coordinator node1:12345 --processes 2 --process K
    """

    file: Annotated[Path, tyro.conf.Positional]
    """Of the series; every process reads it."""
    model: Literal["atmofit_2026", "preetham"] = "atmofit_2026"
    """Of the sky."""
    free: tuple[str, ...] = ()
    """Unknowns to search for beside turbidity, such as albedo."""
    albedo: float | None = None
    """Of the ground, if it is known and the model has one."""
    sun_zenith: float | None = None
    """Solar zenith angle [degree] of a table without one."""
    noise: float | None = None
    """Relative standard deviation of a value; 0.02 if not given or in the file."""
    spectral: bool = False
    """Of the scans, spectra from 400 to 700 nm instead of luminances."""
    model_error: bool = True
    """Count what the model misses of real skies. Without: the noise alone."""
    robust: bool = False
    """Let directions count less that no smooth sky explains."""
    out: Path = Path("runs/series")
    """Folder of the store."""
    block: int | None = None
    """Skies in a block; four times those that all devices take at once if not given."""
    machines: _Common = dataclasses.field(default_factory=Machines)

    def run(self) -> None:
        """Do it."""
        mesh, hosts = self.machines.join()
        observations = read_observations(
            self.file,
            solar_zenith_deg=self.sun_zenith,
            relative_noise=self.noise,
            spectral=self.spectral,
        )
        work = SeriesWork(
            observations,
            ATMOFIT_2026 if self.model == "atmofit_2026" else self.model,
            free=("turbidity", *self.free),
            known={} if self.albedo is None else {"albedo": self.albedo},
            model_error=self.model if self.model_error else None,
            robust=self.robust,
        )
        _fill(work, self.out / "series", self.block, mesh, hosts)
