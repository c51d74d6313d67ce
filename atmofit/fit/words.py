"""Fits in words: a line for each parameter, with its standard error and what to think of it."""

from collections.abc import Iterable, Sequence

from atmofit.typing import Reals


def parameter_lines(
    names: Sequence[str], values: Reals, errors: Reals, notes: Iterable[str]
) -> list[str]:
    """A line for each parameter.

    Args:
        names: Of the parameters.
        values: Of them.
        errors: Standard errors; 0: the value was known.
        notes: What to say after each; empty: nothing.
    """
    lines, width = [], max(len(name) for name in names)
    for name, value, error, note in zip(names, values, errors, notes, strict=True):
        worth = f"± {error:.2g}" if error != 0 else "known"
        lines.append(f"  {name:{width}} {value:9.4g} {worth} {note}".rstrip())
    return lines
