"""Two daemons behind one router: a swarm's name is served by one of them, or by none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

import jostle
from conftest import (
    MAX_WAIT_SECS,
    Daemon,
    Router,
    Wire,
    eventually,
    find_free_endpoint,
    zenoh_session,
)


class Fleet:
    """The daemons `a`, behind a `Wire`, and `b`, and a router that connects to both."""

    def __init__(self, folder: Path) -> None:
        self.folders = {node: folder / node for node in ("a", "b")}
        for each in self.folders.values():
            each.mkdir()
        self.endpoints = {node: find_free_endpoint() for node in self.folders}
        self.daemons: dict[str, Daemon] = {}
        self.wire = Wire(self.endpoints["a"])
        # The second daemon had a swarm of the same name before.
        self.start("b")
        with jostle.connect(self.endpoints["b"]) as client:
            client.create("school", jostle.Spec(n=4, seed=1, rate=None))
        self.daemons["b"].stop()
        self.start("a")
        self.router = Router(self.wire.endpoint, self.endpoints["b"])

    def start(self, node: str) -> Daemon:
        """Starts a daemon on the data of its last run."""
        self.daemons[node] = Daemon(self.folders[node], self.endpoints[node], node=node)
        return self.daemons[node]

    def connect(self, node: str) -> jostle.Client:
        """A client of one daemon, by the router."""
        deadline = time.monotonic() + MAX_WAIT_SECS
        while True:
            try:
                return jostle.connect(self.router.endpoint, node=node, timeout=10.0)
            except jostle.JostleError:
                assert time.monotonic() < deadline
                time.sleep(0.05)

    def close(self) -> None:
        """Ends the router and the daemons that still run."""
        self.router.close()
        self.wire.close()
        for daemon in self.daemons.values():
            if daemon.process.poll() is None:
                daemon.kill()


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


def is_contested(client: jostle.Client) -> bool:
    try:
        return client.metrics().contested > 0
    except jostle.JostleError:
        return False


def executed(endpoint: str, ids: list[str]) -> list[int]:
    """How often each request is in the journal of the swarm."""
    with jostle.connect(endpoint) as client:
        journal = client.swarm("school").journal()
        seen = [entry.request_id for entry in journal]
    return [seen.count(each) for each in ids]


def test_no_command_is_executed_twice_while_a_second_daemon_comes_and_goes(fleet: Fleet) -> None:
    client = fleet.connect("a")
    school = client.create("school", jostle.Spec(n=4, seed=1, rate=None))
    is_over = threading.Event()
    ends: list[Callable[[Daemon], object]] = []

    def come_and_go() -> None:
        try:
            for end in (Daemon.stop, Daemon.kill, Daemon.stop):
                daemon = fleet.start("b")
                with fleet.connect("b") as second:
                    eventually("it is contested", partial(is_contested, second))
                end(daemon)
                ends.append(end)
        finally:
            is_over.set()

    ids: list[str] = []
    coming = threading.Thread(target=come_and_go)
    coming.start()
    while len(ids) < 200 or not is_over.is_set():
        ids.append(f"r{len(ids)}")
        school.set(pi3=1.0 + 1e-3 * len(ids), request_id=ids[-1])
        time.sleep(0.01)
    coming.join()
    assert len(ends) == 3
    assert executed(fleet.endpoints["a"], ids) == [1] * len(ids)
    client.close()
    fleet.daemons["a"].stop()
    fleet.start("b")
    assert executed(fleet.endpoints["b"], ids) == [0] * len(ids)


def test_contested_names_both_daemons_and_discard_ends_it(fleet: Fleet) -> None:
    first = fleet.connect("a")
    school = first.create("school", jostle.Spec(n=4, seed=1, rate=None))
    fleet.start("b")
    second = fleet.connect("b")
    eventually("it is contested", lambda: is_contested(second))
    assert [it.contested_by for it in second.swarms()] == ["a"]
    # The second daemon, queried directly, names the daemon that serves the swarm.
    with jostle.connect(fleet.endpoints["b"]) as direct:
        with pytest.raises(jostle.Contested) as waiting:
            direct.swarm("school").status()
        assert waiting.value.details["nodes"] == ["b", "a"]
        with pytest.raises(jostle.AlreadyExists):
            direct.restore(school.snapshot(), "school")

    fleet.wire.unplug()

    def is_served_there() -> bool:
        try:
            return second.swarm("school").set(pi3=2.0).seq > 0
        except jostle.JostleError:
            return False

    eventually("the second serves", is_served_there)
    fleet.wire.plug()
    eventually("both noticed", lambda: is_contested(second) and is_contested(first))
    # A client that connects now checks the claims first; the daemons reply with the same error.
    with fleet.connect("a") as late:
        for call in (late.swarm("school").status, late.swarm("school").pause):
            with pytest.raises(jostle.Contested) as caught:
                call()
            assert sorted(caught.value.details["nodes"]) == ["a", "b"]
    with pytest.raises(jostle.Contested):
        school.pause()
    second.discard("school")
    with pytest.raises(jostle.NotFound):
        second.discard("school")

    def is_served_again() -> bool:
        try:
            return school.pause().seq > 0
        except jostle.Contested:
            return False

    eventually("the first serves again", is_served_again)
    first.close()
    second.close()


def test_two_daemons_settle_their_claims_within_a_moment(own_daemon: Daemon) -> None:
    with jostle.connect(own_daemon.endpoint) as client:
        client.create("school", jostle.Spec(n=4, seed=1, rate=None))
    # The claim of another daemon that has not yet read this one's.
    with zenoh_session(own_daemon.endpoint) as other:
        token = other.liveliness().declare_token("jostle/school/claim/b/1-2/serving")
        with jostle.connect(own_daemon.endpoint) as client:
            with pytest.raises(jostle.Contested):
                client.swarm("school").set(pi3=2.0)
            yielding = threading.Timer(0.3, token.undeclare)
            began = time.monotonic()
            yielding.start()
            client.swarm("school").set(pi3=2.0)
            assert time.monotonic() - began >= 0.3
            yielding.join()
