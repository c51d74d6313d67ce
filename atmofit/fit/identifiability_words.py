"""Identifiability of fits in words and as JSON."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from atmofit.fit.identifiability import Identifiability

_MEANINGS = {
    frozenset("A"): "The horizon's brightness at one turbidity trades with that at the other",
    frozenset("AB"): "A and B exchange: a strong gradation that ends low looks like a weaker one "
    "that reaches high",
    frozenset(
        "CD"
    ): "C and D exchange: where D is small, C exp(D gamma) turns into a straight line",
    frozenset("CE"): "C and E exchange: a wide glow looks like cos² gamma",
    frozenset("DE"): "D and E exchange: a wide glow looks like cos² gamma",
    frozenset("CDE"): "C, D and E exchange: a wide glow is a straight line plus cos² gamma",
    frozenset(("A", "scale")): "A and the scale exchange: the horizon's factor is nearly constant, "
    "or so large that only its product with the scale counts",
    frozenset(("A", "B", "scale")): "A, B and the scale exchange: the horizon's factor is nearly "
    "the same over most of the sky",
    frozenset(("C", "scale")): "C and the scale exchange: the glow is nearly constant",
    frozenset(("C", "D", "scale")): "C, D and the scale exchange: the glow is so wide that it "
    "looks like a constant and a straight line",
}
_UNIT = 0.01  # root mean square of the residuals that each parameter of a direction changes


def weakest_direction(found: Identifiability, fit: tuple[int, ...] = ()) -> str:
    """The weakest direction of one fit in words.

    Args:
        found: Of one or many fits.
        fit: Which one; empty for a joint fit.

    Returns:
        The two or three parameters that dominate it, how far each moves, what they change
        together, and what that means where a pair is known.
    """
    direction = np.asarray(found.weakest_direction)[fit]
    norm = np.asarray(found.column_norm)[fit]
    order = np.argsort(-np.abs(direction))
    share = np.cumsum(direction[order] ** 2)
    count = int(np.clip(np.searchsorted(share, 0.85) + 1, 2, 3))
    leading = order[:count]
    moves = [
        f"{found.names[k]} {'up' if direction[k] > 0 else 'down'} by "
        f"{abs(_UNIT * direction[k] / norm[k]):.2g}"
        for k in leading
    ]
    together = float(np.asarray(found.weakest_change)[fit])
    text = (
        f"{moves[0]} with {' and '.join(moves[1:])}: alone each changes the residuals by "
        f"{_percent(np.abs(_UNIT * direction[leading]))}, all together by only "
        f"{100 * _UNIT * together:.2g} %"
    )
    meaning = _MEANINGS.get(frozenset(found.names[k].split(" at ")[0] for k in leading))
    return f"{text}. {meaning}." if meaning else f"{text}."


def _percent(changes: np.ndarray) -> str:
    low, high = 100 * changes.min(), 100 * changes.max()
    return f"{low:.2g} %" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g} %"


def weakest_fit(found: Identifiability) -> tuple[int, ...]:
    """The fit with the largest condition number; empty for a joint fit."""
    conditions = np.asarray(found.condition_number)
    return tuple(int(k) for k in np.unravel_index(conditions.argmax(), conditions.shape))


def interval(found: Identifiability, number: int, fit: tuple[int, ...] = ()) -> str:
    """A profiled parameter of one fit, 0 or 1, with its 95 % interval, in words.

    An interval is open where the loss does not rise enough within ten standard errors.
    """
    k = int(np.asarray(found.profile.parameter)[fit][number])
    value = float(np.asarray(found.estimate)[fit][k])
    low = float(np.asarray(found.profile.lower)[fit][number])
    high = float(np.asarray(found.profile.upper)[fit][number])
    ends = (
        f"{low:.3g}" if np.isfinite(low) else "open",
        f"{high:.3g}" if np.isfinite(high) else "open",
    )
    return f"{found.names[k]} = {value:.3g} ({ends[0]} to {ends[1]})"


def to_dict(found: Mapping[str, Identifiability]) -> dict[str, Any]:
    """Identifiability of fits as numbers, lists and words that JSON can hold; NaN is None."""
    return {name: _fit_to_dict(fit) for name, fit in found.items()}


def _fit_to_dict(found: Identifiability) -> dict[str, Any]:
    worst = weakest_fit(found)
    good = np.asarray(found.good)
    profile = found.profile
    arrays = {
        "estimate": found.estimate,
        "standard_error": found.standard_error,
        "condition_number": found.condition_number,
        "weakest_direction": found.weakest_direction,
        "weakest_change": found.weakest_change,
        "inflation": found.inflation,
        "spread": found.spread,
        "default_relative_loss": found.default,
    }
    return {
        "parameters": list(found.names),
        "linear": found.linear,
        "starts": int(good.shape[-1]),
        "good_starts": float(good.mean()),
        "good_starts_of_the_worst_fit": float(good.mean(axis=-1).min()),
        "good_straight_searches": float(np.asarray(found.straight).mean()),
        "relative_loss": _plain(found.relative_loss),
        **{name: _plain(array) for name, array in arrays.items()},
        "weakest_fit": list(worst),
        "weakest_direction_in_words": weakest_direction(found, worst),
        "profile": {
            "parameter": np.asarray(profile.parameter).tolist(),
            "value": _plain(profile.value),
            "rise": _plain(profile.rise),
            "lower": _plain(profile.lower),
            "upper": _plain(profile.upper),
        },
    }


def _plain(array: Any) -> Any:
    """Nested lists of six digits, None for what is not finite."""
    known = np.asarray(array)
    if known.ndim == 0:
        return float(f"{known:.6g}") if np.isfinite(known) else None
    return [_plain(row) for row in known]
