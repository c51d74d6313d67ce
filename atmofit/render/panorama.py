"""The sky dome as a fisheye picture: zenith in the middle, horizon outside, sun at the top.

Angles from the zenith grow evenly outward, azimuths clockwise from the sun. A dome that is given
on the half circle from 0 to 180 degrees is mirrored, since the sky is symmetric to the sun.
"""

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from atmofit.geometry import DirectionGrid, Directions
from atmofit.render.film import on_film

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

MAGNITUDES, DIFFERENCES = "cividis", "RdBu_r"  # even in lightness; the second about its middle
HORIZON_DEG = 90.0
DIRECTION_DECIMALS = 4  # [degree]; closer directions count as one
ROUND = 0.97  # a dome whose edge keeps within this share of its radius counts as round
BEYOND_DEG = 1.5
_WIDTHS = {"axis": 0.5, "horizon": 0.9}


def draw_dome(
    axes: "Axes",
    directions: Directions | DirectionGrid,
    values: Any,
    *,
    limits: tuple[float, float] | None = None,
    colour_map: str = MAGNITUDES,
    solar_zenith_angle: float | None = None,
    labels: bool = True,
    pixels: int = 200,
) -> "AxesImage":
    """Draw a quantity on the dome, smoothly shaded.

    Args:
        axes: Empty ones; they become square and lose their frame.
        directions: Any list that spans the dome, or a grid; mirrored if all azimuths lie between
            0 and 180 degrees.
        values: In the shape of the directions.
        limits: Of the colours. None: the range of the values.
        colour_map: `MAGNITUDES`, `DIFFERENCES` (with limits even about 0) or any of matplotlib.
        solar_zenith_angle: Where to mark the sun [rad]. None: nowhere.
        labels: Whether rings and azimuths carry their degrees.
        pixels: Across the picture.

    Returns:
        The image, for a colour bar.

    Raises:
        ValueError: Values that do not fit the directions, or fewer than three directions.
    """
    picture = interpolate_dome(directions, values, pixels=pixels)
    low, high = limits if limits is not None else (np.nanmin(picture), np.nanmax(picture))
    image = _show(axes, picture, cmap=colour_map, vmin=low, vmax=high)
    _draw_rings(axes, labels, "#00000066")
    if solar_zenith_angle is not None:
        mark_sun(axes, solar_zenith_angle)
    return image


def draw_sky(
    axes: "Axes",
    directions: Directions | DirectionGrid,
    xyY: Any,
    *,
    white_luminance: float,
    solar_zenith_angle: float | None = None,
    pixels: int = 240,
) -> "AxesImage":
    """Draw a sky in its colours, see `sky_image`."""
    image = _show(axes, sky_image(directions, xyY, white_luminance=white_luminance, pixels=pixels))
    _draw_rings(axes, False, "none")
    if solar_zenith_angle is not None:
        mark_sun(axes, solar_zenith_angle)
    return image


def sky_image(
    directions: Directions | DirectionGrid,
    xyY: Any,
    *,
    white_luminance: float,
    pixels: int = 400,
) -> np.ndarray:
    """A fisheye photograph of a sky, in sRGB.

    As `on_film` shows colours.

    Args:
        directions: Of the sky, as in `draw_dome`.
        xyY: x, y and Y [cd m^-2] on a last axis of 3 after the axes of the directions.
        white_luminance: The exposure [cd m^-2]: this luminance is shown as 63 % of the screen's.
        pixels: Width and height.

    Returns:
        Red, green, blue and opacity, 0 to 1, [row, column, 4]; transparent outside the dome.

    Raises:
        ValueError: Colours that do not fit the directions, or a luminance that is not positive.
    """
    xyY = np.asarray(xyY, float)
    if xyY.shape != (*directions.shape, 3) or not xyY[..., 2].min() > 0:
        raise ValueError(
            f"xyY must have shape {(*directions.shape, 3)} and positive Y, got {xyY.shape}"
        )
    # Luminance spans decades, so it is interpolated in its logarithm; chromaticity hardly bends.
    log_luminance = interpolate_dome(directions, np.log(xyY[..., 2]), pixels=pixels)
    x, y = (
        interpolate_dome(directions, xyY[..., k], pixels=pixels, smooth=False) for k in range(2)
    )
    inside = np.isfinite(log_luminance) & np.isfinite(x)
    colours = np.stack([x[inside], y[inside], np.exp(log_luminance[inside])], axis=-1)
    picture = np.zeros((pixels, pixels, 4))
    picture[inside, :3] = on_film(colours, white_luminance)
    picture[inside, 3] = 1
    return picture


def interpolate_dome(
    directions: Directions | DirectionGrid, values: Any, *, pixels: int = 200, smooth: bool = True
) -> np.ndarray:
    """Values between the directions, on the pixels of a fisheye picture.

    Args:
        directions: As in `draw_dome`.
        values: In their shape; NaN anywhere makes the whole picture NaN.
        pixels: Width and height; the picture spans the horizon's circle.
        smooth: Cubic in each triangle of directions, kept inside the range of the values; False:
            linear.

    Returns:
        [row, column] from the top left; NaN outside the outermost directions. The values on a
        round edge are drawn up to 1.5 degrees beyond it, so that a ring at 89 degrees reaches the
        horizon.
    """
    from matplotlib.tri import CubicTriInterpolator, LinearTriInterpolator

    values = np.asarray(values, float)
    if values.shape != directions.shape:
        raise ValueError(f"values must have shape {directions.shape}, got {values.shape}")
    view, azimuth = (np.asarray(angle, float).ravel() for angle in directions.angles())
    net = _net(view.tobytes(), azimuth.tobytes())
    if not np.isfinite(values).all():
        return np.full((pixels, pixels), np.nan)
    at_points = np.tile(values.ravel(), net.copies)[net.chosen]
    if smooth:
        between = CubicTriInterpolator(net.triangles, at_points, kind="geom")
    else:
        between = LinearTriInterpolator(net.triangles, at_points)
    picture = np.ma.filled(between(*net.pixels(pixels)), np.nan)
    return np.clip(picture, at_points.min(), at_points.max())


@dataclasses.dataclass(frozen=True)
class _Net:
    """Triangles between directions on the picture.

    Attributes:
        triangles: Of matplotlib, in degrees to the right and up.
        copies: How often the list of directions is repeated: 2 if mirrored.
        chosen: Which of the repeated entries are the triangles' corners.
    """

    triangles: Any
    copies: int
    chosen: np.ndarray

    def pixels(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the centres of the pixels take their values; NaN: nowhere."""
        centres = HORIZON_DEG * (2 * (np.arange(count) + 0.5) / count - 1)
        right, up = np.meshgrid(np.abs(centres) if self.copies == 2 else centres, -centres)
        inner, outer = self._edge()
        if inner < ROUND * outer:
            return right, up
        radius = np.hypot(right, up)
        inward = np.minimum(1.0, inner / np.maximum(radius, 1e-9))
        inward[radius > outer + BEYOND_DEG] = np.nan
        return right * inward, up * inward

    def _edge(self) -> tuple[float, float]:
        """Distances from the zenith to the nearest chord and to the farthest corner."""
        net = self.triangles
        triangle, side = np.nonzero(net.neighbors == -1)
        corners = net.triangles[triangle]
        rows = np.arange(len(triangle))
        points = np.stack([net.x, net.y], axis=-1)
        a, b = points[corners[rows, side]], points[corners[rows, (side + 1) % 3]]
        across = b - a
        area = a[:, 0] * across[:, 1] - a[:, 1] * across[:, 0]
        nearest = np.min(np.abs(area) / np.hypot(*across.T))
        return 0.9999 * float(nearest), float(np.hypot(net.x, net.y).max())


@functools.lru_cache(maxsize=8)
def _net(view: bytes, azimuth: bytes) -> _Net:
    """Triangulate directions on the picture, given as bytes so that they can be remembered."""
    from matplotlib.tri import Triangulation

    θ, φ = np.degrees(np.frombuffer(view)), np.frombuffer(azimuth)
    right, up = θ * np.sin(φ), θ * np.cos(φ)
    half = bool(np.all(np.sin(φ) > -1e-6))
    points = np.stack([right, up], axis=-1)
    if half:
        points = np.concatenate([points, np.stack([-right, up], axis=-1)])
    # Adding 0 turns -0 into 0.
    rounded = np.round(points, DIRECTION_DECIMALS) + 0.0
    _, chosen = np.unique(rounded, axis=0, return_index=True)
    if len(chosen) < 3:
        raise ValueError(f"a dome needs at least three directions, got {len(chosen)}")
    return _Net(Triangulation(*points[chosen].T), 2 if half else 1, chosen)


def mark_sun(axes: "Axes", solar_zenith_angle: float) -> None:
    """Mark where the sun stands [rad]."""
    axes.plot(
        [0.0], [np.degrees(solar_zenith_angle)], "o", ms=6, mfc="white", mec="black", mew=1.0,
        clip_on=False, zorder=5,
    )  # fmt: skip


def _show(axes: "Axes", picture: np.ndarray, **colours: Any) -> "AxesImage":
    from matplotlib.patches import Circle

    extent = (-HORIZON_DEG, HORIZON_DEG, -HORIZON_DEG, HORIZON_DEG)
    axes.set_axis_off()
    image = axes.imshow(picture, extent=extent, interpolation="bilinear", **colours)
    image.set_clip_path(Circle((0, 0), HORIZON_DEG, transform=axes.transData))
    return image


def _draw_rings(axes: "Axes", labels: bool, colour: str) -> None:
    """Rings at 30 and 60 degrees, the meridians at right angles, the horizon, their degrees."""
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    reach = HORIZON_DEG * (1.16 if labels else 1.04)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    for ring in (30.0, 60.0):
        axes.add_patch(Circle((0, 0), ring, fill=False, ec=colour, lw=_WIDTHS["axis"]))
    axes.add_patch(Circle((0, 0), HORIZON_DEG, fill=False, ec="#444444", lw=_WIDTHS["horizon"]))
    across, none = (-HORIZON_DEG, HORIZON_DEG), (0.0, 0.0)
    for line in ((across, none), (none, across)):
        axes.plot(*line, color=colour, lw=_WIDTHS["axis"])
    if not labels:
        return
    halo = [withStroke(linewidth=2, foreground="white")]
    for ring in (30.0, 60.0):
        at = ring * np.sqrt(0.5)
        axes.text(at, -at, f"{ring:.0f}°", ha="center", va="center", fontsize=7, path_effects=halo)
    for azimuth, (right, up) in {0: (0, 1), 90: (1, 0), 180: (0, -1), 270: (-1, 0)}.items():
        axes.text(
            right * HORIZON_DEG * 1.04, up * HORIZON_DEG * 1.04, f"{azimuth}°", fontsize=7,
            ha={1: "left", 0: "center", -1: "right"}[right],
            va={1: "bottom", 0: "center", -1: "top"}[up],
        )  # fmt: skip
