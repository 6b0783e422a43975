"""Viewers who come and go, some dozens in a process; run as a module, this is such a process."""

from __future__ import annotations

import heapq
import json
import random
import subprocess
import sys
import threading
import time
import zlib
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cbor2
import zenoh

from jostle._link import open_session

_PROCESSES = 4
# How long one looks at a swarm, and how long until the next one comes in its place.
_STAYS_SECS = (5.0, 40.0)
_IS_AWAY_SECS = (0.5, 4.0)


@dataclass
class Seen:
    """What the viewers of one process saw.

    Attributes:
        visits: Sessions opened.
        failed: Sessions that found nobody.
        states: States received.
        missed: States that their numbers say were published and not received.
        epochs: How often a viewer saw an epoch begin while it looked on.
        back: Where steps or epochs went back: swarm, epoch and step before and after.
        twins: The bodies of each twin: step and a check sum of all columns.
        apart: Steps at which twins were seen with different bodies.
    """

    visits: int = 0
    failed: int = 0
    states: int = 0
    missed: int = 0
    epochs: int = 0
    back: list[list[Any]] = field(default_factory=list)
    twins: dict[str, dict[int, int]] = field(default_factory=dict)
    apart: list[int] = field(default_factory=list)


class Visit:
    """One viewer of one swarm."""

    def __init__(self, session: zenoh.Session, swarm: str, seen: Seen) -> None:
        self._session = session
        self._swarm = swarm
        self._seen = seen
        self._last: tuple[int, int, int] | None = None
        self._subscriber = session.declare_subscriber(f"jostle/{swarm}/state", self._see)

    def end(self) -> None:
        """Goes."""
        self._session.close()

    def _see(self, sample: zenoh.Sample) -> None:
        state = cbor2.loads(sample.payload.to_bytes())
        epoch, step, frame = state["epoch"], state["step"], state["frame"]
        seen = self._seen
        seen.states += 1
        if self._last is not None:
            last_epoch, last_step, last_frame = self._last
            if (epoch, step) < (last_epoch, last_step):
                seen.back.append([self._swarm, last_epoch, last_step, epoch, step])
            if epoch > last_epoch:
                seen.epochs += 1
            elif frame > last_frame + 1:
                seen.missed += frame - last_frame - 1
        self._last = (epoch, step, frame)
        if self._swarm.startswith("twin-"):
            columns = (state[name].value for name in ("id", "x", "y", "alpha", "weight"))
            bodies = zlib.crc32(b"".join(columns))
            if seen.twins.setdefault(self._swarm, {}).setdefault(step, bodies) != bodies:
                seen.apart.append(step)


def look_on(endpoint: str, swarms: list[str], count: int, seed: str, over: threading.Event) -> Seen:
    """Has so many viewers come and go until told to end."""
    dice = random.Random(seed)
    seen = Seen()
    now = time.monotonic()
    # Who is to do something when: a visit to end, or none and somebody comes.
    due: list[tuple[float, int, Visit | None]] = [
        (now + dice.uniform(0.0, 5.0), number, None) for number in range(count)
    ]
    heapq.heapify(due)
    while not over.wait(max(0.0, due[0][0] - time.monotonic())):
        _, number, visit = heapq.heappop(due)
        if visit is None:
            swarm = dice.choice(swarms)
            try:
                visit = Visit(open_session(endpoint, 2.0), swarm, seen)
                seen.visits += 1
            except Exception:
                seen.failed += 1
            rest = dice.uniform(*(_IS_AWAY_SECS if visit is None else _STAYS_SECS))
        else:
            visit.end()
            visit = None
            rest = dice.uniform(*_IS_AWAY_SECS)
        heapq.heappush(due, (time.monotonic() + rest, number, visit))
    for _, _, visit in due:
        if visit is not None:
            visit.end()
    return seen


class Crowd:
    """All viewers."""

    def __init__(self, endpoint: str, swarms: list[str], count: int, seed: int, work: Path) -> None:
        self._told = [work / f"viewers-{k}.json" for k in range(_PROCESSES)]
        # Twins are looked at more than others, for what is seen of one holds for the other.
        chosen = [*swarms, *(name for name in swarms if name.startswith("twin-"))]
        self._processes = []
        for k, told in enumerate(self._told):
            share = str(count // _PROCESSES + (k < count % _PROCESSES))
            command = [sys.executable, "-m", "day.viewers", endpoint, ",".join(chosen)]
            with told.open("wb") as output, told.with_suffix(".err").open("wb") as errors:
                self._processes.append(
                    subprocess.Popen(
                        [*command, share, f"{seed} {k}"],
                        stdin=subprocess.PIPE,
                        stdout=output,
                        stderr=errors,
                        start_new_session=True,
                    )
                )

    def finish(self) -> list[Seen]:
        """Has all of them go, and tells what they saw."""
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.close()
        for process in self._processes:
            process.wait(60.0)
        return [_read(told) for told in self._told]

    def end(self) -> None:
        """Has all of them gone at once."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()


def _read(told: Path) -> Seen:
    text = told.read_text()
    assert text, told.with_suffix(".err").read_text()
    fields = json.loads(text)
    fields["twins"] = {
        swarm: {int(step): bodies for step, bodies in steps.items()}
        for swarm, steps in fields["twins"].items()
    }
    return Seen(**fields)


def _main() -> None:
    endpoint, swarms, count, seed = sys.argv[1:]
    over = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        over.set()

    threading.Thread(target=wait, daemon=True).start()
    print(json.dumps(asdict(look_on(endpoint, swarms.split(","), int(count), seed, over))))


if __name__ == "__main__":
    _main()
