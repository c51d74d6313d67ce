"""The command line: the public functions under their own names, degrees instead of radians."""

import contextlib
import dataclasses
import math
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import jax
import tyro

from atmofit.cli_sky import Sky
from atmofit.fit.candidates import SimulatorModel
from atmofit.fit.comparison import compare
from atmofit.fit.judgement import judge
from atmofit.fit.pieces import DamagedPieceWarning
from atmofit.fit.posterior import profile_turbidity
from atmofit.fit.problem import turbidity_problem
from atmofit.fit.refit import refit
from atmofit.fit.skies import RefitSettings, simulate_skies
from atmofit.fit.training import TrainingSettings, train
from atmofit.fit.turbidity import estimate_turbidity
from atmofit.io import (
    output_folder,
    read_coefficients,
    read_settings,
    read_sky_model,
    write_coefficients,
    write_dataset,
    write_sky_model,
    write_source,
)
from atmofit.models.preetham import PREETHAM_1999
from atmofit.models.sky_model import SkyModel
from atmofit.models.stored import ATMOFIT_2026
from atmofit.observe.images import read_photograph
from atmofit.observe.observation import Observation
from atmofit.observe.photograph import SkySettings, sky_from_photograph
from atmofit.observe.tables import SUFFIXES as TABLE_SUFFIXES
from atmofit.observe.tables import read_observations
from atmofit.render.training import write_training_report
from atmofit.render.turbidity import write_turbidity_report
from atmofit.report import comparison_text, summary_text, write_report

if TYPE_CHECKING:
    from tqdm import tqdm

_STAGES = (
    "simulation",
    "colour",
    "joint fits",
    "zenith fits",
    "single skies",
    "comparison",
    "identifiability",
)


@dataclasses.dataclass(frozen=True)
class Refit:
    """Simulate skies, fit a sky model to them, compare, report."""

    preset: Literal["preetham1999", "standard"] = "preetham1999"
    """preetham1999: the 1999 paper's work done again. standard: real air with ozone, ground and all
    orders, down to twilight, fitted by atmofit's own shape; --orders, --geometry and --starts do
    not apply."""
    rtol: float = 1e-2
    """Promised relative error of luminance, 5e-4 to 1."""
    orders: int = 2
    """Scattering orders, 1 to 20."""
    geometry: Literal["spherical", "flat", "paper"] = "spherical"
    """Of the atmosphere; paper is flat below 70 degrees and spherical beyond."""
    turbidity: tuple[float, ...] | None = None
    """At least three, 1 to 64; the preset's own if not given."""
    suns: tuple[float, ...] | None = None
    """Solar zenith angles in degrees, at least four; the preset's own if not given."""
    dtype: Literal["float32", "float64"] = "float32"
    """Of the simulation; the fits are always in float64."""
    starts: int = 64
    """Random starts from which each fit is searched for again; 0 leaves this out."""
    out: Path | None = None
    """Folder of the results: coefficients.json, sky.nc, report.html and pictures, or
    sky_model.json, table.md and a picture. runs/refit, or runs/refit_standard, if not given."""
    pieces: bool = True
    """Keep each finished piece of the simulation in the folder pieces of `out`, and take those
    that an earlier run of the same settings left there."""

    def run(self) -> None:
        """Do it."""
        if self.preset == "standard":
            self._train()
        else:
            self._refit()

    def _chosen(self) -> dict[str, Any]:
        """Turbidities and suns that replace those of the preset."""
        given = {"turbidity": self.turbidity, "solar_zenith_angle_deg": self.suns}
        return {name: values for name, values in given.items() if values is not None}

    def _train(self) -> None:
        """Train a sky model on real air."""
        from tqdm import tqdm

        settings = TrainingSettings(rtol=self.rtol, dtype=self.dtype, **self._chosen())
        folder = output_folder(self.out or Path("runs/refit_standard"))
        pieces = folder / "pieces" if self.pieces else None
        count = len(settings.turbidity) * len(settings.albedo)
        with tqdm(total=count + 2, unit="step", leave=False) as bar, _warnings_above(bar):

            def begin(stage: str) -> None:
                bar.set_description(f"{stage:<20}")
                bar.update()

            trained = train(settings, pieces=pieces, progress=begin)
        paths = [write_sky_model(trained, folder / "sky_model.json")]
        text, written = write_training_report(trained, folder)
        print(text)
        if pieces is not None:
            print(f"pieces: {trained.skies.pieces_read} of {count} were found in {pieces}")
        print("written:", ", ".join(str(path) for path in [*paths, *written]))

    def _refit(self) -> None:
        """The paper's work done again."""
        from tqdm import tqdm

        settings = RefitSettings(
            **self._chosen(),
            orders=self.orders,
            rtol=self.rtol,
            geometry=self.geometry,
            dtype=self.dtype,
            starts=self.starts,
        )
        folder = output_folder(self.out or Path("runs/refit"))
        pieces = folder / "pieces" if self.pieces else None
        steps = len(_STAGES) + settings.piece_count + 3
        with tqdm(total=steps, unit="step", leave=False) as bar, _warnings_above(bar):

            def begin(stage: str) -> None:
                bar.set_description(f"{stage:<20}")
                bar.update()

            result = refit(settings, pieces=pieces, progress=begin)
            begin("coefficients")
            paths = [write_coefficients(result, folder / "coefficients.json")]
            begin("sky.nc")
            paths.append(write_dataset(result, folder / "sky.nc"))
            begin("report")
            paths += write_report(result, folder)
        print(summary_text(result))
        print("seconds:", ", ".join(f"{k} {v:.2f}" for k, v in result.seconds.items()))
        if pieces is not None:
            found = f"{result.skies.pieces_read} of {settings.piece_count}"
            print(f"pieces: {found} of the simulation were found in {pieces}")
        print("written:", ", ".join(str(path) for path in paths))


@dataclasses.dataclass(frozen=True)
class Turbidity:
    """Estimate turbidity from measured skies: a table, a scan, or a photograph with its range."""

    file: Annotated[Path, tyro.conf.Positional]
    """A table of directions (.csv, .nc), the scans of Kider et al. (.npz), or a photograph (.exr,
    .hdr)."""
    model: Literal["atmofit_2026", "preetham", "simulator", "simulator-all", "continental-all"] = (
        "atmofit_2026"
    )
    """Of the sky. The simulators: two orders, or all, in the 1999 paper's air; all orders in real
    air over a continent. They take a minute to compile."""
    free: tuple[str, ...] = ()
    """Unknowns to search for beside turbidity, such as albedo, ozone_dobson, angstrom_exponent,
    solar_zenith_angle, solar_azimuth."""
    albedo: float | None = None
    """Of the ground, if it is known and the model has one."""
    sun_zenith: float | None = None
    """Solar zenith angle [degree]: of a table without one, or of a photograph, with --sun-azimuth;
    else a photograph's sun is its brightest spot."""
    sun_azimuth: float | None = None
    """Of a photograph's sun, from its left edge or top to the right [degree]."""
    noise: float | None = None
    """Relative standard deviation of a value; 0.02, of photographs 0.03, if not given or in the
    file."""
    spectral: bool = False
    """Of the scans, spectra from 400 to 700 nm instead of luminances."""
    model_error: bool = True
    """Count what the model misses of real skies. Without: the noise alone."""
    robust: bool | None = None
    """Let directions count less that no smooth sky explains; of photographs, if not given."""
    projection: Literal["latlong", "fisheye"] = "latlong"
    """Of a photograph."""
    out: Path = Path("runs/turbidity")
    """Folder of report.html, turbidity.json and pictures."""

    def run(self) -> None:
        """Do it."""
        folder = output_folder(self.out)
        photograph = self.file.suffix.lower() not in TABLE_SUFFIXES
        skies = self._photograph() if photograph else self._table()
        model, error = _MODELS[self.model]
        values = {} if self.albedo is None else {"albedo": self.albedo}
        robust = photograph if self.robust is None else self.robust
        found = []
        for name, observation, notes in skies:
            seen = [observation]
            if photograph:
                one_exposure = dataclasses.replace(observation, exposure="unknown")
                seen.append(one_exposure.to_luminance())
            profiles = []
            for one in seen:
                problem = turbidity_problem(
                    one,
                    model,
                    free=("turbidity", *self.free),
                    known=values,
                    model_error=error if self.model_error else None,
                )
                best = estimate_turbidity(problem, robust=robust, starts=3 if photograph else 1)
                profiles.append(profile_turbidity(problem, best))
            found.append(judge(name, observation, profiles[0], notes, *profiles[1:]))
            print(found[-1].sentence())
            for warning in found[-1].warnings:
                print(f"  note: {warning}")
        paths = write_turbidity_report(found, folder)
        print("written:", ", ".join(str(path) for path in paths[:2]), "and pictures")

    def _table(self) -> list[tuple[str, Observation, tuple[str, ...]]]:
        """The skies of a table."""
        observations = read_observations(
            self.file,
            solar_zenith_deg=self.sun_zenith,
            relative_noise=self.noise,
            spectral=self.spectral,
        )
        if len(observations) == 1:
            return [(self.file.stem, observations[0], ())]
        return [(f"{self.file.stem} {k + 1}", one, ()) for k, one in enumerate(observations)]

    def _photograph(self) -> list[tuple[str, Observation, tuple[str, ...]]]:
        """The sky of a photograph."""
        if (self.sun_zenith is None) != (self.sun_azimuth is None):
            raise ValueError("sun_zenith and sun_azimuth must be given together for a photograph")
        image = read_photograph(self.file, self.projection)
        settings = SkySettings()
        if self.noise is not None:
            settings = dataclasses.replace(settings, relative_noise=self.noise)
        if self.sun_zenith is not None and self.sun_azimuth is not None:
            sun = (math.radians(self.sun_zenith), math.radians(self.sun_azimuth))
            settings = dataclasses.replace(settings, sun=sun)
        sky = sky_from_photograph(image, settings)
        elevation = 90.0 - math.degrees(sky.solar_zenith_angle)
        counts = ", ".join(f"{count} {what}" for what, count in sky.counts.items())
        notes = (
            f"sun at elevation {elevation:.1f}°, azimuth {math.degrees(sky.solar_azimuth):.1f}°",
            f"pixels: {counts}",
        )
        print(*notes, sep="\n")
        return [(self.file.stem, sky.observation, notes)]


_MODELS: dict[str, tuple[str | SkyModel | SimulatorModel, str]] = {
    "atmofit_2026": (ATMOFIT_2026, "atmofit_2026"),
    "preetham": ("preetham", "preetham"),
    "simulator": ("simulator", "simulator"),
    "simulator-all": (SimulatorModel(orders="all"), "simulator all"),
    "continental-all": (SimulatorModel("continental", orders="all"), "continental all"),
}


@dataclasses.dataclass(frozen=True)
class Export:
    """Write a sky model as source code for a renderer."""

    to: Literal["c", "glsl", "hlsl", "python", "json"]
    """Language; json holds the coefficients and says how they are used."""
    out: Path
    """File to write."""
    model: Path | None = None
    """A sky_model.json that refit --preset standard wrote; the shipped model if not given."""
    channels: Literal["colours", "wavelengths", "all"] = "colours"
    """X, Y and Z; radiance over solar irradiance at the model's wavelengths; or both."""
    name: str = "atmofit_2026"
    """Of the function."""

    def run(self) -> None:
        """Do it."""
        model = ATMOFIT_2026 if self.model is None else read_sky_model(self.model)
        model = model.only(self.channels)
        print("written:", write_source(model, self.to, self.out, self.name))


@contextlib.contextmanager
def _warnings_above(bar: "tqdm[NoReturn]") -> Iterator[None]:
    """In this context, warnings about damaged pieces are lines above the progress bar."""
    with warnings.catch_warnings():
        shown = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
            if issubclass(category, DamagedPieceWarning):
                bar.write(f"atmofit: {message}", file=sys.stderr)
            else:
                shown(message, category, *place)

        warnings.simplefilter("always", DamagedPieceWarning)
        warnings.showwarning = show
        yield


@dataclasses.dataclass(frozen=True)
class Check:
    """Compare a model with freshly simulated skies."""

    model: Annotated[str, tyro.conf.Positional]
    """A coefficients.json that refit wrote, or the word published."""
    like: Path | None = None
    """A coefficients.json whose skies are simulated again; without it those that the model was
    fitted to, and for the published one those of the reference job."""

    def run(self) -> None:
        """Do it."""
        published = self.model == "published"
        model = PREETHAM_1999 if published else read_coefficients(Path(self.model))
        like = self.like or (None if published else Path(self.model))
        skies = simulate_skies(RefitSettings() if like is None else read_settings(like))
        print(comparison_text(compare(model, skies, self.model), skies))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0, or 2 after one line that says what was wrong."""
    use_compilation_cache()
    jax.config.update("jax_enable_x64", True)
    commands = {
        "refit": Refit,
        "check": Check,
        "sky": Sky,
        "turbidity": Turbidity,
        "export": Export,
    }
    command = tyro.extras.subcommand_cli_from_dict(commands, prog="atmofit", args=arguments)
    try:
        command.run()
    except (ValueError, OSError, ImportError) as error:
        print(f"atmofit: {error}", file=sys.stderr)
        return 2
    return 0


def use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, unless JAX was told another."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(cache / "atmofit" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


if __name__ == "__main__":
    sys.exit(main())
