"""The command line: results, one clear line for bad input, exit status."""

import json
import sys

import numpy as np
import pytest

pytest.importorskip("tyro")

import atmofit as af
from atmofit.__main__ import main as main_if_installed
from atmofit.cli import main

SMALL = [
    "--rtol",
    "5e-2",
    "--turbidity",
    "2",
    "4",
    "6",
    "--suns",
    "0",
    "30",
    "60",
    "80",
    "--starts",
    "0",
]
FILES = {"coefficients.json", "sky.nc", "report.html"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("refit")
    assert main(["refit", *SMALL, "--out", str(out)]) == 0
    return out


def test_refit_writes_its_files(folder):
    names = {path.name for path in folder.iterdir()}
    assert names > FILES
    assert sum(name.endswith(".png") for name in names) >= 4
    stored = json.loads((folder / "coefficients.json").read_text())
    assert stored["settings"]["turbidity"] == [2.0, 4.0, 6.0]


def numbers(folder):
    stored = json.loads((folder / "coefficients.json").read_text())
    del stored["seconds"]
    return stored


def test_second_run_takes_the_pieces_of_the_first_and_names_a_damaged_one(
    folder, capsys, monkeypatch
):
    monkeypatch.setattr("atmofit.cli.write_report", lambda *_: [])  # costs seconds
    first = numbers(folder)
    pieces = sorted(folder.glob("pieces/*/*"))
    assert len(pieces) == 3
    pieces[1].write_bytes(pieces[1].read_bytes()[:-1])
    assert main(["refit", *SMALL, "--out", str(folder)]) == 0
    printed = capsys.readouterr()
    assert f"atmofit: piece {pieces[1]} is damaged (" in printed.err
    assert f"pieces: 2 of 3 of the simulation were found in {folder / 'pieces'}" in printed.out
    assert numbers(folder) == first


def test_run_without_pieces_keeps_none(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("atmofit.cli.write_report", lambda *_: [])
    assert main(["refit", *SMALL, "--no-pieces", "--out", str(tmp_path)]) == 0
    assert "pieces:" not in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"coefficients.json", "sky.nc"}
    assert numbers(tmp_path) == numbers(folder)


@pytest.mark.parametrize("model", ["published", "file"])
def test_check_compares(model, folder, capsys):
    name = str(folder / "coefficients.json") if model == "file" else model
    assert main(["check", name, "--like", str(folder / "coefficients.json")]) == 0
    printed = capsys.readouterr().out
    assert "Y at the zenith, model / simulation" in printed
    assert "80" in printed


def test_check_takes_the_settings_of_the_file(folder, capsys):
    assert main(["check", str(folder / "coefficients.json")]) == 0
    printed = capsys.readouterr().out
    stored = json.loads((folder / "coefficients.json").read_text())
    assert f"{stored['comparison']['regenerated']['luminance_rms']:.3f}" in printed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["refit", "--rtol=-1"], "rtol must be between 0.0005 and 1, got -1"),
        (["refit", "--turbidity", "0.5", "2", "3"], "turbidity must be between 1 and 64, got 0.5"),
        (["refit", "--turbidity", "2", "3"], "turbidity must hold at least 3 values"),
        (
            ["refit", "--suns", "0", "20", "40", "95"],
            "suns must be between 0 and 90",
        ),
        (["refit", "--turbidity", "nan", "2", "3"], "turbidity must be between 1 and 64, got nan"),
        (["refit", "--orders", "21"], 'orders must be 1 to 20 or "all", got 21'),
        (["check", "nothing.json"], "file must exist, got 'nothing.json'"),
    ],
)
def test_bad_input_gives_one_line_and_status_2(arguments, message, capsys):
    assert main(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("atmofit: ")
    assert message in lines[0]


def test_folder_that_cannot_be_written_gives_status_2(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main(["refit", "--out", str(blocked)]) == 2
    assert "out must be a folder that can be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [["refit", "--rtol", "abc"], ["refit", "--geometry", "round"], ["paint"], []]
)
def test_unknown_arguments_give_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert capsys.readouterr().err


def test_export_writes_source_code(tmp_path, capsys):
    assert main(["export", "--to", "glsl", "--out", str(tmp_path / "sky.glsl")]) == 0
    assert "sky.glsl" in capsys.readouterr().out
    assert "void atmofit_2026(" in (tmp_path / "sky.glsl").read_text()
    absent = str(tmp_path / "absent.json")
    assert main(["export", "--to", "c", "--out", "x", "--model", absent]) == 2
    assert "file must exist" in capsys.readouterr().err


def test_turbidity_of_a_table_is_reported(tmp_path, capsys):
    random = np.random.default_rng(5)
    view, azimuth = (
        np.tile(np.arange(10.0, 81.0, 10.0), 6),
        np.repeat(np.arange(0.0, 360.0, 60.0), 8),
    )
    directions = af.Directions(np.radians(view), np.radians(azimuth))
    Y = np.asarray(af.ATMOFIT_2026(2.4, np.radians(40.0), directions))[:, 2]
    Y = Y * np.exp(0.02 * random.standard_normal(Y.shape))
    rows = [f"{v:g},{a:g},40,{y:.2f}" for v, a, y in zip(view, azimuth, Y, strict=True)]
    head = "view_zenith_deg,relative_azimuth_deg,sun_zenith_deg,luminance_cd_m2"
    (tmp_path / "sky.csv").write_text("\n".join([head, *rows]))
    out = tmp_path / "out"
    assert main(["turbidity", str(tmp_path / "sky.csv"), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "sky: turbidity 2." in printed
    (found,) = json.loads((out / "turbidity.json").read_text())["skies"]
    low, high = found["turbidity_interval_95"]
    assert low < 2.4 < high
    assert found["turbidity"] == pytest.approx(2.4, abs=0.15)  # with the model's own mean errors
    assert found["haze_optical_depth_550"] == pytest.approx(
        (found["turbidity"] - 1) * 0.0973, abs=1e-3
    )
    assert not found["refused"]
    page = (out / "report.html").read_text()
    assert "sky: turbidity" in page
    assert "data:image/png" in page
    assert (out / "sky_01.png").stat().st_size > 1e4


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.csv", None, "file must exist"),
        ("sky.txt", "x", "file must end in .exr, .hdr, .pic"),
        ("sky.jpg", "x", "a .jpg has been tone-mapped"),
        ("sky.exr", "x", "file must be a whole OpenEXR image"),
        ("sky.csv", "a,b\n1,2\n", "solar_zenith_deg must be given|file must have a column"),
    ],
)
def test_turbidity_refuses_bad_files(name, content, message, tmp_path, capsys):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    assert main(["turbidity", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert any(part in said for part in message.split("|"))


def test_a_missing_package_is_one_line(monkeypatch, capsys):
    monkeypatch.delitem(sys.modules, "atmofit.cli", raising=False)
    monkeypatch.setitem(sys.modules, "tyro", None)
    assert main_if_installed() == 2
    printed = capsys.readouterr().err
    assert printed == "atmofit: the command line needs tyro: pip install 'atmofit[cli]'\n"
