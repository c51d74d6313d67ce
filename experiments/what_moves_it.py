"""What moves the verdict on the 1999 model? Each assumption changed in turn, and refitted.

For the reference job: how the skies compare with the published model under each assumption, what
a refit of its own leaves, and how far the regenerated coefficients move. Then all that the paper
may have done at once, and the combination of tried assumptions that brings the published model
closest. The third order of scattering comes from a Monte Carlo, which takes most of the time and
is taken up again where a run stopped (third_order.json).

Writes config.json, result.json, table.md and a picture; with --store also the table that the
package keeps and that every report shows.
"""

import dataclasses
import datetime
import json
import time
from importlib import metadata
from pathlib import Path

import jax
import tyro
from what_moves_it_skies import (
    NOT_NORMALISED,
    PAPER,
    SETTINGS,
    SINGLE,
    Assumptions,
    Changes,
    direction_weight,
    fits,
    phase_factor,
    simulate,
)
from what_moves_it_third_order import Sampling, ThirdOrder, sample, smooth

import atmofit as af
from atmofit.fit.movement import (
    BASELINE,
    MOVEMENTS,
    Movement,
    Movements,
    movement,
    movements_to_json,
    parse_movements,
)
from atmofit.fit.verdict import CoefficientScores, coefficient_scores
from atmofit.provenance import versions
from atmofit.render.image import png_bytes, save_bytes, style
from atmofit.render.movements import MOVEMENT_COLUMNS, movement_rows
from atmofit.render.verdict_pictures import draw_movements

# The skies do not depend on the first three, and a factor on all luminance explains nothing.
NOT_COMBINED = {"weighting", "lowest_sun_deg", "near_sun_deg", "sunlight"}
LEAST_GAIN = 1e-3  # in the rms of log Y ratio, for a further assumption to be taken


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    out: Path = Path("runs/what_moves_it")
    """Folder of the results, and of the third order's samples."""
    store: bool = False
    """Replace the table that the package keeps."""
    sampling: Sampling = dataclasses.field(default_factory=Sampling)


class Experiment:
    """The rows measured so far, each from the assumptions that it changes."""

    def __init__(self, third_order: ThirdOrder) -> None:
        """Measure the baseline."""
        self.third_order = third_order
        self.rows: list[Movement] = []
        self.baseline: CoefficientScores | None = None
        self.measure(BASELINE, "as the reference job", BASELINE, {})

    def measure(self, key: str, label: str, kind: str, changes: Changes) -> None:
        """Simulate, refit and compare under changed assumptions."""
        begin = time.perf_counter()
        assumptions = Assumptions(**changes)
        skies = simulate(assumptions, self.third_order)
        joint, zeniths = fits(skies, assumptions)
        baseline = self.baseline or coefficient_scores(joint, zeniths)
        self.baseline = baseline
        row = movement(
            key,
            label,
            kind,
            skies,
            joint,
            zeniths,
            baseline=baseline,
            weight=direction_weight(assumptions),
        )
        self.rows.append(row)
        print(
            f"{label}: Y ratio {row.luminance_ratio:.3f}, median move {row.moved_median:.2f}, "
            f"{time.perf_counter() - begin:.1f} s",
            flush=True,
        )

    def closest(self, *, normalised: bool) -> tuple[tuple[str, ...], Changes]:
        """Take single assumptions, one after the other, while they bring the model closer.

        Args:
            normalised: Leave out phase functions that are not.

        Returns:
            Keys of the assumptions taken, and their changes.
        """
        start = self.rows[0].luminance_log_rms
        better = {row.key for row in self.rows if row.luminance_log_rms < start - LEAST_GAIN}
        candidates = {
            key: changes
            for key, (_, changes) in SINGLE.items()
            if key in better
            and not NOT_COMBINED & changes.keys()
            and not (normalised and changes.get("phase") in NOT_NORMALISED)
        }
        taken: tuple[str, ...] = ()
        changes: Changes = {}
        while True:
            tried = {
                key: self._distance(changes | more)
                for key, more in candidates.items()
                if not changes.keys() & more.keys() and _possible(changes | more)
            }
            key = min(tried, key=tried.__getitem__) if tried else None
            if key is None or tried[key] > start - LEAST_GAIN:
                return taken, changes
            start, taken, changes = tried[key], (*taken, key), changes | candidates[key]

    def _distance(self, changes: Changes) -> float:
        skies = simulate(Assumptions(**changes), self.third_order)
        return af.compare(af.PREETHAM_1999, skies, "published").summary()["luminance_log_rms"]


def _possible(changes: Changes) -> bool:
    return not (changes.get("orders") == 3 and changes.get("phase") in NOT_NORMALISED)


def main(config: Config) -> None:
    """Sample the third order, measure every assumption, write."""
    config.out.mkdir(parents=True, exist_ok=True)
    third_order = smooth(sample(config.sampling, config.out / "third_order.json"))
    experiment = Experiment(third_order)
    for key, (label, changes) in SINGLE.items():
        experiment.measure(key, label, "single", changes)
    experiment.measure("paper", "all that the paper may have done", "combination", PAPER)
    for key, normalised in (("closest", False), ("closest_normalised", True)):
        taken, changes = experiment.closest(normalised=normalised)
        words = "; ".join(SINGLE[name][0] for name in taken) or "nothing"
        which = "closest with a normalised phase" if normalised else "closest"
        experiment.measure(key, f"{which}: {words}", "combination", changes)
    found = Movements(_provenance(), _third_order(third_order, config), tuple(experiment.rows))
    _write(config, found)


def _provenance() -> dict[str, object]:
    return {
        "command": "python experiments/what_moves_it.py --store",
        "date": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}",
        "versions": {**versions(), "scipy": metadata.version("scipy")},
        "settings": {
            "turbidity": SETTINGS.turbidity,
            "solar_zenith_angle_deg": SETTINGS.solar_zenith_angle_deg,
            "wavelength_nm": [min(SETTINGS.wavelength_nm), max(SETTINGS.wavelength_nm), 10.0],
            "directions": 343,
            "rtol": SETTINGS.rtol,
            "dtype": SETTINGS.dtype,
        },
        "phase_integrals": {
            name: [float(phase_factor(name).min()), float(phase_factor(name).max())]
            for name in ("divided by K", *NOT_NORMALISED)
        },
    }


def _third_order(found: ThirdOrder, config: Config) -> dict[str, object]:
    s = config.sampling
    samples = len(s.turbidity) * len(s.sun_deg) * len(s.wavelength_nm) * s.directions
    return {
        "samples": samples,
        "paths_per_sample": s.batches * s.paths,
        "noise": found.noise,
        "degree": found.degree,
        "error": found.error,
        "median_error": found.median_error,
        "largest_error": found.largest_error,
        "largest_ratio": found.largest_ratio,
    }


def _write(config: Config, found: Movements) -> None:
    text = movements_to_json(found)
    parse_movements(text)
    table = _table(movement_rows(found))
    print(table)
    settings = json.dumps(dataclasses.asdict(config), indent=1, default=str) + "\n"
    files = {"config.json": settings, "result.json": text, "table.md": table + "\n"}
    for name, content in files.items():
        save_bytes(content.encode(), config.out / name)
    with style():
        save_bytes(png_bytes(draw_movements(found)), config.out / "what_moves_it.png")
    if config.store:
        target = Path(af.__file__).parent / "tables" / MOVEMENTS
        save_bytes(text.encode(), target)


def _table(rows: list[tuple[str, ...]]) -> str:
    lines = [MOVEMENT_COLUMNS, ["---", *["---:"] * (len(MOVEMENT_COLUMNS) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)  # the fits are in double precision
    main(tyro.cli(Config))
