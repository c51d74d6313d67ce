"""Phase functions: how scattered light is shared among the directions.

All take the scattering angle (0 = forward) and integrate to 1 over the sphere [1/sr]. Multiple
scattering sees them through their Legendre moments: the integral of p P_l over the sphere.
"""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import gauss_nodes, legendre_table, powers
from atmofit.spectrum import Spectrum, at, checked_spectral, spectral
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_FOUR_PI = 4 * math.pi
_NORMALISING_NODES = 200
_LARGEST_ASYMMETRY = 0.999
_LARGEST_DEPOLARISATION = 6 / 7  # where the King factor becomes infinite


class PhaseFunction(eqx.Module):
    """Share of the scattered light per solid angle.

    Attributes:
        degree: The last Legendre moment that is not 0, or None where there is no last one.
    """

    degree: ClassVar[int | None] = None

    @abc.abstractmethod
    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr], [..., wavelength]; the last axis is 1 where it is the same."""

    @abc.abstractmethod
    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """The first Legendre moments [-], [degree, wavelength]; the 0th is 1."""

    def __call__(self, scattering_angle: RealsLike, wavelength_nm: RealsLike = 550.0) -> Reals:
        """Phase function at one wavelength.

        Args:
            scattering_angle: 0 = forward [rad], any shape.
            wavelength_nm: [nm], a number.

        Returns:
            Phase function of the shape of the angle [1/sr]; its integral over the sphere is 1.
        """
        angle = angle_in_range("scattering_angle", scattering_angle, 0.0, math.pi)
        wavelength = real_array(wavelength_nm).astype(angle.dtype).reshape(1)
        return self.at_wavelengths(angle, wavelength)[..., 0]

    def checked(self) -> "PhaseFunction":
        """Refuse impossible parameters."""
        return self


def forward_peak(moments: Float[Array, "*s l"]) -> Float[Array, "*s"]:
    """Share of the scattered light in a forward peak that Legendre moments do not resolve.

    The last moment, which all further ones approach (delta scaling); 0 for backward peaks, whose
    moments alternate.

    Args:
        moments: At least two, the last one beyond those that are resolved [-].

    References:
        Wiscombe (1977), J. Atmos. Sci. 34, 1408.
    """
    return jnp.maximum(jnp.min(moments[..., -2:], axis=-1), 0.0)


def resolved(moments: Float[Array, "*s l"]) -> tuple[Float[Array, "*s l_"], Float[Array, "*s"]]:
    """Legendre moments of a phase function without the peaks that they do not resolve.

    The forward peak is taken out. A backward peak stays, as its Cesaro mean of second order,
    without which the series has negative ripples as large as itself.

    Args:
        moments: At least two, the last one beyond those that are resolved [-].

    Returns:
        All moments but the last, of what is left, and the forward peak's share [-].
    """
    degree = np.arange(moments.shape[-1])
    sign, last = np.where(degree % 2, -1.0, 1.0), degree[-1]
    mean = (last + 1 - degree) * (last - degree) / ((last + 1) * last)
    behind, blurred = (jnp.asarray(x, moments.dtype) for x in (sign, sign * (1 - mean)))
    axes = (None,) * (moments.ndim - 1)
    backward = forward_peak(moments * behind[axes])[..., None] * blurred[axes]
    peak = forward_peak(moments)
    return (moments - peak[..., None] - backward)[..., :-1] / (1 - peak)[..., None], peak


class Rayleigh(PhaseFunction):
    """Scattering by air molecules, 3 / (16 pi) (1 + cos^2) if they are isotropic.

    Attributes:
        depolarisation: Factor rho of anisotropic molecules [-], 0 to 6/7, a number or a
            `Spectrum`: 3 / (8 pi (2 + rho)) ((1 + rho) + (1 - rho) cos^2), Chandrasekhar (1960)
            section 18. None: left out, that is 0.
    """

    degree: ClassVar[int | None] = 2
    depolarisation: Scalar | Spectrum | None = eqx.field(
        converter=lambda value: None if value is None else spectral(value), default=None
    )

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]; the same at every wavelength unless depolarisation varies."""
        if self.depolarisation is None:
            return (3 / (4 * _FOUR_PI) * (1 + jnp.cos(angle) ** 2))[..., None]
        rho = _on_last_axis(self.depolarisation, wavelength_nm, angle)
        shape = (1 + rho) + (1 - rho) * jnp.cos(angle)[..., None] ** 2
        return 3 / (2 * _FOUR_PI) * shape / (2 + rho)

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments 1, 0, (1 - rho) / (5 (2 + rho)), 0, ..."""
        first, second = (np.eye(1, count, degree).T for degree in (0, 2))
        if self.depolarisation is None:
            return jnp.asarray(first + 0.1 * second, wavelength_nm.dtype)
        rho = _on_last_axis(self.depolarisation, wavelength_nm, wavelength_nm[0])[None, :]
        value = (1 - rho) / (5 * (2 + rho))
        return jnp.asarray(first, rho.dtype) + jnp.asarray(second, rho.dtype) * value

    def checked(self) -> "Rayleigh":
        """Refuse depolarisation factors that no molecule has."""
        if self.depolarisation is None:
            return self
        return Rayleigh(
            checked_spectral("depolarisation", self.depolarisation, 0.0, _LARGEST_DEPOLARISATION)
        )


extremes(
    Case("forward", {"angle": 0.0}, limit=6 / (16 * math.pi), slope={"angle": 0.0}),
    Case("aside", {"angle": math.pi / 2}, limit=3 / (16 * math.pi)),
    call=lambda angle: Rayleigh()(angle),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(Rayleigh)
extremes(
    Case("none", {"depolarisation": 0.0, "angle": 0.0}, (6 / (16 * math.pi), 1, 0, 0.1, 0)),
    # All that the largest factor leaves: (13 + cos^2) / 20 of 3 / (8 pi).
    Case("most", {"depolarisation": 6 / 7, "angle": 0.0}, (21 / (80 * math.pi), 1, 0, 0.01, 0)),
    part="depolarisation",
    call=lambda depolarisation, angle: (
        Rayleigh(depolarisation).checked()(angle),
        Rayleigh(depolarisation).moments(4, angle[None]),
    ),
    depolarisation=Domain(0.0, _LARGEST_DEPOLARISATION),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(Rayleigh)


class HenyeyGreenstein(PhaseFunction):
    """The one-parameter phase function of Henyey and Greenstein (1941).

    Attributes:
        asymmetry: Mean cosine of the scattering angle g, -0.999 to 0.999, above 0 for forward
            scattering; a number or a `Spectrum`.
    """

    asymmetry: Scalar | Spectrum = eqx.field(converter=spectral)

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        g = _on_last_axis(self.asymmetry, wavelength_nm, angle)
        # (1 - g)^2 + 4 g sin^2 keeps its digits in the forward peak, 1 + g^2 - 2 g cos does not.
        half = jnp.sin(angle / 2)[..., None]
        return (1 - g**2) / (_FOUR_PI * ((1 - g) ** 2 + 4 * g * half**2) ** 1.5)

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments g^l."""
        g = _on_last_axis(self.asymmetry, wavelength_nm, wavelength_nm[0])
        return powers(g, count).T

    def checked(self) -> "HenyeyGreenstein":
        """Refuse asymmetries outside (-1, 1)."""
        return HenyeyGreenstein(
            checked_spectral("asymmetry", self.asymmetry, -_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY)
        )


extremes(
    Case("isotropic", {"asymmetry": 0.0}, limit=1 / _FOUR_PI),
    Case("forward", {"asymmetry": 0.5, "angle": 0.0}, 6 / _FOUR_PI, {"angle": 0.0}),
    Case("backward", {"asymmetry": 0.5, "angle": math.pi}, limit=0.75 / 1.5**3 / _FOUR_PI),
    call=lambda asymmetry, angle: HenyeyGreenstein(asymmetry).checked()(angle),
    asymmetry=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(HenyeyGreenstein)
extremes(
    Case("isotropic", {"asymmetry": 0.0}, limit=(1, 0, 0, 0), slope={"asymmetry": (0, 1, 0, 0)}),
    part="moments",
    call=lambda asymmetry: HenyeyGreenstein(asymmetry).checked().moments(4, asymmetry[None]),
    asymmetry=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
)(HenyeyGreenstein)


class CornetteShanks(PhaseFunction):
    """Henyey-Greenstein times 1 + cos^2, which is Rayleigh's at g = 0 (Cornette, Shanks 1992).

    Attributes:
        asymmetry: The parameter g, -0.999 to 0.999 (the mean cosine is
            3 g (4 + g^2) / (5 (2 + g^2))); a number or a `Spectrum`.
    """

    asymmetry: Scalar | Spectrum = eqx.field(converter=spectral)

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        g = _on_last_axis(self.asymmetry, wavelength_nm, angle)
        henyey = HenyeyGreenstein(self.asymmetry).at_wavelengths(angle, wavelength_nm)
        return henyey * 1.5 * (1 + jnp.cos(angle)[..., None] ** 2) / (2 + g**2)

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments, from those of Henyey-Greenstein by mu P_l's recurrence, twice."""
        g = _on_last_axis(self.asymmetry, wavelength_nm, wavelength_nm[0])
        times_mu2 = jnp.asarray(_cosine_squared_matrix(count), g.dtype)
        henyey = powers(g, count + 2).T
        return (1.5 / (2 + g**2))[None, :] * (henyey[:count] + times_mu2 @ henyey)

    def checked(self) -> "CornetteShanks":
        """Refuse asymmetries outside (-1, 1)."""
        return CornetteShanks(
            checked_spectral("asymmetry", self.asymmetry, -_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY)
        )


extremes(
    Case("Rayleigh's", {"asymmetry": 0.0, "angle": 0.0}, 6 / (16 * math.pi), {"angle": 0.0}),
    Case("forward", {"asymmetry": 0.5, "angle": 0.0}, limit=6 * 3 / 2.25 / _FOUR_PI),
    call=lambda asymmetry, angle: CornetteShanks(asymmetry).checked()(angle),
    asymmetry=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(CornetteShanks)
extremes(
    Case("Rayleigh's", {"asymmetry": 0.0}, limit=(1, 0, 0.1, 0), size=1.0),
    part="moments",
    call=lambda asymmetry: CornetteShanks(asymmetry).checked().moments(4, asymmetry[None]),
    asymmetry=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
)(CornetteShanks)


class TabulatedPhase(PhaseFunction):
    """A table of values against angle, and against wavelength if there are several columns.

    Between the angles the logarithm follows cubics with continuous slope, flat at 0 and at pi;
    between the wavelengths it is linear, outside them constant. The whole is scaled so that its
    integral over the sphere is 1 at every wavelength.

    Attributes:
        angle: Scattering angle [rad], increasing from 0 or more to pi or less; the first and
            last values also hold beyond.
        values: Above 0, in any unit, one column for each wavelength.
        wavelength_nm: Wavelength of each column [nm], increasing.
    """

    angle: Float[Array, " knot"] = eqx.field(converter=real_array)
    values: Float[Array, "knot column"] = eqx.field(converter=real_array)
    wavelength_nm: Float[Array, " column"] = eqx.field(converter=real_array)

    def __init__(self, angle: RealsLike, values: RealsLike, wavelength_nm: RealsLike = 550.0):
        """Take one column as a list, or several as [angle, wavelength]."""
        self.angle = real_array(angle)
        table = real_array(values)
        self.values = table[:, None] if table.ndim == 1 else table
        self.wavelength_nm = jnp.atleast_1d(real_array(wavelength_nm))

    def __check_init__(self) -> None:
        """Check the table's shape, and its values where they are known."""
        shape = (self.angle.size, self.wavelength_nm.size)
        if self.angle.ndim != 1 or self.values.shape != shape or self.angle.size < 2:
            raise ValueError(
                f"values must have the shape [angle, wavelength] = {shape} with at least 2 angles, "
                f"got {self.values.shape}"
            )
        if not is_traced(self):
            angle_in_range("angle", self.angle, 0.0, math.pi)
            in_range("values", self.values, float(np.finfo(np.float32).tiny), math.inf)
            for name in ("angle", "wavelength_nm"):
                if np.any(np.diff(np.asarray(getattr(self, name), float)) <= 0):
                    raise ValueError(f"{name} of a TabulatedPhase must increase")

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        return jnp.exp(self._basis(angle) @ self._log_columns(wavelength_nm))

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments by quadrature; the 0th is 1 by construction."""
        angle, weight = _sphere_nodes()
        table = self._log_columns(wavelength_nm)
        p = jnp.exp(self._basis(jnp.asarray(angle, table.dtype)) @ table)
        weighted = weight[:, None] * legendre_table(np.cos(angle), count)
        return jnp.asarray(weighted.T, p.dtype) @ p

    def _log_columns(self, wavelength_nm: Float[Array, " w"]) -> Float[Array, "knot w"]:
        """Log values, normalised: the knots' weights add to 1, so a constant passes through."""
        table = jnp.log(self.values)
        if self.wavelength_nm.size > 1:
            # A matrix product: each wanted wavelength is a mixture of two columns.
            columns = jnp.arange(self.wavelength_nm.size, dtype=table.dtype)
            place = jnp.interp(wavelength_nm, self.wavelength_nm, columns)
            table = table @ jnp.maximum(1 - jnp.abs(columns[:, None] - place[None, :]), 0.0)
        angle, weight = _sphere_nodes()
        log_p = self._basis(jnp.asarray(angle, table.dtype)) @ table
        largest = log_p.max(0, keepdims=True)
        total = jnp.asarray(weight, table.dtype) @ jnp.exp(log_p - largest)
        return table - largest - jnp.log(total)[None, :]

    def _basis(self, angle: Reals) -> Float[Array, "... knot"]:
        """Weights of the knots' values at an angle: cubic Hermite with three-point slopes."""
        knots = self.angle
        x = jnp.clip(angle, knots[0], knots[-1])
        panel = jnp.clip(
            jnp.searchsorted(knots, x, side="right", method="compare_all") - 1, 0, knots.size - 2
        )
        left = jax.nn.one_hot(panel, knots.size, dtype=x.dtype)
        right = jax.nn.one_hot(panel + 1, knots.size, dtype=x.dtype)
        width = knots[panel + 1] - knots[panel]
        t, width = ((x - knots[panel]) / width)[..., None], width[..., None]
        slope_weight = width * (t * (1 - t) ** 2 * left - t**2 * (1 - t) * right)
        value_weight = (1 + 2 * t) * (1 - t) ** 2 * left + t**2 * (3 - 2 * t) * right
        return value_weight + slope_weight @ _slope_matrix(knots)


extremes(
    Case("constant", {"values": (7.0,) * 4}, limit=1 / _FOUR_PI),
    Case("at a knot", {"angle": 1.0}),
    Case("last knot", {"angle": math.pi}),
    call=lambda values, angle: TabulatedPhase((0.0, 0.1, 1.0, math.pi), values)(angle),
    values=Span((1e-12,) * 4, (1e12, 1.0, 1.0, 1.0)),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(TabulatedPhase)


def _slope_matrix(x: Float[Array, " knot"]) -> Float[Array, "knot knot"]:
    """Slopes at the knots from the values: the parabola through three, 0 at both ends."""
    n = x.size
    step = jnp.diff(x)
    difference = (jnp.eye(n, k=1)[:-1] - jnp.eye(n)[:-1]).astype(x.dtype) / step[:, None]
    inner = (step[1:, None] * difference[:-1] + step[:-1, None] * difference[1:]) / (
        step[1:] + step[:-1]
    )[:, None]
    return jnp.pad(inner, ((1, 1), (0, 0)))


def _sphere_nodes() -> tuple[np.ndarray, np.ndarray]:
    """Angles, dense near 0, and solid-angle weights that integrate over the sphere."""
    u, w = gauss_nodes(_NORMALISING_NODES)
    return math.pi * u**2, w * 2 * math.pi * u * 2 * math.pi * np.sin(math.pi * u**2)


def _cosine_squared_matrix(count: int) -> np.ndarray:
    """Moments of mu^2 p, [count], from the moments of p, [count + 2]."""
    size = count + 4
    degree = np.arange(size)
    multiply = np.zeros((size, size))
    multiply[degree[:-1], degree[:-1] + 1] = (degree[:-1] + 1) / (2 * degree[:-1] + 1)
    multiply[degree[1:], degree[1:] - 1] = degree[1:] / (2 * degree[1:] + 1)
    return (multiply @ multiply)[:count, : count + 2]


def _on_last_axis(
    quantity: Scalar | Spectrum, wavelength_nm: Float[Array, " w"], like: Reals
) -> Reals:
    """A parameter as a trailing wavelength axis behind the axes of `like`; length 1 if constant."""
    value = at(quantity, wavelength_nm) if isinstance(quantity, Spectrum) else quantity[None]
    return value.reshape((1,) * like.ndim + value.shape)
