"""A part of an experiment as a task of an executor, and the archive of its result."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import tarfile
import tempfile
from pathlib import Path

import msgspec

from . import _program
from ._atomic_file import atomic_file
from ._errors import Conflict, Faulted
from ._experiment import EXPERIMENT, POINTS, SET_POINTS, START, Files
from ._watchdog import with_watchdog

# The files that a task returns. Its tables are left out: merging writes them.
FILES = (EXPERIMENT, "runs.jsonl")
# Those that only some experiments have.
OPTIONAL_FILES = (POINTS, SET_POINTS, START)
_ERROR_LINES = 20


class _Header(msgspec.Struct, frozen=True):
    """The first line of the `runs.jsonl` of a part."""

    experiment: str
    model_version: int


class Processes:
    """The programs that this process runs, so that it can terminate them."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._is_terminated = False

    def add(self, process: subprocess.Popen[bytes]) -> None:
        """Adds a program, and terminates it if all were terminated."""
        self._running.add(process)
        if self._is_terminated:
            process.terminate()

    def remove(self, process: subprocess.Popen[bytes]) -> None:
        """Removes a program that has ended."""
        self._running.discard(process)

    def terminate(self) -> None:
        """Terminates all programs, also those that are added later."""
        self._is_terminated = True
        for process in list(self._running):
            process.terminate()


def run_part(
    files: Files, runs: str, jostled: str | None, processes: Processes | None = None
) -> bytes:
    """Executes runs of an experiment on one core, in a temporary folder of this machine.

    Args:
        files: The experiment's files.
        runs: The numbers of the runs, such as `17,18,40-60`.
        jostled: Path of `jostled` on this machine; None searches as `jostle.local` does.
        processes: Where to add the program while it runs.

    Returns:
        The folder of the part, as a compressed tar archive.

    Raises:
        Faulted: The program failed; the message contains the runs, the host and the last lines of
            its stderr.
        Unavailable: There is no program.
    """
    try:
        return _run(files, runs, jostled, processes)
    except OSError as error:
        remedy = ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES):
            remedy = "; set TMPDIR on the worker to a folder with space"
        raise _failed(runs, f"{error}{remedy}") from error


def _failed(runs: str, why: str) -> Faulted:
    host = os.uname().nodename
    return Faulted(f"runs {runs} on {host}: {why}", details={"runs": runs, "host": host})


def _run(files: Files, runs: str, jostled: str | None, processes: Processes | None) -> bytes:
    program = _program.find(jostled)
    with tempfile.TemporaryDirectory(prefix="jostle-part-", ignore_cleanup_errors=True) as folder:
        file = files.store(Path(folder))
        part = Path(folder, "part")
        command = [program, "run", str(file), "--runs", runs, "--threads", "1", "--json"]
        code, errors = _call([*command, "-o", str(part)], folder, processes)
        if code != 0:
            lines = errors.decode(errors="replace").strip().splitlines()[-_ERROR_LINES:]
            raise _failed(runs, f"`jostled run` {_ending(code)}: " + "\n".join(lines))
        archive = io.BytesIO()
        with tarfile.open(fileobj=archive, mode="w:gz", compresslevel=1) as tar:
            for name in (*FILES, *OPTIONAL_FILES):
                if name in FILES or (part / name).exists():
                    tar.add(part / name, arcname=name)
        return archive.getvalue()


def _ending(code: int) -> str:
    """How a process ended, by its return code."""
    if code >= 0:
        return f"exited with {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    reason = " (out of memory?)" if -code == signal.SIGKILL else ""
    return f"was killed by {name}{reason}"


def _call(command: list[str], folder: str, processes: Processes | None) -> tuple[int, bytes]:
    """Runs a command, which is terminated if this process ends. Returns exit code and stderr."""
    stdin, held = os.pipe()
    try:
        try:
            process = subprocess.Popen(
                with_watchdog(command, folder),
                stdin=stdin,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                # Ctrl-C on a terminal reaches only this process, which terminates the program.
                start_new_session=True,
            )
        finally:
            os.close(stdin)
        if processes is not None:
            processes.add(process)
        try:
            _, errors = process.communicate()
        except BaseException:
            process.terminate()
            process.wait()
            raise
        finally:
            if processes is not None:
                processes.remove(process)
            os.write(held, b"\n")
        return process.returncode, errors
    finally:
        os.close(held)


def unpack(archive: bytes, folder: Path, runs: str, model_version: int) -> None:
    """Writes the files of an archive of `run_part`.

    Args:
        archive: The result of the task.
        folder: An empty folder.
        runs: The numbers of its runs.
        model_version: The version of the model on this machine.

    Raises:
        Conflict: The worker has another version of jostle or of the model.
    """
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        names = tar.getnames()
        for name in (*FILES, *OPTIONAL_FILES):
            member = tar.extractfile(name) if name in names else None
            if member is None and name in OPTIONAL_FILES:
                continue
            if member is None:
                raise Conflict(
                    f"the result of runs {runs} has no {name}: install the same version of "
                    "jostle on all workers"
                )
            with atomic_file(folder / name) as file:
                file.write(member.read())
    with (folder / "runs.jsonl").open("rb") as lines:
        header = msgspec.json.decode(lines.readline(), type=_Header)
    if header.model_version != model_version:
        raise Conflict(
            f"a worker has version {header.model_version} of the model and this machine "
            f"{model_version}: install the same version of jostle on all of them",
            details={"theirs": header.model_version, "ours": model_version},
        )
