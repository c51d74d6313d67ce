"""Pictures of landscapes as files."""

import io
from pathlib import Path

import numpy as np

from atmofit.colour import XYZ_to_linear_sRGB, XYZ_to_xyY
from atmofit.io import replace_file
from atmofit.landscape.picture import Picture
from atmofit.render.film import on_film
from atmofit.render.image import save_bytes


def typical_luminance(picture: Picture) -> float:
    """An exposure that shows most of a picture [cd m^-2]: its 80th percentile of luminance."""
    return float(np.percentile(np.asarray(picture.XYZ)[..., 1], 80.0))


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
