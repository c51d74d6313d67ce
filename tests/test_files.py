"""Files appear whole or not at all, also beside what killed runs left and while others write."""

import os
import stat
import subprocess
import sys
import time

import numpy as np
import pytest

from atmofit import files
from atmofit.files import output_folder, readable_arrays, readable_file, replace_file


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    return path


def new(temporary):
    temporary.write_text("new")


@pytest.fixture(scope="module")
def gone():
    """The number of a process that has ended."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def leftover(path, process, host=None, name=None):
    """A file as a process killed while it wrote `path` leaves it."""
    stem = name or path.stem
    temporary = path.with_name(f".{stem}-{host or files._host()}-{process}-ab_9{path.suffix}")
    temporary.write_text("ha")
    return temporary


def test_failed_write_leaves_the_old_file_and_nothing_else(path):
    def fail(temporary):
        temporary.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        replace_file(path, fail)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_written_file_is_readable_by_others(path):
    replace_file(path, new)
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_old_file_stays_until_the_new_one_is_whole(path):
    def write(temporary):
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.suffix == path.suffix

    replace_file(path, write)
    assert path.read_text() == "new"


def test_leftovers_of_a_killed_process_are_removed(path, gone):
    leftover(path, gone)
    replace_file(path, new)
    assert list(path.parent.iterdir()) == [path]


def test_temporary_files_of_others_stay(path, gone):
    kept = {
        leftover(path, os.getpid()),  # a process that runs
        leftover(path, gone, host="0123abcd"),  # perhaps running on another machine
        leftover(path, gone, name="result-2"),  # of another file
    }
    replace_file(path, new)
    assert set(path.parent.iterdir()) == {path, *kept}


def test_leftover_of_another_machine_is_removed_after_a_day(path):
    temporary = leftover(path, 1, host="0123abcd")
    then = time.time() - 25 * 3600
    os.utime(temporary, (then, then))
    replace_file(path, new)
    assert list(path.parent.iterdir()) == [path]


def test_last_of_two_writers_wins(path):
    def slow(temporary):
        temporary.write_text("slow")
        replace_file(path, new)  # another writer begins and ends meanwhile
        assert path.read_text() == "new"

    replace_file(path, slow)
    assert path.read_text() == "slow"
    assert list(path.parent.iterdir()) == [path]


def test_name_of_the_temporary_file_is_found_again_when_its_process_is_gone(path, monkeypatch):
    names = []
    replace_file(path, lambda temporary: (names.append(temporary), new(temporary))[1])
    names[0].write_text("half")
    monkeypatch.setattr(files, "_is_running", lambda process: process != os.getpid())
    replace_file(path, new)
    assert list(path.parent.iterdir()) == [path]


def test_folder_that_is_a_file_is_refused(path):
    with pytest.raises(ValueError, match=r"out must be a folder that can be written, got .*result"):
        output_folder(path)


def test_files_of_others_are_bounded(tmp_path):
    assert readable_file(str(tmp_path / __file__)).name == "test_files.py"
    with pytest.raises(ValueError, match="file must exist"):
        readable_file(tmp_path)
    big = tmp_path / "big.json"
    big.write_bytes(b" " * 1000)
    with pytest.raises(ValueError, match=r"file must have at most 999 bytes, got 1000 in .*big"):
        readable_file(big, 999)
    # Zeros pack well: what counts is what they unpack to.
    np.savez_compressed(tmp_path / "zeros.npz", a=np.zeros(100_000))
    assert (tmp_path / "zeros.npz").stat().st_size < 2000
    with pytest.raises(ValueError, match="file must hold at most 2000 bytes, got 800128"):
        readable_arrays(tmp_path / "zeros.npz", 2000)
    with pytest.raises(ValueError, match="file must be a NumPy archive"):
        readable_arrays(big)
