"""Exported source code says what the model says."""

import ctypes
import json
import re
import subprocess
from typing import Any

import numpy as np
import pytest

import atmofit as af
from atmofit.export.expressions import expressions
from atmofit.export.languages import source_code
from atmofit.io import read_sky_model, write_source
from atmofit.models.cie import CIEShape
from atmofit.models.dependence import Basis, Dependence
from atmofit.models.sky_model import SkyModel

MODEL = af.ATMOFIT_2026.only("colours")
DOME = af.dome_343()
VIEW, AZIMUTH = (np.ascontiguousarray(x, float) for x in DOME.angles())
PLACES = [(1.3, 0.2, 0.0), (3.0, 1.1, 0.3), (10.0, np.radians(92.0), 0.8)]
RTOL = 1e-5  # of the issue; double precision and nine digits give 1e-8

# What makes a C compiler read shader code, in single precision.
SHIM = """#include <tgmath.h>
#undef min
#undef max
#define in
#define out
#define min(a, b) fmin((float)(a), (float)(b))
#define max(a, b) fmax((float)(a), (float)(b))
"""
LOOP = """
void every(double T, double s, double a, int n, const double *view, const double *azimuth,
           double *values)
{
    %(real)s numbers[%(numbers)d], value[3];
    atmofit_2026_numbers(T, s, a, numbers);
    for (int i = 0; i < n; ++i) {
        atmofit_2026_direction(numbers, s, view[i], azimuth[i], value);
        for (int k = 0; k < 3; ++k) values[3 * i + k] = value[k];
    }
}
"""


def _expected(turbidity, sun, albedo, model=MODEL):
    return np.asarray(model.XYZ(turbidity, sun, DOME, albedo))


def _compiled(folder, text, real):
    """A function of turbidity, sun and albedo that gives X, Y, Z over the dome."""
    numbers = 3 * len(MODEL.shape.names)
    source, library = folder / "sky.c", folder / "sky.so"
    source.write_text(text + LOOP % {"real": real, "numbers": numbers})
    command = ["cc", "-std=c11", "-O1", "-Wall", "-Wno-unknown-pragmas", "-shared", "-fPIC"]
    command += [str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    call, pointer = ctypes.CDLL(str(library)).every, ctypes.POINTER(ctypes.c_double)

    def sky(*place):
        values = np.zeros((VIEW.size, 3))
        arrays = (x.ctypes.data_as(pointer) for x in (VIEW, AZIMUTH, values))
        call(*map(ctypes.c_double, place), VIEW.size, *arrays)
        return values

    return sky


@pytest.fixture(scope="module", autouse=True)
def compiler():
    if subprocess.run(["cc", "--version"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no C compiler")


@pytest.mark.parametrize("language", ["c", "glsl", "hlsl"])
def test_compiled_code_agrees(tmp_path, language):
    """C as it is; shaders read as C in single precision, whose rounding is 6e-8 a step."""
    text = source_code(MODEL, language)
    if language != "c":
        text = re.sub(r"= float\[(\d+)\]\((.*?)\n\);", r"= {\2};", text, flags=re.DOTALL)
        text = SHIM + text.replace("atan(", "atan2(") if language == "glsl" else SHIM + text
    sky = _compiled(tmp_path, text, "double" if language == "c" else "float")
    for place in PLACES:
        expected = _expected(*place)
        np.testing.assert_allclose(sky(*place), expected, RTOL if language == "c" else 1e-4)


def test_python_agrees_and_refuses():
    names: dict[str, Any] = {}
    exec(source_code(MODEL, "python"), names)
    for place in PLACES:
        expected = _expected(*place)
        for k in (0, 30, 200, 342):
            found = names["atmofit_2026"](*place, VIEW[k], AZIMUTH[k])
            np.testing.assert_allclose(found, expected[k], RTOL)
    with pytest.raises(ValueError, match="turbidity must be between"):
        names["atmofit_2026"](30.0, 1.0, 0.2, 0.0, 0.0)


def test_json_agrees(tmp_path):
    """Read again, and evaluated by what the file itself says."""
    path = write_source(MODEL, "json", tmp_path / "deep" / "model.json", "unused")
    again, stored = read_sky_model(path), json.loads(path.read_text())
    for place in PLACES:
        expected = _expected(*place)
        np.testing.assert_allclose(_expected(*place, model=again), expected, RTOL)
    assert stored["channels"]["colours"] == ["X", "Y", "Z"]
    assert np.shape(stored["coefficients"]) == MODEL.coefficients.shape
    assert stored["shape"]["numbers"] == list(MODEL.shape.names)


def test_splines_and_other_shapes_are_exported(tmp_path):
    """Parts that the shipped model does not have."""
    dependence = Dependence(Basis("spline", 5), Basis("spline", 6), Basis("polynomial", 1))
    numbers = np.random.default_rng(1).normal(size=(3, 1, dependence.size))
    model = SkyModel(numbers, CIEShape(12), dependence)
    names: dict[str, Any] = {}
    exec(source_code(model, "python"), names)
    expected = np.asarray(model.XYZ(2.2, 1.3, DOME, 0.1))
    found = [names["atmofit_2026"](2.2, 1.3, 0.1, VIEW[k], AZIMUTH[k]) for k in (0, 40, 300)]
    np.testing.assert_allclose(found, expected[[0, 40, 300]], RTOL)


def test_what_has_no_symbol_is_named():
    import jax.numpy as jnp

    with pytest.raises(NotImplementedError, match="no symbol for what JAX calls"):
        expressions(lambda x: jnp.sort(jnp.stack([x, -x])), ("x",))


def test_bad_names_are_refused():
    with pytest.raises(ValueError, match="name must be an identifier, got '2 skies'"):
        source_code(MODEL, "c", "2 skies")
    with pytest.raises(ValueError, match="language must be one of"):
        source_code(MODEL, "fortran")
