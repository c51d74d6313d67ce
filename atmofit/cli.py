"""The command line: the public functions under their own names, degrees instead of radians."""

import dataclasses
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import tyro

from atmofit.fit.refit import RefitSettings, compare, refit, simulate_skies
from atmofit.io import (
    output_folder,
    read_coefficients,
    read_settings,
    write_coefficients,
    write_dataset,
)
from atmofit.models.preetham import PREETHAM_1999
from atmofit.report import comparison_text, summary_text, write_report

_STAGES = ("simulation", "colour", "joint fits", "zenith fits", "single skies", "comparison")


@dataclasses.dataclass(frozen=True)
class Simulation:
    """What is simulated; nothing said means the reference job (for check: that of FILE)."""

    rtol: float | None = None
    """Promised relative error of luminance, 5e-4 to 1 (reference job: 1e-2)."""
    orders: int | None = None
    """Scattering orders, 1 or 2 (reference job: 2)."""
    geometry: Literal["spherical", "flat", "paper"] | None = None
    """Of the atmosphere (reference job: spherical)."""
    turbidity: tuple[float, ...] | None = None
    """At least three, 1 to 64 (reference job: 2 3 4 5 6)."""
    suns: tuple[float, ...] | None = None
    """Solar zenith angles in degrees, at least four (reference job: 0 8 ... 80 87)."""
    dtype: Literal["float32", "float64"] | None = None
    """Of the simulation (reference job: float32)."""

    def settings(self, base: RefitSettings) -> RefitSettings:
        """The settings with what was said in place of the base's."""
        said: dict[str, Any] = {k: v for k, v in vars(self).items() if v is not None}
        if "suns" in said:
            said["solar_zenith_angle_deg"] = said.pop("suns")
        return dataclasses.replace(base, **said)


@dataclasses.dataclass(frozen=True)
class Refit:
    """Simulate skies, fit the model of the 1999 paper to them, compare, report."""

    simulation: Annotated[Simulation, tyro.conf.OmitArgPrefixes] = dataclasses.field(
        default_factory=Simulation
    )
    out: Path = Path("runs/refit")
    """Folder of coefficients.json, sky.nc, report.html and pictures."""

    def run(self) -> None:
        """Do it."""
        from tqdm import tqdm

        settings = self.simulation.settings(RefitSettings())
        folder = output_folder(self.out)
        with tqdm(total=len(_STAGES) + 3, unit="stage", leave=False) as bar:

            def begin(stage: str) -> None:
                bar.set_description(f"{stage:<14}")
                bar.update()

            result = refit(settings, progress=begin)
            begin("coefficients")
            paths = [write_coefficients(result, folder / "coefficients.json")]
            begin("sky.nc")
            paths.append(write_dataset(result, folder / "sky.nc"))
            begin("report")
            paths += write_report(result, folder)
        print(summary_text(result))
        print("seconds:", ", ".join(f"{k} {v:.2f}" for k, v in result.seconds.items()))
        print("written:", ", ".join(str(path) for path in paths))


@dataclasses.dataclass(frozen=True)
class Check:
    """Compare a model with freshly simulated skies."""

    model: Annotated[str, tyro.conf.Positional]
    """A coefficients.json that refit wrote, or the word published."""
    simulation: Annotated[Simulation, tyro.conf.OmitArgPrefixes] = dataclasses.field(
        default_factory=Simulation
    )

    def run(self) -> None:
        """Do it."""
        if self.model == "published":
            model, base = PREETHAM_1999, RefitSettings()
        else:
            model, base = read_coefficients(Path(self.model)), read_settings(Path(self.model))
        skies = simulate_skies(self.simulation.settings(base))
        print(comparison_text(compare(model, skies, self.model), skies))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0, or 2 after one line that says what was wrong."""
    use_compilation_cache()
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
