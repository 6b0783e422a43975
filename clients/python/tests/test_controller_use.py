"""What a controller does if several threads or tasks use it, and if an advance is cut short."""

from __future__ import annotations

import asyncio
import runpy
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually
from jostle import aio

Create = Callable[..., jostle.Swarm]
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "controller.py"


def test_two_threads_cannot_use_one_controller_at_a_time(create: Create) -> None:
    swarm = create(n=5)
    barrier = threading.Barrier(2)
    with swarm.join("ada", jostle.ids([0])) as ada, ThreadPoolExecutor(2) as pool:

        def work() -> tuple[int, int]:
            counts = [0, 0]
            barrier.wait(MAX_WAIT_SECS)
            for _ in range(200):
                try:
                    assert ada.advance(1).complete
                    counts[0] += 1
                except jostle.IncorrectState:
                    counts[1] += 1
            return counts[0], counts[1]

        done = [one.result(MAX_WAIT_SECS) for one in [pool.submit(work), pool.submit(work)]]
        succeeded, refused = (sum(column) for column in zip(*done, strict=True))
        # Each success is a step of its own, and a refused call changes nothing.
        assert succeeded + refused == 400
        assert refused > 0
        assert (swarm.status().step, ada.step) == (succeeded, succeeded)


def test_calls_during_an_advance_are_refused_and_it_goes_on(create: Create) -> None:
    swarm = create(n=5)
    with (
        swarm.join("ada", jostle.ids([0])) as ada,
        swarm.join("bob", jostle.ids([1]), deadline=60.0) as bob,
        ThreadPoolExecutor(1) as pool,
    ):
        waiting = pool.submit(ada.advance, 3)
        eventually("it waits for bob", lambda: swarm.status().waiting_for != [])
        calls: list[Callable[[], object]] = [
            ada.advance,
            lambda: ada.advance(3),
            lambda: ada.advance(direction=1.0),
            ada.sync,
        ]
        for call in calls:
            with pytest.raises(jostle.IncorrectState, match="another thread or task"):
                call()
        assert not waiting.done()
        assert bob.advance(3).complete
        assert waiting.result(MAX_WAIT_SECS).complete
        assert (swarm.status().step, ada.step) == (3, 3)


def test_another_thread_ends_an_advance(create: Create) -> None:
    swarm = create(n=5)
    with swarm.join("bob", jostle.ids([1]), deadline=60.0), ThreadPoolExecutor(1) as pool:
        ada = swarm.join("ada", jostle.ids([0]))
        for end, kind in ((ada.cancel, jostle.Conflict), (ada.leave, jostle.JostleError)):
            waiting = pool.submit(ada.advance, 3)
            eventually("it is pending", lambda: targets(swarm)["ada"] == 3)
            end()
            with pytest.raises(kind):
                waiting.result(MAX_WAIT_SECS)
            assert swarm.status().step == 0
        assert ada.sync().step == 0
        ada.leave()


def targets(swarm: jostle.Swarm) -> dict[str, int | None]:
    return {it.controller: it.target_step for it in swarm.controllers()}


def test_puts_are_refused_only_while_another_call_is_executed(create: Create) -> None:
    swarm = create(n=5)
    with (
        swarm.join("ada", jostle.ids([0]), mode="free_running") as ada,
        ThreadPoolExecutor(4) as pool,
    ):

        def put(number: int) -> int:
            try:
                ada.put(direction=float(number))
            except jostle.IncorrectState:
                return 0
            return 1

        swarm.run()
        sent = sum(pool.map(put, range(2000)))

        def counted() -> int:
            puts = swarm.controllers()[0].puts
            return puts.applied + puts.overtaken + puts.stale + puts.refused

        eventually("all have arrived", lambda: counted() == sent)
        # Each has a number of its own, and they leave in that order.
        puts = swarm.controllers()[0].puts
        assert (puts.stale, puts.refused) == (0, 0)


def test_two_tasks_cannot_use_one_controller_and_a_cancelled_one_is_waited_for(
    daemon: Daemon, create: Create
) -> None:
    swarm = create(n=5)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            there = client.swarm(swarm.name)
            async with there.join("ada", jostle.ids([0])) as ada, there.join("bob", deadline=60.0):
                for _ in range(20):
                    waiting = asyncio.create_task(ada.advance(2))
                    while not (await there.status()).waiting_for:
                        await asyncio.sleep(0.001)
                    with pytest.raises(jostle.IncorrectState, match="another thread or task"):
                        await ada.advance(2)
                    waiting.cancel()
                    with pytest.raises(asyncio.CancelledError):
                        await waiting
                    # The thread of the cancelled call may not have ended yet.
                    assert (await ada.sync()).step == 0
                    assert (await ada.cancel()).step == 0

    asyncio.run(asyncio.wait_for(main(), MAX_WAIT_SECS))


@pytest.mark.parametrize("has_state", [False, True])
def test_an_advance_says_whether_it_is_complete(create: Create, has_state: bool) -> None:
    swarm = create(n=5)
    with swarm.join("ada", jostle.ids([0])) as ada, ThreadPoolExecutor(1) as pool:
        for steps in (1, 7):
            assert ada.advance(steps, state=has_state).complete
        waiting = pool.submit(ada.advance, 10**8, state=has_state)
        eventually("it steps", lambda: swarm.status().step > 8)
        swarm.pause()
        advanced = waiting.result(MAX_WAIT_SECS)
        assert not advanced.complete
        assert 0 < advanced.steps < 10**8
        assert (advanced.step, ada.step) == (8 + advanced.steps, advanced.step)
        assert ada.advance(2, state=has_state).complete
        # The swarm waits for nobody else: a condition ends it as well.
        swarm.when("order >= 0", pause=True)
        assert not ada.advance(10**6, state=has_state).complete


def test_the_example_looks_at_it(
    create: Create, daemon: Daemon, client: jostle.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = create(n=2).name + "-looped"
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), name, "--endpoint", daemon.endpoint])

    def interrupt() -> None:
        swarm = client.swarm(name)
        while not any(it.swarm == name and it.step > 0 for it in client.swarms()):
            pass
        swarm.when("order >= 0", pause=True)

    with ThreadPoolExecutor(1) as pool:
        interrupting = pool.submit(interrupt)
        with pytest.raises(SystemExit, match=rf"ended after \d of 10 steps.*{name}"):
            runpy.run_path(str(EXAMPLE), run_name="__main__")
        interrupting.result(MAX_WAIT_SECS)
    client.swarm(name).delete()
