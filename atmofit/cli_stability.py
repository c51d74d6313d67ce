"""The command that tries every function at its extremes."""

import dataclasses
import time
from pathlib import Path

from atmofit.files import output_folder
from atmofit.fuzz import Hunt, fuzz
from atmofit.stability import DTYPES, Check, declarations, run, summary, write_tables


@dataclasses.dataclass(frozen=True)
class Stability:
    """Try every public function at its extremes, value and slopes, in float32 and float64.

    NaN, infinity, negative light, a wrong limit or bad input that is not refused is a failure; the
    exit status is then 1. Writes stability.md and stability.json. Everything takes a quarter of
    an hour; some functions, and two minutes of random places:

        atmofit stability --only fog --fuzz 2
    """

    out: Path = Path("runs/stability")
    """Folder of the report."""
    fuzz: float = 0.0
    """Then hunt at random places for so many minutes."""
    seed: int = 0
    """Of the hunt."""
    only: str = ""
    """Look only at functions whose name holds this."""

    def run(self) -> int:
        """Do it; 1 if anything fails."""
        from tqdm import tqdm

        if not 0 <= self.fuzz <= 1e5:
            raise ValueError(f"fuzz must be between 0 and 100000 minutes, got {self.fuzz}")
        folder = output_folder(self.out)
        chosen = [d for d in declarations() if self.only in d.name]
        if not chosen:
            raise ValueError(f"only must be part of a function's name, got {self.only!r}")
        start = time.monotonic()
        checks: list[Check] = []
        with tqdm(total=len(chosen) * len(DTYPES), unit="", leave=False) as bar:
            for declaration in chosen:
                for dtype in DTYPES:
                    bar.set_description(declaration.name)
                    checks += run(declaration, dtype)
                    bar.update()
        seconds = round(time.monotonic() - start, 1)
        write_tables(folder, checks, seconds=seconds)  # a hunt may be stopped
        hunt = Hunt(0, 0, 0, [])
        if self.fuzz > 0:
            with tqdm(unit=" batches", leave=False) as bar:

                def tell(name: str) -> None:
                    bar.set_description(name)
                    bar.update()

                hunt = fuzz(chosen, 60 * self.fuzz, self.seed, tell)
        every = checks + hunt.findings
        write_tables(folder, every, seconds=seconds, hunt=dataclasses.asdict(hunt))
        print(_table(every))
        failed = sum(not check.passed for check in every)
        if self.fuzz > 0:
            print(
                f"hunt: {hunt.points} places of {hunt.functions} of {hunt.of} functions and "
                f"precisions, {len(hunt.findings)} findings"
            )
        print(f"{len(every)} checks, {failed} failing; all in {folder / 'stability.md'}")
        return 1 if failed else 0


def _table(checks: list[Check]) -> str:
    """A line for each function."""
    lines = [("function", "checks", "fail", "worst case")]
    lines += [(name, str(n), str(bad), words) for name, n, bad, words in summary(checks)]
    wide = max(len(line[0]) for line in lines)
    return "\n".join(f"{a:{wide}}  {b:>6}  {c:>4}  {words}" for a, b, c, words in lines)
