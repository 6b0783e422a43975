"""Samples the resources that the daemon uses."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .node import Node, Run

_SAMPLE_SECS = 1.0
_FACTOR = re.compile(r'jostle_swarm_real_time_factor\{swarm="([^"]+)"\} (\S+)')
_CPU = re.compile(r"jostle_cpu_seconds_total (\S+)")


@dataclass(frozen=True)
class Sample:
    """A sample of the daemon's process.

    Attributes:
        at: When, on the monotonic clock.
        run: The number of the run of the daemon.
        memory_kb: Resident memory.
        descriptors: Open descriptors.
        threads: Its threads.
        cpu_secs: CPU time since it started.
        slowest: The least real-time factor of the swarms that run at a given rate; None if there
            is none.
    """

    at: float
    run: int
    memory_kb: int
    descriptors: int
    threads: int
    cpu_secs: float
    slowest: float | None


class Meter(threading.Thread):
    """Takes a sample every second until `finish` is called."""

    def __init__(self, node: Node) -> None:
        super().__init__(name="meter", daemon=True)
        self._node = node
        self._stop_event = threading.Event()
        self.samples: list[Sample] = []

    def run(self) -> None:
        """Takes samples until `finish` is called."""
        while not self._stop_event.wait(_SAMPLE_SECS):
            self.sample()

    def finish(self) -> None:
        """Stops sampling."""
        self._stop_event.set()
        self.join()

    def sample(self) -> None:
        """Takes a sample if the daemon runs."""
        run = self._node.runs[-1]
        if run.ended is not None:
            return
        text = self._node.metrics()
        process = Path("/proc") / str(run.pid)
        try:
            status = (process / "status").read_text()
            descriptors = len(list((process / "fd").iterdir()))
        except OSError:
            return
        memory = re.search(r"VmRSS:\s+(\d+)", status)
        threads = re.search(r"Threads:\s+(\d+)", status)
        if text is None or memory is None or threads is None:
            return
        factors = [float(factor) for _, factor in _FACTOR.findall(text)]
        cpu = _CPU.search(text)
        self.samples.append(
            Sample(
                time.monotonic(),
                run.number,
                int(memory[1]),
                descriptors,
                int(threads[1]),
                float(cpu[1]) if cpu else 0.0,
                min(factors, default=None),
            )
        )

    def run_of(self, run: Run) -> dict[str, Any]:
        """The memory, descriptors and threads of one run of the daemon; empty if it was too short.

        `slope_mb_per_hour` is that of least squares over the last two thirds of the run, `later`
        their begin and end, and `grown_mb` the growth in that time.
        """
        mine = [sample for sample in self.samples if sample.run == run.number]
        if len(mine) < 3:
            return {}
        later = mine[len(mine) // 3 :]
        slope = least_squares([it.at for it in later], [it.memory_kb for it in later])
        span = later[-1].at - later[0].at
        return {
            "later": (later[0].at, later[-1].at),
            "slope_mb_per_hour": round(slope * 3600 / 1024, 2),
            "grown_mb": round(slope * span / 1024, 2),
            "descriptors": extent([sample.descriptors for sample in mine]),
            "threads": extent([sample.threads for sample in mine]),
        }


def extent(values: Sequence[float]) -> dict[str, float]:
    """The last and the largest value."""
    return {"last": values[-1], "max": max(values)}


def least_squares(x: Sequence[float], y: Sequence[float]) -> float:
    """The slope of the regression line."""
    mean_x, mean_y = math.fsum(x) / len(x), math.fsum(y) / len(y)
    above = math.fsum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    below = math.fsum((a - mean_x) ** 2 for a in x)
    return above / below if below > 0.0 else 0.0
