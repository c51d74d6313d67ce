"""How finely a slab is resolved in angle and depth."""

import dataclasses

RUNGS = ((5e-2, 8), (1e-2, 16), (2e-3, 32), (0.0, 64))  # tolerance down to which so many streams do
THICKEST_SLAB = 1e4


@dataclasses.dataclass(frozen=True)
class SlabPlan:
    """Counts that shape the program. Hashable; predictions do not count for equality.

    Attributes:
        streams: Polar directions, half of them up; even.
        modes: Terms of the cosine series in azimuth, at most `streams`.
        doublings: From the thinnest layer to the whole.
        rtol: That was asked for, or None.
        errors: Found for some counts of streams, against twice as many: streams, error.
        left_out: What is not computed, and what that costs.
    """

    streams: int = 32
    modes: int = 32
    doublings: int = 20
    rtol: float | None = dataclasses.field(default=None, compare=False)
    errors: tuple[tuple[int, float], ...] = dataclasses.field(default=(), compare=False)
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    def __post_init__(self) -> None:
        """Check the counts."""
        if self.streams % 2 or not 4 <= self.streams <= 256:
            raise ValueError(f"streams must be even, between 4 and 256, got {self.streams}")
        if not 1 <= self.modes <= self.streams:
            raise ValueError(
                f"modes must be between 1 and streams = {self.streams}, got {self.modes}"
            )
        if not 1 <= self.doublings <= 60:
            raise ValueError(f"doublings must be between 1 and 60, got {self.doublings}")

    def __str__(self) -> str:
        """What is computed and what is not."""
        asked = "" if self.rtol is None else f", tolerance {self.rtol:g}"
        lines = [
            f"slab by {self.streams} streams, {self.modes} azimuthal modes, "
            f"{self.doublings} doublings{asked}"
        ]
        lines += [f"  {count} streams: error {error:.1e}" for count, error in self.errors]
        lines += [f"  left out: {what}" for what in self.left_out]
        return "\n".join(lines)


def streams_for(rtol: float) -> int:
    """Streams for a tolerance, with haze and fog of an asymmetry to .85."""
    return next(streams for least, streams in RUNGS if rtol >= least)
