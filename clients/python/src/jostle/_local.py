"""A daemon of one's own, for as long as the program runs."""

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
from ._client import Client, open_link
from ._errors import InvalidArgument, Unavailable
from ._link import Link
from ._progress import Bar
from ._watchdog import with_watchdog

# A daemon that finds a large folder tells its swarms' pasts before it listens.
_START_SECS = 120.0
_STOP_SECS = 10.0
_LOOK_AGAIN_SECS = 0.05
_LOG_LINES = 20

# Settings that are not for the caller to say, and why.
_OWN = {
    "listen": "is a free port of this machine: read it from `endpoint`",
    "data_dir": "is what `folder` says",
    "prefix": "is of no use to a daemon that nobody else knows of",
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
    """Starts a daemon that nobody else knows of, and connects with it.

        with jostle.local() as client:
            swarm = client.create("school", jostle.Spec(n=50))

    It is stopped by `close()`, when the `with` block is left, when nobody holds the client or a
    swarm of it any more, and when this process ends, even by `kill -9`. There may be any number.

    Args:
        folder: Where everything is kept: swarms that are there already go on. None is a temporary
            folder, and nothing is kept.
        jostled: The program; None is what the environment's `JOSTLED` names, or else the one that
            the wheel installed, or else `jostled` on the `PATH`.
        client: Who commands say they are from, as `connect` takes it.
        timeout: Seconds that every command may take unless it says otherwise.
        show: Show that it is being started; None is if that is seen, on a terminal or in a
            notebook, and takes a while, as with much in its folder.
        settings: What `jostled config explain` lists, such as `max_individuals=5000`; HTTP is not
            served unless `http` says where.

    Raises:
        InvalidArgument: A setting is not one that can be given here.
        OSError: The folder cannot be made.
        Unavailable: There is no `jostled`, or it does not start; its log says why.
    """
    seconds = check_seconds("timeout", timeout)
    daemon = Daemon(_program.find(jostled), folder, settings, show)
    try:
        link, node = open_link(daemon.endpoint, client=client, timeout=seconds)
    except BaseException:
        daemon.stop()
        raise
    # Swarms and streams hold the link, and so the daemon lives as long as any of them.
    link.held = daemon
    return Local(link, node, daemon)


class Local(Client):
    """A client and a daemon of its own; `local` makes one.

    Closing it stops the daemon, and so does the end of this process. Other programs may connect
    with `endpoint` meanwhile.
    """

    def __init__(self, link: Link, node: str, daemon: Daemon) -> None:
        super().__init__(link, node)
        self._daemon = daemon

    @property
    def folder(self) -> Path:
        """Where the daemon keeps everything; a temporary one goes with it."""
        return self._daemon.folder

    @property
    def log(self) -> Path:
        """What the daemon has to say, a file in its folder."""
        return self._daemon.log

    @property
    def pid(self) -> int:
        """The daemon's process."""
        return self._daemon.pid

    def __repr__(self) -> str:
        return f"Local({self.node!r} at {self.endpoint}, {str(self.folder)!r})"

    def close(self) -> None:
        """Ends every stream, the connection and the daemon; harmless when done already."""
        if self._daemon.is_ours():
            super().close()
            self._daemon.stop()


class Daemon:
    """A `jostled` that ends with this process."""

    def __init__(
        self,
        program: str,
        folder: str | os.PathLike[str] | None,
        settings: Mapping[str, str | float],
        show: bool | None,
    ) -> None:
        flags = _flags(settings)
        self._stopping = threading.Lock()
        self._owner = os.getpid()
        self._is_temporary = folder is None
        self._process: subprocess.Popen[bytes] | None = None
        self._held: int | None = None
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
        """Its process."""
        assert self._process is not None
        return self._process.pid

    def is_ours(self) -> bool:
        """Whether this process started it, and not one that this was forked from."""
        return os.getpid() == self._owner

    def stop(self) -> None:
        """Stops it and removes what is temporary; harmless when done already."""
        if not self.is_ours():
            return
        with self._stopping:
            if self._process is not None and self._process.poll() is None:
                self._process.terminate()
                try:
                    self._process.wait(_STOP_SECS)
                except subprocess.TimeoutExpired:
                    self._process.kill()
                    self._process.wait()
            if self._held is not None:
                # Nothing is left to do for the watchdog.
                with contextlib.suppress(OSError):
                    os.write(self._held, b"\n")
                self._let_go()
            if self._is_temporary:
                shutil.rmtree(self.folder, ignore_errors=True)

    def forget(self) -> None:
        """Takes it for another process's from now on."""
        self._let_go()
        if self._process is not None:
            # Or it is warned of one that was left running.
            self._process.returncode = 0

    def _let_go(self) -> None:
        """Closes this process's end of what shows the watchdog that it lives."""
        if self._held is not None:
            os.close(self._held)
            self._held = None

    def __del__(self) -> None:
        # A failed constructor has stopped it.
        if hasattr(self, "endpoint"):
            self.stop()

    def _start(self, command: list[str], show: bool | None) -> str:
        """Starts it and returns its endpoint."""
        folder = str(self.folder)
        where = ["--listen", "tcp/127.0.0.1:0", "--data-dir", folder]
        command = [command[0], "serve", *where, *command[1:]]
        stdin, self._held = os.pipe()
        try:
            with self.log.open("ab") as log:
                written = log.tell()
                self._process = subprocess.Popen(
                    with_watchdog(command, folder if self._is_temporary else ""),
                    stdin=stdin,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    # A Ctrl-C is for this program, which says itself when the daemon is to stop.
                    start_new_session=True,
                )
        finally:
            os.close(stdin)
        assert self._process.stdout is not None
        with self._process.stdout as stdout, Bar("jostled", show) as bar:
            return self._read_endpoint(stdout, written, bar)

    def _read_endpoint(self, stdout: IO[bytes], written: int, bar: Bar) -> str:
        """Waits for the line that says where it listens; its log is as long as `written` before."""
        deadline = time.monotonic() + _START_SECS
        said = b""
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while time.monotonic() < deadline:
                _cancel.check()
                bar.show(None, f"is starting in {self.folder}")
                if not selector.select(_LOOK_AGAIN_SECS):
                    continue
                chunk = os.read(stdout.fileno(), 4096)
                said += chunk
                if found := re.search(rb"^listening on (\S+)\n", said, re.M):
                    return found[1].decode()
                if not chunk:
                    break
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            # What has closed its output is about to end.
            self._process.wait(1.0 if time.monotonic() < deadline else 0.0)
        code = self._process.poll()
        how = f"does not listen after {_START_SECS:.0f} s" if code is None else f"ended with {code}"
        with self.log.open("rb") as log:
            log.seek(written)
            lines = log.read().decode(errors="replace").strip().splitlines()[-_LOG_LINES:]
        raise Unavailable(
            f"the daemon {how} and did not start; it says:\n" + "\n".join(lines),
            details={"exit_code": code, "log": lines},
        )


_daemons: weakref.WeakSet[Daemon] = weakref.WeakSet()


@atexit.register
def _stop_daemons() -> None:
    for daemon in list(_daemons):
        daemon.stop()


def _forget_daemons() -> None:
    """In a process forked from this one: they are not its own, and do not live as long as it."""
    for daemon in list(_daemons):
        daemon.forget()


os.register_at_fork(after_in_child=_forget_daemons)


def _flags(settings: Mapping[str, str | float]) -> list[str]:
    """The settings as the program takes them.

    Raises:
        InvalidArgument: One is no setting, or said otherwise.
    """
    flags = []
    for name, value in {"node": "local", "http": "", **settings}.items():
        if name in _OWN:
            raise InvalidArgument(f"{name!r} {_OWN[name]}", details={"field": name})
        flags.append(f"--{name.replace('_', '-')}={value}")
    return flags
