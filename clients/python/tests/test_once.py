"""A command is executed once, even if its reply is lost."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import zenoh

import jostle
from conftest import MAX_WAIT_SECS, Daemon, Wire, eventually, zenoh_session

Create = Callable[..., jostle.Swarm]

COMMANDS: dict[str, Callable[[jostle.Swarm], Any]] = {
    "inject": lambda swarm: swarm.inject(1).ids,
    "step": lambda swarm: swarm.step(3).steps,
    "step with state": lambda swarm: swarm.step(3, state=True).step,
    "set": lambda swarm: swarm.set(pi3=2.0).before.pi3,
    "batch": lambda swarm: swarm.batch([jostle.Inject(1)]).results[0].ids,
    "reset": lambda swarm: swarm.reset().seq,
    "waiting for its step": lambda swarm: swarm.at(7).pause().phase,
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_whose_reply_is_lost_is_executed_once(
    name: str, wire: Wire, create: Create
) -> None:
    swarm, twin = create(n=3, seed=1), create(n=3, seed=1)
    command = COMMANDS[name]
    expected = command(twin)
    with jostle.connect(wire.endpoint) as client, ThreadPoolExecutor(1) as pool:
        mine = client.swarm(swarm.name)
        assert mine.status().seq == 0
        wire.mute()
        answer = pool.submit(command, mine)
        eventually("it is executed", lambda: len(swarm.history()) == len(twin.history()))
        assert not answer.done()
        wire.cut()
        assert answer.result(MAX_WAIT_SECS) == expected
    after, twins = swarm.status(), twin.status()
    assert (after.seq, after.state_hash, after.scheduled) == (
        twins.seq,
        twins.state_hash,
        twins.scheduled,
    )


def test_a_swarm_whose_create_reply_is_lost_is_recognised(
    wire: Wire, client: jostle.Client
) -> None:
    with jostle.connect(wire.endpoint) as mine, ThreadPoolExecutor(1) as pool:
        wire.mute()
        creation = pool.submit(mine.create, "unheard", jostle.Spec(n=3))
        eventually("it is created", lambda: "unheard" in [s.swarm for s in client.swarms()])
        wire.cut()
        swarm = creation.result(MAX_WAIT_SECS)
        assert swarm.status().n == 3
        wire.mute()
        deletion = pool.submit(swarm.delete)
        eventually("it is deleted", lambda: "unheard" not in [s.swarm for s in client.swarms()])
        wire.cut()
        assert deletion.result(MAX_WAIT_SECS).swarm == "unheard"


def test_a_long_step_survives_a_cut_and_gets_one_reply(wire: Wire, create: Create) -> None:
    swarm = create(n=100)
    with jostle.connect(wire.endpoint) as client, ThreadPoolExecutor(1) as pool:
        answer = pool.submit(client.swarm(swarm.name).step, 1000)
        swarm.wait(phase="running", timeout=MAX_WAIT_SECS)
        wire.cut()
        result = answer.result(MAX_WAIT_SECS)
    assert (result.steps, result.step, swarm.status().step) == (1000, 1000, 1000)


def test_a_connection_cut_repeatedly_loses_and_repeats_nothing(wire: Wire, create: Create) -> None:
    swarm = create(n=1)
    with jostle.connect(wire.endpoint) as client, ThreadPoolExecutor(1) as pool:
        mine = client.swarm(swarm.name)

        def work() -> list[int]:
            return [mine.set(pi3=1.0 + number / 128).seq for number in range(60)]

        answers = pool.submit(work)
        seen = -1
        while not answers.done():
            # A cut after each bit of progress.
            seq = swarm.status().seq
            if seq >= seen + 12:
                seen = seq
                wire.cut()
        assert answers.result() == list(range(1, 61))
    assert [entry.args["pi3"] for entry in swarm.journal()] == [
        1.0 + number / 128 for number in range(60)
    ]


def test_a_request_is_not_sent_again_to_another_daemon(tmp_path: Path) -> None:
    folders = tmp_path / "first", tmp_path / "second"
    for folder in folders:
        folder.mkdir()
    first, second = Daemon(folders[0]), Daemon(folders[1])
    wire = Wire(first.endpoint)
    try:
        with (
            jostle.connect(first.endpoint) as one,
            jostle.connect(second.endpoint) as other,
            jostle.connect(wire.endpoint) as client,
            ThreadPoolExecutor(1) as pool,
        ):
            swarms = [each.create("same", jostle.Spec(n=3)) for each in (one, other)]
            # The claims of the name are read once a connection: here, and not while it is muted, so
            # that the connection does not reach the end of its lease.
            assert client.swarm("same").status().seq == 0
            wire.mute()
            answer = pool.submit(client.swarm("same").inject, 1)
            eventually("it is executed", lambda: swarms[0].status().seq == 1)
            wire.daemon = second.endpoint
            wire.cut()
            with pytest.raises(jostle.Unavailable):
                answer.result(MAX_WAIT_SECS)
            # From now on the client is connected to this one.
            eventually("the client is connected to it", lambda: is_at(client, seq=0))
            assert swarms[1].status().seq == 0
    finally:
        wire.close()
        first.kill()
        second.kill()


def is_at(client: jostle.Client, seq: int) -> bool:
    try:
        return client.swarm("same").status().seq == seq
    except jostle.JostleError:
        return False


def test_a_given_request_id_names_one_command_across_clients(
    daemon: Daemon, create: Create
) -> None:
    swarm = create(n=3)

    def inject(client: str, count: int = 1) -> jostle.IdsResult:
        with jostle.connect(daemon.endpoint, client=client) as mine:
            return mine.swarm(swarm.name).inject(count, request_id="night 1")

    first = inject("ada")
    assert first.ids == [3]
    assert inject("ada") == first
    with pytest.raises(jostle.Conflict) as caught:
        inject("ada", count=2)
    assert caught.value.details["field"] == "request_id"
    assert inject("bob").ids == [4]
    assert swarm.status().n == 5
    wrong: list[Any] = ["", "a" * 257, 7, b"bytes"]
    for request_id in wrong:
        with pytest.raises(jostle.InvalidArgument) as refused:
            swarm.pause(request_id=request_id)
        assert refused.value.details == {"field": "request_id"}


def test_a_rejected_command_can_be_retried_under_its_id(create: Create) -> None:
    swarm = create(n=3)
    with pytest.raises(jostle.Conflict):
        swarm.set(pi3=2.0, request_id="again", expect_step=5)
    swarm.step(5)
    assert swarm.set(pi3=2.0, request_id="again", expect_step=5).now.pi3 == 2.0


class BusyDaemon:
    """A daemon that replies `busy` a number of times, and then executes."""

    def __init__(self, endpoint: str, times: int) -> None:
        self.session = zenoh_session(endpoint, "listen")
        self.times = times
        self.received: list[dict[str, Any]] = []
        self.unanswered: list[zenoh.Query] = []
        self.is_deaf = False
        self.keep = [
            self.session.liveliness().declare_token("jostle/@node/busy/alive"),
            self.session.liveliness().declare_token("jostle/school/alive/busy"),
            self.session.declare_queryable("jostle/@node/busy/get/hello", self.hello),
            self.session.declare_queryable("jostle/school/**", self.answer),
        ]

    def hello(self, query: zenoh.Query) -> None:
        """Replies to `hello`."""
        limits = dict.fromkeys(jostle.Limits.__struct_fields__, 1 << 20)
        result = {"version": "0", "wire_version": 1, "unix_secs": 0.0, "limits": limits}
        query.reply(query.key_expr, json.dumps({"node": "busy", "result": result}))

    def answer(self, query: zenoh.Query) -> None:
        """Records the request and replies with the common fields."""
        payload = query.payload
        if self.is_deaf:
            # A query that is dropped ends without a reply.
            self.unanswered.append(query)
            self.is_deaf = False
            return
        self.received.append({} if payload is None else json.loads(payload.to_bytes()))
        if len(self.received) <= self.times:
            error: dict[str, Any] = {
                "code": "busy",
                "message": "later",
                "details": {},
                "step": None,
            }
            query.reply_err(json.dumps(error))
            return
        place = {"swarm": "school", "epoch": 1, "step": 0, "time": 0.0, "phase": "paused"}
        query.reply(query.key_expr, json.dumps({**place, "seq": 1, "result": {}}))


@pytest.fixture
def busy_daemon(free_endpoint: str) -> Iterator[BusyDaemon]:
    daemon = BusyDaemon(free_endpoint, times=3)
    yield daemon
    daemon.session.close()


def test_a_request_is_sent_again_unchanged_to_a_busy_daemon(
    busy_daemon: BusyDaemon, free_endpoint: str
) -> None:
    with jostle.connect(free_endpoint, timeout=10.0) as client:
        assert client.swarm("school").pause(expect_step=0).seq == 1
    received = busy_daemon.received
    assert len(received) == 4
    waits = [request.pop("timeout_secs") for request in received]
    assert waits == sorted(set(waits), reverse=True)
    assert waits[0] == 10.0
    assert received == [received[0]] * 4


def test_a_lost_request_is_sent_again(busy_daemon: BusyDaemon, free_endpoint: str) -> None:
    busy_daemon.times = 0
    with jostle.connect(free_endpoint) as client:
        for call in (client.swarm("school").pause, client.swarm("school").delete):
            busy_daemon.is_deaf = True
            busy_daemon.received.clear()
            assert call().seq == 1
            assert len(busy_daemon.received) == 1
            lost = busy_daemon.unanswered.pop().payload
            assert lost is not None
            first, again = json.loads(lost.to_bytes()), busy_daemon.received[0]
            assert first.pop("timeout_secs") > again.pop("timeout_secs") > 1.0
            assert first == again
        busy_daemon.is_deaf = True
        with pytest.raises(jostle.Unavailable, match="sent no reply"):
            client.swarm("school").pause(timeout=0.2)
        busy_daemon.unanswered.clear()


def test_a_daemon_that_stays_busy_is_an_error_at_the_deadline(
    busy_daemon: BusyDaemon, free_endpoint: str
) -> None:
    busy_daemon.times = 1_000_000
    with jostle.connect(free_endpoint, timeout=0.5) as client:
        calls: list[Callable[[], object]] = [
            client.swarm("school").pause,
            # The timeout of the request is an hour.
            client.swarm("school").step,
            client.swarm("school").status,
        ]
        for call in calls:
            began = time.monotonic()
            busy_daemon.received.clear()
            with pytest.raises(jostle.Busy, match="later"):
                call()
            assert time.monotonic() - began < MAX_WAIT_SECS
            assert 2 < len(busy_daemon.received) < 50


def is_at_step(swarm: jostle.Swarm, step: int) -> bool:
    return swarm.status().step == step


def test_the_state_of_a_lost_reply_is_fetched_in_lock_step(wire: Wire, create: Create) -> None:
    swarm, twin = create(n=200, seed=1), create(n=200, seed=1)
    with jostle.connect(wire.endpoint) as client, ThreadPoolExecutor(1) as pool:
        controller = client.swarm(swarm.name).join("ada", jostle.ids([0, 1, 2]), deadline=60)
        for step in (2, 4):
            wire.mute()
            reached = pool.submit(controller.advance, 2, direction=0.5, state=True)
            eventually("it is executed", functools.partial(is_at_step, swarm, step))
            wire.cut()
            arrived = reached.result(MAX_WAIT_SECS)
            state = swarm.state()
            assert (arrived.steps, arrived.step, controller.step) == (2, step, step)
            assert arrived.state.x.tobytes() == state.x.tobytes()
            assert arrived.state.alpha.tobytes() == state.alpha.tobytes()
            assert arrived.state.state_hash == arrived.state_hash == swarm.status().state_hash
            # The daemon lost the controller with its connection; directions are held.
            controller.sync()
    others = twin.join("ada", jostle.ids([0, 1, 2]), deadline=60)
    others.advance(2, direction=0.5)
    others.advance(2, direction=0.5)
    assert twin.status().state_hash == swarm.status().state_hash


def test_the_state_of_a_lost_reply_is_not_taken_from_a_changed_swarm(
    wire: Wire, create: Create
) -> None:
    swarm = create(n=200)
    with jostle.connect(wire.endpoint) as client, ThreadPoolExecutor(1) as pool:
        # The first request of a connection checks which daemons claim the swarm.
        client.swarm(swarm.name).status()
        wire.mute()
        reached = pool.submit(client.swarm(swarm.name).step, 2, state=True)
        eventually("it is executed", lambda: swarm.status().step == 2)
        swarm.inject(1)
        wire.cut()
        with pytest.raises(jostle.Conflict, match="led to step 2") as caught:
            reached.result(MAX_WAIT_SECS)
    assert caught.value.step == 2
    assert swarm.status().step == 2


def test_a_controller_killed_before_the_reply_comes_back_at_the_step_reached(
    wire: Wire, create: Create
) -> None:
    swarm = create(n=200)
    program = (
        "import jostle, sys\n"
        "controller = jostle.connect(sys.argv[1]).swarm(sys.argv[2]).join('ada', deadline=60)\n"
        "print('joined', flush=True)\n"
        "sys.stdin.readline()\n"
        "controller.advance(3, state=True)\n"
        "print('received', flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, wire.endpoint, swarm.name],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        assert child.stdout.readline() == "joined\n"
        wire.mute()
        child.stdin.write("\n")
        child.stdin.flush()
        eventually("it is executed", lambda: swarm.status().step == 3)
        child.kill()
        assert child.stdout.read() == ""
    wire.cut()
    eventually("it has left", lambda: not swarm.controllers())
    again = swarm.join("ada")
    assert again.step == 3
    arrived = again.advance(state=True)
    assert (arrived.step, arrived.state.step) == (4, 4)
