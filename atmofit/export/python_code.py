"""Python with its standard library alone."""

import textwrap
from collections.abc import Iterable, Sequence

import numpy as np
import sympy

from atmofit.export.formulas import Parts, assigned, describe, listed
from atmofit.export.printers import Python
from atmofit.models.sky_model import SkyModel


def python_code(model: SkyModel, parts: Parts, name: str) -> str:
    """Python with its standard library alone."""
    printer = Python({"fully_qualified_modules": True})
    coefficients = np.asarray(model.coefficients)
    d = model.dependence

    def lines(targets: Iterable[str], values: Sequence[sympy.Expr]) -> str:
        done = [f"{t} = {printer.doprint(value)}" for t, value in assigned(targets, values)]
        return textwrap.indent("\n".join(done), "    ")

    def basis(axis: str) -> str:
        targets = [f"v_{k}" for k in range(len(parts.bases[axis]))]
        body = lines(targets, parts.bases[axis])
        return f"def _basis_{axis}({axis}):\n{body}\n    return [{', '.join(targets)}]"

    names = ", ".join(model.shape.names)
    comment = "\n".join(describe(model))
    low, high = d.turbidity_range
    return f'''"""{comment}
"""

import math

COEFFICIENTS = [  # [channel][number][turbidity][sun][albedo], flat
{listed(coefficients.ravel())},
]


{basis("t")}


{basis("s")}


{basis("a")}


def {name}_numbers(turbidity, sun, albedo):
    """Numbers of each channel of a sky."""
    for what, value, least, most in (
        ("turbidity", turbidity, {low!r}, {high!r}),
        ("sun", sun, 0.0, math.radians({d.latest_sun_deg!r})),
        ("albedo", albedo, 0.0, {d.largest_albedo!r}),
    ):
        if not least <= value <= most:
            raise ValueError(f"{{what}} must be between {{least}} and {{most}}, got {{value}}")
{lines(("t", "s", "a"), parts.coordinates)}
    basis = [i * j * k for i in _basis_t(t) for j in _basis_s(s) for k in _basis_a(a)]
    size = len(basis)
    totals = [
        sum(b * c for b, c in zip(basis, COEFFICIENTS[k * size : (k + 1) * size]))
        for k in range(len(COEFFICIENTS) // size)
    ]
    n = {len(model.shape.names)}
    return [totals[k : k + n] for k in range(0, len(totals), n)]


def {name}_angle(view, azimuth, sun):
    """Angle from the sun."""
{lines(("angle",), [parts.angle])}
    return angle


def {name}_channel(numbers, c, gamma):
    """One channel of a direction."""
    [{names}] = numbers
{lines(("value",), [parts.value])}
    return value


def {name}_direction(numbers, sun, view, azimuth):
    """All channels of a direction."""
    gamma = {name}_angle(view, azimuth, sun)
    return [{name}_channel(each, math.cos(view), gamma) for each in numbers]


def {name}(turbidity, sun, albedo, view, azimuth):
    """All channels of a direction of a sky."""
    return {name}_direction({name}_numbers(turbidity, sun, albedo), sun, view, azimuth)
'''
