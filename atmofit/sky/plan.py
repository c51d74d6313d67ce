"""How a sky is computed: node counts on a ladder of accuracy. Python only, nothing traced."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.optics.atmosphere import LATEST_SUN, Atmosphere
from atmofit.sky.ladder import LADDER, Nodes, measured
from atmofit.typing import RealsLike

MAXIMUM_ORDERS = 20
QUANTITIES = ("spectrum", "luminance")
_TWILIGHT = 1.3  # times the sun angles where the field also serves twilight
_LUMINANCE_NODES = {5e-2: 3, 1e-2: 4, 2e-3: 7, 5e-4: 10}  # wavelengths that luminance alone needs
ZENITH = 1e-6  # a view zenith angle up to here counts as overhead [rad]


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is computed for a sky, with what accuracy, and what is left out.

    Attributes:
        orders: Scattering orders summed, or "all".
        rtol: Rung of the ladder, the promised relative error of luminance.
        nodes: Node counts.
        dtype: "float32" or "float64".
        all_wavelengths: Whether every wavelength asked for is computed.
        quantity: "spectrum", or "luminance" alone, from a few wavelengths of the plan's choice.
        zenith_only: Whether the field serves no direction but the zenith.
        latest_sun: Largest solar zenith angle that the field serves [rad].
        by_order: Whether the orders are kept apart.
        computed: In words.
        left_out: In words, each with its reason.
    """

    orders: int | str
    rtol: float
    nodes: Nodes
    dtype: str
    all_wavelengths: bool
    quantity: str = "spectrum"
    zenith_only: bool = False
    latest_sun: float = LATEST_SUN
    by_order: bool = False
    computed: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    @property
    def arriving_orders(self) -> int:
        """Orders of the light that is scattered once more on the way to the observer."""
        return self.nodes.steps + 1 if isinstance(self.orders, str) else self.orders - 1

    @property
    def modes(self) -> int:
        """Azimuth modes of the single-scattered light."""
        return 1 if self.zenith_only and self.orders == 2 else self.nodes.degrees

    @property
    def counts_peaks(self) -> bool:
        """Whether scattering into unresolved forward peaks is counted as scattering."""
        return self.orders not in (1, "all")

    @property
    def luminance_nodes(self) -> int:
        """Wavelengths computed where luminance alone is asked for; 0: all of 380 to 780 nm."""
        return 0 if self.all_wavelengths else _LUMINANCE_NODES[self.rtol]

    def __str__(self) -> str:
        """A table in plain text."""
        orders = "all orders" if self.orders == "all" else f"{self.orders} order(s)"
        lines = [f"Plan: {orders}, rtol {self.rtol:g}, {self.dtype}"]
        lines += [f"  computed: {line}" for line in self.computed]
        lines += [f"  left out: {line}" for line in self.left_out]
        if self.orders == 2:
            rung = measured(self.rtol, self.dtype)
            lines.append(
                f"  measured: luminance within {100 * rung.largest:.2g} % of the exact oracle; the "
                f"reference job of 60 skies took {rung.hot_seconds:.2g} s"
            )
        return "\n".join(lines)


def plan_sky(
    atmosphere: Atmosphere,
    *,
    solar_zenith_angle: RealsLike | None = None,
    directions: Directions | DirectionGrid | None = None,
    quantity: str = "spectrum",
    orders: int | str = 2,
    rtol: float = 1e-2,
    dtype: str | None = None,
    all_wavelengths: bool | None = None,
    by_order: bool = False,
) -> Plan:
    """Decide how a sky is computed.

    Args:
        atmosphere: Only which constituents exist counts, and whether their spectra are smooth.
        solar_zenith_angle: Known value or values [rad], 0 to 96 degrees; if all are above the
            horizon, twilight is left out, and the field serves no sun below it. A tracer is
            refused. None: whatever the geometry allows.
        directions: Known directions; if all are overhead, whatever depends on azimuth is left
            out, and the field serves the zenith only. A tracer is refused.
        quantity: "spectrum", or "luminance": no spectrum is computed, only the few wavelengths
            that luminance needs, see `SkyField.luminance`.
        orders: Scattering orders to sum, 1 to 20, or "all": converged, with the rest as a
            geometric series.
        rtol: Promised relative error of luminance, 5e-4 to 1; the next finer rung is taken.
        dtype: "float32" or "float64"; None: JAX's default.
        all_wavelengths: Compute every wavelength asked for instead of a few nodes; None: where
            the constituents demand it.
        by_order: Keep the orders apart, see `SkyField.radiance_by_order`; `orders` is a number.

    Raises:
        TypeError: The sun or a direction is a tracer.
        ValueError: A value lies outside its range.
    """
    latest_sun = _latest_sun(atmosphere, solar_zenith_angle)
    zenith_only = directions is not None and _all_overhead(directions)
    choice("quantity", quantity, QUANTITIES)
    _check_orders(orders, by_order)
    smallest = min(LADDER)
    in_range("rtol", rtol, smallest, 1.0)
    rung = max((r for r in LADDER if r <= rtol * (1 + 1e-9)), default=smallest)
    name = np.dtype(jnp.result_type(float) if dtype is None else dtype).name
    if name not in ("float32", "float64"):
        raise ValueError(f'dtype must be "float32" or "float64", got {name!r}')
    every = all_wavelengths if all_wavelengths is not None else not atmosphere.is_smooth
    # One order is cheap, and under a low sun its spectrum is too steep for few wavelengths.
    steep = quantity == "luminance" and orders == 1
    every = every or steep or (quantity == "spectrum" and LADDER[rung].wavelength == 0)
    nodes = LADDER[rung]
    if latest_sun > HORIZON:
        nodes = dataclasses.replace(nodes, sun=math.ceil(_TWILIGHT * nodes.sun))
    plan = Plan(orders, rung, nodes, name, every, quantity, zenith_only, latest_sun, by_order)
    computed, left_out = _in_words(atmosphere, plan)
    return dataclasses.replace(plan, computed=computed, left_out=left_out)


def _latest_sun(atmosphere: Atmosphere, solar_zenith_angle: RealsLike | None) -> float:
    """The largest solar zenith angle to serve [rad]."""
    latest = atmosphere.latest_sun
    if solar_zenith_angle is None:
        return latest
    if is_traced(solar_zenith_angle):
        raise TypeError("solar_zenith_angle of plan_sky must be known, got a tracer")
    known = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, latest)
    return HORIZON if float(np.max(np.asarray(known))) <= HORIZON else latest


def _check_orders(orders: int | str, by_order: bool) -> None:
    if orders != "all" and not (isinstance(orders, int) and 1 <= orders <= MAXIMUM_ORDERS):
        raise ValueError(f'orders must be 1 to {MAXIMUM_ORDERS} or "all", got {orders!r}')
    if by_order and orders == "all":
        raise ValueError('orders must be a number where they are kept apart, got "all"')


def _all_overhead(directions: Directions | DirectionGrid) -> bool:
    """Whether known directions all point to the zenith."""
    view, azimuth = directions.angles()
    if is_traced(view, azimuth):
        raise TypeError("directions of plan_sky must be known, got a tracer")
    angle_in_range("view_zenith_angle", view, 0.0, HORIZON)
    return float(np.max(np.asarray(view))) <= ZENITH


def _in_words(atmosphere: Atmosphere, plan: Plan) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is computed and what is left out."""
    n = plan.nodes
    computed = [f"single scattering, {n.view} nodes along the line of sight"]
    left_out = []
    if plan.orders == 1:
        left_out.append("second order: orders=1")
    else:
        computed.append(
            f"second order, {n.altitude} altitudes x {n.sun} sun angles x {n.degrees} moments"
        )
    if plan.orders == "all":
        computed.append(f"orders to {n.steps + 2}, the rest as a geometric series")
    else:
        if plan.orders not in (1, 2):
            computed.append(f"orders 3 to {plan.orders}")
        left_out.append(f"orders above {plan.orders}: not asked for")
    if plan.latest_sun <= HORIZON:
        left_out.append("twilight: the sun is above the horizon")
    for name in ("molecules", "haze", "ground"):
        if getattr(atmosphere, name) is None:
            left_out.append(f"{name}: absent from the atmosphere")
        elif name == "ground" and plan.orders == 1:
            left_out.append("ground: its light reaches the observer at two orders or more")
        else:
            computed.append(name)
    if atmosphere.absorbers:
        computed.append(f"{len(atmosphere.absorbers)} absorber(s)")
    else:
        left_out.append("absorbers: absent from the atmosphere")
    _wavelengths_in_words(plan, computed, left_out)
    if plan.zenith_only:
        computed.append("the zenith")
        left_out.append("azimuth modes and other directions: only the zenith is looked at")
    left_out.append("polarisation and refraction: not modelled")
    return tuple(computed), tuple(left_out)


def _wavelengths_in_words(plan: Plan, computed: list[str], left_out: list[str]) -> None:
    if plan.quantity == "luminance":
        left_out.append("spectrum and chromaticity: only luminance is asked for")
    if plan.all_wavelengths:
        computed.append(f"every wavelength {_EVERY[plan.quantity]}")
    elif plan.quantity == "luminance":
        computed.append(f"luminance from {plan.luminance_nodes} wavelengths")
    else:
        computed.append(f"{plan.nodes.wavelength} wavelengths, interpolated")
        left_out.append("further wavelengths: log radiance is smooth between the nodes")


_EVERY = {"spectrum": "asked for", "luminance": "from 380 to 780 nm by 10 nm"}
