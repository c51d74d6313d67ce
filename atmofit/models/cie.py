"""The CIE's standard general sky: fifteen distributions of luminance, from overcast to clear."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON
from atmofit.models.perez import COSINE_FLOOR
from atmofit.models.shapes import FreeNumber
from atmofit.typing import Reals, RealsLike

# a, b of the gradation; c, d, e of the indicatrix.
_GRADATIONS = {
    "I": (4.0, -0.70), "II": (1.1, -0.80), "III": (0.0, -1.0),
    "IV": (-1.0, -0.55), "V": (-1.0, -0.32), "VI": (-1.0, -0.15),
}  # fmt: skip
_INDICATRICES = {
    1: (0.0, -1.0, 0.0), 2: (2.0, -1.5, 0.15), 3: (5.0, -2.5, 0.30),
    4: (10.0, -3.0, 0.45), 5: (16.0, -3.0, 0.30), 6: (24.0, -2.8, 0.15),
}  # fmt: skip
CIE_SKY_TYPES = {
    number: (*_GRADATIONS[gradation], *_INDICATRICES[indicatrix])
    for number, (gradation, indicatrix) in enumerate(
        (
            ("I", 1), ("I", 2), ("II", 1), ("II", 2), ("III", 1), ("III", 2), ("III", 3),
            ("III", 4), ("IV", 2), ("IV", 3), ("IV", 4), ("V", 4), ("V", 5), ("VI", 5), ("VI", 6),
        ),
        start=1,
    )
}  # fmt: skip


def cie_general_sky(
    sky_type: int,
    view_zenith_angle: RealsLike,
    scattering_angle: RealsLike,
    solar_zenith_angle: RealsLike,
) -> Reals:
    """Luminance over that at the zenith.

    Args:
        sky_type: 1 (overcast, steep gradation) to 15 (clear, white-blue and turbid); 5 is uniform,
            12 the clear sky of low turbidity. Static.
        view_zenith_angle: 0 to pi/2 [rad].
        scattering_angle: Between view direction and sun, 0 to pi [rad].
        solar_zenith_angle: 0 to pi/2 [rad]. The three broadcast.

    Returns:
        The ratio, positive, of the broadcast shape. NaN where a traced angle is out of range.

    Raises:
        ValueError: A known argument is out of range.

    References:
        CIE S 011/E:2003, Spatial distribution of daylight: CIE standard general sky.
    """
    _check_type(sky_type)
    θ, γ, s = _angles(view_zenith_angle, scattering_angle, solar_zenith_angle)
    zenith = _relative(sky_type, jnp.ones_like(s), s)
    return _relative(sky_type, jnp.cos(θ), γ) / zenith


extremes(
    Case(
        "zenith",
        {"view_zenith_angle": 0.0, "scattering_angle": 1.0, "solar_zenith_angle": 1.0},
        limit=1.0,
    ),
    call=lambda view_zenith_angle, scattering_angle, solar_zenith_angle: cie_general_sky(
        12, view_zenith_angle, scattering_angle, solar_zenith_angle
    ),
    view_zenith_angle=Domain(0.0, HORIZON),
    scattering_angle=Domain(0.0, math.pi),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)(cie_general_sky)


def cie_clear_sky(
    view_zenith_angle: RealsLike, scattering_angle: RealsLike, solar_zenith_angle: RealsLike
) -> Reals:
    """Luminance of the CIE's clear sky of 1973 over that at the zenith.

    Args:
        view_zenith_angle: 0 to pi/2 [rad].
        scattering_angle: Between view direction and sun, 0 to pi [rad].
        solar_zenith_angle: 0 to pi/2 [rad]. The three broadcast.

    Returns:
        The ratio, of the broadcast shape.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Preetham, Shirley and Smits (1999), equation 1; Kittler (1967).
    """
    θ, γ, s = _angles(view_zenith_angle, scattering_angle, solar_zenith_angle)

    def around(angle: Reals) -> Reals:
        return 0.91 + 10 * jnp.exp(-3 * angle) + 0.45 * jnp.cos(angle) ** 2

    gradation = -jnp.expm1(-0.32 / jnp.maximum(jnp.cos(θ), COSINE_FLOOR))
    return around(γ) / around(s) * gradation / -math.expm1(-0.32)


extremes(
    Case(
        "zenith",
        {"view_zenith_angle": 0.0, "scattering_angle": 0.5, "solar_zenith_angle": 0.5},
        limit=1.0,
    ),
    call=lambda view_zenith_angle, scattering_angle, solar_zenith_angle: cie_clear_sky(
        view_zenith_angle, scattering_angle, solar_zenith_angle
    ),
    view_zenith_angle=Domain(0.0, HORIZON),
    scattering_angle=Domain(0.0, math.pi),
    solar_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)(cie_clear_sky)


@extremes(
    Case("zenith", {"view_zenith_angle": 0.0}, limit=1.0, slope={"view_zenith_angle": 0.0}),
    Case("horizon", {"view_zenith_angle": math.pi / 2}, limit=1 / 3),
    view_zenith_angle=Domain(0.0, HORIZON),
    least=0.0,
)
def cie_overcast_sky(view_zenith_angle: RealsLike) -> Reals:
    """Luminance of the CIE's overcast sky over that at the zenith.

    Args:
        view_zenith_angle: 0 to pi/2 [rad].

    References:
        Preetham, Shirley and Smits (1999), equation 2; Moon and Spencer (1942).
    """
    θ = angle_in_range("view_zenith_angle", view_zenith_angle, 0.0, HORIZON)
    return (1 + 2 * jnp.cos(θ)) / 3


def _angles(view: RealsLike, scattering: RealsLike, sun: RealsLike) -> tuple[Reals, Reals, Reals]:
    """Checked, of one shape and dtype."""
    θ = angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
    γ = angle_in_range("scattering_angle", scattering, 0.0, math.pi)
    s = angle_in_range("solar_zenith_angle", sun, 0.0, HORIZON)
    dtype = jnp.result_type(θ, γ, s)
    θ, γ, s = (x.astype(dtype) for x in jnp.broadcast_arrays(θ, γ, s))
    return θ, γ, s


def _check_type(sky_type: int) -> None:
    if sky_type not in CIE_SKY_TYPES:
        raise ValueError(f"sky_type must be a whole number from 1 to 15, got {sky_type!r}")


def _relative(sky_type: int, cosine: Reals, scattering_angle: Reals) -> Reals:
    """Gradation times indicatrix."""
    a, b, c, d, e = CIE_SKY_TYPES[sky_type]
    gradation = 1 + a * jnp.exp(b / jnp.maximum(cosine, COSINE_FLOOR))
    around_sun = jnp.exp(d * scattering_angle) - math.exp(d * np.pi / 2)
    return gradation * (1 + c * around_sun + e * jnp.cos(scattering_angle) ** 2)


class CIEShape(eqx.Module):
    """One of the fifteen distributions as a shape of a `SkyModel`: only its level is free.

    Attributes:
        sky_type: 1 to 15. Static.
    """

    sky_type: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        """Check the type."""
        _check_type(self.sky_type)

    @property
    def free_numbers(self) -> tuple[FreeNumber, ...]:
        """The logarithm of the level."""
        return (FreeNumber("ln_level", 0.0, 3.0, is_level=True),)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free numbers."""
        return ("ln_level",)

    def __call__(
        self, numbers: Float[Array, " n"], cosine: Reals, scattering_angle: Reals
    ) -> Reals:
        """Value of one sky, as `Shape.__call__`."""
        return jnp.exp(numbers[0]) * _relative(self.sky_type, cosine, scattering_angle)
