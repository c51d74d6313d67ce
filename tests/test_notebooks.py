"""Notebooks run in silence, are stored without outputs, and match their scripts.

What they drew is kept in build/notebooks, from where the documentation takes it.
"""

import ast
import os
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

from atmofit.files import replace_file

ROOT = Path(__file__).parents[1]
FOLDER, EXECUTED = ROOT / "notebooks", ROOT / "build" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SCRIPTS = sorted(FOLDER.glob("*.py"))
LONGEST_FUNCTION = 3  # lines; whatever is longer belongs to the library


def test_every_notebook_has_its_script():
    assert NOTEBOOKS
    assert [path.stem for path in NOTEBOOKS] == [path.stem for path in SCRIPTS]


@pytest.mark.notebooks
@pytest.mark.slow
@pytest.mark.timeout(600)  # on an empty compilation cache
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path, monkeypatch):
    monkeypatch.setenv("ATMOFIT_FAST", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))  # no settings of the user
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the kernel's own shows figures in the cells
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "atmofit" / "jax"
    for name, value in (
        ("JAX_COMPILATION_CACHE_DIR", str(cache)),
        ("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3"),
    ):
        monkeypatch.setenv(name, os.environ.get(name, value))
    notebook = nbformat.read(path, as_version=4)
    folder = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=None, resources=folder).execute()
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    said = [o.text for o in outputs if o.output_type == "stream" and o.name == "stderr"]
    assert not said
    assert sum("image/png" in o.get("data", {}) for o in outputs) >= 3
    EXECUTED.mkdir(parents=True, exist_ok=True)
    replace_file(EXECUTED / path.name, lambda new: nbformat.write(notebook, new))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    ids = [cell.id for cell in notebook.cells]
    assert len(set(ids)) == len(ids)
    for cell in notebook.cells:
        assert not cell.metadata
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_in_step_with_its_script(path):
    notebook = jupytext.reads(path.read_text("utf-8"), fmt="ipynb")
    script = jupytext.reads(path.with_suffix(".py").read_text("utf-8"), fmt="py:percent")
    cells, expected = (
        [(cell.cell_type, cell.source) for cell in one.cells] for one in (notebook, script)
    )
    assert cells == expected


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_notebook_defines_nothing_reusable(path):
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    assert not [node for node in nodes if isinstance(node, ast.ClassDef)]
    for node in nodes:
        if isinstance(node, ast.FunctionDef):
            assert (node.end_lineno or 0) - node.lineno < LONGEST_FUNCTION, node.name
