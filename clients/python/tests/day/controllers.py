"""The four controllers, each in a process of its own; run as a module, this is one of them."""

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
    """An advance that was answered, or what came instead.

    Attributes:
        sent: When it was sent, on the monotonic clock.
        answered: When it was answered.
        step: The step reached; the one it stands at when `error` is there.
        epoch: The epoch it heard of.
        missed: Whose deadlines fired.
        left: Who has left.
        error: The code of the error that came instead of an answer.
        joined: Whether it is in line again, after that error.
    """

    sent: float
    answered: float
    step: int
    epoch: int
    missed: list[str]
    left: list[str]
    error: str = ""
    joined: bool = False


class Running:
    """A controller's processes, one after the other."""

    def __init__(self, who: Controller, endpoint: str, work: Path) -> None:
        self.who = who
        self._endpoint = endpoint
        self._log = work / f"{who.name}.jsonl"
        self._log.touch()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Starts one."""
        ids = ",".join(map(str, self.who.ids))
        command = [sys.executable, "-m", "day.controllers", self._endpoint]
        with self._log.open("ab") as log, self._log.with_suffix(".err").open("ab") as errors:
            self._process = subprocess.Popen(
                [*command, self.who.swarm, self.who.name, ids],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=errors,
                start_new_session=True,
            )

    def signal(self, number: signal.Signals) -> None:
        """Kills it, stops it or lets it go on."""
        assert self._process is not None
        self._process.send_signal(number)
        if number == signal.SIGKILL:
            self._process.wait()

    def finish(self) -> None:
        """Has it leave and end."""
        if self._process is None or self._process.poll() is not None:
            return
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.end()

    def end(self) -> None:
        """Has it gone, whatever state it is in."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def exchanges(self) -> list[Exchange]:
        """What it has told so far; what a kill has cut short is left out."""
        lines = self._log.read_text().split("\n")[:-1]
        return [Exchange(**json.loads(line)) for line in lines]

    def errors(self) -> str:
        """What it said when something went wrong that should not."""
        return self._log.with_suffix(".err").read_text()


def gather(endpoint: str, work: Path) -> list[Running]:
    """The four, yet to begin."""
    return [Running(who, endpoint, work) for who in CONTROLLERS]


def steer(endpoint: str, swarm: str, name: str, ids: list[int], over: threading.Event) -> None:
    """Joins and advances until told to end, whatever becomes of the daemon and the others."""
    with jostle.connect(endpoint, client=name) as client:
        one = client.swarm(swarm).join(name, jostle.ids(ids), deadline=DEADLINE_SECS, again=True)
        is_in_line = True
        # Some are quicker than others, so that there is somebody who waits.
        dice = random.Random(name)
        while not over.wait(dice.uniform(0.5, 1.5) / EXCHANGES_PER_SECOND):
            sent = time.monotonic()
            missed: list[str] = []
            left: list[str] = []
            error = ""
            try:
                if not is_in_line:
                    one.sync()
                    is_in_line = True
                    _tell(Exchange(sent, time.monotonic(), one.step, one.epoch, [], [], "", True))
                    continue
                direction = math.sin(0.001 * one.step)
                one.advance(STEPS_PER_EXCHANGE, direction=direction, weight=1.5)
                missed = [miss.controller for miss in one.news.missed]
                left = [departed.controller for departed in one.news.left]
            except (jostle.Conflict, jostle.NotFound) as trouble:
                is_in_line = False
                error = trouble.code
            except jostle.JostleError as trouble:
                error = trouble.code
            _tell(Exchange(sent, time.monotonic(), one.step, one.epoch, missed, left, error))
        one.leave()


def _tell(exchange: Exchange) -> None:
    sys.stdout.write(json.dumps(exchange.__dict__) + "\n")
    sys.stdout.flush()


def _main() -> None:
    endpoint, swarm, name, ids = sys.argv[1:]
    over = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        over.set()

    threading.Thread(target=wait, daemon=True).start()
    steer(endpoint, swarm, name, [int(one) for one in ids.split(",")], over)


if __name__ == "__main__":
    _main()
