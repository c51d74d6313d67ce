"""The clear-sky model of Preetham, Shirley and Smits (1999): luminance and chromaticity."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit import tables
from atmofit.checks import angle_in_range, in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.perez import perez_formula
from atmofit.typing import Reals, RealsLike, Scalar, real_array

CANDELA_PER_KILOCANDELA = 1e3
CHI_OFFSET, CHI_SLOPE = 4 / 9, 1 / 120  # chi = (4/9 - T/120) (pi - 2 solar zenith angle)

Matrix = Array | np.ndarray


def _matrix(value: Any) -> Float[Matrix, "..."]:
    """A floating-point array; NumPy stays NumPy, so that a model can be made at import."""
    return value if isinstance(value, jax.Array) else np.asarray(value, float)


class PreethamModel(eqx.Module):
    """Sky luminance and chromaticity as functions of turbidity and sun.

    Attributes:
        x_distribution: Perez coefficients of x, [A..E, (T, 1)].
        y_distribution: Of y.
        luminance_distribution: Of Y.
        zenith_x: x at the zenith, [(T^2, T, 1), (s^3, s^2, s, 1)], with the solar zenith angle
            s [rad].
        zenith_y: y at the zenith.
        zenith_luminance: a, b, c, d of (a T + b) tan chi + c T + d [kcd m^-2].
        turbidity_range: Where the model is valid; static. Luminance at and outside the ends may
            be negative and is never clipped.

    References:
        Preetham et al. (1999), appendix A.2.
    """

    x_distribution: Float[Matrix, "5 2"] = eqx.field(converter=_matrix)
    y_distribution: Float[Matrix, "5 2"] = eqx.field(converter=_matrix)
    luminance_distribution: Float[Matrix, "5 2"] = eqx.field(converter=_matrix)
    zenith_x: Float[Matrix, "3 4"] = eqx.field(converter=_matrix)
    zenith_y: Float[Matrix, "3 4"] = eqx.field(converter=_matrix)
    zenith_luminance: Float[Matrix, " 4"] = eqx.field(converter=_matrix)
    turbidity_range: tuple[float, float] = eqx.field(static=True, default=(1.7, 10.0))

    def __check_init__(self) -> None:
        """Check the range; the shapes of the matrices are checked where types are."""
        low, high = self.turbidity_range
        if not 1 <= low < high < np.inf:
            raise ValueError(
                f"turbidity_range must increase from at least 1, got ({low:.6g}, {high:.6g})"
            )
        for name, shape in _SHAPES.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {getattr(self, name).shape}")

    def __call__(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
    ) -> Reals:
        """Chromaticity and luminance of the sky.

        Args:
            turbidity: Inside `turbidity_range`; a scalar.
            solar_zenith_angle: 0 to pi/2 [rad]; a scalar.
            directions: On or above the horizon.

        Returns:
            x, y and Y [cd m^-2] on a last axis of 3 after the axes of the directions, in their
            dtype. NaN where a traced argument is out of range.

        Raises:
            ValueError: A known argument is out of range.
        """
        view, azimuth = directions.angles()
        T, s = self._checked(turbidity, solar_zenith_angle, view.dtype)
        view = angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
        # JAX 0.10 remembers NumPy arguments in the precision that it first met them in.
        known = jax.tree.map(real_array, self)
        return _sky(known, T, s, view, in_range("relative_azimuth", azimuth, -np.inf, np.inf))

    def zenith(self, turbidity: RealsLike, solar_zenith_angle: RealsLike) -> Reals:
        """x, y and Y [cd m^-2] at the zenith, on a last axis of 3.

        Args:
            turbidity: Inside `turbidity_range`, any shape.
            solar_zenith_angle: 0 to pi/2 [rad]; broadcasts against `turbidity`.

        Raises:
            ValueError: A known argument is out of range.
        """
        dtype = jnp.result_type(float, turbidity, solar_zenith_angle)
        return _zenith(self, *self._checked(turbidity, solar_zenith_angle, dtype))

    def _checked(
        self, turbidity: RealsLike, solar_zenith_angle: RealsLike, dtype: Any
    ) -> tuple[Reals, Reals]:
        T = in_range("turbidity", turbidity, *self.turbidity_range)
        s = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
        return T.astype(dtype), s.astype(dtype)


_SHAPES = {
    "x_distribution": (5, 2),
    "y_distribution": (5, 2),
    "luminance_distribution": (5, 2),
    "zenith_x": (3, 4),
    "zenith_y": (3, 4),
    "zenith_luminance": (4,),
}


@eqx.filter_jit
def _sky(
    model: PreethamModel, turbidity: Scalar, sun: Scalar, view: Reals, azimuth: Reals
) -> Reals:
    γ = scattering_angle(view, azimuth, sun)
    zenith = _zenith(model, turbidity, sun)
    values = []
    for k, matrix in enumerate(
        (model.x_distribution, model.y_distribution, model.luminance_distribution)
    ):
        slope, intercept = jnp.moveaxis(jnp.asarray(matrix, view.dtype), 1, 0)
        coefficients = slope * turbidity + intercept
        at_zenith = perez_formula(coefficients, jnp.zeros_like(sun), sun)
        values.append(zenith[k] * perez_formula(coefficients, view, γ) / at_zenith)
    return jnp.stack(values, axis=-1)


def _zenith(model: PreethamModel, turbidity: Reals, sun: Reals) -> Reals:
    T, s = jnp.broadcast_arrays(turbidity, sun)
    return jnp.stack(
        [
            zenith_chromaticity(jnp.asarray(model.zenith_x, T.dtype), T, s),
            zenith_chromaticity(jnp.asarray(model.zenith_y, T.dtype), T, s),
            CANDELA_PER_KILOCANDELA
            * zenith_luminance(jnp.asarray(model.zenith_luminance, T.dtype), T, s),
        ],
        axis=-1,
    )


def zenith_luminance(
    coefficients: Float[Array, " 4"], turbidity: Reals, solar_zenith_angle: Reals
) -> Reals:
    """Zenith luminance (a T + b) tan chi + c T + d, in the unit of its coefficients.

    Args:
        coefficients: a, b, c, d.
        turbidity: Any shape.
        solar_zenith_angle: [rad], the same shape.
    """
    return jnp.tensordot(zenith_luminance_basis(turbidity, solar_zenith_angle), coefficients, 1)


def zenith_luminance_basis(turbidity: Reals, solar_zenith_angle: Reals) -> Reals:
    """What a, b, c and d multiply in the zenith luminance, on a last axis of 4."""
    tangent = jnp.tan((CHI_OFFSET - CHI_SLOPE * turbidity) * (np.pi - 2 * solar_zenith_angle))
    one = jnp.ones_like(tangent)
    return jnp.stack([turbidity * tangent, tangent, turbidity * one, one], axis=-1)


def zenith_chromaticity(
    matrix: Float[Array, "3 4"], turbidity: Reals, solar_zenith_angle: Reals
) -> Reals:
    """Zenith chromaticity, a polynomial of degree 2 in turbidity and 3 in the sun's angle.

    Args:
        matrix: Rows for T^2, T, 1; columns for s^3, s^2, s, 1.
        turbidity: T, any shape.
        solar_zenith_angle: s [rad], the same shape.
    """
    basis = zenith_chromaticity_basis(turbidity, solar_zenith_angle)
    return jnp.tensordot(basis, matrix.ravel(), 1)


def zenith_chromaticity_basis(turbidity: Reals, solar_zenith_angle: Reals) -> Reals:
    """What the 12 cells, row by row, multiply in a zenith chromaticity, on a last axis of 12."""
    T, s = turbidity, solar_zenith_angle
    in_T, in_s = (T * T, T, jnp.ones_like(T)), (s * s * s, s * s, s, jnp.ones_like(s))
    return jnp.stack([row * column for row in in_T for column in in_s], axis=-1)


def _published() -> PreethamModel:
    published = tables.preetham1999_coefficients()
    return PreethamModel(
        x_distribution=published.distribution["x"],
        y_distribution=published.distribution["y"],
        luminance_distribution=published.distribution["Y"],
        zenith_x=published.zenith_chromaticity["x"],
        zenith_y=published.zenith_chromaticity["y"],
        zenith_luminance=published.zenith_luminance,
    )


PREETHAM_1999 = _published()

extremes(
    Case("at the sun", {"view_zenith_angle": 0.7, "solar_zenith_angle": 0.7, "azimuth": 0.0}),
    Case("horizon", {"view_zenith_angle": HORIZON, "azimuth": 0.0}),
    Case("everything overhead", {"view_zenith_angle": 0.0, "solar_zenith_angle": 0.0}),
    call=lambda turbidity, solar_zenith_angle, view_zenith_angle, azimuth: PREETHAM_1999(
        turbidity, solar_zenith_angle, Directions(view_zenith_angle[None], azimuth[None])
    ),
    turbidity=Domain(1.7, 10.0),
    solar_zenith_angle=Domain(0.0, HORIZON),
    view_zenith_angle=Domain(0.0, HORIZON),
    azimuth=Domain(-np.inf, np.inf),
    least=0.0,
)(PreethamModel)
extremes(
    part="zenith",
    call=lambda turbidity, solar_zenith_angle: PREETHAM_1999.zenith(turbidity, solar_zenith_angle),
    turbidity=Domain(1.7, 10.0),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)(PreethamModel)
