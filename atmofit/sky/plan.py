"""How a sky is computed: what `plan_sky` decides. Python only, nothing traced."""

import dataclasses
from typing import Any

from atmofit.optics.atmosphere import LATEST_SUN, Atmosphere
from atmofit.sky.ladder import Nodes, measured
from atmofit.sky.sun_angles import SunRange

ZENITH = 1e-6  # a view zenith angle up to here counts as overhead [rad]


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is computed for a sky, with what accuracy, and what is left out.

    Attributes:
        orders: Scattering orders summed, or "all"; 0 for the sun alone.
        rtol: Rung of the ladder, the promised relative error of luminance.
        nodes: Node counts.
        dtype: "float32" or "float64".
        all_wavelengths: Whether every wavelength asked for is computed.
        quantity: "spectrum"; or "luminance" alone, from a few wavelengths of the plan's choice;
            or "sun", the unscattered light alone.
        zenith_only: Whether the field serves no direction but the zenith.
        luminance_nodes: Wavelengths computed for luminance alone; 0: all of 380 to 780 nm.
        suns: Least and largest solar zenith angle that the field serves [rad].
        by_order: Whether the orders are kept apart.
        geometry: Taken in place of the atmosphere's, or None.
        without: Constituents that are left out though the atmosphere has them.
        slopes: Plan of the sky whose slopes stand for those of this one, or None: exact.
        errors: What was chosen by value, and by how much each is predicted to miss luminance.
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
    suns: SunRange = (0.0, LATEST_SUN)
    luminance_nodes: int = 0
    by_order: bool = False
    geometry: str | None = None
    without: tuple[str, ...] = ()
    slopes: "Plan | None" = None
    errors: tuple[tuple[str, float], ...] = dataclasses.field(default=(), compare=False)
    computed: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    @property
    def arriving_orders(self) -> int:
        """Orders of the light that is scattered once more on the way to the observer."""
        return self.nodes.steps + 1 if isinstance(self.orders, str) else self.orders - 1

    @property
    def predicted_error(self) -> float:
        """Relative error of luminance that all predicted ones add up to; 0 if none was."""
        return sum(error for _, error in self.errors)

    @property
    def modes(self) -> int:
        """Azimuth modes of the single-scattered light."""
        return 1 if self.zenith_only and self.orders == 2 else self.nodes.degrees

    @property
    def counts_peaks(self) -> bool:
        """Whether scattering into unresolved forward peaks is counted as scattering."""
        return self.orders not in (1, "all")

    def simplified(self, atmosphere: Atmosphere) -> Atmosphere:
        """The atmosphere that is computed in place of another."""
        changes: dict[str, Any] = dict.fromkeys(self.without)
        if "absorbers" in changes:
            changes["absorbers"] = ()
        if self.geometry is not None:
            changes["geometry"] = self.geometry
        return dataclasses.replace(atmosphere, **changes)

    def __str__(self) -> str:
        """A table in plain text."""
        orders = "all orders" if self.orders == "all" else f"{self.orders} order(s)"
        lines = [f"Plan: {orders}, rung {self.rtol:g}, {self.dtype}"]
        lines += [f"  computed: {line}" for line in self.computed]
        lines += [f"  left out: {line}" for line in self.left_out]
        lines += [f"  predicted error: {what} {100 * e:.2g} %" for what, e in self.errors]
        if self.errors:
            lines.append(f"  predicted error: {100 * self.predicted_error:.2g} % at most, in all")
        elif self.orders == 2:
            rung = measured(self.rtol, self.dtype)
            lines.append(
                f"  measured: luminance within {100 * rung.largest:.2g} % of the exact oracle; the "
                f"reference job of 60 skies took {rung.hot_seconds:.2g} s"
            )
        return "\n".join(lines)
