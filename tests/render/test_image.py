"""Figures as files."""

import base64
import sys

import matplotlib
import pytest

from atmofit.render.image import data_uri, new_figure, png_bytes, save_bytes, style


def test_figure_is_saved_as_png_without_an_address(tmp_path):
    figure = new_figure(1.0, 1.0)
    figure.subplots().plot([0, 1])
    path = save_bytes(png_bytes(figure), tmp_path / "a.png")
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert b"http" not in content
    assert list(tmp_path.iterdir()) == [path]
    assert base64.b64decode(data_uri(content).removeprefix("data:image/png;base64,")) == content


def test_no_global_state():
    before = dict(matplotlib.rcParams)
    with style():
        png_bytes(new_figure(1.0, 1.0))
    assert dict(matplotlib.rcParams) == before
    if "matplotlib.pyplot" in sys.modules:
        assert sys.modules["matplotlib.pyplot"].get_fignums() == []


def test_nothing_is_left_where_a_file_cannot_be_written(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        save_bytes(b"x", tmp_path / "taken")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
    with pytest.raises(OSError, match="absent"):
        save_bytes(b"x", tmp_path / "absent" / "file")
