"""The asyncio form: the same calls, awaited, and a loop that is never blocked."""

from __future__ import annotations

import asyncio
import gc
import inspect
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, Daemon, Wire, eventually
from jostle import aio

Create = Callable[..., jostle.Swarm]


@pytest.fixture(autouse=True)
def _ends_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jostle._threads._IDLE_SECS", 0.1)


def workers() -> int:
    return sum(it.name in ("jostle-worker", "jostle-listener") for it in threading.enumerate())


def run_delays() -> dict[str, int]:
    """For each thread of this process, how long it was ready to run and waited for a CPU, in ns."""
    delays = {}
    for task in Path("/proc/self/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):
            delays[task.name] = int((task / "schedstat").read_text().split()[1])
    return delays


def run_delay_secs(before: dict[str, int]) -> float:
    """How long threads waited for a CPU since `before`; those that ended are left out."""
    return sum(delay - before.get(task, 0) for task, delay in run_delays().items()) / 1e9


def run(main: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Runs `main`, and checks that the loop was never blocked and no thread remains."""
    before = workers()
    gap = 0.0

    async def watched() -> None:
        async def watch() -> None:
            nonlocal gap
            while True:
                began, delays = time.monotonic(), run_delays()
                await asyncio.sleep(0.005)
                took = time.monotonic() - began
                if took > gap:
                    # On a busy machine the thread of the loop, or the one that holds the
                    # interpreter's lock, waits for a CPU: that time does not count.
                    gap = max(gap, took - run_delay_secs(delays))

        watching = asyncio.create_task(watch())
        try:
            await asyncio.wait_for(main(), 2 * MAX_WAIT_SECS)
        finally:
            watching.cancel()

    asyncio.run(watched())
    # Each of these calls would block for a second or longer.
    assert gap < 0.5
    gc.collect()
    eventually("its threads end", lambda: workers() <= before)


@pytest.mark.parametrize(
    ("sync", "form"),
    [
        (jostle.Client, aio.Client),
        (jostle.Local, aio.Local),
        (jostle.Swarm, aio.Swarm),
        (jostle.AtStep, aio.AtStep),
        (jostle.Experiment, aio.Experiment),
        (jostle.Controller, aio.Controller),
    ],
)
def test_every_blocking_call_has_an_awaited_one(sync: type, form: type) -> None:
    for name, thing in inspect.getmembers(sync):
        if name.startswith("_"):
            continue
        there = getattr(form, name, None)
        assert there is not None, name
        if callable(thing):
            assert inspect.getdoc(there), name
            takes = [list(inspect.signature(it).parameters) for it in (thing, there)]
            assert takes[0] == takes[1], name


def test_a_swarm_is_steered_and_followed(daemon: Daemon) -> None:
    async def main() -> None:
        async with aio.connect(daemon.endpoint, client="ada") as client:
            swarm = await client.create("aio", jostle.Spec(n=5, publish_every=1))
            state = await swarm.step(10, state=True)
            assert (state.step, state.n) == (10, 5)
            informed = await swarm.inform(jostle.count(2), direction=0.0)
            assert len(informed.ids) == 2
            fork = await swarm.fork("aio-fork")
            assert (await fork.status()).step == 10
            await fork.delete()
            await swarm.run(until_step=60, rate=None)
            steps = []
            async for state in swarm.states(timeout=MAX_WAIT_SECS):
                steps.append(state.step)
                if state.step == 60 and state.phase == "paused":
                    break
            assert steps == sorted(steps)
            verbs = [event.verb for event in await swarm.history() if event.kind == "command"]
            assert verbs == ["step", "inform", "run"]
            with pytest.raises(jostle.NotFound):
                await client.swarm("unknown").status()
            with pytest.raises(jostle.InvalidArgument, match="pi3"):
                await swarm.set(pi3=-1.0)
            assert "aio" in [it.swarm for it in await client.swarms()]
            await swarm.delete()

    run(main)


def test_many_calls_wait_at_once_without_blocking_the_loop(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        client = await aio.connect(daemon.endpoint)
        mine = client.swarm(swarm.name)
        waiting = [asyncio.create_task(mine.wait(phase="running")) for _ in range(100)]
        await asyncio.sleep(0.2)
        await mine.run()
        assert {status.phase for status in await asyncio.gather(*waiting)} == {"running"}
        await client.close()
        await client.close()

    run(main)


def test_a_cancelled_call_ends_at_once_and_its_thread_soon(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            mine = client.swarm(swarm.name)
            before = threading.active_count()
            began = time.monotonic()
            for _ in range(20):
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(mine.wait(phase="running"), 0.05)
            # Each of these waits for half a minute if it is not cancelled.
            assert time.monotonic() - began < MAX_WAIT_SECS
            # A waiting call holds a thread, a cancelled one only briefly.
            assert threading.active_count() - before < 10
            assert (await mine.status()).step == 0

    run(main)


def test_a_controller_and_a_client_are_opened_by_a_task(create: Create, daemon: Daemon) -> None:
    swarm = create(n=4)

    async def main() -> None:
        client = await asyncio.create_task(aio.connect(daemon.endpoint))
        async with client, asyncio.TaskGroup() as group:
            theirs = client.swarm(swarm.name)
            joining = [
                group.create_task(theirs.join(name, jostle.ids([at])))
                for at, name in enumerate("abc")
            ]
        assert [it.result().ids for it in joining] == [[0], [1], [2]]
        with pytest.raises(jostle.InvalidArgument, match="name"):
            await asyncio.create_task(theirs.join("", jostle.ids([3])))
        unused = aio.connect(daemon.endpoint)
        unused.close()
        cancelled = asyncio.create_task(aio.connect(daemon.endpoint))
        cancelled.cancel()
        with pytest.raises(asyncio.CancelledError):
            await cancelled

    run(main)


def test_a_cancelled_connecting_leaves_nothing(free_endpoint: str, daemon: Daemon) -> None:
    async def main() -> None:
        for endpoint in (free_endpoint, daemon.endpoint):
            task = asyncio.create_task(_open(endpoint))
            await asyncio.sleep(0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        with pytest.raises(jostle.Unavailable):
            await aio.connect(free_endpoint, timeout=0.1)

    async def _open(endpoint: str) -> None:
        async with aio.connect(endpoint, timeout=1.0):
            raise AssertionError

    run(main)


def test_a_cancelled_item_is_not_lost(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        async with (
            aio.connect(daemon.endpoint) as client,
            client.swarm(swarm.name).events() as events,
        ):
            got: list[float] = []
            setting: asyncio.Task[None] | None = None
            # If cancelling lost items, the later ones would end the loop.
            waits = [0.002] * 200
            while not got or got[-1] < _pi3(49):
                try:
                    wait = waits.pop() if waits else None
                    got.append((await asyncio.wait_for(anext(events), wait)).args["pi3"])
                except TimeoutError:
                    # No item is available yet: the first one is cancelled in any case.
                    setting = setting or asyncio.create_task(_set(client.swarm(swarm.name)))
            assert setting is not None
            setting.cancel()
            assert got == [_pi3(it) for it in range(50)]

    async def _set(mine: aio.Swarm) -> None:
        for it in itertools.count():
            await mine.set(pi3=_pi3(it))

    def _pi3(it: int) -> float:
        return 1.0 + it / 64

    run(main)


def test_two_readers_of_a_stream_get_an_item_each(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            events = await client.swarm(swarm.name).events()
            both = [asyncio.create_task(_next(events)) for _ in range(2)]
            await client.swarm(swarm.name).set(pi3=2.0)
            await client.swarm(swarm.name).set(pi3=3.0)
            numbers = [event.number for event in await asyncio.gather(*both)]
            assert sorted(numbers) == [numbers[0], numbers[0] + 1]
            await events.close()
            assert [event async for event in events] == []

    async def _next(events: aio.Stream[jostle.Event]) -> jostle.Event:
        return await anext(events)

    run(main)


@pytest.mark.parametrize("how", ["stream", "swarm", "client"])
def test_closing_ends_a_loop(how: str, create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        client = await aio.connect(daemon.endpoint)
        mine = client.swarm(swarm.name)
        states = mine.states()
        await anext(states)
        task = asyncio.create_task(_drain(states))
        await asyncio.sleep(0.05)
        closes = {"stream": states.close, "swarm": mine.close, "client": client.close}
        await closes[how]()
        assert await task == 0
        await client.close()

    run(main)


async def _drain(stream: aio.Stream[jostle.State]) -> int:
    return len([item async for item in stream])


def test_a_stream_of_a_deleted_swarm_ends(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            mine = client.swarm(swarm.name)
            async with mine.states() as states:
                await anext(states)
                task = asyncio.create_task(_drain(states))
                await mine.delete()
                await task
            with pytest.raises(jostle.NotFound):
                await anext(mine.states())

    run(main)


def test_a_stream_that_is_left_or_cancelled_is_unsubscribed(create: Create, daemon: Daemon) -> None:
    swarm = create(n=2)

    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            before = workers()
            async for state in client.swarm(swarm.name).states():
                assert state.step == 0
                break
            task = asyncio.create_task(_drain(client.swarm(swarm.name).states()))
            await asyncio.sleep(0.1)
            assert workers() > before
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            del task
            gc.collect()
            deadline = time.monotonic() + MAX_WAIT_SECS
            while workers() > before:
                assert time.monotonic() < deadline
                await asyncio.sleep(0.05)

    run(main)


def test_a_private_daemon_and_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOSTLED", str(JOSTLED))

    async def main() -> None:
        async with aio.local() as client:
            swarm = await client.create("school", jostle.Spec(n=3, rate=None))
            states = swarm.states()
            await anext(states)
            os.kill(client.pid, signal.SIGKILL)
            with pytest.raises(jostle.Unavailable):
                async for _ in states:
                    pass
            with pytest.raises(jostle.Unavailable):
                await swarm.step()
        folder = client.folder
        task = asyncio.create_task(_local())
        await asyncio.sleep(0.03)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert not folder.exists()

    async def _local() -> None:
        async with aio.local():
            await asyncio.sleep(60)

    run(main)


def test_a_daemon_without_replies_blocks_only_the_call_to_it(wire: Wire, create: Create) -> None:
    swarm = create(n=2)

    async def main() -> None:
        client = await aio.connect(wire.endpoint, timeout=1.0)
        wire.mute()
        task = asyncio.create_task(client.swarm(swarm.name).status())
        await asyncio.sleep(0.3)
        assert not task.done()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        wire.cut()
        await client.close()

    run(main)


def test_an_experiment_is_awaited(daemon: Daemon) -> None:
    async def main() -> None:
        async with aio.connect(daemon.endpoint) as client:
            text = {"name": "aio", "seed": 1, "replicates": 2, "duration": 1, "grid": [{"n": [3]}]}
            experiment = await client.submit(text)
            assert await experiment.wait(MAX_WAIT_SECS) is experiment
            assert len(await experiment.rows()) == 2
            assert (await aio.experiment(text, client=client)).name == "aio"
            await experiment.delete()

    run(main)


@pytest.mark.parametrize(("ends", "code"), [("", 0), ("raise KeyError", 1), ("sys.exit(3)", 3)])
def test_a_program_that_closes_nothing_exits(ends: str, code: int) -> None:
    program = (
        "import asyncio, jostle, sys\n"
        "from jostle import aio\n"
        "kept = []\n"
        "async def main():\n"
        "    client = await aio.local()\n"
        "    swarm = await client.create('x', {'n': 3})\n"
        "    states = swarm.states()\n"
        "    await anext(states)\n"
        "    tasks = [asyncio.create_task(states.__anext__()),\n"
        "             asyncio.create_task(swarm.wait(phase='running'))]\n"
        "    kept.extend([client, swarm, states, tasks])\n"
        "    await asyncio.sleep(0.05)\n"
        f"    {ends}\n"
        "asyncio.run(main())\n"
    )
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env={**os.environ, "JOSTLED": str(JOSTLED)},
        capture_output=True,
        text=True,
        timeout=MAX_WAIT_SECS,
        check=False,
    )
    assert ran.returncode == code
    assert ran.stderr == "" or code == 1
    assert "Exception ignored" not in ran.stderr
