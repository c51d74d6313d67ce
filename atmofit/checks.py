"""Input checks: an error for values that are known, NaN for values that are traced."""

import contextlib
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from atmofit.typing import Reals, RealsLike, real_array

_ANGLE_SLACK = 1e-6  # [rad]; the float32 nearest to pi / 2 lies above it
_debug = False


@contextlib.contextmanager
def debug_checks() -> Iterator[None]:
    """Inside this context, traced values outside a function's domain raise at run time.

    Programs compiled outside the context keep returning NaN; those compiled inside it are not
    kept in JAX's persistent compilation cache.
    """
    global _debug
    before, _debug = _debug, True
    try:
        yield
    finally:
        _debug = before


def is_traced(*values: object) -> bool:
    """Whether any leaf is a JAX tracer, that is, has no value yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def in_range(
    name: str, value: RealsLike, low: float, high: float, unit: str = "", *, slack: float = 0.0
) -> Reals:
    """Return the value as an array if it lies in [low, high].

    Args:
        name: Name of the argument, for the message.
        value: Any shape. NaN is outside every range.
        low: Smallest allowed value.
        high: Largest allowed value; infinity itself is never allowed.
        unit: Unit, for the message.
        slack: How far beyond the limits rounding may put a value.

    Returns:
        The value as a floating-point array. A traced value is NaN where it lies outside.

    Raises:
        ValueError: A known value lies outside.
    """
    if not is_traced(value):
        refuse_beyond(name, value, low, high, unit, slack=slack)
        return real_array(value)
    array = real_array(value)
    inside = (array >= low - slack) & (array <= high + slack) & jnp.isfinite(array)
    if _debug:
        return eqx.error_if(array, ~inside, f"{name} must be {_allowed(low, high, unit)}")
    return jnp.where(inside, array, jnp.nan)


def refuse_beyond(
    name: str, value: RealsLike, low: float, high: float, unit: str = "", *, slack: float = 0.0
) -> None:
    """Like `in_range` for a known value, without JAX: also for what is made on import.

    Raises:
        ValueError: It lies outside.
    """
    given = np.asarray(value)
    known = given.astype(float)
    # In the value's own precision, so that the float32 nearest to a limit lies inside.
    kind = given.dtype if given.dtype.kind == "f" else known.dtype
    least, most = (float(np.asarray(end, kind)) for end in (low - slack, high + slack))
    bad = ~((known >= least) & (known <= most) & np.isfinite(known))
    if bad.any():
        worst = known[bad].flat[0]
        raise ValueError(
            f"{name} must be {_allowed(low, high, unit)}, got {worst:.6g}"
            + (f" ({bad.sum()} of {known.size} values)" if known.size > 1 else "")
        )


def angle_in_range(name: str, value: RealsLike, low: float, high: float) -> Reals:
    """Like `in_range` for an angle [rad], with room for the rounding of float32."""
    return in_range(name, value, low, high, "rad", slack=_ANGLE_SLACK)


def _allowed(low: float, high: float, unit: str) -> str:
    unit = f" {unit}" if unit else ""
    if np.isinf(high):
        return f"at least {low:.6g}{unit}" if np.isfinite(low) else "finite"
    return f"between {low:.6g} and {high:.6g}{unit}"


def choice(name: str, value: str, allowed: tuple[str, ...]) -> str:
    """Return the value if it is one of the allowed words, else raise ValueError."""
    if value not in allowed:
        words = ", ".join(f'"{word}"' for word in allowed)
        raise ValueError(f"{name} must be one of {words}, got {value!r}")
    return value
