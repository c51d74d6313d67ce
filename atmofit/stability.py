"""The stability table: every declared function at its extremes, in float32 and in float64.

`python -m atmofit.stability` writes runs/stability/table.md and table.json and exits with 1 if a
check fails. What is checked stands beside the functions, see `atmofit.extremes`.
"""

import dataclasses
import importlib
import json
import pkgutil
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import atmofit
from atmofit.extremes import DECLARATIONS, Case, Declaration, Domain, Numbers, Span
from atmofit.io import output_folder, replace_file
from atmofit.typing import Reals

DTYPES = ("float32", "float64")
OUT = Path("runs/stability")
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
        low, high = _ends(span)
        found += [Case(f"{name} lowest", {name: low}), Case(f"{name} highest", {name: high})]
        for word, number in (("zero", 0.0), ("tiny", _TINY)):
            inside = np.clip(number, low, high)
            if (inside == number).any() and not (inside == low).all():
                found.append(Case(f"{name} {word}", {name: inside}))
    if len(declaration.spans) > 1:
        for word, end in (("lowest", 0), ("highest", 1)):
            corner = {name: _ends(span)[end] for name, span in declaration.spans.items()}
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
        values, slopes = jax.tree.map(np.asarray, _evaluate(declaration, stacked))
        checks: list[Check] = []
        for k, case in enumerate(inside):
            of_case = {name: slope[k] for name, slope in slopes.items()}
            for what, passed, found, error in _judge(case, values[k], of_case, dtype):
                checks.append(Check(declaration.name, case.name, dtype, what, passed, found, error))
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


def _evaluate(declaration: Declaration, stacked: dict[str, Reals]) -> tuple[Reals, dict]:
    """Values [case, output] and slopes by argument [case, output, argument's axes]."""

    def flat(arguments: dict[str, Reals]) -> Reals:
        out = declaration.call(**arguments)
        leaves = [leaf for leaf in jax.tree.leaves(out) if jnp.issubdtype(leaf.dtype, jnp.floating)]
        return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])

    if declaration.derivative == "none":
        return jax.jit(jax.vmap(flat))(stacked), {}
    if declaration.derivative == "reverse":
        slopes, values = jax.jit(jax.vmap(jax.jacrev(lambda at: (flat(at),) * 2, has_aux=True)))(
            stacked
        )
        return values, slopes
    # One direction at a time: all at once take longer to compile than these take to run.
    along = jax.jit(jax.vmap(lambda at, along: jax.jvp(flat, (at,), (along,))))
    still = jax.tree.map(jnp.zeros_like, stacked)
    values, slopes = along(stacked, still)[0], {}
    for name, argument in stacked.items():
        columns = []
        for entry in np.ndindex(argument.shape[1:]):
            unit = still[name].at[(slice(None), *entry)].set(1)
            columns.append(along(stacked, still | {name: unit})[1])
        slopes[name] = jnp.stack(columns, axis=-1)
    return values, slopes


def _judge(
    case: Case, value: np.ndarray, slopes: dict[str, np.ndarray], dtype: str
) -> Iterator[tuple[str, bool, str, float]]:
    """Whether value and slopes are finite and, where limits are known, right."""
    yield ("value finite", *_finite(value))
    for name, slope in slopes.items():
        yield (f"slope by {name} finite", *_finite(slope))
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
    low, high = _ends(span)
    wide = (low > 0) & (high > _WIDE * low)
    root = np.sqrt(np.where(wide, low, 1.0)) * np.sqrt(np.where(wide, high, 1.0))
    return np.where(wide, root, low / 2 + high / 2)


def _ends(span: Span) -> tuple[np.ndarray, np.ndarray]:
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


def write_tables(folder: Path, checks: list[Check]) -> None:
    """Write table.md and table.json, each whole or not at all."""
    head = "| function | case | dtype | check | | found |\n|---|---|---|---|---|---|\n"
    rows = [
        f"| {c.function} | {c.case} | {c.dtype} | {c.what} | "
        f"{'ok' if c.passed else '**FAILS**'} | {c.found.replace('|', '/')} |\n"
        for c in checks
    ]
    title = f"# Stability: {len(checks)} checks, {sum(not c.passed for c in checks)} failing\n\n"
    text = title + head + "".join(rows)
    replace_file(folder / "table.md", lambda path: _write(path, text))
    listed = [dataclasses.asdict(c) | {"error": min(c.error, _HUGE)} for c in checks]
    replace_file(folder / "table.json", lambda path: _write(path, json.dumps(listed, indent=1)))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def main(folder: Path = OUT) -> int:
    """Make the tables; returns 1 if a check fails."""
    output_folder(folder)
    checks: list[Check] = []
    for declaration in declarations():
        for dtype in DTYPES:
            checks += run(declaration, dtype)
    write_tables(folder, checks)
    lines = [("function", "checks", "fail", "worst case")]
    lines += [(name, str(n), str(bad), words) for name, n, bad, words in summary(checks)]
    wide = max(len(line[0]) for line in lines)
    for name, n, bad, words in lines:
        sys.stdout.write(f"{name:{wide}}  {n:>6}  {bad:>4}  {words}\n")
    failures = sum(not check.passed for check in checks)
    sys.stdout.write(f"{len(checks)} checks, {failures} failing; all in {folder}/table.md\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
