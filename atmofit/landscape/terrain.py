"""Heights on a grid: made from a seed, or read from a file."""

import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.files import readable_file
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

_LARGEST_SIDE = 8192.0
_HEAD = ("ncols", "nrows", "cellsize")


class Terrain(eqx.Module):
    """Heights at the points of a square grid.

    Attributes:
        heights: Above the sea [m], [north, east]; the first point lies at the origin.
        spacing: Of the points [m].
    """

    heights: Float[Array, "north east"] = eqx.field(converter=real_array)
    spacing: Scalar = eqx.field(converter=scalar)

    def checked(self) -> "Terrain":
        """Refuse impossible grids."""
        if self.heights.ndim != 2 or min(self.heights.shape) < 2:
            raise ValueError(f"heights must be a grid, got shape {self.heights.shape}")
        heights = in_range("heights", self.heights, -500.0, 1e4, "m")
        return Terrain(heights, in_range("spacing", self.spacing, 1e-2, 1e5, "m"))

    @property
    def size(self) -> tuple[Scalar, Scalar]:
        """Extent to the east and to the north [m]."""
        north, east = self.heights.shape
        return (east - 1) * self.spacing, (north - 1) * self.spacing

    def sample(self, values: Float[Array, "north east"], east: Reals, north: Reals) -> Reals:
        """A quantity of the grid between its points, linear; beyond the edges it stays constant."""
        rows, columns = values.shape
        x = jnp.clip(east / self.spacing, 0.0, columns - 1.0)
        y = jnp.clip(north / self.spacing, 0.0, rows - 1.0)
        i = jnp.minimum(jnp.floor(jax.lax.stop_gradient(y)).astype(int), rows - 2)
        j = jnp.minimum(jnp.floor(jax.lax.stop_gradient(x)).astype(int), columns - 2)
        u, v = x - j.astype(x.dtype), y - i.astype(y.dtype)
        flat, first = values.ravel(), i * columns + j
        south, north_of_it = (flat[k] * (1 - u) + flat[k + 1] * u for k in (first, first + columns))
        return south * (1 - v) + north_of_it * v

    def height_at(self, east: Reals, north: Reals) -> Reals:
        """Height between the points [m]."""
        return self.sample(self.heights, east, north)

    def slopes(self) -> tuple[Float[Array, "north east"], Float[Array, "north east"]]:
        """How fast the ground rises to the east and to the north [-]."""
        north, east = jnp.gradient(self.heights)
        return east / self.spacing, north / self.spacing

    def sunlit(
        self, solar_zenith_angle: RealsLike, solar_azimuth: RealsLike
    ) -> Float[Array, "north east"]:
        """Share of the sun that each point sees, 1 or 0 but for edges blurred over half a cell.

        Row by row away from the sun, each point hands on the height below which it casts shadow.

        Args:
            solar_zenith_angle: [rad], a number.
            solar_azimuth: Clockwise from north [rad], a number.
        """
        zenith, azimuth = scalar(solar_zenith_angle), scalar(solar_azimuth)
        toward_east, toward_north = jnp.sin(azimuth), jnp.cos(azimuth)
        # The sweep goes along the axis that lies nearer to the sun's direction.
        along_north = jnp.abs(toward_north) >= jnp.abs(toward_east)
        by_north = _shadow(self.heights, self.spacing, zenith, toward_north, toward_east)
        by_east = _shadow(self.heights.T, self.spacing, zenith, toward_east, toward_north).T
        above = self.heights - jnp.where(along_north, by_north, by_east)
        blur = 0.5 * self.spacing * jnp.tan(jnp.maximum(math.pi / 2 - zenith, 0.02))
        return jnp.clip(0.5 + above / blur, 0.0, 1.0)


def _shadow(
    heights: Float[Array, "row column"],
    spacing: Scalar,
    zenith: Scalar,
    across: Scalar,
    along: Scalar,
) -> Float[Array, "row column"]:
    """Height below which each point lies in the shadow of the rows nearer to the sun."""
    forward = across < 0  # the sun stands beyond the first row
    rows = jnp.where(forward, heights, heights[::-1])
    safe = jnp.where(jnp.abs(across) < 1e-3, 1.0, jnp.abs(across))
    shift = along / safe  # columns toward the sun for a row toward it
    drop = spacing * jnp.sqrt(1 + shift**2) / jnp.tan(jnp.minimum(zenith, 1.57))
    columns = jnp.arange(heights.shape[1], dtype=heights.dtype)

    def step(top: Reals, row: Reals) -> tuple[Reals, Reals]:
        shadow = jnp.interp(columns + shift, columns, top) - drop
        return jnp.maximum(shadow, row), shadow

    _, found = jax.lax.scan(step, jnp.full_like(rows[0], -1e5), rows)
    return jnp.where(forward, found, found[::-1])


def procedural_terrain(
    seed: int = 0,
    points: int = 1024,
    spacing: float = 60.0,
    relief: float = 2200.0,
    roughness: float = 2.1,
) -> Terrain:
    """Mountains from a seed: noise whose amplitude falls with spatial frequency, valleys flattened.

    Args:
        seed: Of the noise.
        points: Along each side, 16 to 8192.
        spacing: Of the points [m].
        relief: Of the highest point above the lowest [m].
        roughness: Power with which the noise's amplitude falls, 1 (rough) to 4 (smooth).

    Returns:
        The same heights for the same arguments on every machine, up to rounding; the grid's edges
        meet, so that it could be repeated.

    Raises:
        ValueError: An argument is out of range.
    """
    in_range("points", points, 16.0, _LARGEST_SIDE)
    in_range("relief", relief, 1.0, 9e3, "m")
    in_range("roughness", roughness, 1.0, 4.0)
    random = np.random.default_rng(seed)
    rows, columns = np.fft.fftfreq(points)[:, None], np.fft.rfftfreq(points)[None, :]
    frequency = np.hypot(rows, columns)
    # No wave longer than a third of the side, so that every part has mountains.
    amplitude = np.maximum(frequency, 3.0 / points) ** -roughness
    noise = np.fft.rfft2(random.standard_normal((points, points))) * amplitude
    noise[0, 0] = 0.0
    smooth = np.fft.irfft2(noise, (points, points))
    # Ridges where the noise changes sign, as water leaves them; wide floors between.
    ridges = 1 - np.abs(smooth) / np.abs(smooth).max()
    share = (ridges - ridges.min()) / np.ptp(ridges)
    return Terrain(relief * share**4, spacing).checked()


def read_elevation_grid(path: str | Path) -> Terrain:
    """Read an Esri ASCII grid (.asc): names and numbers, then heights from north to south.

    Args:
        path: Of the file. Points without data get the lowest height.

    Raises:
        ValueError: No such file, one of another kind, or an incomplete one.
        OSError: It cannot be read.
    """
    text = readable_file(path).read_text(encoding="ascii", errors="replace").split()
    head: dict[str, float] = {}
    place = 0
    while place + 1 < len(text) and text[place][0].isalpha():
        head[text[place].lower()] = _number(path, text[place + 1])
        place += 2
    missing = [name for name in _HEAD if name not in head]
    if missing:
        raise ValueError(f"file must name {', '.join(_HEAD)}, got none of {missing} in {path}")
    shape = int(head["nrows"]), int(head["ncols"])
    values = np.array([_number(path, word) for word in text[place:]])
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"file must hold {shape[0]} x {shape[1]} heights, got {values.size}")
    known = values != head.get("nodata_value", -9999.0)
    if not known.any():
        raise ValueError(f"file must hold heights, got only points without data in {path}")
    heights = np.where(known, values, values[known].min())
    return Terrain(heights.reshape(shape)[::-1], head["cellsize"]).checked()


def _number(path: str | Path, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"file must hold numbers, got {word!r} in {path}") from None
