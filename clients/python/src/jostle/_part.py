"""A part of an experiment as a task of an executor."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from . import _program
from ._delivery import RUNS, Kept, Returned, Stored, Target, TooLarge, dask_worker, deliver
from ._errors import Conflict, Faulted, JostleError
from ._experiment import Files
from ._watchdog import with_watchdog

_ERROR_LINES = 20


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """The first line of a `runs.jsonl`.

    Attributes:
        model_version: The version of the model that executed its runs.
        definitions: The number of the definitions of measures. Earlier versions, which had the
            first ones, wrote none.
    """

    model_version: int | None = None
    definitions: int = 1


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
    files: Files,
    runs: str,
    jostled: str | None,
    target: Target,
    processes: Processes | None = None,
) -> Returned | Stored | Kept:
    """Executes runs of an experiment on one core, in a temporary folder of this machine.

    Args:
        files: The experiment's files.
        runs: The numbers of the runs, such as `17,18,40-60`.
        jostled: Path of `jostled` on this machine; None searches as `jostle.local` does.
        target: Where the caller stores the part.
        processes: Where to add the program while it runs.

    Returns:
        The files of the part, or where they are.

    Raises:
        Faulted: The program failed, or the executor cannot deliver the files; the message contains
            the runs, the host and the last lines of its stderr.
        StorageFull: The disk of the caller is full.
        Unavailable: There is no program.
    """
    worker = dask_worker() if target.reads_workers else None
    try:
        return _run(files, runs, jostled, target, worker, processes)
    except TooLarge as error:
        raise _failed(runs, str(error)) from None
    except JostleError:
        # `Unavailable` is also an `OSError`.
        raise
    except OSError as error:
        remedy = ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES):
            setting = "set TMPDIR on" if worker is None else "set --local-directory of"
            remedy = f"; {setting} the worker to a folder with space"
        raise _failed(runs, f"{error}{remedy}") from error


def _failed(runs: str, why: str) -> Faulted:
    host = os.uname().nodename
    return Faulted(f"runs {runs} on {host}: {why}", details={"runs": runs, "host": host})


def _run(
    files: Files,
    runs: str,
    jostled: str | None,
    target: Target,
    worker: Any | None,
    processes: Processes | None,
) -> Returned | Stored | Kept:
    program = _program.find(jostled)
    # Dask removes the folder of a worker that was killed.
    temporary = tempfile.TemporaryDirectory(
        prefix="jostle-part-",
        dir=None if worker is None else worker.local_directory,
        ignore_cleanup_errors=True,
    )
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(temporary)
        file = files.store(Path(folder))
        part = Path(folder, "part")
        command = [program, "run", str(file), "--runs", runs, "--threads", "1", "--json"]
        code, errors = _call([*command, "-o", str(part)], folder, processes)
        if code != 0:
            lines = errors.decode(errors="replace").strip().splitlines()[-_ERROR_LINES:]
            raise _failed(runs, f"`jostled run` {_ending(code)}: " + "\n".join(lines))
        result = deliver(part, target, worker, temporary)
        if isinstance(result, Kept):
            stack.pop_all()
        return result


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


def check_version(part: Path, model_version: int, others: Header | None) -> None:
    """Checks the version of the model and the definitions with which a part was executed.

    Raises:
        Conflict: The worker has another version than `model_version`, that of this machine, or
            other definitions than the `others`, with which it cannot be merged.
    """
    with (part / RUNS).open("rb") as lines:
        header = msgspec.json.decode(lines.readline(), type=Header)
    if header.model_version != model_version:
        raise Conflict(
            f"a worker has version {header.model_version} of the model and this machine "
            f"{model_version}: install the same version of jostle on all of them",
            details={
                "model_version": header.model_version,
                "theirs": header.model_version,
                "ours": model_version,
            },
        )
    if others is not None and others.definitions != header.definitions:
        raise Conflict(
            f"a worker has the definitions {header.definitions} of measures and other parts "
            f"{others.definitions}: finish the sweep with the version of jostle that began it, on "
            "all machines, or choose another folder",
            details={"theirs": header.definitions, "ours": others.definitions},
        )
