"""Searches for the smallest sum of squares, many at once, from any start.

A search walks by Newton steps inside a trust region. Second derivatives are exact, not the product
J^T J: these fits have large residuals (a five-parameter formula does not hold a sky), and along a
weakly determined direction the part that J^T J leaves out then dominates. Curvature that is
negative counts with its size, so that a step always goes downhill.

A weak ridge decides what data leave open. A search begins with a strong one and releases it in
stages: with it the loss has hardly more than one minimum, and from there the path leads on to a
deep one of the many that the data make. Which one depends on the place toward which the strong
ridge pulls, so each start is released from a few such places, and the lowest end counts.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from atmofit.typing import Reals, Scalar

Residuals = Callable[[Reals], Reals]
Derivatives = tuple[Scalar, Float[Array, " p"], Float[Array, "p p"]]
Objective = Callable[[Int[Array, ""], Reals], Derivatives]
_LARGEST_STEP = 4.0
_FIRST_STEP = 1.0


class Minimum(eqx.Module):
    """Where searches ended; `...` is their number.

    Attributes:
        parameters: The best ones found; NaN where the loss is.
        loss: Half the sum of squared residuals there, ridge included.
        decrement: Share of the loss that a full Newton step would still remove.
        converged: Whether that share is below `tolerance(dtype)`, or what it would remove below
            5e-13 (5e-6 in float32), as for data that the model holds exactly.
        steps: Steps taken along all paths, rejected ones too.
        path_loss: Loss at the end of each path; infinite where that did not converge.
    """

    parameters: Float[Array, "*search p"]
    loss: Float[Array, "*search"]
    decrement: Float[Array, "*search"]
    converged: Bool[Array, "*search"]
    steps: Int[Array, "*search"]
    path_loss: Float[Array, "*search path"]


class Paths(NamedTuple):
    """Along what a search goes from its start.

    Attributes:
        ridges: Of each path in each stage; the last one is the same for all and stays.
        pulls: Where the ridges before the last have their centre; the last one's is 0.
    """

    ridges: Float[Array, "path stage"]
    pulls: Float[Array, "path p"]


class _Search(NamedTuple):
    """One search: where it is, what it knows there, and where it looks next."""

    place: Reals
    value: Scalar  # of the data, like its derivatives; the ridge is added where it is needed
    gradient: Reals
    hessian: Reals
    trial: Reals
    promise: Scalar  # what the trial step should gain
    radius: Scalar
    removable: Scalar  # what a full Newton step would gain
    stage: Array
    steps: Array
    done: Array


# Number of the search in each lane, the next number, what runs, and what has ended.
_Loop = tuple[Array, Array, _Search, _Search]


def tolerance(dtype: jnp.dtype) -> float:
    """Largest relative decrement of a converged fit: 1e-6 in float64, 0.02 in float32."""
    return 64 * float(jnp.finfo(dtype).eps) ** 0.5


def resolution(dtype: jnp.dtype) -> float:
    """A loss below which differences mean nothing: 5e-13 in float64, 5e-6 in float32."""
    return 0.5 * (10 * max(1e-7, 1e4 * float(jnp.finfo(dtype).eps))) ** 2


def derivatives(residuals: Residuals, at: Reals) -> Derivatives:
    """Half the sum of squared residuals, its gradient and its exact second derivatives."""

    def slope(p: Reals) -> tuple[Reals, tuple[Scalar, Reals]]:
        value, gradient = jax.value_and_grad(lambda p: 0.5 * jnp.sum(residuals(p) ** 2))(p)
        return gradient, (value, gradient)

    hessian, (value, gradient) = jax.jacfwd(slope, has_aux=True)(at)
    return value, gradient, hessian


def minimise(
    objective: Objective,
    starts: Float[Array, "search p"],
    paths: Paths,
    max_steps: int,
    lanes: int,
) -> Minimum:
    """Search from each start along each path, and keep the lowest end.

    Minimises objective(number, z) + ridge^2 |z|^2 / 2, so z should be in units in which a change
    of 1 is large but sensible. A step is at most 4 long.

    Args:
        objective: From the number of a start and parameters to value, gradient and Hessian.
            Smooth; a place where they are not finite is stepped back from.
        starts: First parameters.
        paths: The ridges.
        max_steps: Steps allowed along each path, rejected ones and all stages included.
        lanes: Searches at a time.

    Returns:
        The ends of the searches, converged or not; nothing is raised.
    """
    count = paths.pulls.shape[0]

    def of_search(search: Array, place: Reals) -> Derivatives:
        return objective(search // count, place)

    search = _run(of_search, jnp.repeat(starts, count, axis=0), paths, max_steps, lanes)
    ridge, dtype = paths.ridges[0, -1], starts.dtype
    loss = search.value + 0.5 * ridge**2 * jnp.sum(search.place**2, axis=-1)
    finite = jnp.isfinite(loss)
    enough = search.removable <= tolerance(dtype) * loss + resolution(dtype)
    converged = enough & finite & (search.stage == paths.ridges.shape[1] - 1)
    ends = Minimum(
        parameters=jnp.where(finite[:, None], search.place, jnp.nan),
        loss=jnp.where(finite, loss, jnp.nan),
        decrement=search.removable / (loss + float(jnp.finfo(dtype).tiny)),
        converged=converged,
        steps=search.steps,
        path_loss=jnp.where(converged, loss, jnp.inf)[:, None],
    )
    ends = jax.tree.map(lambda leaf: leaf.reshape(-1, count, *leaf.shape[1:]), ends)
    # An end that did not converge counts only where none did.
    path_loss = ends.path_loss[..., 0]
    losses = jnp.where(jnp.any(ends.converged, axis=1)[:, None], path_loss, ends.loss)
    lowest = jnp.argmin(jnp.where(jnp.isnan(losses), jnp.inf, losses), axis=1)
    rows = jnp.arange(starts.shape[0])
    best = jax.tree.map(lambda leaf: leaf[rows, lowest], ends)
    return eqx.tree_at(
        lambda end: (end.steps, end.path_loss), best, (jnp.sum(ends.steps, axis=1), path_loss)
    )


def _run(
    objective: Objective,
    starts: Float[Array, "search p"],
    paths: Paths,
    max_steps: int,
    lanes: int,
) -> _Search:
    """Run searches, some at a time; where one ends, the next takes its place."""
    number, size = starts.shape
    lanes = min(lanes, number)
    dtype = starts.dtype

    def advance(job: Array, search: _Search) -> _Search:
        path = job % paths.pulls.shape[0]
        return _advance(objective, job, search, paths.ridges[path], paths.pulls[path], max_steps)

    def body(loop: _Loop) -> _Loop:
        jobs, following, running, ended = loop
        running = jax.vmap(advance)(jobs, running)
        # An idle lane has the number of no search: what it would write is dropped.
        target = jnp.where(running.done, jobs, number)
        ended = jax.tree.map(lambda old, new: old.at[target].set(new, mode="drop"), ended, running)
        free = running.done & (jobs < number)
        order = jnp.cumsum(free) - 1
        jobs = jnp.where(free, jnp.minimum(following + order, number), jobs)
        fresh = jax.vmap(_begin)(starts[jnp.minimum(jobs, number - 1)])
        fresh = fresh._replace(done=jobs >= number)
        running = jax.tree.map(
            lambda new, old: jnp.where(jnp.expand_dims(free, tuple(range(1, new.ndim))), new, old),
            fresh,
            running,
        )
        return jobs, following + jnp.sum(free), running, ended

    running = jax.vmap(_begin)(starts[:lanes])
    ended = jax.vmap(_begin)(jnp.zeros((number, size), dtype))
    loop = (jnp.arange(lanes), jnp.asarray(lanes), running, ended)
    *_, ended = jax.lax.while_loop(lambda loop: jnp.any(loop[0] < number), body, loop)
    return ended


def _begin(start: Reals) -> _Search:
    """A search that knows nothing yet and looks at its start first."""
    dtype, size = start.dtype, start.size
    zero, infinite = jnp.zeros((), dtype), jnp.asarray(jnp.inf, dtype)
    return _Search(
        place=start,
        value=infinite,
        gradient=jnp.zeros(size, dtype),
        hessian=jnp.zeros((size, size), dtype),
        trial=start,
        promise=zero,
        radius=jnp.asarray(_FIRST_STEP, dtype),
        removable=infinite,
        stage=jnp.asarray(0),
        steps=jnp.asarray(0),
        done=jnp.asarray(False),
    )


def _advance(
    objective: Objective,
    job: Array,
    search: _Search,
    ridges: Reals,
    pull: Reals,
    max_steps: int,
) -> _Search:
    """Look at the trial, keep it or not, and find the next."""
    dtype = search.place.dtype
    eps, tiny = float(jnp.finfo(dtype).eps), float(jnp.finfo(dtype).tiny)
    ridge, centre = _ridge(ridges, pull, search.stage)

    def total(value: Scalar, place: Reals) -> Scalar:
        return value + 0.5 * ridge * jnp.sum((place - centre) ** 2)

    value, gradient, hessian = objective(job, search.trial)
    finite = jnp.isfinite(value) & jnp.isfinite(gradient).all() & jnp.isfinite(hessian).all()
    first = jnp.isinf(search.value)
    gain = jnp.where(finite, total(search.value, search.place) - total(value, search.trial), -1.0)
    quality = jnp.where(first, 1.0, gain / jnp.maximum(search.promise, tiny))
    kept = finite & (first | (quality > 1e-4))

    def choose(new: Array, old: Array) -> Array:
        return jnp.where(kept, new, old)

    place = choose(search.trial, search.place)
    value, gradient = choose(value, search.value), choose(gradient, search.gradient)
    hessian = choose(hessian, search.hessian)
    length = jnp.sqrt(jnp.sum((search.trial - search.place) ** 2))
    grown = jnp.minimum(2 * search.radius, _LARGEST_STEP)
    wide = (quality > 0.75) & (length > 0.8 * search.radius)
    radius = jnp.where(quality < 0.25, 0.25 * length, jnp.where(wide, grown, search.radius))
    radius = jnp.where(first, search.radius, radius)

    # The ridge is the same in every direction: it moves the curvatures and leaves the axes.
    data_curvature, axes = jnp.linalg.eigh(hessian)

    def along_axes(ridge: Scalar, centre: Reals) -> tuple[Reals, Reals, Scalar]:
        curvature = jnp.abs(data_curvature + ridge)
        curvature = jnp.maximum(curvature, 10 * eps * jnp.max(curvature) + tiny)
        slope = (gradient + ridge * (place - centre)) @ axes
        return slope, curvature, 0.5 * jnp.sum(slope**2 / curvature)

    _, _, removable = along_axes(ridge, centre)
    loss = total(value, place)
    last = search.stage == ridges.size - 1
    enough = jnp.where(last, tolerance(dtype) ** 1.5, 0.01)
    settled = (removable <= enough * loss + 1e-4 * resolution(dtype)) | (radius < 100 * eps)
    stage = jnp.minimum(search.stage + settled.astype(search.stage.dtype), ridges.size - 1)
    slope, curvature, removable = along_axes(*_ridge(ridges, pull, stage))
    step = _bounded_step(slope, curvature, radius)
    return _Search(
        place=place,
        value=value,
        gradient=gradient,
        hessian=hessian,
        trial=place + axes @ step,
        promise=-(jnp.dot(slope, step) + 0.5 * jnp.dot(curvature, step**2)),
        radius=radius,
        removable=removable,
        stage=stage,
        steps=search.steps + 1,
        done=(settled & last) | (search.steps + 1 >= max_steps) | (first & ~finite) | search.done,
    )


def _ridge(ridges: Reals, pull: Reals, stage: Array) -> tuple[Scalar, Reals]:
    """Square of the ridge in a stage, and its centre."""
    return ridges[stage] ** 2, jnp.where(stage == ridges.size - 1, 0.0, pull)


def _bounded_step(slope: Reals, curvature: Reals, radius: Scalar) -> Reals:
    """The Newton step, damped so that it stays inside the radius."""
    tiny = float(jnp.finfo(slope.dtype).tiny)

    def length(damping: Scalar) -> Scalar:
        return jnp.sqrt(jnp.sum((slope / (curvature + damping)) ** 2))

    def improve(_: Array, damping: Scalar) -> Scalar:
        now = jnp.maximum(length(damping), tiny)
        fall = jnp.sum(slope**2 / (curvature + damping) ** 3) / now
        return damping + jnp.maximum(now / radius - 1, 0.0) * now / jnp.maximum(fall, tiny)

    damping = jax.lax.fori_loop(0, 6, improve, jnp.zeros_like(radius))
    step = -slope / (curvature + damping)
    return step * jnp.minimum(1.0, radius / jnp.maximum(length(damping), tiny))
