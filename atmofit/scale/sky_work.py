"""Simulated skies over a table of turbidities, ground albedos and suns, row by row."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np

from atmofit.colour import XYZ_to_xyY
from atmofit.fit.training import TrainingSettings
from atmofit.geometry import Directions, dome_343
from atmofit.scale.works import Coordinate, Variable, Work
from atmofit.sky.plan import Plan
from atmofit.typing import Reals


@dataclasses.dataclass(frozen=True)
class SkyWork(Work):
    """A data set of skies; a row is one turbidity over one ground, under all suns.

    The skies are those of `simulate_training`, which holds a whole table in memory instead.

    Attributes:
        sky: What is simulated.
        directions: In which the skies are seen; None: `dome_343`.
        plan: How each sky is computed; None: that of the settings.
    """

    sky: TrainingSettings = dataclasses.field(default_factory=TrainingSettings)
    directions: Directions | None = None
    plan: Plan | None = None

    name = "dataset"
    axis = "air"
    group = 1  # a field shares its work among the suns already

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Turbidity and albedo of each row."""
        T, albedo = np.meshgrid(self.sky.turbidity, self.sky.albedo, indexing="ij")
        return T.ravel(), albedo.ravel()

    @property
    def count(self) -> int:
        """Rows."""
        return len(self.sky.turbidity) * len(self.sky.albedo)

    @property
    def settings(self) -> dict[str, Any]:
        """All that the numbers depend on besides the code."""
        view, azimuth = (np.asarray(angle).tolist() for angle in self._directions.angles())
        return dataclasses.asdict(self.sky) | {
            "plan": dataclasses.asdict(self._plan),
            "view_zenith_angle": view,
            "relative_azimuth": azimuth,
        }

    @property
    def variables(self) -> dict[str, Variable]:
        """Radiance and colour."""
        dome = (len(self.sky.solar_zenith_angle_deg), *self._directions.shape)
        axes = ("sun", "direction")
        return {
            "radiance": Variable(
                (*axes, "wavelength"),
                (*dome, self.sky.all_wavelength_nm.size),
                self._plan.dtype,
                "sr-1",
                "radiance over the sun's irradiance",
            ),
            "xyY": Variable(
                (*axes, "colour"), (*dome, 3), "float64", "1, 1, cd m-2", "x, y, Y, standard sun"
            ),
        }

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """Of air, sun, direction, wavelength."""
        T, albedo = self.table
        return sky_coordinates(T, albedo, self.sky, self._directions) | {
            "wavelength": (("wavelength",), self.sky.all_wavelength_nm, {"units": "nm"}),
        }

    def inputs(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Turbidity and albedo of some rows."""
        T, albedo = self.table
        return T[first:last], albedo[first:last]

    def compute(self, inputs: tuple[Reals, Reals]) -> dict[str, Reals]:
        """Radiance and colour of a row."""
        T, albedo = inputs
        radiance = self.sky.radiance(self._plan, self._directions, T[0], albedo[0])
        xyY = XYZ_to_xyY(self.sky.XYZ(radiance))
        return {"radiance": radiance[None], "xyY": xyY[None]}

    @functools.cached_property
    def _directions(self) -> Directions:
        with jax.enable_x64(True):
            return dome_343() if self.directions is None else self.directions

    @functools.cached_property
    def _plan(self) -> Plan:
        with jax.enable_x64(True):
            return self.sky.plan() if self.plan is None else self.plan


def sky_coordinates(
    turbidity: np.ndarray, albedo: np.ndarray, sky: TrainingSettings, directions: Directions
) -> dict[str, Coordinate]:
    """Of air, sun and direction."""
    view, azimuth = (np.asarray(angle, float) for angle in directions.angles())
    sun = np.radians(sky.solar_zenith_angle_deg)
    return {
        "turbidity": (("air",), turbidity, {"units": "1"}),
        "albedo": (("air",), albedo, {"units": "1", "long_name": "of the ground"}),
        "solar_zenith_angle": (("sun",), sun, {"units": "rad"}),
        "view_zenith_angle": (("direction",), view, {"units": "rad"}),
        "relative_azimuth": (("direction",), azimuth, {"units": "rad", "long_name": "0: sun"}),
    }
