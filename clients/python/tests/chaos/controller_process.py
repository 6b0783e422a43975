"""The four controllers, each in its own process; run as a module, this is one of them."""

from __future__ import annotations

import json
import math
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import jostle

from .plan import (
    CONTROLLERS,
    DEADLINE_SECS,
    EXCHANGES_PER_SECOND,
    STEPS_PER_EXCHANGE,
    Controller,
)


@dataclass(frozen=True)
class Exchange:
    """An advance and its reply or error.

    Attributes:
        sent: When it was sent, on the monotonic clock.
        answered: When the reply or error arrived.
        step: The step reached; with an error the step of the controller.
        epoch: The epoch that the controller knows.
        missed: Controllers that missed their deadlines.
        left: Controllers that left.
        error: The code of the error.
        joined: Whether this is the `sync` after an error.
    """

    sent: float
    answered: float
    step: int
    epoch: int
    missed: list[str]
    left: list[str]
    error: str = ""
    joined: bool = False


class ControllerProcess:
    """A controller, and its successive processes."""

    def __init__(self, who: Controller, endpoint: str, work: Path) -> None:
        self.who = who
        self._endpoint = endpoint
        self._log = work / f"{who.name}.jsonl"
        self._log.touch()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Starts a process."""
        ids = ",".join(map(str, self.who.ids))
        command = [sys.executable, "-m", "chaos.controller_process", self._endpoint]
        with self._log.open("ab") as log, self._log.with_suffix(".err").open("ab") as errors:
            self._process = subprocess.Popen(
                [*command, self.who.swarm, self.who.name, ids],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=errors,
                start_new_session=True,
            )

    def signal(self, number: signal.Signals) -> None:
        """Sends a signal to the process."""
        assert self._process is not None
        self._process.send_signal(number)
        if number == signal.SIGKILL:
            self._process.wait()

    def finish(self) -> None:
        """Lets the controller leave, and waits until its process ends."""
        if self._process is None or self._process.poll() is not None:
            return
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.end()

    def end(self) -> None:
        """Kills the process if it still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def exchanges(self) -> list[Exchange]:
        """Its exchanges so far, without a line that a kill truncated."""
        lines = self._log.read_text().split("\n")[:-1]
        return [Exchange(**json.loads(line)) for line in lines]

    def failures(self) -> str:
        """What its processes wrote to stderr, which is empty unless one failed."""
        return self._log.with_suffix(".err").read_text()


def create_all(endpoint: str, work: Path) -> list[ControllerProcess]:
    """The four controllers, not started."""
    return [ControllerProcess(who, endpoint, work) for who in CONTROLLERS]


def steer(endpoint: str, swarm: str, name: str, ids: list[int], over: threading.Event) -> None:
    """Joins and advances until `over` is set, across restarts of the daemon."""
    with jostle.connect(endpoint, client=name) as client:
        one = client.swarm(swarm).join(name, jostle.ids(ids), deadline=DEADLINE_SECS, again=True)
        is_synced = True
        # At different intervals, so that a controller has to wait for the others.
        rng = random.Random(name)
        while not over.wait(rng.uniform(0.5, 1.5) / EXCHANGES_PER_SECOND):
            sent = time.monotonic()
            missed: list[str] = []
            left: list[str] = []
            error = ""
            try:
                if not is_synced:
                    one.sync()
                    is_synced = True
                    _print(Exchange(sent, time.monotonic(), one.step, one.epoch, [], [], "", True))
                    continue
                direction = math.sin(0.001 * one.step)
                one.advance(STEPS_PER_EXCHANGE, direction=direction, weight=1.5)
                missed = [miss.controller for miss in one.news.missed]
                left = [departed.controller for departed in one.news.left]
            except (jostle.Conflict, jostle.NotFound) as failure:
                is_synced = False
                error = failure.code
            except jostle.JostleError as failure:
                error = failure.code
            _print(Exchange(sent, time.monotonic(), one.step, one.epoch, missed, left, error))
        one.leave()


def stdin_closed() -> threading.Event:
    """An event that is set when the standard input is closed."""
    closed = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        closed.set()

    threading.Thread(target=wait, daemon=True).start()
    return closed


def _print(exchange: Exchange) -> None:
    sys.stdout.write(json.dumps(exchange.__dict__) + "\n")
    sys.stdout.flush()


def _main() -> None:
    endpoint, swarm, name, ids = sys.argv[1:]
    steer(endpoint, swarm, name, [int(one) for one in ids.split(",")], stdin_closed())


if __name__ == "__main__":
    _main()
