"""Directions on the sky dome and the angle between them and the sun."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import safe_sqrt
from atmofit.typing import Reals, RealsLike, real_array

HORIZON = np.pi / 2


class Directions(eqx.Module):
    """A list of view directions.

    Attributes:
        view_zenith_angle: 0 overhead, pi/2 at the horizon [rad].
        relative_azimuth: 0 toward the sun [rad].
        rings: How many consecutive directions share one zenith angle, ring by ring; their work
            along the line of sight is then shared. Static; None: every direction stands alone.
    """

    view_zenith_angle: Float[Array, " direction"] = eqx.field(converter=real_array)
    relative_azimuth: Float[Array, " direction"] = eqx.field(converter=real_array)
    rings: tuple[int, ...] | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        """Check that both arrays and the rings describe the same list."""
        zenith, azimuth = self.view_zenith_angle, self.relative_azimuth
        if zenith.ndim != 1 or zenith.shape != azimuth.shape:
            raise ValueError(
                "view_zenith_angle and relative_azimuth must be two lists of one length, "
                f"got shapes {zenith.shape} and {azimuth.shape}"
            )
        if zenith.size == 0:
            raise ValueError("view_zenith_angle must hold at least one direction, got none")
        if self.rings is not None and not (
            all(isinstance(count, int) and count > 0 for count in self.rings)
            and sum(self.rings) == zenith.size
        ):
            raise ValueError(
                f"rings must be whole numbers above 0 that add up to {zenith.size}, "
                f"got {self.rings}"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a quantity given on these directions."""
        return self.view_zenith_angle.shape

    def angles(self) -> tuple[Reals, Reals]:
        """View zenith angle and relative azimuth of every direction, both of `shape`."""
        return self.view_zenith_angle, self.relative_azimuth

    def checked(self) -> "Directions":
        """Refuse directions below the horizon and values that are not finite."""
        zenith = angle_in_range("view_zenith_angle", self.view_zenith_angle, 0.0, HORIZON)
        azimuth = in_range("relative_azimuth", self.relative_azimuth, -np.inf, np.inf)
        if self.rings is not None and not is_traced(self.view_zenith_angle):
            same = np.repeat(np.asarray(zenith)[self.ring_starts], self.rings)
            if not np.array_equal(same, np.asarray(zenith)):
                raise ValueError("view_zenith_angle must be constant in each of the rings")
        return Directions(zenith, azimuth, self.rings)

    @property
    def ring_starts(self) -> np.ndarray:
        """Index of the first direction of each ring."""
        counts = np.asarray(self.rings if self.rings is not None else (1,) * self.shape[0])
        return np.concatenate([[0], np.cumsum(counts)[:-1]])


extremes(
    call=lambda view_zenith_angle, relative_azimuth: Directions(
        view_zenith_angle[None], relative_azimuth[None]
    ).checked(),
    view_zenith_angle=Domain(0.0, HORIZON),
    relative_azimuth=Domain(-np.inf, np.inf),
)(Directions)


class DirectionGrid(eqx.Module):
    """The product of zenith angles and azimuths.

    Attributes:
        view_zenith_angle: 0 overhead, pi/2 at the horizon [rad].
        relative_azimuth: 0 toward the sun [rad].
    """

    view_zenith_angle: Float[Array, " zenith"] = eqx.field(converter=real_array)
    relative_azimuth: Float[Array, " azimuth"] = eqx.field(converter=real_array)

    def __check_init__(self) -> None:
        """Check that both axes are lists."""
        for name in ("view_zenith_angle", "relative_azimuth"):
            axis = getattr(self, name)
            if axis.ndim != 1 or axis.size == 0:
                raise ValueError(f"{name} must be a list that is not empty, got shape {axis.shape}")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a quantity given on these directions."""
        return (self.view_zenith_angle.size, self.relative_azimuth.size)

    def angles(self) -> tuple[Reals, Reals]:
        """View zenith angle and relative azimuth of every direction, both of `shape`."""
        zenith, azimuth = jnp.meshgrid(self.view_zenith_angle, self.relative_azimuth, indexing="ij")
        return zenith, azimuth

    def as_list(self) -> Directions:
        """The same directions, zenith by zenith, as a list that shares the rings' work."""
        zenith, azimuth = self.angles()
        rings = (self.relative_azimuth.size,) * self.view_zenith_angle.size
        return Directions(zenith.ravel(), azimuth.ravel(), rings)


extremes(
    call=lambda view_zenith_angle, relative_azimuth: (
        DirectionGrid(view_zenith_angle[None], relative_azimuth[None]).as_list().checked()
    ),
    view_zenith_angle=Domain(0.0, HORIZON),
    relative_azimuth=Domain(-np.inf, np.inf),
)(DirectionGrid)


def dome_343() -> Directions:
    """The reference dome: the zenith and 18 rings of 19 azimuths on the half circle.

    Rings at 5, 10, ..., 85 and 89 degrees; azimuths 0, 10, ..., 180 degrees. The paper gives the
    number 343 only; this layout is ours.
    """
    zenith = np.radians([*range(5, 90, 5), 89])
    azimuth = np.radians(np.arange(0, 181, 10))
    return Directions(
        np.concatenate([[0.0], np.repeat(zenith, azimuth.size)]),
        np.concatenate([[0.0], np.tile(azimuth, zenith.size)]),
        (1,) + (azimuth.size,) * zenith.size,
    )


@extremes(
    Case(
        "at the sun",
        {"view_zenith_angle": 0.7, "relative_azimuth": 0.0, "solar_zenith_angle": 0.7},
        limit=0.0,
        slope={"view_zenith_angle": 0.0, "relative_azimuth": 0.0, "solar_zenith_angle": 0.0},
    ),
    Case(
        "next to the sun",
        {"view_zenith_angle": 0.5 + 2**-10, "relative_azimuth": 0.0, "solar_zenith_angle": 0.5},
        limit=2**-10,
        slope={"view_zenith_angle": 1.0, "relative_azimuth": 0.0, "solar_zenith_angle": -1.0},
        ulps=8.0,
        size=1.0,
    ),
    Case(
        "opposite the sun",
        {"view_zenith_angle": HORIZON, "relative_azimuth": np.pi, "solar_zenith_angle": HORIZON},
        limit=np.pi,
    ),
    Case(
        "both overhead",
        {"view_zenith_angle": 0.0, "relative_azimuth": 1.0, "solar_zenith_angle": 0.0},
        limit=0.0,
    ),
    view_zenith_angle=Span(0.0, np.pi),
    relative_azimuth=Span(-np.pi, np.pi),
    solar_zenith_angle=Span(0.0, np.pi),
)
def scattering_angle(
    view_zenith_angle: RealsLike, relative_azimuth: RealsLike, solar_zenith_angle: RealsLike
) -> Reals:
    """Angle between a view direction and the sun.

    Exact to rounding at every angle; where the two directions coincide (or are opposite) the
    gradient, which has no limit there, is 0.

    Args:
        view_zenith_angle: [rad].
        relative_azimuth: 0 toward the sun [rad].
        solar_zenith_angle: [rad]. The three arguments broadcast.

    Returns:
        Scattering angle, 0 to pi [rad].
    """
    view, azimuth, sun = jnp.broadcast_arrays(
        real_array(view_zenith_angle), real_array(relative_azimuth), real_array(solar_zenith_angle)
    )
    # Haversines of the angle and of its supplement, each free of cancellation.
    across = jnp.sin(view) * jnp.sin(sun)
    near = jnp.sin((view - sun) / 2) ** 2 + across * jnp.sin(azimuth / 2) ** 2
    far = jnp.cos((view + sun) / 2) ** 2 + across * jnp.cos(azimuth / 2) ** 2
    return 2 * jnp.arctan2(safe_sqrt(near), safe_sqrt(far))
