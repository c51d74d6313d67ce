"""From luminances of any size to what a screen shows."""

from typing import Any

import numpy as np

from atmofit.colour import XYZ_to_linear_sRGB, linear_sRGB_to_sRGB, xyY_to_XYZ


def on_film(xyY: Any, white_luminance: float) -> np.ndarray:
    """Colours as a film that saturates shows them.

    A luminance Y becomes 1 - exp(-Y / white luminance) and keeps its chromaticity; colours outside
    the gamut are clipped, channel by channel.

    Args:
        xyY: x, y and Y [cd m^-2] on a last axis.
        white_luminance: The exposure [cd m^-2]: this luminance is shown as 63 % of the screen's.

    Returns:
        Red, green and blue of sRGB, 0 to 1, on a last axis.

    Raises:
        ValueError: The exposure is not positive.
    """
    if not 0 < white_luminance < np.inf:
        raise ValueError(f"white_luminance must be positive, got {white_luminance}")
    colours = np.array(xyY, float)
    colours[..., 2] = -np.expm1(-colours[..., 2] / white_luminance)
    linear = np.asarray(XYZ_to_linear_sRGB(xyY_to_XYZ(colours)))
    return np.asarray(linear_sRGB_to_sRGB(np.clip(linear, 0, 1)))
