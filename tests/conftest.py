"""JAX as the tests want it: double precision, no silent promotion, compiled programs kept.

And the order of the files, for two processes.
"""

import gc
import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    jax.config.update("jax_compilation_cache_dir", str(cache / "atmofit" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
gc.set_threshold(100_000, 50, 100)  # traced programs are kept, so there is little to collect


def pytest_configure(config):
    config.option.loadscopereorder = False  # else files with few tests come last, be they long


@pytest.hookimpl(tryfirst=True)  # before the slow ones are left out
def pytest_collection_modifyitems(items):
    """Files with slow tests first, so that no process is left alone with one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
