"""One program over all devices of a process, a group of rows on each.

The compiled program always sees one group of rows on a device, whatever the number of devices and
of rows: what a row gives does not depend on where it was computed.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

AXIS = "device"
_SPREAD = PartitionSpec(AXIS)


def device_mesh(count: int | None = None) -> Mesh:
    """A mesh of one axis over devices of this process.

    On the CPU, where devices are shares of the processor, `count` may be any number as long as JAX
    has not computed yet in this process.

    Args:
        count: Devices; None: all that there are.

    Returns:
        The mesh.

    Raises:
        ValueError: Fewer devices than asked for.
    """
    if count is not None:
        if count < 1:
            raise ValueError(f"devices must be at least 1, got {count}")
        count_cpu_devices(count)
    found = jax.local_devices()
    wanted = len(found) if count is None else count
    if wanted > len(found):
        raise ValueError(f"devices must be at most the {len(found)} that JAX has, got {wanted}")
    return jax.make_mesh((wanted,), (AXIS,), axis_types=(AxisType.Auto,), devices=found[:wanted])


def count_cpu_devices(count: int) -> None:
    """Let the CPU be so many devices, unless JAX has computed already and their number is fixed."""
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", count)


def over_devices(
    function: Callable[[Any], Any], mesh: Mesh | None = None, group: int = 1
) -> Callable[[Any], Any]:
    """Spread a function of rows over devices.

    Args:
        function: From a tree of arrays with a first axis of `group` rows to another such tree;
            each row's result depends on that row alone. Works under jit.
        mesh: From `device_mesh`; None: over all devices of this process.
        group: Rows that a device takes at a time. Static.

    Returns:
        A function from trees with any number of rows, at least one, to trees of NumPy arrays with
        as many. Rows that fill up the last round are copies of the last one, and are dropped.

    Raises:
        ValueError: A group below 1; when called, no rows, or arrays that differ in their number.
    """
    if group < 1:
        raise ValueError(f"group must be at least 1, got {group}")
    mesh = device_mesh() if mesh is None else mesh
    sharding = NamedSharding(mesh, _SPREAD)
    programs: dict[Any, Callable[[Any], Any]] = {}

    def compiled(part: Any) -> Callable[[Any], Any]:
        """The program for a group of such arrays, made once."""
        one = jax.tree.map(lambda x: jax.ShapeDtypeStruct((group, *x.shape[1:]), x.dtype), part)
        kind = (jax.tree.structure(one), *jax.tree.leaves(one))
        if kind not in programs:
            # The rows do not meet, so there is nothing to check about what devices share.
            spread = jax.shard_map(
                _traced(function, one),
                mesh=mesh,
                in_specs=_SPREAD,
                out_specs=_SPREAD,
                check_vma=False,
            )
            programs[kind] = jax.jit(spread)
        return programs[kind]

    at_once = mesh.size * group

    def call(rows: Any) -> Any:
        count = _row_count(rows)
        done = []
        for first in range(0, count, at_once):
            chosen = np.minimum(np.arange(first, first + at_once), count - 1)
            part = jax.tree.map(lambda leaf, rows=chosen: np.asarray(leaf)[rows], rows)
            done.append(compiled(part)(jax.device_put(part, sharding)))  # does not wait
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *jax.device_get(done))

    return call


def _traced(function: Callable[[Any], Any], like: Any) -> Callable[[Any], Any]:
    """A function that is traced now, as for one device.

    Some solvers (lineax 0.1) refuse arrays that know of a mesh, as those inside a shard_map do.
    """
    traced, shapes = jax.make_jaxpr(jax.jit(function), return_shape=True)(like)
    structure = jax.tree.structure(shapes)

    def call(rows: Any) -> Any:
        return jax.tree.unflatten(structure, jaxpr_as_fun(traced)(*jax.tree.leaves(rows)))

    return call


def _row_count(rows: Any) -> int:
    """Length of the first axis of every array."""
    counts = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(rows)}
    if len(counts) != 1 or counts <= {(), (0,)}:
        raise ValueError(
            f"rows must be arrays with one first axis of at least 1, got lengths {sorted(counts)}"
        )
    return counts.pop()[0]
