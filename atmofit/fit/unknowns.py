"""What may be unknown of a sky: names, ranges, and the way from free variables to values."""

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from atmofit.checks import in_range
from atmofit.typing import RealsLike, Scalar, scalar


@dataclasses.dataclass(frozen=True)
class Unknown:
    """A number of the air, ground or sun that a fit may search for.

    Attributes:
        low: Least value that is searched.
        high: Largest.
        start: Where the search begins, and the value that is taken where it is not searched.
        typical_slope: Of the logarithm of a sky, over the whole range; only sets the first steps.
        in_logarithm: Whether the search goes in even ratios.
        unit: For tables.
    """

    low: float
    high: float
    start: float
    typical_slope: float
    in_logarithm: bool = False
    unit: str = "-"


UNKNOWNS: Mapping[str, Unknown] = MappingProxyType(
    {
        "turbidity": Unknown(1.0, 30.0, 3.0, 0.6, in_logarithm=True),
        "angstrom_exponent": Unknown(-0.5, 3.0, 1.3, 0.1),
        "single_scattering_albedo": Unknown(0.5, 1.0, 0.925, 0.3),
        "asymmetry": Unknown(0.3, 0.9, 0.703, 0.5),
        "scale_height": Unknown(300.0, 6e3, 1.2e3, 0.05, in_logarithm=True, unit="m"),
        "ozone_dobson": Unknown(0.0, 600.0, 300.0, 0.05, unit="DU"),
        "albedo": Unknown(0.0, 1.0, 0.2, 0.3),
        "solar_zenith_angle": Unknown(0.0, math.pi / 2, 1.0, 3.0, unit="rad"),
        "solar_azimuth": Unknown(-math.pi / 3, math.pi / 3, 0.0, 3.0, unit="rad"),
    }
)


class Search(eqx.Module):
    """Which unknowns are searched for, in which ranges, and the values of the others.

    Attributes:
        low: Of each free unknown, like the next two.
        high: Largest value.
        start: Where the search begins.
        given: Values of the unknowns that are not searched for.
        prior_mean: Of a normal prior, of the value or, in logarithm, of its logarithm.
        prior_width: Its standard deviation; infinite: no prior.
        names: Of the free unknowns, turbidity first. Static.
    """

    low: Float[Array, " p"]
    high: Float[Array, " p"]
    start: Float[Array, " p"]
    given: dict[str, Scalar]
    prior_mean: Float[Array, " p"]
    prior_width: Float[Array, " p"]
    names: tuple[str, ...] = eqx.field(static=True)

    def value(self, x: Float[Array, " p"]) -> Float[Array, " p"]:
        """Values of the free unknowns at x in [-1, 1]."""
        share = (1 + x) / 2
        evenly = self.low + (self.high - self.low) * share
        ratio = jnp.log(jnp.where(self.in_logarithm, self.high / self._safe_low, 1.0))
        in_ratio = self._safe_low * jnp.exp(ratio * share)
        # Rounding must not leave the range.
        return jnp.clip(jnp.where(self.in_logarithm, in_ratio, evenly), self.low, self.high)

    def place(self, value: Float[Array, " p"]) -> Float[Array, " p"]:
        """Where in [-1, 1] some values lie, the inverse of `value`."""
        value = jnp.clip(value, self.low, self.high)
        ratio = jnp.log(jnp.where(self.in_logarithm, self.high / self._safe_low, 2.0))
        in_ratio = jnp.log(jnp.where(self.in_logarithm, value / self._safe_low, 1.0)) / ratio
        evenly = (value - self.low) / (self.high - self.low)
        return 2 * jnp.where(self.in_logarithm, in_ratio, evenly) - 1

    def slope(self, x: Float[Array, " p"]) -> Float[Array, " p"]:
        """Derivatives of the values by x."""
        value = self.value(x)
        ratio = jnp.log(jnp.where(self.in_logarithm, self.high / self._safe_low, 1.0))
        return jnp.where(self.in_logarithm, value * ratio, self.high - self.low) / 2

    def all_values(self, x: Float[Array, " p"]) -> dict[str, Scalar]:
        """Every unknown by its name."""
        found = self.value(x)
        return self.given | {name: found[k] for k, name in enumerate(self.names)}

    def prior_residuals(self, x: Float[Array, " p"]) -> Float[Array, " p"]:
        """Distances from the prior's means in standard deviations; 0 without prior."""
        value = self.value(x)
        value = jnp.where(
            self.in_logarithm, jnp.log(jnp.where(self.in_logarithm, value, 1.0)), value
        )
        informed = jnp.isfinite(self.prior_width)
        width = jnp.where(informed, self.prior_width, 1.0)
        return jnp.where(informed, (value - self.prior_mean) / width, 0.0)

    @property
    def typical_slope(self) -> Float[Array, " p"]:
        """Of the logarithm of a sky by x."""
        slopes = [UNKNOWNS[name].typical_slope / 2 for name in self.names]
        return jnp.asarray(slopes, self.low.dtype)

    @property
    def in_logarithm(self) -> Bool[Array, " p"]:
        """Which unknowns are searched in even ratios."""
        return jnp.asarray([UNKNOWNS[name].in_logarithm for name in self.names])

    @property
    def _safe_low(self) -> Float[Array, " p"]:
        return jnp.where(self.in_logarithm, self.low, 1.0)


def make_search(
    free: tuple[str, ...],
    allowed: tuple[str, ...],
    *,
    ranges: Mapping[str, tuple[float, float]],
    values: Mapping[str, RealsLike],
    priors: Mapping[str, tuple[float, float]],
    dtype: jnp.dtype,
) -> Search:
    """Check what is asked for and put it together.

    Args:
        free: Names of the unknowns to search for; "turbidity" is among them.
        allowed: Names that the model has.
        ranges: That replace the unknowns' own, by name.
        values: Known values of the others, and starts of the free ones, by name.
        priors: Means and standard deviations by name; of the logarithm for unknowns that are
            searched in even ratios, where the second number is relative.
        dtype: Of the arrays.

    Raises:
        ValueError: A name that the model lacks, a value outside its range, a strange prior.
    """
    if "turbidity" not in free:
        raise ValueError(f'free must contain "turbidity", got {free}')
    if len(set(free)) < len(free):
        raise ValueError(f"free must name each unknown once, got {free}")
    for what, named in (("free", free), ("known", values), ("prior", priors)):
        for name in named:
            if name not in allowed:
                words = ", ".join(f'"{word}"' for word in allowed)
                raise ValueError(f"{what} may name {words} with this model, got {name!r}")
    strange = set(priors) - set(free)
    if strange:
        raise ValueError(f"prior must be of free unknowns, got {sorted(strange)}")
    order = ("turbidity", *(name for name in allowed if name in free and name != "turbidity"))
    limits = {name: ranges.get(name, (UNKNOWNS[name].low, UNKNOWNS[name].high)) for name in allowed}
    start = {name: _inside(name, values, limits[name]).astype(dtype) for name in allowed}
    informed = [_prior(name, priors.get(name)) for name in order]
    return Search(
        low=jnp.asarray([limits[name][0] for name in order], dtype),
        high=jnp.asarray([limits[name][1] for name in order], dtype),
        start=jnp.stack([start[name] for name in order]),
        given={name: start[name] for name in allowed if name not in free},
        prior_mean=jnp.asarray([mean for mean, _ in informed], dtype),
        prior_width=jnp.asarray([width for _, width in informed], dtype),
        names=order,
    )


def _inside(name: str, values: Mapping[str, Any], limits: tuple[float, float]) -> Scalar:
    """A given value, or the unknown's own start inside the limits."""
    if name not in values:
        return scalar(min(max(UNKNOWNS[name].start, limits[0]), limits[1]))
    value = in_range(name, values[name], *limits, slack=1e-6)
    if value.ndim != 0:
        raise ValueError(f"{name} must be one number, got shape {value.shape}")
    return value


def _prior(name: str, prior: tuple[float, float] | None) -> tuple[float, float]:
    if prior is None:
        return 0.0, math.inf
    mean, width = (float(number) for number in prior)
    in_logarithm = UNKNOWNS[name].in_logarithm
    if not (math.isfinite(mean) and width > 0 and (mean > 0 or not in_logarithm)):
        raise ValueError(
            f"prior of {name} must be a finite mean and a standard deviation above 0, got {prior}"
        )
    return (math.log(mean), width / mean) if in_logarithm else (mean, width)
