"""Figures without global state, as PNG bytes and files."""

import base64
import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from atmofit.files import replace_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110
_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "figure.facecolor": "white",
    "text.color": "#222222",
    "axes.labelcolor": "#222222",
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """The look of all pictures, inside this context only."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure that places its own axes; pyplot does not know of it.

    Args:
        width: [inch]; a picture has 110 dots per inch.
        height: [inch].
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")


def png_bytes(figure: "Figure") -> bytes:
    """The figure as a PNG file, without a date or address in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def data_uri(png: bytes) -> str:
    """A PNG as an address that holds the whole picture."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def save_bytes(content: bytes, path: str | Path) -> Path:
    """Write a file whole or not at all, in a folder that exists.

    Raises:
        OSError: It cannot be written; nothing is left behind.
    """

    def write(temporary: Path) -> None:
        temporary.write_bytes(content)

    return replace_file(Path(path), write)
