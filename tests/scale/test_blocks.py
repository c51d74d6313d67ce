"""Stores of blocks: resumed runs equal undisturbed ones, and what is damaged is noticed."""

import json

import numpy as np
import pytest

pytest.importorskip("zarr")

from scale.toy_work import ToyWork

import atmofit as af
from atmofit.scale import store as stores
from atmofit.scale.hosts import Hosts
from atmofit.scale.store import BlockStore

ROWS = 4  # in a block: blocks of 4, 4 and 3 rows
BLOCKS = 3


class Killed(BaseException):
    """Nothing may catch it."""


def run(folder, work=None, rows_per_block: int | None = ROWS, **keywords):
    return af.run_blocks(work or ToyWork(), folder, rows_per_block=rows_per_block, **keywords)


def every_block(folder):
    store = BlockStore.open(folder)
    return [store.read(block) for block in range(store.block_count)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed") / "store"
    done = run(folder)
    assert (done.computed, done.found) == (BLOCKS, 0)
    return folder


def same(folder, other):
    for a, b in zip(every_block(folder), every_block(other), strict=True):
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
    sums = [BlockStore.open(one).manifest["sha256"] for one in (folder, other)]
    assert sums[0] == sums[1]


def test_store_reads_as_a_dataset_with_units(undisturbed):
    with BlockStore.open(undisturbed).dataset() as data:
        # Sines of numbers up to 18: rounding of the argument, 18 x 1.1e-16; seen: 3e-16.
        np.testing.assert_allclose(data["waves"], ToyWork().expected(), rtol=0, atol=2e-15)
        np.testing.assert_array_equal(data["above"], data["waves"][:, 0] > 0)
        np.testing.assert_array_equal(data["place"], np.linspace(0.0, 6.0, 11))
        assert data["waves"].dims == ("row", "wave")
        assert "place" in data["waves"].coords
        assert data["waves"].attrs["units"] == "1"
    assert af.verify_store(undisturbed) == []


def killed_after(calls, original):
    """The function, which goes so far and no further."""
    left = [calls]

    def wrapped(*arguments, **keywords):
        if left[0] == 0:
            raise Killed
        left[0] -= 1
        return original(*arguments, **keywords)

    return wrapped


@pytest.mark.parametrize(
    ("where", "name", "calls", "left"),
    [
        ("template", "_write_template", 0, 0),
        ("manifest of the template", "_write_json", 0, 0),
        ("values of the first block", "_write_values", 0, 0),
        ("between values and entry", "_write_entry", 0, 0),
        ("values of the second block", "_write_values", 1, 1),
        ("between values and entry of the last block", "_write_entry", 2, 2),
        ("between two arrays of a block", "_array", 3, 1),
        ("checksums in the manifest", "finish", 0, 3),
    ],
    ids=lambda x: x if isinstance(x, str) else None,
)
def test_killed_runs_go_on_and_end_alike(where, name, calls, left, undisturbed, tmp_path):
    folder = tmp_path / "store"
    owner = BlockStore if hasattr(BlockStore, name) else stores
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, killed_after(calls, getattr(owner, name)))
        with pytest.raises(Killed):
            run(folder)
    done = run(folder)
    assert (done.computed, done.found, done.damaged) == (BLOCKS - left, left, ())
    same(folder, undisturbed)
    assert not list(tmp_path.glob(".*"))  # nothing half-made stays


@pytest.mark.parametrize("how", ["bit", "short", "entry", "gone"])
def test_a_damaged_block_is_seen_and_computed_again(how, undisturbed, tmp_path):
    folder = tmp_path / "store"
    run(folder)
    store = BlockStore.open(folder)
    chunk = folder / stores.VALUES / "waves" / "c" / "1" / "0"
    content = chunk.read_bytes()
    if how == "bit":
        values = store.read(1)["waves"].copy()
        values[0, 0] = np.nextafter(values[0, 0], 2.0)
        store._write_values(1, store.read(1) | {"waves": values})
    elif how == "short":
        chunk.write_bytes(content[: len(content) // 2])
    elif how == "entry":
        store.entry(1).write_text(store.entry(1).read_text()[:20])
    else:
        chunk.unlink()
    assert af.verify_store(folder) == [1]
    done = run(folder)
    assert (done.computed, done.found, done.damaged) == (1, BLOCKS - 1, (1,))
    assert af.verify_store(folder) == []
    same(folder, undisturbed)


def test_a_block_in_the_place_of_another_is_noticed(tmp_path):
    folder = tmp_path / "store"
    run(folder)
    store = BlockStore.open(folder)
    store._write_values(1, store.read(0))
    store.entry(1).write_text(store.entry(0).read_text())
    assert af.verify_store(folder) == [1]


def test_processes_share_the_blocks(undisturbed, tmp_path, monkeypatch):
    # One after the other, without waiting for each other.
    monkeypatch.setattr(Hosts, "wait", lambda *_: None)
    monkeypatch.setattr(BlockStore, "absent", lambda _: False)
    folder = tmp_path / "store"
    with pytest.raises(ValueError, match="every block must be whole"):
        run(folder, hosts=Hosts(0, 2))
    assert sorted(path.stem for path in (folder / "blocks").iterdir()) == ["00000000", "00000002"]
    assert run(folder, hosts=Hosts(1, 2)).computed == 1
    assert (run(folder).computed, run(folder).found) == (0, BLOCKS)  # alone, all of them
    same(folder, undisturbed)


def test_progress_and_the_size_of_blocks(tmp_path):
    said = []
    run(tmp_path / "store", rows_per_block=None, progress=said.append)
    # Four times one device's group of two: blocks of 8 and 3 rows.
    assert said == ["block 1 of 2", "block 2 of 2"]
    assert run(tmp_path / "store", rows_per_block=None).found == 2


def test_a_store_of_other_settings_is_refused(undisturbed, tmp_path):
    with pytest.raises(ValueError, match="was made with other settings shift"):
        run(undisturbed, ToyWork(shift=1e-9))
    with pytest.raises(ValueError, match="was made with other rows_per_block"):
        run(undisturbed, rows_per_block=5)
    manifest = json.loads((undisturbed / "manifest.json").read_text())
    other = tmp_path / "store"
    run(other)
    (other / "manifest.json").write_text(json.dumps(manifest | {"source": "edited"}))
    with pytest.raises(ValueError, match="was made with other source"):
        run(other)
    assert af.verify_store(undisturbed) == []


def test_bad_folders_and_sizes_are_refused(tmp_path, monkeypatch):
    waited = []
    monkeypatch.setattr(Hosts, "wait", lambda _, name: waited.append(name))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter").write_text("mine")
    with pytest.raises(ValueError, match="out must be a new folder or a store of blocks"):
        run(tmp_path / "full", hosts=Hosts(0, 2))
    with pytest.raises(ValueError, match="folder must hold a store of blocks"):
        run(tmp_path / "full", hosts=Hosts(1, 2))
    assert waited == ["toy is there"] * 2  # no process is left waiting for the other
    assert (tmp_path / "full" / "letter").read_text() == "mine"
    with pytest.raises(ValueError, match="folder must hold a store of blocks"):
        af.verify_store(tmp_path / "nothing")
    with pytest.raises(ValueError, match="block must be at least 1, got 0"):
        run(tmp_path / "store", rows_per_block=0)
