"""Finished pieces of a simulation: found again, checked, replaced when damaged."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import atmofit as af
from atmofit import provenance
from atmofit.fit.pieces import KEYS_KEPT, DamagedPieceWarning, Pieces, simulation_key
from atmofit.fit.skies import Clock

# Five suns: the second block has one of its own and is filled up. Three turbidities: 6 pieces.
SETTINGS = af.RefitSettings(
    turbidity=(2.0, 4.0, 6.0),
    solar_zenith_angle_deg=(0.0, 30.0, 50.0, 65.0, 80.0),
    rtol=5e-2,
    starts=0,
)
CHILD = """
import sys
import atmofit as af
from atmofit.cli import use_compilation_cache
from fit.test_pieces import SETTINGS
use_compilation_cache()
af.simulate_skies(SETTINGS, pieces=sys.argv[1])
"""


@pytest.fixture(scope="module")
def undisturbed():
    return af.simulate_skies(SETTINGS)


@pytest.fixture
def folder(undisturbed, tmp_path):
    """With every piece in it."""
    skies = af.simulate_skies(SETTINGS, pieces=tmp_path)
    assert_same(skies, undisturbed, read=0)
    return tmp_path


def assert_same(skies, expected, read):
    np.testing.assert_array_equal(skies.radiance, expected.radiance)
    np.testing.assert_array_equal(skies.xyY, expected.xyY)
    assert skies.pieces_read == read


def files(folder):
    return sorted(folder.glob("*/*"))


def test_pieces_are_read_and_nothing_else_is_in_the_folder(folder, undisturbed):
    assert len(files(folder)) == SETTINGS.piece_count == 6
    told = []
    skies = af.simulate_skies(SETTINGS, Clock(told.append), folder)
    assert_same(skies, undisturbed, read=6)
    assert told == ["simulation", *(f"piece {i} found" for i in range(1, 7)), "colour"]


def test_filled_up_block_holds_what_its_suns_have_alone(undisturbed):
    # The fifth sun shares its program with three copies of itself; other suns must not move it.
    suns = (*SETTINGS.solar_zenith_angle_deg[1:], 20.0)
    moved = af.simulate_skies(dataclasses.replace(SETTINGS, solar_zenith_angle_deg=suns))
    assert undisturbed.radiance.shape == (3, 5, 343, 41)
    np.testing.assert_array_equal(moved.radiance[:, :4], undisturbed.radiance[:, 1:])


def test_missing_pieces_are_computed_again(folder, undisturbed):
    for path in files(folder)[1:4]:
        path.unlink()
    told = []
    skies = af.simulate_skies(SETTINGS, Clock(told.append), folder)
    assert_same(skies, undisturbed, read=3)
    assert told[4:7] == ["piece 4 of 6", "piece 5 of 6", "piece 6 of 6"]


def cut(content):
    return content[:-100]


def flip(content):
    return content[:1000] + bytes([content[1000] ^ 4]) + content[1001:]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (cut, r"\d+ of \d+ bytes are there"),
        (flip, "its checksum is another"),
        (lambda content: content[:20], "its first line is not a checksum and a length"),
        (
            lambda content: b"%x" % (int(content[:1], 16) ^ 1) + content[1:],
            "its checksum is another",
        ),
        (lambda _: b"", "its first line is not a checksum and a length"),
    ],
    ids=["cut", "flipped", "cut in the header", "header", "empty"],
)
def test_damaged_piece_is_named_and_computed_again(damage, reason, folder, undisturbed):
    path = files(folder)[2]
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    with pytest.warns(DamagedPieceWarning, match=rf"piece .*{path.name} .*\({reason}\)") as caught:
        assert_same(af.simulate_skies(SETTINGS, pieces=folder), undisturbed, read=5)
    assert len(caught) == 1
    assert path.read_bytes() == whole


def test_flipped_bit_in_every_byte_and_every_cut_is_seen(tmp_path):
    pieces = Pieces.open(tmp_path, "f" * 64)
    values = np.arange(3, dtype="float32")
    pieces.write("a", values)
    path = pieces.path("a")
    whole = path.read_bytes()
    np.testing.assert_array_equal(pieces.read("a"), values)
    places = range(len(whole))
    damaged = [
        *(whole[:i] + bytes([whole[i] ^ 1 << i % 8]) + whole[i + 1 :] for i in places),
        *(whole[:i] for i in places),
        whole + b"0",
    ]

    def read(content):
        path.write_bytes(content)
        return pieces.read("a")

    with pytest.warns(DamagedPieceWarning) as caught:
        found = [read(content) for content in damaged]
    assert found == [None] * len(caught) == [None] * len(damaged)


def test_piece_under_another_name_or_key_is_not_taken(tmp_path):
    one, other = (Pieces.open(tmp_path, digit * 64) for digit in "12")
    one.write("a", np.zeros(3))
    assert other.read("a") is None
    for place in (one.path("b"), other.path("a")):
        place.write_bytes(one.path("a").read_bytes())
    for pieces, name in ((one, "b"), (other, "a")):
        with pytest.warns(DamagedPieceWarning, match="its checksum is another"):
            assert pieces.read(name) is None


def test_other_settings_have_pieces_of_their_own(folder, undisturbed):
    other = dataclasses.replace(SETTINGS, turbidity=(2.0, 4.0, 6.5))
    assert af.simulate_skies(other, pieces=folder).pieces_read == 0
    assert_same(af.simulate_skies(SETTINGS, pieces=folder), undisturbed, read=6)


def test_key_changes_with_all_that_moves_the_numbers(monkeypatch):
    def key(**changes):
        return simulation_key(dataclasses.replace(SETTINGS, **changes).simulated)

    changed = [
        key(turbidity=(2.0, 4.0, 6.5)),
        key(solar_zenith_angle_deg=(0.0, 30.0, 50.0, 65.0, 81.0)),
        key(wavelength_nm=(450.0, 550.0, 651.0)),
        key(orders=1),
        key(rtol=1e-2),
        key(geometry="flat"),
        key(dtype="float64"),
    ]
    assert len({key(), *changed}) == 8
    assert key(weighting="absolute") == key()  # of the fits only
    before = key()
    for module in ("versions", "source_digest", "machine"):
        with monkeypatch.context() as patch:
            patch.setattr(f"atmofit.fit.pieces.{module}", lambda: "other")
            assert key() != before


def test_source_digest_covers_code_and_tables(tmp_path, monkeypatch):
    for name in ("provenance.py", "look.py", "table.csv"):
        (tmp_path / name).write_text("1")
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "provenance.py"))
    digest = provenance.source_digest.__wrapped__
    seen = {digest()}
    for name in ("look.py", "table.csv"):
        (tmp_path / name).write_text("2")
        seen.add(digest())
    (tmp_path / "look.py").rename(tmp_path / "book.py")
    assert len({*seen, digest()}) == 4


def grow_old(path, seconds):
    then = time.time() - seconds
    os.utime(path, (then, then))


def test_folder_does_not_grow_without_end(tmp_path):
    foreign = tmp_path / "0123456789abcdef"  # named like one of ours, but not ours
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    grow_old(foreign, 15.5)
    (tmp_path / "notes.txt").write_text("mine")
    for age in range(30, 0, -1):
        pieces = Pieces.open(tmp_path, f"{age:02d}" * 32)
        pieces.write("a", np.zeros(3))
        (pieces.folder / ".a-killed.piece").write_text("half")
        grow_old(pieces.folder, age)
    Pieces.open(tmp_path, "01" * 32)
    kept = {path.name for path in tmp_path.iterdir()} - {foreign.name, "notes.txt"}
    assert kept == {f"{age:02d}" * 8 for age in range(1, KEYS_KEPT + 1)}
    assert (foreign / "thesis.txt").read_text() == "mine"


def test_folder_removed_by_another_run_is_made_again(tmp_path):
    pieces = Pieces.open(tmp_path, "f" * 64)
    pieces.folder.rmdir()
    pieces.write("a", np.zeros(3))
    assert pieces.read("a") is not None


def test_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    told = []
    with pytest.raises(ValueError, match=r"pieces must be a folder .*, got .*file"):
        af.refit(SETTINGS, pieces=blocked, progress=told.append)
    assert not told


def test_killed_run_is_continued(undisturbed, tmp_path):
    """SIGKILL as soon as two pieces are there; two is what must be kept, at least."""
    tests = str(Path(__file__).parents[1])
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(tmp_path)],
        env=os.environ | {"PYTHONPATH": tests},
        stderr=subprocess.PIPE,
    )
    deadline = time.monotonic() + 200
    while len(list(tmp_path.glob("*/[!.]*"))) < 2:
        assert child.poll() is None, child.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(1e-3)
    child.send_signal(signal.SIGKILL)
    child.communicate()
    kept = len(list(tmp_path.glob("*/[!.]*")))
    assert 2 <= kept <= 6
    assert_same(af.simulate_skies(SETTINGS, pieces=tmp_path), undisturbed, read=kept)
    assert not list(tmp_path.rglob(".*"))
