"""The API reference: every public name under the subject of its module.

A page says `.. public:: atmofit.optics atmofit.spectrum`; the directive lists all names of
`atmofit.__all__` and `atmofit.clouds.__all__` that were imported from there. Of several pages the
one with the longest match has the name. Which module a name comes from is read off the import
statements, so that this works without Sphinx and without importing atmofit.
"""

import ast
import re
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = Path(__file__).parent / "reference"
PACKAGES = ("atmofit", "atmofit.clouds")
DATA = {  # what has no docstring of its own
    "ATMOFIT_2026": "The shipped `SkyModel`: shape `AUREOLE`, turbidity 1.2 to 10, the sun to 92 "
    "degrees, ground albedo to 0.8; X, Y, Z and 24 wavelengths from 360 to 820 nm.",
    "PREETHAM_1999": "The `PreethamModel` with the coefficients as published.",
    "PEREZ": "The `Shape` of Perez: five numbers.",
    "EXTENDED": "The `Shape` with the terms of Hosek and Wilkie: nine numbers.",
    "AUREOLE": "The `Shape` with light around the sun and its own horizon: thirteen numbers.",
}


def public_names(package: str) -> dict[str, str]:
    """Module of every name in a package's `__all__`."""
    tree = ast.parse((ROOT / package.replace(".", "/") / "__init__.py").read_text("utf-8"))
    modules, public = {}, []
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            modules |= {alias.asname or alias.name: node.module for alias in node.names}
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            public = ast.literal_eval(node.value)
    return {f"{package}.{name}": modules[name] for name in public}


def all_names() -> dict[str, str]:
    """Module of every public name, by its full name."""
    return {name: at for package in PACKAGES for name, at in public_names(package).items()}


def asked_modules() -> dict[str, set[str]]:
    """Modules and packages that each page of the reference asks for."""
    found = {}
    for page in sorted(PAGES.glob("*.rst")):
        asked = re.findall(r"^\.\. public:: (.+)$", page.read_text("utf-8"), re.MULTILINE)
        found[page.stem] = {word for line in asked for word in line.split()}
    return found


def names_of(modules: Iterable[str], others: Iterable[str]) -> list[str]:
    """Names that belong to `modules` and to none of `others` more closely."""

    def depth(module: str, candidates: Iterable[str]) -> int:
        inside = (c for c in candidates if module == c or module.startswith(c + "."))
        return max((len(c) for c in inside), default=0)

    modules, others = set(modules), set(others) - set(modules)
    return [
        name
        for name, module in all_names().items()
        if depth(module, modules) > depth(module, others)
    ]


def setup(app) -> dict[str, bool]:
    """Register the directive `public`."""
    import importlib
    import inspect

    from docutils import nodes
    from docutils.statemachine import StringList
    from sphinx.util.docutils import SphinxDirective

    every_module = set().union(*asked_modules().values())

    def entry(name: str) -> tuple[str, str]:
        package, _, last = name.rpartition(".")
        value = getattr(importlib.import_module(package), last)
        if not (inspect.isclass(value) or inspect.isroutine(value)):
            return "py:data", DATA.get(last, f"A {type(value).__name__}.")
        first = (inspect.getdoc(value) or "").split("\n\n")[0].replace("\n", " ")
        kind = "autoclass" if inspect.isclass(value) else "autofunction"
        return kind, first.replace("`...`", "``...``")

    class Public(SphinxDirective):
        required_arguments = 1
        final_argument_whitespace = True

        def run(self) -> list[nodes.Node]:
            names = names_of(self.arguments[0].split(), every_module)
            entries = {name: entry(name) for name in names}
            lines = [".. list-table::", "   :class: names", "   :widths: 30 70", ""]
            for name, (_, first) in entries.items():
                short = name.rpartition(".")[2]
                lines += [f"   * - :py:obj:`{short} <{name}>`", f"     - {first}"]
            lines.append("")
            for name, (kind, first) in entries.items():
                lines += [f".. {kind}:: {name}"]
                lines += ["   :members:"] if kind == "autoclass" else []
                lines += ["", f"   {first}"] if kind == "py:data" else []
                lines.append("")
            around = nodes.container()
            self.state.nested_parse(StringList(lines, "public names"), 0, around)
            return around.children

    app.add_directive("public", Public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
