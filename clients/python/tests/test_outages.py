"""Short outages: what each call sees of each fault is in `tests/outages.toml` of the repository."""

from __future__ import annotations

import contextlib
import json
import math
import random
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import jostle
from conftest import MAX_WAIT_SECS, ROOT, Daemon, Router, eventually
from jostle import _outage, _retry, _session
from outage_client import LAST_CONDITION, LAST_NOTE, SHORT_TIMEOUT_SECS

TABLE = tomllib.loads((ROOT / "tests" / "outages.toml").read_text())
FAULTS = {fault["name"]: fault for fault in TABLE["faults"]}
FORMS = ("jostle", "aio")
# The calls that are made again and again, and those that take as long as the outage.
REQUESTS = ("read", "short_read", "command", "advance")
# These outages take longer in total than the default suite should.
SLOW = ("stopped_1", "stopped_8", "stopped_15", "suspended")
# How much longer than its timeout a request may take, as documented, and on a busy machine.
GRACE_SECS = 2.0
TOLERANCE_SECS = 20.0
# The swarms reach it long after the outage, or at once without a rate.
LAST_STEP = 20_000


class Scene:
    """A daemon, perhaps a router, and a client in its own process that makes every call."""

    def __init__(self, folder: Path, is_routed: bool) -> None:
        self.daemon = Daemon(folder)
        self.folder = folder
        self.is_suspended = False
        self.router = Router(self.daemon.endpoint) if is_routed else None
        endpoint = self.daemon.endpoint if self.router is None else self.router.endpoint
        with jostle.connect(self.daemon.endpoint) as client:
            for form in FORMS:
                for swarm in (form, f"{form}-run"):
                    client.create(swarm, jostle.Spec(n=3, seed=1)).run(rate=1.0)
                client.create(f"{form}-steered", jostle.Spec(n=3, seed=1))
        program = Path(__file__).with_name("outage_client.py")
        if is_routed:
            eventually("the router reaches the daemon", lambda: is_reached(endpoint))
        self.process = subprocess.Popen(
            [sys.executable, program, endpoint, str(LAST_STEP)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lines: list[str] = []
        self._news = threading.Condition()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        assert self._line(0) == "ready\n"

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                with self._news:
                    self._lines.append(line)
                    self._news.notify_all()

    def _line(self, number: int) -> str:
        with self._news:
            assert self._news.wait_for(lambda: len(self._lines) > number, 2 * MAX_WAIT_SECS)
        return self._lines[number]

    def stop_daemon(self, seconds: float) -> None:
        """Stops the daemon for a time."""
        self.daemon.freeze()
        time.sleep(seconds)
        self.daemon.thaw()

    def restart_daemon(self, seconds: float) -> None:
        """Kills the daemon, and starts it again after a time."""
        self.daemon.kill()
        time.sleep(seconds)
        self.daemon = Daemon(self.folder, listen=self.daemon.endpoint)

    def restart_router(self, seconds: float) -> None:
        """Kills the router, and starts it again after a time."""
        assert self.router is not None
        self.router.close()
        time.sleep(seconds)
        self.router = Router(self.daemon.endpoint, listen=self.router.endpoint)

    def suspend_client(self, seconds: float) -> None:
        """Stops the client for a time."""
        self.is_suspended = True
        self.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)

    def finish(self) -> dict[str, Any]:
        """Lets the calls succeed after the outage; returns what the client has seen."""
        with jostle.connect(self.daemon.endpoint, timeout=MAX_WAIT_SECS) as client:
            for form in FORMS:
                client.swarm(form).inform(jostle.count(1), direction=0.0)
                for swarm in (form, f"{form}-run"):
                    client.swarm(swarm).run(until_step=LAST_STEP, rate=None, wait=True)
            assert self.process.stdin is not None
            self.process.stdin.write("over\n")
            self.process.stdin.flush()
            for form in FORMS:
                client.swarm(form).annotate(LAST_NOTE)
            found: dict[str, Any] = json.loads(self._line(1))
            journals = {form: client.swarm(form).journal() for form in FORMS}
        found["journal"] = {
            form: [entry.args["text"] for entry in entries if entry.verb == "annotate"]
            for form, entries in journals.items()
        }
        assert self.process.wait(MAX_WAIT_SECS) == 0
        return found

    def close(self) -> None:
        """Ends all processes."""
        self.process.kill()
        self.process.wait()
        self._listener.join(MAX_WAIT_SECS)
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        if self.router is not None:
            self.router.close()
        if self.daemon.process.poll() is None:
            self.daemon.kill()


def is_reached(endpoint: str, node: str | None = None) -> bool:
    try:
        jostle.connect(endpoint, node=node).close()
    except jostle.JostleError:
        return False
    return True


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[[str], Scene]]:
    """Starts the scene of a fault, and ends it after the test."""
    scenes: list[Scene] = []

    def start(fault: str) -> Scene:
        scenes.append(Scene(tmp_path, fault == "router"))
        return scenes[-1]

    yield start
    for scene in scenes:
        scene.close()


def inflict(scene: Scene, name: str) -> tuple[float, float]:
    """Lets the fault happen; returns when it begins and ends."""
    began = time.monotonic()
    kinds = {
        "stopped": scene.stop_daemon,
        "router": scene.restart_router,
        "restarted": scene.restart_daemon,
        "suspended": scene.suspend_client,
    }
    kinds[name.partition("_")[0]](FAULTS[name]["secs"])
    return began, time.monotonic()


@pytest.mark.parametrize(
    "name", [pytest.param(it, marks=[pytest.mark.slow] if it in SLOW else []) for it in FAULTS]
)
def test_each_call_sees_what_the_table_says(name: str, start: Callable[[str], Scene]) -> None:
    scene = start(name)
    outage = inflict(scene, name)
    found = scene.finish()
    wrong = [
        f"{form} {call} should see {expected}: {problem}"
        for form in FORMS
        for call, expected in FAULTS[name]["seen"].items()
        if (problem := differs(form, call, expected, found, outage, scene))
    ]
    assert wrong == []
    for form in FORMS:
        events = found["got"][f"{form} events"]
        numbers = [number for number, _, _ in events]
        # The number jumps at a restart; no event is missing.
        assert numbers == sorted(set(numbers))
        notes = [text for _, _, text in events if text.startswith("note ") or text == LAST_NOTE]
        journal = found["journal"][form]
        before = journal[: journal.index(LAST_NOTE) + 1]
        assert notes == before[len(before) - len(notes) :]
        assert len(journal) == len(set(journal)), "a command was executed twice"
        assert set(found["got"][f"{form} command"]) <= set(journal), "a command was not executed"
        states = [tuple(place) for place in found["got"][f"{form} states"]]
        assert states == sorted(set(states))


def differs(
    form: str,
    call: str,
    expected: str,
    found: dict[str, Any],
    outage: tuple[float, float],
    scene: Scene,
) -> str | None:
    """How what a call saw differs from the table; None if it does not."""
    attempts = found["seen"][f"{form} {call}"]
    codes = {code for _, _, code in attempts if code is not None}
    if expected not in ("goes_on", "reconnects"):
        if codes != {expected}:
            return f"{codes or 'no error'}"
        failed = [end - began for began, end, code in attempts if code == "unavailable"]
        most = SHORT_TIMEOUT_SECS + GRACE_SECS + TOLERANCE_SECS
        # Its last attempt is not later than its timeout, and the delay before is at most as long.
        if not all(SHORT_TIMEOUT_SECS / 4 <= seconds <= most for seconds in failed):
            return f"it took {failed} s"
    elif codes:
        return f"{codes}"
    waits = {
        "states": f"the stream of states of swarm {form!r} ",
        "events": f"the stream of events of swarm {form!r} ",
        "wait": f"the wait for step={LAST_STEP} of swarm {form!r} ",
        "condition": f"the wait for {LAST_CONDITION} of swarm {form!r} ",
        "run": f"the wait for step={LAST_STEP} of swarm {form + '-run'!r} ",
    }
    if call in waits:
        lines = [(level, text) for _, level, text in found["said"] if waits[call] in text]
        kinds = [(level, "is not reachable: " in text) for level, text in lines]
        warnings = [("WARNING", True), ("WARNING", False)]
        if kinds != (warnings if expected == "reconnects" else []):
            return f"it said {lines}"
    elif expected == "goes_on" and not scene.is_suspended:
        attempts = found["seen"][f"{form} {call}"]
        longest = max(end - began for began, end, _ in attempts)
        during = [it for it in attempts if it[0] < outage[1] and it[1] > outage[0]]
        if not during or longest < 0.8 * (outage[1] - outage[0]):
            return f"the longest took {longest:.1f} s"
    return None


def test_the_page_has_the_table() -> None:
    words = {"goes_on": "go on", "reconnects": "reconnect and say so", None: ""}
    page = (ROOT / "docs" / "guarantees.md").read_text()
    for fault in TABLE["faults"]:
        seen = fault["seen"]
        assert seen["read"] == seen["command"]
        assert len({seen[call] for call in ("states", "events", "wait", "condition", "run")}) == 1
        columns = [seen.get(call) for call in ("read", "short_read", "states", "advance")]
        cells = [words.get(it, f"`{it}`") for it in columns]
        row = f"| {' | '.join([fault['fault'], *cells])} |".replace("|  |", "| |")
        assert row in page


def test_the_delays_are_those_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    policy = TABLE["retries"]
    waited: list[float] = []
    monkeypatch.setattr(_retry, "sleep", waited.append)
    for share in (0.0, 1.0):
        monkeypatch.setattr(
            random, "uniform", lambda low, high, share=share: low + share * (high - low)
        )
        backoff = _retry.Backoff(time.monotonic(), 1000.0, 1000.0)
        for _ in range(8):
            backoff.sleep(jostle.Busy("later"))
    delay, expected = policy["first_delay_secs"], []
    for _ in range(8):
        expected.append(delay)
        delay = min(policy["growth"] * delay, policy["max_delay_secs"])
    shares = (1.0 - policy["jitter"], 1.0 + policy["jitter"])
    assert waited == pytest.approx([share * delay for share in shares for delay in expected])
    assert policy["max_silent_retries"] == _retry.MAX_SILENT_RETRIES
    assert policy["forgotten_commands"] == list(_retry.FORGOTTEN_COMMANDS)
    assert TABLE["limits"]["wait_secs"] == _outage.RECONNECT_TIMEOUT_SECS


def test_each_outage_of_a_wait_has_its_own_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(_retry, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(_retry, "sleep", lambda _: None)
    limit, gone = TABLE["limits"]["wait_secs"], jostle.Unavailable("gone")
    backoff = _retry.Backoff(now, math.inf, limit)
    for _ in range(3):
        for passed in (0.0, limit - 2.0):
            now += passed
            backoff.sleep(gone)
        # An attempt does not fail.
        backoff.reset()
        now += 1.0
    backoff.sleep(gone)
    now += limit
    with pytest.raises(jostle.Unavailable):
        backoff.sleep(gone)


def test_a_command_in_flight_goes_on_behind_a_restarted_router(own_daemon: Daemon) -> None:
    router = Router(own_daemon.endpoint)
    try:
        eventually("the router reaches the daemon", lambda: is_reached(router.endpoint))
        with (
            jostle.connect(own_daemon.endpoint) as near,
            jostle.connect(router.endpoint, timeout=MAX_WAIT_SECS) as far,
            ThreadPoolExecutor(1) as pool,
        ):
            swarm = near.create("long", jostle.Spec(n=100, seed=1))
            result = pool.submit(far.swarm("long").step, 1000)
            swarm.wait(phase="running", timeout=MAX_WAIT_SECS)
            router.close()
            router = Router(own_daemon.endpoint, listen=router.endpoint)
            assert result.result(MAX_WAIT_SECS).steps == 1000
            assert swarm.status().step == 1000
    finally:
        router.close()


def change_often(client: jostle.Client, number: int, is_over: threading.Event) -> list[str]:
    """Sends commands, one after the other, to the swarm and to the daemon; returns their names."""
    sent: list[str] = []
    swarm = client.swarm("school")
    while not is_over.is_set():
        sent.append(f"{number}-{len(sent)}")
        if number == 0:
            client.create(sent[-1], jostle.Spec(n=1)).delete()
        else:
            swarm.set(pi3=(100 * len(sent) + number) / 1e6)
    return sent


def test_commands_in_flight_at_a_kill_are_executed_once(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)
    numbers, is_over = range(6), threading.Event()
    try:
        with (
            jostle.connect(daemon.endpoint, timeout=MAX_WAIT_SECS) as client,
            ThreadPoolExecutor(len(numbers)) as pool,
        ):
            client.create("school", jostle.Spec(n=3))
            sent = [pool.submit(change_often, client, number, is_over) for number in numbers]
            try:
                for _ in range(3):
                    time.sleep(0.5)
                    daemon.kill()
                    daemon = Daemon(tmp_path, daemon.endpoint)
                time.sleep(0.5)
            finally:
                is_over.set()
            counts = {
                number: len(it.result(MAX_WAIT_SECS))
                for number, it in zip(numbers, sent, strict=True)
            }
            journal = [
                it.args["pi3"] for it in client.swarm("school").journal() if it.verb == "set"
            ]
            assert [it.swarm for it in client.swarms()] == ["school"]
    finally:
        daemon.kill()
    expected = [(100 * (k + 1) + it) / 1e6 for it in numbers if it for k in range(counts[it])]
    assert sorted(journal) == sorted(expected)
    assert min(counts.values()) > 0


@pytest.mark.parametrize("breaks", [False, True])
def test_without_time_to_ask_again_only_a_connection_that_holds_tells_what_is_missing(
    breaks: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path)
    try:
        with jostle.connect(daemon.endpoint) as client:
            session = client._session
            waited: list[float] = []

            def wait(seconds: float) -> None:
                waited.append(seconds)
                if breaks:
                    daemon.kill()
                    eventually("the connection is lost", lambda: not session.connected())

            monkeypatch.setattr(_session, "sleep", wait)
            expected = jostle.Unavailable if breaks else jostle.NotFound
            with pytest.raises(expected):
                session.get(session.swarm_key("none", "get/status"), swarm="none", timeout=0.01)
            assert waited == [_retry.FIRST_DELAY_SECS]
    finally:
        daemon.kill()


def test_a_command_is_not_sent_again_to_a_daemon_with_other_data(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    daemon = Daemon(tmp_path / "a", node="lab")
    try:
        with (
            jostle.connect(daemon.endpoint, timeout=MAX_WAIT_SECS) as client,
            ThreadPoolExecutor(1) as pool,
        ):
            swarm = client.create("school", jostle.Spec(n=100))
            result = pool.submit(swarm.step, 10**7)
            swarm.wait(phase="running", timeout=MAX_WAIT_SECS)
            daemon.kill()
            daemon = Daemon(tmp_path / "b", daemon.endpoint, node="lab")
            with jostle.connect(daemon.endpoint) as other:
                other.create("school", jostle.Spec(n=100))
            with pytest.raises(jostle.Unavailable):
                result.result(MAX_WAIT_SECS)
            assert swarm.status().step == 0
    finally:
        daemon.kill()


def test_a_daemon_that_is_away_is_told_from_the_others_behind_its_router(tmp_path: Path) -> None:
    daemons = {}
    for node in ("a", "b"):
        (tmp_path / node).mkdir()
        daemons[node] = Daemon(tmp_path / node, node=node)
    endpoint = daemons["a"].endpoint
    router = Router(*(daemon.endpoint for daemon in daemons.values()))
    try:
        for node in daemons:
            eventually(f"{node} is reached", lambda: is_reached(router.endpoint, node))  # noqa: B023
        with (
            jostle.connect(router.endpoint, node="a", timeout=MAX_WAIT_SECS) as client,
            ThreadPoolExecutor(3) as pool,
        ):
            swarm = client.create("school", jostle.Spec(n=3))
            assert swarm.status().step == 0
            states = swarm.states(timeout=2 * MAX_WAIT_SECS)
            assert next(states).step == 0
            daemons["a"].kill()
            status, hello = pool.submit(swarm.status), pool.submit(client.hello)
            state = pool.submit(lambda: next(states, None))
            # Long enough for the router to have forgotten its keys.
            time.sleep(0.5)
            daemons["a"] = Daemon(tmp_path / "a", endpoint, node="a")
            assert status.result(MAX_WAIT_SECS).epoch == 2
            assert hello.result(MAX_WAIT_SECS).node == "a"
            present = state.result(MAX_WAIT_SECS)
            assert present is not None, "the stream has ended"
            assert present.epoch == 2
    finally:
        router.close()
        for daemon in daemons.values():
            daemon.kill()
