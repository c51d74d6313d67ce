"""Files that appear whole or not at all; and files of others, within bounds."""

import contextlib
import os
import platform
import re
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

LARGEST_FILE, LARGEST_ARRAYS = 2**28, 2**32  # [bytes]
_OLD = 24 * 3600.0  # [s]; no file takes so long to write


def replace_file(path: Path, write: Callable[[Path], None]) -> Path:
    """Write a file under a temporary name beside it, then rename: whole or not at all.

    Several processes may write the same file at once: each has its own temporary name, and the
    last to rename wins. What a killed process left of this file is removed.

    Args:
        path: The file; its folder exists.
        write: Writes the file whose path it is given.

    Returns:
        The path.

    Raises:
        OSError: It cannot be written; nothing is left behind.
    """
    _remove_leftovers(path)
    prefix = f".{path.stem}-{_host()}-{os.getpid()}-"
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def readable_file(path: Path | str, largest_bytes: int = LARGEST_FILE) -> Path:
    """A file that somebody else may have written, before it is read.

    Args:
        path: The file.
        largest_bytes: Of the file.

    Raises:
        ValueError: It is absent, no file, or larger.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"file must exist, got {str(path)!r}")
    size = path.stat().st_size
    if size > largest_bytes:
        raise ValueError(
            f"file must have at most {largest_bytes} bytes, got {size} in {str(path)!r}"
        )
    return path


def readable_arrays(path: Path | str, largest_bytes: int = LARGEST_ARRAYS) -> Path:
    """A NumPy archive (.npz) that does not unpack to more than it should.

    Args:
        path: The file.
        largest_bytes: Of all arrays together, in memory.

    Raises:
        ValueError: It is absent, no archive, or larger.
    """
    path = readable_file(path, largest_bytes)
    try:
        with zipfile.ZipFile(path) as parts:
            # What the archive says; zipfile itself reads no more than that.
            size = sum(part.file_size for part in parts.infolist())
    except zipfile.BadZipFile as error:
        raise ValueError(f"file must be a NumPy archive, got {str(path)!r} ({error})") from error
    if size > largest_bytes:
        raise ValueError(
            f"file must hold at most {largest_bytes} bytes, got {size} in {str(path)!r}"
        )
    return path


def output_folder(path: Path, name: str = "out") -> Path:
    """Make a folder for results and see that it can be written, before any work is done.

    Args:
        path: The folder.
        name: Of the argument, for the message.

    Raises:
        ValueError: It cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise ValueError(
            f"{name} must be a folder that can be written, got {str(path)!r} ({error.strerror})"
        ) from error
    return path


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files of `path` whose process is gone; those of other machines when old."""
    names = re.compile(
        rf"\.{re.escape(path.stem)}-([0-9a-f]{{8}})-(\d+)-\w+{re.escape(path.suffix)}"
    )
    for file in path.parent.iterdir():
        if (match := names.fullmatch(file.name)) is None:
            continue
        gone = match[1] == _host() and not _is_running(int(match[2]))
        with contextlib.suppress(FileNotFoundError):  # another process may remove it first
            if gone or time.time() - file.stat().st_mtime > _OLD:
                file.unlink()


def _host() -> str:
    """Eight hexadecimal digits for this machine."""
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _is_running(process: int) -> bool:
    """Whether a process of this machine runs; taken for granted where it cannot be asked."""
    if os.name != "posix":  # elsewhere signal 0 is not a question
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
