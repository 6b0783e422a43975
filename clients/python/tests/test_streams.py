"""Streams of what a swarm publishes."""

from __future__ import annotations

import contextlib
import gc
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

import jostle
from conftest import MAX_WAIT_SECS, Daemon, Router, Wire, eventually, zenoh_session
from jostle._state import FrameReader

Create = Callable[..., jostle.Swarm]


def test_states_begin_with_the_current_one_and_never_decrease(create: Create) -> None:
    swarm = create(n=3, publish_every=1)
    swarm.step(5)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        first = next(states)
        assert (first.step, first.skipped) == (5, 0)
        swarm.run(until_step=60, rate=None)
        places = [(first.epoch, first.step, first.frame)]
        for state in states:
            places.append((state.epoch, state.step, state.frame))
            if state.step == 60 and state.phase == "paused":
                break
    assert places == sorted(set(places))


def test_a_slow_reader_gets_the_newest_and_the_number_skipped(create: Create) -> None:
    swarm = create(n=3, publish_every=1)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        first = next(states)
        # No state is read while these are published.
        for _ in range(30):
            swarm.step()
        seen = []
        for state in states:
            seen.append(state)
            if state.step == 30 and state.phase == "paused":
                break
    assert sum(state.skipped + 1 for state in seen) == seen[-1].frame - first.frame
    assert len(seen) < 10
    assert sum(state.skipped for state in seen) > 0


def test_states_older_than_the_first_one_are_not_skipped(create: Create) -> None:
    present = create(n=3).state()
    # Positions (step, frame): queried, published before that state, published after it.
    states = [replace(present, step=step, frame=frame) for step, frame in [(5, 7), (3, 8), (6, 9)]]
    reader = FrameReader(lambda payload: states[int(payload)], lambda: states[0])
    read = reader.first() + reader.read(b"1") + reader.read(b"2")
    assert [(state.step, state.skipped) for state in read] == [(5, 0), (6, 0)]


def _misdeliver(session: zenoh.Session, swarm: str) -> None:
    """Publishes what belongs on other keys, as zenoh does at times after an outage."""
    fixtures = Path(__file__).parents[3] / "proto" / "fixtures"
    state = (fixtures / "state.cbor").read_bytes()
    ours = [(fixtures / it).read_text() for it in ("event.phase.json", "order.json")]
    event, order = (it.replace('"school"', f'"{swarm}"') for it in ours)
    deleted = (fixtures / "event.deleted.json").read_text()
    assert all('"school"' in it for it in [*ours, deleted])
    for noun, others in [
        ("state", [event, order]),
        ("order", [event, ours[1]]),
        ("event", [order, ours[0], deleted]),
    ]:
        key = f"jostle/{swarm}/{noun}"
        for other in others:
            session.put(key, other, encoding=zenoh.Encoding.APPLICATION_JSON)
        # Of another swarm, too: on the key of the states it is a state.
        session.put(key, state, encoding=zenoh.Encoding.APPLICATION_CBOR)


def test_what_belongs_on_another_key_is_left_out_and_what_was_lost_is_queried(
    create: Create, daemon: Daemon
) -> None:
    name = create(n=3).name
    # A daemon passes on nothing that others put on its keys, a router does.
    router = Router(daemon.endpoint)
    with (
        contextlib.closing(router),
        zenoh_session(router.endpoint) as session,
        jostle.connect(router.endpoint) as client,
        client.swarm(name) as swarm,
        swarm.states(timeout=MAX_WAIT_SECS) as states,
        swarm.orders(timeout=MAX_WAIT_SECS) as orders,
        swarm.events(after=0, timeout=MAX_WAIT_SECS) as events,
    ):
        assert next(states).step == 0
        for step in range(1, 4):
            _misdeliver(session, swarm.name)
            swarm.step()
            state, order = next(states), next(orders)
            while state.step < step:
                state = next(states)
            while order.step < step:
                order = next(orders)
            assert (state.swarm, state.n, state.step) == (swarm.name, 3, step)
            assert (order.swarm, order.n, order.step) == (swarm.name, 3, step)
        numbers = [next(events).number for _ in range(4)]
        assert numbers == [1, 2, 3, 4]


def test_a_command_shows_in_a_paused_swarm(create: Create) -> None:
    swarm = create(n=3)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        assert not next(states).informed.any()
        swarm.inform(jostle.ids([1]), 0.5)
        assert next(state for state in states if state.informed.any()).direction[1] == 0.5


def test_a_reset_shows_as_a_new_epoch(create: Create) -> None:
    swarm = create(n=3)
    swarm.step(20)
    with swarm.states(timeout=MAX_WAIT_SECS) as states:
        epoch = next(states).epoch
        swarm.reset()
        after = next(state for state in states if state.epoch > epoch)
        assert after.step == 0


def test_a_silent_stream_is_a_deadline_and_can_continue(create: Create) -> None:
    swarm = create(n=3)
    with swarm.states(timeout=0.05) as states:
        next(states)
        with pytest.raises(jostle.DeadlineExceeded, match="paused"):
            next(states)
        swarm.step(5)

        def arrives() -> bool:
            try:
                return next(states).step == 5
            except jostle.DeadlineExceeded:
                return False

        eventually("the state arrives", arrives)
    with pytest.raises(jostle.InvalidArgument):
        swarm.states(timeout=-1.0)


def test_orders_contain_order_and_drift(create: Create) -> None:
    swarm = create(n=5, publish_every=1)
    swarm.inform(jostle.count(5), 0.0)
    with swarm.orders(timeout=MAX_WAIT_SECS) as orders:
        swarm.step(3)
        sample = next(sample for sample in orders if sample.step == 3)
    assert (sample.swarm, sample.n, sample.informed) == (swarm.name, 5, 5)
    assert 0.0 <= sample.order.order <= 1.0
    assert sample.order.drift == pytest.approx(sample.order.velocity[0])


def test_all_events_arrive_in_order(create: Create) -> None:
    swarm = create(n=3)
    with swarm.events(timeout=MAX_WAIT_SECS) as events:
        for number in range(200):
            swarm.set(pi3=0.25 + number / 1024)
        got = []
        for event in events:
            got.append(event)
            if event.kind == "command" and event.args == {"pi3": 0.25 + 199 / 1024}:
                break
    numbers = [event.number for event in got]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert [e.args["pi3"] for e in got if e.kind == "command"] == [
        0.25 + number / 1024 for number in range(200)
    ]


def test_every_stream_ends_when_the_swarm_is_deleted(
    create: Create, monkeypatch: pytest.MonkeyPatch
) -> None:
    # None ends because of its check after a silence.
    monkeypatch.setattr("jostle._stream._SILENCE_SECS", 100 * MAX_WAIT_SECS)
    swarm = create(n=3)
    streams: list[jostle.Stream[Any]] = [swarm.states(), swarm.orders(), swarm.events()]
    with ThreadPoolExecutor(len(streams)) as pool:
        drained = [pool.submit(list[Any], stream) for stream in streams]
        swarm.run()
        swarm.delete()
        items = [work.result(MAX_WAIT_SECS) for work in drained]
    last = items[-1][-1]
    assert isinstance(last, jostle.Event)
    assert last.kind == "deleted"


@pytest.mark.parametrize("politely", [True, False])
def test_a_stream_goes_on_with_a_restarted_daemon(own_daemon: Daemon, politely: bool) -> None:
    folder, endpoint = own_daemon.log.parent, own_daemon.endpoint
    with jostle.connect(endpoint, timeout=MAX_WAIT_SECS) as client:
        swarm = client.create("kept", jostle.Spec(n=3))
        states, events = swarm.states(timeout=0.1), swarm.events(timeout=0.1)
        before = next(states)
        if politely:
            assert own_daemon.stop() == 0
        else:
            own_daemon.kill()
        for stream in (states, events):
            eventually("it is reported", lambda: is_unreachable(stream))  # noqa: B023
        again = Daemon(folder, endpoint)
        try:
            swarm.annotate("back")
            state = eventually_next(states)
            assert (state.epoch, state.step) == (before.epoch + 1, 0)
            while (event := eventually_next(events)).verb != "annotate":
                assert event.epoch > before.epoch
        finally:
            again.kill()


def is_unreachable(stream: jostle.Stream[Any]) -> bool:
    """Whether the stream has noticed that the daemon is not reachable."""
    try:
        next(stream)
    except jostle.DeadlineExceeded as error:
        return "is not reachable" in str(error)
    return False


def eventually_next(stream: jostle.Stream[Any]) -> Any:
    """The next item of a stream with a short timeout."""
    deadline = time.monotonic() + MAX_WAIT_SECS
    while True:
        try:
            return next(stream)
        except jostle.DeadlineExceeded:
            assert time.monotonic() < deadline


def test_a_daemon_that_comes_back_without_the_swarm_ends_its_streams(
    own_daemon: Daemon, tmp_path: Path
) -> None:
    endpoint, another = own_daemon.endpoint, tmp_path / "another"
    another.mkdir()
    with jostle.connect(endpoint, timeout=MAX_WAIT_SECS) as client, ThreadPoolExecutor(2) as pool:
        swarm = client.create("lost", jostle.Spec(n=3))
        work = [pool.submit(list[object], stream) for stream in (swarm.states(), swarm.events())]
        own_daemon.kill()
        daemon = Daemon(another, endpoint)
        try:
            for stream in work:
                with pytest.raises(jostle.NotFound, match="back, but without swarm 'lost'"):
                    stream.result(MAX_WAIT_SECS)
        finally:
            daemon.kill()


def test_a_stream_goes_on_with_another_swarm_of_the_name(
    wire: Wire, client: jostle.Client, create: Create
) -> None:
    swarm = create(n=3)
    swarm.step(20)
    with jostle.connect(wire.endpoint) as far:
        mine = far.swarm(swarm.name)
        streams: list[jostle.Stream[Any]] = [mine.states(timeout=0.1), mine.events(timeout=0.1)]
        orders = mine.orders(timeout=0.1)
        assert next(streams[0]).step == 20
        wire.unplug()
        for stream in (*streams, orders):
            eventually("it is noticed", lambda: is_unreachable(stream))  # noqa: B023
        swarm.delete()
        client.create(swarm.name, jostle.Spec(n=4))
        wire.plug()
        assert eventually_next(streams[0]).n == 4
        assert eventually_next(streams[1]).kind == "created"
        swarm.set(pi3=2.0)
        assert eventually_next(orders).n == 4


def test_closing_from_another_thread_ends_the_loop(daemon: Daemon, create: Create) -> None:
    swarm = create(n=3)
    closers: list[Callable[[jostle.Client, jostle.Swarm, jostle.Stream[jostle.State]], None]] = [
        lambda client, swarm, stream: stream.close(),
        lambda client, swarm, stream: swarm.close(),
        lambda client, swarm, stream: client.close(),
    ]
    for close in closers:
        with jostle.connect(daemon.endpoint) as client, ThreadPoolExecutor(1) as pool:
            mine = client.swarm(swarm.name)
            stream = mine.states()
            next(stream)
            work = pool.submit(list[jostle.State], stream)
            close(client, mine, stream)
            assert work.result(MAX_WAIT_SECS) == []
            assert list(stream) == []


def test_an_unreferenced_stream_is_unsubscribed(create: Create) -> None:
    swarm = create(n=3)
    before = threading.active_count()
    for state in swarm.states():
        assert state.step == 0
        break
    stream = swarm.states()
    held = weakref.ref(stream)
    del stream
    gc.collect()
    assert held() is None
    eventually("its threads end", lambda: threading.active_count() <= before)


@pytest.mark.parametrize("ends", ["", "raise SystemExit(0)", "sys.exit(0)", "del client, stream"])
def test_a_program_that_closes_nothing_exits(ends: str, daemon: Daemon, create: Create) -> None:
    swarm = create(n=3, rate=20.0)
    swarm.run()
    code = (
        "import jostle, sys\n"
        f"client = jostle.connect({daemon.endpoint!r})\n"
        f"stream = client.swarm({swarm.name!r}).states()\n"
        f"others = client.swarm({swarm.name!r}).orders(), client.swarm({swarm.name!r}).events()\n"
        "assert next(stream).n == 3\n"
        f"{ends}\n"
    )
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        timeout=MAX_WAIT_SECS,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
