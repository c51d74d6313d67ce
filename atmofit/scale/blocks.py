"""The driver: computes the blocks of a store that are not there yet."""

import dataclasses
import time
from pathlib import Path

import jax
from jax.sharding import Mesh

from atmofit.fit.skies import Progress
from atmofit.scale.devices import device_mesh, over_devices
from atmofit.scale.hosts import Hosts
from atmofit.scale.store import BlockStore, create_store, open_for
from atmofit.scale.works import Work

_ALONE = Hosts()
_POLL = 0.5  # [s]


@dataclasses.dataclass(frozen=True)
class BlockRun:
    """What one process did.

    Attributes:
        store: Whole now, with the blocks of all processes.
        computed: Blocks that this process computed.
        found: Blocks of its share that an earlier run had finished.
        damaged: Numbers of those that were computed again, since their checksum did not match.
        seconds: From beginning to end, compilation and waiting included.
    """

    store: BlockStore
    computed: int
    found: int
    damaged: tuple[int, ...]
    seconds: float


def run_blocks(
    work: Work,
    folder: str | Path,
    *,
    rows_per_block: int | None = None,
    mesh: Mesh | None = None,
    hosts: Hosts = _ALONE,
    progress: Progress | None = None,
) -> BlockRun:
    """Fill a store with the rows of a work, block by block.

    Killed at any moment, the same call goes on where it was; so does a call with another number of
    devices or processes. A block whose checksum does not match is computed again.

    Args:
        work: What is computed.
        folder: Of the store; on several machines a folder that all see.
        rows_per_block: At least 1, best a multiple of what all devices take at a time; None: that
            of the store, if there is one, else four times what all devices take at a time.
        mesh: From `device_mesh`; None: all devices of this process.
        hosts: From `join_hosts`; every process makes the same call.
        progress: Called with a few words before each block of this process.

    Returns:
        The store and what was done.

    Raises:
        ValueError: A store that was made with other settings, or a folder that cannot be written.
        OSError: A block cannot be written.
    """
    begin = time.perf_counter()
    mesh = device_mesh() if mesh is None else mesh
    size = 4 * work.group * mesh.size if rows_per_block is None else rows_per_block
    try:
        create_store(folder, work, size, hosts.first)
    finally:  # also when it was refused: the others must not wait for what does not come
        hosts.wait(f"{work.name} is there")
    store = open_for(folder, work, rows_per_block)
    mine = [block for block in range(store.block_count) if hosts.owns(block)]
    missing = [block for block in mine if store.checksum(block) is None]
    damaged = tuple(block for block in missing if store.entry(block).exists())
    tell = progress or (lambda _: None)
    with jax.enable_x64(True):
        compute = over_devices(work.compute, mesh, work.group)
        for number, block in enumerate(missing):
            tell(f"block {number + 1} of {len(missing)}")
            store.write(block, compute(work.inputs(*store.rows(block))))
    # A barrier may have its own limit of time, far below that of a slower process.
    while hosts.processes > 1 and store.absent():
        time.sleep(_POLL)
    hosts.wait(f"{work.name} is filled")
    if hosts.first:
        store.finish()
    hosts.wait(f"{work.name} is finished")
    seconds = time.perf_counter() - begin
    whole = BlockStore.open(folder)
    return BlockRun(whole, len(missing), len(mine) - len(missing), damaged, seconds)
