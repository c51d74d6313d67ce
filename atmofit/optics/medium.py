"""Optical properties of an atmosphere at given wavelengths."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.extremes import Domain, extremes
from atmofit.numerics import chebyshev_basis, legendre_to_chebyshev, safe_divide
from atmofit.optics.air import LARGEST_PRESSURE
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.gases import LARGEST_OZONE_DOBSON
from atmofit.optics.phase import PhaseFunction, forward_peak
from atmofit.optics.profiles import DensityProfile
from atmofit.spectrum import at
from atmofit.typing import Reals, Scalar

_PEAK_DEGREES = 128  # Legendre moments that resolve any forward peak met here


class Medium(eqx.Module):
    """An atmosphere's optical properties at chosen wavelengths; scatterers come first.

    Attributes:
        profiles: Density of each constituent.
        extinction: Vertical optical depth [-], [constituent, wavelength].
        scattering: The part of it that scatters, [scatterer, wavelength].
        phases: Phase function of each scatterer.
        wavelength_nm: [nm].
        ground_albedo: [wavelength], or None: black.
        peaks: Share of each scatterer's light in a forward peak that is set apart,
            [scatterer, wavelength], or None.
    """

    profiles: tuple[DensityProfile, ...]
    extinction: Float[Array, "constituent w"]
    scattering: Float[Array, "scatterer w"]
    phases: tuple[PhaseFunction, ...]
    wavelength_nm: Float[Array, " w"]
    ground_albedo: Float[Array, " w"] | None
    peaks: Float[Array, "scatterer w"] | None = None

    @property
    def top(self) -> Scalar:
        """Altitude above which nothing scatters [m], without slope: nodes are laid by it."""
        return jax.lax.stop_gradient(jnp.stack([p.top for p in self.scattering_profiles]).max())

    @property
    def scale(self) -> Scalar:
        """Altitude over which the densest constituent changes [m], without slope likewise."""
        return jax.lax.stop_gradient(jnp.stack([p.scale for p in self.scattering_profiles]).min())

    @property
    def scattering_profiles(self) -> tuple[DensityProfile, ...]:
        """Density of each scatterer."""
        return self.profiles[: len(self.phases)]

    def phase_functions(self, angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], ...]:
        """Scattering optical depth times phase function, [..., wavelength] for each scatterer."""
        return tuple(
            phase.at_wavelengths(angle, self.wavelength_nm) * _last_axis(scattering, angle.ndim)
            for phase, scattering in zip(self.phases, self.scattering, strict=True)
        )

    def moments(self, count: int, whole: bool = False) -> Float[Array, "scatterer degree w"]:
        """Scattering optical depth times the Legendre moments of each scatterer.

        Args:
            count: How many. Static.
            whole: Whether forward peaks that were set apart count. Static.
        """
        moments = self._phase_moments(count)
        if self.peaks is not None and not whole:
            moments = moments - self.peaks[:, None]
        return moments * self.scattering[:, None, :]

    def peaks_apart(self, degrees: int, unscattered: bool) -> "Medium":
        """Set apart the forward peaks that so many Legendre moments do not resolve.

        See `forward_peak`.

        Args:
            degrees: Legendre moments. Static.
            unscattered: Whether the light in the peaks counts as not scattered. Static.
        """
        if all(phase.degree is not None and phase.degree < degrees for phase in self.phases):
            return self
        peaks = forward_peak(jnp.moveaxis(self._phase_moments(degrees + 1), 1, -1))
        apart = eqx.tree_at(lambda m: m.peaks, self, peaks, is_leaf=lambda leaf: leaf is None)
        if not unscattered:
            return apart
        count = len(self.phases)
        extinction = self.extinction.at[:count].add(-peaks * self.scattering)
        return eqx.tree_at(lambda m: m.extinction, apart, extinction)

    def deflected(self, columns: Float[Array, "*s constituent"]) -> Reals | None:
        """Optical depth of the forward peaks on a path, [..., wavelength]; None without any.

        Args:
            columns: Over vertical columns, of each constituent.
        """
        if self.peaks is None:
            return None
        return columns[..., : len(self.phases)] @ (self.peaks * self.scattering)

    def smooth_phase_functions(
        self, cosine: Float[Array, "azimuth p"], degrees: int
    ) -> tuple[Float[Array, "azimuth w p"], ...]:
        """As `phase_functions`, from so many moments, without the forward peaks.

        Args:
            cosine: Of the scattering angle.
            degrees: Legendre moments. Static.

        Returns:
            For each scatterer.
        """
        basis = _legendre_series(cosine, degrees)
        functions = []
        for c, phase in enumerate(self.phases):
            # Not yet for every wavelength, where they do not depend on it.
            moments = phase.moments(degrees, self.wavelength_nm)
            value = jnp.moveaxis(jnp.tensordot(moments.T, basis, (1, -1)), 0, -2)
            if self.peaks is not None:
                even = basis.sum(axis=-1)[:, None, :]
                value = value - self.peaks[c][None, :, None] * even
            functions.append(value * self.scattering[c][None, :, None])
        return tuple(functions)

    def deflected_phase_functions(self, angle: Reals, degrees: int) -> tuple[Reals, ...]:
        """As `phase_functions`, of light that a forward peak deflects before or after.

        Two scatterings have the moments beta_l^2; without peaks they have (beta_l - peak)^2.
        What is between them belongs to light scattered once with the peak's share of each other
        scattering: beta_l - peak / 2 below the last degree and beta_l^2 / (2 peak) beyond it.

        Args:
            angle: Scattering angle [rad].
            degrees: Legendre moments that resolve the rest. Static.
        """
        whole = self.phase_functions(angle)
        if self.peaks is None:
            return whole
        moments, peaks = self._phase_moments(_PEAK_DEGREES), self.peaks[:, None]
        beyond = moments * (1 - jnp.clip(safe_divide(moments, peaks), -1.0, 1.0) / 2)
        below = jnp.asarray(np.arange(_PEAK_DEGREES) < degrees)[None, :, None]
        excess = jnp.where(below, peaks / 2, beyond) * self.scattering[:, None]
        basis = _legendre_series(jnp.cos(angle), _PEAK_DEGREES)
        return tuple(
            full if phase.degree is not None else jnp.maximum(full - basis @ part, 0.0)
            for phase, full, part in zip(self.phases, whole, excess, strict=True)
        )

    def _phase_moments(self, count: int) -> Float[Array, "scatterer degree w"]:
        shape = (count, self.wavelength_nm.size)
        return jnp.stack(
            [jnp.broadcast_to(p.moments(count, self.wavelength_nm), shape) for p in self.phases]
        )


def optical_properties(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"]) -> Medium:
    """Evaluate every constituent at the wavelengths.

    Args:
        atmosphere: At least one constituent must scatter.
        wavelength_nm: [nm].
    """
    profiles: list[DensityProfile] = []
    extinction, scattering, phases = [], [], []
    if atmosphere.molecules is not None:
        depth = atmosphere.molecules.optical_depth_at(wavelength_nm)
        profiles.append(atmosphere.molecules.density_profile())
        extinction.append(depth)
        scattering.append(depth)
        phases.append(atmosphere.molecules.phase())
    if atmosphere.haze is not None:
        depth = atmosphere.haze.optical_depth_at(wavelength_nm)
        profiles.append(atmosphere.haze.density_profile())
        extinction.append(depth)
        scattering.append(depth * at(atmosphere.haze.single_scattering_albedo, wavelength_nm))
        phases.append(atmosphere.haze.phase)
    for gas in atmosphere.absorbers:
        profiles.append(gas.density_profile())
        extinction.append(gas.optical_depth_at(wavelength_nm))
    ground = atmosphere.ground
    return Medium(
        tuple(profiles),
        jnp.stack(extinction),
        jnp.stack(scattering),
        tuple(phases),
        wavelength_nm,
        None if ground is None else at(ground.albedo, wavelength_nm),
    )


def _legendre_series(cosine: Reals, count: int) -> Reals:
    """(2 l + 1) / (4 pi) P_l of the cosine, l from 0 to count - 1 on a new last axis."""
    odd = (2 * np.arange(count) + 1) / (4 * math.pi)
    to_chebyshev = legendre_to_chebyshev(count) * odd[None, :]
    return chebyshev_basis(cosine, count) @ jnp.asarray(to_chebyshev, cosine.dtype)


def _last_axis(values: Float[Array, " w"], axes_before: int) -> Float[Array, "..."]:
    return values.reshape((1,) * axes_before + values.shape)


extremes(
    part="from_turbidity",
    call=lambda turbidity, wavelength_nm: (
        optical_properties(
            Atmosphere.from_turbidity(turbidity).checked(), wavelength_nm[None]
        ).scattering
    ),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    wavelength_nm=Domain(380.0, 780.0),
)(Atmosphere)
extremes(
    part="standard",
    call=lambda surface_pressure, ozone_dobson, wavelength_nm: (
        optical_properties(
            Atmosphere.standard(
                surface_pressure=surface_pressure, ozone_dobson=ozone_dobson
            ).checked(),
            wavelength_nm[None],
        ).extinction
    ),
    surface_pressure=Domain(0.0, LARGEST_PRESSURE),
    ozone_dobson=Domain(0.0, LARGEST_OZONE_DOBSON),
    wavelength_nm=Domain(380.0, 780.0),
)(Atmosphere)
