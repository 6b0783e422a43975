"""A place of the day's own: its processes end with it, and its disk is as small as needed."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import types
from pathlib import Path

import needs

_IN_IT = "JOSTLE_DAY_APART"
_UNSHARE = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]


def enter() -> int | Path:
    """Begins this program again where its processes and mounts are its own.

    Whatever ends this process, the kernel ends there everything that the day has started.

    Returns:
        The exit code of what was begun; in there, the folder to work in.
    """
    if _IN_IT in os.environ:
        return Path(os.environ[_IN_IT])
    unshare = _UNSHARE if os.geteuid() == 0 else [*_UNSHARE, "--map-root-user"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode != 0
    ):
        if needs.may_skip("mount", "a day in a lab"):
            print("skipped, needs mount", flush=True)
            return 0
        print(needs.refusal("mount", "run it where `unshare --mount` works"), file=sys.stderr)
        return 1
    command = [*unshare, sys.executable, "-m", "day", *sys.argv[1:]]
    with (
        tempfile.TemporaryDirectory(prefix="jostle-day-") as work,
        subprocess.Popen(command, env={**os.environ, _IN_IT: work}) as inner,
    ):

        def end(number: int, frame: types.FrameType | None) -> None:
            # Its first process goes, and with it the others.
            inner.kill()

        signal.signal(signal.SIGTERM, end)
        while True:
            # Ctrl-C reaches the one within as well, which then ends by itself.
            with contextlib.suppress(KeyboardInterrupt):
                return inner.wait()


class Disk:
    """A small disk of the daemon's."""

    def __init__(self, path: Path, megabytes: int) -> None:
        self.path = path
        self.megabytes = megabytes
        path.mkdir()
        size = f"size={megabytes}m"
        subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", path], check=True)

    def used_megabytes(self) -> float:
        """What is on it."""
        return shutil.disk_usage(self.path).used / 2**20

    def fill(self) -> None:
        """Leaves no byte."""
        with (self.path / "ballast").open("ab", buffering=0) as ballast:
            for size in (65536, 4096, 1):
                with contextlib.suppress(OSError):
                    while ballast.write(bytes(size)):
                        pass

    def free(self) -> None:
        """Leaves room again."""
        (self.path / "ballast").unlink(missing_ok=True)
