"""The command line: the public functions under their own names, degrees instead of radians."""

import contextlib
import dataclasses
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import jax
import tyro

from atmofit.cli_scale import Dataset, Series
from atmofit.cli_sky import Sky
from atmofit.cli_stability import Stability
from atmofit.cli_turbidity import Turbidity
from atmofit.files import output_folder
from atmofit.fit.comparison import compare
from atmofit.fit.pieces import DamagedPieceWarning
from atmofit.fit.refit import refit
from atmofit.fit.skies import RefitSettings, simulate_skies
from atmofit.fit.training import TrainingSettings, train
from atmofit.io import (
    read_coefficients,
    read_settings,
    read_sky_model,
    write_coefficients,
    write_dataset,
    write_sky_model,
    write_source,
)
from atmofit.models.preetham import PREETHAM_1999
from atmofit.models.stored import ATMOFIT_2026
from atmofit.render.training import write_training_report
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
    """Simulate skies, fit a sky model to them, compare, report.

    Takes two minutes, and five with --preset standard, beside compilation. A killed run continues
    where it was. For a first look:

        atmofit refit --rtol 5e-2 --starts 0 --out runs/quick
    """

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
class Export:
    """Write a sky model as source code for a renderer.

    One file that needs nothing else:

        atmofit export --to glsl --out sky.glsl
    """

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
    """Compare a model with freshly simulated skies.

    Prints how far its luminance and colours are off, by turbidity and sun:

        atmofit check published
    """

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
    """Run a command; its status, or 2 after one line that says what was wrong."""
    use_compilation_cache()
    jax.config.update("jax_enable_x64", True)
    commands = {
        "refit": Refit,
        "check": Check,
        "sky": Sky,
        "turbidity": Turbidity,
        "dataset": Dataset,
        "series": Series,
        "export": Export,
        "stability": Stability,
    }
    command = tyro.extras.subcommand_cli_from_dict(commands, prog="atmofit", args=arguments)
    try:
        return command.run() or 0
    except (ValueError, OSError, ImportError) as error:
        print(f"atmofit: {error}", file=sys.stderr)
        return 2


def use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, unless JAX was told another."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(cache / "atmofit" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
