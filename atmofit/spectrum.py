"""Quantities that vary with wavelength."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

_SLACK = 1e-6  # the rounding of float32, since nodes or wavelengths may have been rounded


class Spectrum(eqx.Module):
    """A quantity given at some wavelengths, linear in between.

    Attributes:
        wavelength_nm: Increasing [nm].
        values: The quantity there, in its own unit.
        smooth: A promise that the curve has no edges or lines, so that a radiance that depends on
            it may be interpolated between a few wavelengths. Static.
    """

    wavelength_nm: Float[Array, " n"] = eqx.field(converter=real_array)
    values: Float[Array, " n"] = eqx.field(converter=real_array)
    smooth: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        """Check the shapes, and the values where they are known."""
        wavelength, values = self.wavelength_nm, self.values
        if wavelength.ndim != 1 or wavelength.shape != values.shape or wavelength.size == 0:
            raise ValueError(
                "wavelength_nm and values must be two lists of one length that is not 0, "
                f"got shapes {wavelength.shape} and {values.shape}"
            )
        if not is_traced(wavelength):
            check_wavelengths(np.asarray(wavelength))
        if not is_traced(values) and not np.isfinite(np.asarray(values)).all():
            bad = np.asarray(values)[~np.isfinite(np.asarray(values))]
            raise ValueError(f"values must be finite, got {bad[0]} ({bad.size} of {values.size})")

    def __call__(self, wavelength_nm: RealsLike) -> Reals:
        """The quantity at other wavelengths inside the range of the nodes.

        Args:
            wavelength_nm: Any shape [nm].

        Returns:
            The quantity, shape and dtype of `wavelength_nm`. NaN where a traced wavelength lies
            outside the range.

        Raises:
            ValueError: A known wavelength lies outside the range.
        """
        nodes, values = self.wavelength_nm, self.values
        if is_traced(nodes):
            inside = real_array(wavelength_nm)
            low, high = nodes[0].astype(inside.dtype), nodes[-1].astype(inside.dtype)
            within = (inside >= low * (1 - _SLACK)) & (inside <= high * (1 + _SLACK))
            inside = jnp.where(within, inside, jnp.nan)
        else:
            known = np.asarray(nodes)  # indexing a JAX array would trace it under jit
            low, high = float(known[0]), float(known[-1])
            inside = in_range("wavelength_nm", wavelength_nm, low, high, "nm", slack=_SLACK * high)
        return jnp.interp(inside, nodes.astype(inside.dtype), values.astype(inside.dtype))


extremes(
    Case("at a node", {"values": (1.0, 3.0, 2.0), "wavelength_nm": 500.0}, limit=3.0),
    Case("between", {"values": (1.0, 3.0, 2.0), "wavelength_nm": 450.0}, limit=2.0),
    call=lambda values, wavelength_nm: Spectrum((400.0, 500.0, 700.0), values)(wavelength_nm),
    values=Span((-1e30,) * 3, (1e30,) * 3),
    wavelength_nm=Domain(400.0, 700.0),
)(Spectrum)


def at(quantity: RealsLike | Spectrum, wavelength_nm: RealsLike) -> Reals:
    """A quantity that may vary with wavelength, at the given wavelengths.

    Args:
        quantity: A `Spectrum`, or a number or 0-d array that holds at every wavelength.
        wavelength_nm: Any shape [nm].

    Returns:
        The quantity, shape and dtype of `wavelength_nm`.
    """
    if isinstance(quantity, Spectrum):
        return quantity(wavelength_nm)
    wavelength = real_array(wavelength_nm)
    return jnp.broadcast_to(scalar(quantity).astype(wavelength.dtype), wavelength.shape)


def spectral(value: Any) -> Scalar | Spectrum:
    """Keep a `Spectrum`, turn a number into a 0-d array; the converter of fields."""
    return value if isinstance(value, Spectrum) else scalar(value)


def checked_spectral(
    name: str, quantity: Scalar | Spectrum, low: float, high: float
) -> Scalar | Spectrum:
    """Refuse values outside [low, high], as `in_range` does; a `Spectrum` in all its values."""
    if isinstance(quantity, Spectrum):
        values = in_range(name, quantity.values, low, high)
        return Spectrum(quantity.wavelength_nm, values, quantity.smooth)
    return in_range(name, quantity, low, high)


def all_smooth(*quantities: object) -> bool:
    """Whether every `Spectrum` among the quantities promises to be smooth."""
    return all(q.smooth for q in quantities if isinstance(q, Spectrum))


def check_wavelengths(wavelength_nm: np.ndarray) -> None:
    """Refuse known wavelengths that are not finite, positive and increasing."""
    if not (np.isfinite(wavelength_nm).all() and (wavelength_nm > 0).all()):
        bad = wavelength_nm[~(np.isfinite(wavelength_nm) & (wavelength_nm > 0))]
        raise ValueError(f"wavelength_nm must be positive and finite, got {bad[0]}")
    falls = np.flatnonzero(np.diff(wavelength_nm) <= 0)
    if falls.size:
        first, second = wavelength_nm[falls[0] : falls[0] + 2]
        raise ValueError(f"wavelength_nm must increase, got {second:.6g} after {first:.6g}")
