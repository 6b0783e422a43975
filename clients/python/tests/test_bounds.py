"""How long a call takes: the bounds of docs/controllers.md."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

import jostle
from conftest import Daemon

Call = Callable[[jostle.Swarm, jostle.Controller], object]
# The calls and their timeouts. The swarm waits for a second controller, which does not advance.
SHORT_CALLS: dict[str, tuple[float, Call]] = {
    "advance": (0.2, lambda _, controller: controller.advance(direction=0.0, timeout=0.2)),
    "longer advance": (2.5, lambda _, controller: controller.advance(direction=0.0, timeout=2.5)),
    "wait": (0.2, lambda swarm, _: swarm.wait("order > 0.99 for 1000", timeout=0.2)),
}


# Without a timeout they may take an hour, but not without a daemon.
LONG_CALLS: dict[str, Call] = {
    "advance": lambda _, controller: controller.advance(direction=0.0),
    "cancel": lambda _, controller: controller.cancel(),
    "fork": lambda swarm, _: swarm.fork("copy", step=0),
    "join": lambda swarm, _: swarm.join("eve", jostle.ids([0])),
    "step": lambda swarm, _: swarm.step(1000),
    "sync": lambda _, controller: controller.sync(),
    "verify": lambda swarm, _: swarm.verify(),
}


@contextmanager
def a_swarm_that_waits(
    daemon: Daemon, timeout: float
) -> Iterator[tuple[jostle.Swarm, jostle.Controller]]:
    """A swarm whose second controller does not advance, and its first one."""
    with jostle.connect(daemon.endpoint, timeout=timeout) as client:
        swarm = client.create("held", jostle.Spec(n=2))
        with swarm.join("idle", jostle.ids([1])), swarm.join("ada", jostle.ids([0])) as ada:
            ada.sync()
            yield swarm, ada


@pytest.mark.parametrize("name", SHORT_CALLS)
def test_a_call_ends_at_its_timeout(own_daemon: Daemon, name: str) -> None:
    with a_swarm_that_waits(own_daemon, timeout=30.0) as (swarm, ada):
        timeout, call = SHORT_CALLS[name]
        began = time.monotonic()
        with pytest.raises(jostle.DeadlineExceeded):
            call(swarm, ada)
        # Less than it waits for a reply that is missing.
        assert timeout <= time.monotonic() - began < timeout + 2.0


@pytest.mark.parametrize("name", SHORT_CALLS)
def test_a_call_without_a_reply_ends_at_the_bound_of_the_page(
    own_daemon: Daemon, name: str
) -> None:
    """The bound is that of docs/controllers.md: 2 s, and the timeout of the client."""
    with a_swarm_that_waits(own_daemon, timeout=1.0) as (swarm, ada):
        timeout, call = SHORT_CALLS[name]
        own_daemon.freeze()
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable):
            call(swarm, ada)
        took = time.monotonic() - began
        own_daemon.thaw()
        # And a second for a busy machine.
        assert timeout <= took < timeout + 2.0 + 1.0 + 1.0


@pytest.mark.parametrize(
    ("name", "killed_after"), [("advance", 0.5), *((name, 0.0) for name in LONG_CALLS)]
)
def test_a_call_to_a_daemon_that_is_gone_ends_at_the_timeout_of_the_client(
    own_daemon: Daemon, name: str, killed_after: float
) -> None:
    with jostle.connect(own_daemon.endpoint, timeout=2.0) as client:
        swarm = client.create("held", jostle.Spec(n=2))
        idle = swarm.join("idle", jostle.ids([1]))
        ada = swarm.join("ada", jostle.ids([0]))
        ada.sync()
        kill = threading.Timer(killed_after, own_daemon.kill)
        kill.start()
        if killed_after == 0.0:
            kill.join()
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable):
            LONG_CALLS[name](swarm, ada)
        took = time.monotonic() - began - killed_after
        kill.join()
        # And the rest for a busy machine; three times the timeout would be 6 s.
        assert took < 2.0 + 2.0
        # It held the swarm until then.
        assert idle.step == 0
