"""Pictures of skies, and pictures as files."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from atmofit.colour import XYZ_to_linear_sRGB, XYZ_to_xyY
from atmofit.files import replace_file
from atmofit.geometry import HORIZON, Directions
from atmofit.landscape.picture import Picture
from atmofit.render.film import on_film
from atmofit.render.image import save_bytes

SkyColours = Callable[[Directions], Any]  # XYZ, [direction, 3]


def dome_picture(sky: SkyColours, size: int, sun_azimuth: float) -> Picture:
    """The whole dome: zenith in the middle, horizon outside, north at the top, east at the right.

    Args:
        sky: XYZ in a list of directions.
        size: Pixels across and down; black beyond the horizon.
        sun_azimuth: Clockwise from north [rad].
    """
    place = (np.arange(size) + 0.5) * 2 / size - 1
    east, north = np.meshgrid(place, -place)
    zenith = np.hypot(east, north) * HORIZON
    azimuth = np.arctan2(east, north) - sun_azimuth
    inside = zenith <= HORIZON
    XYZ = np.zeros((size, size, 3))
    XYZ[inside] = sky(Directions(zenith[inside], azimuth[inside]))
    return Picture(XYZ, np.full((size, size), np.inf))


def panorama_picture(sky: SkyColours, size: int, sun_azimuth: float) -> Picture:
    """All around: north in the middle, east to the right, the zenith above, the horizon below.

    Args:
        sky: XYZ in a list of directions.
        size: Pixels across; a quarter of them down, so that angles are even both ways.
        sun_azimuth: Clockwise from north [rad].
    """
    rows = max(size // 4, 1)
    zenith = HORIZON * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * ((np.arange(size) + 0.5) / size - 0.5) - sun_azimuth
    z, a = np.meshgrid(zenith, azimuth, indexing="ij")
    XYZ = np.asarray(sky(Directions(z.ravel(), a.ravel())), float).reshape(rows, size, 3)
    return Picture(XYZ, np.full((rows, size), np.inf))


def typical_luminance(picture: Picture) -> float:
    """An exposure that shows most of a picture [cd m^-2]: its 80th percentile of luminance."""
    luminance = np.asarray(picture.XYZ)[..., 1]
    return float(np.percentile(luminance[luminance > 0], 80.0))


def write_picture(picture: Picture, path: str | Path, white_luminance: float | None = None) -> Path:
    """Write a picture whole or not at all.

    Args:
        picture: Of a landscape.
        path: Ends with .png: on film, in sRGB; or with .exr: linear sRGB [cd m^-2] in single
            precision.
        white_luminance: The film's exposure, see `on_film`; None: the picture's own.

    Returns:
        The path.

    Raises:
        ValueError: Another suffix.
        ImportError: OpenEXR is not installed (`pip install 'atmofit[images]'`).
        OSError: The file cannot be written; no part of it is left behind.
    """
    target = Path(path)
    if target.suffix == ".exr":
        return replace_file(target, lambda name: _write_exr(picture, name))
    if target.suffix != ".png":
        raise ValueError(f"path must end with .png or .exr, got {str(path)!r}")
    from matplotlib.image import imsave

    white = typical_luminance(picture) if white_luminance is None else white_luminance
    buffer = io.BytesIO()
    shown = on_film(np.asarray(XYZ_to_xyY(picture.XYZ)), white)
    imsave(buffer, np.round(255 * shown).astype(np.uint8), format="png")
    return save_bytes(buffer.getvalue(), target)


def _write_exr(picture: Picture, path: Path) -> None:
    try:
        import OpenEXR
    except ImportError as error:
        raise ImportError("EXR files need OpenEXR: pip install 'atmofit[images]'") from error
    linear = np.ascontiguousarray(XYZ_to_linear_sRGB(picture.XYZ), np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": linear}) as file:
        file.write(str(path))
