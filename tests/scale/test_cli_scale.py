"""The commands dataset and series: stores, one clear line for bad input, exit status."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("tyro")
pytest.importorskip("zarr")

from scale import run_works
from scale.toy_work import ToyWork

import atmofit as af
from atmofit import cli_scale
from atmofit.cli import main
from atmofit.scale.store import BlockStore

SMALL = "--turbidity 2 3.5 --suns 20 75 91 --albedo 0.4 --wavelengths 450 --rtol 1"
DATASET = ["dataset", *SMALL.split(" ")]


@pytest.fixture
def small(monkeypatch):
    """The command's skies on the small plan."""
    work = run_works.sky_work()
    monkeypatch.setattr(cli_scale, "SkyWork", lambda sky: dataclasses.replace(work, sky=sky))


def test_dataset_with_fits(small, tmp_path, capsys):
    command = [*DATASET, "--dtype", "float64", "--fit", "--out", str(tmp_path), "--block", "1"]
    assert main([*command, "--devices", "1"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.split(":")[1].split(",")[0].strip() for line in said] == ["2 blocks computed"] * 2
    entry = BlockStore.open(tmp_path / "fits").entry(1)
    entry.write_text(entry.read_text().replace('"sha256": "', '"sha256": "no'))
    assert main(command) == 0  # on all devices, which one device made
    said = capsys.readouterr().out
    assert "skies: 0 blocks computed, 2 found" in said
    assert "fits: 1 blocks computed (1 of them were damaged), 1 found" in said
    with BlockStore.open(tmp_path / "skies").dataset() as data:
        table = data.set_index(air=["turbidity", "albedo"])  # as users pick a row
        assert table["xyY"].sel(turbidity=3.5, albedo=0.4).shape == (3, 29, 3)
        assert data["radiance"].attrs["units"] == "sr-1"
    with BlockStore.open(tmp_path / "fits").dataset() as data:
        assert data["coefficients"].shape == (2, 2, 5)  # no fit below the horizon
        np.testing.assert_allclose(np.degrees(data["solar_zenith_angle"]), [20, 75], rtol=1e-14)
        assert bool(data["converged"].all())
    assert main([*DATASET, "--dtype", "float64", "--out", str(tmp_path), "--albedo", "0.1"]) == 2
    assert "was made with other settings albedo" in capsys.readouterr().err


def test_series_of_a_table(tmp_path, capsys):
    dome = run_works.sky_work().directions
    assert dome is not None
    view, azimuth = np.degrees(dome.view_zenith_angle), np.degrees(dome.relative_azimuth)
    truth, lines = (2.5, 4.0, 5.5), []
    for scan, T in enumerate(truth):
        Y = af.PREETHAM_1999(T, np.radians(40.0), dome)[..., 2]
        rows = list(zip(view, azimuth, np.asarray(Y), strict=True))
        # Scans of different length.
        lines += [f"{scan},{v!s},{a!s},40,{y!s}" for v, a, y in rows[: len(rows) - scan]]
    head = "scan,view_zenith_deg,relative_azimuth_deg,sun_zenith_deg,luminance_cd_m2"
    table = tmp_path / "series.csv"
    table.write_text("\n".join([head, *lines]) + "\n")
    command = ["series", str(table), "--model", "preetham", "--no-model-error"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    assert "1 blocks computed, 0 found" in capsys.readouterr().out
    with BlockStore.open(tmp_path / "series").dataset() as data:
        # The model's own skies; the search ends at 1e-8 or so of the truth.
        np.testing.assert_allclose(data["turbidity"], truth, rtol=1e-6)
        assert bool(data["converged"].all())
    table.write_text(table.read_text().replace(",40,", ",40.1,"))
    assert main([*command, "--out", str(tmp_path)]) == 2
    assert "was made with other settings observations" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--devices", "0"], "devices must be at least 1, got 0"),
        (["--processes", "2"], "coordinator must be given with processes"),
        (["--coordinator", "here", "--processes", "2", "--process", "0"], "HOST:PORT, got 'here'"),
        (["--suns", "97"], "suns must be between 0 and 96 degree, got 97"),
        (["--block", "0"], "block must be at least 1, got 0"),
    ],
)
def test_bad_options_are_one_line(given, message, small, tmp_path, capsys):
    assert main([*DATASET, "--out", str(tmp_path), *given]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].startswith("atmofit: ")
    assert message in said[-1]


def test_works_without_what_they_need_are_refused(tmp_path):
    dome = run_works.sky_work().directions
    assert dome is not None
    one = af.Observation(dome, np.ones(29), 0.5, 0.02)
    other = af.Observation(dome, np.ones((29, 3)), 0.5, 0.02, channels="XYZ")
    with pytest.raises(ValueError, match="observations must be of one kind of channels"):
        af.SeriesWork([one, other])
    with pytest.raises(ValueError, match="observations must be at least one, got none"):
        af.SeriesWork([])
    with pytest.raises(ValueError, match="folder must hold a store of blocks, got 'nowhere'"):
        _ = af.FitWork("nowhere").count
    af.run_blocks(ToyWork(), tmp_path / "toy")
    with pytest.raises(ValueError, match=r"skies must be a finished store of skies, got .* toy"):
        _ = af.FitWork(tmp_path / "toy").count
