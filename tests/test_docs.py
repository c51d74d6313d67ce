"""The documentation: nothing public is missing, its code runs, its links lead somewhere.

The tutorial's cells are run here in the order of the page, and each line `% check ...` beside a
sentence (a comment to the site) holds the sentence to what was computed.
"""

import ast
import importlib.util
import re
from pathlib import Path

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

import atmofit as af

ROOT = Path(__file__).parents[1]
SITE = ROOT / "docs" / "site"
PAGES = sorted(
    path for path in SITE.rglob("*.md") if path.relative_to(SITE).parts[0] != "notebooks"
)
TUTORIAL = [path for path in PAGES if "{code-cell}" in path.read_text("utf-8")]
MARKDOWN = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
    (ROOT / "docs").glob("*.md")
)
STEPS = re.compile(r"```\{code-cell\}[^\n]*\n(.*?)```|^% check ([^\n]*)", re.DOTALL | re.MULTILINE)


def _names(path):
    return path.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def listed():
    """The helper of the site that decides which page has which name."""
    spec = importlib.util.spec_from_file_location("public_names", SITE / "public_names.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def as_users_have_it(monkeypatch):
    """JAX's own defaults, not the tests' strict ones; pictures drawn into memory."""
    with (
        jax.enable_x64(False),
        jax.numpy_rank_promotion("allow"),
        jax.numpy_dtype_promotion("standard"),
        mpl.rc_context(),
    ):
        plt.switch_backend("agg")
        monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
        yield


def test_every_public_name_is_in_the_reference_once(listed):
    names = {f"atmofit.{name}" for name in af.__all__}
    names |= {f"atmofit.clouds.{name}" for name in af.clouds.__all__}
    assert set(listed.all_names()) == names
    pages = listed.asked_modules()
    every = set().union(*pages.values())
    shown = [name for asked in pages.values() for name in listed.names_of(asked, every)]
    assert sorted(shown) == sorted(names)  # none missing, none on two pages


def test_every_page_is_reachable():
    folders = {"", "tutorial", "howto", "explanation", "reference"}
    for folder in folders:
        index = SITE / folder / ("index.rst" if folder == "reference" else "index.md")
        words = index.read_text("utf-8").split()
        pages = [*(SITE / folder).glob("*.md"), *(SITE / folder).glob("*.rst")]
        for page in set(pages) - {index}:
            assert (f"{folder}/{page.stem}" if folder == "" else page.stem) in {
                word if folder else f"/{word}" for word in words
            }, page


@pytest.mark.slow
@pytest.mark.parametrize("path", TUTORIAL, ids=_names)
def test_tutorial_runs_and_says_what_is_true(path, as_users_have_it):
    steps = [match.groups() for match in STEPS.finditer(path.read_text("utf-8"))]
    assert sum(check is not None for _, check in steps) >= 3
    names: dict[str, object] = {}
    for code, check in steps:
        if check is None:
            exec(compile(code, str(path), "exec"), names)
        else:
            assert bool(eval(check, names)), check


@pytest.mark.parametrize("path", [*PAGES, ROOT / "README.md"], ids=_names)
def test_code_is_python_with_public_names(path):
    for block in re.findall(
        r"^```(?:python|\{code-cell\}[^\n]*)\n(.*?)^```", path.read_text("utf-8"), re.M | re.S
    ):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("af", "af.clouds"):
                owner = af if ast.unparse(node.value) == "af" else af.clouds
                assert node.attr == "clouds" or node.attr in owner.__all__, node.attr


@pytest.mark.parametrize("path", [*PAGES, *MARKDOWN], ids=_names)
def test_links_and_pictures_exist(path):
    text = re.sub(r"^```python.*?^```", "", path.read_text("utf-8"), flags=re.M | re.S)
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    targets += re.findall(r"^```\{(?:figure|include)\} (\S+)", text, re.M)
    for target in targets:
        if not re.match(r"[a-z]+:|#", target):
            assert (path.parent / target.partition("#")[0]).exists(), target
    for target in re.findall(r"\{doc\}`(?:[^`<]*<)?([^`>]+)>?`", text):
        base = SITE if target.startswith("/") else path.parent
        place = base / target.lstrip("/")
        if place.parts[-2] == "notebooks":
            place = ROOT / "notebooks" / place.name
        assert any(place.with_suffix(s).exists() for s in (".md", ".rst", ".ipynb")), target


@pytest.mark.parametrize("path", [*PAGES, ROOT / "README.md"], ids=_names)
def test_scripts_that_are_named_exist(path):
    for script in re.findall(
        r"`(?:experiments/|python experiments/)([a-z_]+\.py)", path.read_text("utf-8")
    ):
        assert (ROOT / "experiments" / script).exists(), script


def test_parts_of_the_readme_that_the_site_shows_exist():
    readme = (ROOT / "README.md").read_text("utf-8")
    options = r'^:(?:start-after|end-before): "(.*)"$'
    marks = re.findall(options, (SITE / "errors.md").read_text("utf-8"), re.M)
    assert len(marks) == 4
    for mark in marks:
        assert readme.count(mark.replace("\\n", "\n")) == 1, mark


def test_bibliography_has_what_is_cited():
    keys = set(re.findall(r"^@\w+\{(\w+),", (SITE / "references.bib").read_text("utf-8"), re.M))
    for path in PAGES:
        for cited in re.findall(r"\{cite(?::t)?\}`([^`]+)`", path.read_text("utf-8")):
            assert set(cited.split(",")) <= keys, (path, cited)


def test_settings_fetch_nothing():
    settings = (SITE / "conf.py").read_text("utf-8")
    for word in ("intersphinx", "http://", "https://", "sphinx.ext.mathjax"):
        assert word not in settings
    assert not re.search(r"https?:|@import", (SITE / "_static" / "atmofit.css").read_text("utf-8"))
