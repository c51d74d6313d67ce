"""Where a process learns which of how many it is; what a mesh and its rows refuse."""

import jax
import numpy as np
import pytest

import atmofit as af
from atmofit.scale.hosts import _PLACES, Hosts, join_hosts


@pytest.fixture(autouse=True)
def joined(monkeypatch):
    """What JAX is asked to join; nothing of the machine's own environment."""
    for pair in _PLACES:
        for name in pair:
            monkeypatch.delenv(name, raising=False)
    calls = []
    monkeypatch.setattr(jax.distributed, "initialize", lambda *given: calls.append(given))
    return calls


def test_alone_without_a_word(joined, monkeypatch):
    assert join_hosts() == Hosts(0, 1)
    monkeypatch.setenv("SLURM_PROCID", "0")  # an interactive job of one task
    monkeypatch.setenv("SLURM_NTASKS", "1")
    assert join_hosts() == Hosts(0, 1)
    assert join_hosts("node1:1234", 1, 0) == Hosts(0, 1)
    assert joined == []


@pytest.mark.parametrize("names", _PLACES)
def test_place_from_a_batch_system(names, joined, monkeypatch):
    for name, value in zip(names, ("2", "5"), strict=True):
        monkeypatch.setenv(name, value)
    assert join_hosts("node1:1234") == Hosts(2, 5)
    assert join_hosts("node1:1234", process=3) == Hosts(3, 5)
    assert joined == [("node1:1234", 5, 2), ("node1:1234", 5, 3)]


def test_coordinator_from_a_batch_system(joined, monkeypatch):
    monkeypatch.setenv("SLURM_PROCID", "1")
    monkeypatch.setenv("SLURM_NTASKS", "2")
    monkeypatch.setattr(jax, "process_index", lambda: 1)
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    assert join_hosts() == Hosts(1, 2)
    assert joined == [()]

    def unknown():
        raise ValueError("coordinator_address should be defined.")

    monkeypatch.setattr(jax.distributed, "initialize", unknown)
    with pytest.raises(ValueError, match=r"coordinator must be given as HOST:PORT.*one of 2"):
        join_hosts()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((None, 2, 0), "coordinator must be given with processes"),
        (("node1:1234", 2, None), "processes and process must be given.*2 and None"),
        (("node1", 2, 0), "coordinator must be HOST:PORT, got 'node1'"),
        (("node1:1234", 2, 2), "process must be 0 to 1, got 2"),
        (("node1:1234", 0, 0), "processes must be at least 1, got 0"),
    ],
)
def test_what_does_not_fit_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        join_hosts(*given)


def test_devices_that_there_are_not():
    assert af.device_mesh().size == jax.local_device_count()
    with pytest.raises(ValueError, match="devices must be at least 1, got 0"):
        af.device_mesh(0)
    jax.numpy.zeros(1).block_until_ready()  # from now on their number is fixed
    count = jax.local_device_count() + 1
    with pytest.raises(ValueError, match=f"devices must be at most .* got {count}"):
        af.device_mesh(count)


def test_rows_that_do_not_belong_together():
    double = af.over_devices(lambda rows: {"twice": 2 * rows[0] + rows[1]}, group=2)
    whole = double((np.arange(5.0), np.ones(5)))
    np.testing.assert_array_equal(whole["twice"], 2 * np.arange(5.0) + 1)
    for rows in ((np.arange(5.0), np.ones(4)), (np.empty(0), np.empty(0)), (1.0, 2.0), ()):
        with pytest.raises(ValueError, match="rows must be arrays with one first axis"):
            double(rows)
    with pytest.raises(ValueError, match="group must be at least 1, got 0"):
        af.over_devices(lambda rows: rows, group=0)
