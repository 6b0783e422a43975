"""Each error as a user sees it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh

import jostle
from conftest import MAX_WAIT_SECS, Daemon, eventually, zenoh_session
from jostle._errors import read_error
from recorder import Recorder

Create = Callable[..., jostle.Swarm]


def test_without_a_daemon_the_error_comes_within_the_timeout_with_a_remedy() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable, match="jostled serve") as caught:
            jostle.connect(endpoint, timeout=0.3)
    assert f"{endpoint}, tried for 0.3 s" in caught.value.message
    assert time.monotonic() - began < MAX_WAIT_SECS


def test_another_program_that_listens_does_not_block_the_caller() -> None:
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable, match="may hang"):
            jostle.connect(f"tcp/127.0.0.1:{mute.getsockname()[1]}", timeout=0.3)
    # zenoh alone waits for 10 s.
    assert time.monotonic() - began < 8.0


def test_a_host_without_an_address_is_named() -> None:
    with pytest.raises(jostle.Unavailable, match=r"the host 'no-such-host\.invalid'"):
        jostle.connect("tcp/no-such-host.invalid:7447", timeout=0.3)


def test_a_missed_timeout_is_that_of_the_caller_with_the_words_of_this_package(
    create: Create,
) -> None:
    swarm = create(n=50)
    for seconds in (0.2, 1.2):
        with pytest.raises(jostle.DeadlineExceeded) as caught:
            swarm.step(10**8, timeout=seconds)
        assert caught.value.message.startswith(f"not done within {seconds} s: ")
        assert "timeout=" in caught.value.message
        assert "timeout_secs" not in caught.value.message
        assert caught.value.details["after_secs"] == seconds
        swarm.pause()
    with pytest.raises(jostle.DeadlineExceeded, match=r"phase=running .*within 0\.3 s: .*timeout="):
        swarm.wait(phase="running", timeout=0.3)


def test_a_run_that_is_waited_for_ends_within_its_timeout(create: Create) -> None:
    swarm = create(n=5)
    began = time.monotonic()
    with pytest.raises(jostle.DeadlineExceeded, match=r"runs on; `pause\(\)` pauses it") as caught:
        swarm.run(until=1e6, wait=True, timeout=0.5)
    assert 0.5 <= time.monotonic() - began < MAX_WAIT_SECS
    assert "within 0.5 s" in caught.value.message
    assert swarm.status().phase == "running"
    swarm.pause()
    assert swarm.run(until_step=swarm.status().step + 5, rate=None, wait=True).phase == "paused"


def test_remedies_of_the_wire_are_in_the_words_of_this_package() -> None:
    for message, expected in [
        (
            'there is no swarm "a": the node\'s get/swarms lists what there is',
            'there is no swarm "a": `client.swarms()` lists them',
        ),
        (
            "an equal swarm of this name exists: set exist_ok to use it",
            "an equal swarm of this name exists: pass `exist_ok=True` to use it",
        ),
        (
            "until_step 5 is in the past, the swarm is at step 6: name a later one",
            "the end, step 5, is in the past, the swarm is at step 6: name a later one",
        ),
    ]:
        sent = {"code": "not_found", "message": message, "details": {}}
        error = read_error(msgspec.json.encode(sent))
        assert error is not None
        assert error.message == expected


def test_the_endpoint_is_read_from_the_environment(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JOSTLE_ENDPOINT", daemon.endpoint)
    with jostle.connect() as client:
        assert client.endpoint == daemon.endpoint
        with jostle.connect(node=client.node) as same:
            assert same.node == client.node


@pytest.mark.parametrize(
    "arguments",
    [
        {"endpoint": "127.0.0.1:7447"},
        {"endpoint": "tcp"},
        {"node": "*"},
        {"prefix": "jostle/*"},
        {"prefix": "/jostle"},
        {"prefix": ""},
        {"client": "a" * 257},
        {"timeout": 0.0},
        {"timeout": float("nan")},
        {"timeout": "5"},
    ],
)
def test_invalid_endpoints_are_rejected(arguments: dict[str, Any]) -> None:
    with pytest.raises(jostle.InvalidArgument):
        jostle.connect(**arguments)


def test_an_unknown_node_or_prefix_is_unavailable(daemon: Daemon) -> None:
    with pytest.raises(jostle.Unavailable, match="unknown-node"):
        jostle.connect(daemon.endpoint, node="unknown-node", timeout=0.3)
    with pytest.raises(jostle.Unavailable, match="prefix"):
        jostle.connect(daemon.endpoint, prefix="elsewhere", timeout=0.3)


def test_every_call_raises_not_found(client: jostle.Client) -> None:
    swarm = client.swarm("unknown")
    calls: list[Callable[[], object]] = [
        swarm.status,
        swarm.state,
        swarm.spec,
        swarm.states,
        swarm.orders,
        swarm.events,
        swarm.pause,
        swarm.delete,
        lambda: swarm.step(3, state=True),
        lambda: swarm.wait(step=1),
    ]
    for call in calls:
        with pytest.raises(jostle.NotFound, match="unknown"):
            call()


def test_invalid_arguments_name_the_field(client: jostle.Client, create: Create) -> None:
    swarm = create(n=3)
    calls: list[tuple[str, Callable[[], object]]] = [
        ("steps", lambda: swarm.step(0)),
        ("steps", lambda: swarm.step(1.5)),  # type: ignore[call-overload]
        ("direction", lambda: swarm.inform(jostle.count(1), "east")),  # type: ignore[arg-type]
        ("direction", lambda: swarm.inform(jostle.count(1), np.nan)),
        ("pi1", lambda: swarm.set(pi1=0.5)),
        ("ids", lambda: swarm.inform(jostle.ids([99]), 0.0)),
        ("fraction", lambda: swarm.inform(jostle.fraction(1.5), 0.0)),
        ("colour", lambda: client.create("a", {"n": 1, "colour": "red"})),
        ("n", lambda: client.create("a", {})),
        ("n", lambda: client.create("a", jostle.Spec(n=0))),
        ("x", lambda: client.create("a", jostle.Spec(n=2, start=jostle.given([0], [0], [0])))),
        ("timeout", lambda: swarm.pause(timeout=-1.0)),
        ("timeout", lambda: swarm.pause(timeout=1e9)),
    ]
    for field, call in calls:
        with pytest.raises(jostle.InvalidArgument) as caught:
            call()
        error = caught.value
        assert field in f"{error.message} {error.details}", error
    with pytest.raises(TypeError, match=r"^pause\(\) got an unexpected .*'expect_stop'"):
        swarm.pause(expect_stop=3)  # type: ignore[call-arg]
    assert swarm.status().seq == 0


def test_none_is_called_none(client: jostle.Client, create: Create) -> None:
    swarm: Any = create(n=6)
    anyone = jostle.count(1)
    nothing: Any = None
    calls: dict[str, Callable[[], object]] = {
        "rate": lambda: swarm.run(rate=-1),
        "args": lambda: swarm.set(pi1=None),
        "direction": lambda: swarm.inform(anyone, None),
        "select": lambda: swarm.inform(None, 0.0),
        "select.ids": lambda: swarm.inform(jostle.ids(nothing), 0.0),
        "select.fraction": lambda: swarm.remove(jostle.fraction(nothing)),
        "steps": lambda: swarm.step(None),
        "commands": lambda: swarm.batch(None),
        "commands[0].args.direction": lambda: swarm.batch([jostle.Inform(anyone, nothing)]),
        "commands[0]": lambda: swarm.batch([None]),
        "spec": lambda: client.create("none", nothing),
        "spec.pi1": lambda: client.create("none", {"n": 3, "pi1": None}),
        "spec.rate": lambda: client.create("none", {"n": 3, "rate": -1}),
        "snapshot": lambda: client.restore(nothing, "none"),
    }
    for field, call in calls.items():
        with pytest.raises(jostle.InvalidArgument, match=r"None|not a snapshot") as raised:
            call()
        assert raised.value.details["field"] == field
        assert "null" not in f"{raised.value} {raised.value.details}"
    with pytest.raises(TypeError, match="unexpected keyword argument 'x'"):
        swarm.set(x=None)
    # A value of the caller named null keeps its name.
    with pytest.raises(jostle.NotFound, match="null"):
        client.swarm("null").status()
    error = read_error(
        b'{"code": "invalid_argument", "message": "x: invalid type: boolean `true`, expected a'
        b' number: give null, or a \\"null\\"", "details": {"range": "null, or a \\"null\\""}}'
    )
    assert str(error) == (
        'x: invalid type: boolean `True`, expected a number: give None, or a "null"'
    )


def test_a_step_of_a_running_swarm_is_an_incorrect_state(create: Create) -> None:
    swarm = create(n=2)
    swarm.run()
    with pytest.raises(jostle.IncorrectState) as caught:
        swarm.step()
    assert caught.value.step is not None


def test_limits_of_the_daemon_are_errors(client: jostle.Client) -> None:
    with pytest.raises(jostle.ResourceExhausted):
        client.create("crowd", jostle.Spec(n=50, start=jostle.disc(0.5)))
    numbers = np.full(60_000, 0.1234567890123456)
    spec = jostle.Spec(n=60_000, start=jostle.given(numbers, numbers, numbers))
    with pytest.raises(jostle.ResourceExhausted, match="max_message_bytes") as caught:
        client.create("long", spec)
    assert caught.value.details["max"] == client.hello().limits.max_message_bytes
    assert caught.value.details["got"] > caught.value.details["max"]


def test_the_longest_request_allowed_reaches_the_daemon(client: jostle.Client) -> None:
    limit = client.hello().limits.max_message_bytes
    with pytest.raises(jostle.InvalidArgument):
        client.create("padded", {"n": 1, "contacts": "x" * (limit - 400)})
    with pytest.raises(jostle.ResourceExhausted, match="max_message_bytes"):
        client.create("padded", {"n": 1, "contacts": "x" * limit})


def test_another_step_or_epoch_than_expected_is_a_conflict(create: Create) -> None:
    swarm = create(n=2)
    swarm.step(3, expect_step=0)
    with pytest.raises(jostle.Conflict) as caught:
        swarm.set(pi3=2.0, expect_step=0)
    assert caught.value.step == 3
    epoch = swarm.status().epoch
    with pytest.raises(jostle.Conflict):
        swarm.pause(expect_epoch=epoch + 1)
    assert swarm.pause(expect_step=3, expect_epoch=epoch).step == 3
    assert swarm.status().parameters.pi3 == 1.0
    with pytest.raises(jostle.Conflict):
        swarm.run(until_step=1)


def test_a_deadline_is_an_error_and_the_work_continues(create: Create) -> None:
    swarm = create(n=100)
    with pytest.raises(jostle.DeadlineExceeded):
        swarm.step(2000, timeout=0.05)
    assert swarm.wait(phase="paused").step == 2000


def test_a_wait_that_the_daemon_ends_early_is_sent_again(
    daemon: Daemon, create: Create, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = create(n=2)
    link = swarm._session
    get_once = link.get_once
    sent: list[str] = []

    def spy(selector: str, *, swarm: str | None, timeout: float) -> bytes:
        if "/get/wait?" in selector:
            sent.append(selector)
        return get_once(selector, swarm=swarm, timeout=timeout)

    monkeypatch.setattr(link, "get_once", spy)
    selector = f"jostle/{swarm.name}/get/wait?phase=running;timeout_secs=30"
    with zenoh_session(daemon.endpoint) as session, ThreadPoolExecutor(1) as pool:
        held: list[zenoh.Handler[zenoh.Reply]] = []

        def is_sent_again() -> bool:
            held.extend(session.get(selector) for _ in range(100))
            swarm.status()
            return len(sent) >= 2

        # The wait could last longer than this test: the daemon replied early.
        waiting = pool.submit(swarm.wait, phase="running", timeout=10 * MAX_WAIT_SECS)
        eventually("the daemon ends the wait early and the client sends it again", is_sent_again)
        assert len(held) > 1024, "more requests wait than the limit"
        swarm.run()
        assert waiting.result(MAX_WAIT_SECS).phase == "running"


def test_a_fault_is_an_error_and_reset_clears_it(create: Create) -> None:
    # Steps so long that bodies pass through each other.
    for seed in range(20):
        swarm = create(n=100, pi1=2.0, pi2=0.0, pi4=1000.0, dt=0.5, seed=seed, rate=None)
        try:
            swarm.step(2000)
        except jostle.Faulted as error:
            step = error.step
            break
    else:
        pytest.fail("no swarm faulted")
    assert (swarm.status().phase, swarm.status().step) == ("faulted", step)
    with pytest.raises(jostle.IncorrectState):
        swarm.step()
    with pytest.raises(jostle.IncorrectState):
        swarm.set(pi3=0.5)
    with pytest.raises(jostle.Faulted):
        swarm.wait(step=10_000)
    assert swarm.wait(phase="faulted").step == step
    assert swarm.state().step == step
    assert swarm.reset().phase == "paused"
    with pytest.raises(jostle.Faulted):
        swarm.run(until_step=2000, wait=True)


def test_a_defect_of_the_daemon_is_internal_and_changes_nothing(tmp_path: Path) -> None:
    # The second command that changes something triggers a defect.
    daemon = Daemon(tmp_path, failing="command=1*off->1*panic->off")
    try:
        with jostle.connect(daemon.endpoint) as client:
            swarm = client.create("struck", jostle.Spec(n=3))
            swarm.set(pi3=2.0)
            before = swarm.status()
            with pytest.raises(jostle.Internal) as caught:
                swarm.inject(1, request_id="struck")
            assert caught.value.step == 0
            assert swarm.status() == before
            assert swarm.inject(1, request_id="struck").ids == [3]
    finally:
        daemon.kill()


def test_a_step_that_faulted_gets_the_same_error_when_sent_again(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, failing="step=3*off->panic")
    try:
        with jostle.connect(daemon.endpoint) as client:
            swarm = client.create("struck", jostle.Spec(n=3))
            for _ in range(2):
                with pytest.raises(jostle.Faulted) as caught:
                    swarm.step(5, request_id="five")
                assert caught.value.step == 3
            with pytest.raises(jostle.IncorrectState):
                swarm.step(5)
            assert [event.kind for event in swarm.history()] == ["created", "command", "fault"]
    finally:
        daemon.kill()


def test_alive_but_silent_is_not_permitted(free_endpoint: str) -> None:
    # A daemon whose access control drops queries looks like this to a client.
    with zenoh_session(free_endpoint, "listen") as silent:
        token = silent.liveliness().declare_token("jostle/@node/silent/alive")
        with pytest.raises(jostle.PermissionDenied, match="silent"):
            jostle.connect(free_endpoint)
        token.undeclare()


def test_a_killed_daemon_is_unavailable_until_it_is_restarted(own_daemon: Daemon) -> None:
    folder = own_daemon.log.parent
    with (
        jostle.connect(own_daemon.endpoint) as client,
        jostle.connect(own_daemon.endpoint, timeout=0.5) as brief,
    ):
        client.create("lost", jostle.Spec(n=2))
        own_daemon.kill()
        with pytest.raises(jostle.Unavailable):
            brief.swarm("lost").status()
        with pytest.raises(jostle.Unavailable):
            brief.swarms()
        again = Daemon(folder, own_daemon.endpoint)
        try:
            eventually("the client finds the daemon again", lambda: answers(client))
            assert client.create("found", jostle.Spec(n=2)).step(2).step == 2
        finally:
            assert again.stop() == 0


def answers(client: jostle.Client) -> bool:
    try:
        client.hello()
    except jostle.Unavailable:
        return False
    return True


def test_a_daemon_killed_while_it_works_is_unavailable(own_daemon: Daemon) -> None:
    with jostle.connect(own_daemon.endpoint) as client, ThreadPoolExecutor(1) as pool:
        swarm = client.create("doomed", jostle.Spec(n=50))
        work = pool.submit(swarm.step, 1_000_000_000)
        swarm.wait(phase="running")
        own_daemon.kill()
        with pytest.raises(jostle.Unavailable):
            work.result(MAX_WAIT_SECS)


def test_a_frozen_daemon_is_unavailable_after_the_deadline(own_daemon: Daemon) -> None:
    with jostle.connect(own_daemon.endpoint, timeout=0.2) as client:
        swarm = client.create("frozen", jostle.Spec(n=2))
        own_daemon.freeze()
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable):
            swarm.status()
        assert time.monotonic() - began < 8.0
        own_daemon.thaw()
        eventually("the client finds the daemon again", lambda: answers(client))


def test_a_suspended_daemon_is_not_one_without_swarms(own_daemon: Daemon) -> None:
    with jostle.connect(own_daemon.endpoint) as client:
        client.create("suspended", jostle.Spec(n=2))
        session = client._session
        key = session.swarm_key("suspended", "alive/*")
        assert len(session.alive(key)) == 1
        own_daemon.freeze()
        with pytest.raises(jostle.Unavailable, match="no reply"):
            session.alive(key)
        own_daemon.thaw()


def test_a_query_that_ends_at_its_timeout_without_an_error_is_late(free_endpoint: str) -> None:
    with (
        closing(Recorder(free_endpoint)) as recorder,
        jostle.connect(free_endpoint) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        recorder.is_mute = lambda key: key.endswith("/cmd/pause")
        reply = pool.submit(client.swarm("school").pause, timeout=1.3)
        assert recorder.holds(1)
        # The first query has a timeout of 1 s, which zenoh applies on both sides.
        time.sleep(0.95)
        recorder.release()
        reply.result(MAX_WAIT_SECS)
        # Sent again with the rest of the timeout, not as if the daemon had rejected it.
        assert 0 < recorder.repeats[0].body["timeout_secs"] < 0.5


def test_a_closed_client_raises_an_error(daemon: Daemon) -> None:
    client = jostle.connect(daemon.endpoint)
    client.close()
    client.close()
    with pytest.raises(jostle.Unavailable, match="closed"):
        client.swarms()
    with pytest.raises(jostle.Unavailable):
        client.swarm("any").states()


def test_ctrl_c_interrupts_a_wait(free_endpoint: str) -> None:
    recorder = Recorder(free_endpoint)
    recorder.is_mute = lambda key: key.endswith("/get/wait")
    code = (
        "import jostle\n"
        f"swarm = jostle.connect({free_endpoint!r}).swarm('school')\n"
        "swarm.wait(phase='running')\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        # From then on it waits for the daemon only.
        assert recorder.holds(1)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=MAX_WAIT_SECS)
    finally:
        process.kill()
        process.communicate()
        recorder.close()
    assert "KeyboardInterrupt" in errors
    assert process.returncode == -signal.SIGINT


def test_one_client_serves_many_threads(client: jostle.Client, create: Create) -> None:
    swarms = [create(n=2) for _ in range(4)]
    barrier = threading.Barrier(8)

    def work(number: int) -> int:
        barrier.wait()
        swarm = swarms[number % 4]
        for _ in range(20):
            swarm.set(pi3=1.0 + number)
        return swarm.status().seq

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(8)))
    assert [swarm.status().seq for swarm in swarms] == [40] * 4
    assert client.node
    assert os.getpid()


def test_one_client_too_many_gets_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOSTLED_MAX_CLIENTS", "1")
    daemon = Daemon(tmp_path)
    try:
        with jostle.connect(daemon.endpoint) as first:
            assert first.hello().limits.max_clients == 1
            with pytest.raises(jostle.ResourceExhausted, match="raise max_clients") as caught:
                jostle.connect(daemon.endpoint)
            assert caught.value.details["limit"] == 1
            # The rejected client is disconnected.
            eventually("there is space", lambda: first.status().clients == 1)
            assert first.hello().limits.max_clients == 1
    finally:
        daemon.stop()
