"""The command that estimates turbidity from measured skies."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Literal

import tyro

from atmofit.files import output_folder
from atmofit.fit.candidates import SimulatorModel
from atmofit.fit.judgement import judge
from atmofit.fit.posterior import profile_turbidity
from atmofit.fit.problem import turbidity_problem
from atmofit.fit.turbidity import estimate_turbidity
from atmofit.models.sky_model import SkyModel
from atmofit.models.stored import ATMOFIT_2026
from atmofit.observe.images import read_photograph
from atmofit.observe.observation import Observation
from atmofit.observe.photograph import SkySettings, sky_from_photograph
from atmofit.observe.tables import SUFFIXES as TABLE_SUFFIXES
from atmofit.observe.tables import read_observations
from atmofit.render.turbidity import write_turbidity_report


@dataclasses.dataclass(frozen=True)
class Turbidity:
    """Estimate turbidity from measured skies: a table, a scan, or a photograph with its range.

    Prints each sky's turbidity with its standard error and what else was searched for; a report
    shows what the model misses. A table, and a photograph whose ground may be bright:

        atmofit turbidity sky.csv --sun-zenith 40

        atmofit turbidity sky.exr --free albedo --projection fisheye
    """

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
