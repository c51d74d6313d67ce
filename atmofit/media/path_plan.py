"""Which solver integrates along a path."""

import dataclasses

from atmofit.checks import choice

SOLVERS = ("constant", "horizontal", "hermite", "gauss")
NODES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)


@dataclasses.dataclass(frozen=True)
class PathPlan:
    """A solver. Hashable: what shapes the program is all that counts for equality.

    Attributes:
        solver: "constant", "horizontal", "hermite" or "gauss".
        nodes: Of the quadrature; 0 for the other solvers.
        rtol: That was asked for, or None.
        errors: Of every solver on these paths, by name, from cheap to dear.
    """

    solver: str = "gauss"
    nodes: int = 16
    rtol: float | None = dataclasses.field(default=None, compare=False)
    errors: tuple[tuple[str, float], ...] = dataclasses.field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Check both."""
        choice("solver", self.solver, SOLVERS)
        allowed = NODES if self.solver == "gauss" else (0,)
        if self.nodes not in allowed:
            raise ValueError(
                f'nodes must be one of {allowed} for "{self.solver}", got {self.nodes}'
            )

    @property
    def name(self) -> str:
        """In a word or two."""
        return f"{self.solver} {self.nodes}" if self.nodes else self.solver

    @property
    def predicted_error(self) -> float | None:
        """Of the solver that was chosen; None where nothing was predicted."""
        return dict(self.errors).get(self.name)

    def __str__(self) -> str:
        """What is computed, and how wrong every other way would be."""
        lines = [f"path by {self.name}"]
        if self.rtol is not None:
            lines[0] += f", tolerance {self.rtol:g}"
        lines += [f"  {name}: error {error:.1e}" for name, error in self.errors]
        return "\n".join(lines)


DEFAULT_PLAN = PathPlan()
