"""Whether a swarm is reachable follows from liveliness tokens, in any order of two of them."""

from __future__ import annotations

import pytest

from jostle._presence import Presence, State


def test_a_swarm_whose_daemon_stays_is_asked_for() -> None:
    swarm = Presence()
    swarm.swarm_token(False, 5.0)
    assert swarm.state is State.MISSING
    assert swarm.deadline == 6.0
    swarm.ask_later(6.0)
    assert swarm.deadline == 7.0


@pytest.mark.parametrize("is_node_first", [True, False])
def test_a_swarm_that_disappears_with_its_daemon_comes_back_with_it(is_node_first: bool) -> None:
    swarm = Presence()
    if is_node_first:
        swarm.node_token(False, 5.0)
    swarm.swarm_token(False, 5.0)
    if not is_node_first:
        swarm.node_token(False, 5.0)
    seen = [(swarm.state, swarm.deadline)]
    swarm.node_token(True, 100.0)
    seen.append((swarm.state, swarm.deadline))
    swarm.swarm_token(True, 100.5)
    seen.append((swarm.state, swarm.deadline))
    # There is no limit while it is away.
    assert seen == [(State.AWAY, None), (State.EXPECTED, 103.0), (State.PRESENT, None)]


def test_a_daemon_that_is_back_at_once_was_away() -> None:
    swarm = Presence()
    swarm.swarm_token(False, 5.0)
    swarm.node_token(False, 5.0)
    swarm.node_token(True, 5.0)
    assert swarm.state is State.EXPECTED, "its swarms are not deleted, they are about to appear"


def test_a_daemon_may_disappear_again_before_its_swarm_is_back() -> None:
    swarm = Presence()
    swarm.swarm_token(False, 5.0)
    swarm.node_token(False, 5.0)
    swarm.node_token(True, 6.0)
    swarm.node_token(False, 7.0)
    assert swarm.state is State.AWAY
    assert swarm.deadline is None


def test_a_token_that_was_there_already_is_no_news() -> None:
    swarm = Presence()
    swarm.swarm_token(True, 5.0)
    swarm.node_token(True, 5.0)
    assert swarm.state is State.PRESENT
    assert swarm.deadline is None
