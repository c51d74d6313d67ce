"""A sky model as self-contained source code: C, GLSL, HLSL or Python.

All four come from the same expressions, which are read off the model's own program. C, GLSL and
HLSL share one layout, and differ in what the languages write otherwise.
"""

import dataclasses
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import sympy
from sympy.logic.boolalg import Boolean
from sympy.printing.c import C99CodePrinter
from sympy.printing.glsl import GLSLPrinter
from sympy.printing.pycode import PythonCodePrinter

from atmofit.checks import choice
from atmofit.export.expressions import expressions
from atmofit.geometry import scattering_angle
from atmofit.models.sky_model import COLOURS, SkyModel

LANGUAGES = ("c", "glsl", "hlsl", "python")
_LONGEST_POWER = 8


def source_code(model: SkyModel, language: str, name: str = "atmofit_2026") -> str:
    """The model as source code that needs nothing else.

    The code holds the coefficients, a function that makes a sky's numbers from turbidity, sun and
    albedo (once per sky), and one that makes the channels of a direction from them.

    Args:
        model: With colours, spectral channels, or both; those it has are exported, in its order.
        language: "c" (C99, double precision), "glsl" (3.30 or newer), "hlsl" or "python".
        name: Of the main function, and before all other names.

    Returns:
        The text of a file.

    Raises:
        ValueError: An unknown language, or a name that is no identifier.
    """
    choice("language", language, LANGUAGES)
    if not name.isidentifier():
        raise ValueError(f"name must be an identifier, got {name!r}")
    parts = _Parts.of(model)
    if language == "python":
        return _python(model, parts, name)
    return _braces(model, parts, name, _TOKENS[language])


@dataclasses.dataclass(frozen=True)
class _Parts:
    """The expressions of a model.

    Attributes:
        coordinates: Of turbidity, sun and albedo, in "turbidity", "sun" and "albedo".
        bases: Values of each basis, in "t", "s" and "a".
        angle: From the sun, in "view", "azimuth" and "sun".
        value: In "c" (the cosine of the view zenith angle), "gamma" and the shape's numbers.
    """

    coordinates: list[sympy.Expr]
    bases: dict[str, list[sympy.Expr]]
    angle: sympy.Expr
    value: sympy.Expr

    @staticmethod
    def of(model: SkyModel) -> "_Parts":
        d, shape = model.dependence, model.shape
        return _Parts(
            expressions(
                lambda T, s, a: jnp.stack(d.coordinates(T, s, a)), ("turbidity", "sun", "albedo")
            ),
            {
                axis: expressions(basis, (axis,))
                for axis, basis in (("t", d.turbidity), ("s", d.sun), ("a", d.albedo))
            },
            expressions(scattering_angle, ("view", "azimuth", "sun"))[0],
            expressions(lambda c, γ, *n: shape(jnp.stack(n), c, γ), ("c", "gamma", *shape.names))[
                0
            ],
        )


def channel_names(model: SkyModel) -> list[str]:
    """What the channels are, in order."""
    spectral = [f"radiance over solar irradiance at {λ:g} nm [1/sr]" for λ in model.wavelength_nm]
    return spectral + [f"{c} [cd/m^2]" for c in COLOURS if model.colours]


class _Products:
    """Powers with whole exponents as products: pow() of a negative base is undefined in shaders."""

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        base, exponent = expr.as_base_exp()
        double = 2 * exponent
        if not double.is_Integer or abs(double) > 2 * _LONGEST_POWER:
            return super()._print_Pow(expr)  # pyright: ignore
        text = f"({self._print(base)})"  # pyright: ignore
        factors = [text] * (abs(int(double)) // 2)
        if int(double) % 2:
            factors.append(f"{self.root}{text}")  # pyright: ignore
        product = "*".join(factors)
        return f"({product})" if exponent > 0 else f"({self.one}/({product}))"  # pyright: ignore

    def _nested(self, function: str, arguments: Sequence[Any]) -> str:
        first, *rest = (self._print(each) for each in arguments)  # pyright: ignore
        for each in rest:
            first = f"{function}({first}, {each})"
        return first


class _C(_Products, C99CodePrinter):
    root, one = "sqrt", "1.0"

    def _print_Max(self, expr: Any) -> str:
        return self._nested("fmax", expr.args)

    def _print_Min(self, expr: Any) -> str:
        return self._nested("fmin", expr.args)


class _GLSL(_Products, GLSLPrinter):
    root, one = "sqrt", "1.0"
    arctangent = "atan"

    def _print_Max(self, expr: Any) -> str:
        return self._nested("max", expr.args)

    def _print_Min(self, expr: Any) -> str:
        return self._nested("min", expr.args)

    def _print_Abs(self, expr: Any) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _print_atan2(self, expr: Any) -> str:
        return f"{self.arctangent}({', '.join(self._print(each) for each in expr.args)})"

    def _print_Integer(self, expr: Any) -> str:
        return f"{int(expr)}.0"  # whole numbers and fractions do not mix with floats everywhere

    def _print_int(self, expr: int) -> str:
        return f"{expr}.0"


class _HLSL(_GLSL):
    arctangent = "atan2"


class _Python(_Products, PythonCodePrinter):
    root, one = "math.sqrt", "1.0"


@dataclasses.dataclass(frozen=True)
class _Tokens:
    """What C, GLSL and HLSL write differently."""

    printer: Any
    real: str
    head: str
    constant: str  # of a named list of numbers
    given: str  # an array that a function reads
    filled: str  # an array that a function fills
    function: str  # before functions
    suffix: str = ""


_TOKENS = {
    "c": _Tokens(
        _C({}), "double", "#include <math.h>\n\n",
        "static const double {name}[{size}] = {{\n{numbers}\n}};",
        "const double {name}[{size}]", "double {name}[{size}]", "static inline ",
    ),
    "glsl": _Tokens(
        _GLSL({}), "float", "",
        "const float {name}[{size}] = float[{size}](\n{numbers}\n);",
        "in float {name}[{size}]", "out float {name}[{size}]", "",
    ),
    "hlsl": _Tokens(
        _HLSL({}), "float", "",
        "static const float {name}[{size}] = {{\n{numbers}\n}};",
        "in float {name}[{size}]", "out float {name}[{size}]", "",
    ),
}  # fmt: skip


def _describe(model: SkyModel) -> list[str]:
    """What has to be known to use the code."""
    d = model.dependence
    low, high = d.turbidity_range
    channels = "; ".join(f"{k}: {name}" for k, name in enumerate(channel_names(model)))
    return textwrap.wrap(
        f"A sky model exported by atmofit. Valid for turbidity {low:g} to {high:g}, solar zenith "
        f"angle 0 to {d.latest_sun_deg:g} degrees, ground albedo 0 to {d.largest_albedo:g} and "
        "directions on or above the horizon; outside it means nothing. Angles in radians: view is "
        "the zenith angle of the direction, azimuth is relative to the sun's. Numbers are made "
        f"once per sky. Channels: {channels}.",
        96,
    )


def _assigned(targets: Iterable[str], values: Sequence[sympy.Expr]) -> list[tuple[str, Any]]:
    """Assignments that compute what is common to the expressions once."""
    found: Any = sympy.cse(values, symbols=sympy.numbered_symbols("x_"))
    shared, reduced = found
    # Conditions go back to where they are used: they are no numbers.
    conditions = {symbol: value for symbol, value in shared if isinstance(value, Boolean)}
    named = [(str(x), v.xreplace(conditions)) for x, v in shared if x not in conditions]
    return named + list(zip(targets, (v.xreplace(conditions) for v in reduced), strict=True))


def _braces(model: SkyModel, parts: _Parts, name: str, tokens: _Tokens) -> str:
    """C, GLSL or HLSL."""
    coefficients = np.asarray(model.coefficients)
    channels, n, _ = coefficients.shape
    sizes = {axis: len(basis) for axis, basis in parts.bases.items()}
    numbers, real = channels * n, tokens.real

    def lines(targets: Iterable[str], values: Sequence[sympy.Expr]) -> str:
        done = [
            f"{'' if '[' in target else real + ' '}{target} = {_one_line(tokens, value)};"
            for target, value in _assigned(targets, values)
        ]
        return textwrap.indent("\n".join(done), "    ")

    def basis(axis: str) -> str:
        targets = [f"values[{k}]" for k in range(sizes[axis])]
        filled = tokens.filled.format(name="values", size=sizes[axis])
        body = lines(targets, parts.bases[axis])
        return f"{tokens.function}void {name}_basis_{axis}({real} {axis}, {filled})\n{{\n{body}\n}}"

    listed = tokens.constant.format(
        name=f"{name}_coefficients", size=coefficients.size, numbers=_listed(coefficients.ravel())
    )
    given = tokens.given.format(name="numbers", size=numbers)
    fill = tokens.filled.format(name="numbers", size=numbers)
    values = tokens.filled.format(name="value", size=channels)
    own = "\n".join(
        f"    {real} {each} = numbers[channel*{n} + {k}];"
        for k, each in enumerate(model.shape.names)
    )
    comment = "\n".join(f"// {line}" for line in _describe(model))
    return f"""{comment}

{tokens.head}{listed}

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


def _one_line(tokens: _Tokens, value: sympy.Expr) -> str:
    return " ".join(tokens.printer.doprint(value).split())


def _listed(numbers: np.ndarray, indent: str = "    ") -> str:
    """Numbers with nine digits, which hold single precision, in lines."""
    texts = [_literal(float(value)) for value in numbers]
    rows = [", ".join(texts[k : k + 7]) for k in range(0, len(texts), 7)]
    return ",\n".join(indent + row for row in rows)


def _literal(value: float) -> str:
    text = f"{value:.9g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _python(model: SkyModel, parts: _Parts, name: str) -> str:
    """Python with its standard library alone."""
    printer = _Python({"fully_qualified_modules": True})
    coefficients = np.asarray(model.coefficients)
    d = model.dependence

    def lines(targets: Iterable[str], values: Sequence[sympy.Expr]) -> str:
        done = [f"{t} = {printer.doprint(value)}" for t, value in _assigned(targets, values)]
        return textwrap.indent("\n".join(done), "    ")

    def basis(axis: str) -> str:
        targets = [f"v_{k}" for k in range(len(parts.bases[axis]))]
        body = lines(targets, parts.bases[axis])
        return f"def _basis_{axis}({axis}):\n{body}\n    return [{', '.join(targets)}]"

    names = ", ".join(model.shape.names)
    comment = "\n".join(_describe(model))
    low, high = d.turbidity_range
    return f'''"""{comment}
"""

import math

COEFFICIENTS = [  # [channel][number][turbidity][sun][albedo], flat
{_listed(coefficients.ravel())},
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
