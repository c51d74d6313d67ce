"""Which wavelengths are computed, and the way from there to those that are asked for.

Log radiance is smooth in wavelength^-2 where air and haze alone shape it: a few Chebyshev nodes
hold it. Absorbers and a coloured ground bring edges and bands. Their effect is smooth too, not in
wavelength but in their own amount: at fewer nodes the sky is computed with half and with all of
the largest amount, and every wavelength takes the value at its own: on a parabola of log radiance
for a gas, and for the ground on the curve that its repeated reflections follow.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from atmofit.numerics import chebyshev_basis, chebyshev_nodes, chebyshev_transform, safe_divide
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.medium import Medium, optical_properties
from atmofit.sky.plan import Plan
from atmofit.spectrum import Spectrum, at
from atmofit.typing import Reals, Scalar

_NARROWEST_NM = 1.0  # of the interval on which nodes are laid
_ALL_BUT = 1 - 1e-6  # of the light: rounding must not leave less than none


class Samples(eqx.Module):
    """What is computed: wavelengths and, at each, how much there is of what is rough.

    Attributes:
        asked_nm: Wavelengths asked for [nm].
        wavelength_nm: Those of the samples [nm]: without anything rough, then for each rough
            quantity those with half and those with all of it.
        amount: Optical depth of each absorber, then the albedo of a coloured ground,
            [rough, sample]; None: as the atmosphere has it.
        share: Amounts where they are asked for over the largest, [rough, asked]; None likewise.
        nodes: Of smooth log radiance; 0: every wavelength asked for is computed. Static.
        rough_nodes: Of the effect of rough quantities. Static.
        gases: How many of those are absorbers, the first ones. Static.
    """

    asked_nm: Float[Array, " w"]
    wavelength_nm: Float[Array, " s"]
    amount: Float[Array, "rough s"] | None = None
    share: Float[Array, "rough w"] | None = None
    nodes: int = eqx.field(static=True, default=0)
    rough_nodes: int = eqx.field(static=True, default=0)
    gases: int = eqx.field(static=True, default=0)


def samples(atmosphere: Atmosphere, asked_nm: Float[Array, " w"], plan: Plan) -> Samples:
    """The wavelengths to compute.

    Args:
        atmosphere: Its absorbers and a coloured ground are rough.
        asked_nm: Wavelengths asked for [nm].
        plan: How many nodes. Static.
    """
    rough = _rough(atmosphere)
    nodes, few = plan.nodes.wavelength, plan.nodes.rough
    every = plan.all_wavelengths or plan.quantity == "luminance"
    if every or asked_nm.size <= nodes + 2 * few * len(rough):
        return Samples(asked_nm, asked_nm)
    base = _chebyshev(asked_nm, nodes)
    if not rough:
        return Samples(asked_nm, base, nodes=nodes)
    amounts = jnp.stack([at(quantity, asked_nm) for quantity in rough])
    largest = amounts.max(axis=1)
    # One rough quantity after the other, half of it and all of it; nothing of the others.
    units = np.repeat(np.kron(np.eye(len(rough)), [0.5, 1.0]), few, axis=1)
    amount = jnp.asarray(units, base.dtype) * largest[:, None]
    return Samples(
        asked_nm,
        jnp.concatenate([base, jnp.tile(_chebyshev(asked_nm, few), 2 * len(rough))]),
        jnp.concatenate([jnp.zeros((len(rough), nodes), base.dtype), amount], axis=1),
        safe_divide(amounts, largest[:, None]),
        nodes,
        few,
        len(atmosphere.absorbers),
    )


def medium_at(atmosphere: Atmosphere, chosen: Samples) -> Medium:
    """Optical properties of every sample."""
    medium = optical_properties(atmosphere, chosen.wavelength_nm)
    if chosen.amount is None:
        return medium
    gases = len(atmosphere.absorbers)
    scatterers = medium.extinction[: len(medium.phases)]
    extinction = jnp.concatenate([scatterers, chosen.amount[:gases]])
    medium = eqx.tree_at(lambda m: m.extinction, medium, extinction)
    if chosen.amount.shape[0] == gases:
        return medium
    return eqx.tree_at(lambda m: m.ground_albedo, medium, chosen.amount[gases])


def to_asked(computed: Float[Array, "*s n"], chosen: Samples) -> Float[Array, "*s w"]:
    """Radiance at the wavelengths asked for, from that of the samples."""
    if chosen.nodes == 0:
        return computed
    asked, count, few = chosen.asked_nm, chosen.nodes, chosen.rough_nodes
    dark, log = log_radiance(computed)
    smooth = log[..., :count]
    total = smooth @ _interpolation(asked, asked, count).T
    if chosen.share is not None:
        there = smooth @ _interpolation(_chebyshev(asked, few), asked, count).T
        onto = _interpolation(asked, asked, few).T
        parts = log[..., count:].reshape(*log.shape[:-1], -1, 2, few) - there[..., None, None, :]
        half, whole = (parts[..., k, :] @ onto for k in (0, 1))
        for k in range(chosen.share.shape[0]):
            share = jnp.broadcast_to(chosen.share[k], total.shape)
            effect = _of_ground if k == chosen.gases else _of_gas
            total = total + effect(half[..., k, :], whole[..., k, :], share)
    return jnp.where(dark[..., :count].all(-1, keepdims=True), 0.0, jnp.exp(total))


def _of_gas(half: Reals, whole: Reals, share: Reals) -> Reals:
    """What a share of a gas adds to log radiance: a parabola through none, half and all of it."""
    return 4 * share * (1 - share) * half + share * (2 * share - 1) * whole


def _of_ground(half: Reals, whole: Reals, share: Reals) -> Reals:
    """Likewise of an albedo, which adds a / (1 - b albedo) times itself, exactly."""
    h, w = jnp.expm1(half), jnp.expm1(whole)
    b = safe_divide(w - 2 * h, w - h)
    return jnp.log1p(jnp.maximum(share * w * (1 - b) / (1 - b * share), -_ALL_BUT))


def log_radiance(computed: Reals) -> tuple[Bool[Array, "..."], Reals]:
    """Where there is no light, and the logarithm of radiance, finite there too."""
    tiny = jnp.finfo(computed.dtype).tiny
    dark = computed <= tiny  # not NaN, which stays NaN
    return dark, jnp.log(jnp.where(dark, tiny, computed))


def _rough(atmosphere: Atmosphere) -> list[Scalar | Spectrum]:
    """Amounts that need not be smooth in wavelength."""
    rough: list[Scalar | Spectrum] = [gas.optical_depth for gas in atmosphere.absorbers]
    ground = atmosphere.ground
    if ground is not None and isinstance(ground.albedo, Spectrum) and not ground.albedo.smooth:
        rough.append(ground.albedo)
    return rough


def _chebyshev(asked_nm: Float[Array, " w"], count: int) -> Float[Array, " n"]:
    """Chebyshev nodes in wavelength^-2 over the range asked for [nm]."""
    low, high = _interval(asked_nm)
    unit = jnp.asarray((chebyshev_nodes(count) + 1) / 2, asked_nm.dtype)
    return 1 / jnp.sqrt(low + (high - low) * unit)


def _interval(asked_nm: Float[Array, " w"]) -> tuple[Scalar, Scalar]:
    """Ends of the wavelength range in wavelength^-2, never the same."""
    low = asked_nm.min()
    high = jnp.maximum(asked_nm.max(), low + _NARROWEST_NM)
    return 1 / high**2, 1 / low**2


def _interpolation(
    wavelength_nm: Float[Array, " m"], asked_nm: Float[Array, " w"], count: int
) -> Float[Array, "m n"]:
    """Weights of so many nodes over the range asked for, in the value at wavelengths inside."""
    low, high = _interval(asked_nm)
    place = jnp.clip(2 * (1 / wavelength_nm**2 - low) / (high - low) - 1, -1.0, 1.0)
    transform = jnp.asarray(chebyshev_transform(count), wavelength_nm.dtype)
    return chebyshev_basis(place, count) @ transform
