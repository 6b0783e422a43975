"""A daemon that is not there yet, or that recovers its swarms after a start."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually, find_free_endpoint
from jostle import aio

SWARMS = [f"s{number}" for number in range(8)]
# Four swarms are recovered, then nothing for some time, then the others.
SLOW = "recover-swarm=4*sleep(50)->1*sleep(2000)->off"


class Place:
    """A data folder and an endpoint, at which a daemon is started and killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoint = find_free_endpoint()
        self.daemon: Daemon | None = None

    def start(self, failing: str | None = None) -> None:
        """Starts a daemon, and returns when it has recovered its swarms."""
        self.daemon = Daemon(self.folder, listen=self.endpoint, failing=failing)

    def kill(self) -> None:
        """Kills the daemon."""
        if self.daemon is not None:
            self.daemon.kill()
            self.daemon = None

    def start_soon(self) -> threading.Thread:
        """Starts a daemon after a moment in which there is none; it recovers slowly."""

        def start() -> None:
            time.sleep(0.5)
            self.start(SLOW)

        thread = threading.Thread(target=start)
        thread.start()
        return thread


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    """A place with swarms, whose daemon was killed."""
    place = Place(tmp_path)
    place.start()
    with jostle.connect(place.endpoint) as client:
        for swarm in SWARMS:
            client.create(swarm, jostle.Spec(n=3))
    place.kill()
    yield place
    place.kill()


def _names(endpoint: str) -> list[str]:
    with jostle.connect(endpoint, timeout=MAX_WAIT_SECS) as client:
        return [swarm.swarm for swarm in client.swarms()]


def _names_async(endpoint: str) -> list[str]:
    async def names() -> list[str]:
        async with aio.connect(endpoint, timeout=MAX_WAIT_SECS) as client:
            return [swarm.swarm for swarm in await client.swarms()]

    return asyncio.run(names())


@pytest.mark.parametrize("names", [_names, _names_async])
def test_connect_waits_for_the_daemon_and_its_swarms(
    place: Place, names: Callable[[str], list[str]], caplog: pytest.LogCaptureFixture
) -> None:
    starting = place.start_soon()
    try:
        with caplog.at_level(logging.WARNING, "jostle"):
            assert names(place.endpoint) == SWARMS
    finally:
        starting.join()
    said = caplog.messages
    assert said[0] == (
        f"the daemon at {place.endpoint} is not reachable: connect(timeout={MAX_WAIT_SECS:g}) "
        "waits for it"
    )


def test_connect_says_how_long_it_waited_for_a_daemon_that_is_not_there() -> None:
    endpoint = find_free_endpoint()
    began = time.monotonic()
    with pytest.raises(jostle.Unavailable, match=r"tried for 0\.5 s: start one with"):
        jostle.connect(endpoint, timeout=0.5)
    assert time.monotonic() - began < MAX_WAIT_SECS


def test_a_short_timeout_ends_with_the_reason(place: Place) -> None:
    starting = place.start_soon()
    try:
        found: Any = None
        deadline = time.monotonic() + MAX_WAIT_SECS
        while found is None and time.monotonic() < deadline:
            try:
                jostle.connect(place.endpoint, timeout=0.2).close()
            except jostle.Unavailable:
                continue
            except jostle.Busy as error:
                found = error.details
        assert found["reason"] == "recovering"
        assert 1 <= found["swarms_left"] <= 8
    finally:
        starting.join()


def test_requests_wait_for_the_swarms_and_a_retry_gets_the_first_reply(place: Place) -> None:
    place.start()
    client = jostle.connect(place.endpoint, timeout=MAX_WAIT_SECS)
    with client:
        swarm = client.swarm("s7")
        first = swarm.step(3, request_id="once")
        swarm.pause()
        place.kill()
        # What a daemon received before it was killed is not sent to another run of it.
        eventually("the client notices", lambda: not client._session.connected())
        starting = place.start_soon()
        try:
            again = swarm.step(3, request_id="once")
            assert (again.step, again.seq, again.steps) == (first.step, first.seq, 3)
            # Requests of other kinds, too.
            assert client.swarm("s6").status().step == 0
            assert len(client.swarms()) == len(SWARMS)
            assert swarm.status().step == 3
            assert [entry.verb for entry in swarm.journal()].count("step") == 1
        finally:
            starting.join()
