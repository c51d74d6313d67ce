"""From a photograph to an observation: sun, horizon, bad pixels, and cells of clear sky."""

import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Float, Int

from atmofit.checks import in_range
from atmofit.colour import LUMINANCE_OF_SRGB
from atmofit.geometry import Directions
from atmofit.observe.images import Photograph
from atmofit.observe.observation import Observation

_SUN_SPOT = math.radians(2.0)  # radius over which brightness is averaged to find the sun
_FEWEST_CELLS = 20
_EVEN = 1.05  # brightest cell over darkest: an image of one brightness
_FLAT_SUN = 3.0  # brightest spot over the sky's median: less, and the range is not a sky's
_PEAK = 2.0  # brightest spot over a ring around it: less, and it is no sun
_RING = (math.radians(8.0), math.radians(15.0))
_CLIPPED = 0.02  # share of the sky's pixels that have the largest value
_STEP = 0.5  # of log luminance from ring to ring downward: something stands before the sky
_LOOK_BACK = math.radians(6.0)  # how far above a pixel the sky is compared with it
_ROUGH = 0.06  # deviation from a plane inside a cell over its mean: cloud edges, wires, leaves


@dataclasses.dataclass(frozen=True)
class SkySettings:
    """How a photograph is taken apart.

    Attributes:
        lowest_elevation_deg: Pixels below are not looked at [degree].
        sun_radius_deg: Around the sun nothing is used: it blinds the lens [degree].
        cell_deg: Width of the cells into which pixels are put together [degree].
        relative_noise: Of a cell, for lens and camera are no photometer [-].
        sun: Solar zenith angle, and azimuth from the image's left edge or top [rad]; None: the
            brightest spot of the sky.
        exposure: As in `Observation`; "each channel" leaves the white balance open.
    """

    lowest_elevation_deg: float = 5.0
    sun_radius_deg: float = 15.0
    cell_deg: float = 7.5
    relative_noise: float = 0.03
    sun: tuple[float, float] | None = None
    exposure: str = "each channel"

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        in_range("lowest_elevation_deg", self.lowest_elevation_deg, 0.0, 80.0, "degree")
        in_range("sun_radius_deg", self.sun_radius_deg, 0.0, 60.0, "degree")
        in_range("cell_deg", self.cell_deg, 1.0, 30.0, "degree")
        in_range("relative_noise", self.relative_noise, 1e-6, 1.0)
        if self.sun is not None:
            in_range("sun", self.sun[0], 0.0, math.pi / 2, "rad")


@dataclasses.dataclass(frozen=True)
class SkyFromPhotograph:
    """The clear sky in a photograph.

    Attributes:
        observation: One value for each cell, in linear sRGB of unknown exposure.
        solar_zenith_angle: [rad].
        solar_azimuth: In the image, as `Photograph.angles` counts [rad].
        used: Pixels that entered the observation.
        cell: To which cell each of them belongs, -1 for the others.
        counts: Pixels that were left out, by reason, and those that were used.
    """

    observation: Observation
    solar_zenith_angle: float
    solar_azimuth: float
    used: Bool[np.ndarray, "row column"]
    cell: Int[np.ndarray, "row column"]
    counts: dict[str, int]


def sky_from_photograph(
    photograph: Photograph, settings: SkySettings | None = None
) -> SkyFromPhotograph:
    """Find the sun, mask what is no clear sky, and put the rest together in cells.

    Left out are pixels below the horizon, behind things that stand before the sky (below a step in
    brightness, column by column), around the sun, and with a channel that is not finite or not
    above 0; then cells that are uneven inside. Thin cloud stays, for a robust fit to find.

    Raises:
        ValueError: The image has no sky, no range, is clipped or looks tone-mapped, or its sun is
            not in the frame; the message says what was seen.
    """
    s = settings or SkySettings()
    zenith, azimuth, area = photograph.angles()
    rgb = photograph.rgb
    finite = np.asarray(np.isfinite(rgb).all(axis=2))
    positive = np.asarray(finite & (np.where(finite[..., None], rgb, 0.0) > 0).all(axis=2))
    above = zenith <= math.radians(90.0 - s.lowest_elevation_deg)
    if not (above & positive).any():
        raise ValueError(
            "photograph must show sky, got no pixel with positive channels above an elevation of "
            f"{s.lowest_elevation_deg:g} degrees"
        )
    Y = np.where(positive, np.where(finite[..., None], rgb, 0.0) @ LUMINANCE_OF_SRGB, np.nan)
    _check_range(Y[above & positive])
    sun = s.sun if s.sun is not None else _brightest(zenith, azimuth, area, rgb, finite)
    to_sun = _apart(zenith, azimuth, *sun)
    clear = above & ~_behind(Y, zenith, above)
    near = to_sun <= math.radians(s.sun_radius_deg)
    used = clear & positive & ~near
    cell, count = _cells(zenith, azimuth, used, math.radians(s.cell_deg))
    values, rough, view, across = _means(rgb, zenith, azimuth, area, cell, count)
    good = rough <= _ROUGH
    kept = used & np.append(good, False)[cell]
    counts = {
        "below the horizon": int((~above).sum()),
        "behind things": int((above & ~clear).sum()),
        "around the sun": int((clear & near).sum()),
        "negative": int((clear & ~near & finite & ~positive).sum()),
        "not finite": int((clear & ~near & ~finite).sum()),
        "in uneven cells": int((used & ~kept).sum()),
        "used": int(kept.sum()),
    }
    if good.sum() < _FEWEST_CELLS:
        raise ValueError(
            f"photograph must show at least {_FEWEST_CELLS} cells of clear sky, got {good.sum()}; "
            f"pixels: {counts}"
        )
    if s.sun is None:
        _check_sun(values[good] @ LUMINANCE_OF_SRGB, np.abs(rgb) @ LUMINANCE_OF_SRGB, to_sun, above)
    observation = Observation(
        directions=Directions(view[good], across[good] - sun[1]),
        values=values[good],
        solar_zenith_angle=sun[0],
        relative_noise=s.relative_noise,
        channels="linear_sRGB",
        exposure=s.exposure,
    )
    number = np.append(np.where(good, np.cumsum(good) - 1, -1), -1)
    return SkyFromPhotograph(observation, sun[0], sun[1], kept, number[cell], counts)


def _check_range(Y: np.ndarray) -> None:
    """Refuse images whose sky has one brightness, or whose brightest parts were cut off."""
    low, high = np.percentile(Y, [1.0, 99.0])
    if high <= _EVEN * low:
        raise ValueError(
            "photograph must have the sky's range of brightness, got "
            f"{low:.4g} to {high:.4g} between its 1st and 99th percentile"
        )
    clipped = float(np.mean(Y.max() * (1 - 1e-6) <= Y))
    if clipped > _CLIPPED:
        raise ValueError(
            f"photograph must not be clipped, got {clipped:.1%} of the sky at its largest value "
            f"{Y.max():.4g}"
        )


def _check_sun(sky: np.ndarray, size: np.ndarray, to_sun: np.ndarray, above: np.ndarray) -> None:
    """Refuse a brightest spot that is no sun: not much brighter than sky and surroundings."""
    spot = size[(to_sun <= _SUN_SPOT) & np.isfinite(size)]
    ring = size[(to_sun >= _RING[0]) & (to_sun <= _RING[1]) & above & np.isfinite(size)]
    brightest = float(spot.max()) if spot.size else math.nan
    over_sky = brightest / float(np.median(sky))
    over_ring = brightest / float(np.median(ring)) if ring.size else math.nan
    if not (over_sky >= _FLAT_SUN and over_ring >= _PEAK):
        raise ValueError(
            "photograph must show the sun with its full range, got a brightest spot "
            f"{over_sky:.2g} times as bright as the middle of the sky and {over_ring:.2g} times as "
            "bright as its own surroundings: the sun is outside the frame, masked or behind "
            "cloud, or the image has been tone-mapped; give its place if it is known"
        )


def _brightest(
    zenith: np.ndarray, azimuth: np.ndarray, area: np.ndarray, rgb: np.ndarray, finite: np.ndarray
) -> tuple[float, float]:
    """Zenith angle and azimuth of the brightest spot above the horizon.

    A photograph's sun is often damaged, some of its pixels negative: their size counts. The
    brightest pixel is looked for first, then the centre of what is nearly as bright around it.
    """
    up = zenith <= math.pi / 2
    size = np.where(finite[..., None] & up[..., None], np.abs(rgb), 0.0) @ LUMINANCE_OF_SRGB
    at = np.unravel_index(int(np.argmax(size)), size.shape)
    place = float(zenith[at]), float(azimuth[at])
    for _ in range(3):
        around = _apart(zenith, azimuth, *place) <= _SUN_SPOT
        light = np.where(around, np.minimum(size, 0.5 * size[at]) * area, 0.0)
        view, across = np.where(up, zenith, 0.0), azimuth
        vector = [
            float(np.sum(light * np.sin(view) * np.cos(across))),
            float(np.sum(light * np.sin(view) * np.sin(across))),
            float(np.sum(light * np.cos(view))),
        ]
        place = (
            math.atan2(math.hypot(vector[0], vector[1]), vector[2]),
            math.atan2(vector[1], vector[0]) % (2 * math.pi),
        )
    return min(place[0], math.pi / 2), place[1]


def _apart(zenith: np.ndarray, azimuth: np.ndarray, z: float, a: float) -> np.ndarray:
    """Angle of every pixel to a direction; that of pixels outside the image is pi."""
    view = np.where(np.isfinite(zenith), zenith, 0.0)
    cosine = np.cos(view) * math.cos(z) + np.sin(view) * math.sin(z) * np.cos(azimuth - a)
    return np.where(np.isfinite(zenith), np.arccos(np.clip(cosine, -1.0, 1.0)), math.pi)


def _behind(Y: np.ndarray, zenith: np.ndarray, above: np.ndarray) -> Bool[np.ndarray, "row column"]:
    """Pixels below a dark step along their column or radius: trees, houses, masts.

    The sky is followed from the zenith down. Where a pixel is darker than the sky a little above it
    by more than .5 in the logarithm, something stands before it, and all below goes with it.
    """
    rows, columns = _downward(zenith)
    depth = zenith[rows[0], columns[0]]
    back = max(round(_LOOK_BACK / float(np.median(np.diff(depth)))), 1)
    seen = np.where(above & (Y > 0), Y, np.nan)[rows, columns]
    logs = np.asarray(np.log(seen))
    before = np.lib.stride_tricks.sliding_window_view(logs[:, :-1], back, axis=1)
    known = np.asarray(np.isfinite(before).any(axis=2))
    usual = np.nanmedian(np.where(known[..., None], before, 0.0), axis=2)
    dark = np.where(known, logs[:, back:], np.inf) < usual - _STEP
    behind = np.zeros(Y.shape, bool)
    behind[rows[:, back:], columns[:, back:]] = np.maximum.accumulate(dark, axis=1)
    return behind & above


def _downward(zenith: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of pixels from the zenith down, [ray, step]: columns, or rays of a fisheye."""
    rows, columns = zenith.shape
    if np.isfinite(zenith).all() and np.ptp(zenith[0]) == 0:
        shape = (columns, rows)
        down = np.broadcast_to(np.arange(rows), shape)
        return down, np.broadcast_to(np.arange(columns)[:, None], shape)
    radius = min(rows, columns) / 2
    along = np.arange(0.5, radius)
    # Two rays for each pixel of the rim, so that none is missed between them.
    turn = np.linspace(0.0, 2 * math.pi, math.ceil(4 * math.pi * radius), endpoint=False)[:, None]
    row = (rows / 2 - along * np.cos(turn)).astype(int).clip(0, rows - 1)
    column = (columns / 2 + along * np.sin(turn)).astype(int).clip(0, columns - 1)
    return row, column


def _cells(
    zenith: np.ndarray, azimuth: np.ndarray, used: np.ndarray, width: float
) -> tuple[Int[np.ndarray, "row column"], int]:
    """Cells of about equal area, ring by ring, that hold a used pixel."""
    ring = np.floor(np.where(used, zenith, 0.0) / width).astype(int)
    around = np.maximum(1, np.round(2 * math.pi * np.sin((ring + 0.5) * width) / width).astype(int))
    sector = np.floor(np.mod(azimuth, 2 * math.pi) / (2 * math.pi) * around).astype(int)
    key = ring * 10_000 + sector.clip(0, around - 1)
    names, number = np.unique(key[used], return_inverse=True)
    cell = np.full(zenith.shape, -1)
    cell[used] = number
    return cell, names.size


def _means(
    rgb: np.ndarray,
    zenith: np.ndarray,
    azimuth: np.ndarray,
    area: np.ndarray,
    cell: np.ndarray,
    count: int,
) -> tuple[Float[np.ndarray, "cell 3"], np.ndarray, np.ndarray, np.ndarray]:
    """Of each cell the mean channels, their unevenness, and the mean direction."""
    inside = cell >= 0
    number, weight = cell[inside], area[inside]

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(number, weight * values, count)

    whole = total(np.ones(number.size))
    z, a = zenith[inside], azimuth[inside]
    x, y, up = total(np.sin(z) * np.cos(a)), total(np.sin(z) * np.sin(a)), total(np.cos(z))
    channels = rgb[inside]
    mean = np.stack([total(channels[:, k]) / whole for k in range(3)], axis=1)
    Y = channels @ LUMINANCE_OF_SRGB
    centre = total(Y) / whole
    # What a plane through the cell does not explain, so that the sun's glow may be steep.
    offsets = np.stack([z, a * np.sin(z), Y / centre[number]], axis=1)
    middle = np.stack([total(column) / whole for column in offsets.T], axis=1)
    offsets = offsets - middle[number]
    products = np.empty((count, 3, 3))
    for i in range(3):
        for j in range(3):
            products[:, i, j] = total(offsets[:, i] * offsets[:, j]) / whole
    plane = products[:, :2, :2] + 1e-12 * np.eye(2)
    slope = np.linalg.solve(plane, products[:, :2, 2:])
    left = products[:, 2, 2] - np.sum(products[:, :2, 2:] * slope, axis=(1, 2))
    rough = np.sqrt(np.maximum(left, 0.0))
    return mean, rough, np.arctan2(np.hypot(x, y), up), np.arctan2(y, x)
