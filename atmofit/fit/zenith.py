"""Fits of the zenith values, to the forms of Preetham et al. (1999), appendix A.2.

Both forms are linear in their coefficients, so these fits need neither a start nor steps.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.fit import weighting as weights
from atmofit.fit.uncertainty import pointing_up
from atmofit.geometry import HORIZON
from atmofit.models.preetham import (
    CANDELA_PER_KILOCANDELA,
    zenith_chromaticity_basis,
    zenith_luminance_basis,
)
from atmofit.typing import Reals, RealsLike

WEIGHTINGS = ("relative", "absolute")


class ZenithFit(eqx.Module):
    """Coefficients of a zenith form.

    Attributes:
        coefficients: Luminance: a, b, c, d [kcd m^-2]. Chromaticity: the matrix
            [(T^2, T, 1), (s^3, s^2, s, 1)].
        standard_error: Of the coefficients, the same shape; residuals taken as independent, as
            in `uncertainty.uncertainty`.
        robust_standard_error: Likewise, but each cell of the table may have a variance of its
            own (HC3: each residual is divided by 1 - its leverage before it enters the sandwich).
        covariance: Of the coefficients row by row.
        condition_number: Of the design matrix with its columns scaled to unit length.
        column_norm: Length of each column over the root of their number: the root mean square
            residual that the coefficient alone changes, per unit; row by row.
        weakest_direction: Unit vector over the coefficients row by row, each in units of
            1 / column_norm, along which residuals change least.
        weakest_change: Root mean square change of the residuals along it, per unit; 1 for a
            coefficient alone.
        rms: Root mean square residual, dimensionless in the measure of the weighting.
        largest: Largest residual by size.
        residuals: [turbidity, sun], likewise.
        weighting: Static.
    """

    coefficients: Float[Array, "*cells"]
    standard_error: Float[Array, "*cells"]
    robust_standard_error: Float[Array, "*cells"]
    covariance: Float[Array, "p p"]
    condition_number: Float[Array, ""]
    column_norm: Float[Array, " p"]
    weakest_direction: Float[Array, " p"]
    weakest_change: Float[Array, ""]
    rms: Float[Array, ""]
    largest: Float[Array, ""]
    residuals: Float[Array, "turbidity sun"]
    weighting: str = eqx.field(static=True, default="relative")


def fit_zenith_luminance(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    luminance: RealsLike,
    *,
    weighting: str = "relative",
) -> ZenithFit:
    """Fit (a T + b) tan((4/9 - T/120)(pi - 2 s)) + c T + d to zenith luminances.

    Args:
        turbidity: T, shape [turbidity], at least two different.
        solar_zenith_angle: s, 0 to pi/2, shape [sun], at least two different [rad].
        luminance: Shape [turbidity, sun] [cd m^-2]; positive if weighting is "relative".
        weighting: "relative" to each value or "absolute".

    Returns:
        a, b, c, d [kcd m^-2].

    Raises:
        ValueError: Empty, non-finite or non-positive data, or too few turbidities or suns.
    """
    T, s, data = _checked(turbidity, solar_zenith_angle, luminance, "luminance", weighting, 2, 2)
    basis = zenith_luminance_basis(*jnp.meshgrid(T, s, indexing="ij"))
    return ZenithFit(**_fit(basis, data / CANDELA_PER_KILOCANDELA, weighting), weighting=weighting)


def fit_zenith_chromaticity(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    chromaticity: RealsLike,
    *,
    weighting: str = "relative",
) -> ZenithFit:
    """Fit the polynomial of degree 2 in T and 3 in s to zenith chromaticities x or y.

    Args:
        turbidity: T, shape [turbidity], at least three different.
        solar_zenith_angle: s, 0 to pi/2, shape [sun], at least four different [rad].
        chromaticity: x or y, shape [turbidity, sun].
        weighting: "relative" to each value or "absolute".

    Returns:
        The matrix [3, 4].

    Raises:
        ValueError: Empty, non-finite or non-positive data, or too few turbidities or suns.
    """
    T, s, data = _checked(
        turbidity, solar_zenith_angle, chromaticity, "chromaticity", weighting, 3, 4
    )
    fit = _fit(zenith_chromaticity_basis(*jnp.meshgrid(T, s, indexing="ij")), data, weighting)
    for name in ("coefficients", "standard_error", "robust_standard_error"):
        fit[name] = fit[name].reshape(3, 4)
    return ZenithFit(**fit, weighting=weighting)


def _checked(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    values: RealsLike,
    name: str,
    weighting: str,
    turbidities: int,
    suns: int,
) -> tuple[Reals, Reals, Reals]:
    choice("weighting", weighting, WEIGHTINGS)
    data = weights.checked_values(name, values, weighting)
    T = in_range("turbidity", turbidity, -np.inf, np.inf).astype(data.dtype)
    s = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON).astype(data.dtype)
    if T.ndim != 1 or s.ndim != 1 or data.shape != T.shape + s.shape:
        raise ValueError(
            f"{name} must have shape [turbidity, sun] = {T.shape + s.shape}, got {data.shape}"
        )
    for axis, known, least in (("turbidity", T, turbidities), ("solar_zenith_angle", s, suns)):
        different = known.size if is_traced(known) else np.unique(np.asarray(known)).size
        if different < least:
            raise ValueError(f"{axis} must hold at least {least} different values, got {different}")
    return T, s, data


@eqx.filter_jit
def _fit(
    basis: Float[Array, "turbidity sun p"], values: Float[Array, "turbidity sun"], weighting: str
) -> dict[str, Array]:
    """Linear least squares by QR of the weighted and scaled design matrix.

    HC3: MacKinnon and White (1985), J. Econometrics 29, 305.
    """
    weight = 1 / values if weighting == "relative" else jnp.ones_like(values)
    if weighting == "absolute":
        weight = weight / jnp.sqrt(jnp.mean(values**2))
    size = basis.shape[-1]
    design = (basis * weight[..., None]).reshape(-1, size)
    target = (values * weight).ravel()
    length = jnp.linalg.norm(design, axis=0)
    q, r = jnp.linalg.qr(design / length[None, :])
    scaled = jax.scipy.linalg.solve_triangular(r, q.T @ target)
    residuals = design @ (scaled / length) - target
    inverse = jax.scipy.linalg.solve_triangular(r, jnp.eye(size, dtype=r.dtype)) / length[:, None]
    variance = jnp.sum(residuals**2) / max(target.size - size, 1)
    covariance = variance * (inverse @ inverse.T)
    # A datum that its coefficients can always meet has leverage 1 and no residual.
    rest = jnp.maximum(1 - jnp.sum(q**2, axis=1), float(jnp.finfo(q.dtype).eps) ** 0.5)
    spread = (residuals / rest)[:, None] * (q @ inverse.T)
    _, stretch, axes = jnp.linalg.svd(r)
    return {
        "coefficients": scaled / length,
        "standard_error": jnp.sqrt(jnp.diagonal(covariance)),
        "robust_standard_error": jnp.sqrt(jnp.sum(spread**2, axis=0)),
        "covariance": covariance,
        "condition_number": stretch[0] / stretch[-1],
        "column_norm": length / np.sqrt(target.size),
        "weakest_direction": pointing_up(axes[-1]),
        "weakest_change": stretch[-1],
        "rms": jnp.sqrt(jnp.mean(residuals**2)),
        "largest": jnp.max(jnp.abs(residuals)),
        "residuals": residuals.reshape(values.shape),
    }
