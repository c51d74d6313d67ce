"""Photographs of the sky with their full range: OpenEXR and Radiance HDR."""

import dataclasses
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from atmofit.checks import choice
from atmofit.files import readable_file

PROJECTIONS = ("latlong", "fisheye")
SUFFIXES = (".exr", ".hdr", ".pic")
_ANY_DEPTH = 3  # OpenCV's IMREAD_COLOR and IMREAD_ANYDEPTH: numbers as they are in the file
_LARGEST_IMAGE, _MOST_PIXELS = 2**30, 2**27
_HEADER = 2**14  # bytes in which a Radiance file must have said its size
_RADIANCE_SIZE = re.compile(rb"\n[-+][XY] (\d+) [-+][XY] (\d+)\n")
_TONE_MAPPED = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".webp")


@dataclasses.dataclass(frozen=True)
class Photograph:
    """An image of the whole sky in linear channels.

    Attributes:
        rgb: Relative radiance, top row first; linear sRGB.
        projection: "latlong": columns are azimuths over a full turn, rows go from the zenith to
            the nadir; "fisheye": the zenith in the middle, the horizon on the inscribed circle,
            zenith angle in proportion to the radius.
    """

    rgb: Float[np.ndarray, "row column 3"]
    projection: str = "latlong"

    def __post_init__(self) -> None:
        """Refuse an unknown projection."""
        choice("projection", self.projection, PROJECTIONS)

    def angles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Zenith angle and azimuth [rad] of every pixel, and its solid angle [sr].

        The azimuth runs to the right: from the left edge of a "latlong", clockwise from the top of
        a "fisheye". Pixels outside a fisheye's circle have a zenith angle of infinity.
        """
        rows, columns = self.rgb.shape[:2]
        row, column = np.arange(rows) + 0.5, np.arange(columns) + 0.5
        if self.projection == "latlong":
            zenith = np.repeat((np.pi * row / rows)[:, None], columns, axis=1)
            azimuth = np.repeat((2 * np.pi * column / columns)[None, :], rows, axis=0)
            area = np.sin(zenith) * (np.pi / rows) * (2 * np.pi / columns)
            return zenith, azimuth, area
        radius = min(rows, columns) / 2
        x = (column[None, :] - columns / 2) / radius
        y = (rows / 2 - row[:, None]) / radius
        distance = np.hypot(x, y)
        inside = distance <= 1.0
        zenith = np.where(inside, distance * np.pi / 2, np.inf)
        azimuth = np.mod(np.arctan2(x, y), 2 * np.pi)
        # The area of a pixel on the sphere: sin(z) dz dphi, with dx dy = r dr dphi.
        stretch = np.sinc(np.where(inside, distance, 0.0) / 2) * (np.pi / 2) ** 2
        return zenith, azimuth, np.where(inside, stretch / radius**2, 0.0)


def read_photograph(path: Path | str, projection: str = "latlong") -> Photograph:
    """Read an image with its full range.

    Args:
        path: OpenEXR (.exr) with channels R, G, B, or Radiance (.hdr, .pic).
        projection: See `Photograph`.

    Raises:
        ValueError: The file is absent, damaged, of another kind, or has a tone-mapped format.
        ImportError: The reader is not installed (`pip install 'atmofit[images]'`).
    """
    path = Path(path)
    choice("projection", projection, PROJECTIONS)
    suffix = path.suffix.lower()
    if suffix in _TONE_MAPPED:
        raise ValueError(
            f"file must be an image with its full range ({', '.join(SUFFIXES)}): a {suffix} has "
            f"been tone-mapped, and its values are no radiances, got {str(path)!r}"
        )
    if suffix not in SUFFIXES:
        raise ValueError(f"file must end in {', '.join(SUFFIXES)}, got {str(path)!r}")
    readable_file(path, _LARGEST_IMAGE)
    rgb = _read_exr(path) if suffix == ".exr" else _read_radiance(path)
    if rgb.ndim != 3 or rgb.shape[2] != 3 or min(rgb.shape[:2]) < 8:
        raise ValueError(
            f"file must hold at least 8 x 8 pixels of R, G and B, got shape {rgb.shape} "
            f"in {str(path)!r}"
        )
    return Photograph(rgb.astype(float), projection)


def _check_pixels(path: Path, one: int, other: int) -> None:
    """Refuse images that would not fit into memory, before they are unpacked."""
    if one * other > _MOST_PIXELS:
        raise ValueError(
            f"file must have at most {_MOST_PIXELS} pixels, got {one} x {other} in {str(path)!r}"
        )


def _read_exr(path: Path) -> np.ndarray:
    try:
        import OpenEXR
    except ImportError as error:
        raise ImportError("photographs need OpenEXR: pip install 'atmofit[images]'") from error
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            (left, top), (right, bottom) = file.header()["dataWindow"]
        _check_pixels(path, int(right - left) + 1, int(bottom - top) + 1)
        with OpenEXR.File(str(path)) as file:
            channels = file.channels()
            for name in ("RGB", "RGBA"):
                if name in channels:
                    return np.array(channels[name].pixels[..., :3], float)
            if not {"R", "G", "B"} <= set(channels):
                raise ValueError(f"file must have channels R, G, B, got {sorted(channels)}")
            return np.stack([np.array(channels[c].pixels, float) for c in "RGB"], axis=-1)
    except (RuntimeError, OSError, TypeError, ValueError) as error:
        raise ValueError(
            f"file must be a whole OpenEXR image, got {str(path)!r} ({error})"
        ) from error


def _read_radiance(path: Path) -> np.ndarray:
    try:
        import imageio.v3
    except ImportError as error:
        raise ImportError("photographs need imageio: pip install 'atmofit[images]'") from error
    with path.open("rb") as file:
        size = _RADIANCE_SIZE.search(file.read(_HEADER))
    if size is not None:
        _check_pixels(path, int(size[1]), int(size[2]))
    try:
        return np.asarray(imageio.v3.imread(path, plugin="opencv", flags=_ANY_DEPTH), float)
    except (OSError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"file must be a whole Radiance image, got {str(path)!r} ({error})"
        ) from error
