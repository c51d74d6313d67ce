"""What numbers depend on besides the settings: packages, source files, machine."""

import functools
import hashlib
import os
import platform
from importlib import metadata
from pathlib import Path

import jax

_PACKAGES = ("atmofit", "jax", "equinox", "optimistix", "numpy")
_SOURCES = {".py", ".csv"}  # tables are read as CSV


def versions() -> dict[str, str]:
    """Versions of the packages on which numbers depend."""
    return {name: metadata.version(name) for name in _PACKAGES}


@functools.cache
def source_digest() -> str:
    """SHA-256 of the package's own files, so that work of edited code is told from older work."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.suffix in _SOURCES):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()


def machine() -> dict[str, str]:
    """What decides the last digits: where JAX computes, and how it was told to."""
    device = jax.devices()[0]
    return {
        "processor": platform.machine(),
        "device": f"{device.platform} {device.device_kind}",
        "jaxlib": metadata.version("jaxlib"),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
        "matmul_precision": str(jax.config.values["jax_default_matmul_precision"]),
    }
