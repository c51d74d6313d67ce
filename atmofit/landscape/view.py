"""Where the rays of a picture meet the ground.

The picture's plane is upright, so all pixels of a column look along one azimuth: one profile of the
ground serves them all, and the nearest place that reaches as high as a pixel looks is found in the
running maximum of the profile's slopes. No ray is marched on its own.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from atmofit.checks import in_range
from atmofit.landscape.terrain import Terrain
from atmofit.typing import Reals, Scalar, scalar


class View(eqx.Module):
    """A camera with an upright picture plane.

    Attributes:
        east: Place of the eye [m].
        north: Likewise.
        above_ground: Height of the eye over the ground [m].
        azimuth: To which it looks, clockwise from north [rad].
        field_of_view: Across the picture [rad], below pi. Static.
        columns: Pixels across. Static.
        rows: Pixels down. Static.
        horizon: Where the level line runs, 0 at the top to 1 at the bottom. Static.
        farthest: To which distance the ground is looked for [m]. Static.
        samples: Of a profile, in even ratios of distance. Static.
    """

    east: Scalar = eqx.field(converter=scalar)
    north: Scalar = eqx.field(converter=scalar)
    above_ground: Scalar = eqx.field(converter=scalar)
    azimuth: Scalar = eqx.field(converter=scalar)
    field_of_view: float = eqx.field(static=True, converter=float, default=math.radians(60.0))
    columns: int = eqx.field(static=True, default=1000)
    rows: int = eqx.field(static=True, default=750)
    horizon: float = eqx.field(static=True, converter=float, default=0.5)
    farthest: float = eqx.field(static=True, converter=float, default=6e4)
    samples: int = eqx.field(static=True, default=2048)

    def checked(self) -> "View":
        """Refuse impossible cameras."""
        in_range("field_of_view", self.field_of_view, 1e-3, 3.0, "rad")
        in_range("columns", self.columns, 1.0, 1e5)
        in_range("rows", self.rows, 1.0, 1e5)
        in_range("horizon", self.horizon, 0.0, 1.0)
        in_range("farthest", self.farthest, 10.0, 5e5, "m")
        in_range("samples", self.samples, 16.0, 1e5)
        in_range("above_ground", self.above_ground, 0.1, 1e4, "m")
        return self

    def rays(self, column: Array) -> tuple[Reals, Reals]:
        """Azimuths of some columns [rad], and what their pixels climb for each metre along level.

        Args:
            column: Numbers of columns.

        Returns:
            Azimuths [column] and slopes [column, row].
        """
        half = math.tan(self.field_of_view / 2)
        pixel = 2 * half / self.columns
        across = (column.astype(self.azimuth.dtype) + 0.5) * pixel - half
        up = (self.horizon * self.rows - np.arange(self.rows) - 0.5) * pixel
        azimuth = self.azimuth + jnp.arctan(across)
        return azimuth, jnp.asarray(up, across.dtype)[None, :] / jnp.sqrt(1 + across**2)[:, None]


class Hits(eqx.Module):
    """What pixels see.

    Attributes:
        distance: Along the ground's level [m], [column, row]; that of the last sample for sky.
        slope: What the ray climbs for each metre along level [-], likewise.
        azimuth: Clockwise from north [rad], [column].
        is_ground: Whether the ray meets it, [column, row].
        altitude: Of the eye [m].
    """

    distance: Float[Array, "column row"]
    slope: Float[Array, "column row"]
    azimuth: Float[Array, " column"]
    is_ground: Bool[Array, "column row"]
    altitude: Scalar

    @property
    def view_zenith_angle(self) -> Float[Array, "column row"]:
        """Of each ray [rad]."""
        return math.pi / 2 - jnp.arctan(self.slope)

    @property
    def length(self) -> Float[Array, "column row"]:
        """Of each ray to the ground [m]."""
        return self.distance * jnp.sqrt(1 + self.slope**2)

    def place(self, view: View) -> tuple[Float[Array, "column row"], Float[Array, "column row"]]:
        """Where each ray ends, east and north [m]."""
        return (
            view.east + self.distance * jnp.sin(self.azimuth)[:, None],
            view.north + self.distance * jnp.cos(self.azimuth)[:, None],
        )


def intersect(terrain: Terrain, view: View, column: Array) -> Hits:
    """The nearest ground that the pixels of some columns see.

    Args:
        terrain: Heights; beyond the grid's edges there is no ground.
        view: The camera.
        column: Numbers of columns.
    """
    azimuth, slope = view.rays(column)
    nearest = 0.1 * view.above_ground
    share = jnp.asarray(np.linspace(0.0, 1.0, view.samples), slope.dtype)
    distance = nearest * (view.farthest / nearest) ** share
    east = view.east + distance[None, :] * jnp.sin(azimuth)[:, None]
    north = view.north + distance[None, :] * jnp.cos(azimuth)[:, None]
    eye = terrain.height_at(view.east, view.north) + view.above_ground
    width, depth = terrain.size
    there = (east >= 0) & (east <= width) & (north >= 0) & (north <= depth)
    rise = jnp.where(there, terrain.height_at(east, north) - eye, -1e6)
    at, found = jax.vmap(_first, in_axes=(0, 0, None))(rise, slope, distance)
    return Hits(at, slope, azimuth, found, eye)


def _first(
    rise: Float[Array, " sample"],
    slope: Float[Array, " row"],
    distance: Float[Array, " sample"],
) -> tuple[Float[Array, " row"], Bool[Array, " row"]]:
    """Distances of one column, and whether there is ground; it is straight between samples."""
    highest = jax.lax.cummax(rise / distance)
    after = jnp.searchsorted(highest, slope)
    found = after < distance.size
    k = jnp.clip(after, 1, distance.size - 1)
    near, far = distance[k - 1], distance[k]
    # How far the ray runs above the ground before, and below it after.
    above = slope * near - rise[k - 1]
    below = rise[k] - slope * far
    share = above / jnp.maximum(above + below, 1e-6)
    at = near + (far - near) * jnp.clip(share, 0.0, 1.0)
    return jnp.where(found, at, distance[-1]), found
