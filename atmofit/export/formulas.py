"""What source code of a model consists of in any language: expressions, numbers, a comment."""

import dataclasses
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import sympy
from sympy.logic.boolalg import Boolean

from atmofit.export.expressions import expressions
from atmofit.geometry import scattering_angle
from atmofit.models.sky_model import COLOURS, SkyModel


@dataclasses.dataclass(frozen=True)
class Parts:
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
    def of(model: SkyModel) -> "Parts":
        """Those of a model."""
        d, shape = model.dependence, model.shape
        return Parts(
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


def describe(model: SkyModel) -> list[str]:
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


def assigned(targets: Iterable[str], values: Sequence[sympy.Expr]) -> list[tuple[str, Any]]:
    """Assignments that compute what is common to the expressions once."""
    found: Any = sympy.cse(values, symbols=sympy.numbered_symbols("x_"))
    shared, reduced = found
    # Conditions go back to where they are used: they are no numbers.
    conditions = {symbol: value for symbol, value in shared if isinstance(value, Boolean)}
    named = [(str(x), v.xreplace(conditions)) for x, v in shared if x not in conditions]
    return named + list(zip(targets, (v.xreplace(conditions) for v in reduced), strict=True))


def listed(numbers: np.ndarray, indent: str = "    ") -> str:
    """Numbers with nine digits, which hold single precision, in lines."""
    texts = [_literal(float(value)) for value in numbers]
    rows = [", ".join(texts[k : k + 7]) for k in range(0, len(texts), 7)]
    return ",\n".join(indent + row for row in rows)


def _literal(value: float) -> str:
    text = f"{value:.9g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"
