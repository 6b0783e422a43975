"""The real daemon, on a port of its own."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import selectors
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

import jostle
from needs import pytest_sessionfinish as pytest_sessionfinish

ROOT = Path(__file__).resolve().parents[3]
JOSTLED = Path(os.environ.get("JOSTLED", ROOT / "target" / "release" / "jostled"))

# After so long a test takes for hung what it waits for. No claim about time: on a machine whose
# every core is busy, what takes 1 s otherwise takes 20.
PATIENCE_SECS = 60.0

# A shell starts background jobs with SIGINT ignored, which child processes inherit: without this
# the programs that the tests interrupt would ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)


class Daemon:
    """A `jostled serve` of this test run's own."""

    def __init__(
        self,
        folder: Path,
        listen: str = "tcp/127.0.0.1:0",
        failing: str | None = None,
        node: str | None = None,
    ) -> None:
        self.data = folder / "data"
        self.log = folder / "jostled.log"
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [
                    *(JOSTLED, "serve", "--listen", listen, "--http", "", "--data-dir", self.data),
                    *(() if node is None else ("--node", node)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=folder,
                # Where it is to fail, such as `command=panic`.
                env=os.environ if failing is None else {**os.environ, "FAILPOINTS": failing},
            )
        try:
            self.endpoint = self._read_endpoint()
        except BaseException:
            self.kill()
            raise

    def _read_endpoint(self) -> str:
        """Waits for the line that says where it listens."""
        assert self.process.stdout is not None
        deadline = time.monotonic() + PATIENCE_SECS
        said = b""
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            while time.monotonic() < deadline:
                if not selector.select(deadline - time.monotonic()):
                    break
                chunk = os.read(self.process.stdout.fileno(), 4096)
                said += chunk
                if found := re.search(rb"listening on (\S+)\n", said):
                    return found[1].decode()
                if not chunk:
                    break
        raise AssertionError(f"jostled does not listen: {said!r}, {self.log.read_text()}")

    def stop(self) -> int:
        """Asks it to stop, as a service manager would, and returns its exit code."""
        self.process.terminate()
        return self._reap()

    def kill(self) -> None:
        """Ends it where it stands."""
        self.process.kill()
        self._reap()

    def freeze(self) -> None:
        """Stops it from running without ending it."""
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Lets it run again."""
        self.process.send_signal(signal.SIGCONT)

    def _reap(self) -> int:
        try:
            return self.process.wait(PATIENCE_SECS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        finally:
            assert self.process.stdout is not None
            self.process.stdout.close()


class Wire:
    """A cable between clients and a daemon, to be cut, stalled and slowed."""

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
        """Lets nothing more through from the daemon, until it is cut."""
        self._is_mute = True

    def cut(self) -> None:
        """Ends every connection; those made from now on work."""
        with self._lock:
            ends, self._ends = self._ends, []
            for end in ends:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
            # Only now: a reply that is under way must not pass.
            self._is_mute = False

    def unplug(self) -> None:
        """Ends every connection, and those made from now on at once."""
        self._is_out = True
        self.cut()

    def plug(self) -> None:
        """Has all flow again, what was held up as well."""
        self._is_out = False
        self._flows.set()

    def stall(self) -> None:
        """Holds up all that is sent, either way."""
        self._flows.clear()

    def slow(self, seconds: float) -> None:
        """Delays all that is sent by as long, either way."""
        self._delay = seconds

    def close(self) -> None:
        """Ends every connection and takes no more."""
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


@pytest.fixture
def wire(daemon: Daemon) -> Iterator[Wire]:
    """A cable to the shared daemon."""
    wire = Wire(daemon.endpoint)
    yield wire
    wire.close()


@pytest.fixture(scope="session")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """One daemon for every test that does it no harm."""
    daemon = Daemon(tmp_path_factory.mktemp("daemon"))
    yield daemon
    assert daemon.stop() == 0, daemon.log.read_text()


@pytest.fixture
def own_daemon(tmp_path: Path) -> Iterator[Daemon]:
    """A daemon for one test that does it harm."""
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
    """Creates swarms of names of their own, and deletes them after the test."""
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
    """Waits until `holds`, which asks the daemon, or fails saying `what` did not come about."""
    deadline = time.monotonic() + PATIENCE_SECS
    while not holds():
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_SECS} s"
        # What it waits for needs the core, too.
        time.sleep(0.01)


def find_free_endpoint() -> str:
    """An endpoint on which no process listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@pytest.fixture
def free_endpoint() -> str:
    """An endpoint on which no process listens."""
    return find_free_endpoint()


def zenoh_session(endpoint: str, mode: str = "connect") -> zenoh.Session:
    """A session of zenoh's own, that connects or listens there."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"' if mode == "connect" else '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{mode}/endpoints", f'["{endpoint}"]')
    return zenoh.open(config)
