"""The ladder of accuracy: node counts of each rung, stored with what was measured of them.

`ladder.json` beside this module holds both; experiments/error_vs_runtime.py writes it.
"""

import dataclasses
import functools
import json
from importlib import resources
from types import MappingProxyType
from typing import Any


@dataclasses.dataclass(frozen=True)
class Nodes:
    """Node counts of one rung of the ladder.

    Attributes:
        view: Along the line of sight for the first order.
        view_second: Along the line of sight for the second order.
        altitude: Altitudes at which the single-scattered light is known.
        sun: Local solar zenith angles at which it is known.
        polar: Directions from the horizon to the zenith, and to the nadir.
        limb: Directions between the level and the ground's horizon.
        azimuth: Azimuths on the half circle.
        bend: Azimuths at which the curvature of the planet is followed (1 in a flat one).
        path: Along each of these directions.
        degrees: Legendre moments and azimuth modes of the single-scattered light.
        higher_modes: Azimuth modes of the light of order 2 and above.
        higher_degrees: Legendre moments of it.
        streams: Rays that meet the ground, along which light of order 2 and above is carried.
        steps: Orders above the first two that are computed before the rest is added.
        wavelength: Wavelengths between which log radiance is interpolated; 0: all that are asked.
        rough: Wavelengths between which the effect of absorbers and of a coloured ground is.
    """

    view: int
    view_second: int
    altitude: int
    sun: int
    polar: int
    limb: int
    azimuth: int
    bend: int
    path: int
    degrees: int
    higher_modes: int
    higher_degrees: int
    streams: int
    steps: int
    wavelength: int
    rough: int


@dataclasses.dataclass(frozen=True)
class Measured:
    """What a rung was measured to do.

    Errors are relative, of luminance, two orders, against nested quadrature that shares no code
    with the simulator. Seconds and memory are those of the reference job: 12 suns x 5 turbidities x
    343 directions x 41 wavelengths.

    Attributes:
        reference_largest: Over sun 0, 60, 85 degrees x turbidity 2, 6 x 9 directions.
        reference_rms: Root mean square over the same.
        random_largest: Over random skies, turbidity 1 to 8, sun 0 to 88 degrees.
        random_rms: Root mean square over the same.
        compile_seconds: Trace and compilation.
        first_seconds: First call after it.
        hot_seconds: Median of the calls after that.
        peak_megabytes: Peak memory of the process.
    """

    reference_largest: float
    reference_rms: float
    random_largest: float
    random_rms: float
    compile_seconds: float
    first_seconds: float
    hot_seconds: float
    peak_megabytes: int

    @property
    def largest(self) -> float:
        """The largest error met in any sky."""
        return max(self.reference_largest, self.random_largest)


@functools.cache
def stored() -> dict[str, Any]:
    """The file as it is: the rungs, and how, when and on what they were measured."""
    file = resources.files("atmofit.sky") / "ladder.json"
    return json.loads(file.read_text(encoding="utf-8"))


def measured(rtol: float, dtype: str) -> Measured:
    """What a rung was measured to do in "float32" or "float64".

    Raises:
        KeyError: There is no such rung or dtype.
    """
    for rung in stored()["rungs"]:
        if rung["rtol"] == rtol and dtype in rung["measured"]:
            return Measured(**rung["measured"][dtype])
    raise KeyError(f"no rung of the ladder has rtol {rtol:g}, {dtype}")


LADDER = MappingProxyType({rung["rtol"]: Nodes(**rung["nodes"]) for rung in stored()["rungs"]})
