"""The daemon, and its lives one after the other on one folder and port."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path

# How long a daemon may take to listen before the day is given up.
_PATIENCE_SECS = 20.0


@dataclass
class Life:
    """A daemon from its start to its end; times are of the monotonic clock.

    Attributes:
        number: From 1.
        pid: Its process.
        began: When it was started.
        listening: When it said that it listens.
        ended: When it was gone; None while it is there.
        how: How it ended: `killed`, or `stopped` with an exit code.
    """

    number: int
    pid: int
    began: float
    listening: float
    ended: float | None = None
    how: str = ""


class Node:
    """A `jostled serve`, to be killed and started again."""

    def __init__(self, jostled: Path, data: Path, work: Path) -> None:
        self.jostled = jostled
        self.data = data
        self.log = work / "jostled.log"
        self._said = work / "jostled.out"
        self._listen, self._http = (f"127.0.0.1:{port}" for port in free_ports(2))
        self.endpoint = f"tcp/{self._listen}"
        self.lives: list[Life] = []
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> Life:
        """Starts it and waits until it listens."""
        command: list[str | Path] = [
            self.jostled,
            "serve",
            "--node",
            "lab",
            "--listen",
            self.endpoint,
        ]
        command += ["--http", self._http, "--data-dir", self.data, "--experiment-threads", "1"]
        began = time.monotonic()
        with self.log.open("ab") as log, self._said.open("wb") as said:
            # Ctrl-C is for the day, which ends it.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=log,
                start_new_session=True,
            )
        self._process = process
        while not re.search(rb"listening on \S+\n", self._said.read_bytes()):
            if process.poll() is not None or time.monotonic() - began > _PATIENCE_SECS:
                raise AssertionError(f"jostled does not listen: {self.log.read_text()[-2000:]}")
            time.sleep(0.002)
        life = Life(len(self.lives) + 1, process.pid, began, time.monotonic())
        self.lives.append(life)
        return life

    def kill(self) -> None:
        """Ends it where it stands."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self.lives[-1].ended, self.lives[-1].how = time.monotonic(), "killed"

    def stop(self) -> int:
        """Asks it to stop, and tells its exit code."""
        assert self._process is not None
        self._process.terminate()
        code = self._process.wait(_PATIENCE_SECS)
        self.lives[-1].ended, self.lives[-1].how = time.monotonic(), f"stopped with {code}"
        return code

    def end(self) -> None:
        """Has it gone, whatever state it is in."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def is_up(self) -> bool:
        """Whether there is one that was not killed."""
        return bool(self.lives) and self.lives[-1].ended is None

    def down(self) -> list[tuple[float, float]]:
        """From when until when there was none."""
        return [
            (before.ended, after.listening)
            for before, after in zip(self.lives, self.lives[1:], strict=False)
            if before.ended is not None
        ]

    def health(self) -> list[str] | None:
        """Why it is not healthy, by code; None if it does not answer."""
        try:
            said = self._fetch("healthz")
        except urllib.error.HTTPError as error:
            said = error.read()
        except OSError:
            return None
        return [reason["code"] for reason in json.loads(said)["reasons"]]

    def metrics(self) -> str | None:
        """What it tells Prometheus; None if it does not answer."""
        try:
            return self._fetch("metrics").decode()
        except OSError:
            return None

    def _fetch(self, page: str) -> bytes:
        with urllib.request.urlopen(f"http://{self._http}/{page}", timeout=5.0) as answer:
            said: bytes = answer.read()
            return said


def free_ports(count: int) -> list[int]:
    """Ports that nobody listens on yet."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for free in sockets:
            free.bind(("127.0.0.1", 0))
        return [free.getsockname()[1] for free in sockets]
    finally:
        for free in sockets:
            free.close()
