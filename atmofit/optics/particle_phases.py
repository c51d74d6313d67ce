"""Phase functions of particles larger than the wavelength, and the words of planetary science.

Astronomers count from the phase angle between sun and observer as seen from the particle, 0 at
full moon; the rest of atmofit counts from the scattering angle, 0 straight on. One is pi minus the
other. Blinn (1982) also scales a phase function so that its mean over the sphere is 1, where ours
integrates to 1: `phase_of_phase_angle` converts both.
"""

import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

_FOUR_PI = 4 * math.pi
_SERIES_TO = 0.5  # [rad]
_SERIES = tuple((-1) ** (n + 1) * 2 * n / math.factorial(2 * n + 1) for n in range(1, 7))
_SUM_SLACK = 1e-5  # of weights in float32
_LARGEST_ASYMMETRY = 0.999


@extremes(
    Case("forward", {"scattering_angle": 0.0}, limit=math.pi, slope={"scattering_angle": -1.0}),
    scattering_angle=Domain(0.0, math.pi),
    least=0.0,
)
def phase_angle(scattering_angle: RealsLike) -> Reals:
    """Phase angle [rad] of a scattering angle [rad]: pi minus it; 0 is back toward the light.

    Raises:
        ValueError: A known angle is outside 0 to pi.
    """
    return math.pi - angle_in_range("scattering_angle", scattering_angle, 0.0, math.pi)


@extremes(
    Case("opposition", {"phase_angle": 0.0}, limit=math.pi, slope={"phase_angle": -1.0}),
    phase_angle=Domain(0.0, math.pi),
    least=0.0,
)
def scattering_angle_of_phase_angle(phase_angle: RealsLike) -> Reals:
    """Scattering angle [rad] of a phase angle [rad]: pi minus it; 0 is straight on.

    Raises:
        ValueError: A known angle is outside 0 to pi.
    """
    return math.pi - angle_in_range("phase_angle", phase_angle, 0.0, math.pi)


def phase_of_phase_angle(
    phase: PhaseFunction, phase_angle: RealsLike, wavelength_nm: RealsLike = 550.0
) -> Reals:
    """A phase function as Blinn writes it: of the phase angle, with a mean of 1 over the sphere.

    Args:
        phase: That integrates to 1 over the sphere.
        phase_angle: 0 = back toward the light [rad], any shape.
        wavelength_nm: [nm], a number.

    Returns:
        4 pi p(pi - phase angle) [-].

    Raises:
        ValueError: A known angle is outside 0 to pi, or the phase function is impossible.
    """
    angle = scattering_angle_of_phase_angle(phase_angle)
    return _FOUR_PI * phase.checked()(angle, wavelength_nm)


extremes(
    Case("even", {"asymmetry": 0.0}, limit=1.0),
    call=lambda asymmetry, angle: phase_of_phase_angle(HenyeyGreenstein(asymmetry), angle),
    asymmetry=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(phase_of_phase_angle)


class Isotropic(PhaseFunction):
    """The same in every direction, 1 / (4 pi)."""

    degree: ClassVar[int | None] = 0

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        return (1 / _FOUR_PI + 0 * angle)[..., None]  # NaN where the angle is

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments 1, 0, 0, ..."""
        return jnp.asarray(np.eye(count, 1), wavelength_nm.dtype)


extremes(
    Case("everywhere", {}, limit=(1 / _FOUR_PI, 1, 0, 0), slope={"angle": 0.0}),
    call=lambda angle: (
        Isotropic()(angle),
        Isotropic().moments(3, angle[None]),
    ),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(Isotropic)


class LinearPhase(PhaseFunction):
    """(1 + x cos(phase angle)) / (4 pi), that is 1 - x cos(scattering angle) (Blinn 1982, 3.2).

    Attributes:
        x: Minus three times the mean cosine of the scattering angle [-], -1 to 1 (beyond, the
            phase function would be negative); above 0 it scatters back.
    """

    degree: ClassVar[int | None] = 1
    x: Scalar = eqx.field(converter=scalar)

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        return ((1 - self.x * jnp.cos(angle)) / _FOUR_PI)[..., None]

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments 1, -x / 3, 0, ..."""
        first, second = (np.eye(1, count, degree).T for degree in (0, 1))
        kind = self.x.dtype
        return jnp.asarray(first, kind) - jnp.asarray(second / 3, kind) * self.x

    def checked(self) -> "LinearPhase":
        """Refuse negative phase functions."""
        return LinearPhase(in_range("x", self.x, -1.0, 1.0))


extremes(
    Case("dark ahead", {"x": 1.0, "angle": 0.0}, limit=0.0, slope={"x": -1 / _FOUR_PI}),
    Case("even", {"x": 0.0}, limit=1 / _FOUR_PI),
    call=lambda x, angle: LinearPhase(x).checked()(angle),
    x=Domain(-1.0, 1.0),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(LinearPhase)
extremes(
    Case("most", {"x": 1.0}, limit=(1, -1 / 3, 0), slope={"x": (0, -1 / 3, 0)}),
    part="moments",
    call=lambda x: LinearPhase(x).checked().moments(3, x[None]),
    x=Domain(-1.0, 1.0),
)(LinearPhase)


class LambertSphere(PhaseFunction):
    """A large white sphere that reflects by Lambert's law, without diffraction.

    With a = the phase angle, 2 / (3 pi^2) (sin a + (pi - a) cos a); its mean cosine is -4/9.
    """

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        return (2 / (3 * math.pi**2) * _sine_less_angle_cosine(angle))[..., None]

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments 1, -4/9, then only the even ones, in closed form."""
        return jnp.asarray(_lambert_moments(count)[:, None], wavelength_nm.dtype)


extremes(
    Case("new moon", {"angle": 0.0}, limit=0.0, slope={"angle": 0.0}),
    Case("thin crescent", {"angle": 2.0**-10}, 2 / (9 * math.pi**2) * 2.0**-30, rtol=1e-6),
    Case("half moon", {"angle": math.pi / 2}, limit=2 / (3 * math.pi**2)),
    Case("full moon", {"angle": math.pi}, limit=2 / (3 * math.pi)),
    call=lambda angle: LambertSphere()(angle),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(LambertSphere)
extremes(
    Case("always", {}, limit=(1, -4 / 9, 1 / 16, 0)),
    part="moments",
    derivative="none",
    call=lambda wavelength: LambertSphere().moments(4, wavelength[None]),
    wavelength=Span(100.0, 10000.0),
)(LambertSphere)


class PhaseSum(PhaseFunction):
    """A weighted mean of phase functions, for a mixture of particles.

    Attributes:
        weights: Share of each part in the scattered light [-], 0 to 1, that add to 1.
        parts: The phase functions; sums may stand in sums.
    """

    weights: Float[Array, " part"] = eqx.field(converter=real_array)
    parts: tuple[PhaseFunction, ...] = eqx.field(converter=tuple)

    def __check_init__(self) -> None:
        """Check the number of weights, and the weights where they are known."""
        if not self.parts or self.weights.shape != (len(self.parts),):
            raise ValueError(
                f"weights must be one for each of the {len(self.parts)} parts, at least 1, "
                f"got the shape {self.weights.shape}"
            )
        if not is_traced(self.weights):
            in_range("weights", self.weights, 0.0, 1.0)
            total = float(np.sum(np.asarray(self.weights, float)))
            if abs(total - 1) > _SUM_SLACK:
                raise ValueError(f"weights must add to 1, got {total:.6g}")

    def at_wavelengths(self, angle: Reals, wavelength_nm: Float[Array, " w"]) -> Reals:
        """Phase function [1/sr]."""
        return self._mix([part.at_wavelengths(angle, wavelength_nm) for part in self.parts])

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments: the weighted mean of the parts'."""
        return self._mix([part.moments(count, wavelength_nm) for part in self.parts])

    def checked(self) -> "PhaseSum":
        """Refuse impossible parts and weights; traced weights that do not add to 1 become NaN."""
        weights = in_range("weights", self.weights, 0.0, 1.0)
        right = jnp.abs(jnp.sum(weights) - 1) <= _SUM_SLACK
        weights = jnp.where(right, weights, jnp.nan)
        return eqx.tree_at(
            lambda mixture: (mixture.weights, mixture.parts),
            self,
            (weights, tuple(part.checked() for part in self.parts)),
        )

    def _mix(self, values: list[Reals]) -> Reals:
        return sum(
            (weight * value for weight, value in zip(self.weights, values, strict=True)),
            start=jnp.zeros((1,) * values[0].ndim, values[0].dtype),
        )


def _two_lobes(share: Scalar, g: Scalar) -> PhaseSum:
    return PhaseSum(jnp.stack([share, 1 - share]), (HenyeyGreenstein(g), HenyeyGreenstein(-g)))


extremes(
    Case("one alone", {"share": 1.0, "g": 0.5, "angle": 0.0}, limit=6 / _FOUR_PI),
    Case("even", {"g": 0.0}, limit=1 / _FOUR_PI),
    call=lambda share, g, angle: _two_lobes(share, g).checked()(angle),
    share=Domain(0.0, 1.0),
    g=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(PhaseSum)
extremes(
    Case("balanced", {"share": 0.5, "g": 0.5}, limit=(1, 0, 0.25, 0)),
    part="moments",
    call=lambda share, g: _two_lobes(share, g).checked().moments(4, g[None]),
    share=Domain(0.0, 1.0),
    g=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
)(PhaseSum)


def henyey_greenstein_of_phase_angle(g: RealsLike) -> HenyeyGreenstein:
    """Henyey-Greenstein in Blinn's convention, where g > 0 scatters back toward the light.

    Args:
        g: Mean cosine of the phase angle [-], -0.999 to 0.999, a number.

    Returns:
        The same with the asymmetry of the scattering angle, -g.

    Raises:
        ValueError: A known g is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 3.5, with the numerator and the exponent
        that the printed formula lost.
    """
    return HenyeyGreenstein(-in_range("g", g, -_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY))


extremes(
    Case("back", {"g": 0.5, "angle": math.pi}, limit=6 / _FOUR_PI),
    call=lambda g, angle: henyey_greenstein_of_phase_angle(g)(angle),
    g=Domain(-_LARGEST_ASYMMETRY, _LARGEST_ASYMMETRY),
    angle=Domain(0.0, math.pi),
    least=0.0,
)(henyey_greenstein_of_phase_angle)


def furnace_slag_phase() -> HenyeyGreenstein:
    """Dark rough surfaces such as furnace slag: g = 0.325 of the phase angle (Blinn 1982, 3.5)."""
    return henyey_greenstein_of_phase_angle(0.325)


def saturn_ring_phase() -> PhaseSum:
    """Particles of Saturn's rings: 0.596 of a back-scattering lobe, 0.404 of a forward one.

    References:
        Esposito and Lumme (1977), Icarus 31, 157, as quoted by Blinn (1982), section 3.7, where
        the second lobe's sign and point were lost.
    """
    lobes = tuple(henyey_greenstein_of_phase_angle(g) for g in (0.5, -0.5))
    return PhaseSum(np.array([0.596, 0.404]), lobes)


for _preset, _behind in (
    (furnace_slag_phase, (1 - 0.325**2) / (1 - 0.325) ** 3),
    (saturn_ring_phase, 0.596 * 6 + 0.404 * 0.75 / 1.5**3),
):
    extremes(
        Case("back", {"angle": math.pi}, limit=_behind / _FOUR_PI),
        call=lambda angle, _preset=_preset: _preset()(angle),
        angle=Domain(0.0, math.pi),
    )(_preset)


def _sine_less_angle_cosine(x: Reals) -> Reals:
    """Sin x - x cos x for x >= 0; its terms cancel near 0, where it is x^3 / 3."""
    near = x < _SERIES_TO
    small = jnp.where(near, x, 0.0)
    square, series = small * small, jnp.zeros_like(x)
    for coefficient in reversed(_SERIES):
        series = series * square + coefficient
    return jnp.where(near, series * square * small, jnp.sin(x) - x * jnp.cos(x))


def _lambert_moments(count: int) -> np.ndarray:
    """Legendre moments of the Lambert sphere.

    Its second derivative in the cosine mu is 1 / sqrt(1 - mu^2), whose moments are known, and the
    double primitive of P_l is a sum of three P_k that vanishes with its slope at both ends.
    """
    moments = np.zeros(max(count, 2))
    moments[:2] = 1.0, -4 / 9
    degree = np.arange(2, count, 2)
    ratio = np.cumprod(np.concatenate([[1.0], 1 - 1 / np.arange(2.0, count + 4, 2)]))
    known = math.pi * ratio**2  # of P_0, P_2, P_4, ...
    place = degree // 2
    moments[degree] = (4 / (3 * math.pi)) * (
        known[place + 1] / ((2 * degree + 1) * (2 * degree + 3))
        - 2 * known[place] / ((2 * degree - 1) * (2 * degree + 3))
        + known[place - 1] / ((2 * degree + 1) * (2 * degree - 1))
    )
    return moments[:count]
