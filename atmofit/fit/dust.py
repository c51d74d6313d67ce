"""What a slab of dust is made of, from its brightness in several geometries.

Optical depth, single-scattering albedo and a phase function of two Henyey-Greenstein lobes, one
ahead and one behind, by least squares from several starts.
"""

import math
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.fit import few_parameters
from atmofit.fit.ranges import RangedFit, Ranges, Values, even_places, log_ratio
from atmofit.geometry import HORIZON, Directions, scattering_angle
from atmofit.media.doubling import doublings_for
from atmofit.media.slab import SMALLEST_COSINE, lit_and_seen
from atmofit.media.slab_plan import SlabPlan
from atmofit.media.slab_solution import solve_slab
from atmofit.numerics import safe_divide, safe_sqrt
from atmofit.optics.particle_phases import PhaseSum
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.typing import Reals, RealsLike, Scalar, real_array

ORDERS = ("single", "all")
RANGES = Ranges(
    (
        ("optical_depth", 1e-3, 100.0),
        ("single_scattering_albedo", 0.0, 1.0),
        ("backward_weight", 0.0, 1.0),
        ("forward_asymmetry", 0.0, 0.95),
        ("backward_asymmetry", -0.95, 0.0),
    ),
    logarithmic=("optical_depth",),
)
NAMES = RANGES.names
PLAN = SlabPlan(16, 16, doublings_for(100.0, 16))
MAX_STEPS = 100
_CANDIDATES = 128  # places where the misfit is looked at before the searches
_LINEAR_BELOW = 0.01  # of the measured: where the logarithm goes on as its tangent
_SLACK = 1e-3  # of a cosine, for rounded angles


class SlabView(eqx.Module):
    """From where a slab is lit and seen, one entry for each measurement.

    Attributes:
        view_cosine: Of the angle between the normal on the observer's side and the observer,
            1e-6 to 1 [-].
        solar_cosine: Of that between the same normal and the sun, -1 to 1 [-]; below 0 the
            unlit side is seen.
        scattering_angle: 0 = straight on [rad]; pi minus the phase angle. The three broadcast.
    """

    view_cosine: Float[Array, " n"] = eqx.field(converter=real_array)
    solar_cosine: Float[Array, " n"] = eqx.field(converter=real_array)
    scattering_angle: Float[Array, " n"] = eqx.field(converter=real_array)

    def __init__(
        self, view_cosine: RealsLike, solar_cosine: RealsLike, scattering_angle: RealsLike
    ) -> None:
        """Bring the three to one list."""
        three = (real_array(x) for x in (view_cosine, solar_cosine, scattering_angle))
        lists = jnp.broadcast_arrays(*three)
        self.view_cosine, self.solar_cosine, self.scattering_angle = map(jnp.atleast_1d, lists)

    @staticmethod
    def from_angles(
        view_zenith_angle: RealsLike, solar_zenith_angle: RealsLike, relative_azimuth: RealsLike
    ) -> "SlabView":
        """A slab that lies level under the sun.

        Args:
            view_zenith_angle: Of the direction looked in, 0 to pi [rad]: over pi/2 the lit side is
                seen from above, under it the other from below.
            solar_zenith_angle: 0 to pi/2 [rad].
            relative_azimuth: 0 toward the sun [rad]. The three broadcast.

        Raises:
            ValueError: A known angle is out of range.
        """
        view = angle_in_range("view_zenith_angle", view_zenith_angle, 0.0, math.pi)
        sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
        azimuth = in_range("relative_azimuth", relative_azimuth, -math.inf, math.inf)
        up, lit = jnp.cos(view), jnp.clip(jnp.cos(sun), 0.0, 1.0)
        seen = jnp.clip(jnp.abs(up), SMALLEST_COSINE, 1.0)
        side = jnp.where(up > 0, -1.0, 1.0).astype(lit.dtype)
        return SlabView(seen, side * lit, scattering_angle(view, azimuth, sun))

    def checked(self) -> "SlabView":
        """Refuse impossible values, and angles that the two cosines do not allow."""
        view = SlabView(
            in_range("view_cosine", self.view_cosine, SMALLEST_COSINE, 1.0),
            in_range("solar_cosine", self.solar_cosine, -1.0, 1.0),
            angle_in_range("scattering_angle", self.scattering_angle, 0.0, math.pi),
        )
        if not is_traced(view):
            middle, reach = (np.asarray(x, float) for x in view.cosine_range())
            angle = np.asarray(view.scattering_angle, float)
            bad = np.abs(np.cos(angle) - middle) > reach + _SLACK
            if bad.any():
                k = int(np.argmax(bad))
                low, high = np.arccos(np.clip([middle + reach, middle - reach], -1.0, 1.0))[:, k]
                raise ValueError(
                    f"scattering_angle must be between {low:.6g} and {high:.6g} rad for the "
                    f"cosines of measurement {k}, got {angle[k]:.6g} ({bad.sum()} of {bad.size} "
                    "values)"
                )
        return view

    def cosine_range(self) -> tuple[Reals, Reals]:
        """Middle and half width of the cosines of the scattering angle that can be [-]."""
        sines = safe_sqrt(1 - self.view_cosine**2) * safe_sqrt(1 - self.solar_cosine**2)
        return -self.view_cosine * self.solar_cosine, sines

    def relative_azimuth(self) -> Reals:
        """Azimuth of the direction looked in, 0 toward the sun [rad]; pi/2 where there is none."""
        middle, reach = self.cosine_range()
        cosine = jnp.clip(safe_divide(jnp.cos(self.scattering_angle) - middle, reach), -1.0, 1.0)
        return jnp.arctan2(safe_sqrt(1 - cosine**2), cosine)


class DustFit(RangedFit):
    """What `fit_dust` found.

    The values are optical depth, single-scattering albedo, share of the backward lobe in the
    scattered light, and mean cosines of the scattering angle of the forward and the backward lobe;
    the residuals ln(model / measured) / noise, linear where the model is below 1 % of the measured.

    Attributes:
        orders: "single" or "all". Static.
        plan: Of the solver for all orders. Static.
    """

    NAMES = RANGES.names
    orders: str = eqx.field(static=True)
    plan: SlabPlan = eqx.field(static=True)

    @property
    def phase(self) -> PhaseSum:
        """The phase function."""
        return _phase(dict(zip(NAMES, self.values, strict=True)))

    def predict(self, view: SlabView) -> Reals:
        """Radiance over the sun's irradiance in other geometries [1/sr], [n]."""
        return _predict(self.values, view.checked(), self.orders, self.plan)

    def __str__(self) -> str:
        """Values, errors, and what is not determined."""
        return f"{self.orders} scattering, {super().__str__()}"


def fit_dust(
    view: SlabView,
    radiance: RealsLike,
    *,
    relative_noise: RealsLike = 0.02,
    orders: str = "single",
    known: Mapping[str, RealsLike] | None = None,
    starts: int = 4,
    plan: SlabPlan = PLAN,
    max_steps: int = MAX_STEPS,
) -> DustFit:
    """Fit a slab of dust to its brightness in several geometries.

    Least squares of ln(model / measured) / noise by Levenberg-Marquardt in free variables, from
    the best of 128 fixed places. Standard errors come from the noise as given and from the
    derivatives at the minimum: right where the model holds and the noise is small.

    Args:
        view: The geometries; at least as many as free parameters.
        radiance: Over the sun's irradiance across its rays, one for each geometry, above 0 [1/sr].
        relative_noise: Standard deviation over the value, 1e-6 to 0.5 [-], a number or a list.
        orders: "single" scattering or "all" orders. Static.
        known: Values by name (`optical_depth` .001 to 100, `single_scattering_albedo`,
            `backward_weight` 0 to 1, `forward_asymmetry` 0 to .95, `backward_asymmetry` -.95 to 0)
            that are not sought. The names are static, the values not.
        starts: Searches, 1 to 32. Static.
        plan: For all orders. Static.
        max_steps: Of one search. Static.

    Returns:
        The fit; nothing is raised if the search fails, see `converged`. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: A known argument is out of range, an unknown name, lists that do not fit, or
            fewer measurements than free parameters.
    """
    choice("orders", orders, ORDERS)
    in_range("starts", starts, 1.0, 32.0)
    in_range("max_steps", max_steps, 1.0, 1e6)
    view = view.checked()
    measured = in_range("radiance", radiance, 1e-30, 1e30, "1/sr")
    noise = in_range("relative_noise", relative_noise, 1e-6, 0.5)
    if measured.shape != view.view_cosine.shape or noise.shape not in ((), measured.shape):
        raise ValueError(
            f"radiance and relative_noise must fit the {view.view_cosine.size} geometries, "
            f"got shapes {measured.shape} and {noise.shape}"
        )
    given = RANGES.checked(known)
    free = RANGES.free(given)
    if measured.size < len(free):
        raise ValueError(
            f"radiance must be at least {len(free)} for {len(free)} free parameters, "
            f"got {measured.size}"
        )
    dtype = jnp.result_type(float)
    view, measured, noise, given = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, dtype), (view, measured, noise, given)
    )
    found = _fit(view, measured, noise, given, orders, starts, plan, max_steps)
    return DustFit(**found, free=free, orders=orders, plan=plan)


@eqx.filter_jit
def _fit(
    view: SlabView,
    measured: Float[Array, " n"],
    noise: Reals,
    known: Values,
    orders: str,
    starts: int,
    plan: SlabPlan,
    max_steps: int,
) -> dict[str, Array]:
    count = len(RANGES.free(known))

    def residuals(place: Reals) -> Reals:
        ratio = _model(RANGES.at(place, known), view, orders, plan) / measured
        return log_ratio(ratio, _LINEAR_BELOW) / noise

    table = jnp.asarray(even_places(count, _CANDIDATES), measured.dtype)
    loss = jax.lax.map(lambda place: jnp.sum(residuals(place) ** 2), table, batch_size=8)
    best = jax.lax.top_k(-jnp.where(jnp.isfinite(loss), loss, jnp.inf), starts)[1]
    weight = jnp.sqrt(jnp.sum(jnp.broadcast_to(noise, measured.shape) ** -2))
    rounding = few_parameters.rounding_of(weight, float(jnp.finfo(measured.dtype).eps))
    size = jnp.full(count, weight)

    def search(place: Reals) -> tuple[few_parameters.Valley, Array, Array]:
        # Second derivatives find the floor where single scattering does not hold the data; of all
        # orders they would take minutes to compile.
        exact = orders == "single"
        return few_parameters.descend(residuals, place, size, rounding, max_steps, exact)

    ends, converged, steps = jax.lax.map(search, table[best])
    depth = jnp.sum(ends.residuals**2, axis=1)
    at = jnp.argmin(jnp.where(jnp.isfinite(depth), depth, jnp.inf))
    # A search that never could begin ends where it knows nothing.
    begun = jnp.isfinite(loss[best[at]])
    end = jax.tree.map(lambda leaf: jnp.where(begun, leaf[at], jnp.nan), ends)
    return RANGES.worth(end, known) | {"converged": converged[at], "steps": jnp.sum(steps)}


@eqx.filter_jit
def _predict(values: Reals, view: SlabView, orders: str, plan: SlabPlan) -> Reals:
    view = jax.tree.map(lambda leaf: leaf.astype(values.dtype), view)
    return _model(dict(zip(NAMES, values, strict=True)), view, orders, plan)


def _phase(values: Values) -> PhaseSum:
    weight = values["backward_weight"]
    ahead, behind = values["forward_asymmetry"], values["backward_asymmetry"]
    lobes = HenyeyGreenstein(ahead), HenyeyGreenstein(behind)
    return PhaseSum(jnp.stack([1 - weight, weight]), lobes)


def _model(values: Values, view: SlabView, orders: str, plan: SlabPlan) -> Reals:
    """Radiance over irradiance [1/sr]."""
    depth, albedo = values["optical_depth"], values["single_scattering_albedo"]
    if orders == "single":
        scattered = albedo * _phase(values)(view.scattering_angle)
        return scattered * lit_and_seen(depth, view.view_cosine, view.solar_cosine)
    sun, seen = jnp.arccos(jnp.abs(view.solar_cosine)), jnp.arccos(view.view_cosine)
    below = view.solar_cosine < 0
    zenith = jnp.where(below, seen, math.pi - seen)
    solved = solve_slab(
        optical_depth=depth,
        single_scattering_albedo=albedo,
        phase=_phase(values),
        solar_zenith_angle=sun,
        plan=plan,
    )
    # Of every view under every sun, those that were measured; most of the work is the slab's.
    return jnp.diagonal(solved.radiance(Directions(zenith, view.relative_azimuth())))


extremes(
    Case("back at the sun", {"view": 2.0, "sun": math.pi - 2.0, "azimuth": math.pi}),
    Case("straight through", {"view": 1.0, "sun": 1.0, "azimuth": 0.0}),
    Case("overhead", {"view": 0.0, "sun": 0.0}),
    Case("both level", {"view": HORIZON, "sun": HORIZON}),
    call=lambda view, sun, azimuth: (
        *(x[0] for x in jax.tree.leaves(SlabView.from_angles(view, sun, azimuth).checked())),
        SlabView.from_angles(view, sun, azimuth).relative_azimuth()[0],
    ),
    view=Domain(0.0, math.pi),
    sun=Domain(0.0, HORIZON),
    azimuth=Span(-math.pi, math.pi),
)(SlabView)

_TURNS = np.linspace(0.1, 3.0, 12)


def _fitted(radiance: Reals, relative_noise: Scalar) -> tuple[Reals, ...]:
    view = SlabView.from_angles(2.5, 0.9, _TURNS)
    found = fit_dust(view, radiance, relative_noise=relative_noise, starts=2)
    return found.values, found.residuals


extremes(
    Case("far too dark", {"radiance": np.full(12, 1e-10)}),
    Case("far too bright", {"radiance": np.full(12, 1e10)}),
    Case("one bright", {"radiance": np.append(np.full(11, 0.02), 10.0)}),
    Case("tiny noise", {"relative_noise": 1e-6}),
    call=_fitted,
    derivative="none",
    heavy=True,
    radiance=Span(np.full(12, 0.01), np.linspace(0.02, 0.1, 12)),
    relative_noise=Domain(1e-6, 0.5),
)(fit_dust)
