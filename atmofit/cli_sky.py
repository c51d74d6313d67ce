"""The command that draws skies and landscapes."""

import dataclasses
import datetime
import math
from pathlib import Path
from typing import Literal

import numpy as np

from atmofit.clouds.pattern_light import cloud_phase
from atmofit.clouds.picture import render_cloud
from atmofit.clouds.stage import staged_cloud, staged_view
from atmofit.clouds.surroundings import clear_surroundings
from atmofit.colour import XYZ_to_xyY
from atmofit.files import output_folder
from atmofit.landscape.light import clear_light
from atmofit.landscape.picture import Picture, render_landscape
from atmofit.landscape.terrain import Terrain, procedural_terrain, read_elevation_grid
from atmofit.landscape.view import View
from atmofit.media.path_planning import plan_path
from atmofit.models.stored import ATMOFIT_2026
from atmofit.render.pictures import (
    dome_picture,
    panorama_picture,
    typical_luminance,
    write_picture,
)
from atmofit.sun_position import sun_at

_FARTHEST, _EYE = 5e4, 30.0  # [m]
_SIGHT_RTOL = 3e-3


@dataclasses.dataclass(frozen=True)
class Sky:
    """Draw a clear sky as a dome, all around, over a landscape, or behind a cloud.

    The sun is given by its angles, or by place and time. An evening over mountains, and a cloud
    against the sun:

        atmofit sky --kind landscape --sun-zenith 85 --sun-azimuth 250 --toward 250

        atmofit sky --clouds cumulus --sun-zenith 80 --sun-azimuth 12 --out cloud.png
    """

    kind: Literal["dome", "panorama", "landscape"] = "dome"
    """All of the sky, zenith in the middle; all around, down to the horizon; or over land."""
    turbidity: float = 3.0
    """Of the haze: 2 is very clear, 3 clear, 6 hazy; 1.7 to 10."""
    sun_zenith: float | None = None
    """Solar zenith angle [degree], 0 to 90."""
    sun_azimuth: float = 180.0
    """Clockwise from north [degree]."""
    latitude: float | None = None
    """North is positive [degree]; with longitude and time instead of the sun's angles."""
    longitude: float | None = None
    """East is positive [degree]."""
    time: str | None = None
    """With its zone, as 2026-06-21T18:00+02:00."""
    albedo: float = 0.2
    """Of the ground, 0 to 1."""
    clouds: Literal["cumulus", "cumulonimbus"] | None = None
    """Instead of a dome: this cloud over level ground."""
    voxels: int = 64
    """Of the cloud, along its longest edge, 8 to 256."""
    density: float = 1.0
    """Multiplies the extinction of the cloud."""
    scattering: Literal["converged", "pattern"] = "converged"
    """In the cloud: all orders, or the first three by the reference pattern of 1996."""
    toward: float = 0.0
    """Where a landscape or a cloud is looked at, clockwise from north [degree]."""
    terrain: Path | None = None
    """An Esri ASCII grid (.asc); without it mountains from the seed."""
    seed: int = 5
    """Of the mountains, and of the cloud."""
    width: int = 800
    """Pixels across."""
    white: float | None = None
    """Exposure: the luminance that is shown at 63 % [cd/m^2]; the picture's own, if not given."""
    exr: bool = False
    """Write linear sRGB too."""
    out: Path = Path("runs/sky")
    """Folder of the pictures, or one picture that ends with .png or .exr."""

    def run(self) -> None:
        """Do it."""
        if not 8 <= self.width <= 20_000:
            raise ValueError(f"width must be between 8 and 20000, got {self.width}")
        paths = self._paths()
        output_folder(paths[0].parent)
        zenith, azimuth = self._sun()
        if not 0 <= zenith <= math.pi / 2:
            raise ValueError(
                f"sun must be above the horizon, got a zenith angle of {math.degrees(zenith):.1f}°"
            )
        picture = self._picture(zenith, azimuth)
        white = typical_luminance(picture) if self.white is None else self.white
        for path in paths:
            write_picture(picture, path, white)
        luminance = np.asarray(XYZ_to_xyY(picture.XYZ))[..., 2]
        print(
            f"sun at elevation {90 - math.degrees(zenith):.1f}°, azimuth "
            f"{math.degrees(azimuth):.1f}°; luminance {luminance[luminance > 0].min():.3g} to "
            f"{luminance.max():.3g} cd/m², {white:.3g} shown at 63 %"
        )
        print("written:", ", ".join(str(path) for path in paths))

    def _paths(self) -> list[Path]:
        """Of the pictures."""
        path = self.out
        if path.suffix not in (".png", ".exr"):
            path = path / f"{self.clouds or self.kind}.png"
        return [path, path.with_suffix(".exr")] if self.exr and path.suffix == ".png" else [path]

    def _sun(self) -> tuple[float, float]:
        """Zenith angle and azimuth of the sun [rad]."""
        place = (self.latitude, self.longitude, self.time)
        if all(value is None for value in place):
            zenith = 45.0 if self.sun_zenith is None else self.sun_zenith
            return math.radians(zenith), math.radians(self.sun_azimuth)
        if self.latitude is None or self.longitude is None or self.time is None:
            raise ValueError("latitude, longitude and time must be given together")
        if self.sun_zenith is not None:
            raise ValueError("sun_zenith must not be given where place and time are")
        try:
            when = datetime.datetime.fromisoformat(self.time)
        except ValueError:
            raise ValueError(
                f"time must be like 2026-06-21T18:00+02:00, got {self.time!r}"
            ) from None
        return sun_at(when, math.radians(self.latitude), math.radians(self.longitude))

    def _picture(self, zenith: float, azimuth: float) -> Picture:
        if self.clouds is not None:
            return self._cloudy(self.clouds, zenith, azimuth)
        if self.kind == "landscape":
            return self._landscape(zenith, azimuth)
        draw = dome_picture if self.kind == "dome" else panorama_picture
        return draw(
            lambda directions: ATMOFIT_2026.XYZ(self.turbidity, zenith, directions, self.albedo),
            self.width,
            azimuth,
        )

    def _cloudy(self, name: str, zenith: float, azimuth: float) -> Picture:
        """A preset cloud from the ground."""
        from tqdm import tqdm

        toward = math.radians(self.toward)
        cloud = staged_cloud(
            name, seed=self.seed, voxels=self.voxels, toward=toward, density=self.density
        )
        middle = float(cloud.low[2] + cloud.high[2]) / 2
        around = clear_surroundings(self.turbidity, zenith, azimuth, self.albedo, middle)
        view = staged_view(name, width=self.width, toward=toward)
        with tqdm(unit="", leave=False) as bar:

            def tell(stage: str) -> None:
                if stage.startswith("left out"):
                    bar.write(stage)
                    return
                bar.set_description(stage)
                bar.update()

            return render_cloud(
                cloud, view, around, phase=cloud_phase(), method=self.scattering, tell=tell
            )

    def _landscape(self, zenith: float, azimuth: float) -> Picture:
        """From a summit in the middle of the terrain."""
        terrain = (
            procedural_terrain(self.seed)
            if self.terrain is None
            else read_elevation_grid(self.terrain)
        )
        light = clear_light(self.turbidity, zenith, azimuth, self.albedo)
        view = View(
            *summit(terrain),
            _EYE,
            math.radians(self.toward),
            columns=self.width,
            rows=max(3 * self.width // 4, 1),
            horizon=0.4,
            farthest=_FARTHEST,
        )
        lowest = math.pi / 2 + math.atan(math.tan(view.field_of_view / 2) * 1.5)
        highest = float(np.max(np.asarray(terrain.heights))) + _EYE
        plan = plan_path(
            light.air,
            (0.1 * _EYE, 2 * _FARTHEST),
            (math.radians(60.0), lowest),
            (0.0, max(highest, _EYE)),
            _SIGHT_RTOL,
        )
        return render_landscape(terrain, view, light, plan, self.albedo)


def summit(terrain: Terrain) -> tuple[float, float]:
    """The highest place of the middle third, east and north [m]."""
    heights = np.asarray(terrain.heights)
    first = [size // 3 for size in heights.shape]
    last = [max(2 * size // 3, start + 1) for size, start in zip(heights.shape, first, strict=True)]
    middle = heights[first[0] : last[0], first[1] : last[1]]
    north, east = np.unravel_index(np.argmax(middle), middle.shape)
    spacing = float(terrain.spacing)
    return (east + first[1]) * spacing, (north + first[0]) * spacing
