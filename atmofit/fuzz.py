"""Random places of every declared function, for as long as one likes."""

import dataclasses
import time
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from atmofit.extremes import Declaration, Span
from atmofit.stability import DTYPES, Check, Program, ends, judged, program

POINTS = 32  # of a function that are tried at a time
KEPT = 40  # functions whose programs are kept; all of them exceed a process's memory maps
_DECADES = 12  # how close to an end, relative to the span, a place may lie
_WIDE = 1e3


@dataclasses.dataclass(frozen=True)
class Hunt:
    """What a hunt found.

    Attributes:
        points: Places that were tried.
        functions: Functions and precisions that were tried, of `of`.
        of: Of all that there are.
        findings: Checks that failed, with the place in words.
    """

    points: int
    functions: int
    of: int
    findings: list[Check]


def fuzz(
    declarations: Sequence[Declaration],
    seconds: float,
    seed: int = 0,
    tell: Callable[[str], None] = lambda name: None,
) -> Hunt:
    """Try functions in random order at random places until the time is over.

    Each is compiled when its turn comes, so that a short hunt sees a part of them; another seed
    sees another part.

    Args:
        declarations: Of the functions.
        seconds: After which no other batch begins.
        seed: Of order and places; equal seeds try equal places in equal order.
        tell: Called with the name of what is tried next.
    """
    stop = time.monotonic() + seconds
    rng = np.random.default_rng(seed)
    every = [(d, dtype) for d in declarations for dtype in DTYPES]
    programs: dict[str, Program] = {}
    seen: set[tuple[str, str]] = set()
    findings: list[Check] = []
    points = 0
    while every and time.monotonic() < stop:
        for k in rng.permutation(len(every)):
            if time.monotonic() >= stop:
                break
            declaration, dtype = every[k]
            tell(declaration.name)
            evaluate = programs.pop(declaration.name, None) or program(declaration)
            programs[declaration.name] = evaluate
            if len(programs) > KEPT:
                del programs[next(iter(programs))]  # the one used longest ago
            places = {name: somewhere(span, rng) for name, span in declaration.spans.items()}
            with jax.enable_x64(dtype == "float64"):
                stacked = {name: jnp.asarray(x, dtype) for name, x in places.items()}
                found = jax.tree.map(np.asarray, evaluate(stacked))
            findings += _failures(declaration, dtype, places, *found)
            seen.add((declaration.name, dtype))
            points += POINTS
    return Hunt(points, len(seen), len(every), findings)


def somewhere(span: Span, rng: np.random.Generator) -> np.ndarray:
    """Places of one argument, [point, ...]: anywhere, near an end, at an end, or at 0."""
    low, high = ends(span)
    shape = (POINTS, *low.shape)
    u = rng.random(shape)
    wide = (low > 0) & (high > _WIDE * low)
    ratio = np.where(wide, high / np.where(wide, low, 1.0), 1.0)
    near = (high - low) * 10.0 ** (-_DECADES * u)
    choices = [
        low + (high - low) * u,
        np.where(wide, low * ratio**u, low + (high - low) * u),
        low + near,
        high - near,
        np.where(u < 0.5, low, high),
        np.broadcast_to(np.clip(0.0, low, high), shape),
    ]
    kind = rng.choice(len(choices), shape, p=(0.3, 0.2, 0.15, 0.15, 0.1, 0.1))
    return np.clip(np.choose(kind, choices), low, high)


def _failures(
    declaration: Declaration,
    dtype: str,
    places: dict[str, np.ndarray],
    values: np.ndarray,
    slopes: dict[str, np.ndarray],
) -> list[Check]:
    """What does not hold, and where."""
    found = []
    for k in range(POINTS):
        of_point = {name: slope[k] for name, slope in slopes.items()}
        for line in judged(declaration, values[k], of_point):
            if not line[1]:
                where = ", ".join(f"{name}={x[k].tolist()!r}" for name, x in places.items())
                found.append(Check(declaration.name, where, dtype, *line))
    return found
