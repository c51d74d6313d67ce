"""All orders of scattering in a slab, or in a stack of them over a ground."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON, DirectionGrid, Directions, scattering_angle
from atmofit.media.bordered import Bordered
from atmofit.media.doubling import (
    SMALLEST_COSINE,
    Fan,
    Layer,
    add,
    double,
    doublings_for,
    echoes,
    fan,
    lambert_ground,
)
from atmofit.media.slab import lit_and_seen
from atmofit.media.slab_plan import THICKEST_SLAB, SlabPlan, streams_for
from atmofit.numerics import mean_decay
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction, resolved
from atmofit.typing import Reals, RealsLike, Scalar, real_array


class Slabs(eqx.Module):
    """Homogeneous layers, top first, over a ground.

    Attributes:
        optical_depth: Of each, vertical [-].
        single_scattering_albedo: Of each [-].
        phases: Of each.
        ground_albedo: Of a ground that reflects alike in all directions [-]; None: there is none.
        wavelength_nm: At which the phase functions are taken [nm].
    """

    optical_depth: Float[Array, " layer"]
    single_scattering_albedo: Float[Array, " layer"]
    phases: tuple[PhaseFunction, ...]
    ground_albedo: Scalar | None
    wavelength_nm: Float[Array, " 1"]


class SlabSolution(eqx.Module):
    """What becomes of light that falls on slabs. The sun's axis is absent where one sun was asked.

    Attributes:
        slabs: Those.
        solar_zenith_angle: [rad].
        reflectance: Share of the light that comes back [-].
        diffuse_transmittance: Share that arrives below, scattered at least once [-].
        direct_transmittance: Share that arrives without having been scattered [-].
        plan: How it was computed. Static.
    """

    slabs: Slabs
    solar_zenith_angle: Reals
    reflectance: Reals
    diffuse_transmittance: Reals
    direct_transmittance: Reals
    plan: SlabPlan = eqx.field(static=True)

    def radiance(self, directions: Directions | DirectionGrid) -> Reals:
        """Scattered light that leaves the slabs, over the sun's irradiance across its rays [1/sr].

        Seen from below where the view zenith angle is under pi/2, from above where it is over.

        Args:
            directions: To look in, view zenith angles from 0 to pi; a grid shares the work of a
                zenith angle. A level one is taken as one 0.006 degrees beside it.

        Returns:
            [sun, *directions]; the sun's axis is absent where one sun was asked for.

        Raises:
            ValueError: A known angle is out of range.
        """
        zenith = angle_in_range("view_zenith_angle", directions.view_zenith_angle, 0.0, np.pi)
        azimuth = in_range("relative_azimuth", directions.relative_azimuth, -np.inf, np.inf)
        if isinstance(directions, DirectionGrid):
            azimuth = jnp.broadcast_to(azimuth[None, :], directions.shape)
        else:
            azimuth = azimuth[:, None]
        suns = jnp.atleast_1d(self.solar_zenith_angle)
        found = _radiance(
            self.slabs, suns, _folded(directions.view_zenith_angle), zenith, azimuth, self.plan
        )
        return found.reshape(*self.solar_zenith_angle.shape, *directions.shape)


def solve_slab(
    *,
    optical_depth: RealsLike,
    single_scattering_albedo: RealsLike,
    phase: PhaseFunction | tuple[PhaseFunction, ...],
    solar_zenith_angle: RealsLike,
    ground_albedo: RealsLike | None = None,
    wavelength_nm: RealsLike = 550.0,
    rtol: float = 1e-2,
    plan: SlabPlan | None = None,
) -> SlabSolution:
    """Solve a slab, or a stack of slabs, for all orders of scattering by doubling and adding.

    The phase function's forward peak is cut off and added to what passes (Wiscombe 1977), and the
    first order of radiance is put back with the whole of it (Nakajima and Tanaka 1988).

    Args:
        optical_depth: Vertical, 0 to 10,000 [-]; a list is a stack, top first.
        single_scattering_albedo: 0 to 1 [-]; a number or a list like the depths.
        phase: Of all the slabs, or one for each.
        solar_zenith_angle: 0 to pi/2 [rad]; a number or a list of suns, which share the work.
        ground_albedo: 0 to 1 [-]; None: no ground.
        wavelength_nm: At which the phase functions are taken [nm].
        rtol: Sets the streams: 8 from 5e-2, 16 from 1e-2, 32 from 2e-3, else 64; for phase
            functions with an asymmetry to .85. `plan_slab` measures instead.
        plan: Counts; None: as `rtol` says, for every depth. Static.

    Returns:
        Shares of the light, and by `.radiance(directions)` what is seen. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: A known argument is out of range, or lists do not fit.

    References:
        Hansen and Travis (1974), Space Sci. Rev. 16, 527. Wiscombe (1977), J. Atmos. Sci. 34,
        1408. Nakajima and Tanaka (1988), J. Quant. Spectrosc. Radiat. Transfer 40, 51.
    """
    slabs = checked_slabs(
        optical_depth, single_scattering_albedo, phase, ground_albedo, wavelength_nm
    )
    zenith = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    if zenith.ndim > 1:
        raise ValueError(f"solar_zenith_angle must be a number or a list, got shape {zenith.shape}")
    if plan is None:
        streams = streams_for(rtol)
        plan = SlabPlan(streams, streams, doublings_for(THICKEST_SLAB, streams), rtol)
    dtype = jnp.result_type(slabs.optical_depth, zenith)
    slabs, zenith = jax.tree.map(lambda leaf: leaf.astype(dtype), (slabs, zenith))
    shares = _shares(slabs, jnp.atleast_1d(zenith), plan)
    back, through, direct = (share.reshape(zenith.shape) for share in shares)
    return SlabSolution(slabs, zenith, back, through, direct, plan)


def checked_slabs(
    optical_depth: RealsLike,
    single_scattering_albedo: RealsLike,
    phase: PhaseFunction | tuple[PhaseFunction, ...],
    ground_albedo: RealsLike | None = None,
    wavelength_nm: RealsLike = 550.0,
) -> Slabs:
    """Slabs from the arguments of `solve_slab`, or what is wrong with them."""
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST_SLAB)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    if depth.ndim > 1 or albedo.ndim > 1 or albedo.shape not in ((), (1,), depth.shape):
        raise ValueError(
            "optical_depth and single_scattering_albedo must be numbers or lists of one length, "
            f"got shapes {depth.shape} and {albedo.shape}"
        )
    depth = jnp.atleast_1d(depth)
    phases = phase if isinstance(phase, tuple) else (phase,) * depth.size
    if len(phases) != depth.size:
        raise ValueError(f"phase must be one or {depth.size}, got {len(phases)}")
    ground = None if ground_albedo is None else in_range("ground_albedo", ground_albedo, 0.0, 1.0)
    return Slabs(
        depth,
        jnp.broadcast_to(albedo, depth.shape).astype(depth.dtype),
        tuple(each.checked() for each in phases),
        ground,
        real_array(wavelength_nm).astype(depth.dtype).reshape(1),
    )


class Scaled(eqx.Module):
    """Slabs without the forward peak of their phase functions, each attribute by layer.

    Attributes:
        optical_depth: What is left [-].
        single_scattering_albedo: Likewise [-].
        moments: Of the rest of the phase function, [layer, degree].
        peak: Share of the scattered light in the peak [-].
    """

    optical_depth: Float[Array, " layer"]
    single_scattering_albedo: Float[Array, " layer"]
    moments: Float[Array, "layer l"]
    peak: Float[Array, " layer"]


def scaled(slabs: Slabs, streams: int) -> Scaled:
    """Cut off what the streams cannot hold, see `resolved`."""
    moments = jnp.stack(
        [phase.moments(streams + 1, slabs.wavelength_nm)[:, 0] for phase in slabs.phases]
    ).astype(slabs.optical_depth.dtype)
    kept, peak = resolved(moments)
    albedo = slabs.single_scattering_albedo
    left = 1 - albedo * peak
    return Scaled(
        left * slabs.optical_depth,
        albedo * (1 - peak) / left,
        kept,
        peak,
    )


def light(
    parts: Scaled, ground_albedo: Scalar | None, directions: Fan, doublings: int
) -> tuple[Bordered, Bordered]:
    """What goes up from the top, and down at the bottom, of light from above."""
    of_layer = functools.partial(double, directions, doublings=doublings)
    layers = [
        of_layer(depth, albedo, moments)
        for depth, albedo, moments in zip(
            parts.optical_depth, parts.single_scattering_albedo, parts.moments, strict=True
        )
    ]
    stack: Layer = functools.reduce(add, layers)
    if ground_albedo is None:
        return stack.reflection, stack.transmission
    ground = lambert_ground(directions, ground_albedo).reflection
    down = echoes(stack.reflection_below, ground) @ stack.transmission
    return stack.reflection + stack.transmission_below @ ground @ down, down


@eqx.filter_jit
def _shares(slabs: Slabs, solar_zenith_angle: Reals, plan: SlabPlan) -> tuple[Reals, Reals, Reals]:
    """Reflectance, diffuse and direct transmittance: no view, and no azimuth but the mean."""
    none = jnp.zeros((0,), solar_zenith_angle.dtype)
    suns = jnp.maximum(jnp.cos(solar_zenith_angle), SMALLEST_COSINE)
    directions = fan(plan.streams, 1, none, suns)
    parts = scaled(slabs, plan.streams)
    up, down = light(parts, slabs.ground_albedo, directions, plan.doublings)
    to_flux = jnp.sqrt(directions.weight * directions.cosine[0])
    left, peaks = jnp.sum(parts.optical_depth), jnp.sum(slabs.optical_depth - parts.optical_depth)
    # The peak that passes with the direct light was scattered all the same.
    passed = jnp.exp(-left / suns) * (peaks / suns) * mean_decay(peaks / suns)
    direct = jnp.exp(-jnp.sum(slabs.optical_depth) / suns)
    return to_flux @ up.beside[0] / suns, to_flux @ down.beside[0] / suns + passed, direct


@eqx.filter_jit
def _radiance(
    slabs: Slabs,
    solar_zenith_angle: Reals,
    apart: tuple[Reals, Int[Array, " view"]],
    view_zenith_angle: Reals,
    relative_azimuth: Float[Array, "view azimuth"],
    plan: SlabPlan,
) -> Float[Array, "sun view azimuth"]:
    dtype = solar_zenith_angle.dtype
    suns = jnp.maximum(jnp.cos(solar_zenith_angle), SMALLEST_COSINE)
    upward = jnp.cos(view_zenith_angle).astype(dtype)
    cosine, which = jnp.cos(apart[0]).astype(dtype), apart[1]
    directions = fan(plan.streams, plan.modes, cosine, suns)
    views = directions.cosine[1][which]
    parts = scaled(slabs, plan.streams)
    up, down = light(parts, slabs.ground_albedo, directions, plan.doublings)
    from_below = (upward > 0)[None, :, None]
    modes = jnp.where(from_below, down.corner[:, which], up.corner[:, which])
    mode = np.arange(plan.modes)
    share = jnp.asarray(np.where(mode == 0, 1.0, 2.0), dtype)
    turn = jnp.cos(relative_azimuth.astype(dtype)[..., None] * jnp.asarray(mode, dtype)[None, None])
    turn = turn * share[None, None, :]
    angle = scattering_angle(
        view_zenith_angle[None, :, None].astype(dtype),
        relative_azimuth[None].astype(dtype),
        solar_zenith_angle[:, None, None],
    )
    total = jnp.einsum("mvs,vam->sva", modes, turn)
    # The first order again, with the whole phase function instead of the part of it.
    n = directions.cosine[0].size
    of_views, of_suns = (
        [functions[0][:, n:][:, which] for functions in (directions.even, directions.odd)],
        [functions[1] for functions in (directions.even, directions.odd)],
    )
    factors = _first_order(parts.optical_depth, suns, views, upward > 0)
    for k, phase in enumerate(slabs.phases):
        even, odd = (
            jnp.einsum("l,mvl,msl->mvs", parts.moments[k], v, s)
            for v, s in zip(of_views, of_suns, strict=True)
        )
        part = jnp.einsum("mvs,vam->sva", jnp.where(from_below, even + odd, even - odd), turn)
        whole = phase.at_wavelengths(angle, slabs.wavelength_nm)[..., 0] / (1 - parts.peak[k])
        more = parts.single_scattering_albedo[k] * factors[k]
        total = total + more[:, :, None] * (whole - part)
    return total


def _folded(zenith_angle: Reals) -> tuple[Reals, Int[Array, " view"]]:
    """Angles to the normal that differ, and which of them each view has; up and down share one."""
    if is_traced(zenith_angle):
        return jnp.minimum(zenith_angle, np.pi - zenith_angle), jnp.arange(zenith_angle.size)
    known = np.asarray(zenith_angle)
    folded = np.minimum(known, np.asarray(np.pi - known, known.dtype))
    digits = 12 if known.dtype == np.float64 else 6
    angle, which = np.unique(np.round(folded, digits), return_inverse=True)
    return jnp.asarray(angle), jnp.asarray(which.reshape(-1))


def _first_order(
    optical_depth: Float[Array, " layer"],
    suns: Float[Array, " sun"],
    views: Float[Array, " view"],
    from_below: Array,
) -> Float[Array, "layer sun view"]:
    """How much of each layer is lit through those above and seen through those between."""
    above = jnp.cumsum(optical_depth) - optical_depth
    below = jnp.sum(optical_depth) - above - optical_depth
    between = jnp.where(from_below[None, :], below[:, None], above[:, None])
    dimmed = jnp.exp(-above[:, None, None] / suns[None, :, None])
    dimmed = dimmed * jnp.exp(-between[:, None, :] / views[None, None, :])
    sun = jnp.where(from_below[None, :], -suns[:, None], suns[:, None])
    return dimmed * lit_and_seen(optical_depth[:, None, None], views[None, None, :], sun[None])


def _extreme(ground: bool) -> Any:
    """Few streams, which break no later than many."""

    def call(
        optical_depth: Scalar, albedo: Scalar, asymmetry: Scalar, sun: Scalar, view: Scalar
    ) -> tuple[Reals, ...]:
        solved = solve_slab(
            optical_depth=optical_depth,
            single_scattering_albedo=albedo,
            phase=HenyeyGreenstein(asymmetry),
            solar_zenith_angle=sun,
            ground_albedo=0.5 if ground else None,
            plan=SlabPlan(8, 4, 17),
        )
        seen = solved.radiance(Directions(view[None], view[None]))
        return solved.reflectance, solved.diffuse_transmittance, seen[0]

    return call


for _ground in (False, True):
    extremes(
        Case("no slab", {"optical_depth": 0.0, "view": 1.0}, (0.5 * _ground, 0.0, 0.0), size=1.0),
        Case("black", {"albedo": 0.0}),
        Case("white and thick", {"albedo": 1.0, "optical_depth": 1e4}),
        Case("a hair thick", {"optical_depth": 1e-12}),
        Case("sharp peak", {"asymmetry": 0.99}),
        Case("into the sun", {"sun": 1.0, "view": 1.0}),
        Case("both level", {"sun": np.pi / 2, "view": np.pi / 2}),
        part="over a ground" if _ground else "alone",
        call=_extreme(_ground),
        optical_depth=Domain(0.0, THICKEST_SLAB),
        albedo=Domain(0.0, 1.0),
        asymmetry=Domain(-0.999, 0.999),
        sun=Domain(0.0, HORIZON),
        view=Domain(0.0, np.pi),
        # Rounding is that of the light that comes in; level suns have most of it.
        least=(0.0, 1e3),
    )(solve_slab)
