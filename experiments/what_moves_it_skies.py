"""The assumptions of `what_moves_it.py`, the skies that they make, and the fits to these skies."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from what_moves_it_third_order import ThirdOrder

import atmofit as af
from atmofit.fit.skies import QUANTITIES, SimulatedSkies
from atmofit.optics.phase import TabulatedPhase
from atmofit.spectrum import at
from atmofit.tables import constant, preetham1999_phase, preetham1999_spectra

SETTINGS = af.RefitSettings()  # the reference job
Changes = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Assumptions:
    """What the skies and the fits rest on; the defaults are the reference job's.

    Attributes:
        geometry: Of the atmosphere.
        orders: 3 multiplies the sum of two orders by the ratio that the Monte Carlo gives.
        refractive_index: Of air.
        haze_scale_height: [m].
        haze_profile: "exponential", "boundary layer" (well mixed to 1.5 km) or "layer aloft"
            (Gaussian about 3 km with a width of 0.7 km); the optical depth stays.
        phase: Haze's: "normalised" numerically; "divided by K" of Table 2; "as printed", eta
            itself; "over 4 pi", eta / (4 pi); "doubled", without the half of A.3: eta / (pi K).
        ground_albedo: 0 to 1.
        haze_albedo: Single-scattering albedo.
        sunlight: Factor on the sun's irradiance.
        weighting: Of luminance, in the joint fit and (log: relative) at the zenith.
        lowest_sun_deg: Suns further from the zenith are left out of fits and comparisons.
        near_sun_deg: Directions this close to the sun are left out of the joint fits and the
            comparisons over the dome.
    """

    geometry: str = "spherical"
    orders: int = 2
    refractive_index: float = constant("refractive_index")
    haze_scale_height: float = 1 / constant("haze_decay")
    haze_profile: str = "exponential"
    phase: str = "normalised"
    ground_albedo: float = 0.0
    haze_albedo: float = 1.0
    sunlight: float = 1.0
    weighting: str = "relative"
    lowest_sun_deg: float = 90.0
    near_sun_deg: float = 0.0


SINGLE: dict[str, tuple[str, Changes]] = {
    "orders_1": ("order 1 only", {"orders": 1}),
    "orders_3": ("orders 1 to 3", {"orders": 3}),
    "geometry_flat": ("flat geometry", {"geometry": "flat"}),
    "geometry_paper": ("the paper's geometry: flat below 70°", {"geometry": "paper"}),
    "refractive_index": ("n = 1.0003 as printed", {"refractive_index": 1.0003}),
    "haze_600_m": ("haze scale height 0.6 km", {"haze_scale_height": 600.0}),
    "haze_2400_m": ("haze scale height 2.4 km", {"haze_scale_height": 2400.0}),
    "boundary_layer": ("haze well mixed to 1.5 km", {"haze_profile": "boundary layer"}),
    "layer_aloft": ("haze in a layer at 3 km", {"haze_profile": "layer aloft"}),
    "phase_over_K": ("haze phase: η / (2π K of Table 2)", {"phase": "divided by K"}),
    "phase_printed": ("haze phase: η itself, not normalised", {"phase": "as printed"}),
    "phase_over_4_pi": ("haze phase: η / 4π, not normalised", {"phase": "over 4 pi"}),
    "phase_doubled": ("haze phase: η / (π K), the half of A.3 left out", {"phase": "doubled"}),
    "weighting_absolute": ("luminance weighted absolutely", {"weighting": "absolute"}),
    "weighting_log": ("logarithms of luminance", {"weighting": "log"}),
    "suns_72": ("suns to 72° only", {"lowest_sun_deg": 72.0}),
    "near_sun_10": ("without 10° about the sun", {"near_sun_deg": 10.0}),
    "near_sun_20": ("without 20° about the sun", {"near_sun_deg": 20.0}),
    "ground_albedo": ("ground albedo 0.2", {"ground_albedo": 0.2}),
    "sunlight_doubled": ("sunlight twice as strong", {"sunlight": 2.0}),
    "haze_albedo": ("haze single-scattering albedo 0.9", {"haze_albedo": 0.9}),
}
PAPER: Changes = {
    "geometry": "paper",
    "refractive_index": 1.0003,
    "phase": "divided by K",
    "weighting": "absolute",
}
# Haze that scatters more or less than it takes from the beam: such a phase goes with no ratio of
# the third order, which was sampled in the paper's air.
NOT_NORMALISED = ("as printed", "over 4 pi", "doubled")


class ScaledPhase(af.PhaseFunction):
    """A phase function times a factor that depends on wavelength: it need not integrate to 1.

    Attributes:
        phase: Normalised.
        factor: Its integral over the sphere.
    """

    phase: TabulatedPhase
    factor: af.Spectrum

    def at_wavelengths(
        self, angle: Float[Array, "..."], wavelength_nm: Float[Array, " w"]
    ) -> Float[Array, "..."]:
        """Phase function [1/sr]."""
        scale = at(self.factor, wavelength_nm)
        values = self.phase.at_wavelengths(angle, wavelength_nm)
        return values * scale.reshape((1,) * angle.ndim + scale.shape)

    def moments(self, count: int, wavelength_nm: Float[Array, " w"]) -> Float[Array, "l w_or_1"]:
        """Legendre moments."""
        scale = at(self.factor, wavelength_nm)
        return self.phase.moments(count, wavelength_nm) * scale[None, :]


@functools.cache
def phase_factor(phase: str) -> np.ndarray:
    """Integral of a haze phase function over the sphere at the wavelengths of Table 2."""
    table, spectra = preetham1999_phase(), preetham1999_spectra()
    if phase == "normalised":
        return np.ones_like(spectra.K)
    # The same interpolation normalised and not: their ratio at any angle is the integral of eta.
    angle, eta = table.scattering_angle[0], table.eta[0]
    normalised = [float(af.bullrich_phase()(angle, λ)) for λ in table.wavelength_nm]
    integral = np.interp(spectra.wavelength_nm, table.wavelength_nm, eta / np.array(normalised))
    unit = {
        "divided by K": 2 * np.pi * spectra.K,
        "as printed": 1.0,
        "over 4 pi": 4 * np.pi,
        "doubled": np.pi * spectra.K,
    }
    return integral / unit[phase]


class _Traced(eqx.Module):
    """What may change without compiling again; an absent part is another program."""

    refractive_index: Float[Array, ""]
    haze_scale_height: Float[Array, ""]
    haze_albedo: Float[Array, ""]
    phase_factor: Float[Array, " k"]
    ground_albedo: Float[Array, ""] | None
    profile: af.DensityProfile | None


def simulate(assumptions: Assumptions, third_order: ThirdOrder) -> SimulatedSkies:
    """The skies of the reference job under the assumptions."""
    a = assumptions
    traced = _Traced(
        refractive_index=jnp.asarray(a.refractive_index),
        haze_scale_height=jnp.asarray(a.haze_scale_height),
        haze_albedo=jnp.asarray(a.haze_albedo),
        phase_factor=jnp.asarray(phase_factor(a.phase)),
        ground_albedo=jnp.asarray(a.ground_albedo) if a.ground_albedo else None,
        profile=_profile(a.haze_profile),
    )
    dome = af.dome_343()
    plan = dataclasses.replace(SETTINGS, orders=min(a.orders, 2)).plan()
    radiance = a.sunlight * np.asarray(_simulate(traced, dome, plan, a.geometry), float)
    if a.orders == 3:
        view, azimuth = (np.asarray(angle) for angle in dome.angles())
        λ = np.array(SETTINGS.wavelength_nm)
        suns = SETTINGS.solar_zenith_angle
        for T, sky in zip(SETTINGS.turbidity, radiance, strict=True):
            sky *= third_order.ratio(T, suns[:, None, None], view[:, None], azimuth[:, None], λ)
    xyY = np.asarray(af.spectrum_to_xyY(jnp.asarray(radiance), SETTINGS.wavelength_nm))
    settings = dataclasses.replace(SETTINGS, weighting=a.weighting)
    return SimulatedSkies(settings, dome, radiance, xyY, {})


def _profile(name: str) -> af.DensityProfile | None:
    if name == "boundary layer":
        return af.Profile([0.0, 1400.0, 1600.0], [1.0, 1.0, 0.0])
    return af.GaussianLayer(3e3, 0.7e3) if name == "layer aloft" else None


@eqx.filter_jit
def _simulate(traced: _Traced, dome: af.Directions, plan: af.Plan, geometry: str) -> jax.Array:
    """Radiance, [turbidity, sun, direction, wavelength]."""
    wavelength = jnp.asarray(SETTINGS.wavelength_nm)
    suns = jnp.asarray(SETTINGS.solar_zenith_angle)
    factor = af.Spectrum(preetham1999_spectra().wavelength_nm, traced.phase_factor, smooth=True)

    def of_turbidity(T: jax.Array) -> jax.Array:
        paper = af.Haze.from_turbidity(T)
        haze = af.Haze(
            paper.optical_depth,
            paper.angstrom_exponent,
            traced.haze_scale_height,
            traced.haze_albedo,
            ScaledPhase(af.bullrich_phase(), factor),
            paper.relative_efficiency,
            traced.profile,
        )
        ground = None if traced.ground_albedo is None else af.Ground(traced.ground_albedo)
        air = af.Molecules(refractive_index=traced.refractive_index)
        field = af.solve_sky(
            af.Atmosphere(air, haze, ground=ground, geometry=geometry), wavelength, plan=plan
        )
        return jax.vmap(lambda sun: field.radiance(sun, dome))(suns)

    return jax.vmap(of_turbidity)(jnp.asarray(SETTINGS.turbidity))


def direction_weight(assumptions: Assumptions) -> np.ndarray:
    """1 where a direction counts and 0 where it is left out, [turbidity, sun, direction]."""
    view, azimuth = af.dome_343().angles()
    suns = np.asarray(SETTINGS.solar_zenith_angle_deg)
    angle = af.scattering_angle(
        view[None, :], azimuth[None, :], jnp.radians(jnp.asarray(suns))[:, None]
    )
    far = np.degrees(np.asarray(angle)) >= assumptions.near_sun_deg
    kept = far & (suns <= assumptions.lowest_sun_deg)[:, None]
    return np.broadcast_to(kept.astype(float), (len(SETTINGS.turbidity), *kept.shape))


def fits(
    skies: SimulatedSkies, assumptions: Assumptions
) -> tuple[dict[str, af.DistributionFit], dict[str, af.ZenithFit]]:
    """Joint fits and zenith fits under the assumptions."""
    suns, turbidity = SETTINGS.solar_zenith_angle, np.asarray(SETTINGS.turbidity)
    weight = direction_weight(assumptions)
    joint = {
        q: af.fit_distribution(
            skies.directions,
            suns,
            turbidity,
            skies.quantity(q),
            weight=weight,
            weighting=skies.settings.weighting_of(q),
        )
        for q in QUANTITIES
    }
    high = np.asarray(SETTINGS.solar_zenith_angle_deg) <= assumptions.lowest_sun_deg
    zenith, suns = skies.zenith[:, high], suns[high]
    at_zenith = "absolute" if assumptions.weighting == "absolute" else "relative"
    zeniths = {
        "x": af.fit_zenith_chromaticity(turbidity, suns, zenith[..., 0], weighting="absolute"),
        "y": af.fit_zenith_chromaticity(turbidity, suns, zenith[..., 1], weighting="absolute"),
        "Y": af.fit_zenith_luminance(turbidity, suns, zenith[..., 2], weighting=at_zenith),
    }
    return joint, zeniths
