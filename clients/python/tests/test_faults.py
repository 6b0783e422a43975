"""Faults of controllers in lock-step: processes, connections, the daemon.

Nothing hangs, the others continue, no step is lost or executed twice, and the journal leads to the
same state when it is replayed.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import jostle
from conftest import MAX_WAIT_SECS, Daemon, Wire, eventually
from steering import directions

Create = Callable[..., jostle.Swarm]
Start = Callable[..., "Program"]

STEERING = Path(__file__).with_name("steering.py")

# The longest deadline. An exchange that takes less did not wait for it.
LONG_SECS = 60
NOT_LONG_SECS = LONG_SECS / 2
# Longer than an exchange on a busy machine, and short enough to be missed three times.
SHORT_SECS = 1.0


class Program:
    """A controller in its own process."""

    def __init__(self, endpoint: str, swarm: str, name: str, *options: object) -> None:
        self.name = name
        self.process = subprocess.Popen(
            [sys.executable, STEERING, endpoint, swarm, name, *map(str, options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.output: list[list[str]] = []
        self._news = threading.Condition()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                with self._news:
                    self.output.append(line.split())
                    self._news.notify_all()

    def printed(self, word: str) -> list[list[str]]:
        """The lines that begin with this word, without it."""
        return [words for first, *words in list(self.output) if first == word]

    @property
    def step(self) -> int:
        """The last step that it printed."""
        steps = self.printed("step")
        return int(steps[-1][0]) if steps else 0

    @property
    def steps(self) -> list[int]:
        """Every step that it printed."""
        return [int(step) for step, _ in self.printed("step")]

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Waits until its output makes this hold."""
        with self._news:
            assert self._news.wait_for(holds, MAX_WAIT_SECS), (
                f"{self.name}: {what}: {self.output[-5:]}"
            )

    def until_step(self, step: int) -> None:
        """Waits until it prints this step."""
        self.until(f"step {step}", lambda: self.step >= step)

    def go_on(self) -> None:
        """Makes it advance, if it waits for that."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def send(self, sent: signal.Signals) -> None:
        """Sends its process a signal."""
        self.process.send_signal(sent)

    def finish(self) -> None:
        """Waits for its end, with exit code 0."""
        assert self.process.wait(MAX_WAIT_SECS) == 0, self.output[-5:]
        self._close()

    def end(self) -> None:
        """Kills it if it still runs."""
        self.process.kill()
        self.process.wait(MAX_WAIT_SECS)
        self._close()

    def _close(self) -> None:
        self._listener.join(MAX_WAIT_SECS)
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts controllers, and ends them after the test."""
    programs: list[Program] = []

    def start(endpoint: str, swarm: str, name: str, *options: object) -> Program:
        programs.append(Program(endpoint, swarm, name, *options))
        return programs[-1]

    yield start
    for program in programs:
        program.end()


class Ada:
    """The other controller, in this process."""

    def __init__(self, swarm: jostle.Swarm, others: int = 1) -> None:
        self.swarm = swarm
        self.controller = swarm.join("ada", jostle.ids([0, 1]), deadline=LONG_SECS)
        self.others = others
        self.longest = 0.0
        self.advanced: list[jostle.Advanced] = []
        # Called when a controller has missed this many deadlines in a row.
        self.on_miss: dict[int, Callable[[], None]] = {}

    def with_(self, other: Program) -> None:
        """Waits for the other one, and advances with it for some steps."""
        other.until("it joins", lambda: bool(other.printed("joined")))
        self.until("both advance", lambda: other.step >= 20)

    def advance(self) -> jostle.Advanced:
        """Advances by one step."""
        began = time.monotonic()
        wanted = directions(self.controller)
        advanced = self.controller.advance(direction=wanted, weight=2.0, timeout=MAX_WAIT_SECS)
        self.longest = max(self.longest, time.monotonic() - began)
        self.advanced.append(advanced)
        for miss in advanced.news.missed:
            if miss.misses in self.on_miss:
                self.on_miss[miss.misses]()
        return advanced

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Advances until this holds."""
        deadline = time.monotonic() + MAX_WAIT_SECS
        while not holds():
            assert time.monotonic() < deadline, f"{what}: not within {MAX_WAIT_SECS} s"
            self.advance()

    @property
    def missed(self) -> list[int]:
        """The consecutive deadlines that others had missed, at each miss."""
        return [miss.misses for advanced in self.advanced for miss in advanced.news.missed]

    @property
    def left(self) -> list[str]:
        """The reasons why others left."""
        return [departed.why for advanced in self.advanced for departed in advanced.news.left]

    def is_whole(self) -> None:
        """Leaves, and verifies the history: every step was executed once, with the same result.

        What is written down of deadlines and departures is all that it needs, and no clock.
        """
        steps = [advanced.step for advanced in self.advanced]
        assert steps == list(range(1, len(steps) + 1))
        self.controller.leave()
        eventually("its history can be verified", self._is_verified)

    def _is_verified(self) -> bool:
        try:
            verified = self.swarm.verify(timeout=MAX_WAIT_SECS)
        except jostle.Conflict as error:
            # Another controller continues, and its steps are durable a moment later.
            if "is not on the disk yet" not in str(error):
                raise
            return False
        assert verified.differs_at is None
        return True


def undisturbed(create: Create, until: int) -> str:
    """The state hash that two controllers reach without a fault."""
    swarm = create(n=20, seed=7)
    one, other = (
        swarm.join("ada", jostle.ids([0, 1])),
        swarm.join("bob", jostle.ids([2, 3])),
    )
    with one, other:
        while one.step < until:
            waiting = threading.Thread(
                target=other.advance, kwargs={"direction": directions(other), "weight": 2.0}
            )
            waiting.start()
            advanced = one.advance(direction=directions(one), weight=2.0)
            waiting.join(MAX_WAIT_SECS)
    return advanced.state_hash


BOB = ("bob", "--ids", 2, 3, "--until")


def pair(swarm: jostle.Swarm, endpoint: str, start: Start, deadline: float) -> tuple[Ada, Program]:
    """Both controllers, after they have advanced for some steps."""
    ada = Ada(swarm)
    bob = start(endpoint, swarm.name, *BOB, 10**6, "--deadline", deadline)
    ada.with_(bob)
    return ada, bob


def test_a_killed_controller_has_left_at_once(create: Create, daemon: Daemon, start: Start) -> None:
    ada, bob = pair(create(n=20, seed=7), daemon.endpoint, start, LONG_SECS)
    bob.process.kill()
    ada.until("bob is lost", lambda: ada.left == ["lost"])
    assert ada.longest < NOT_LONG_SECS, "an exchange waited for the deadline"
    later = len(ada.advanced) + 50
    ada.until("it continues", lambda: len(ada.advanced) >= later)
    assert ada.missed == []
    ada.is_whole()


def test_a_stopped_controller_misses_three_deadlines_and_joins_again(
    create: Create, daemon: Daemon, start: Start
) -> None:
    ada, bob = pair(create(n=20, seed=7), daemon.endpoint, start, SHORT_SECS)
    bob.send(signal.SIGSTOP)
    ada.until("bob has left", lambda: bool(ada.left))
    assert (ada.left, ada.missed[-3:]) == (["late"], [1, 2, 3])
    alone = ada.controller.step + 50
    ada.until("it continues", lambda: ada.controller.step >= alone)
    bob.send(signal.SIGCONT)
    ada.until("bob is back", lambda: bool(bob.printed("back")) and bob.step > alone + 20)
    assert " ".join(bob.printed("out")[-1]).startswith("not_found")
    assert "missed 3 deadlines" in " ".join(bob.printed("out")[-1])
    ada.is_whole()


@pytest.mark.parametrize(("on_timeout", "weight"), [("hold", 2.0), ("free", 0.0)])
def test_a_slow_controller_misses_deadlines_and_the_swarm_steps(
    on_timeout: str, weight: float, create: Create, daemon: Daemon, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    terms = ("--deadline", SHORT_SECS, "--waits", "--on-timeout", on_timeout)
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, *terms)
    bob.until("it joins", lambda: bool(bob.printed("joined")))
    # It advances after two deadlines and before the third.
    ada.on_miss[2] = bob.go_on
    ada.until("it steps sometimes", lambda: bob.step > 0)
    ada.until("it is missed", lambda: bool(ada.advanced[-1].news.missed))
    assert swarm.state().weight[2] == weight
    ada.until("it has synced", lambda: len(bob.steps) >= 3 and len(bob.printed("out")) >= 3)
    assert set(ada.missed) == {1, 2}
    assert ada.left == []
    assert ada.longest < NOT_LONG_SECS
    ada.is_whole()


def test_a_much_too_slow_controller_is_removed_and_joins_repeatedly(
    create: Create, daemon: Daemon, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    terms = ("--deadline", SHORT_SECS / 2, "--waits")
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, *terms)
    bob.until("it joins", lambda: bool(bob.printed("joined")))
    ada.on_miss[3] = bob.go_on
    ada.until("it leaves and joins", lambda: len(ada.left) >= 3 and len(bob.steps) >= 3)
    assert set(ada.left) == {"late"}
    assert set(ada.missed) == {1, 2, 3}
    ada.is_whole()


@pytest.mark.parametrize("how", ["kill", "stop"])
def test_a_restarted_daemon_loses_and_repeats_no_exchange(
    how: str, create: Create, own_daemon: Daemon, start: Start
) -> None:
    until, daemon = 400, own_daemon
    folder, endpoint = daemon.log.parent, daemon.endpoint
    with jostle.connect(endpoint) as client:
        swarm = client.create("restarted", {"n": 20, "seed": 7})
        ada = start(endpoint, swarm.name, "ada", "--ids", 0, 1, "--until", until)
        bob = start(endpoint, swarm.name, *BOB, until)
        try:
            for step in (100, 250, 251):
                # At the last one, all that the one before rolled back is executed again.
                ada.until_step(step)
                getattr(daemon, how)()
                daemon = Daemon(folder, listen=endpoint)
            for program in (ada, bob):
                program.finish()
                assert program.printed("out") == []
                assert program.printed("missed") == []
                assert program.steps == list(range(1, until + 1)), "a step is lost or repeated"
            assert ada.printed("step") == bob.printed("step")
            assert ada.printed("step")[-1] == [str(until), undisturbed(create, until)]
            assert swarm.status().epoch == 4
            assert swarm.verify(timeout=MAX_WAIT_SECS).differs_at is None
            # The tokens exist again: the new daemon notices one that disappears.
            assert swarm.controllers() == []
        finally:
            daemon.kill()


def test_the_restarted_daemon_notices_a_token_that_disappears(
    own_daemon: Daemon, start: Start
) -> None:
    folder, endpoint = own_daemon.log.parent, own_daemon.endpoint
    with jostle.connect(endpoint, timeout=MAX_WAIT_SECS) as client:
        swarm = client.create("restarted", {"n": 20, "seed": 7})
        ada, bob = pair(swarm, endpoint, start, LONG_SECS)
        own_daemon.kill()
        daemon = Daemon(folder, listen=endpoint)
        try:
            again = ada.controller.step + 50
            ada.until("both continue", lambda: bob.step >= again)
            bob.process.kill()
            ada.until("bob is lost", lambda: ada.left == ["lost"])
            assert ada.longest < NOT_LONG_SECS
            ada.is_whole()
        finally:
            daemon.kill()


def test_a_cut_connection_loses_the_controller_until_it_joins_again(
    create: Create, wire: Wire, start: Start
) -> None:
    ada, bob = pair(create(n=20, seed=7), wire.endpoint, start, LONG_SECS)
    wire.unplug()
    ada.until("bob is lost", lambda: ada.left == ["lost"])
    assert ada.longest < NOT_LONG_SECS
    alone = ada.controller.step + 50
    ada.until("it continues", lambda: ada.controller.step >= alone)
    wire.plug()
    ada.until("bob is back", lambda: bob.step > alone + 20)
    assert len(bob.printed("out")) == 1
    assert ada.missed == []
    ada.is_whole()


def is_answered(call: Callable[[], object]) -> bool:
    """Whether the daemon replies."""
    try:
        call()
    except jostle.Unavailable:
        return False
    return True


def test_an_exchange_whose_reply_is_lost_is_executed_once(create: Create, wire: Wire) -> None:
    swarm = create(n=20, seed=7)
    with jostle.connect(wire.endpoint, timeout=MAX_WAIT_SECS) as far:
        ada = far.swarm(swarm.name).join("ada", jostle.ids([0, 1]), deadline=60.0)
        advanced: list[jostle.Advanced] = []
        for step in range(1, 4):
            wire.mute()
            waiting = threading.Thread(target=lambda: advanced.append(ada.advance(direction=0.5)))
            waiting.start()
            eventually("it is executed", lambda: swarm.status().step == step)  # noqa: B023
            wire.cut()
            waiting.join(MAX_WAIT_SECS)
            assert (advanced[-1].step, ada.step, swarm.status().step) == (step, step, step)
            # By then it was lost, or its token existed again.
            eventually("the connection is restored", lambda: is_answered(ada.sync))
            assert (ada.ids, ada.step) == ([0, 1], step)
        ada.leave()
    assert swarm.verify(timeout=MAX_WAIT_SECS).differs_at is None


def test_a_stalled_connection_makes_the_controller_late(
    create: Create, wire: Wire, start: Start
) -> None:
    ada, bob = pair(create(n=20, seed=7), wire.endpoint, start, SHORT_SECS)
    wire.stall()
    ada.until("bob has left", lambda: bool(ada.left))
    assert (ada.left, ada.missed[-3:]) == (["late"], [1, 2, 3])
    alone = ada.controller.step + 50
    ada.until("it continues", lambda: ada.controller.step >= alone)
    wire.plug()
    ada.until("bob is back", lambda: bob.step > alone + 20)
    ada.is_whole()


def test_a_slow_connection_loses_nothing(create: Create, wire: Wire, start: Start) -> None:
    until = 60
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(wire.endpoint, swarm.name, *BOB, until)
    ada.with_(bob)
    wire.slow(0.02)
    began, first = time.monotonic(), ada.controller.step
    ada.until("it reaches the last step", lambda: ada.controller.step >= until)
    assert time.monotonic() - began > 0.02 * (until - first - 5)
    wire.slow(0.0)
    bob.finish()
    assert (ada.missed, bob.printed("out"), bob.steps) == ([], [], list(range(1, until + 1)))
    assert ada.advanced[-1].state_hash == undisturbed(create, until)
    ada.is_whole()
