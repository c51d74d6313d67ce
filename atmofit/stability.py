"""The stability table: every declared function at its extremes, in float32 and in float64.

`atmofit stability` writes it and exits with 1 if a check fails. What is checked stands beside the
functions, see `atmofit.extremes`.
"""

import dataclasses
import importlib
import json
import pkgutil
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import atmofit
from atmofit.extremes import DECLARATIONS, Case, Declaration, Domain, Numbers, Span
from atmofit.files import replace_file
from atmofit.typing import Reals

DTYPES = ("float32", "float64")
Program = Callable[[dict[str, Reals]], tuple[Reals, dict[str, Reals]]]
_TINY = 1e-30  # a normal number in float32 too
_HUGE = 1e30  # stands for an end at infinity
_WIDE = 1e3  # spans with a larger ratio of their ends have their geometric mean as middle
_BEYOND = 1e-3  # how far beyond a domain's end, relative to the end or to the width


@dataclasses.dataclass(frozen=True)
class Check:
    """One line of the table.

    Attributes:
        function: Module, name and part.
        case: In words.
        dtype: "float32" or "float64".
        what: What is checked.
        passed: Whether it holds.
        found: What was found, in words.
        error: Error over tolerance where a limit is known, else 0 or infinity.
    """

    function: str
    case: str
    dtype: str
    what: str
    passed: bool
    found: str
    error: float


def declarations() -> tuple[Declaration, ...]:
    """Import every module of the package and return what they declare."""
    for module in pkgutil.walk_packages(atmofit.__path__, "atmofit."):
        if module.name != __name__:
            importlib.import_module(module.name)
    return tuple(d for d in DECLARATIONS if d.subject.__module__.startswith("atmofit."))


def cases_inside(declaration: Declaration) -> list[Case]:
    """The named cases, and those that the spans imply."""
    found = [Case("middle of every span", {})]
    for name, span in declaration.spans.items():
        low, high = ends(span)
        found += [Case(f"{name} lowest", {name: low}), Case(f"{name} highest", {name: high})]
        for word, number in (("zero", 0.0), ("tiny", _TINY)):
            inside = np.clip(number, low, high)
            if (inside == number).any() and not (inside == low).all():
                found.append(Case(f"{name} {word}", {name: inside}))
    if len(declaration.spans) > 1:
        for word, end in (("lowest", 0), ("highest", 1)):
            corner = {name: ends(span)[end] for name, span in declaration.spans.items()}
            found.append(Case(f"every argument {word}", corner))
    return found + list(declaration.cases)


def cases_beyond(declaration: Declaration) -> list[Case]:
    """Each argument that has a `Domain`, just outside it and at NaN."""
    found = []
    for name, span in declaration.spans.items():
        if not isinstance(span, Domain):
            continue
        low, high = (np.asarray(end, float) for end in (span.low, span.high))
        width = np.where(np.isfinite(high - low), high - low, 0.0)
        step = _BEYOND * np.maximum(width, np.where(np.isfinite(low), np.abs(low), 0.0))
        for word, value in (
            ("below", low - np.maximum(step, _BEYOND)),
            ("above", high + np.maximum(step, _BEYOND)),
            ("NaN", np.full(low.shape, np.nan)),
        ):
            found.append(Case(f"{name} {word}", {name: value}))
    return found


def run(declaration: Declaration, dtype: str) -> list[Check]:
    """Evaluate one function at all its cases, in one compiled program.

    Args:
        declaration: From `declarations`.
        dtype: "float32" or "float64".
    """
    inside, beyond = cases_inside(declaration), cases_beyond(declaration)
    with jax.enable_x64(dtype == "float64"):
        rows = [_arguments(declaration, case) for case in inside + beyond]
        stacked = {
            name: jnp.asarray(np.stack([row[name] for row in rows]), dtype)
            for name in declaration.spans
        }
        values, slopes = jax.tree.map(np.asarray, program(declaration)(stacked))
        checks: list[Check] = []
        for k, case in enumerate(inside):
            of_case = {name: slope[k] for name, slope in slopes.items()}
            for line in judged(declaration, values[k], of_case):
                checks.append(Check(declaration.name, case.name, dtype, *line))
            for line in _against_limits(case, values[k], of_case, dtype):
                checks.append(Check(declaration.name, case.name, dtype, *line))
        for k, case in enumerate(beyond, start=len(inside)):
            nan = bool(np.isnan(values[k]).any())
            checks.append(
                Check(declaration.name, case.name, dtype, "traced: NaN", nan, _show(values[k]), 0.0)
            )
            refused, found = _refuses(declaration, rows[k], dtype)
            checks.append(
                Check(declaration.name, case.name, dtype, "known: ValueError", refused, found, 0.0)
            )
    return checks


def program(declaration: Declaration) -> Program:
    """Values [case, output] and slopes by argument [case, output, argument's axes] of many cases.

    Compiled once for each number of cases and precision.
    """

    def flat(arguments: dict[str, Reals]) -> Reals:
        out = declaration.call(**arguments)
        leaves = [leaf for leaf in jax.tree.leaves(out) if jnp.issubdtype(leaf.dtype, jnp.floating)]
        return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])

    if declaration.derivative == "none":
        alone = jax.jit(jax.vmap(flat))
        return lambda stacked: (alone(stacked), {})
    if declaration.derivative == "reverse":
        back = jax.jit(jax.vmap(jax.jacrev(lambda at: (flat(at),) * 2, has_aux=True)))
        return lambda stacked: back(stacked)[::-1]
    # One direction at a time: all at once take longer to compile than these take to run.
    along = jax.jit(jax.vmap(lambda at, along: jax.jvp(flat, (at,), (along,))))

    def forward(stacked: dict[str, Reals]) -> tuple[Reals, dict[str, Reals]]:
        still = jax.tree.map(jnp.zeros_like, stacked)
        values, slopes = along(stacked, still)[0], {}
        for name, argument in stacked.items():
            columns = []
            for entry in np.ndindex(argument.shape[1:]):
                unit = still[name].at[(slice(None), *entry)].set(1)
                columns.append(along(stacked, still | {name: unit})[1])
            slopes[name] = jnp.stack(columns, axis=-1)
        return values, slopes

    return forward


Line = tuple[str, bool, str, float]  # what was checked, whether it holds, what was found, error


def judged(
    declaration: Declaration, value: np.ndarray, slopes: dict[str, np.ndarray]
) -> Iterator[Line]:
    """What has to hold everywhere: all finite, and light not negative."""
    yield ("value finite", *_finite(value))
    if declaration.least is not None:
        unit = float(np.finfo(value.dtype).eps)
        good = not (value < declaration.least - declaration.rounding * unit).any()
        yield (
            f"value not below {declaration.least:g}",
            good,
            _show(value),
            0.0 if good else np.inf,
        )
    for name, slope in slopes.items():
        yield (f"slope by {name} finite", *_finite(slope))


def _against_limits(
    case: Case, value: np.ndarray, slopes: dict[str, np.ndarray], dtype: str
) -> Iterator[Line]:
    """Whether value and slopes are right where they are known."""
    tolerance = case.ulps * float(np.finfo(dtype).eps) + case.rtol
    if case.limit is not None:
        yield ("value is the limit", *_close(value, case.limit, tolerance, case.size))
    for name, expected in case.slope.items():
        found = slopes[name]
        yield (f"slope by {name} is the limit", *_close(found, expected, tolerance, case.size))


def _finite(found: np.ndarray) -> tuple[bool, str, float]:
    good = bool(np.isfinite(found).all())
    return good, _show(found), 0.0 if good else np.inf


def _close(
    found: np.ndarray, expected: Numbers, tolerance: float, size: float | None
) -> tuple[bool, str, float]:
    exact = np.broadcast_to(np.ravel(np.asarray(expected, float)), found.size)
    off = np.abs(np.ravel(found).astype(float) - exact)
    allowed = tolerance * (np.abs(exact) if size is None else np.full(exact.shape, size))
    # An expected 0 without a size must come out exactly.
    error = np.where(off == 0, 0.0, off / np.where(allowed == 0, np.finfo(float).tiny, allowed))
    worst = float(np.nan_to_num(error, nan=np.inf).max())
    return worst <= 1, f"{_show(found)}, expected {_show(exact)}", worst


def _refuses(declaration: Declaration, row: dict[str, np.ndarray], dtype: str) -> tuple[bool, str]:
    """Whether known arguments raise ValueError."""
    try:
        declaration.call(**{name: jnp.asarray(value, dtype) for name, value in row.items()})
    except ValueError as error:
        return True, str(error)
    return False, "no error"


def _arguments(declaration: Declaration, case: Case) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(case.at.get(name, _middle(span)), float)
        for name, span in declaration.spans.items()
    }


def _middle(span: Span) -> np.ndarray:
    low, high = ends(span)
    wide = (low > 0) & (high > _WIDE * low)
    root = np.sqrt(np.where(wide, low, 1.0)) * np.sqrt(np.where(wide, high, 1.0))
    return np.where(wide, root, low / 2 + high / 2)


def ends(span: Span) -> tuple[np.ndarray, np.ndarray]:
    """Both ends, with large numbers in place of infinity."""
    low, high = (
        np.asarray(np.clip(np.asarray(end, float), -_HUGE, _HUGE)) for end in (span.low, span.high)
    )
    return low, high


def _show(values: np.ndarray) -> str:
    """The number, or the range of several."""
    some = np.ravel(values)
    bad = some[~np.isfinite(some)]
    if bad.size:
        return f"{bad[0]} ({bad.size} of {some.size})"
    low, high = some.min(), some.max()
    return f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"


def summary(checks: Iterable[Check]) -> list[tuple[str, int, int, str]]:
    """For each function: number of checks, failures, and its worst case in words."""
    groups: dict[str, list[Check]] = defaultdict(list)
    for check in checks:
        groups[check.function].append(check)
    lines = []
    for name, group in groups.items():
        failed = [check for check in group if not check.passed]
        worst = max(failed or group, key=lambda check: check.error)
        words = f"{worst.case}, {worst.dtype}, {worst.what}: {worst.found}"
        if not failed:
            words = f"{worst.case}, {worst.dtype}: {worst.error:.2g} of what is allowed"
        limited = failed or worst.error > 0
        lines.append((name, len(group), len(failed), words if limited else "all finite"))
    return lines


def write_tables(folder: Path, checks: list[Check], **more: Any) -> None:
    """Write stability.md and stability.json, each whole or not at all.

    Args:
        folder: Exists.
        checks: All lines.
        **more: Goes into the JSON file too.
    """
    failed = sum(not c.passed for c in checks)
    head = "| function | case | dtype | check | | found |\n|---|---|---|---|---|---|\n"
    rows = [
        f"| {c.function} | {c.case} | {c.dtype} | {c.what} | "
        f"{'ok' if c.passed else '**FAILS**'} | {c.found.replace('|', '/')} |\n"
        for c in sorted(checks, key=lambda check: check.passed)
    ]
    worst = "".join(
        f"| {name} | {count} | {bad} | {words.replace('|', '/')} |\n"
        for name, count, bad, words in summary(checks)
    )
    text = (
        f"# Stability: {len(checks)} checks, {failed} failing\n\n"
        f"| function | checks | failing | worst case |\n|---|---|---|---|\n{worst}\n"
        f"## Every check, failing ones first\n\n{head}{''.join(rows)}"
    )
    replace_file(folder / "stability.md", lambda path: _write(path, text))
    lines = [dataclasses.asdict(c) | {"error": min(c.error, _HUGE)} for c in checks]
    found = {"checks": len(checks), "failed": failed, **more, "lines": lines}
    replace_file(folder / "stability.json", lambda path: _write(path, json.dumps(found, indent=1)))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
