"""What the daemon takes, and how late it steps: a line every few seconds."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .node import Life, Node

_SAMPLE_SECS = 1.0
_BUCKET = re.compile(r'jostle_step_lateness_seconds_bucket\{le="([^"]+)"\} (\d+)')
_FACTOR = re.compile(r'jostle_swarm_real_time_factor\{swarm="([^"]+)"\} (\S+)')
_CPU = re.compile(r"jostle_cpu_seconds_total (\S+)")


@dataclass(frozen=True)
class Sample:
    """One look at the daemon's process.

    Attributes:
        at: When, on the monotonic clock.
        life: In which of its lives.
        memory_kb: Resident.
        descriptors: Open.
        threads: Running.
        cpu_secs: Computed since it started.
        slowest: The least real-time factor of the swarms that have one, but for those that run
            as fast as they can; None if there is none.
    """

    at: float
    life: int
    memory_kb: int
    descriptors: int
    threads: int
    cpu_secs: float
    slowest: float | None


class Meter(threading.Thread):
    """Samples until told to end."""

    def __init__(self, node: Node) -> None:
        super().__init__(name="meter", daemon=True)
        self._node = node
        self._over = threading.Event()
        self.samples: list[Sample] = []
        # By life: how many steps were at most so late.
        self.lateness: dict[int, dict[float, int]] = {}

    def run(self) -> None:
        """Looks until told to end."""
        while not self._over.wait(_SAMPLE_SECS):
            self.look()

    def finish(self) -> None:
        """Ends."""
        self._over.set()
        self.join()

    def look(self) -> None:
        """Takes a sample, if there is a daemon."""
        life = self._node.lives[-1]
        if life.ended is not None:
            return
        text = self._node.metrics()
        process = Path("/proc") / str(life.pid)
        try:
            status = (process / "status").read_text()
            descriptors = len(list((process / "fd").iterdir()))
        except OSError:
            return
        memory = re.search(r"VmRSS:\s+(\d+)", status)
        threads = re.search(r"Threads:\s+(\d+)", status)
        if text is None or memory is None or threads is None:
            return
        self.lateness[life.number] = {float(le): int(count) for le, count in _BUCKET.findall(text)}
        factors = [float(factor) for _, factor in _FACTOR.findall(text)]
        cpu = _CPU.search(text)
        self.samples.append(
            Sample(
                time.monotonic(),
                life.number,
                int(memory[1]),
                descriptors,
                int(threads[1]),
                float(cpu[1]) if cpu else 0.0,
                min(factors, default=None),
            )
        )

    def late(self) -> dict[str, float]:
        """How late steps began, of all lives together: bounds of the histogram, in seconds."""
        total: dict[float, int] = {}
        for life in self.lateness.values():
            for bound, count in life.items():
                total[bound] = total.get(bound, 0) + count
        steps = max(total.values(), default=0)

        def bound_of(share: float) -> float:
            return min((it for it, count in total.items() if count >= share * steps), default=0.0)

        return {"steps": steps, "p50": bound_of(0.5), "p99": bound_of(0.99), "max": bound_of(1.0)}

    def life(self, life: Life) -> dict[str, Any]:
        """What one life of the daemon took."""
        mine = [sample for sample in self.samples if sample.life == life.number]
        report: dict[str, Any] = {"life": life.number, "samples": len(mine), "how": life.how}
        report["seconds"] = round((life.ended or time.monotonic()) - life.listening, 1)
        report["until_listening_secs"] = round(life.listening - life.began, 3)
        if len(mine) < 3:
            return report
        later = mine[len(mine) // 3 :]
        slope = least_squares([it.at for it in later], [it.memory_kb for it in later])
        span = later[-1].at - later[0].at
        report["later"] = (later[0].at, later[-1].at)
        report["memory_mb"] = extent([sample.memory_kb / 1024 for sample in mine])
        report["slope_mb_per_hour"] = round(slope * 3600 / 1024, 2)
        report["grown_mb"] = round(slope * span / 1024, 2)
        report["descriptors"] = extent([sample.descriptors for sample in mine])
        report["threads"] = extent([sample.threads for sample in mine])
        report["cores"] = round(mine[-1].cpu_secs / (mine[-1].at - life.began), 3)
        return report

    def told(self) -> list[dict[str, Any]]:
        """Every sample."""
        return [asdict(sample) for sample in self.samples]


def extent(values: Sequence[float]) -> dict[str, float]:
    """The first, the last and the extremes."""
    said = {"first": values[0], "last": values[-1], "min": min(values), "max": max(values)}
    return {name: round(value, 1) for name, value in said.items()}


def least_squares(x: Sequence[float], y: Sequence[float]) -> float:
    """The slope of the line through points."""
    mean_x, mean_y = math.fsum(x) / len(x), math.fsum(y) / len(y)
    above = math.fsum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    below = math.fsum((a - mean_x) ** 2 for a in x)
    return above / below if below > 0.0 else 0.0
