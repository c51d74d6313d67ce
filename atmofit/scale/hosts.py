"""Processes on one or several machines that work on one store."""

import dataclasses
import os
from collections.abc import Mapping

import jax
from jax.experimental import multihost_utils

# Where batch systems say which process of how many this is.
_PLACES = (
    ("SLURM_PROCID", "SLURM_NTASKS"),
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("PMI_RANK", "PMI_SIZE"),
)


@dataclasses.dataclass(frozen=True)
class Hosts:
    """Which process of how many this is; the blocks of a store are dealt out in turn.

    Attributes:
        process: 0 to processes - 1; the first one makes the store and its manifest.
        processes: At least 1.
    """

    process: int = 0
    processes: int = 1

    def __post_init__(self) -> None:
        """Refuse a place that there is not."""
        if self.processes < 1:
            raise ValueError(f"processes must be at least 1, got {self.processes}")
        if not 0 <= self.process < self.processes:
            raise ValueError(f"process must be 0 to {self.processes - 1}, got {self.process}")

    @property
    def first(self) -> bool:
        """Whether this is the process that makes the store."""
        return self.process == 0

    def owns(self, block: int) -> bool:
        """Whether this process computes a block."""
        return block % self.processes == self.process

    def wait(self, name: str) -> None:
        """Wait until every process has come to the place of this name."""
        if self.processes > 1:
            multihost_utils.sync_global_devices(name)


def join_hosts(
    coordinator: str | None = None, processes: int | None = None, process: int | None = None
) -> Hosts:
    """Join the other processes of a job, before JAX computes anything.

    Args:
        coordinator: HOST:PORT of process 0, a port that is free there. None: as SLURM or
            Open MPI 4 tell JAX, if this process is one of several; else it is alone.
        processes: How many; None: as SLURM, Open MPI or MPICH say.
        process: Which of them this is; None: likewise.

    Returns:
        The place of this process.

    Raises:
        ValueError: Numbers without a coordinator, a coordinator without numbers, or impossible
            ones; a coordinator that cannot be found from the environment.
        RuntimeError: The others do not come, or JAX has computed already.
    """
    told = _told(os.environ)
    if coordinator is None and (processes is not None or process is not None):
        raise ValueError("coordinator must be given with processes and process, got None")
    if coordinator is None and (told is None or told.processes == 1):
        return Hosts()
    if coordinator is None:
        try:
            jax.distributed.initialize()
        except ValueError as error:
            raise ValueError(
                "coordinator must be given as HOST:PORT: this is one of "
                f"{told.processes if told else 0} processes, and the environment does not tell "
                f"where the first is ({error})"
            ) from error
        return Hosts(jax.process_index(), jax.process_count())
    if told is not None:
        processes = told.processes if processes is None else processes
        process = told.process if process is None else process
    if processes is None or process is None:
        raise ValueError(
            "processes and process must be given with a coordinator outside SLURM and MPI, "
            f"got {processes} and {process}"
        )
    if not coordinator.rpartition(":")[0] or not coordinator.rpartition(":")[2].isdigit():
        raise ValueError(f"coordinator must be HOST:PORT, got {coordinator!r}")
    place = Hosts(process, processes)
    if place.processes > 1:
        jax.distributed.initialize(coordinator, place.processes, place.process)
    return place


def _told(environment: Mapping[str, str]) -> Hosts | None:
    """What a batch system says in the environment; None: nothing."""
    for process, processes in _PLACES:
        if process in environment and processes in environment:
            return Hosts(int(environment[process]), int(environment[processes]))
    return None
