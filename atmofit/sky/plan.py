"""How a sky is computed: node counts on a ladder of accuracy. Python only, nothing traced."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.optics.atmosphere import Atmosphere
from atmofit.sky.ladder import LADDER, Nodes, measured
from atmofit.typing import RealsLike

QUANTITIES = ("spectrum", "luminance")
_LUMINANCE_NODES = {5e-2: 3, 1e-2: 4, 2e-3: 7, 5e-4: 10}  # wavelengths that luminance alone needs
ZENITH = 1e-6  # a view zenith angle up to here counts as overhead [rad]


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is computed for a sky, with what accuracy, and what is left out.

    Attributes:
        orders: Scattering orders summed.
        rtol: Rung of the ladder, the promised relative error of luminance.
        nodes: Node counts.
        dtype: "float32" or "float64".
        all_wavelengths: Whether every wavelength asked for is computed.
        quantity: "spectrum", or "luminance" alone, from a few wavelengths of the plan's choice.
        zenith_only: Whether the field serves no direction but the zenith.
        computed: In words.
        left_out: In words, each with its reason.
    """

    orders: int
    rtol: float
    nodes: Nodes
    dtype: str
    all_wavelengths: bool
    quantity: str = "spectrum"
    zenith_only: bool = False
    computed: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    @property
    def luminance_nodes(self) -> int:
        """Wavelengths computed where luminance alone is asked for; 0: all of 380 to 780 nm."""
        return 0 if self.all_wavelengths else _LUMINANCE_NODES[self.rtol]

    def __str__(self) -> str:
        """A table in plain text."""
        lines = [f"Plan: {self.orders} order(s), rtol {self.rtol:g}, {self.dtype}"]
        lines += [f"  computed: {line}" for line in self.computed]
        lines += [f"  left out: {line}" for line in self.left_out]
        if self.orders == 2 and self.nodes == LADDER[self.rtol]:
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
    orders: int = 2,
    rtol: float = 1e-2,
    dtype: str | None = None,
    all_wavelengths: bool | None = None,
) -> Plan:
    """Decide how a sky is computed.

    Args:
        atmosphere: Only which constituents exist counts, and whether their spectra are smooth.
        solar_zenith_angle: Known value or values [rad], checked against the simulator's domain;
            a tracer is refused.
        directions: Known directions; if all are overhead, whatever depends on azimuth is left
            out, and the field serves the zenith only. A tracer is refused.
        quantity: "spectrum", or "luminance": no spectrum is computed, only the few wavelengths
            that luminance needs, see `SkyField.luminance`.
        orders: 1 or 2.
        rtol: Promised relative error of luminance, 5e-4 to 1; the next finer rung is taken.
        dtype: "float32" or "float64"; None: JAX's default.
        all_wavelengths: Compute every wavelength asked for instead of a few nodes; None: where
            the constituents demand it.

    Raises:
        TypeError: The sun or a direction is a tracer.
        ValueError: A value lies outside its range.
    """
    if solar_zenith_angle is not None:
        if is_traced(solar_zenith_angle):
            raise TypeError("solar_zenith_angle of plan_sky must be known, got a tracer")
        angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    zenith_only = directions is not None and _all_overhead(directions)
    choice("quantity", quantity, QUANTITIES)
    if orders not in (1, 2):
        raise ValueError(f"orders must be 1 or 2, got {orders!r}")
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
    nodes = dataclasses.replace(LADDER[rung], modes=1) if zenith_only else LADDER[rung]
    plan = Plan(orders, rung, nodes, name, every, quantity, zenith_only)
    computed, left_out = _in_words(atmosphere, plan)
    return dataclasses.replace(plan, computed=computed, left_out=left_out)


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
    if plan.orders > 1:
        computed.append(
            f"second order, {n.altitude} altitudes x {n.sun} sun angles x {n.degrees} moments"
        )
    else:
        left_out.append("second order: orders=1")
    left_out.append(f"orders above {plan.orders}: not asked for")
    for name in ("molecules", "haze", "ground"):
        if getattr(atmosphere, name) is None:
            left_out.append(f"{name}: absent from the atmosphere")
        elif name == "ground" and plan.orders < 2:
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
