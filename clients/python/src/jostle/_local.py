"""A private daemon that ends with this process."""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import selectors
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from . import _cancel, _program
from ._arguments import check_seconds
from ._client import Client
from ._connect import open_session
from ._errors import Unavailable, invalid
from ._progress import Bar
from ._session import Session
from ._shutdown import check_usable
from ._watchdog import with_watchdog

# A daemon replays the journals of its folder before it listens.
_START_TIMEOUT_SECS = 120.0
_STOP_TIMEOUT_SECS = 10.0
_POLL_INTERVAL_SECS = 0.05
_LOG_LINES = 20

# Settings that the caller cannot give, and why.
_RESERVED = {
    "listen": "is a free port of this machine: read it from `endpoint`",
    "data_dir": "is the argument `folder`",
    "prefix": "has no use for a private daemon",
}


def local(
    folder: str | os.PathLike[str] | None = None,
    *,
    jostled: str | os.PathLike[str] | None = None,
    client: str | None = None,
    timeout: float = 5.0,
    show: bool | None = None,
    **settings: str | float,
) -> Local:
    """Starts a private daemon and connects to it.

        with jostle.local() as client:
            swarm = client.create("school", jostle.Spec(n=50))

    It ends when `close()` is called, when the `with` block is left, when the last reference to the
    client and its swarms is dropped, and when this process ends, even by `kill -9`. A process may
    start any number.

    Args:
        folder: The data directory; its swarms are loaded. None is a temporary folder, which is
            deleted at the end.
        jostled: The program; None is the environment's `JOSTLED`, or else the program of the
            installed wheel, or else `jostled` on the `PATH`.
        client: The client's name, see `connect`.
        timeout: Seconds of every request without a timeout of its own.
        show: Show a progress bar; None shows it on a terminal and in a notebook, if the start takes
            long, such as with a large folder.
        settings: Settings of `jostled config explain`, such as `max_individuals=5000`; without
            `http` there is no HTTP server.

    Raises:
        InvalidArgument: A setting cannot be given here.
        OSError: The folder cannot be created.
        Unavailable: There is no `jostled`, or it does not start; the message has its log.
    """
    seconds = check_seconds("timeout", timeout)
    # Before a daemon starts to which this process could not connect.
    check_usable()
    daemon = Daemon(_program.find(jostled), folder, settings, show)
    try:
        session, node = open_session(daemon.endpoint, client=client, timeout=seconds)
    except BaseException:
        daemon.stop()
        raise
    # Swarms and streams reference the session, and so the daemon lives as long as any of them.
    session.keepalive = daemon
    return Local(session, node, daemon)


class Local(Client):
    """A client with a private daemon; `local` makes one.

    Closing it stops the daemon, and so does the end of this process. Other programs on this machine
    may connect to `endpoint`.
    """

    def __init__(self, session: Session, node: str, daemon: Daemon) -> None:
        super().__init__(session, node)
        self._daemon = daemon

    @property
    def folder(self) -> Path:
        """The data directory of the daemon; a temporary one is deleted with it."""
        return self._daemon.folder

    @property
    def log(self) -> Path:
        """The log file of the daemon, in its folder."""
        return self._daemon.log

    @property
    def pid(self) -> int:
        """The process id of the daemon."""
        return self._daemon.pid

    def __repr__(self) -> str:
        return f"Local({self.node!r} at {self.endpoint}, {str(self.folder)!r})"

    def close(self) -> None:
        """Closes every stream and the connection, and stops the daemon."""
        if self._daemon.is_ours():
            super().close()
            self._daemon.stop()


class Daemon:
    """A process of `jostled` that ends with this process."""

    def __init__(
        self,
        program: str,
        folder: str | os.PathLike[str] | None,
        settings: Mapping[str, str | float],
        show: bool | None,
    ) -> None:
        flags = _flags(settings)
        self._stopping = threading.Lock()
        self._is_stopping = False
        self._owner = os.getpid()
        self._is_temporary = folder is None
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: int | None = None
        self.folder = Path(tempfile.mkdtemp(prefix="jostle-") if folder is None else folder)
        _daemons.add(self)
        try:
            self.folder = self.folder.resolve()
            self.folder.mkdir(parents=True, exist_ok=True)
            self.log = self.folder / "jostled.log"
            self.endpoint = self._start([program, *flags], show)
        except BaseException:
            self.stop()
            raise

    @property
    def pid(self) -> int:
        """Its process id."""
        assert self._process is not None
        return self._process.pid

    def is_ours(self) -> bool:
        """Whether this process started it, not one that this process was forked from."""
        return os.getpid() == self._owner

    def has_ended(self) -> bool:
        """Whether its process has ended, or is about to."""
        return self._is_stopping or self._process is None or self._process.poll() is not None

    def stop(self) -> None:
        """Stops it and deletes a temporary folder; a second call does nothing."""
        if not self.is_ours():
            return
        self._is_stopping = True
        with self._stopping:
            if self._process is not None and self._process.poll() is None:
                self._process.terminate()
                try:
                    self._process.wait(_STOP_TIMEOUT_SECS)
                except subprocess.TimeoutExpired:
                    self._process.kill()
                    self._process.wait()
            if self._pipe is not None:
                # The watchdog exits.
                with contextlib.suppress(OSError):
                    os.write(self._pipe, b"\n")
                self._close_pipe()
            if self._is_temporary:
                shutil.rmtree(self.folder, ignore_errors=True)

    def forget(self) -> None:
        """Releases it in a forked process, without stopping it."""
        self._close_pipe()
        if self._process is not None:
            # Otherwise `subprocess` warns that it is running.
            self._process.returncode = 0

    def _close_pipe(self) -> None:
        """Closes this process's end of the watchdog's pipe."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def __del__(self) -> None:
        # If the constructor raised, it is stopped.
        if hasattr(self, "endpoint"):
            self.stop()

    def _start(self, command: list[str], show: bool | None) -> str:
        """Starts it and returns its endpoint."""
        folder = str(self.folder)
        where = ["--listen", "tcp/127.0.0.1:0", "--data-dir", folder]
        command = [command[0], "serve", *where, *command[1:]]
        stdin, self._pipe = os.pipe()
        try:
            with self.log.open("ab") as log:
                written = log.tell()
                self._process = subprocess.Popen(
                    with_watchdog(command, folder if self._is_temporary else ""),
                    stdin=stdin,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    # Ctrl-C on a terminal reaches only this process, which stops the daemon.
                    start_new_session=True,
                )
        finally:
            os.close(stdin)
        assert self._process.stdout is not None
        with self._process.stdout as stdout, Bar("jostled", show) as bar:
            return self._read_endpoint(stdout, written, bar)

    def _read_endpoint(self, stdout: IO[bytes], written: int, bar: Bar) -> str:
        """Waits for the line with its endpoint; the log has `written` bytes of earlier starts."""
        deadline = time.monotonic() + _START_TIMEOUT_SECS
        output = b""
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while time.monotonic() < deadline:
                _cancel.check()
                bar.show(None, f"is starting in {self.folder}")
                if not selector.select(_POLL_INTERVAL_SECS):
                    continue
                chunk = os.read(stdout.fileno(), 4096)
                output += chunk
                if found := re.search(rb"^listening on (\S+)\n", output, re.M):
                    return found[1].decode()
                if not chunk:
                    break
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            # A program that closes its output is about to end.
            self._process.wait(1.0 if time.monotonic() < deadline else 0.0)
        code = self._process.poll()
        how = (
            f"does not listen after {_START_TIMEOUT_SECS:.0f} s"
            if code is None
            else f"ended with {code}"
        )
        with self.log.open("rb") as log:
            log.seek(written)
            lines = log.read().decode(errors="replace").strip().splitlines()[-_LOG_LINES:]
        raise Unavailable(
            f"the daemon {how} and did not start; its log ends with:\n" + "\n".join(lines),
            details={"exit_code": code, "log": lines},
        )


_daemons: weakref.WeakSet[Daemon] = weakref.WeakSet()


@atexit.register
def _stop_daemons() -> None:
    for daemon in list(_daemons):
        daemon.stop()


def _forget_daemons() -> None:
    """In a forked process: releases the daemons, which belong to the parent."""
    for daemon in list(_daemons):
        daemon.forget()


os.register_at_fork(after_in_child=_forget_daemons)


def _flags(settings: Mapping[str, str | float]) -> list[str]:
    """The settings as arguments of the program.

    Raises:
        InvalidArgument: One of them is reserved.
    """
    flags = []
    for name, value in {"node": "local", "http": "", **settings}.items():
        if name in _RESERVED:
            raise invalid(name, f"{name!r} {_RESERVED[name]}")
        flags.append(f"--{name.replace('_', '-')}={value}")
    return flags
