"""The command that draws skies, and its files."""

import datetime

import numpy as np
import pytest

import atmofit as af
from atmofit.cli import main
from atmofit.cli_sky import summit
from atmofit.render.pictures import dome_picture, panorama_picture, write_picture


def read(path):
    from matplotlib.image import imread

    return imread(path)


def run(tmp_path, *arguments):
    return main(["sky", "--width", "48", "--out", str(tmp_path), *arguments])


@pytest.mark.parametrize(("kind", "rows"), [("dome", 48), ("panorama", 12), ("landscape", 36)])
def test_pictures_are_written(tmp_path, capsys, kind, rows):
    assert run(tmp_path, "--kind", kind, "--sun-zenith", "60", "--exr") == 0
    assert "sun at elevation 30.0°, azimuth 180.0°" in capsys.readouterr().out
    shown = read(tmp_path / f"{kind}.png")
    assert shown.shape[:2] == (rows, 48)
    assert 0.1 < shown[..., :3].mean() < 0.95
    assert (tmp_path / f"{kind}.exr").stat().st_size > 500


@pytest.mark.parametrize(
    ("name", "more", "written"),
    [
        ("first.png", (), ["first.png"]),
        ("first.png", ("--exr",), ["first.exr", "first.png"]),
        ("first.exr", (), ["first.exr"]),
        ("v1.2", (), ["v1.2/dome.png"]),
    ],
)
def test_out_is_a_folder_or_a_picture(tmp_path, name, more, written):
    assert run(tmp_path / name, *more) == 0
    assert (
        sorted(f.relative_to(tmp_path).as_posix() for f in tmp_path.rglob("*.*") if f.is_file())
        == written
    )


def test_place_and_time_give_the_sun(tmp_path, capsys):
    place = ("--latitude", "50", "--longitude", "10", "--time", "2026-06-21T18:00+02:00")
    assert run(tmp_path, *place) == 0
    zenith, azimuth = np.degrees(
        af.sun_at(datetime.datetime.fromisoformat(place[-1]), *np.radians([50, 10]).tolist())
    )
    said = f"sun at elevation {90 - zenith:.1f}°, azimuth {azimuth:.1f}°"
    assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--latitude", "50"), "latitude, longitude and time must be given together"),
        (("--sun-zenith", "95"), "sun must be above the horizon, got a zenith angle of 95.0°"),
        (("--turbidity", "40"), "turbidity must be between"),
        (("--width", "2"), "width must be between 8 and 20000, got 2"),
        (
            ("--latitude", "50", "--longitude", "1", "--time", "noon"),
            "time must be like 2026-06-21T18:00+02:00, got 'noon'",
        ),
        (("--kind", "landscape", "--terrain", "nowhere.asc"), "nowhere.asc"),
    ],
)
def test_wrong_requests_say_what_is_wrong(tmp_path, capsys, arguments, message):
    assert run(tmp_path, *arguments) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("*.png"))


def toward_the_sun(directions):
    view, azimuth = directions.angles()
    bright = np.exp(-5 * np.asarray(af.scattering_angle(view, azimuth, 1.0)))
    return np.stack([bright, bright, bright], axis=-1)


def test_domes_and_panoramas_have_their_sun_where_it_stands():
    # In the east: at the right of the dome, and right of the middle of the panorama.
    dome = dome_picture(toward_the_sun, 101, np.pi / 2).XYZ[..., 1]
    row, column = np.unravel_index(np.argmax(dome), dome.shape)
    assert row == pytest.approx(50, abs=1)
    assert (column - 50) / 50.5 == pytest.approx(1.0 / (np.pi / 2), abs=0.03)
    assert dome[0, 0] == 0.0
    around = panorama_picture(toward_the_sun, 360, np.pi / 2).XYZ[..., 1]
    row, column = np.unravel_index(np.argmax(around), around.shape)
    assert column == pytest.approx(270, abs=1)
    assert row == pytest.approx(np.degrees(1.0), abs=1)


def test_exr_holds_the_light_itself(tmp_path):
    picture = panorama_picture(toward_the_sun, 64, 0.0)
    read_back = af.read_photograph(write_picture(picture, tmp_path / "sky.exr"))
    linear = np.asarray(af.XYZ_to_linear_sRGB(picture.XYZ))
    np.testing.assert_allclose(read_back.rgb, linear, rtol=1e-6)
    with pytest.raises(ValueError, match=r"path must end with \.png or \.exr"):
        write_picture(picture, tmp_path / "sky.jpg")


def test_the_summit_is_inside():
    terrain = af.procedural_terrain(3, 90, 50.0)
    east, north = summit(terrain)
    assert 30 * 50 <= east < 60 * 50
    assert 30 * 50 <= north < 60 * 50
