"""The real daemon, on a free port."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

import jostle
from chaos.node import free_ports
from needs import pytest_sessionfinish as pytest_sessionfinish

ROOT = Path(__file__).resolve().parents[3]
JOSTLED = Path(os.environ.get("JOSTLED", ROOT / "target" / "release" / "jostled"))

# A wait fails after this time. It does not measure performance: on a machine whose
# every core is busy, what takes 1 s otherwise takes 20.
MAX_WAIT_SECS = 60.0

# A shell starts background jobs with SIGINT ignored, which child processes inherit: without this
# the programs that the tests interrupt would ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)


class Daemon:
    """A `jostled serve` of this test run."""

    def __init__(
        self,
        folder: Path,
        listen: str = "tcp/127.0.0.1:0",
        failing: str | None = None,
        node: str | None = None,
        http: str = "",
    ) -> None:
        self.data = folder / "data"
        self.log = folder / "jostled.log"
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [
                    *(JOSTLED, "serve", "--listen", listen, "--http", http),
                    *("--data-dir", self.data),
                    *(() if node is None else ("--node", node)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=folder,
                # A failpoint, such as `command=panic`.
                env=os.environ if failing is None else {**os.environ, "FAILPOINTS": failing},
            )
        self._output = b""
        try:
            self.endpoint = self._read(rb"listening on (\S+)\n")
            self.http = self._read(rb"http on (\S+)\n") if http else ""
        except BaseException:
            self.kill()
            raise

    def _read(self, pattern: bytes) -> str:
        """Waits until the standard output has a match of the pattern; returns its first group."""
        assert self.process.stdout is not None
        deadline = time.monotonic() + MAX_WAIT_SECS
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            while (found := re.search(pattern, self._output)) is None:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    break
                chunk = os.read(self.process.stdout.fileno(), 4096)
                self._output += chunk
                if not chunk:
                    break
        if found is None:
            raise AssertionError(f"jostled: {self._output!r}, {self.log.read_text()}")
        return found[1].decode()

    def stop(self) -> int:
        """Stops it with SIGTERM, as a service manager would, and returns its exit code."""
        self.process.terminate()
        return self._reap()

    def kill(self) -> None:
        """Kills it with SIGKILL."""
        self.process.kill()
        self._reap()

    def freeze(self) -> None:
        """Stops its process with SIGSTOP."""
        self.process.send_signal(signal.SIGSTOP)
        # Some of its threads may still run when the signal has been sent.
        os.waitid(os.P_PID, self.process.pid, os.WSTOPPED)

    def thaw(self) -> None:
        """Resumes its process."""
        self.process.send_signal(signal.SIGCONT)

    def _reap(self) -> int:
        try:
            return self.process.wait(MAX_WAIT_SECS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        finally:
            assert self.process.stdout is not None
            self.process.stdout.close()


class Wire:
    """A proxy between clients and a daemon that can be cut, stalled and slowed."""

    def __init__(self, endpoint: str) -> None:
        self.daemon = endpoint
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._lock = threading.Lock()
        self._is_mute = False
        self._is_out = False
        self._delay = 0.0
        self._flows = threading.Event()
        self._flows.set()
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def mute(self) -> None:
        """Drops everything the daemon sends, until `cut`."""
        self._is_mute = True

    def cut(self) -> None:
        """Closes every connection; new ones work."""
        with self._lock:
            ends, self._ends = self._ends, []
            for end in ends:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
            # Only now: a reply in transit must not pass.
            self._is_mute = False

    def unplug(self) -> None:
        """Closes every connection, and new ones at once."""
        self._is_out = True
        self.cut()

    def plug(self) -> None:
        """Forwards again, including what was held back."""
        self._is_out = False
        self._flows.set()

    def stall(self) -> None:
        """Holds back everything, in both directions."""
        self._flows.clear()

    def slow(self, seconds: float) -> None:
        """Delays everything by `secs`, in both directions."""
        self._delay = seconds

    def close(self) -> None:
        """Closes every connection and accepts no more."""
        self._listener.close()
        self._flows.set()
        self.cut()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                if self._is_out:
                    client.close()
                    continue
                host, port = self.daemon.removeprefix("tcp/").split(":")
                try:
                    daemon = socket.create_connection((host, int(port)))
                except OSError:
                    client.close()
                    continue
                with self._lock:
                    self._ends += [client, daemon]
                for ends, may_be_mute in (((client, daemon), False), ((daemon, client), True)):
                    threading.Thread(
                        target=self._carry, args=(*ends, may_be_mute), daemon=True
                    ).start()

    def _carry(self, source: socket.socket, target: socket.socket, may_be_mute: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self._flows.wait()
                time.sleep(self._delay)
                if not (may_be_mute and self._is_mute):
                    target.sendall(data)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_RDWR)


ROUTER = """
import json, sys, zenoh
config = zenoh.Config()
for key, value in json.loads(sys.argv[1]).items():
    config.insert_json5(key, json.dumps(value))
session = zenoh.open(config)
print("there", flush=True)
sys.stdin.read()
"""


class Router:
    """A zenoh router in a separate process, which retries its connections."""

    def __init__(self, *endpoints: str, listen: str | None = None) -> None:
        self.endpoint = find_free_endpoint() if listen is None else listen
        config = {
            "mode": "router",
            "listen/endpoints": [self.endpoint],
            "connect/endpoints": endpoints,
            "connect/exit_on_failure": False,
            "connect/retry": {
                "period_init_ms": 100,
                "period_max_ms": 200,
                "period_increase_factor": 2,
            },
            "scouting/multicast/enabled": False,
        }
        self.process = subprocess.Popen(
            [sys.executable, "-c", ROUTER, json.dumps(config)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"there\n"

    def close(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def jostled_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names the daemon's program in the environment, for `local` and `sweep`."""
    monkeypatch.setenv("JOSTLED", str(JOSTLED))


@pytest.fixture
def wire(daemon: Daemon) -> Iterator[Wire]:
    """A proxy to the shared daemon."""
    wire = Wire(daemon.endpoint)
    yield wire
    wire.close()


@pytest.fixture(scope="session")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """One daemon for all tests that do not stop or change it."""
    daemon = Daemon(tmp_path_factory.mktemp("daemon"))
    yield daemon
    assert daemon.stop() == 0, daemon.log.read_text()


@pytest.fixture
def own_daemon(tmp_path: Path) -> Iterator[Daemon]:
    """A daemon for one test that stops or changes it."""
    daemon = Daemon(tmp_path)
    yield daemon
    if daemon.process.poll() is None:
        daemon.kill()


@pytest.fixture
def client(daemon: Daemon) -> Iterator[jostle.Client]:
    """A client of the shared daemon."""
    with jostle.connect(daemon.endpoint, client="pytest") as client:
        yield client


_numbers = itertools.count(1)


@pytest.fixture
def create(client: jostle.Client) -> Iterator[Callable[..., jostle.Swarm]]:
    """Creates swarms with unique names, and deletes them after the test."""
    created: list[jostle.Swarm] = []

    def create(n: int = 5, **fields: object) -> jostle.Swarm:
        swarm = client.create(f"test-{next(_numbers)}", {"n": n, **fields})
        created.append(swarm)
        return swarm

    yield create
    names = {summary.swarm for summary in client.swarms()}
    for swarm in created:
        if swarm.name in names:
            swarm.delete()


def eventually(what: str, holds: Callable[[], bool]) -> None:
    """Polls until `holds`, which queries the daemon, returns true; fails with `what` otherwise."""
    deadline = time.monotonic() + MAX_WAIT_SECS
    while not holds():
        assert time.monotonic() < deadline, f"{what}: not within {MAX_WAIT_SECS} s"
        # The daemon needs the core, too.
        time.sleep(0.01)


def find_free_endpoint() -> str:
    """An endpoint on which no process listens."""
    return f"tcp/127.0.0.1:{free_ports(1)[0]}"


@pytest.fixture
def free_endpoint() -> str:
    """An endpoint on which no process listens."""
    return find_free_endpoint()


def zenoh_session(endpoint: str, mode: str = "connect") -> zenoh.Session:
    """A plain zenoh session that connects or listens there."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"' if mode == "connect" else '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{mode}/endpoints", f'["{endpoint}"]')
    return zenoh.open(config)
