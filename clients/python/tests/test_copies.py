"""Copies of swarms, and `verify`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import Daemon, eventually

Create = Callable[..., jostle.Swarm]


@pytest.fixture
def copies(client: jostle.Client) -> Iterator[list[str]]:
    """Names of copies, which are deleted after the test."""
    names = ["copy-1", "copy-2"]
    yield names
    for name in {swarm.swarm for swarm in client.swarms()} & set(names):
        client.swarm(name).delete()


def test_a_fork_has_the_same_future_until_it_gets_other_commands(
    create: Create, copies: list[str]
) -> None:
    swarm = create(n=30, seed=4, start={"kind": "disc", "radius": 5})
    swarm.step(20)
    swarm.inform(jostle.count(3), direction=0.0)
    swarm.step(20)
    fork = swarm.fork(copies[0])
    status = fork.status()
    assert (status.reason, status.step, status.epoch) == ("forked", 40, 1)
    assert swarm.step(20).state_hash == fork.step(20).state_hash
    earlier = swarm.fork(copies[1], 20)
    assert earlier.status().informed == 0
    earlier.inform(jostle.count(3), direction=0.0)
    assert earlier.step(40).state_hash == swarm.status().state_hash
    fork.inform(jostle.ids([0]), direction=1.0)
    assert swarm.step(20).state_hash != fork.step(20).state_hash
    with pytest.raises(jostle.AlreadyExists):
        swarm.fork(copies[0])
    with pytest.raises(jostle.Conflict):
        swarm.fork("copy-3", step=81)


def test_a_snapshot_is_restored_from_its_object_its_bytes_and_its_file(
    client: jostle.Client, create: Create, copies: list[str], tmp_path: Path
) -> None:
    swarm = create(n=30, seed=4, start={"kind": "disc", "radius": 5})
    swarm.step(20)
    snapshot = swarm.snapshot()
    assert (snapshot.step, snapshot.n, snapshot.swarm) == (20, 30, swarm.name)
    assert snapshot.state_hash == swarm.status().state_hash
    assert repr(snapshot).startswith(f"Snapshot(swarm='{swarm.name}'")
    path = snapshot.save(tmp_path / "school.snapshot")
    assert jostle.Snapshot.load(path) == snapshot
    with pytest.raises(FileExistsError):
        snapshot.save(path)
    snapshot.save(path, force=True)
    assert list(tmp_path.iterdir()) == [path]
    there = swarm.step(20).state_hash
    for given in (snapshot, snapshot.data, path, str(path)):
        restored = client.restore(given, copies[0])
        assert restored.status().reason == "restored"
        assert restored.step(20).state_hash == there
        restored.delete()
    with pytest.raises(jostle.InvalidArgument):
        client.restore(snapshot.data[:-1], copies[0])
    path.write_bytes(snapshot.data[:-1])
    with pytest.raises(jostle.InvalidArgument):
        client.restore(path, copies[0])


@pytest.mark.parametrize(
    "rubbish",
    [
        b"",
        b"rubbish",
        b"\x00\xff rubbish" * 99,
        b"\xa1\x61\x61\x01",
        # Lengths beyond the end of the data, and endlessly nested lists.
        b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff",
        b"\x5b\x7f\xff\xff\xff\xff\xff\xff\xff",
        b"\x81" * 100_000,
        7,
        None,
    ],
    ids=lambda rubbish: repr(rubbish)[:20],
)
def test_other_data_is_not_a_snapshot(client: jostle.Client, tmp_path: Path, rubbish: Any) -> None:
    with pytest.raises(jostle.InvalidArgument, match="not a snapshot") as raised:
        client.restore(rubbish, "rubbish")
    assert "daemon" not in str(raised.value)
    assert raised.value.details["field"] == "snapshot"
    with pytest.raises(jostle.InvalidArgument, match="not a snapshot"):
        jostle.Snapshot.from_bytes(rubbish)
    if isinstance(rubbish, bytes):
        path = tmp_path / "rubbish.snapshot"
        path.write_bytes(rubbish)
        with pytest.raises(jostle.InvalidArgument, match="not a snapshot"):
            client.restore(path, "rubbish")
    assert "rubbish" not in [summary.swarm for summary in client.swarms()]


def test_a_history_is_verified(create: Create) -> None:
    swarm = create(n=5)
    swarm.step(20_000)
    verified = swarm.verify()
    assert verified.differs_at is None
    assert (verified.from_step, verified.step) == (0, 20_000)
    assert verified.hashes > 1
    assert swarm.status().history_from == jostle.HistoryFrom(epoch=1, step=0)


def test_a_verification_ends_at_its_timeout_also_in_the_daemon(create: Create) -> None:
    swarm = create(n=50)
    swarm.step(40_000, timeout=60.0)
    with pytest.raises(jostle.DeadlineExceeded, match=r"not done within 0\.2 s"):
        swarm.verify(timeout=0.2)
    eventually("the replay ends", lambda: swarm.status().verifying is None)


def test_a_step_becomes_durable(create: Create) -> None:
    swarm = create(n=5)
    result = swarm.step(10)
    assert 0 <= result.durable_step <= result.step
    # A command and all before it are durable when its reply arrives.
    swarm.set(pi3=1.5)
    eventually("the step before it is durable", lambda: swarm.step().durable_step >= 10)


def test_a_swarm_is_recovered_after_its_daemon_was_killed(tmp_path: Path) -> None:
    first = Daemon(tmp_path)
    with jostle.connect(first.endpoint) as client:
        swarm = client.create("school", jostle.Spec(n=10, seed=2))
        swarm.step(30)
        swarm.inform(jostle.count(2), direction=0.0)
        before = swarm.status()
        first.kill()
    second = Daemon(tmp_path)
    with jostle.connect(second.endpoint) as client:
        after = client.swarm("school").status()
    assert second.stop() == 0
    assert after.epoch > before.epoch
    assert (after.step, after.seq) == (before.step, before.seq)
    assert after.state_hash == before.state_hash
