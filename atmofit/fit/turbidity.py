"""Turbidity from a measured sky, by an analytic model or by the simulator."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import choice, in_range
from atmofit.fit import one_parameter
from atmofit.fit.observation import Observation
from atmofit.fit.weighting import safe_log
from atmofit.geometry import DirectionGrid, Directions
from atmofit.models.preetham import PREETHAM_1999, PreethamModel
from atmofit.models.sky_model import SkyModel
from atmofit.optics.atmosphere import Atmosphere
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import simulate_luminance
from atmofit.typing import Reals, RealsLike, Scalar

SIMULATED_RANGE = (1.0, 30.0)
MAX_STEPS = 40
_TWO_SIDED_95 = 1.959964  # of the normal distribution
_COARSEST = 5e-2  # rung of the ladder that the scan uses
_SCAN_ANALYTIC, _SCAN_SIMULATED = 48, 12  # nodes in log T; they follow log luminance to 0.4 %


class TurbidityEstimate(eqx.Module):
    """A turbidity and what it is worth.

    The standard error is that of the noise alone: what the estimate would scatter by if the sky
    were measured again with new noise. A model that does not hold the sky shifts the estimate by
    an amount that no standard error shows; `reduced_chi_square` far above 1 tells that it does
    not, and `scaled_by_residual` widens the interval accordingly.

    Attributes:
        value: Turbidity.
        standard_error: Of the value, from the relative noise of the observation.
        reduced_chi_square: Sum of the squared residuals in units of their noise, over their number
            less one; near 1 if the model holds the sky to within the noise.
        rms: Root mean square of log(model / measured).
        converged: Whether the search ended at a minimum, in the range or at its end.
        at_edge: Whether the minimum lies at an end of the range or beyond; the true turbidity may
            then be far beyond, and the standard error means nothing.
        steps: Steps of the search.
        model: Its name. Static.
        turbidity_range: That was searched. Static.
    """

    value: Float[Array, ""]
    standard_error: Float[Array, ""]
    reduced_chi_square: Float[Array, ""]
    rms: Float[Array, ""]
    converged: Bool[Array, ""]
    at_edge: Bool[Array, ""]
    steps: Int[Array, ""]
    model: str = eqx.field(static=True)
    turbidity_range: tuple[float, float] = eqx.field(static=True)

    @property
    def interval(self) -> Float[Array, "2"]:
        """Lower and upper end of the 95 % interval; it may reach beyond the range."""
        half = _TWO_SIDED_95 * self.standard_error
        return jnp.stack([self.value - half, self.value + half])

    def scaled_by_residual(self) -> "TurbidityEstimate":
        """The same with the standard error times the root of the reduced chi-square, if above 1.

        Right if the noise was given too small; if it is the model that is wrong, residuals of
        neighbouring directions are alike, and even this interval is too narrow.
        """
        factor = jnp.sqrt(jnp.maximum(1.0, self.reduced_chi_square))
        return eqx.tree_at(lambda e: e.standard_error, self, replace=self.standard_error * factor)


def estimate_turbidity(
    observation: Observation,
    model: str | PreethamModel | SkyModel = "preetham",
    *,
    start: RealsLike | None = None,
    turbidity_range: tuple[float, float] | None = None,
    orders: int = 2,
    rtol: float = 2e-3,
    plan: Plan | None = None,
    scan: bool = True,
    max_steps: int = MAX_STEPS,
) -> TurbidityEstimate:
    """Estimate turbidity from the luminance of one sky.

    Least squares of log(model / measured) / noise over the directions, by Levenberg-Marquardt in
    a free variable, with forward derivatives through the model. The sum of squares often has two
    minima (a clear sky can be as bright as a very hazy one), so a scan over the range chooses
    where the search begins. Spectral observations are integrated to luminance first.

    Args:
        observation: Luminances, or spectra that cover 380 to 780 nm.
        model: "preetham", the published model of 1999; "simulator", the sky of
            `Atmosphere.from_turbidity`; or a fitted model such as `refit().model` or
            `ATMOFIT_2026`.
        start: Candidate for the beginning of the search beside the scan; brought inside the range.
        turbidity_range: Searched; inside the model's own range. None: all of it, 1 to 30 for the
            simulator. Static.
        orders: Scattering orders of the simulator. Static.
        rtol: Accuracy of the simulator: 1e-2 would be a part of the error for noise of 1 % over a
            hundred directions. Static.
        plan: From `plan_sky(..., quantity="luminance")`, replaces `orders` and `rtol`. None: a
            simulation in float32, whose rounding is far below any noise. Static.
        scan: False: search from `start` alone, which may end in another minimum. Static.
        max_steps: Steps allowed. Static.

    Returns:
        The estimate; nothing is raised if the search fails, see `converged`. NaN where a traced
        argument is out of range.

    Raises:
        ValueError: Impossible observation, unknown model, or a range outside the model's.

    References:
        Preetham, Shirley and Smits (1999), Computer Graphics Proceedings, for turbidity and model.
    """
    observation = observation.checked()
    dtype = jnp.result_type(float)
    luminance, noise = observation.luminance()
    if max_steps < 1:
        raise ValueError(f"max_steps must be at least 1, got {max_steps}")
    sky, coarse, name = _skies(model, orders, rtol, plan)
    limits = _limits(turbidity_range, sky.turbidity_range)
    if start is None:
        if not scan:
            raise ValueError("start must be given where scan is False, got None")
        start = math.sqrt(limits[0] * limits[1])
    first = in_range("start", start, -np.inf, np.inf).astype(dtype)
    if first.ndim != 0:
        raise ValueError(f"start must be one number, got shape {first.shape}")
    numbers = _estimate(
        sky,
        coarse if scan else None,
        luminance.astype(dtype),
        noise.astype(dtype),
        observation.solar_zenith_angle.astype(dtype),
        jax.tree.map(lambda leaf: leaf.astype(dtype), observation.directions),
        first,
        jnp.asarray(limits, dtype),
        max_steps,
    )
    return TurbidityEstimate(**numbers, model=name, turbidity_range=limits)


class _AnalyticSky(eqx.Module):
    """Luminance by a closed formula."""

    model: PreethamModel | SkyModel

    def __call__(
        self, turbidity: Scalar, solar_zenith_angle: Scalar, directions: Directions | DirectionGrid
    ) -> Reals:
        return self.model(turbidity, solar_zenith_angle, directions)[..., 2]

    @property
    def turbidity_range(self) -> tuple[float, float]:
        return self.model.turbidity_range

    @property
    def dtype(self) -> jnp.dtype:
        return jnp.dtype(jnp.result_type(float))


class _SimulatedSky(eqx.Module):
    """Luminance by the simulator."""

    plan: Plan = eqx.field(static=True)
    turbidity_range: tuple[float, float] = eqx.field(static=True, default=SIMULATED_RANGE)

    def __call__(
        self, turbidity: Scalar, solar_zenith_angle: Scalar, directions: Directions | DirectionGrid
    ) -> Reals:
        atmosphere = Atmosphere.from_turbidity(turbidity)
        return simulate_luminance(atmosphere, solar_zenith_angle, directions, plan=self.plan)

    @property
    def dtype(self) -> jnp.dtype:
        return jnp.dtype(self.plan.dtype)


_Sky = _AnalyticSky | _SimulatedSky


def _skies(
    model: str | PreethamModel | SkyModel, orders: int, rtol: float, plan: Plan | None
) -> tuple[_Sky, _Sky, str]:
    """What computes the sky, what computes it for the scan, and its name."""
    if isinstance(model, PreethamModel | SkyModel) or model == "preetham":
        chosen = PREETHAM_1999 if isinstance(model, str) else model
        sky = _AnalyticSky(jax.tree.map(jnp.asarray, chosen))
        return sky, sky, "preetham" if isinstance(model, str) else "fitted"
    choice("model", model, ("preetham", "simulator"))
    air = Atmosphere.from_turbidity(1.0)
    if plan is None:
        plan = plan_sky(air, quantity="luminance", orders=orders, rtol=rtol, dtype="float32")
    if plan.quantity != "luminance":
        raise ValueError(f'plan must be for quantity "luminance", got "{plan.quantity}"')
    coarse = plan
    if plan.rtol < _COARSEST:
        coarse = plan_sky(
            air, quantity="luminance", orders=plan.orders, rtol=_COARSEST, dtype=plan.dtype
        )
    return _SimulatedSky(plan), _SimulatedSky(coarse), "simulator"


def _limits(asked: tuple[float, float] | None, valid: tuple[float, float]) -> tuple[float, float]:
    """The range that is searched."""
    low, high = valid if asked is None else (float(asked[0]), float(asked[1]))
    if not valid[0] <= low < high <= valid[1]:
        raise ValueError(
            f"turbidity_range must increase inside the model's {valid[0]:g} to {valid[1]:g}, "
            f"got ({low:g}, {high:g})"
        )
    return low, high


@eqx.filter_jit
def _estimate(
    sky: _Sky,
    coarse: _Sky | None,
    luminance: Reals,
    noise: Reals,
    sun: Scalar,
    directions: Directions | DirectionGrid,
    start: Scalar,
    limits: Float[Array, "2"],
    max_steps: int,
) -> dict[str, Array]:
    """The jitted kernel: one sky, everything but the models' structure traced."""
    low, high = limits
    middle, half = (jnp.log(low) + jnp.log(high)) / 2, jnp.log(high / low) / 2

    def turbidity(x: Scalar) -> Scalar:
        return jnp.clip(jnp.exp(middle + half * x), low, high)  # rounding must not leave the range

    def residuals(x: Scalar, sky: _Sky = sky) -> Reals:
        ratio = sky(turbidity(x), sun, directions).astype(luminance.dtype) / luminance
        return (safe_log(ratio) / noise).ravel()

    x = jnp.clip((jnp.log(jnp.clip(start, low, high)) - middle) / half, -1.0, 1.0)
    if coarse is not None:
        nodes = _SCAN_ANALYTIC if isinstance(coarse, _AnalyticSky) else _SCAN_SIMULATED
        x = one_parameter.scan(lambda x: residuals(x, coarse), nodes, x)
    weight = jnp.sqrt(jnp.sum(1 / noise**2))
    exact = isinstance(sky, _AnalyticSky)
    precision = float(jnp.finfo(sky.dtype).eps)
    found, converged, steps = one_parameter.descend(
        residuals, x, weight, precision, max_steps, exact
    )
    value = turbidity(found.place)
    loss = jnp.sum(found.residuals**2)
    return {
        "value": jnp.where(jnp.isfinite(loss), value, jnp.nan),
        "standard_error": value * half / jnp.sqrt(jnp.sum(found.slope**2)),
        "reduced_chi_square": loss / max(luminance.size - 1, 1),
        "rms": jnp.sqrt(jnp.mean((found.residuals * noise.ravel()) ** 2)),
        "converged": converged,
        "at_edge": found.at_end,
        "steps": steps,
    }
