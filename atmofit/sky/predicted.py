"""By how much each way to compute a sky misses it, predicted from a few facts. Python only.

Errors of rungs and of omissions were measured in random skies against fine solutions, and each is
kept as a power law of the facts below times a margin that all but a few of those skies stay under.
`plan_errors.json` beside this module holds them; experiments/plan_errors.py writes it.
"""

import dataclasses
import functools
import json
import math
from importlib import resources
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from atmofit.checks import is_traced
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.medium import optical_properties

_WAVELENGTH_NM = 550.0
_PEAK_DEGREE = 14  # of the Legendre moment that tells how sharp a phase function is
_FAINTEST_HAZE, _FAINTEST_PEAK = 1e-2, 1e-4
_LARGEST_LOGARITHM = 50.0
_THICK = 0.5  # optical depth of a constituent from which light may be turned around often
_LATE_DEG = 88.0  # from here on twilight makes a difference


@dataclasses.dataclass(frozen=True)
class Facts:
    """What the error of a sky depends on, at its worst over suns and views.

    Attributes:
        haze: Vertical optical depth of haze at 550 nm [-].
        absorbers: Likewise of all absorbers, where they absorb most in visible light.
        peak: Share of the scattered light beyond the 14th Legendre moment [-].
        albedo: Of the ground [-].
        sun_deg: Solar zenith angle [degree].
        view_deg: View zenith angle [degree].
    """

    haze: float
    absorbers: float
    peak: float
    albedo: float
    sun_deg: float
    view_deg: float

    def powers(self) -> NDArray[np.float64]:
        """Terms of the power laws."""
        sun, view = (math.log(_airmass(angle)) for angle in (self.sun_deg, self.view_deg))
        haze, peak = math.log(_FAINTEST_HAZE + self.haze), math.log(_FAINTEST_PEAK + self.peak)
        late = max(self.sun_deg - _LATE_DEG, 0.0) / 8
        return np.array([1.0, haze, sun, sun**2, late, peak, self.albedo, view, sun * view])


def facts(atmosphere: Atmosphere, sun_deg: float, view_deg: float) -> Facts:
    """Look at an atmosphere whose values are known.

    Args:
        atmosphere: At least one constituent scatters.
        sun_deg: Largest solar zenith angle [degree].
        view_deg: Largest view zenith angle [degree].

    Raises:
        TypeError: A value is a tracer.
    """
    if is_traced(*jax.tree.leaves(atmosphere)):
        raise TypeError("atmosphere of plan_sky must be known where orders is None, got a tracer")
    with jax.ensure_compile_time_eval():
        medium = optical_properties(atmosphere, jnp.asarray([_WAVELENGTH_NM]))
        depth = np.asarray(medium.extinction)[:, 0]
        moments = np.asarray(medium.moments(_PEAK_DEGREE + 1))[:, _PEAK_DEGREE, 0]
        scattered = float(np.asarray(medium.scattering).sum())
        absorbers = [float(np.max(_values(gas.optical_depth))) for gas in atmosphere.absorbers]
    albedo = 0.0 if atmosphere.ground is None else float(np.max(_values(atmosphere.ground.albedo)))
    return Facts(
        0.0 if atmosphere.haze is None else float(depth[len(medium.phases) - 1]),
        float(sum(absorbers)),
        float(np.maximum(moments, 0.0).sum()) / max(scattered, 1e-30),
        albedo,
        sun_deg,
        view_deg,
    )


def reversals(atmosphere: Atmosphere) -> float:
    """Optical depth of scattering times 1 - mean cosine, at 550 nm [-].

    About how often light is turned around: .1 in clear air, and a white slab of 1.5 passes half.
    0 where it is too little to matter, and where it is not known, under a tracer.
    """
    given = [part.optical_depth for part in (atmosphere.molecules, atmosphere.haze) if part]
    if is_traced(*jax.tree.leaves(atmosphere)):
        return 0.0
    if not any(np.max(_values(depth)) > _THICK for depth in given if depth is not None):
        return 0.0
    with jax.ensure_compile_time_eval():
        medium = optical_properties(atmosphere, jnp.asarray([_WAVELENGTH_NM]))
        moments = np.asarray(medium.moments(2))[:, :, 0]
    return max(float(np.sum(moments[:, 0] - moments[:, 1])), 0.0)


def predicted(what: str, known: Facts) -> float:
    """Relative error of luminance that all but a few skies stay under.

    Args:
        what: A name in the file, such as "rung 0.01", "orders 2", "flat" or "without ground".
        known: About the sky.

    Raises:
        KeyError: It was not measured.
    """
    law = stored()["laws"][what]
    logarithm = min(float(known.powers() @ np.array(law["powers"])), _LARGEST_LOGARITHM)
    return amount(what, known) * math.exp(logarithm) * law["margin"]


def amount(what: str, known: Facts) -> float:
    """Of what is left out, which the error goes with; 1 where nothing is."""
    amounts = {
        "without haze": known.haze,
        "without ground": known.albedo,
        "without absorbers": known.absorbers,
    }
    return amounts.get(what, 1.0)


@functools.cache
def stored() -> dict[str, Any]:
    """The file as it is: the laws, and how, when and on what they were measured."""
    file = resources.files("atmofit.sky") / "plan_errors.json"
    return json.loads(file.read_text(encoding="utf-8"))


def _values(quantity: Any) -> NDArray[np.float64]:
    return np.asarray(getattr(quantity, "values", quantity), float)


def _airmass(zenith_deg: float) -> float:
    """Relative air mass (Kasten and Young 1989, Appl. Opt. 28, 4735), as at the horizon below."""
    z = min(zenith_deg, 90.0)
    return 1 / (math.cos(math.radians(z)) + 0.50572 * (96.07995 - z) ** -1.6364)
