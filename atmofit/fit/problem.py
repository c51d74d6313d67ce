"""What is searched for in a sky, and in what: made once, for estimate, profile and posterior."""

import math
from collections.abc import Mapping
from typing import TypedDict

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range
from atmofit.fit.candidates import Model, Sky, name_of, skies
from atmofit.fit.model_error import ModelError, stored_model_error
from atmofit.fit.sky_loss import SkyLoss, sky_loss
from atmofit.fit.unknowns import make_search
from atmofit.observe.observation import Observation
from atmofit.typing import RealsLike


class Sought(TypedDict, total=False):
    """What is searched for, and what is known: keyword arguments of `turbidity_problem`.

    Attributes:
        free: Unknowns to search for beside turbidity, of those that the model has: for the
            continental air "angstrom_exponent", "single_scattering_albedo", "asymmetry",
            "scale_height" [m], "ozone_dobson", "albedo"; for a `SkyModel` "albedo"; for all
            "solar_zenith_angle" and "solar_azimuth" [rad], the sun's place relative to where the
            directions have it. Static; default ("turbidity",).
        known: Values of the model's other unknowns by name, and starts of the free ones.
        prior: Mean and standard deviation of free unknowns, by name. Static.
        turbidity_range: Searched; inside the model's own range. None: all of it, 1 to 30 for the
            simulator. Static.
        model_error: What the model misses of real skies: a `ModelError`, or a name of
            `stored_model_error`. None: nothing; intervals then hold noise alone.
        start: Candidate for the beginning of the search beside the scan; brought inside the range.
    """

    free: tuple[str, ...]
    known: Mapping[str, RealsLike] | None
    prior: Mapping[str, tuple[float, float]] | None
    turbidity_range: tuple[float, float] | None
    model_error: ModelError | str | None
    start: RealsLike | None


class TurbidityProblem(eqx.Module):
    """What is searched for in a sky, and in what; made by `turbidity_problem`.

    Attributes:
        sky: The model.
        coarse: What stands for it in a scan.
        loss: The data and the unknowns.
        limits: Of turbidity. Static.
        model: Name of the model. Static.
        has_start: Whether a start was given. Static.
    """

    sky: Sky
    coarse: Sky
    loss: SkyLoss
    limits: tuple[float, float] = eqx.field(static=True)
    model: str = eqx.field(static=True)
    has_start: bool = eqx.field(static=True)


def turbidity_problem(
    observation: Observation,
    model: Model = "preetham",
    *,
    free: tuple[str, ...] = ("turbidity",),
    known: Mapping[str, RealsLike] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    turbidity_range: tuple[float, float] | None = None,
    model_error: ModelError | str | None = None,
    start: RealsLike | None = None,
) -> TurbidityProblem:
    """Put together what `estimate_turbidity`, `profile_turbidity` and `sample_turbidity` solve.

    Args:
        observation: Luminances, colours or spectra; unknown exposures are found with the rest.
        model: "preetham", the published model of 1999; "simulator", `SimulatorModel()`: two orders
            of scattering in the paper's air; a `SimulatorModel`; or a fitted model such as
            `refit().model` or `ATMOFIT_2026`.
        free: As `Sought` says, like the next five.
        known: Values by name.
        prior: Of free unknowns.
        turbidity_range: Searched.
        model_error: Of the model.
        start: Of the search.

    Returns:
        The problem. NaN where a traced argument is out of range.

    Raises:
        ValueError: Impossible observation, unknown model or name, or a range outside the model's.

    References:
        Preetham, Shirley and Smits (1999), Computer Graphics Proceedings, for turbidity and model.
    """
    dtype = jnp.result_type(float)
    observation = jax.tree.map(
        lambda leaf: leaf if leaf.dtype == bool else leaf.astype(dtype), observation.checked()
    )
    sky, coarse = skies(model, observation)
    limits = _limits(turbidity_range, sky.ranges["turbidity"])
    first = math.sqrt(limits[0] * limits[1]) if start is None else start
    first = in_range("start", first, -np.inf, np.inf)
    if first.ndim != 0:
        raise ValueError(f"start must be one number, got shape {first.shape}")
    values = dict(known or {})
    if "turbidity" in values:
        raise ValueError("known must not hold turbidity, which is searched for: use start")
    values |= {"turbidity": jnp.clip(first, *limits)}
    values = {"solar_zenith_angle": observation.solar_zenith_angle} | values
    search = make_search(
        tuple(free),
        sky.unknowns,
        ranges=sky.ranges | {"turbidity": limits},
        values=values,
        priors=dict(prior or {}),
        dtype=dtype,
    )
    error = stored_model_error(model_error) if isinstance(model_error, str) else model_error
    return TurbidityProblem(
        sky,
        coarse,
        sky_loss(observation, search, error),
        limits=limits,
        model=name_of(model),
        has_start=start is not None,
    )


def _limits(asked: tuple[float, float] | None, valid: tuple[float, float]) -> tuple[float, float]:
    """The range that is searched."""
    low, high = valid if asked is None else (float(asked[0]), float(asked[1]))
    if not valid[0] <= low < high <= valid[1]:
        raise ValueError(
            f"turbidity_range must increase inside the model's {valid[0]:g} to {valid[1]:g}, "
            f"got ({low:g}, {high:g})"
        )
    return low, high
