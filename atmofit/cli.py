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

from atmofit.fit.comparison import compare
from atmofit.fit.pieces import DamagedPieceWarning
from atmofit.fit.refit import refit
from atmofit.fit.skies import RefitSettings, simulate_skies
from atmofit.io import (
    output_folder,
    read_coefficients,
    read_settings,
    write_coefficients,
    write_dataset,
)
from atmofit.models.preetham import PREETHAM_1999
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
    """Simulate skies, fit the model of the 1999 paper to them, compare, report."""

    rtol: float = 1e-2
    """Promised relative error of luminance, 5e-4 to 1."""
    orders: int = 2
    """Scattering orders, 1 to 20."""
    geometry: Literal["spherical", "flat", "paper"] = "spherical"
    """Of the atmosphere; paper is flat below 70 degrees and spherical beyond."""
    turbidity: tuple[float, ...] = RefitSettings.turbidity
    """At least three, 1 to 64."""
    suns: tuple[float, ...] = RefitSettings.solar_zenith_angle_deg
    """Solar zenith angles in degrees, at least four."""
    dtype: Literal["float32", "float64"] = "float32"
    """Of the simulation; the fits are always in float64."""
    starts: int = 64
    """Random starts from which each fit is searched for again; 0 leaves this out."""
    out: Path = Path("runs/refit")
    """Folder of coefficients.json, sky.nc, report.html and pictures."""
    pieces: bool = True
    """Keep each finished piece of the simulation in the folder pieces of `out`, and take those
    that an earlier run of the same settings left there."""

    def run(self) -> None:
        """Do it."""
        from tqdm import tqdm

        settings = RefitSettings(
            turbidity=self.turbidity,
            solar_zenith_angle_deg=self.suns,
            orders=self.orders,
            rtol=self.rtol,
            geometry=self.geometry,
            dtype=self.dtype,
            starts=self.starts,
        )
        folder = output_folder(self.out)
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
    commands = {"refit": Refit, "check": Check}
    command = tyro.extras.subcommand_cli_from_dict(commands, prog="atmofit", args=arguments)
    try:
        command.run()
    except (ValueError, OSError) as error:
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
