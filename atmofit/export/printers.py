"""How each language writes expressions: sympy's printers, with powers as products."""

from collections.abc import Sequence
from typing import Any

from sympy.printing.c import C99CodePrinter
from sympy.printing.glsl import GLSLPrinter
from sympy.printing.pycode import PythonCodePrinter

_LONGEST_POWER = 8


class Products:
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


class C(Products, C99CodePrinter):
    """C99."""

    root, one = "sqrt", "1.0"

    def _print_Max(self, expr: Any) -> str:
        return self._nested("fmax", expr.args)

    def _print_Min(self, expr: Any) -> str:
        return self._nested("fmin", expr.args)


class GLSL(Products, GLSLPrinter):
    """GLSL, whose whole numbers are written as floats."""

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


class HLSL(GLSL):
    """HLSL, which differs in one name."""

    arctangent = "atan2"


class Python(Products, PythonCodePrinter):
    """Python with its module math."""

    root, one = "math.sqrt", "1.0"
