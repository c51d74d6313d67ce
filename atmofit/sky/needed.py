"""What a scene needs within a tolerance, chosen by predicted errors. Python only."""

import dataclasses

from atmofit.optics.atmosphere import Atmosphere
from atmofit.sky.ladder import LADDER
from atmofit.sky.luminance import COUNTS
from atmofit.sky.predicted import Facts, predicted

_QUADRATURE = 0.6  # share of the tolerance that the rung may take
_OMISSION = 0.5  # share of what is then left that an omission may take
_FLAT_TO_DEG = 90.0  # a flat atmosphere knows no later sun
_ROUNDING_FROM = 1e-3  # rungs finer than this are computed in float64


@dataclasses.dataclass(frozen=True)
class Needed:
    """How a scene is computed, and what that is predicted to cost.

    Attributes:
        rung: Of the ladder.
        orders: Scattering orders, or "all".
        geometry: In place of the atmosphere's, or None.
        without: Constituents left out.
        wavelengths: Rung whose few wavelengths are interpolated, or None: none is.
        luminance_nodes: Wavelengths for luminance alone, 0: all.
        dtype: "float32" or "float64".
        errors: What is done, and its predicted relative error of luminance.
    """

    rung: float
    orders: int | str
    geometry: str | None = None
    without: tuple[str, ...] = ()
    wavelengths: float | None = None
    luminance_nodes: int = 0
    dtype: str = "float64"
    errors: tuple[tuple[str, float], ...] = ()


def needed(atmosphere: Atmosphere, known: Facts, rtol: float, quantity: str) -> Needed:
    """The cheapest way whose predicted errors stay within a tolerance.

    Args:
        atmosphere: What exists.
        known: About it, the suns and the views.
        rtol: Tolerance.
        quantity: "spectrum", "luminance" or "sun".

    Returns:
        The choice; where even the finest rung is predicted to miss the tolerance, that rung.
    """
    coarse_first = sorted(LADDER, reverse=True)
    enough = (r for r in coarse_first if _of_rung(r, known) <= _QUADRATURE * rtol)
    rung = next(enough, min(LADDER))
    errors = [("quadrature", _of_rung(rung, known))]
    left = rtol - errors[0][1]

    def affordable(what: str) -> bool:
        nonlocal left
        error = predicted(what, known)
        if error > _OMISSION * left:
            return False
        errors.append((what, error))
        left -= error
        return True

    wavelengths, luminance_nodes = None, 0
    if quantity == "spectrum" and _is_smooth(atmosphere):
        wavelengths = next((r for r in coarse_first if affordable(f"wavelengths {r:g}")), None)
    if quantity == "luminance" and atmosphere.is_smooth:
        counts = (COUNTS[r] for r in coarse_first)
        luminance_nodes = next((n for n in counts if affordable(f"luminance {n}")), 0)
    present = [name for name in ("absorbers", "ground", "haze") if getattr(atmosphere, name)]
    if atmosphere.molecules is None and "haze" in present:
        present.remove("haze")
    without = tuple(name for name in present if affordable(f"without {name}"))
    geometry = None
    if atmosphere.geometry == "spherical":
        simpler = ["flat"] * (known.sun_deg < _FLAT_TO_DEG) + ["pseudo-spherical"]
        geometry = next((name for name in simpler if affordable(name)), None)
    orders = next((n for n in (1, 2) if affordable(f"orders {n}")), "all")
    dtype = "float32" if rung > _ROUNDING_FROM else "float64"
    return Needed(
        rung, orders, geometry, without, wavelengths, luminance_nodes, dtype, tuple(errors)
    )


def _of_rung(rung: float, known: Facts) -> float:
    return predicted(f"rung {rung:g}", known)


def _is_smooth(atmosphere: Atmosphere) -> bool:
    """Whether all but absorbers and ground are smooth in wavelength."""
    parts = [part for part in (atmosphere.molecules, atmosphere.haze) if part is not None]
    return all(part.is_smooth for part in parts)
