"""Types shared by the modules, and the converters of their fields."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

Scalar = Float[Array, ""]
Reals = Float[Array, "..."]
RealsLike = ArrayLike | Sequence[Any]  # a number, a list, a NumPy array or a JAX array


def real_array(value: Any) -> Reals:
    """A floating-point JAX array; its dtype is kept, numbers and integers become JAX's default."""
    known = isinstance(value, jax.Array | np.ndarray | np.generic)
    array = value if known else np.asarray(value)
    if jnp.issubdtype(array.dtype, jnp.floating):
        # JAX 0.10 may remember a NumPy array in double precision, and hand it out so in single.
        return jnp.asarray(array, jax.dtypes.canonicalize_dtype(array.dtype))
    return jnp.asarray(array).astype(float)


def scalar(value: Any) -> Scalar:
    """A floating-point JAX array; the field that uses this converter is checked to be 0-d."""
    return real_array(value)
