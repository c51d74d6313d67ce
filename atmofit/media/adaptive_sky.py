"""A sky pixel by pixel as Klassen (1987) saved time: adaptive Simpson, and reuse of integrals.

Plain NumPy on the host, one line of sight after the other, and counted: the thing that
`media.sky_reconstruction` is compared with. The pixels are scanned row by row. Where the angles
have changed so little since the last integral that the screen would not show it, that integral
serves again. The paper has one threshold for the whole sky; ours is the change that a screen shows,
so that it widens where the sky is even. The phase function is exact in every pixel.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from atmofit.checks import in_range
from atmofit.media.two_layers import TwoLayers

# Largest slope of a value of sRGB by the logarithm of light, behind 1 - exp(-light).
_SHOWN_PER_LOG = 0.235
_LADDER = 65  # angles at which the change of the integral is known beforehand
_DEEPEST = 14  # halvings of an interval
_STEP = 1e-3  # [-], of the cosine toward the sun, for its slope

Spectrum = Float[np.ndarray, " w"]


@dataclasses.dataclass
class AdaptiveSky:
    """Integrals of a picture, and what they cost.

    Attributes:
        integral: Of the transmittance to sun and eye [m], [pixel, wavelength].
        integrals: Lines of sight that were integrated.
        evaluations: Of the integrand, each at all wavelengths, the plan's own included.
    """

    integral: Float[np.ndarray, "pixel w"]
    integrals: int
    evaluations: int


class _Lines:
    """Integrals along lines of sight, and a count of evaluations."""

    def __init__(self, layers: TwoLayers, solar_zenith_angle: float, rtol: float) -> None:
        self.radius = float(layers.radius)
        self.top, self.air = float(layers.haze_top), float(layers.air_top)
        self.molecules = np.asarray(layers.molecular_extinction, float)
        self.haze = np.asarray(layers.haze_extinction, float)
        self.sun_up, self.rtol = math.cos(solar_zenith_angle), rtol
        self.evaluations = 0

    def whole(self, up: float) -> float:
        """Way from the ground to the end of the haze [m], by the sine of its elevation."""
        return _to_shell(self.radius, self.top, up)

    def integral(self, up: float, toward: float) -> Spectrum:
        """By adaptive Simpson, until all wavelengths agree."""
        way = self.whole(up)

        # Squaring crowds the points to the eye's end, where thick haze has all its light.
        def integrand(x: float) -> Spectrum:
            return 2 * x * way * self._light(x * x * way, up, toward)

        return _simpson(integrand, self.rtol)

    def _light(self, way: float, up: float, toward: float) -> Spectrum:
        self.evaluations += 1
        rise = way * (way + 2 * self.radius * up)
        altitude = min(rise / (math.sqrt(self.radius**2 + rise) + self.radius), self.top)
        here = self.radius + altitude
        sine = (self.radius * self.sun_up + way * toward) / here
        in_haze = _to_shell(here, self.top - altitude, sine)
        at_top = (here * sine + in_haze) / (self.radius + self.top)
        above = _to_shell(self.radius + self.top, self.air - self.top, at_top)
        through = in_haze + way
        return np.exp(-self.molecules * (above + through) - self.haze * through)


def _to_shell(radius: float, height: float, sine: float) -> float:
    """Way from a sphere to a concentric one above it [m]."""
    difference, up = height * (2 * radius + height), radius * sine
    root = math.sqrt(max(difference + up * up, 0.0))
    if up < 0:
        return root - up
    return difference / (root + up) if root + up > 0 else 0.0


def _simpson(integrand: Callable[[float], Spectrum], rtol: float) -> Spectrum:
    """Adaptive Simpson over 0 to 1; intervals wait in a list, not on Python's own stack."""
    ends = [integrand(x) for x in (0.0, 0.5, 1.0)]
    first = _rule(1.0, *ends)
    allowed = rtol * np.maximum(np.abs(first), 1e-30)
    waiting = [(0.0, 1.0, *ends, first, 0)]
    total = np.zeros_like(first)
    while waiting:
        low, high, a, b, c, coarse, depth = waiting.pop()
        width, middle = high - low, (low + high) / 2
        left, right = integrand(low + width / 4), integrand(high - width / 4)
        halves = _rule(width / 2, a, left, b), _rule(width / 2, b, right, c)
        change = halves[0] + halves[1] - coarse
        # A first look of four intervals, so that a peak between three points is not missed.
        done = depth > 0 and np.all(np.abs(change) <= 15 * allowed * width)
        if done or depth >= _DEEPEST:
            total = total + halves[0] + halves[1] + change / 15
        else:
            waiting.append((low, middle, a, left, b, halves[0], depth + 1))
            waiting.append((middle, high, b, right, c, halves[1], depth + 1))
    return total


def _rule(width: float, a: Spectrum, b: Spectrum, c: Spectrum) -> Spectrum:
    return width / 6 * (a + 4 * b + c)


def adaptive_sky(
    layers: TwoLayers,
    solar_zenith_angle: float,
    view_zenith_angle: Float[np.ndarray, " pixel"],
    relative_azimuth: Float[np.ndarray, " pixel"],
    *,
    bits: float | None = 8.0,
    rtol: float = 1e-4,
) -> AdaptiveSky:
    """Integrals along all lines of sight of a picture, exact geometry, reusing the last.

    Args:
        layers: Haze and air.
        solar_zenith_angle: 0 to pi/2 [rad].
        view_zenith_angle: Row by row [rad], 0 to pi/2.
        relative_azimuth: 0 toward the sun [rad].
        bits: Of the screen: an integral is reused while a shown value can have changed by less
            than half a step of it, 2 to 16. None: every line is integrated.
        rtol: Of the quadrature, 1e-12 to 0.1.

    Raises:
        ValueError: A number is out of range.
    """
    in_range("solar_zenith_angle", solar_zenith_angle, 0.0, math.pi / 2, "rad", slack=1e-6)
    in_range("view_zenith_angle", view_zenith_angle, 0.0, math.pi / 2, "rad", slack=1e-6)
    in_range("rtol", rtol, 1e-12, 0.1)
    lines = _Lines(layers, solar_zenith_angle, rtol)
    up = np.maximum(np.cos(view_zenith_angle), 0.0)
    level = np.sin(view_zenith_angle) * np.cos(relative_azimuth)
    toward = up * lines.sun_up + level * math.sin(solar_zenith_angle)
    if bits is None:
        shown, slope, allowed = up, np.zeros_like(up), -1.0
    else:
        in_range("bits", bits, 2.0, 16.0)
        shown, slope = _changes(lines, solar_zenith_angle, up)
        allowed = 0.5 / (2**bits - 1)
    return _scan(lines, up, toward, shown, slope, allowed)


def _scan(
    lines: _Lines,
    up: np.ndarray,
    toward: np.ndarray,
    shown: np.ndarray,
    slope: np.ndarray,
    allowed: float,
) -> AdaptiveSky:
    """Pixel after pixel."""
    found, last, count = np.empty((up.size, lines.haze.size)), None, 0
    value = np.zeros(lines.haze.size)
    for pixel, now in enumerate(zip(up, toward, shown, slope, strict=True)):
        if last is None or (
            abs(now[2] - last[2]) + max(now[3], last[3]) * abs(now[1] - last[1]) > allowed
        ):
            value, last, count = lines.integral(float(now[0]), float(now[1])), now, count + 1
        found[pixel] = value
    return AdaptiveSky(found, count, lines.evaluations)


def _changes(lines: _Lines, sun: float, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a screen shows of a change of the line's elevation, summed from level, and per cosine.

    Both are known at some elevations, spaced as the way through the haze changes, for light from
    before, beside and behind; the largest counts.
    """
    scale = math.sqrt(2 * lines.top / lines.radius)
    ladder = scale * np.sinh(np.linspace(0.0, math.asinh(1 / scale), _LADDER))
    ladder[-1] = 1.0
    level = np.sqrt(np.maximum(1 - ladder**2, 0.0)) * math.sin(sun)
    logs, slopes = [], []
    for side in (1.0, 0.0, -1.0):
        toward = ladder * lines.sun_up + side * level
        here, beside = (
            np.log([lines.integral(s, t) + 1e-300 for s, t in zip(ladder, cosines, strict=True)])
            for cosines in (toward, toward - math.copysign(_STEP, side or 1.0))
        )
        logs.append(here)
        slopes.append(np.abs(beside - here).max(axis=1) / _STEP)
    steps = np.abs(np.diff(logs, axis=1)).max(axis=(0, 2))
    summed = np.concatenate([[0.0], np.cumsum(steps)])
    shown = _SHOWN_PER_LOG * np.interp(up, ladder, summed)
    return shown, _SHOWN_PER_LOG * np.interp(up, ladder, np.max(slopes, axis=0))
