"""A sky model as self-contained source code: C, GLSL, HLSL or Python.

All come from the same expressions, which are read off the model's own program.
"""

from atmofit.checks import choice
from atmofit.export.c_like import TOKENS, c_like_code
from atmofit.export.formulas import Parts
from atmofit.export.python_code import python_code
from atmofit.models.sky_model import SkyModel

LANGUAGES = ("c", "glsl", "hlsl", "python")


def source_code(model: SkyModel, language: str, name: str = "atmofit_2026") -> str:
    """The model as source code that needs nothing else.

    The code holds the coefficients, a function that makes a sky's numbers from turbidity, sun and
    albedo (once per sky), and one that makes the channels of a direction from them.

    Args:
        model: With colours, spectral channels, or both; those it has are exported, in its order.
        language: "c" (C99, double precision), "glsl" (3.30 or newer), "hlsl" or "python".
        name: Of the main function, and before all other names.

    Returns:
        The text of a file.

    Raises:
        ValueError: An unknown language, or a name that is no identifier.
    """
    choice("language", language, LANGUAGES)
    if not name.isidentifier():
        raise ValueError(f"name must be an identifier, got {name!r}")
    parts = Parts.of(model)
    if language == "python":
        return python_code(model, parts, name)
    return c_like_code(model, parts, name, TOKENS[language])
