"""A plain HTML page that holds everything it shows. All text is escaped here."""

from collections.abc import Iterable, Sequence
from html import escape

from atmofit.render.image import data_uri

_CSS = """
body { margin: 0 auto; max-width: 62rem; padding: 1rem; color: #222; background: #fff;
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { font-size: 1.25rem; margin-top: 2.5rem; }
h3 { font-size: 1rem; margin: 1.5rem 0 .5rem; }
p, li { max-width: 45rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .7rem; text-align: right; white-space: nowrap; }
th { border-bottom: 1px solid #999; vertical-align: bottom; white-space: normal; max-width: 9rem; }
td:first-child, th:first-child { text-align: left; }
tbody tr:nth-child(even) { background: #f4f4f4; }
table.words td { text-align: left; white-space: normal; }
table.words td:first-child { white-space: nowrap; vertical-align: top; }
figure { margin: 1.5rem 0 2.5rem; }
figure .wide img { display: block; min-width: 40rem; max-width: 100%; height: auto; }
figcaption { max-width: 45rem; margin-top: .5rem; font-size: .9rem; color: #444; }
pre { overflow-x: auto; background: #f4f4f4; padding: .7rem; font-size: .8rem; }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """A page of parts that are HTML already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )


def heading(text: str, level: int = 2) -> str:
    """A heading."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str) -> str:
    """A paragraph."""
    return f"<p>{escape(text)}</p>"


def bullets(lines: Iterable[str]) -> str:
    """A list of sentences."""
    return "<ul>\n" + "\n".join(f"<li>{escape(line)}</li>" for line in lines) + "\n</ul>"


def block(text: str) -> str:
    """Text whose lines stay as they are."""
    return f"<pre>{escape(text)}</pre>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, words: bool = False) -> str:
    """A table that scrolls where the screen is narrow.

    Args:
        head: Names of the columns; empty: no head.
        rows: Cells as text.
        words: Whether the cells are words rather than numbers.
    """
    words_class = ' class="words"' if words else ""
    lines = [f'<div class="wide"><table{words_class}>']
    if head:
        cells = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
        lines.append(f"<thead><tr>{cells}</tr></thead>")
    lines.append("<tbody>")
    lines += ["<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</tbody></table></div>"])


def picture(png: bytes, caption: str) -> str:
    """A PNG inside the page, with its caption, which is also what a screen reader says."""
    return (
        f'<figure><div class="wide"><img src="{data_uri(png)}" alt="{escape(caption)}"></div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
