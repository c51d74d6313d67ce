"""The public simulator: from an atmosphere to the radiance of its sky."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range, is_traced
from atmofit.constants import MAXIMUM_WAVELENGTH_NM, MINIMUM_WAVELENGTH_NM
from atmofit.geometry import DirectionGrid, Directions
from atmofit.optics.atmosphere import Atmosphere
from atmofit.sky.field import SkyField, cast
from atmofit.sky.luminance import luminance_nodes
from atmofit.sky.paths import paths_of
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.sources import light_everywhere
from atmofit.sky.wavelengths import medium_at, samples
from atmofit.spectrum import Spectrum, check_wavelengths
from atmofit.typing import Reals, RealsLike


def solve_sky(
    atmosphere: Atmosphere,
    wavelength_nm: RealsLike | None,
    orders: int | str = 2,
    rtol: float = 1e-2,
    plan: Plan | None = None,
) -> SkyField:
    """Solve for the light inside an atmosphere, for all suns at once.

    Args:
        atmosphere: What the air is made of.
        wavelength_nm: Wavelengths [nm], a number or an increasing list, 200 to 3000. None with a
            plan for luminance, which brings its own.
        orders: Scattering orders to sum, 1 to 20, or "all". Static.
        rtol: Promised relative error of luminance, 5e-4 to 1. Static.
        plan: From `plan_sky`; replaces `orders` and `rtol`. Static.

    Returns:
        A field whose `radiance` (or `luminance`) method takes sun and directions.

    Raises:
        ValueError: An argument lies outside its range.
    """
    checked = atmosphere.checked()
    if plan is None:
        plan = plan_sky(checked, orders=orders, rtol=rtol)
    if plan.quantity == "sun":
        raise ValueError('plan for quantity "sun" computes no sky: use simulate_sun')
    wavelength = jnp.atleast_1d(
        in_range(
            "wavelength_nm",
            _planned_wavelengths(wavelength_nm, plan, checked.preset),
            MINIMUM_WAVELENGTH_NM,
            MAXIMUM_WAVELENGTH_NM,
            "nm",
        )
    )
    if wavelength.ndim != 1 or wavelength.size == 0:
        raise ValueError(f"wavelength_nm must be a list, got shape {wavelength.shape}")
    if not is_traced(wavelength):
        check_wavelengths(np.asarray(wavelength))
    _check_spectra(checked, wavelength)
    return _solve(cast(checked, plan.dtype), wavelength.astype(plan.dtype), plan)


def simulate_sky(
    atmosphere: Atmosphere,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    wavelength_nm: RealsLike,
    orders: int | str = 2,
    rtol: float = 1e-2,
    solar_irradiance: RealsLike | Spectrum | None = None,
    plan: Plan | None = None,
) -> Reals:
    """Radiance of the sky at the ground: `solve_sky`, then `SkyField.radiance`.

    For several suns over one atmosphere, call `solve_sky` once and vmap `radiance`.
    """
    field = solve_sky(atmosphere, wavelength_nm, orders, rtol, plan)
    return field.radiance(solar_zenith_angle, directions, solar_irradiance)


def simulate_luminance(
    atmosphere: Atmosphere,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    orders: int | str = 2,
    rtol: float = 1e-2,
    plan: Plan | None = None,
) -> Reals:
    """Luminance of the sky [cd m^-2]: `solve_sky` for luminance, then `SkyField.luminance`.

    Chromaticity and spectrum are left out, so that few wavelengths take the place of 41. For
    several suns over one atmosphere, call `solve_sky` once and vmap `luminance`.
    """
    if plan is None:
        plan = plan_sky(atmosphere, quantity="luminance", orders=orders, rtol=rtol)
    return solve_sky(atmosphere, None, plan=plan).luminance(solar_zenith_angle, directions)


def _planned_wavelengths(given: RealsLike | None, plan: Plan, preset: str) -> RealsLike:
    """The wavelengths asked for, or those that a plan for luminance brings."""
    if plan.quantity != "luminance":
        if given is None:
            raise ValueError('wavelength_nm may be None only with a plan for quantity "luminance"')
        return given
    if given is not None:
        raise ValueError(
            'wavelength_nm must be None with a plan for quantity "luminance", which brings its own'
        )
    return luminance_nodes(plan.luminance_nodes, preset).wavelength_nm


@eqx.filter_jit
def _solve(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"], plan: Plan) -> SkyField:
    """The jitted kernel of `solve_sky`."""
    for_slopes = None
    if plan.slopes is not None:
        for_slopes = _solve(atmosphere, wavelength_nm, plan.slopes)
        atmosphere = jax.lax.stop_gradient(atmosphere)
    atmosphere = plan.simplified(atmosphere)
    paths = paths_of(atmosphere)
    chosen = samples(atmosphere, wavelength_nm, plan)
    medium, moments = None, ()
    if atmosphere.molecules is not None or atmosphere.haze is not None:
        medium = medium_at(atmosphere, chosen)
        if plan.orders != 1:
            medium = medium.peaks_apart(plan.nodes.degrees, unscattered=not plan.counts_peaks)
            moments = tuple(light_everywhere(medium, p, plan) for p in paths)
    return SkyField(medium, moments, chosen, paths, for_slopes, plan, atmosphere.preset)


def _check_spectra(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"]) -> None:
    """Refuse wavelengths outside a constituent's spectra, before the kernel."""
    for leaf in jax.tree.leaves(atmosphere, is_leaf=lambda node: isinstance(node, Spectrum)):
        if isinstance(leaf, Spectrum) and not is_traced(leaf, wavelength_nm):
            leaf(wavelength_nm)
