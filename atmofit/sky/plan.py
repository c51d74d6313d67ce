"""How a sky is computed: node counts on a ladder of accuracy. Python only, nothing traced."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.geometry import HORIZON
from atmofit.optics.atmosphere import Atmosphere
from atmofit.typing import RealsLike


@dataclasses.dataclass(frozen=True)
class Nodes:
    """Node counts of one rung of the ladder.

    Attributes:
        view: Along the line of sight for the first order.
        view_second: Along the line of sight for the second order.
        altitude: Altitudes at which the single-scattered light is known.
        sun: Local solar zenith angles at which it is known.
        polar: Directions from the horizon to the zenith, and to the nadir.
        limb: Directions between the level and the ground's horizon.
        azimuth: Azimuths on the half circle.
        bend: Azimuths at which the curvature of the planet is followed (1 in a flat one).
        path: Along each of these directions.
        modes: Azimuth modes of the single-scattered light.
        degrees: Legendre moments of the phase functions in the second scattering.
        wavelength: Wavelengths between which log radiance is interpolated; 0: all that are asked.
    """

    view: int
    view_second: int
    altitude: int
    sun: int
    polar: int
    limb: int
    azimuth: int
    bend: int
    path: int
    modes: int
    degrees: int
    wavelength: int


LADDER: dict[float, Nodes] = {
    5e-2: Nodes(24, 10, 12, 20, 8, 4, 10, 2, 12, 6, 10, 7),
    1e-2: Nodes(32, 14, 16, 24, 12, 4, 16, 3, 14, 8, 16, 9),
    2e-3: Nodes(48, 20, 20, 40, 18, 8, 28, 4, 20, 16, 26, 12),
    5e-4: Nodes(64, 32, 32, 72, 28, 12, 40, 5, 28, 24, 36, 0),
}


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is computed for a sky, with what accuracy, and what is left out.

    Attributes:
        orders: Scattering orders summed.
        rtol: Rung of the ladder, the promised relative error of luminance.
        nodes: Node counts.
        dtype: "float32" or "float64".
        all_wavelengths: Whether every wavelength asked for is computed.
        computed: In words.
        left_out: In words, each with its reason.
    """

    orders: int
    rtol: float
    nodes: Nodes
    dtype: str
    all_wavelengths: bool
    computed: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    def __str__(self) -> str:
        """A table in plain text."""
        lines = [f"Plan: {self.orders} order(s), rtol {self.rtol:g}, {self.dtype}"]
        lines += [f"  computed: {line}" for line in self.computed]
        lines += [f"  left out: {line}" for line in self.left_out]
        return "\n".join(lines)


def plan_sky(
    atmosphere: Atmosphere,
    *,
    solar_zenith_angle: RealsLike | None = None,
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
        orders: 1 or 2.
        rtol: Promised relative error of luminance, 5e-4 to 1; the next finer rung is taken.
        dtype: "float32" or "float64"; None: JAX's default.
        all_wavelengths: Compute every wavelength asked for instead of a few nodes; None: where
            the constituents demand it.

    Raises:
        TypeError: The sun is a tracer.
        ValueError: A value lies outside its range.
    """
    if solar_zenith_angle is not None:
        if is_traced(solar_zenith_angle):
            raise TypeError("solar_zenith_angle of plan_sky must be known, got a tracer")
        angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    if orders not in (1, 2):
        raise ValueError(f"orders must be 1 or 2, got {orders!r}")
    smallest = min(LADDER)
    in_range("rtol", rtol, smallest, 1.0)
    rung = max((r for r in LADDER if r <= rtol * (1 + 1e-9)), default=smallest)
    name = np.dtype(jnp.result_type(float) if dtype is None else dtype).name
    if name not in ("float32", "float64"):
        raise ValueError(f'dtype must be "float32" or "float64", got {name!r}')
    every = all_wavelengths if all_wavelengths is not None else not atmosphere.is_smooth
    every = every or LADDER[rung].wavelength == 0
    return Plan(
        orders, rung, LADDER[rung], name, every, *_in_words(atmosphere, orders, every, rung)
    )


def _in_words(
    atmosphere: Atmosphere, orders: int, every: bool, rung: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is computed and what is left out."""
    n = LADDER[rung]
    computed = [f"single scattering, {n.view} nodes along the line of sight"]
    left_out = []
    if orders > 1:
        computed.append(
            f"second order, {n.altitude} altitudes x {n.sun} sun angles x {n.degrees} moments"
        )
    else:
        left_out.append("second order: orders=1")
    left_out.append(f"orders above {orders}: not asked for")
    for name in ("molecules", "haze", "ground"):
        if getattr(atmosphere, name) is None:
            left_out.append(f"{name}: absent from the atmosphere")
        elif name == "ground" and orders < 2:
            left_out.append("ground: its light reaches the observer at two orders or more")
        else:
            computed.append(name)
    if atmosphere.absorbers:
        computed.append(f"{len(atmosphere.absorbers)} absorber(s)")
    else:
        left_out.append("absorbers: absent from the atmosphere")
    if every:
        computed.append("every wavelength asked for")
    else:
        computed.append(f"{n.wavelength} wavelengths, interpolated")
        left_out.append("further wavelengths: log radiance is smooth between the nodes")
    left_out.append("polarisation and refraction: not modelled")
    return tuple(computed), tuple(left_out)
