"""Preset clouds in front of a camera: where they stand, how thick they are, how they are seen."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, in_range
from atmofit.clouds.presets import PRESETS, cloud_preset
from atmofit.clouds.volume import VoxelCloud
from atmofit.clouds.voxels import box_around, voxelise
from atmofit.landscape.view import View

_EYE = 2.0  # [m]


@dataclasses.dataclass(frozen=True)
class Stage:
    """What a preset is staged with.

    Attributes:
        base: Altitude of the bottom [m].
        distance: From the eye to the middle, along the ground [m].
        extinction_coefficient: Where the density is 1 [1/m].
        field_of_view: Of the camera [degree].
    """

    base: float
    distance: float
    extinction_coefficient: float
    field_of_view: float


STAGES = {
    "cumulus": Stage(900.0, 4200.0, 0.04, 50.0),
    "cumulonimbus": Stage(1000.0, 22_000.0, 0.02, 50.0),
}


def staged_cloud(
    name: str,
    *,
    seed: int = 0,
    voxels: int = 64,
    toward: float = 0.0,
    distance: float | None = None,
    density: float = 1.0,
) -> VoxelCloud:
    """A preset on a grid, at its altitude, some way off.

    Args:
        name: One of `PRESETS`.
        seed: Of the shape.
        voxels: Along the longest edge of the grid, 8 to 256; voxels are about cubes.
        toward: Azimuth in which it stands, clockwise from north [rad].
        distance: Along the ground [m]; None: that of the preset.
        density: Multiplies the preset's extinction, 0 to 1000.

    Returns:
        The cloud; its axes are east, north and altitude [m].

    Raises:
        ValueError: An unknown name, or a value out of range.
    """
    stage = STAGES[choice("name", name, PRESETS)]
    in_range("voxels", voxels, 8.0, 256.0)
    in_range("density", density, 0.0, 1e3)
    away = stage.distance if distance is None else distance
    in_range("distance", away, 0.0, 1e5, "m")
    balls = cloud_preset(name, seed=seed)
    place = (away * math.sin(toward), away * math.cos(toward), stage.base)
    balls = eqx.tree_at(
        lambda b: b.centres, balls, balls.centres + jnp.asarray(place, balls.centres.dtype)[None]
    )
    low, high = box_around(balls)
    edges = high - low
    x, y, z = (max(2, round(voxels * float(edge / edges.max()))) for edge in edges)
    return voxelise(balls, (x, y, z), extinction_coefficient=density * stage.extinction_coefficient)


def staged_view(
    name: str,
    *,
    width: int = 500,
    toward: float = 0.0,
    field_of_view: float | None = None,
    horizon: float = 0.88,
) -> View:
    """A camera on the ground that looks to where the preset stands.

    Args:
        name: One of `PRESETS`.
        width: Pixels across; three quarters of them down.
        toward: Azimuth in which it looks, clockwise from north [rad].
        field_of_view: Across [rad]; None: that of the preset.
        horizon: Where the level line runs, 0 at the top to 1 at the bottom.
    """
    stage = STAGES[choice("name", name, PRESETS)]
    across = np.radians(stage.field_of_view) if field_of_view is None else field_of_view
    rows = max(3 * width // 4, 1)
    return View(0.0, 0.0, _EYE, toward, float(across), width, rows, horizon)
