"""Where a function might break, declared beside it; `atmofit stability` tries it out.

Plain notes: nothing is evaluated here, so that a declaration costs nothing on import.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

Numbers = Any  # a number, nested tuples or a NumPy array
Subject = TypeVar("Subject", bound=Callable[..., Any])

DERIVATIVES = ("reverse", "forward", "none")


@dataclasses.dataclass(frozen=True)
class Span:
    """Range of an argument over which value and derivatives must be finite, ends included."""

    low: Numbers
    high: Numbers


class Domain(Span):
    """A span beyond which known values raise ValueError and traced ones give NaN."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A named place where a function might break.

    Attributes:
        name: In words.
        at: Arguments there; the others stand in the middle of their spans.
        limit: Value expected there, or None.
        slope: Derivatives expected there, by argument.
        ulps: Rounding errors allowed against the expected value and slope, relative to `size`.
        size: What the tolerance is relative to; None: the expected number itself.
        rtol: What a method's own error adds to the tolerance.
    """

    name: str
    at: Mapping[str, Numbers]
    limit: Numbers | None = None
    slope: Mapping[str, Numbers] = dataclasses.field(default_factory=dict)
    ulps: float = 64.0
    size: float | None = None
    rtol: float = 0.0


@dataclasses.dataclass(frozen=True)
class Declaration:
    """What is known of a function's extremes.

    Attributes:
        subject: The public function or class.
        part: Which of its methods or variants; may be empty.
        call: Takes the arguments by name, each an array; returns arrays.
        spans: Of every argument.
        cases: Named cases.
        derivative: "reverse", "forward" or "none": how the slopes are taken.
        heavy: Whether it takes long to compile, so that only the command looks at it.
        least: No value may lie below it; None: values of either sign.
        rounding: By so many units of rounding of 1 a value may, as a difference of such.
    """

    subject: Any
    part: str
    call: Callable[..., Any]
    spans: Mapping[str, Span]
    cases: tuple[Case, ...]
    derivative: str
    heavy: bool
    least: float | None
    rounding: float = 0.0

    @property
    def name(self) -> str:
        """Module, function and part."""
        words = f"{self.subject.__module__}.{self.subject.__qualname__}"
        return f"{words} {self.part}".strip().removeprefix("atmofit.")


DECLARATIONS: list[Declaration] = []


def extremes(
    *cases: Case,
    part: str = "",
    call: Callable[..., Any] | None = None,
    derivative: str = "reverse",
    heavy: bool = False,
    least: float | tuple[float, float] | None = None,
    **spans: Span,
) -> Callable[[Subject], Subject]:
    """Declare the extremes of the function or class below.

    From the spans alone come a case with every argument in the middle, and for each argument
    both ends, zero and a tiny number; arguments with a `Domain` are also tried beyond it.

    Args:
        *cases: Named cases beside those.
        part: Which method or variant this is about, if there are several.
        call: What to call with the arguments, if not the function itself.
        derivative: "reverse", "forward" or "none".
        heavy: It takes long to compile: only the command looks at it, not the tests.
        least: No value may lie below it, as light is not negative. A pair: and by so many units of
            rounding of 1 it may, where it is the difference of such.
        **spans: A `Span` or `Domain` for each argument.

    Returns:
        A decorator that returns what it is given.

    Raises:
        ValueError: A case names an argument without span, or an unknown kind of derivative.
    """
    if derivative not in DERIVATIVES:
        raise ValueError(f"derivative must be one of {DERIVATIVES}, got {derivative!r}")
    for case in cases:
        unknown = {*case.at, *case.slope} - set(spans)
        if unknown:
            raise ValueError(f"case {case.name!r} names {sorted(unknown)}, which have no span")

    def declare(subject: Subject) -> Subject:
        function = subject if call is None else call
        lowest, rounding = least if isinstance(least, tuple) else (least, 0.0)
        DECLARATIONS.append(
            Declaration(subject, part, function, spans, cases, derivative, heavy, lowest, rounding)
        )
        return subject

    return declare
