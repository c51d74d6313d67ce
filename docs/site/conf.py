"""Sphinx settings of the documentation site: `make docs`. Nothing is fetched from a network."""

import json
import os
import re
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT)]
# The tutorial runs in processes of its own, which find the package and compiled programs here.
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "atmofit" / "jax"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
os.environ.setdefault("JAX_PLATFORMS", "cpu")


def _with_figures(notebook: Path) -> Path:
    """What `make notebooks` has drawn of a notebook, if it ran as it is now; else the notebook."""
    executed = ROOT / "build" / "notebooks" / notebook.name
    if executed.exists() and _cells(executed) == _cells(notebook):
        return executed
    return notebook


def _cells(notebook: Path) -> list[str]:
    """The text of all cells."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells]


NOTEBOOKS = HERE / "notebooks"
shutil.rmtree(NOTEBOOKS, ignore_errors=True)
NOTEBOOKS.mkdir()
for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
    shutil.copy(_with_figures(notebook), NOTEBOOKS)

project = "atmofit"
author = "atmofit contributors"
copyright = "atmofit contributors, MIT license"
version = release = re.search(
    r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE
)[1]

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinxcontrib.bibtex",
    "mathml",
    "public_names",
]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # pages that run say so themselves
nb_execution_raise_on_error = True
nb_execution_timeout = 240
nb_execution_in_temp = True
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

default_role = "py:obj"
add_module_names = False
toc_object_entries_show_parents = "hide"
python_maximum_signature_line_length = 70
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
napoleon_use_ivar = True
napoleon_attr_annotations = False  # the signature has them
napoleon_use_rtype = False

html_theme = "furo"
html_title = "atmofit"
html_static_path = ["_static"]
html_css_files = ["atmofit.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "light_css_variables": {
        "color-brand-primary": "#1f5fa8",
        "color-brand-content": "#1f5fa8",
    },
    "dark_css_variables": {
        "color-brand-primary": "#7fb2ea",
        "color-brand-content": "#7fb2ea",
    },
}


def _short(text: str | None) -> str | None:
    """Annotations without modules; what may be a number, a list or an array is `Reals`."""
    if text is None:
        return None
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(?=_?[A-Z]|ndarray)", "", text.replace("~", ""))
    text = re.sub(r"PerezPrior\(strength=.*?\(numpy\)\)", "PerezPrior()", text)
    return re.sub(
        r"_?Array \| ndarray \| (?:numpy\.)?bool \| (?:numpy\.)?number \| bool \| int \| float"
        r" \| complex(?: \| Sequence\[Any\])?",
        "Reals",
        text,
    )


def _shorten(app, what, name, obj, options, signature, returns):
    return _short(signature), _short(returns)


def _escape(app, what, name, obj, options, lines):
    """A star before the name of axes, as in [*direction, wavelength], is no emphasis."""
    for k, line in enumerate(lines):
        line = re.sub(r"(?<![\w*\\`])\*(?=\w+[\],])", r"\\*", line)
        lines[k] = re.sub(r"(?<!`)`\.\.\.`(?!`)", "``...``", line)


def setup(app):
    """Connect what Sphinx calls while it reads docstrings."""
    app.connect("autodoc-process-signature", _shorten)
    app.connect("autodoc-process-docstring", _escape)
