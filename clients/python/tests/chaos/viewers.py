"""Viewers that subscribe and leave, some dozens in a process; as a module, one such process."""

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

from jostle._connect import open_zenoh

from .controller_process import stdin_closed

_PROCESSES = 4
# How long one subscribes to a swarm, and how long until the next one takes its place.
_SUBSCRIBED_SECS = (5.0, 40.0)
_AWAY_SECS = (0.5, 4.0)


@dataclass
class ViewerRecord:
    """What the viewers of one process received.

    Attributes:
        visits: Sessions opened.
        failed: Sessions that could not be opened.
        states: States received.
        missed: States that were published but not received, by their frame numbers.
        epochs: How often an epoch began while a viewer was subscribed.
        back: Where a step or an epoch decreased: swarm, epoch and step before and after.
        twins: For each twin and step a checksum of the bodies.
        apart: Steps at which one twin had two different checksums.
    """

    visits: int = 0
    failed: int = 0
    states: int = 0
    missed: int = 0
    epochs: int = 0
    back: list[list[Any]] = field(default_factory=list)
    twins: dict[str, dict[int, int]] = field(default_factory=dict)
    apart: list[int] = field(default_factory=list)


class Viewer:
    """One subscriber of one swarm."""

    def __init__(self, session: zenoh.Session, swarm: str, seen: ViewerRecord) -> None:
        self._session = session
        self._swarm = swarm
        self._seen = seen
        self._last: tuple[int, int, int] | None = None
        self._subscriber = session.declare_subscriber(f"jostle/{swarm}/state", self._receive)

    def end(self) -> None:
        """Closes the session."""
        self._session.close()

    def _receive(self, sample: zenoh.Sample) -> None:
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


def run_viewers(
    endpoint: str, swarms: list[str], count: int, seed: str, over: threading.Event
) -> ViewerRecord:
    """Keeps `count` viewers subscribing and leaving until `over` is set."""
    rng = random.Random(seed)
    seen = ViewerRecord()
    now = time.monotonic()
    # For each viewer the time of its next action: to leave, or if it is None to subscribe.
    due: list[tuple[float, int, Viewer | None]] = [
        (now + rng.uniform(0.0, 5.0), number, None) for number in range(count)
    ]
    heapq.heapify(due)
    while not over.wait(max(0.0, due[0][0] - time.monotonic())):
        _, number, viewer = heapq.heappop(due)
        if viewer is None:
            swarm = rng.choice(swarms)
            try:
                viewer = Viewer(open_zenoh(endpoint, 2.0), swarm, seen)
                seen.visits += 1
            except Exception:
                seen.failed += 1
            rest = rng.uniform(*(_AWAY_SECS if viewer is None else _SUBSCRIBED_SECS))
        else:
            viewer.end()
            viewer = None
            rest = rng.uniform(*_AWAY_SECS)
        heapq.heappush(due, (time.monotonic() + rest, number, viewer))
    for _, _, viewer in due:
        if viewer is not None:
            viewer.end()
    return seen


class Viewers:
    """The processes of all viewers."""

    def __init__(self, endpoint: str, swarms: list[str], count: int, seed: int, work: Path) -> None:
        self._outputs = [work / f"viewers-{k}.json" for k in range(_PROCESSES)]
        # Twins are chosen more often, so that both are seen at the same steps.
        chosen = [*swarms, *(name for name in swarms if name.startswith("twin-"))]
        self._processes = []
        for k, path in enumerate(self._outputs):
            share = str(count // _PROCESSES + (k < count % _PROCESSES))
            command = [sys.executable, "-m", "chaos.viewers", endpoint, ",".join(chosen)]
            with path.open("wb") as output, path.with_suffix(".err").open("wb") as errors:
                self._processes.append(
                    subprocess.Popen(
                        [*command, share, f"{seed} {k}"],
                        stdin=subprocess.PIPE,
                        stdout=output,
                        stderr=errors,
                        start_new_session=True,
                    )
                )

    def finish(self) -> list[ViewerRecord]:
        """Ends all viewers and returns what they received."""
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.close()
        for process in self._processes:
            process.wait(60.0)
        return [_read(path) for path in self._outputs]

    def end(self) -> None:
        """Kills the processes that still run."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()


def _read(path: Path) -> ViewerRecord:
    text = path.read_text()
    assert text, path.with_suffix(".err").read_text()
    fields = json.loads(text)
    fields["twins"] = {
        swarm: {int(step): bodies for step, bodies in steps.items()}
        for swarm, steps in fields["twins"].items()
    }
    return ViewerRecord(**fields)


def _main() -> None:
    endpoint, swarms, count, seed = sys.argv[1:]
    record = run_viewers(endpoint, swarms.split(","), int(count), seed, stdin_closed())
    print(json.dumps(asdict(record)))


if __name__ == "__main__":
    _main()
