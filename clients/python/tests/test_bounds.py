"""How long a call takes: the bounds of docs/controllers.md."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

import jostle
from conftest import Daemon

Call = Callable[[jostle.Swarm, jostle.Controller], object]
# Each with a timeout of 0.2 s. The swarm waits for a second controller, which does not advance.
SHORT_CALLS: dict[str, Call] = {
    "advance": lambda _, controller: controller.advance(direction=0.0, timeout=0.2),
    "wait": lambda swarm, _: swarm.wait("order > 0.99 for 1000", timeout=0.2),
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
        began = time.monotonic()
        with pytest.raises(jostle.DeadlineExceeded):
            SHORT_CALLS[name](swarm, ada)
        # Less than it waits for a reply that is missing.
        assert 0.2 <= time.monotonic() - began < 0.2 + 2.0


@pytest.mark.parametrize("name", SHORT_CALLS)
def test_a_call_without_a_reply_ends_at_the_bound_of_the_page(
    own_daemon: Daemon, name: str
) -> None:
    """The bound is that of docs/controllers.md: 2 s, and the timeout of the client."""
    with a_swarm_that_waits(own_daemon, timeout=1.0) as (swarm, ada):
        own_daemon.freeze()
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable):
            SHORT_CALLS[name](swarm, ada)
        took = time.monotonic() - began
        own_daemon.thaw()
        # And a second for a busy machine.
        assert 0.2 <= took < 0.2 + 2.0 + 1.0 + 1.0
