"""What does the reference job cost, how far is it from the exact oracle, and what does that cost?

Every rung of the ladder runs in a process of its own, so that its peak memory is its own. Errors
are those of luminance against nested quadrature that shares no code with the simulator
(tests/oracles), over sampled directions of the dome for sun 0, 60 and 85 degrees and turbidity 2
and 6. Everything is measured afresh, the oracle's cost too.
"""

import dataclasses
import json
import os
from pathlib import Path

import jax
import numpy as np
import tyro
from error_vs_runtime_case import Case
from error_vs_runtime_errors import Results, rung
from error_vs_runtime_oracle import WAVELENGTH_NM, quadrature, reference_skies
from error_vs_runtime_report import rung_table

from atmofit.files import replace_file
from atmofit.sky.ladder import LADDER

_JOB_DIRECTIONS = 60 * 343


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    float32: tuple[float, ...] = tuple(LADDER)
    """Rungs of the ladder to run in float32."""
    float64: tuple[float, ...] = (5e-2, 1e-2, 2e-3)
    """Likewise in float64."""
    repeats: int = 3
    """Hot calls; the median is reported. One at the finest rung, where a call takes long."""
    resolution: float = 0.8
    """Of the oracle; 0.8 is good to 3e-4."""
    out: Path = Path("runs/benchmark")


def main(config: Config) -> None:
    """Run the oracle, then every rung in its own process, and print the table."""
    config.out.mkdir(parents=True, exist_ok=True)
    oracle = [quadrature(sky, config.resolution, fresh=True)[1] for sky in reference_skies()]
    seconds = float(np.mean(oracle))
    once, often = (Results(config.out, n, fresh=True) for n in (1, config.repeats))
    rungs, lines = [], []
    for dtype, chosen in (("float32", config.float32), ("float64", config.float64)):
        for rtol in chosen:
            case = Case("ladder", f"{rtol:g}", LADDER[rtol], dtype)
            results = once if rtol == min(LADDER) else often
            rungs.append(rung(results, case, config.resolution))
            printed, lines = len(lines), rung_table(rungs)
            print("\n".join(lines[printed:]), flush=True)
    lines.append(
        f"\nThe oracle took {seconds:.2f} s a direction for {WAVELENGTH_NM.size} wavelengths; the "
        f"reference job's {_JOB_DIRECTIONS} directions would take it "
        f"{_JOB_DIRECTIONS * seconds / 3600:.1f} hours."
    )
    print(lines[-1])
    stored = {
        "config": dataclasses.asdict(config) | {"out": str(config.out)},
        "processors": os.cpu_count(),
        "oracle_seconds_per_direction": seconds,
        "rungs": rungs,
    }
    texts = {"table.md": "\n".join(lines) + "\n", "benchmark.json": json.dumps(stored, indent=1)}
    for name, text in texts.items():
        replace_file(config.out / name, lambda path, text=text: _write(path, text))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
