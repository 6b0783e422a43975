"""Runs the test in PID and mount namespaces of its own, with a small disk for the daemon."""

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

_INSIDE = "JOSTLE_CHAOS_INSIDE"
_UNSHARE = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]


def enter() -> int | Path:
    """Restarts this program in PID and mount namespaces of its own.

    However this process ends, the kernel then kills all processes of the test.

    Returns:
        In the new namespaces the folder to work in; outside the exit code of that program.
    """
    if _INSIDE in os.environ:
        return Path(os.environ[_INSIDE])
    unshare = _UNSHARE if os.geteuid() == 0 else [*_UNSHARE, "--map-root-user"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode != 0
    ):
        if needs.may_skip("mount", "the chaos test"):
            print("skipped, needs mount", flush=True)
            return 0
        print(needs.refusal("mount", "run it where `unshare --mount` works"), file=sys.stderr)
        return 1
    command = [*unshare, sys.executable, "-m", "chaos", *sys.argv[1:]]
    with (
        tempfile.TemporaryDirectory(prefix="jostle-chaos-") as work,
        subprocess.Popen(command, env={**os.environ, _INSIDE: work}) as inner,
    ):

        def end(number: int, frame: types.FrameType | None) -> None:
            # The kernel kills all processes of a PID namespace with its first one.
            inner.kill()

        signal.signal(signal.SIGTERM, end)
        while True:
            # Ctrl-C also reaches the inner process, which then ends.
            with contextlib.suppress(KeyboardInterrupt):
                return inner.wait()


class Disk:
    """A small disk for the data of the daemon."""

    def __init__(self, path: Path, megabytes: int) -> None:
        self.path = path
        self.megabytes = megabytes
        path.mkdir()
        size = f"size={megabytes}m"
        subprocess.run(["mount", "-t", "tmpfs", "-o", size, "none", path], check=True)

    def used_megabytes(self) -> float:
        """The space in use."""
        return shutil.disk_usage(self.path).used / 2**20

    def fill(self) -> None:
        """Uses up the free space to the byte."""
        with (self.path / "ballast").open("ab", buffering=0) as ballast:
            for size in (65536, 4096, 1):
                with contextlib.suppress(OSError):
                    while ballast.write(bytes(size)):
                        pass

    def free(self) -> None:
        """Frees the space that `fill` used up."""
        (self.path / "ballast").unlink(missing_ok=True)
