"""Controllers: in lock-step, and of a running swarm."""

from __future__ import annotations

import asyncio
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest
import zenoh

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually
from jostle import aio

Create = Callable[..., jostle.Swarm]


@pytest.fixture
def pool() -> Iterator[ThreadPoolExecutor]:
    """Threads for the advances of other controllers."""
    with ThreadPoolExecutor(4) as pool:
        yield pool


def waits_for(swarm: jostle.Swarm, controller: str) -> None:
    """Waits until the swarm waits for that controller alone."""
    eventually(
        f"it waits for {controller}",
        lambda: [it.controller for it in swarm.status().waiting_for] == [controller],
    )


def weights(swarm: jostle.Swarm) -> list[float]:
    weight: list[float] = swarm.state().weight.tolist()
    return weight


def test_one_controller_steps_a_swarm_and_gets_its_state(create: Create) -> None:
    swarm = create(n=5)
    with swarm.join("ada", jostle.ids([3, np.uint32(1)]), deadline=30.0) as ada:
        assert (ada.name, ada.swarm, ada.ids) == ("ada", swarm.name, [1, 3])
        assert (ada.step, ada.epoch) == (0, 1)
        assert ada.news == jostle.News(missed=[], left=[], removed=[])
        assert "'ada'" in repr(ada)
        advanced = ada.advance()
        assert (advanced.steps, advanced.step, ada.step, advanced.state) == (1, 1, 1, None)
        assert advanced.state_hash == swarm.status().state_hash
        arrived = ada.advance(np.int64(4), direction=0.5, weight=2.0, state=True)
        state = arrived.state
        assert (state.step, state.n, state.state_hash) == (5, 5, arrived.state_hash)
        assert state.weight.tolist() == [0.0, 2.0, 0.0, 2.0, 0.0]
        assert state.direction[[1, 3]].tolist() == [0.5, 0.5]
        (mine,) = swarm.controllers()
        assert (mine.controller, mine.mode, mine.ids) == ("ada", "lockstep", [1, 3])
        assert (mine.deadline_secs, mine.on_timeout, mine.target_step) == (30.0, "hold", 5)
        status = swarm.status()
        assert (status.controllers, status.waiting_for) == (1, [])
        with pytest.raises(jostle.IncorrectState):
            swarm.step()
        with pytest.raises(jostle.AlreadyExists):
            swarm.join("ada")
        assert ada.advance().step == 6
    assert swarm.controllers() == []
    swarm.step()


def test_ids_and_set_points_can_have_every_shape(create: Create) -> None:
    swarm = create(n=6, pi2=0.75)
    with swarm.join("ada", jostle.ids([1, 2, 4])) as ada:

        def set_points() -> tuple[list[float], list[float]]:
            state = swarm.state()
            return state.direction[[1, 2, 4]].tolist(), state.weight[[1, 2, 4]].tolist()

        ada.advance(direction=np.array([0.1, 0.2, 0.3]))
        assert set_points() == ([0.1, 0.2, 0.3], [0.75, 0.75, 0.75])
        ada.advance(ids=[4], direction=np.float64(1.0), weight=np.int32(2))
        assert set_points() == ([0.1, 0.2, 1.0], [0.75, 0.75, 2.0])
        ada.advance(ids=np.array([2, 1]), direction=(0.5, -0.5), weight=[3.0, 1.0])
        assert set_points() == ([-0.5, 0.5, 1.0], [1.0, 3.0, 2.0])
        ada.advance(direction=0.0, weight=np.array([1.0, 0.0, 1.0], np.float32))
        assert set_points() == ([0.0, 0.0, 0.0], [1.0, 0.0, 1.0])
        for wrong, field in [
            ({"direction": [0.0, 1.0]}, "set.direction"),
            ({"direction": np.zeros((3, 1))}, "set.direction"),
            ({"direction": np.nan}, "set.direction"),
            ({"direction": "east"}, "set.direction"),
            ({"direction": 0.0, "weight": [1.0]}, "set.weight"),
            ({"direction": 0.0, "weight": [1.0, np.inf, 1.0]}, "set.weight"),
            ({"direction": 0.0, "weight": -1.0}, "set.weight"),
            ({"direction": 0.0, "ids": [1.5]}, "set.ids"),
            ({"weight": 1.0}, "set.direction"),
            ({"ids": [1]}, "set.direction"),
            ({"direction": 0.0, "ids": [1, 1]}, "set.ids"),
            ({"direction": 0.0, "ids": [0]}, "set.ids"),
            ({"steps": 0}, "steps"),
            ({"steps": 1.5}, "steps"),
            ({"steps": True}, "steps"),
            ({"direction": 1.0, "ids": []}, "set.ids"),
        ]:
            with pytest.raises(jostle.InvalidArgument) as caught:
                ada.advance(**wrong)  # type: ignore[arg-type]
            assert caught.value.details["field"].startswith(field), wrong
        assert ada.advance().step == 5, "a rejected advance has changed something"


def test_individuals_that_another_client_removed_are_left_out(create: Create) -> None:
    swarm = create(n=6, pi2=0.75)
    with swarm.join("ada", jostle.ids([1, 3, 4])) as ada:
        swarm.remove(jostle.ids([3]))
        advanced = ada.advance(direction=[0.1, 0.2, 0.3], weight=2.0)
        assert (advanced.step, advanced.news.removed, ada.ids) == (1, [3], [1, 4])
        state = swarm.state()
        towards = dict(zip(state.id.tolist(), state.direction.tolist(), strict=True))
        assert (towards[1], towards[4]) == (0.1, 0.3)
        assert ada.advance(direction=[0.5, 0.6]).step == 2
        with pytest.raises(jostle.InvalidArgument, match=r"`sync\(\)` updates `ids`"):
            ada.advance(ids=[3], direction=0.5)
        swarm.remove(jostle.ids([1, 4]))
        assert (ada.advance(direction=0.5).step, ada.ids) == (3, [])


def test_set_points_are_put_only_by_a_controller_that_joined_to_put_them(create: Create) -> None:
    swarm = create(n=4)
    with (
        swarm.join("ada", jostle.ids([1])) as ada,
        pytest.raises(jostle.IncorrectState, match="lockstep: use `advance`"),
    ):
        ada.put(direction=0.5)
    eve = swarm.join("eve", jostle.ids([1]), mode="free_running")
    eve.leave()
    with pytest.raises(jostle.IncorrectState, match=r"has left: `sync\(\)` rejoins"):
        eve.put(direction=0.5)


def test_a_conflict_with_an_advance_that_takes_long_names_its_remedy(create: Create) -> None:
    swarm = create(n=50)
    with swarm.join("ada", jostle.ids([1]), deadline=60.0) as ada:
        with pytest.raises(jostle.DeadlineExceeded, match=r"not advanced within 1\.2 s"):
            ada.advance(10**9, timeout=1.2)
        for _ in range(2):
            with pytest.raises(jostle.Conflict, match=r"`cancel\(\)` ends that"):
                ada.advance(timeout=20.0)
            ada.sync()
        state = ada.cancel()
        assert (state.phase, ada.ids) == ("paused", [1])
        assert ada.advance().step == state.step + 1
        swarm.reset()
        with pytest.raises(jostle.Conflict, match=r"`sync\(\)` resumes"):
            ada.advance()


def test_the_options_of_join_are_checked(create: Create) -> None:
    swarm = create(n=6)
    for wrong in ({"deadline": 0.0}, {"deadline": 61.0}, {"mode": "fast"}, {"on_timeout": "never"}):
        with pytest.raises(jostle.InvalidArgument):
            swarm.join("ada", **wrong)
    for name in ("", "A", "a/b", "*"):
        with pytest.raises(jostle.InvalidArgument):
            swarm.join(name)
    with pytest.raises(jostle.InvalidArgument):
        swarm.join("ada", jostle.count(7))
    with pytest.raises(jostle.Conflict):
        swarm.join("ada", expect_step=3)
    with swarm.join("ada", jostle.fraction(0.5)) as ada, swarm.join("bob", jostle.count(3)) as bob:
        assert sorted(ada.ids + bob.ids) == list(range(6))
        with pytest.raises(jostle.Conflict):
            swarm.join("eve", jostle.ids([0]))
    assert swarm.controllers() == []


def test_it_steps_when_all_have_advanced(
    create: Create, pool: ThreadPoolExecutor, daemon: Daemon
) -> None:
    swarm = create(n=12)
    with (
        jostle.connect(daemon.endpoint) as other,
        swarm.join("ada", jostle.ids([0])) as ada,
        other.swarm(swarm.name).join("bob", jostle.ids([1])) as bob,
    ):
        first = pool.submit(ada.advance, direction=1.0, weight=2.0)
        waits_for(swarm, "bob")
        status = swarm.status()
        assert (status.step, status.phase, weights(swarm)[0]) == (0, "paused", 2.0)
        assert status.waiting_for[0].deadline_secs == 5.0
        assert bob.advance().step == 1
        assert first.result(MAX_WAIT_SECS).step == 1
        # An advance by ten steps equals ten exchanges of the other one.
        ten = pool.submit(ada.advance, 10)
        assert [bob.advance().step for _ in range(10)] == list(range(2, 12))
        assert ten.result(MAX_WAIT_SECS).steps == 10
        with pytest.raises(jostle.InvalidArgument, match="bob"):
            ada.advance(ids=[1], direction=0.0)
        # After a leave the others no longer wait for it.
        last = pool.submit(ada.advance)
        waits_for(swarm, "bob")
        assert bob.leave().seq > 0
        assert last.result(MAX_WAIT_SECS).step == 12
        assert ada.news.left == [jostle.Departed(controller="bob", why="left")]
        with pytest.raises(jostle.NotFound, match="left at step 11"):
            bob.advance()
        with pytest.raises(jostle.NotFound):
            bob.leave()
        # A controller that left can join again.
        assert bob.sync().step == 12
        assert (bob.ids, bob.step) == ([1], 12)
        both = pool.submit(bob.advance)
        assert ada.advance().step == both.result(MAX_WAIT_SECS).step == 13


def test_a_controller_that_missed_its_deadline_gets_an_error_and_syncs(
    create: Create, pool: ThreadPoolExecutor
) -> None:
    swarm = create(n=6)
    with (
        swarm.join("ada", jostle.ids([0])) as ada,
        swarm.join("bob", jostle.ids([1]), deadline=0.05, on_timeout="free") as bob,
    ):
        both = pool.submit(bob.advance, direction=0.0)
        ada.advance()
        both.result(MAX_WAIT_SECS)
        assert weights(swarm)[1] > 0.0
        assert ada.advance().steps == 1
        assert ada.news.missed == [jostle.Miss(controller="bob", step=1, misses=1)]
        assert weights(swarm)[1] == 0.0
        assert swarm.controllers()[1].misses == 1
        with pytest.raises(jostle.Conflict) as caught:
            bob.advance()
        assert (caught.value.step, bob.step) == (2, 1)
        state = bob.sync()
        assert (state.step, bob.step) == (2, 2)
        both = pool.submit(bob.advance)
        ada.advance()
        assert both.result(MAX_WAIT_SECS).step == 3
        assert bob.news.missed == [jostle.Miss(controller="bob", step=1, misses=1)]
        for misses in (1, 2, 3):
            ada.advance()
            assert ada.news.missed[-1].misses == misses
        assert ada.news.left == [jostle.Departed(controller="bob", why="late")]
        with pytest.raises(jostle.NotFound, match="missed 3 deadlines"):
            bob.advance()
        bob.sync()
        assert (bob.ids, bob.step) == ([1], 6)
        assert swarm.controllers()[1].on_timeout == "free"
    assert swarm.verify().differs_at is None


def test_a_swarm_can_pause_for_a_late_controller(create: Create) -> None:
    swarm = create(n=6)
    with swarm.join("ada") as ada, swarm.join("bob", deadline=0.05, on_timeout="pause"):
        for _ in range(2):
            advanced = ada.advance()
            assert (advanced.steps, advanced.step, ada.step) == (0, 0, 0)


def test_an_interruption_ends_the_wait_of_each_controller(
    create: Create, pool: ThreadPoolExecutor
) -> None:
    swarm = create(n=6)
    with swarm.join("ada", jostle.ids([0, 5])) as ada, swarm.join("bob") as bob:

        def meanwhile(change: Callable[[], object]) -> jostle.Advanced:
            waiting = pool.submit(ada.advance, 3)
            waits_for(swarm, "bob")
            change()
            return waiting.result(MAX_WAIT_SECS)

        assert meanwhile(swarm.pause).steps == 0
        both = pool.submit(bob.advance)
        assert ada.advance().step == both.result(MAX_WAIT_SECS).step == 1
        assert meanwhile(swarm.reset).steps == 0
        for controller in (ada, bob):
            with pytest.raises(jostle.Conflict) as caught:
                controller.advance()
            assert (caught.value.step, controller.step) == (0, 1)
            controller.sync()
            assert (controller.step, controller.epoch) == (0, 2)
        swarm.remove(jostle.ids([5]))
        both = pool.submit(bob.advance)
        ada.advance()
        both.result(MAX_WAIT_SECS)
        assert (ada.news.removed, ada.ids) == ([5], [0])
        # No other controller advances in this time, and the advance stays pending.
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(direction=1.0, timeout=0.1)
        waits_for(swarm, "bob")
        # The same advance again is the same exchange; another one replaces it.
        waiting = pool.submit(ada.advance, direction=1.0)
        time.sleep(0.1)
        assert bob.advance().step == 2
        assert waiting.result(MAX_WAIT_SECS).step == 2
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(direction=2.0, timeout=0.1)
        assert bob.advance().step == 3
        # Sent again after its execution, it gets the reply of the first one.
        assert (ada.advance(direction=2.0).step, ada.step) == (3, 3)
        assert swarm.status().step == 3
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(direction=3.0, timeout=0.1)
        instead = pool.submit(ada.advance, direction=4.0)
        eventually("it takes its place", lambda: swarm.state().direction[0] == 4.0)
        assert bob.advance().step == instead.result(MAX_WAIT_SECS).step == 4


def test_a_cancelled_advance_permits_no_steps(create: Create, pool: ThreadPoolExecutor) -> None:
    swarm = create(n=6)
    with swarm.join("ada", jostle.ids([1])) as ada, swarm.join("bob", jostle.ids([2])) as bob:
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(5, timeout=0.1)
        waits_for(swarm, "bob")
        assert (ada.cancel().step, ada.ids) == (0, [1])
        waiting = pool.submit(bob.advance)
        waits_for(swarm, "ada")
        assert swarm.status().step == 0
        assert ada.advance().step == waiting.result(MAX_WAIT_SECS).step == 1
        # Without an advance it returns the state.
        assert ada.cancel().step == 1
        ada.leave()
        assert ada.cancel().step == 1
        assert (ada.ids, len(swarm.controllers())) == ([1], 2)


def test_after_a_cancelled_advance_it_steers_the_individuals_that_were_drawn(
    create: Create,
) -> None:
    swarm = create(n=40)
    with swarm.join("ada", jostle.fraction(0.25)) as ada, swarm.join("bob", jostle.count(8)):
        drawn = ada.ids
        assert len(drawn) == 10
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(direction=1.0, timeout=0.1)
        ada.cancel()
        listed = {it.controller: it.ids for it in swarm.controllers()}
        assert ada.ids == listed["ada"] == drawn
        # Without those that another client has removed.
        swarm.remove(jostle.ids(drawn[:3]))
        with pytest.raises(jostle.DeadlineExceeded):
            ada.advance(direction=2.0, timeout=0.1)
        ada.cancel()
        assert ada.ids == drawn[3:]


def test_an_error_in_a_with_block_is_the_one_raised(create: Create) -> None:
    swarm = create(n=6)
    for leaves in (False, True):
        with pytest.raises(ZeroDivisionError), swarm.join("ada") as ada:  # noqa: PT012
            if leaves:
                ada.leave()
            raise ZeroDivisionError
    assert swarm.controllers() == []
    with swarm.join("ada") as ada:
        ada.leave()


def tokens(daemon: Daemon, swarm: jostle.Swarm, client: jostle.Client) -> list[str]:
    """The controllers whose tokens the daemon sees."""
    return [key.split("/")[-2] for key in client._session.alive(f"jostle/{swarm.name}/ctl/*/alive")]


def test_a_token_exists_from_before_the_join_until_the_leave(
    create: Create, daemon: Daemon, client: jostle.Client
) -> None:
    swarm = create(n=6)
    with jostle.connect(daemon.endpoint) as other:
        theirs = other.swarm(swarm.name)
        with theirs.join("ada") as ada:
            assert tokens(daemon, swarm, client) == ["ada"]
            # A rejected join does not remove the token of another controller.
            for client_of in (swarm, theirs):
                with pytest.raises(jostle.AlreadyExists):
                    client_of.join("ada")
            ada.advance()
            assert tokens(daemon, swarm, client) == ["ada"]
        eventually("it is gone", lambda: tokens(daemon, swarm, client) == [])
        theirs.join("bob")
        bob = theirs.join("bob", again=True)
        assert bob.advance().step == 2
    with pytest.raises(jostle.Unavailable, match="closed"):
        bob.advance()
    # A token disappears with its session, and its controller has left.
    eventually("it is lost", lambda: swarm.controllers() == [])
    # It also disappears with the object that holds it.
    cyd = swarm.join("cyd")
    assert tokens(daemon, swarm, client) != []
    del cyd
    eventually("it is lost", lambda: swarm.controllers() == [])
    swarm.step()


def test_a_controller_that_joins_again_keeps_its_individuals(
    create: Create, daemon: Daemon
) -> None:
    swarm = create(n=6)
    code = """
import os, sys, jostle
ada = jostle.connect(sys.argv[1]).swarm(sys.argv[2]).join("ada", jostle.ids([1, 4]), deadline=60.0)
ada.advance(3)
print(ada.step, flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", code, daemon.endpoint, swarm.name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"3\n"
        ada = swarm.join("ada", again=True, deadline=60.0)
        assert (ada.ids, ada.step) == ([1, 4], 3)
        process.kill()
    time.sleep(0.3)
    assert ada.advance().step == 4, "the end of another process removed its token"
    ada.leave()


def test_set_points_are_sent_while_the_swarm_runs(create: Create, daemon: Daemon) -> None:
    swarm = create(n=6, rate=4.0)
    swarm.run()
    terms = {"mode": "free_running", "deadline": 0.5, "on_timeout": "free"}
    with swarm.join("ada", jostle.ids([2, 4]), **terms) as ada:  # type: ignore[arg-type]
        assert swarm.status().phase == "running"
        for direction in np.linspace(0.0, 1.0, 20):
            ada.put(direction=direction, weight=2.0)
            time.sleep(0.01)
        eventually("they apply", lambda: weights(swarm)[2] == weights(swarm)[4] == 2.0)
        ada.put(ids=[4], direction=[1.0], weight=[3.0])
        eventually("they apply", lambda: weights(swarm)[4] == 3.0)
        with pytest.raises(jostle.InvalidArgument):
            ada.put(direction=[1.0])
        with pytest.raises(jostle.InvalidArgument):
            ada.put(direction=np.nan)
        with pytest.raises(jostle.IncorrectState, match="free_running: use `put`"):
            ada.advance()
        (mine,) = swarm.controllers()
        assert (mine.mode, mine.target_step) == ("free_running", None)
        assert mine.puts.applied + mine.puts.overtaken == 21
        assert (mine.puts.stale, mine.puts.refused) == (0, 0)
        # No further set-point arrives, and its lease ends.
        eventually("they are free", lambda: max(weights(swarm)) == 0.0)
        # A controller that joins again is not mistaken for the earlier one.
        again = swarm.join("ada", again=True, **terms)  # type: ignore[arg-type]
        again.put(direction=0.0, weight=4.0)
        eventually("they apply", lambda: weights(swarm)[2] == 4.0)
    swarm.pause()
    assert {"join", "control", "deadline", "leave"} <= {it.verb for it in swarm.journal()}
    assert swarm.verify().differs_at is None


def test_the_order_of_advances_changes_no_bit(create: Create, pool: ThreadPoolExecutor) -> None:
    hashes = set()
    for turn in (1, -1):
        swarm = create(n=20, seed=3)
        both = [swarm.join("ada", jostle.ids([0, 1])), swarm.join("bob", jostle.ids([2, 3]))]
        for step in range(20):
            waiting: list[Future[jostle.Advanced]] = []
            for controller in both[::turn]:
                towards = 0.1 * step + (controller.name == "bob")
                waiting.append(pool.submit(controller.advance, direction=[towards, 0.0]))
            reached = {one.result(MAX_WAIT_SECS).state_hash for one in waiting}
            assert len(reached) == 1
        hashes |= reached
    assert len(hashes) == 1


def test_the_same_for_asyncio(daemon: Daemon, create: Create) -> None:
    swarm = create(n=6)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            there = client.swarm(swarm.name)
            async with there.join("ada", jostle.ids([0])) as ada, there.join("bob") as bob:
                assert (ada.name, ada.swarm, ada.ids, ada.epoch) == ("ada", swarm.name, [0], 1)
                assert "aio" in repr(ada)
                for _ in range(5):
                    both = await asyncio.gather(ada.advance(direction=0.5), bob.advance())
                    assert both[0].state_hash == both[1].state_hash
                assert (ada.step, ada.news.left) == (5, [])
                # A cancelled advance stays pending; the same one again is the same exchange.
                waiting = asyncio.create_task(ada.advance(direction=1.0))
                while not (await there.status()).waiting_for:
                    await asyncio.sleep(0.01)
                waiting.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await waiting
                both = await asyncio.gather(ada.advance(direction=1.0), bob.advance())
                assert (await ada.sync()).step == 6
                assert [it.controller for it in await there.controllers()] == ["ada", "bob"]
            assert await there.controllers() == []
            cyd = await there.join("cyd")
            await cyd.leave()

    asyncio.run(asyncio.wait_for(main(), MAX_WAIT_SECS))


def _ends(endpoint: str, swarm: str) -> None:
    with jostle.connect(endpoint) as client:
        client.swarm(swarm).join("ada").advance()


def test_a_process_that_leaves_no_controller_ends(create: Create, daemon: Daemon) -> None:
    swarm = create(n=3)
    process = multiprocessing.get_context("spawn").Process(
        target=_ends, args=(daemon.endpoint, swarm.name)
    )
    process.start()
    process.join(MAX_WAIT_SECS)
    assert process.exitcode == 0
    eventually("it is lost", lambda: swarm.controllers() == [])


def test_a_forked_process_leaves_its_controllers_alone(create: Create, daemon: Daemon) -> None:
    swarm = create(n=3)
    code = """
import os, sys, jostle
ada = jostle.connect(sys.argv[1]).swarm(sys.argv[2]).join("ada", deadline=60.0)
if (pid := os.fork()) == 0:
    try:
        ada.advance()
    except jostle.Unavailable:
        del ada
        sys.exit(3)
assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 3
assert ada.advance().step == 1
ada.leave()
"""
    arguments = [sys.executable, "-c", code, daemon.endpoint, swarm.name]
    subprocess.run(arguments, timeout=MAX_WAIT_SECS, check=True)


def test_individuals_driven_directly_move_as_commanded(create: Create) -> None:
    start = {"kind": "given", "x": [0.0, 20.0], "y": [0.0, 0.0], "alpha": [1.5, 1.5]}
    swarm = create(n=2, start=start)
    undriven = swarm.join("ada", jostle.ids([0, 1]))
    with undriven, pytest.raises(jostle.InvalidArgument, match="driving"):
        undriven.advance(direction=0.0, turn=0.0)
    with swarm.join("ada", jostle.ids([0, 1]), driving=True) as ada:
        assert swarm.controllers()[0].driving
        with pytest.raises(jostle.InvalidArgument, match="finite"):
            ada.advance(direction=0.0, turn=np.inf)
        arrived = ada.advance(
            50, direction=0.0, weight=0.0, turn=[0.0, np.nan], speed=[0.5, np.nan], state=True
        )
    state = arrived.state
    assert state.alpha[0] == 1.5
    assert state.alpha[1] != 1.5
    assert np.hypot(state.x[0], state.y[0]) == pytest.approx(0.5)


def test_an_exchange_takes_little_more_than_a_bare_query(
    create: Create, client: jostle.Client
) -> None:
    swarm = create(n=50)
    key = f"jostle/{swarm.name}/get/status"
    session = client._session.zenoh

    def bare() -> None:
        session.get(key, consolidation=zenoh.ConsolidationMode.NONE).recv()

    with swarm.join("ada", jostle.count(5)) as ada:
        directions = np.linspace(0.0, 1.0, 5)
        calls: dict[str, Callable[[], object]] = {
            "a bare query": bare,
            "an exchange": ada.advance,
            "one with set-points": lambda: ada.advance(direction=directions),
            "one with the state": lambda: ada.advance(direction=directions, state=True),
        }
        secs: dict[str, list[float]] = {what: [] for what in calls}
        for _ in range(400):
            # Alternately, so that other load of the machine slows all of them alike.
            for what, call in calls.items():
                began = time.perf_counter()
                call()
                secs[what].append(time.perf_counter() - began)
    medians = {what: sorted(each)[len(each) // 2] for what, each in secs.items()}
    for what, median in medians.items():
        print(f"{what}: {1e6 * median:.0f} µs, {1 / median:.0f} a second")
    assert medians["one with set-points"] < 3.0 * medians["a bare query"] + 0.001
