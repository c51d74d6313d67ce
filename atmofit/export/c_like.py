"""C, GLSL and HLSL: one layout, and what the three write differently."""

import dataclasses
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import sympy

from atmofit.export.formulas import Parts, assigned, describe, listed
from atmofit.export.printers import GLSL, HLSL, C
from atmofit.models.sky_model import SkyModel


@dataclasses.dataclass(frozen=True)
class Tokens:
    """What C, GLSL and HLSL write differently."""

    printer: Any
    real: str
    head: str
    constant: str  # of a named list of numbers
    given: str  # an array that a function reads
    filled: str  # an array that a function fills
    function: str  # before functions
    suffix: str = ""


TOKENS = {
    "c": Tokens(
        C({}), "double", "#include <math.h>\n\n",
        "static const double {name}[{size}] = {{\n{numbers}\n}};",
        "const double {name}[{size}]", "double {name}[{size}]", "static inline ",
    ),
    "glsl": Tokens(
        GLSL({}), "float", "",
        "const float {name}[{size}] = float[{size}](\n{numbers}\n);",
        "in float {name}[{size}]", "out float {name}[{size}]", "",
    ),
    "hlsl": Tokens(
        HLSL({}), "float", "",
        "static const float {name}[{size}] = {{\n{numbers}\n}};",
        "in float {name}[{size}]", "out float {name}[{size}]", "",
    ),
}  # fmt: skip


def c_like_code(model: SkyModel, parts: Parts, name: str, tokens: Tokens) -> str:
    """C, GLSL or HLSL."""
    coefficients = np.asarray(model.coefficients)
    channels, n, _ = coefficients.shape
    sizes = {axis: len(basis) for axis, basis in parts.bases.items()}
    numbers, real = channels * n, tokens.real

    def lines(targets: Iterable[str], values: Sequence[sympy.Expr]) -> str:
        done = [
            f"{'' if '[' in target else real + ' '}{target} = {_one_line(tokens, value)};"
            for target, value in assigned(targets, values)
        ]
        return textwrap.indent("\n".join(done), "    ")

    def basis(axis: str) -> str:
        targets = [f"values[{k}]" for k in range(sizes[axis])]
        filled = tokens.filled.format(name="values", size=sizes[axis])
        body = lines(targets, parts.bases[axis])
        return f"{tokens.function}void {name}_basis_{axis}({real} {axis}, {filled})\n{{\n{body}\n}}"

    table = tokens.constant.format(
        name=f"{name}_coefficients", size=coefficients.size, numbers=listed(coefficients.ravel())
    )
    given = tokens.given.format(name="numbers", size=numbers)
    fill = tokens.filled.format(name="numbers", size=numbers)
    values = tokens.filled.format(name="value", size=channels)
    own = "\n".join(
        f"    {real} {each} = numbers[channel*{n} + {k}];"
        for k, each in enumerate(model.shape.names)
    )
    comment = "\n".join(f"// {line}" for line in describe(model))
    return f"""{comment}

{tokens.head}{table}

{basis("t")}

{basis("s")}

{basis("a")}

{tokens.function}void {name}_numbers({real} turbidity, {real} sun, {real} albedo, {fill})
{{
{lines(("t", "s", "a"), parts.coordinates)}
    {real} in_t[{sizes["t"]}];
    {real} in_s[{sizes["s"]}];
    {real} in_a[{sizes["a"]}];
    {name}_basis_t(t, in_t);
    {name}_basis_s(s, in_s);
    {name}_basis_a(a, in_a);
    int place = 0;
    for (int k = 0; k < {numbers}; ++k) {{
        {real} total = 0.0;
        for (int i = 0; i < {sizes["t"]}; ++i)
            for (int j = 0; j < {sizes["s"]}; ++j)
                for (int l = 0; l < {sizes["a"]}; ++l)
                    total += in_t[i]*in_s[j]*in_a[l]*{name}_coefficients[place++];
        numbers[k] = total;
    }}
}}

{tokens.function}{real} {name}_angle({real} view, {real} azimuth, {real} sun)
{{
{lines(("angle",), [parts.angle])}
    return angle;
}}

{tokens.function}{real} {name}_channel({given}, int channel, {real} c, {real} gamma)
{{
{own}
{lines(("value",), [parts.value])}
    return value;
}}

{tokens.function}void {name}_direction({given}, {real} sun, {real} view, {real} azimuth, {values})
{{
    {real} gamma = {name}_angle(view, azimuth, sun);
    for (int channel = 0; channel < {channels}; ++channel)
        value[channel] = {name}_channel(numbers, channel, cos(view), gamma);
}}

{tokens.function}void {name}({real} turbidity, {real} sun, {real} albedo, {real} view, \
{real} azimuth, {values})
{{
    {real} numbers[{numbers}];
    {name}_numbers(turbidity, sun, albedo, numbers);
    {name}_direction(numbers, sun, view, azimuth, value);
}}
"""


def _one_line(tokens: Tokens, value: sympy.Expr) -> str:
    return " ".join(tokens.printer.doprint(value).split())
