"""What goes wrong around controllers in lock-step: processes, links, the daemon.

Nothing hangs, the others go on, no step is lost or taken twice, and the journal leads to the
same state when it is told again.
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
from conftest import PATIENCE_SECS, Daemon, Wire, eventually
from steering import directions

Create = Callable[..., jostle.Swarm]
Start = Callable[..., "Program"]

STEERING = Path(__file__).with_name("steering.py")

# The longest deadline that there is. An exchange that takes less did not wait for it.
LONG_SECS = 60
NOT_LONG_SECS = LONG_SECS / 2
# Long beside what an exchange takes on a busy machine, and short enough to be missed three times.
SHORT_SECS = 1.0


class Program:
    """A controller in a process of its own."""

    def __init__(self, endpoint: str, swarm: str, name: str, *options: object) -> None:
        self.name = name
        self.process = subprocess.Popen(
            [sys.executable, STEERING, endpoint, swarm, name, *map(str, options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.said: list[list[str]] = []
        self._news = threading.Condition()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                with self._news:
                    self.said.append(line.split())
                    self._news.notify_all()

    def heard(self, word: str) -> list[list[str]]:
        """What it said that begins with this word, without it."""
        return [words for first, *words in list(self.said) if first == word]

    @property
    def step(self) -> int:
        """How far it says to have come."""
        steps = self.heard("step")
        return int(steps[-1][0]) if steps else 0

    @property
    def steps(self) -> list[int]:
        """Every step it says to have come to."""
        return [int(step) for step, _ in self.heard("step")]

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Waits until it has said what makes this hold."""
        with self._news:
            assert self._news.wait_for(holds, PATIENCE_SECS), (
                f"{self.name}: {what}: {self.said[-5:]}"
            )

    def until_step(self, step: int) -> None:
        """Waits until it says that it has come so far."""
        self.until(f"step {step}", lambda: self.step >= step)

    def go_on(self) -> None:
        """Has it advance, if it waits for that."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def send(self, sent: signal.Signals) -> None:
        """Sends its process a signal."""
        self.process.send_signal(sent)

    def finish(self) -> None:
        """Waits for its end, which is a good one."""
        assert self.process.wait(PATIENCE_SECS) == 0, self.said[-5:]
        self._close()

    def end(self) -> None:
        """Ends it, however it is."""
        self.process.kill()
        self.process.wait(PATIENCE_SECS)
        self._close()

    def _close(self) -> None:
        self._listener.join(PATIENCE_SECS)
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
    """The other controller, in this process, that goes on as long as it is told to."""

    def __init__(self, swarm: jostle.Swarm, others: int = 1) -> None:
        self.swarm = swarm
        self.controller = swarm.join("ada", jostle.ids([0, 1]), deadline=LONG_SECS)
        self.others = others
        self.longest = 0.0
        self.told: list[jostle.Advanced] = []
        # What to do when a controller has missed so many deadlines in a row.
        self.on_miss: dict[int, Callable[[], None]] = {}

    def with_(self, other: Program) -> None:
        """Waits for the other, and goes on with it until both have come some way."""
        other.until("it joins", lambda: bool(other.heard("joined")))
        self.until("they are together", lambda: other.step >= 20)

    def advance(self) -> jostle.Advanced:
        """Advances by one step."""
        began = time.monotonic()
        wanted = directions(self.controller)
        told = self.controller.advance(direction=wanted, weight=2.0, timeout=PATIENCE_SECS)
        self.longest = max(self.longest, time.monotonic() - began)
        self.told.append(told)
        for miss in told.news.missed:
            if miss.misses in self.on_miss:
                self.on_miss[miss.misses]()
        return told

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Goes on until this holds."""
        deadline = time.monotonic() + PATIENCE_SECS
        while not holds():
            assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_SECS} s"
            self.advance()

    @property
    def missed(self) -> list[int]:
        """How many deadlines in a row others had missed, each time they did."""
        return [miss.misses for told in self.told for miss in told.news.missed]

    @property
    def left(self) -> list[str]:
        """Why others have left."""
        return [departed.why for told in self.told for departed in told.news.left]

    def is_whole(self) -> None:
        """Leaves, and has the past told again: every step was taken once, and comes out the same.

        What is written down of deadlines and departures is all that it needs, and no clock.
        """
        steps = [told.step for told in self.told]
        assert steps == list(range(1, len(steps) + 1))
        self.controller.leave()
        eventually("its past can be verified", self._is_verified)

    def _is_verified(self) -> bool:
        try:
            verified = self.swarm.verify(timeout=PATIENCE_SECS)
        except jostle.Conflict as error:
            # Another controller goes on, and what it does reaches the disk a moment later.
            if "is not on the disk yet" not in str(error):
                raise
            return False
        assert verified.differs_at is None
        return True


def undisturbed(create: Create, until: int) -> str:
    """Where two controllers come to if nothing happens."""
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
            told = one.advance(direction=directions(one), weight=2.0)
            waiting.join(PATIENCE_SECS)
    return told.state_hash


BOB = ("bob", "--ids", 2, 3, "--until")


def test_one_that_is_killed_has_left_at_once(create: Create, daemon: Daemon, start: Start) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, "--deadline", LONG_SECS)
    ada.with_(bob)
    bob.process.kill()
    ada.until("bob is lost", lambda: ada.left == ["lost"])
    assert ada.longest < NOT_LONG_SECS, "no exchange waited for the deadline"
    goes_on = len(ada.told) + 50
    ada.until("it goes on", lambda: len(ada.told) >= goes_on)
    assert ada.missed == []
    ada.is_whole()


def test_one_that_is_stopped_is_late_three_times_and_comes_back(
    create: Create, daemon: Daemon, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, "--deadline", SHORT_SECS)
    ada.with_(bob)
    bob.send(signal.SIGSTOP)
    ada.until("bob has left", lambda: bool(ada.left))
    assert (ada.left, ada.missed[-3:]) == (["late"], [1, 2, 3])
    alone = ada.controller.step + 50
    ada.until("it goes on", lambda: ada.controller.step >= alone)
    bob.send(signal.SIGCONT)
    ada.until("bob is back", lambda: bool(bob.heard("back")) and bob.step > alone + 20)
    assert " ".join(bob.heard("out")[-1]).startswith("not_found")
    assert "missed 3 deadlines" in " ".join(bob.heard("out")[-1])
    ada.is_whole()


@pytest.mark.parametrize(("on_timeout", "weight"), [("hold", 2.0), ("free", 0.0)])
def test_one_that_is_too_slow_is_missed_and_not_waited_for(
    on_timeout: str, weight: float, create: Create, daemon: Daemon, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    terms = ("--deadline", SHORT_SECS, "--waits", "--on-timeout", on_timeout)
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, *terms)
    bob.until("it joins", lambda: bool(bob.heard("joined")))
    # It advances after two deadlines and before the third.
    ada.on_miss[2] = bob.go_on
    ada.until("it steps now and then", lambda: bob.step > 0)
    ada.until("it is missed", lambda: bool(ada.told[-1].news.missed))
    assert swarm.state().weight[2] == weight
    ada.until("it is in line again", lambda: len(bob.steps) >= 3 and len(bob.heard("out")) >= 3)
    assert set(ada.missed) == {1, 2}
    assert ada.left == []
    assert ada.longest < NOT_LONG_SECS
    ada.is_whole()


def test_one_that_is_ten_times_too_slow_leaves_and_joins_again_and_again(
    create: Create, daemon: Daemon, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    terms = ("--deadline", SHORT_SECS / 2, "--waits")
    bob = start(daemon.endpoint, swarm.name, *BOB, 10**6, *terms)
    bob.until("it joins", lambda: bool(bob.heard("joined")))
    ada.on_miss[3] = bob.go_on
    ada.until("it leaves and joins", lambda: len(ada.left) >= 3 and len(bob.steps) >= 3)
    assert set(ada.left) == {"late"}
    assert set(ada.missed) == {1, 2, 3}
    ada.is_whole()


@pytest.mark.parametrize("how", ["kill", "stop"])
def test_a_daemon_that_is_started_again_loses_and_doubles_nothing(
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
                # The last time before all that the time before took back is there again.
                ada.until_step(step)
                getattr(daemon, how)()
                daemon = Daemon(folder, listen=endpoint)
            for program in (ada, bob):
                program.finish()
                assert program.heard("out") == []
                assert program.heard("missed") == []
                assert program.steps == list(range(1, until + 1)), "none lost, none twice"
            assert ada.heard("step") == bob.heard("step")
            assert ada.heard("step")[-1] == [str(until), undisturbed(create, until)]
            assert swarm.status().epoch == 4
            assert swarm.verify(timeout=PATIENCE_SECS).differs_at is None
            # The tokens are there again: one that goes is noticed by the new daemon as well.
            assert swarm.controllers() == []
        finally:
            daemon.kill()


def test_the_new_daemon_notices_a_token_that_goes(own_daemon: Daemon, start: Start) -> None:
    folder, endpoint = own_daemon.log.parent, own_daemon.endpoint
    with jostle.connect(endpoint, timeout=PATIENCE_SECS) as client:
        ada = Ada(client.create("restarted", {"n": 20, "seed": 7}))
        bob = start(endpoint, "restarted", *BOB, 10**6, "--deadline", LONG_SECS)
        ada.with_(bob)
        own_daemon.kill()
        daemon = Daemon(folder, listen=endpoint)
        try:
            again = ada.controller.step + 50
            ada.until("they go on", lambda: bob.step >= again)
            bob.process.kill()
            ada.until("bob is lost", lambda: ada.left == ["lost"])
            assert ada.longest < NOT_LONG_SECS
            ada.is_whole()
        finally:
            daemon.kill()


def test_a_link_that_is_cut_is_a_controller_lost_until_it_comes_back(
    create: Create, wire: Wire, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(wire.endpoint, swarm.name, *BOB, 10**6, "--deadline", LONG_SECS)
    ada.with_(bob)
    wire.unplug()
    ada.until("bob is lost", lambda: ada.left == ["lost"])
    assert ada.longest < NOT_LONG_SECS
    alone = ada.controller.step + 50
    ada.until("it goes on", lambda: ada.controller.step >= alone)
    wire.plug()
    ada.until("bob is back", lambda: bob.step > alone + 20)
    assert len(bob.heard("out")) == 1
    assert ada.missed == []
    ada.is_whole()


def is_answered(ask: Callable[[], object]) -> bool:
    """Whether the daemon is there to answer."""
    try:
        ask()
    except jostle.Unavailable:
        return False
    return True


def test_an_exchange_whose_answer_is_lost_is_taken_once(create: Create, wire: Wire) -> None:
    swarm = create(n=20, seed=7)
    with jostle.connect(wire.endpoint, timeout=PATIENCE_SECS) as far:
        ada = far.swarm(swarm.name).join("ada", jostle.ids([0, 1]), deadline=60.0)
        told: list[jostle.Advanced] = []
        for step in range(1, 4):
            wire.mute()
            waiting = threading.Thread(target=lambda: told.append(ada.advance(direction=0.5)))
            waiting.start()
            eventually("it is carried out", lambda: swarm.status().step == step)  # noqa: B023
            wire.cut()
            waiting.join(PATIENCE_SECS)
            assert (told[-1].step, ada.step, swarm.status().step) == (step, step, step)
            # By then it was lost, or its token was there again.
            eventually("the link is back", lambda: is_answered(ada.sync))
            assert (ada.ids, ada.step) == ([0, 1], step)
        ada.leave()
    assert swarm.verify(timeout=PATIENCE_SECS).differs_at is None


def test_a_link_that_stalls_is_a_controller_that_is_late(
    create: Create, wire: Wire, start: Start
) -> None:
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(wire.endpoint, swarm.name, *BOB, 10**6, "--deadline", SHORT_SECS)
    ada.with_(bob)
    wire.stall()
    ada.until("bob has left", lambda: bool(ada.left))
    assert (ada.left, ada.missed[-3:]) == (["late"], [1, 2, 3])
    alone = ada.controller.step + 50
    ada.until("it goes on", lambda: ada.controller.step >= alone)
    wire.plug()
    ada.until("bob is back", lambda: bob.step > alone + 20)
    ada.is_whole()


def test_a_link_that_is_slow_is_only_slow(create: Create, wire: Wire, start: Start) -> None:
    until = 60
    swarm = create(n=20, seed=7)
    ada = Ada(swarm)
    bob = start(wire.endpoint, swarm.name, *BOB, until)
    ada.with_(bob)
    wire.slow(0.02)
    began, first = time.monotonic(), ada.controller.step
    ada.until("it comes to its end", lambda: ada.controller.step >= until)
    assert time.monotonic() - began > 0.02 * (until - first - 5)
    wire.slow(0.0)
    bob.finish()
    assert (ada.missed, bob.heard("out"), bob.steps) == ([], [], list(range(1, until + 1)))
    assert ada.told[-1].state_hash == undisturbed(create, until)
    ada.is_whole()
