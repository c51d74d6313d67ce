"""Between the clear and the overcast sky, at high turbidity."""

import jax.numpy as jnp

from atmofit.checks import in_range
from atmofit.colour import XYZ_to_xyY, xyY_to_XYZ
from atmofit.extremes import Domain, Span, extremes
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.models.cie import cie_overcast_sky
from atmofit.models.preetham import PREETHAM_1999, PreethamModel
from atmofit.typing import Reals, RealsLike

_WHITE = (1 / 3, 1 / 3)  # of a flat spectrum


def hazy_sky_xyY(
    turbidity: RealsLike,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    model: PreethamModel = PREETHAM_1999,
    clear_until: float = 6.0,
    overcast_from: float = 10.0,
) -> Reals:
    """A clear model that turns into the CIE's overcast sky as turbidity rises.

    Between the two turbidities the skies are mixed in even proportion, as the 1999 paper recommends
    without saying where: it fitted turbidities up to 6 and calls 10 overcast. The overcast sky has
    the model's zenith luminance and a flat spectrum.

    Args:
        turbidity: From the model's least, a number; beyond `overcast_from` the sky stays overcast.
        solar_zenith_angle: 0 to pi/2 [rad], a number.
        directions: On or above the horizon.
        model: Of the clear sky.
        clear_until: Turbidity to which the sky is clear. Static.
        overcast_from: Turbidity from which it is overcast, in the model's range. Static.

    Returns:
        x, y and Y [cd m^-2] on a last axis after those of the directions.

    Raises:
        ValueError: A known argument is out of range, or the two turbidities do not increase.

    References:
        Preetham, Shirley and Smits (1999), section 5.
    """
    low, high = model.turbidity_range
    if not low <= clear_until < overcast_from <= high:
        raise ValueError(
            f"clear_until and overcast_from must increase inside the model's {low:g} to {high:g}, "
            f"got {clear_until:g} and {overcast_from:g}"
        )
    T = in_range("turbidity", turbidity, low, 64.0)
    clear_T = jnp.minimum(T, overcast_from)
    clear = model(clear_T, solar_zenith_angle, directions)
    share = jnp.clip((T - clear_until) / (overcast_from - clear_until), 0.0, 1.0)
    view, _ = directions.angles()
    luminance = cie_overcast_sky(view) * model.zenith(clear_T, solar_zenith_angle)[2]
    white = jnp.broadcast_to(jnp.asarray(_WHITE, luminance.dtype), (*luminance.shape, 2))
    overcast = jnp.concatenate([white, luminance[..., None]], axis=-1)
    share = share.astype(luminance.dtype)
    return XYZ_to_xyY((1 - share) * xyY_to_XYZ(clear) + share * xyY_to_XYZ(overcast))


extremes(
    call=lambda turbidity, solar_zenith_angle, view_zenith_angle, relative_azimuth: hazy_sky_xyY(
        turbidity,
        solar_zenith_angle,
        Directions(view_zenith_angle[None], relative_azimuth[None]),
    ),
    turbidity=Domain(1.7, 64.0),
    solar_zenith_angle=Span(0.0, HORIZON),
    view_zenith_angle=Span(0.0, HORIZON),
    relative_azimuth=Span(0.0, 3.0),
    least=0.0,
)(hazy_sky_xyY)
