"""Finished pieces of a simulation on disk: the next run finds them, and checks them before use."""

import contextlib
import dataclasses
import hashlib
import io
import json
import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from atmofit.files import output_folder, replace_file
from atmofit.provenance import machine, source_digest, versions

KEYS_KEPT = 8
_SUFFIX = ".piece"


class DamagedPieceWarning(UserWarning):
    """A piece on disk is not what was written; it is computed again."""


def simulation_key(simulated: Mapping[str, Any]) -> str:
    """Hash of everything on which a simulation's numbers depend.

    Args:
        simulated: Settings of the simulation, plain values that JSON takes.

    Returns:
        64 hexadecimal digits, of the settings, the versions of the packages, this package's
        source files, and the machine.
    """
    everything = {
        "simulated": simulated,
        "versions": versions(),
        "source": source_digest(),
        "machine": machine(),
    }
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


@dataclasses.dataclass(frozen=True)
class Pieces:
    """The pieces of one simulation.

    Each is a file: a line with the SHA-256 and the length of what follows, then the array in
    NumPy's format. The hash also covers the key and the piece's name, so that a file out of place
    is not taken for what it is not.

    Attributes:
        folder: Of this key.
        key: From `simulation_key`.
    """

    folder: Path
    key: str

    @staticmethod
    def open(folder: str | Path, key: str) -> "Pieces":
        """The pieces of a key, in a folder that holds those of several.

        Pieces of the eight keys last used are kept, those of older ones are removed.

        Raises:
            ValueError: The folder cannot be made or written.
        """
        mine = output_folder(Path(folder), "pieces") / key[:16]
        output_folder(mine, "pieces")
        os.utime(mine)
        _remove_oldest(Path(folder), mine)
        return Pieces(mine, key)

    def path(self, name: str) -> Path:
        """Where a piece is kept."""
        return self.folder / f"{name}{_SUFFIX}"

    def read(self, name: str) -> np.ndarray | None:
        """A finished piece; None if there is none, or, with a warning that names it, a damaged one.

        Warns:
            DamagedPieceWarning: The file is not what was written.
        """
        path = self.path(name)
        try:
            return self._decode(name, path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            warnings.warn(
                f"piece {path} is damaged ({reason}) and is computed again",
                DamagedPieceWarning,
                stacklevel=2,
            )
            return None

    def write(self, name: str, values: np.ndarray) -> None:
        """Keep a finished piece.

        Raises:
            OSError: It cannot be written; nothing is left behind.
        """
        self.folder.mkdir(parents=True, exist_ok=True)  # another run may have removed it
        buffer = io.BytesIO()
        np.save(buffer, values, allow_pickle=False)
        content = buffer.getvalue()
        header = f"{self._digest(name, content)} {len(content)}\n".encode()

        def write(temporary: Path) -> None:
            temporary.write_bytes(header + content)

        replace_file(self.path(name), write)

    def _decode(self, name: str, stored: bytes) -> np.ndarray:
        """The array in a file's bytes; ValueError says what is wrong with them."""
        header, _, content = stored.partition(b"\n")
        match = re.fullmatch(rb"([0-9a-f]{64}) (\d+)", header)
        if match is None:
            raise ValueError("its first line is not a checksum and a length")
        if len(content) != int(match[2]):
            raise ValueError(f"{len(content)} of {int(match[2])} bytes are there")
        if self._digest(name, content) != match[1].decode():
            raise ValueError("its checksum is another")
        return np.load(io.BytesIO(content), allow_pickle=False)

    def _digest(self, name: str, content: bytes) -> str:
        return hashlib.sha256(f"{self.key} {name}\n".encode() + content).hexdigest()


def _remove_oldest(folder: Path, mine: Path) -> None:
    """Remove the pieces of all keys but those last used; nothing else that may be there."""
    others = [p for p in folder.iterdir() if re.fullmatch("[0-9a-f]{16}", p.name) and p != mine]
    others.sort(key=_last_used, reverse=True)
    for old in others[KEYS_KEPT - 1 :]:
        for file in old.glob(f"*{_SUFFIX}"):  # hidden ones too: half-written by a killed run
            file.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # another run was faster, or it holds other files
            old.rmdir()


def _last_used(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:  # another run has removed it
        return 0.0
