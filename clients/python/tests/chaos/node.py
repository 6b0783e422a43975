"""The daemon, and its successive runs on one data folder and port."""

from __future__ import annotations

import contextlib
import json
import random
import re
import socket
import subprocess
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

# A daemon that does not listen within this time fails the test.
_TIMEOUT_SECS = 20.0


@dataclass
class Run:
    """One process of the daemon, from its start to its end; times are of the monotonic clock.

    Attributes:
        number: From 1.
        pid: Its process id.
        began: When it was started.
        listening: When it printed that it listens.
        ended: When it had ended; None while it runs.
        how: How it ended: `killed`, or `stopped` with an exit code.
    """

    number: int
    pid: int
    began: float
    listening: float
    ended: float | None = None
    how: str = ""


class Node:
    """A `jostled serve` that can be killed and restarted."""

    def __init__(self, jostled: Path, data: Path, work: Path) -> None:
        self.jostled = jostled
        self.data = data
        self.log = work / "jostled.log"
        self._output = work / "jostled.out"
        self._listen, self._http = (f"127.0.0.1:{port}" for port in free_ports(2))
        self.endpoint = f"tcp/{self._listen}"
        self.runs: list[Run] = []
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> Run:
        """Starts it and waits until it listens."""
        command: list[str | Path] = [
            self.jostled,
            "serve",
            "--node",
            "chaos",
            "--listen",
            self.endpoint,
        ]
        command += ["--http", self._http, "--data-dir", self.data, "--experiment-threads", "1"]
        began = time.monotonic()
        with self.log.open("ab") as log, self._output.open("wb") as output:
            # In a session of its own, so that Ctrl-C reaches the test alone, which ends it.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=log,
                start_new_session=True,
            )
        self._process = process
        while not re.search(rb"listening on \S+\n", self._output.read_bytes()):
            if process.poll() is not None or time.monotonic() - began > _TIMEOUT_SECS:
                raise AssertionError(f"jostled does not listen: {self.log.read_text()[-2000:]}")
            time.sleep(0.002)
        run = Run(len(self.runs) + 1, process.pid, began, time.monotonic())
        self.runs.append(run)
        return run

    def kill(self) -> None:
        """Kills it with SIGKILL."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self.runs[-1].ended, self.runs[-1].how = time.monotonic(), "killed"

    def stop(self) -> int:
        """Stops it with SIGTERM and returns its exit code."""
        assert self._process is not None
        self._process.terminate()
        code = self._process.wait(_TIMEOUT_SECS)
        self.runs[-1].ended, self.runs[-1].how = time.monotonic(), f"stopped with {code}"
        return code

    def end(self) -> None:
        """Kills it if it still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def is_up(self) -> bool:
        """Whether the daemon runs."""
        return bool(self.runs) and self.runs[-1].ended is None

    def down(self) -> list[tuple[float, float]]:
        """The intervals in which no daemon listened."""
        return [
            (before.ended, after.listening)
            for before, after in zip(self.runs, self.runs[1:], strict=False)
            if before.ended is not None
        ]

    def health(self) -> list[str] | None:
        """The codes of why it is unhealthy; None if there is no response."""
        try:
            body = self._fetch("healthz")
        except urllib.error.HTTPError as error:
            body = error.read()
        except OSError:
            return None
        return [reason["code"] for reason in json.loads(body)["reasons"]]

    def metrics(self) -> str | None:
        """Its metrics as text; None if there is no response."""
        try:
            return self._fetch("metrics").decode()
        except OSError:
            return None

    def _fetch(self, page: str) -> bytes:
        with urllib.request.urlopen(f"http://{self._http}/{page}", timeout=5.0) as response:
            body: bytes = response.read()
            return body


def free_ports(count: int) -> list[int]:
    """Distinct ports on which no process listens, for daemons that are started with them later.

    They are below the ports that the kernel assigns itself: one of those, assigned to a socket that
    is closed again, may be assigned to another process before the daemon listens on it.
    """
    ports: list[int] = []
    for port in random.SystemRandom().sample(range(10_000, 32_000), 1000):
        with socket.socket() as free, contextlib.suppress(OSError):
            free.bind(("127.0.0.1", port))
            ports.append(port)
        if len(ports) == count:
            return ports
    raise RuntimeError("no port is free")
