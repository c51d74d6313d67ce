"""From a scene and a tolerance to a plan. Python only, nothing traced."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.optics.atmosphere import Atmosphere
from atmofit.sky.ladder import LADDER
from atmofit.sky.luminance import COUNTS
from atmofit.sky.needed import Needed, needed
from atmofit.sky.plan import ZENITH, Plan
from atmofit.sky.predicted import facts, reversals
from atmofit.sky.sun_angles import SunRange, sun_ends
from atmofit.typing import RealsLike

MAXIMUM_ORDERS = 20
QUANTITIES = ("spectrum", "luminance", "sun")
_TWILIGHT = 1.3  # times the sun angles where the field also serves twilight
_SUN_STEP_DEG, _SUN_MARGIN_DEG = 5, 1.0  # known suns are rounded outward, so that plans are few
_SUN_ENDS = 4  # more sun angles for a short range, whose ends are as steep as a long one's
_TURN = math.radians(11.5)  # of the local sun along a view ray
_ROUNDING = 1e-6  # of a float32 sun at the horizon [rad]
# Light that is turned around often takes more orders before the rest follows from them. Measured
# over white haze against `solve_slab`: 5, 10, 20 and 40 do to .5, 1, 4 and 8 reversals.
_REVERSALS, _ORDERS_EACH, _ORDERS_AT_ONCE, _MOST_ORDERS = 0.5, 7.5, 5, 40


def plan_sky(
    atmosphere: Atmosphere,
    *,
    solar_zenith_angle: RealsLike | None = None,
    directions: Directions | DirectionGrid | None = None,
    quantity: str = "spectrum",
    orders: int | str | None = 2,
    rtol: float = 1e-2,
    dtype: str | None = None,
    all_wavelengths: bool | None = None,
    by_order: bool = False,
    slopes_rtol: float | None = None,
) -> Plan:
    """Decide how a sky is computed.

    Args:
        atmosphere: Only which constituents exist counts, and whether their spectra are smooth;
            unless `orders` is None, when its values are looked at and must be known. For all
            orders more of them are computed if it is known to be thick.
        solar_zenith_angle: Known value or values [rad], 0 to 96 degrees; if all are above the
            horizon, twilight is left out, and the field serves no sun below it. A tracer is
            refused. None: whatever the geometry allows.
        directions: Known directions; if all are overhead, whatever depends on azimuth is left
            out, and the field serves the zenith only. A tracer is refused.
        quantity: "spectrum"; "luminance": no spectrum is computed, only the few wavelengths
            that luminance needs, see `SkyField.luminance`; "sun": nothing is scattered at all,
            see `simulate_sun`.
        orders: Scattering orders to sum, 1 to 20, or "all": converged. None: all, and whatever
            the scene does not need within `rtol` is left out, by predicted errors: orders,
            sphericity, constituents, wavelengths (`Plan.errors`); calibrated for air as at sea
            level in visible light, views down to 89 degrees.
        rtol: Promised relative error of luminance, 5e-4 to 1; the next finer rung is taken, or
            the one that is predicted to keep it.
        dtype: "float32" or "float64"; None: JAX's default, or by value where `orders` is None.
        all_wavelengths: Compute every wavelength asked for instead of a few nodes; None: where a
            gas absorbs or a spectrum does not promise to be smooth. False: the effect of gases
            and of a coloured ground is taken from a few wavelengths, by amount; with 500 DU of
            ozone luminance is within 0.3 % to sun 85 degrees, 1 % at 92 (rung 1e-2).
        by_order: Keep the orders apart, see `SkyField.radiance_by_order`; `orders` is a number.
        slopes_rtol: Rung, coarser than the sky's, of a second sky whose relative slopes stand for
            this one's: a Jacobian becomes several times as cheap, and no longer exact. None: all
            slopes are those of the sky itself.

    Raises:
        TypeError: The sun or a direction is a tracer; or the atmosphere, if `orders` is None.
        ValueError: A value lies outside its range.
    """
    suns = _suns(atmosphere, solar_zenith_angle)
    view = math.pi / 2 if directions is None else _lowest_view(directions)
    choice("quantity", quantity, QUANTITIES)
    in_range("rtol", rtol, min(LADDER), 1.0)
    if orders is None:
        latest = suns[1] if solar_zenith_angle is None else np.max(np.asarray(solar_zenith_angle))
        known = facts(atmosphere, math.degrees(float(latest)), math.degrees(view))
        chosen = needed(atmosphere, known, rtol, quantity)
        dtype = chosen.dtype if dtype is None else dtype
    else:
        _check_orders(orders, by_order)
        chosen = _as_asked(atmosphere, orders, rtol)
    name = np.dtype(jnp.result_type(float) if dtype is None else dtype).name
    if name not in ("float32", "float64"):
        raise ValueError(f'dtype must be "float32" or "float64", got {name!r}')
    few = chosen.luminance_nodes if quantity == "luminance" else chosen.wavelengths
    every = not few if all_wavelengths is None else all_wavelengths
    # Luminance needs every wavelength where gases absorb. One order is cheap, and under a low sun
    # its spectrum is too steep for few.
    if quantity == "luminance":
        every = every or bool(atmosphere.absorbers) or chosen.orders == 1
    of_light = LADDER[chosen.rung if chosen.wavelengths is None else chosen.wavelengths]
    nodes = dataclasses.replace(
        LADDER[chosen.rung],
        sun=_sun_count(LADDER[chosen.rung].sun, suns),
        steps=LADDER[chosen.rung].steps + _more_steps(atmosphere, chosen.orders),
        wavelength=of_light.wavelength,
        rough=of_light.rough,
    )
    plan = Plan(
        0 if quantity == "sun" else chosen.orders,
        chosen.rung,
        nodes,
        name,
        every,
        quantity,
        view <= ZENITH,
        suns,
        0 if every else chosen.luminance_nodes,
        by_order,
        chosen.geometry,
        chosen.without,
        errors=chosen.errors,
    )
    if slopes_rtol is not None:
        coarser = plan_sky(
            atmosphere,
            solar_zenith_angle=solar_zenith_angle,
            directions=directions,
            quantity=quantity,
            orders=chosen.orders,
            rtol=in_range("slopes_rtol", slopes_rtol, chosen.rung, 1.0).item(),
            dtype=name,
            all_wavelengths=all_wavelengths,
            by_order=by_order,
        )
        plan = dataclasses.replace(plan, slopes=coarser)
    computed, left_out = _in_words(atmosphere, plan)
    return dataclasses.replace(plan, computed=computed, left_out=left_out)


def _as_asked(atmosphere: Atmosphere, orders: int | str, rtol: float) -> Needed:
    """The rung for a tolerance, with nothing left out by value."""
    rung = max((r for r in LADDER if r <= rtol * (1 + 1e-9)), default=min(LADDER))
    wavelengths = rung if atmosphere.is_smooth else None
    return Needed(rung, orders, wavelengths=wavelengths, luminance_nodes=COUNTS[rung])


def _suns(atmosphere: Atmosphere, solar_zenith_angle: RealsLike | None) -> SunRange:
    """Range of the suns to serve [rad]: a little more than the known ones, by whole steps."""
    latest = atmosphere.latest_sun
    if solar_zenith_angle is None:
        return 0.0, latest
    if is_traced(solar_zenith_angle):
        raise TypeError("solar_zenith_angle of plan_sky must be known, got a tracer")
    angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, latest)
    known = np.degrees(np.asarray(solar_zenith_angle, float))
    low = _SUN_STEP_DEG * math.floor((float(known.min()) - _SUN_MARGIN_DEG) / _SUN_STEP_DEG)
    high = _SUN_STEP_DEG * math.ceil((float(known.max()) + _SUN_MARGIN_DEG) / _SUN_STEP_DEG)
    # Suns that are up leave twilight out, those at the horizon too.
    day = math.radians(float(known.max())) <= HORIZON + _ROUNDING
    return max(math.radians(low), 0.0), min(math.radians(high), HORIZON if day else latest)


def _sun_count(count: int, suns: SunRange) -> int:
    """Local sun angles that hold the light of a range as well as so many hold that of all day."""
    low, high = sun_ends((max(suns[0] - _TURN, 0.0), suns[1] + _TURN))
    first, last = sun_ends((0.0, HORIZON + _TURN))
    more = _TWILIGHT if suns[1] > HORIZON else 1.0
    share = (high - low) / (last - first)
    return min(math.ceil(more * (share * count + _SUN_ENDS)), math.ceil(more * count))


def _more_steps(atmosphere: Atmosphere, orders: int | str) -> int:
    """Orders to compute beyond those of the rung, by fives so that plans are few."""
    if orders != "all":
        return 0
    wanted = _ORDERS_EACH * max(reversals(atmosphere) - _REVERSALS, 0.0)
    return min(_ORDERS_AT_ONCE * math.ceil(wanted / _ORDERS_AT_ONCE), _MOST_ORDERS)


def _check_orders(orders: int | str, by_order: bool) -> None:
    if orders != "all" and not (isinstance(orders, int) and 1 <= orders <= MAXIMUM_ORDERS):
        raise ValueError(f'orders must be 1 to {MAXIMUM_ORDERS} or "all", got {orders!r}')
    if by_order and orders == "all":
        raise ValueError('orders must be a number where they are kept apart, got "all"')


def _lowest_view(directions: Directions | DirectionGrid) -> float:
    """The largest view zenith angle of known directions [rad]."""
    view, azimuth = directions.angles()
    if is_traced(view, azimuth):
        raise TypeError("directions of plan_sky must be known, got a tracer")
    angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
    return float(np.max(np.asarray(view)))


def _in_words(atmosphere: Atmosphere, plan: Plan) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is computed and what is left out."""
    computed: list[str] = []
    left_out: list[str] = []
    _orders_in_words(plan, computed, left_out)
    _scene_in_words(plan, computed, left_out)
    _constituents_in_words(atmosphere, plan, computed, left_out)
    if plan.quantity != "sun":
        _wavelengths_in_words(atmosphere, plan, computed, left_out)
    if plan.slopes is not None:
        left_out.append(f"exact slopes: those of a sky at rtol {plan.slopes.rtol:g} stand for them")
    left_out.append("polarisation and refraction: not modelled")
    return tuple(computed), tuple(left_out)


def _orders_in_words(plan: Plan, computed: list[str], left_out: list[str]) -> None:
    n, order = plan.nodes, plan.orders
    if order == 0:
        computed.append("unscattered sunlight")
        left_out.append("every scattering order and direction: only the sun is looked at")
        return
    computed.append(f"single scattering, {n.view} nodes along the line of sight")
    if order == 1:
        left_out.append("second order: orders=1")
    else:
        computed.append(
            f"second order, {n.altitude} altitudes x {n.sun} sun angles x {n.degrees} moments"
        )
    if order == "all":
        computed.append(f"orders to {n.steps + 2}, the rest as their best mixture")
        if n.steps >= LADDER[plan.rtol].steps + _MOST_ORDERS:
            left_out.append("light scattered yet more often, of which such thick air is full")
        return
    if order not in (1, 2):
        computed.append(f"orders 3 to {order}")
    chosen = any(what.startswith("orders") for what, _ in plan.errors)
    reason = "within the tolerance" if chosen else "not asked for"
    left_out.append(f"orders above {order}: {reason}")


def _scene_in_words(plan: Plan, computed: list[str], left_out: list[str]) -> None:
    """Sun, view and geometry."""
    if plan.suns[1] <= HORIZON:
        left_out.append("twilight: the sun is above the horizon")
    if plan.suns[0] > 0:
        low, high = np.degrees(plan.suns)
        left_out.append(f"suns outside {low:.0f} to {high:.0f} degrees: not asked for")
    if plan.zenith_only:
        computed.append("the zenith")
        left_out.append("azimuth modes and other directions: only the zenith is looked at")
    if plan.geometry is not None:
        computed.append(f"{plan.geometry} geometry")
        left_out.append(f"the sphere: {plan.geometry} paths are within the tolerance")


def _constituents_in_words(
    atmosphere: Atmosphere, plan: Plan, computed: list[str], left_out: list[str]
) -> None:
    for name in ("molecules", "haze", "ground", "absorbers"):
        present = getattr(atmosphere, name)
        if not present:
            left_out.append(f"{name}: absent from the atmosphere")
        elif name in plan.without:
            left_out.append(f"{name}: within the tolerance")
        elif name == "ground" and plan.orders in (0, 1):
            left_out.append("ground: its light reaches the observer at two orders or more")
        else:
            computed.append(f"{len(present)} absorber(s)" if name == "absorbers" else name)


def _wavelengths_in_words(
    atmosphere: Atmosphere, plan: Plan, computed: list[str], left_out: list[str]
) -> None:
    if plan.quantity == "luminance":
        left_out.append("spectrum and chromaticity: only luminance is asked for")
    if plan.all_wavelengths:
        computed.append(f"every wavelength {_EVERY[plan.quantity]}")
    elif plan.quantity == "luminance":
        computed.append(f"luminance from {plan.luminance_nodes} wavelengths")
    else:
        computed.append(f"{plan.nodes.wavelength} wavelengths, interpolated")
        left_out.append("further wavelengths: log radiance is smooth between the nodes")
        if atmosphere.absorbers and "absorbers" not in plan.without:
            computed.append(f"absorption from two amounts at {plan.nodes.rough} wavelengths")


_EVERY = {"spectrum": "asked for", "luminance": "from 380 to 780 nm by 10 nm"}
