"""A real Dask cluster on this machine."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from conftest import JOSTLED, eventually


def command_of(process: int) -> bytes:
    """The command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


class Cluster:
    """A Dask scheduler and its workers, each in its own process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.address = ""
        self.scheduler = self._start(
            "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1"
        )
        log = folder / "scheduler.log"

        def found() -> bool:
            for line in log.read_text().splitlines():
                if "Scheduler at:" in line:
                    self.address = line.split()[-1]
            return bool(self.address)

        eventually("the scheduler", found)
        self.workers = [
            self._start(
                *("distributed.cli.dask_worker", self.address, "--nthreads", "1", "--nanny"),
                *("--no-dashboard", "--local-directory", str(folder)),
            )
            for _ in range(2)
        ]

    def _start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        name = module.rpartition("_")[2]
        environ = {
            **os.environ,
            "JOSTLED": str(JOSTLED),
            # A killed worker is counted against its task.
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "100",
        }
        with (self.folder / f"{name}.log").open("ab") as log:
            command = [sys.executable, "-m", module, *arguments]
            # Another folder than that of the test.
            return subprocess.Popen(command, env=environ, stdout=log, stderr=log, cwd=self.folder)

    def worker_processes(self) -> list[int]:
        """The processes of workers, which their nannies started."""
        found = []
        for nanny in self.workers:
            for children in Path(f"/proc/{nanny.pid}/task").glob("*/children"):
                with contextlib.suppress(FileNotFoundError):
                    found += [int(it) for it in children.read_text().split()]
        return [it for it in found if b"spawn_main" in command_of(it)]

    def stop(self) -> None:
        """Ends all processes. A worker ends with its nanny."""
        # The nannies first: one whose scheduler has ended may not end.
        deadline = time.monotonic() + 5
        for processes in (self.workers, [self.scheduler]):
            for process in processes:
                process.terminate()
            for process in processes:
                try:
                    process.wait(max(0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


@contextlib.contextmanager
def clusters(folder: Path) -> Iterator[Callable[[str], Cluster]]:
    """Starts clusters, each with a folder of its own in `folder`, and stops them."""
    started: list[Cluster] = []

    def start(name: str) -> Cluster:
        inner = folder / name
        inner.mkdir()
        started.append(Cluster(inner))
        return started[-1]

    try:
        yield start
    finally:
        for cluster in started:
            cluster.stop()
