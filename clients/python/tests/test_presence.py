"""Whether a swarm is reachable follows from liveliness tokens, in any order of two of them."""

from __future__ import annotations

import pytest

from jostle._presence import Change, Presence


def test_a_swarm_whose_daemon_stays_was_deleted() -> None:
    swarm = Presence()
    assert not swarm.swarm_token(False, 5.0)
    assert swarm.deadline == 6.0
    assert swarm.judge(True) is Change.DELETED


@pytest.mark.parametrize("is_node_first", [True, False])
def test_a_swarm_that_disappears_with_its_daemon_comes_back_with_it(is_node_first: bool) -> None:
    swarm = Presence()
    if is_node_first:
        swarm.node_token(False, 5.0)
    assert not swarm.swarm_token(False, 5.0)
    if not is_node_first:
        swarm.node_token(False, 5.0)
    assert swarm.deadline == 5.0, "no other token can change the verdict"
    assert swarm.judge(False) is Change.AWAY
    assert swarm.is_away
    assert swarm.deadline is None, "there is no limit while it is away"
    swarm.node_token(True, 100.0)
    assert swarm.deadline == 103.0
    assert swarm.swarm_token(True, 100.5)
    assert swarm.is_present
    assert swarm.deadline is None


def test_a_daemon_may_come_back_without_the_swarm() -> None:
    swarm = Presence()
    swarm.swarm_token(False, 5.0)
    swarm.judge(False)
    swarm.node_token(True, 6.0)
    assert swarm.judge(True) is Change.NOT_RECOVERED


def test_a_daemon_may_disappear_again_before_its_swarm_is_back() -> None:
    swarm = Presence()
    swarm.swarm_token(False, 5.0)
    swarm.judge(False)
    swarm.node_token(True, 6.0)
    swarm.node_token(False, 7.0)
    assert swarm.is_away
    assert swarm.judge(False) is None


def test_a_token_that_was_there_already_is_no_news() -> None:
    swarm = Presence()
    assert not swarm.swarm_token(True, 5.0)
    swarm.node_token(True, 5.0)
    assert swarm.is_present
    assert swarm.deadline is None
