"""Sky models made of parts: a shape, its dependence on air, sun and ground, and what they give."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range
from atmofit.colour import XYZ_to_linear_sRGB, XYZ_to_xyY
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.models.cie import CIEShape
from atmofit.models.dependence import Dependence
from atmofit.models.shapes import Shape
from atmofit.spectrum import Spectrum, check_wavelengths
from atmofit.sun import irradiance_at
from atmofit.typing import Reals, RealsLike, Scalar, real_array

AnyShape = Shape | CIEShape
COLOURS = ("X", "Y", "Z")
DEFAULT_ALBEDO = 0.2
Matrix = Array | np.ndarray


def _matrix(value: Any) -> Float[Matrix, "..."]:
    """A floating-point array; NumPy stays NumPy, so that a model can be made at import."""
    return value if isinstance(value, jax.Array) else np.asarray(value, float)


class SkyModel(eqx.Module):
    """An analytic sky: a shape whose numbers depend on turbidity, sun and ground albedo.

    Each channel has numbers of its own: spectral ones are radiance over the sun's irradiance
    [sr^-1], colours are X, Y and Z [cd m^-2] under the standard sun. Every channel is positive.

    Attributes:
        coefficients: Of each free number of the shape in the basis of the dependence.
        shape: How light is spread over a sky.
        dependence: How a sky's free numbers depend on turbidity, sun and albedo.
        wavelength_nm: Of the spectral channels, increasing [nm]; may be empty. Static.
        colours: Whether X, Y and Z follow the spectral channels. Static.
    """

    coefficients: Float[Matrix, "channel number basis"] = eqx.field(converter=_matrix)
    shape: AnyShape
    dependence: Dependence
    wavelength_nm: tuple[float, ...] = eqx.field(static=True, default=())
    colours: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        """Check that the parts fit together."""
        if self.wavelength_nm:
            check_wavelengths(np.asarray(self.wavelength_nm))
        channels = len(self.wavelength_nm) + len(COLOURS) * self.colours
        expected = (channels, len(self.shape.names), self.dependence.size)
        if channels == 0 or self.coefficients.shape != expected:
            raise ValueError(
                f"coefficients must have shape [channel, number, basis] = {expected} with at least "
                f"one channel, got {self.coefficients.shape}"
            )

    @property
    def turbidity_range(self) -> tuple[float, float]:
        """Where the model is valid."""
        return self.dependence.turbidity_range

    def only(self, channels: str) -> "SkyModel":
        """The same model with fewer channels.

        Args:
            channels: "colours", "wavelengths" or "all".

        Raises:
            ValueError: An unknown word, or channels that the model lacks.
        """
        choice("channels", channels, ("colours", "wavelengths", "all"))
        count = len(self.wavelength_nm)
        if channels == "colours":
            parts = (self.coefficients[count:], (), self.colours)
        elif channels == "wavelengths":
            parts = (self.coefficients[:count], self.wavelength_nm, False)
        else:
            return self
        coefficients, wavelength_nm, colours = parts
        return SkyModel(coefficients, self.shape, self.dependence, wavelength_nm, colours)

    def __call__(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        albedo: RealsLike = DEFAULT_ALBEDO,
    ) -> Reals:
        """Chromaticity and luminance of the sky.

        Args:
            turbidity: Inside `turbidity_range`; a scalar.
            solar_zenith_angle: 0 to that of the dependence's latest sun [rad]; a scalar.
            directions: On or above the horizon.
            albedo: Of the ground, 0 to that of the dependence's largest; a scalar.

        Returns:
            x, y and Y [cd m^-2] on a last axis of 3 after the axes of the directions, in their
            dtype. NaN where a traced argument is out of range.

        Raises:
            ValueError: A known argument is out of range, or the model has no colours.
        """
        return XYZ_to_xyY(self.XYZ(turbidity, solar_zenith_angle, directions, albedo))

    def XYZ(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        albedo: RealsLike = DEFAULT_ALBEDO,
    ) -> Reals:
        """Tristimulus values [cd m^-2] on a last axis of 3; the arguments are those of a call."""
        if not self.colours:
            raise ValueError("colours must be True for a model that is asked for them, got False")
        first = len(self.wavelength_nm)
        return self._values(turbidity, solar_zenith_angle, directions, albedo, first, first + 3)

    def linear_sRGB(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        albedo: RealsLike = DEFAULT_ALBEDO,
    ) -> Reals:
        """Linear sRGB [cd m^-2] on a last axis of 3; the arguments are those of a call.

        Blue skies lie outside the triangle of sRGB: red may be negative, and is not clipped.
        """
        return XYZ_to_linear_sRGB(self.XYZ(turbidity, solar_zenith_angle, directions, albedo))

    def radiance(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        wavelength_nm: RealsLike,
        albedo: RealsLike = DEFAULT_ALBEDO,
        solar_irradiance: RealsLike | Spectrum | None = None,
    ) -> Reals:
        """Spectral radiance of the sky.

        The logarithm of radiance over irradiance is linear between the model's wavelengths.

        Args:
            turbidity: As in a call, like the next two and albedo.
            solar_zenith_angle: [rad].
            directions: On or above the horizon.
            wavelength_nm: A list inside the model's wavelengths [nm].
            albedo: Of the ground.
            solar_irradiance: A number, one for each wavelength, or a `Spectrum`
                [W m^-2 nm^-1]; 1 gives sr^-1. None: ASTM G-173.

        Returns:
            [W m^-2 sr^-1 nm^-1], wavelength on the last axis.

        Raises:
            ValueError: A known argument is out of range, or the model has no wavelengths.
        """
        nodes = np.asarray(self.wavelength_nm)
        if nodes.size == 0:
            raise ValueError("wavelength_nm must be empty for a model without spectral channels")
        λ = in_range("wavelength_nm", wavelength_nm, float(nodes[0]), float(nodes[-1]), "nm")
        if λ.ndim != 1:
            raise ValueError(f"wavelength_nm must be a list, got shape {λ.shape}")
        values = self._values(turbidity, solar_zenith_angle, directions, albedo, 0, nodes.size)
        λ = λ.astype(values.dtype)
        hats = jax.vmap(lambda row: jnp.interp(λ, jnp.asarray(nodes, λ.dtype), row))
        weights = hats(jnp.eye(nodes.size, dtype=λ.dtype))
        sun = irradiance_at(λ, solar_irradiance, "standard")
        logs = jnp.tensordot(jnp.log(values), weights, 1)
        return jnp.exp(logs) * sun.astype(logs.dtype).reshape((1,) * (logs.ndim - 1) + (-1,))

    def _values(
        self,
        turbidity: RealsLike,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        albedo: RealsLike,
        first: int,
        end: int,
    ) -> Reals:
        """Some channels, on a last axis; no others are computed."""
        view, azimuth = directions.angles()
        view = angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
        azimuth = in_range("relative_azimuth", azimuth, -np.inf, np.inf).astype(view.dtype)
        T, s, a = self._checked(turbidity, solar_zenith_angle, albedo)
        coefficients = real_array(self.coefficients[first:end]).astype(view.dtype)
        T, s, a = (x.astype(view.dtype) for x in (T, s, a))
        return _sky(self.shape, self.dependence, coefficients, T, s, a, view, azimuth)

    def _checked(
        self, turbidity: RealsLike, solar_zenith_angle: RealsLike, albedo: RealsLike
    ) -> tuple[Reals, Reals, Reals]:
        d = self.dependence
        T = in_range("turbidity", turbidity, *d.turbidity_range)
        latest = float(np.radians(d.latest_sun_deg))
        s = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, latest)
        a = in_range("albedo", albedo, 0.0, d.largest_albedo)
        for name, value in (("turbidity", T), ("solar_zenith_angle", s), ("albedo", a)):
            if value.ndim != 0:
                raise ValueError(f"{name} must be one number, got shape {value.shape}")
        return T, s, a


@eqx.filter_jit
def _sky(
    shape: AnyShape,
    dependence: Dependence,
    coefficients: Float[Array, "channel number basis"],
    turbidity: Scalar,
    sun: Scalar,
    albedo: Scalar,
    view: Reals,
    azimuth: Reals,
) -> Reals:
    """The jitted kernel: channels on the last axis."""
    numbers = jnp.tensordot(coefficients, dependence(turbidity, sun, albedo), 1)
    γ = scattering_angle(view, azimuth, sun)
    values = jax.vmap(shape, in_axes=(0, None, None))(numbers, jnp.cos(view), γ)
    return jnp.moveaxis(values, 0, -1)
