"""A density that is exponential in each of a few layers, with columns in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.checks import in_range, is_traced
from atmofit.constants import LARGEST_SCALE_HEIGHT, SMALLEST_SCALE_HEIGHT
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import chapman_factors, safe_sqrt
from atmofit.optics.profiles import DensityProfile
from atmofit.typing import Reals, Scalar, real_array

# In t = 2 / (2 + x); least squares with weights that make the largest relative error smallest.
_SLOPE_POLYNOMIAL = (
    1.000018,
    0.997361,
    0.8118859,
    -0.2865356,
    1.829935,
    -5.272035,
    3.333084,
    -0.6412275,
)
_LOG_ABOVE_TOP = -14.0  # of the share of the column above the top, 8e-7


class ExponentialLayers(DensityProfile):
    """Density that is continuous and exponential in every layer.

    A sum of exponentials cannot take its place: real air's density falls faster the higher, up
    to the tropopause, which takes large weights of both signs: six leave 6 % of error.

    Attributes:
        base: Altitude where each layer begins [m]: 0, then increasing, to 1,000,000. The last
            layer has no end.
        scale_height: Of each layer [m], 1 to 30,000.
    """

    base: Float[Array, " layer"] = eqx.field(converter=real_array)
    scale_height: Float[Array, " layer"] = eqx.field(converter=real_array)

    def __check_init__(self) -> None:
        """Check the shapes, and the altitudes where they are known."""
        base = self.base
        if base.ndim != 1 or base.shape != self.scale_height.shape or base.size == 0:
            raise ValueError(
                "base and scale_height must be two lists of one length that is not 0, "
                f"got shapes {base.shape} and {self.scale_height.shape}"
            )
        if not is_traced(base):
            known = np.asarray(base)
            in_range("base", known, 0.0, 1e6, "m")
            if known[0] != 0:
                raise ValueError(f"base must begin with 0 m, got {known[0]:.6g}")
            if (np.diff(known) <= 0).any():
                raise ValueError("base must increase from layer to layer")

    def checked(self) -> "ExponentialLayers":
        """Refuse scale heights outside 1 m to 30 km, and bases that do not increase."""
        low, high = SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT
        base = in_range("base", self.base, 0.0, 1e6, "m")
        if is_traced(base):  # known ones were checked when made
            good = jnp.append(base[0] == 0, jnp.diff(base) > 0)
            base = jnp.where(good, base, jnp.nan)
        return ExponentialLayers(base, in_range("scale_height", self.scale_height, low, high, "m"))

    @property
    def top(self) -> Scalar:
        """Altitude with 8e-7 of the column above, or where the last layer begins [m]."""
        last = self._at_bases()[-1] * self.scale_height[-1] / self._total()
        log_share = jnp.log(jnp.maximum(last, jnp.finfo(last.dtype).tiny))
        return self.base[-1] + self.scale_height[-1] * jnp.maximum(log_share - _LOG_ABOVE_TOP, 0.0)

    @property
    def scale(self) -> Scalar:
        """Vertical column over the density at the ground [m]."""
        return self._total()

    def density(self, altitude: Reals) -> Reals:
        """Density over vertical column [1/m]."""
        return self._relative(altitude, self._layer(altitude)) / self._total()

    def vertical_column(self, altitude: Reals) -> Reals:
        """Share of the vertical column above an altitude [-]."""
        layer = self._layer(altitude)
        here = self._relative(altitude, layer) * self.scale_height[layer]

        def add_level(total: Reals, level: tuple[Scalar, ...]) -> tuple[Reals, None]:
            height, density, below, above = level
            return total + jnp.where(height > altitude, density * (above - below), 0.0), None

        return jax.lax.scan(add_level, here, self._levels())[0] / self._total()

    def rising_column(self, altitude: Reals, cosine: Reals, radius: float) -> Reals:
        """Column over vertical column [-] along a ray that rises to space through shells.

        The column as if the first layer had no end; then, at each level above, what the next
        layer has in place of the layer below: the slope by the root of the scale height, at the
        mean root, which is exact for vertical and for level rays. Relative error below 1e-4 for
        real air, and where the scale height changes to 3/4, 1/2 or 1/4 at one level 1.4e-4,
        2.5e-3 and 2.9e-2 at worst (against quadrature).
        """
        layer, start = self._layer(altitude), radius + altitude
        slant = _slant(self.scale_height[layer], start, cosine)
        here = self._relative(altitude, layer) * slant

        # One level at a time: all at once, in a new axis, take three times as long.
        def add_level(total: Reals, level: tuple[Scalar, ...]) -> tuple[Reals, None]:
            height, density, below, above = level
            root, step = (jnp.sqrt(above) + jnp.sqrt(below)) / 2, jnp.sqrt(above) - jnp.sqrt(below)
            there = radius + height
            rise = jnp.maximum(height - altitude, 0.0)
            along = safe_sqrt((start * cosine) ** 2 + rise * (2 * start + rise))
            slope = _slope(along / (jnp.sqrt(2 * there) * root), root**2 / there)
            change = density * jnp.sqrt(there / 2) * step * slope
            return total + jnp.where(rise > 0, change, 0.0), None

        return jax.lax.scan(add_level, here, self._levels())[0] / self._total()

    def _layer(self, altitude: Reals) -> Int[Array, "..."]:
        """Index of the layer that an altitude lies in."""
        return jnp.searchsorted(self.base[1:], altitude, side="right", method="compare_all")

    def _at_bases(self) -> Float[Array, " layer"]:
        """Density where the layers begin, over that at the ground."""
        fall = jnp.cumsum(jnp.diff(self.base) / self.scale_height[:-1])
        return jnp.exp(-jnp.concatenate([jnp.zeros_like(self.base[:1]), fall]))

    def _relative(self, altitude: Reals, layer: Int[Array, "..."]) -> Reals:
        """Density over that at the ground."""
        rise = altitude - self.base[layer]
        return self._at_bases()[layer] * jnp.exp(-rise / self.scale_height[layer])

    def _total(self) -> Scalar:
        """Vertical column over the density at the ground [m]."""
        within = -jnp.expm1(-jnp.diff(self.base) / self.scale_height[:-1])
        share = jnp.append(within, jnp.ones_like(self.base[0]))
        return (self._at_bases() * self.scale_height * share).sum()

    def _levels(self) -> tuple[Reals, Reals, Reals, Reals]:
        """Altitudes between layers, density there, scale heights below and above."""
        below, above = self.scale_height[:-1], self.scale_height[1:]
        return self.base[1:], self._at_bases()[1:], below, above


def _slope(x: Reals, curvature: Scalar) -> Reals:
    """Slope of `_slant` by the root of the scale height, over sqrt(radius / 2).

    Args:
        x: cosine sqrt(radius / (2 scale height)), at least 0.
        curvature: Scale height over radius.

    Returns:
        (1 - 2 x^2) G(x) + 2 x with G(x) = sqrt(pi) erfcx(x), by a polynomial that is nearest to
        it (relative error 2e-5); times the curvature's correction, which is exact to first order
        for vertical and for level rays.
    """
    t = 2 / (2 + x)
    total = jnp.zeros_like(t)
    for coefficient in reversed(_SLOPE_POLYNOMIAL):
        total = total * t + coefficient
    return t * total * (1 + (2 - 0.875 * t) * curvature)


def _slant(scale_height: Reals, radius: Reals, cosine: Reals) -> Reals:
    """Column to space, over the density at its start, of an exponential along a rising ray [m].

    As `Exponential.rising_column`.
    """
    half = radius / (2 * scale_height)
    root = jnp.sqrt(half)
    leading, correction = chapman_factors(cosine * root)
    return scale_height * root * (leading + correction / (2 * half))


extremes(
    Case("at a level", {"altitude": 5e3, "cosine": 0.0}),
    Case("one exponential", {"scale_height": (8e3, 8e3, 8e3), "altitude": 0.0, "cosine": 1.0}),
    Case("far above", {"scale_height": (1.0, 1.0, 1.0), "altitude": 1e6}),
    Case("thin above thick", {"scale_height": (3e4, 1.0, 3e4), "altitude": 5e3}),
    call=lambda scale_height, altitude, cosine: _everything(scale_height, altitude, cosine),
    derivative="forward",
    scale_height=Domain((SMALLEST_SCALE_HEIGHT,) * 3, (LARGEST_SCALE_HEIGHT,) * 3),
    altitude=Span(0.0, 1e6),
    cosine=Span(0.0, 1.0),
    least=0.0,
)(ExponentialLayers)


def _everything(
    scale_height: Float[Array, " layer"], altitude: Reals, cosine: Reals
) -> tuple[Reals, ...]:
    """Density, columns and ends: what the stability table looks at."""
    profile, radius = ExponentialLayers((0.0, 5e3, 2e4), scale_height).checked(), 6371e3
    return (
        profile.density(altitude),
        profile.vertical_column(altitude),
        profile.level_column(altitude, radius),
        profile.rising_column(altitude, cosine, radius),
        profile.top,
        profile.scale,
    )
