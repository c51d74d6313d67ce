"""What an experiment leaves behind: its settings, its results and a table."""

import dataclasses
import json
import os
import subprocess
from pathlib import Path
from typing import Any

from atmofit.files import output_folder, replace_file
from atmofit.provenance import versions


def write_run(out: Path, config: Any, result: dict[str, Any], table: str) -> None:
    """Write config.json, result.json and table.md, each whole or not at all.

    Args:
        out: Folder, made if absent.
        config: A dataclass; stored with commit, versions and number of processors.
        result: Numbers, strings, lists and dicts of them.
        table: Markdown.
    """
    output_folder(out)
    settings = {
        **dataclasses.asdict(config),
        "commit": commit(),
        "versions": versions(),
        "processors": os.cpu_count(),
    }
    for name, text in (
        ("config.json", json.dumps(settings, indent=1, default=str)),
        ("result.json", json.dumps(result, indent=1)),
        ("table.md", table),
    ):
        replace_file(out / name, lambda path, text=text: _write(path, text))


def commit() -> str:
    """The commit of the checkout, or "unknown"."""
    try:
        command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """A table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _write(path: Path, text: str) -> None:
    path.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
