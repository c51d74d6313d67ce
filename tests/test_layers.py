"""The folders follow the light: a module imports only from stages before its own."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "atmofit"
# What serves all, then the way of the light, then those who use it.
ORDER = (
    *("typing", "constants", "checks", "extremes", "files", "provenance", "numerics", "tables"),
    *("geometry", "spectrum", "sun", "sun_position", "optics", "colour", "sky", "models", "media"),
    *("observe", "landscape", "clouds", "fit", "export", "render", "report", "io", "scale"),
    *("stability", "fuzz", "notebook"),
    *("cli_scale", "cli_sky", "cli_stability", "cli_turbidity", "cli", "__main__"),
)


def imported(module):
    """Stages that a module's text imports from, also inside functions."""
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("atmofit"):
            parts = (node.module or "").split(".")[1:]
            yield from [parts[0]] if parts else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("atmofit."))


def test_every_module_imports_from_earlier_stages_only():
    found, wrong = 0, []
    for module in PACKAGE.rglob("*.py"):
        own = module.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        for stage in set(imported(module)) - {own}:
            found += 1
            if ORDER.index(stage) > ORDER.index(own):
                wrong.append(f"{module.relative_to(PACKAGE)} imports {stage}")
    assert found > 300
    assert not wrong


def test_every_stage_has_its_place():
    there = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert there - {"__init__", "__pycache__", "py"} <= set(ORDER)
