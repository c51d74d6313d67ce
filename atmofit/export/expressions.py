"""The formulas of a model as symbols, read off the very program that JAX runs.

A JAX function of scalars is traced, and its program is carried out on symbols instead of numbers.
So whatever shape or dependence a model has, the exported formulas are those that were fitted.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.extend.core
import numpy as np
import sympy

Symbols = np.ndarray  # of sympy expressions


def expressions(function: Callable[..., Any], names: Sequence[str]) -> list[sympy.Expr]:
    """What a function of scalars computes, as expressions in symbols of the given names.

    Args:
        function: Of as many scalars as there are names; returns a scalar or an array.
        names: Of the symbols.

    Returns:
        One expression for each number that the function returns.

    Raises:
        NotImplementedError: The program does something that has no symbol here.
    """
    with jax.enable_x64(True):
        closed = jax.make_jaxpr(function)(*(1.0 for _ in names))
    symbols = [_array(sympy.Symbol(name, real=True)) for name in names]
    results = _evaluate(closed.jaxpr, closed.consts, symbols)
    return [entry for result in results for entry in result.ravel()]


def _array(value: Any) -> Symbols:
    """Numbers or expressions as an array of expressions."""
    given = np.asarray(value)
    array = np.empty(given.shape, object)
    for index in np.ndindex(given.shape):
        array[index] = sympy.sympify(given[index].item() if given.dtype != object else given[index])
    return array


def _evaluate(jaxpr: Any, constants: Sequence[Any], arguments: Sequence[Symbols]) -> list[Symbols]:
    """Carry a program out."""
    known: dict[Any, Symbols] = {}

    def value(atom: Any) -> Symbols:
        return _array(atom.val) if isinstance(atom, jax.extend.core.Literal) else known[atom]

    known.update(zip(jaxpr.constvars, map(_array, constants), strict=True))
    known.update(zip(jaxpr.invars, arguments, strict=True))
    for equation in jaxpr.eqns:
        given = [value(atom) for atom in equation.invars]
        name, parameters = equation.primitive.name, equation.params
        inner = parameters.get("jaxpr") or parameters.get("call_jaxpr")
        if inner is not None:
            results = _evaluate(inner.jaxpr, inner.consts, given)
        elif name in _ELEMENTWISE:
            results = [_each(_ELEMENTWISE[name], *given)]
        elif name in _STRUCTURAL:
            results = [_STRUCTURAL[name](given, parameters)]
        else:
            raise NotImplementedError(f"no symbol for what JAX calls {name}")
        known.update(zip(equation.outvars, results, strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def _each(function: Callable[..., Any], *arrays: Symbols) -> Symbols:
    """Apply a function to every entry."""
    shape = np.broadcast_shapes(*(array.shape for array in arrays))
    wide = [np.broadcast_to(array, shape) for array in arrays]
    result = np.empty(shape, object)
    for index in np.ndindex(shape):
        result[index] = function(*(array[index] for array in wide))
    return result


def _broadcast(given: list[Symbols], parameters: dict[str, Any]) -> Symbols:
    shape, places = parameters["shape"], parameters["broadcast_dimensions"]
    sizes = [1] * len(shape)
    for axis, place in enumerate(places):
        sizes[place] = given[0].shape[axis]
    return np.broadcast_to(given[0].reshape(sizes), shape)


def _slice(given: list[Symbols], parameters: dict[str, Any]) -> Symbols:
    steps = parameters["strides"] or (1,) * given[0].ndim
    bounds = zip(parameters["start_indices"], parameters["limit_indices"], steps, strict=True)
    return given[0][tuple(slice(*each) for each in bounds)]


def _squeeze(given: list[Symbols], parameters: dict[str, Any]) -> Symbols:
    return np.squeeze(given[0], axis=tuple(parameters["dimensions"]))


def _sum(given: list[Symbols], parameters: dict[str, Any]) -> Symbols:
    total = np.sum(given[0], axis=tuple(parameters["axes"]))
    return total if isinstance(total, np.ndarray) else _array(total)


def _select(which: Any, *cases: Any) -> Any:
    return sympy.Piecewise((cases[1], which), (cases[0], True))


_ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "add_any": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "max": sympy.Max,
    "min": sympy.Min,
    "abs": sympy.Abs,
    "exp": sympy.exp,
    "exp2": lambda x: sympy.Integer(2) ** x,
    "log": sympy.log,
    "log1p": lambda x: sympy.log(1 + x),
    "expm1": lambda x: sympy.exp(x) - 1,
    "sin": sympy.sin,
    "cos": sympy.cos,
    "tan": sympy.tan,
    "atan2": sympy.atan2,
    "sqrt": sympy.sqrt,
    "rsqrt": lambda x: 1 / sympy.sqrt(x),
    "logistic": lambda x: 1 / (1 + sympy.exp(-x)),
    "clamp": lambda low, x, high: sympy.Min(sympy.Max(x, low), high),
    "square": lambda x: x**2,
    "gt": sympy.Gt,
    "ge": sympy.Ge,
    "lt": sympy.Lt,
    "le": sympy.Le,
    "select_n": _select,
    "stop_gradient": lambda x: x,
}
_STRUCTURAL: dict[str, Callable[[list[Symbols], dict[str, Any]], Symbols]] = {
    "integer_pow": lambda given, p: _each(lambda x: x ** p["y"], given[0]),
    "convert_element_type": lambda given, p: given[0],
    "copy": lambda given, p: given[0],
    "reshape": lambda given, p: given[0].reshape(p["new_sizes"]),
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "squeeze": _squeeze,
    "concatenate": lambda given, p: np.concatenate(given, axis=p["dimension"]),
    "stack": lambda given, p: np.stack(given, axis=p["axis"]),
    "reduce_sum": _sum,
    "transpose": lambda given, p: given[0].transpose(p["permutation"]),
}
