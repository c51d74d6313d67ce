"""Air near a flat ground: constituents whose densities fall exponentially with altitude."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import is_traced
from atmofit.constants import (
    LARGEST_OPTICAL_DEPTH,
    LARGEST_SCALE_HEIGHT,
    SMALLEST_SCALE_HEIGHT,
)
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.exponential_layers import ExponentialLayers
from atmofit.optics.haze import Haze
from atmofit.optics.medium import optical_properties
from atmofit.optics.molecules import Molecules
from atmofit.optics.phase import PhaseFunction
from atmofit.optics.profiles import Exponential
from atmofit.spectrum import check_wavelengths
from atmofit.typing import Reals, RealsLike, real_array

_FROM_THE_GROUND = (Exponential, ExponentialLayers)


class LowAir(eqx.Module):
    """What a path near the ground goes through; scatterers come first.

    Attributes:
        extinction: Coefficient at altitude 0 [1/m], [constituent, wavelength].
        scattering: The part of it that scatters, [scatterer, wavelength].
        decay: One over each constituent's scale height [1/m], [constituent].
        phases: Phase function of each scatterer.
        wavelength_nm: [nm].
        left_out: How many absorbers are not in it, since they lie aloft, as ozone does. Static.
    """

    extinction: Float[Array, "constituent w"]
    scattering: Float[Array, "scatterer w"]
    decay: Float[Array, " constituent"]
    phases: tuple[PhaseFunction, ...]
    wavelength_nm: Float[Array, " w"]
    left_out: int = eqx.field(static=True, default=0)

    def phase_functions(self, scattering_angle: Reals) -> Float[Array, "*s scatterer w"]:
        """Phase function of each scatterer [1/sr], [..., scatterer, wavelength]."""
        shape = (*scattering_angle.shape, self.wavelength_nm.size)
        values = [
            phase.at_wavelengths(scattering_angle, self.wavelength_nm) for phase in self.phases
        ]
        return jnp.stack([jnp.broadcast_to(value, shape) for value in values], axis=-2)


def low_air(atmosphere: Atmosphere, wavelength_nm: RealsLike) -> LowAir:
    """The air of an atmosphere as it is near the ground.

    Densities keep the value and the slope that they have at altitude 0, which is exact for
    exponential ones. Layers aloft, whose density does not fall there, are left out.

    Args:
        atmosphere: At least one constituent must scatter.
        wavelength_nm: [nm], increasing.

    Returns:
        Coefficients at the wavelengths.

    Raises:
        ValueError: An impossible atmosphere, or one without scatterers.
    """
    air = atmosphere.checked()
    if air.molecules is None and air.haze is None:
        raise ValueError("atmosphere must have molecules or haze, got neither")
    wavelength = jnp.atleast_1d(real_array(wavelength_nm))
    if not is_traced(wavelength):
        check_wavelengths(np.asarray(wavelength))
    medium = optical_properties(air, wavelength)
    scatterers = len(medium.phases)
    for name, profile in zip(_names(air), medium.profiles, strict=False):
        if not isinstance(profile, _FROM_THE_GROUND):
            raise ValueError(
                f"{name}.profile must fall exponentially from the ground, got "
                f"{type(profile).__name__}"
            )
    kept = [
        number
        for number, profile in enumerate(medium.profiles)
        if number < scatterers or isinstance(profile, _FROM_THE_GROUND)
    ]
    ground = jnp.zeros((), wavelength.dtype)
    at_ground = [jax.value_and_grad(medium.profiles[number].density)(ground) for number in kept]
    density = jnp.stack([value for value, _ in at_ground])
    return LowAir(
        medium.extinction[np.asarray(kept)] * density[:, None],
        medium.scattering * density[:scatterers, None],
        jnp.stack([-slope / value for value, slope in at_ground]),
        medium.phases,
        wavelength,
        len(medium.profiles) - len(kept),
    )


def _names(air: Atmosphere) -> list[str]:
    """Of the scatterers."""
    return [name for name in ("molecules", "haze") if getattr(air, name) is not None]


extremes(
    Case("no haze", {"haze_depth": 0.0}),
    call=lambda haze_depth, scale_height, wavelength_nm: _everything(
        low_air(
            Atmosphere(Molecules(), Haze(haze_depth, scale_height=scale_height)),
            wavelength_nm[None],
        )
    ),
    haze_depth=Domain(0.0, LARGEST_OPTICAL_DEPTH),
    scale_height=Domain(SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT),
    wavelength_nm=Span(200.0, 3000.0),
)(low_air)


def _everything(air: LowAir) -> tuple[Reals, ...]:
    return air.extinction, air.scattering, air.decay
