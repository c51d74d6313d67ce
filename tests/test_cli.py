"""The command line: results, one clear line for bad input, exit status."""

import json

import pytest

pytest.importorskip("tyro")

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
