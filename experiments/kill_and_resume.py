"""Does a run that was killed and started again give the coefficients of an undisturbed one?

The reference job runs once undisturbed; then once for each moment below, killed there by SIGKILL
and started again in the same folder. Every number of coefficients.json must be the same to the last
digit; only the seconds may differ.
"""

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import tyro
from run_files import markdown, write_run

HEADER = [
    "killed", "pieces kept", "pieces computed then", "temporary files", "left at the end",
    "seconds until killed", "seconds of the second run", "coefficients equal",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    arguments: tuple[str, ...] = ()
    """Of `atmofit refit`; none: the reference job."""
    after_pieces: float = 1.0
    """Seconds after the last piece at which the fits are hit."""
    out: Path = Path("runs/kill_and_resume")


@dataclasses.dataclass(frozen=True)
class Case:
    """What one kill left behind, and what the second run made of it."""

    moment: str
    kept: int
    computed: int
    temporary: int
    left: int
    seconds_until_killed: float
    seconds_of_second_run: float
    equal: bool

    def row(self) -> list[str]:
        """As strings."""
        seconds = (self.seconds_until_killed, self.seconds_of_second_run)
        counts = (self.kept, self.computed, self.temporary, self.left)
        return [
            self.moment,
            *(str(count) for count in counts),
            *(f"{second:.1f}" for second in seconds),
            "yes" if self.equal else "NO",
        ]


def main(config: Config) -> None:
    """Run undisturbed, then killed at each moment, and print the table."""
    whole = empty_folder(config.out / "undisturbed")
    seconds = run(config, whole)
    total = len(pieces(whole))
    print(f"undisturbed: {total} pieces, {seconds:.1f} s", flush=True)
    cases = []
    for name, reached in moments(total, config.after_pieces).items():
        cases.append(kill_and_resume(config, name, reached, numbers(whole)))
        print(dataclasses.asdict(cases[-1]), flush=True)
    table = markdown(HEADER, [case.row() for case in cases])
    print(table)
    result = {
        "undisturbed_seconds": seconds,
        "cases": [dataclasses.asdict(case) for case in cases],
    }
    write_run(config.out, config, result, table)
    if not all(case.equal and not case.left for case in cases):
        sys.exit("a second run differs from the undisturbed one, or left files behind")


def moments(total: int, after_pieces: float) -> dict[str, Callable[[Path], bool]]:
    """When to kill: for each moment, whether a folder shows that it is reached."""

    def fitting(folder: Path) -> bool:
        if len(pieces(folder)) < total:
            return False
        time.sleep(after_pieces)
        return True

    return {
        "after 1 piece": lambda folder: len(pieces(folder)) >= 1,
        "after half the pieces": lambda folder: len(pieces(folder)) >= total // 2,
        "in the fits": fitting,
        "while sky.nc is written": lambda folder: any(folder.glob(".sky-*.nc")),
        "among the pictures": lambda folder: any(folder.glob("*.png")),
    }


def kill_and_resume(
    config: Config, name: str, reached: Callable[[Path], bool], expected: dict[str, object]
) -> Case:
    """Start, kill when the moment is reached, start again; what was found on the way."""
    folder = empty_folder(config.out / name.replace(" ", "_"))
    begin = time.perf_counter()
    process = start(config, folder)
    while not reached(folder):
        if process.poll() is not None:
            sys.exit(f"the run in {folder} ended before it could be killed")
        time.sleep(1e-3)
    process.send_signal(signal.SIGKILL)
    process.wait()
    until_killed = time.perf_counter() - begin
    before, temporary = pieces(folder), temporary_files(folder)
    seconds = run(config, folder)
    after = pieces(folder)
    kept = sum(after[path] == written for path, written in before.items())
    return Case(
        moment=name,
        kept=kept,
        computed=len(after) - kept,
        temporary=temporary,
        left=temporary_files(folder),
        seconds_until_killed=until_killed,
        seconds_of_second_run=seconds,
        equal=numbers(folder) == expected,
    )


def empty_folder(folder: Path) -> Path:
    """The folder of one run, without what an earlier experiment left."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    return folder


def start(config: Config, folder: Path) -> subprocess.Popen[bytes]:
    """Start `atmofit refit` in a folder."""
    command = [sys.executable, "-m", "atmofit", "refit", *config.arguments]
    return subprocess.Popen(
        [*command, "--out", str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def run(config: Config, folder: Path) -> float:
    """Run `atmofit refit` to its end; the seconds it took."""
    begin = time.perf_counter()
    process = start(config, folder)
    _, said = process.communicate()
    if process.returncode:
        sys.exit(f"the run in {folder} failed:\n{said.decode()}")
    return time.perf_counter() - begin


def pieces(folder: Path) -> dict[Path, int]:
    """The finished pieces, and when each was written [ns]."""
    return {path: path.stat().st_mtime_ns for path in folder.glob("pieces/*/[!.]*.piece")}


def temporary_files(folder: Path) -> int:
    """How many files there are under temporary names."""
    return sum(path.is_file() for path in folder.rglob(".*"))


def numbers(folder: Path) -> dict[str, object]:
    """All of coefficients.json but the seconds; it is whole, or this raises."""
    stored = json.loads((folder / "coefficients.json").read_text(encoding="utf-8"))
    del stored["seconds"]
    return stored


if __name__ == "__main__":
    main(tyro.cli(Config))
