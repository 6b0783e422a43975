"""Sweeps: executes an experiment in tasks of an executor, on this machine or on many."""

from __future__ import annotations

import concurrent.futures
import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgspec

from . import _part
from ._arguments import check_seconds
from ._errors import (
    Conflict,
    Faulted,
    IncorrectState,
    InvalidArgument,
    StorageFull,
    Unavailable,
    invalid,
)
from ._experiment import EXPERIMENT, Source, read_files
from ._extras import import_extra
from ._plan import Programs, Task
from ._progress import Bar
from ._repr import HtmlList
from ._results import ResultRow, of_rows

if TYPE_CHECKING:
    import pandas

DASK = "dask:"
"""Prefix of the address of a Dask scheduler."""

UNNAMED = "the experiment"
"""What errors call an experiment that is not in a file of the caller."""

# The limit of `jostle experiment plan --secs`.
_MAX_TASK_SECS = 1e9


class _Line(msgspec.Struct, frozen=True):
    """A finished run: any other line of the `runs.jsonl` of a part."""

    run: str
    fault: str | None = None
    row: ResultRow | None = None


def source_label(source: Source) -> str:
    """What errors call an experiment: its file, if it has one."""
    is_text = isinstance(source, Mapping) or (isinstance(source, str) and "\n" in source)
    return UNNAMED if is_text else str(source)


def sweep(
    source: Source,
    executor: Executor | str | Any = None,
    *,
    folder: str | os.PathLike[str],
    task_secs: float = 30.0,
    jostled: str | os.PathLike[str] | None = None,
) -> Sweep:
    """Executes an experiment without a daemon, split into tasks of an executor.

        with jostle.sweep("order.toml", folder="results") as sweep:
            for row in sweep:
                print(row.run, row.v)

    A task is `jostled run` of one or more runs in a temporary folder of the worker; no disk is
    shared. Its results are stored in `FOLDER.parts` and are merged into `folder` when all are
    finished. If a sweep is interrupted, a call with the same folder executes only the missing runs.

    Args:
        source: The experiment: a file, the text of one, or a mapping of its fields.
        executor: Any `concurrent.futures.Executor`; a Dask client; `"dask:tcp://HOST:PORT"`, the
            address of a Dask scheduler, which needs `jostle[dask]`; None is every core of this
            machine. Workers need this package with its programs, in the same version.
        folder: The folder of the results, the same as `jostled run` writes.
        task_secs: Expected seconds of work of a task on one core.
        jostled: Path of `jostled`, the same on this machine and on every worker, with `jostle`
            beside it; None searches as `local` does.

    Raises:
        InvalidArgument: The experiment, the executor or `task_secs` is invalid.
        IncorrectState: The folder contains another experiment, or an unfinished one.
        Conflict: Another process is using the folder.
        Unavailable: There is no program on this machine.
        OSError: A file cannot be read or written.
    """
    secs = check_seconds("task_secs", task_secs)
    if secs > _MAX_TASK_SECS:
        raise invalid(
            "task_secs",
            f"task_secs is {task_secs!r}, but must be at most {_MAX_TASK_SECS:g} seconds",
        )
    problem = ""
    if isinstance(executor, str):
        if not executor.startswith(DASK):
            problem = "use dask:tcp://HOST:PORT, an Executor or a Dask client"
    elif isinstance(executor, type):
        problem = "it is a class; use an instance of it"
    elif executor is not None and not callable(getattr(executor, "submit", None)):
        problem = (
            "it has no method `submit`; use a concurrent.futures.Executor, a Dask client or "
            "dask:tcp://HOST:PORT"
        )
    if problem:
        raise invalid("executor", f"invalid executor {executor!r}: {problem}")
    path = Path(folder)
    if path.exists():
        # A session, or the current folder, which cannot be renamed to.
        path = path.resolve()
    return Sweep(source, executor, path, secs, jostled)


class Sweep:
    """A sweep, which `sweep` creates.

    No task is submitted until the caller iterates over it or calls `wait`. Leaving the `with` block
    or the loop cancels the unfinished tasks; so does an exception, such as KeyboardInterrupt.
    """

    def __init__(
        self,
        source: Source,
        executor: Executor | str | Any,
        folder: Path,
        task_secs: float,
        jostled: str | os.PathLike[str] | None,
    ) -> None:
        self._source = source
        self._files = read_files(source)
        self._executor = executor
        self._jostled = None if jostled is None else os.fspath(jostled)
        self._programs = Programs(self._jostled)
        self._folder = folder
        self._parts = folder.with_name(f"{folder.name}.parts")
        self._rows: HtmlList[ResultRow] = HtmlList()
        self._faults: dict[str, str] = {}
        self._planned: list[Task] = []
        self._done_secs = 0.0
        self._is_merged = False
        self._is_cancelled = False
        # Callbacks of `cancel`, called in reverse order.
        self._open = contextlib.ExitStack()
        try:
            self._open.callback(_lock(self._parts))
            self._open.callback(self._remove_empty)
            self._begin(task_secs)
        except BaseException:
            self._open.close()
            raise

    @property
    def folder(self) -> Path:
        """The folder of the results; it exists when all runs are finished."""
        return self._folder

    @property
    def share(self) -> float:
        """Fraction of the expected work of the tasks that is finished, 0 to 1.

        Runs that earlier sweeps finished do not count.
        """
        total = sum(task.expected_secs for task in self._planned)
        return min(self._done_secs / total, 1.0) if total > 0 else 1.0

    def __repr__(self) -> str:
        return f"Sweep({str(self._folder)!r}, {len(self._rows)} rows)"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.cancel()

    def __iter__(self) -> Iterator[ResultRow]:
        """The rows of all runs: those that are finished already, then each when it arrives.

        Raises:
            Faulted: One or more tasks failed on a worker; the message names their runs. All others
                are finished.
            Conflict: A worker has another version of the model.
            IncorrectState: The sweep was cancelled.
            StorageFull: The disk of this machine is full.
            Unavailable: The executor lost its tasks. A sweep with the same folder resumes.
        """
        yield from list(self._rows)
        for rows in self._results():
            yield from rows

    def wait(self, *, show: bool | None = None) -> Self:
        """Waits until all runs are finished and merged.

        Args:
            show: Show a bar; None shows it on a terminal and in a notebook.

        Raises:
            Faulted: One or more tasks failed on a worker; the message names their runs. All others
                are finished.
            Conflict: A worker has another version of the model.
            IncorrectState: The sweep was cancelled.
            StorageFull: The disk of this machine is full.
            Unavailable: The executor lost its tasks. A sweep with the same folder resumes.
        """
        with Bar(self._folder.name, show) as bar:
            bar.show(self.share, f"{len(self._rows)} runs")
            for _ in self._results():
                bar.show(self.share, f"{len(self._rows)} runs")
        return self

    def rows(self) -> list[ResultRow]:
        """The rows of the finished runs; in the order of the plan once all are finished."""
        return HtmlList(self._rows)

    def faults(self) -> dict[str, str]:
        """The runs that ended early, each with its reason. They are finished, and have a row."""
        return dict(self._faults)

    def frame(self) -> pandas.DataFrame:
        """The rows as a table of pandas, with the columns of `results.csv`.

        Raises:
            ImportError: pandas is missing; `pip install jostle[pandas]` installs it.
        """
        return of_rows(self._rows)

    def cancel(self) -> None:
        """Cancels the unfinished tasks. Received results are kept: see `folder` of `sweep`."""
        if not self._is_merged:
            self._is_cancelled = True
        self._open.close()

    def _remove_empty(self) -> None:
        """Removes the folder of the parts if it has none."""
        if not self._done():
            shutil.rmtree(self._parts, ignore_errors=True)

    def _begin(self, task_secs: float) -> None:
        """Reads the results that exist, and plans tasks for the missing runs."""
        with contextlib.suppress(FileNotFoundError):
            if any(self._folder.iterdir()):
                self._check_merged()
                self._read(self._folder)
                self._end_merged()
                return
        done = self._done()
        if done and not self._files.is_stored(self._parts):
            raise IncorrectState(
                f"{self._parts} contains parts of another experiment: remove it, or choose another "
                "folder",
                details={"field": "folder"},
            )
        file = self._files.store(self._parts)
        for draft in self._parts.glob(".*"):
            # A part that was being written when an earlier sweep was killed.
            shutil.rmtree(draft, ignore_errors=True)
        try:
            self._planned = self._programs.plan(file, task_secs, self._parts)
        except InvalidArgument as error:
            raise self._renamed(error, file) from None
        for part in done:
            self._read(part)

    def _renamed(self, error: InvalidArgument, file: Path) -> InvalidArgument:
        """The error with the caller's name of the experiment in place of the copy's."""
        rest = error.message.removeprefix(str(file))
        name = source_label(self._source) if rest != error.message else ""
        return InvalidArgument(name + rest, details=error.details)

    def _check_merged(self) -> None:
        """Checks that the folder has all results of this experiment."""
        # As `jostled run` compares them.
        if not self._files.is_stored(self._folder):
            raise IncorrectState(
                f"{self._folder} contains another experiment or other files: choose another folder",
                details={"field": "folder"},
            )
        file = self._folder / EXPERIMENT
        if self._programs.plan(file, 1e9, self._folder):
            raise IncorrectState(
                f"{self._folder} contains an unfinished experiment: finish it with `jostled run "
                f"{file} -o {self._folder}`, or choose another folder",
                details={"field": "folder"},
            )

    def _end_merged(self) -> None:
        """Called when the results are in the folder: removes the parts, and then unlocks them."""
        self._is_merged = True
        shutil.rmtree(self._parts, ignore_errors=True)
        self._open.close()

    def _submit(self) -> dict[Future[bytes], Task]:
        """Submits a task for the missing runs. `cancel` cancels them."""
        executor: Any = self._executor
        if isinstance(executor, str):
            distributed = import_extra("distributed", "dask")
            address = executor.removeprefix(DASK)
            try:
                client = distributed.Client(address, set_as_default=False)
            except (OSError, ValueError, TypeError) as error:
                raise Unavailable(
                    f"no Dask scheduler answers at {address}: {error}; check the address, and "
                    "whether the scheduler runs",
                    details={"field": "executor"},
                ) from None
            # The connection may be lost already.
            self._open.callback(lambda: _ignore_errors(client.close))
            executor = client
        if hasattr(executor, "get_executor"):
            # `pure=False`: otherwise Dask gives equal tasks of two sweeps the same key, and
            # cancelling one sweep cancels both.
            executor = executor.get_executor(pure=False)
            self._open.callback(lambda: _ignore_errors(executor.shutdown, wait=False))
        arguments: tuple[Any, ...] = (self._jostled,)
        if executor is None:
            processes = _part.Processes()
            executor = ThreadPoolExecutor(len(os.sched_getaffinity(0)))
            self._open.callback(executor.shutdown, wait=True, cancel_futures=True)
            self._open.callback(processes.terminate)
            arguments = (self._jostled, processes)
        tasks: dict[Future[bytes], Task] = {}

        def cancel() -> None:
            for future in tasks:
                future.cancel()

        self._open.callback(_ignore_errors, cancel)
        for task in self._planned:
            tasks[executor.submit(_part.run_part, self._files, task.runs, *arguments)] = task
        return tasks

    def _results(self) -> Iterator[list[ResultRow]]:
        """The rows of each task when it is finished. Then all are merged."""
        if self._is_merged:
            return
        if self._is_cancelled:
            raise IncorrectState(
                "the sweep was cancelled: call `sweep` again with the same folder to resume it",
                details={"field": "folder"},
            )
        failed: list[str] = []
        try:
            tasks = self._submit() if self._planned else {}
            for future in concurrent.futures.as_completed(list(tasks)):
                task = tasks[future]
                try:
                    archive = future.result()
                except concurrent.futures.CancelledError:
                    raise Unavailable(
                        f"the tasks of runs {task.runs} and others were lost or cancelled: call "
                        "`sweep` again with the same folder to resume it",
                        details={"runs": task.runs},
                    ) from None
                except Faulted as error:
                    failed.append(error.message)
                    continue
                except Exception as error:
                    # An error of the executor, or of the worker before it calls `run_part`.
                    failed.append(f"runs {task.runs}: {error!r}")
                    continue
                part = self._store(task, archive)
                self._done_secs += task.expected_secs
                yield self._read(part)
            self._end(failed)
        except BaseException:
            self.cancel()
            raise

    def _end(self, failed: list[str]) -> None:
        """Merges all parts, unless tasks failed."""
        if failed:
            more = f" and {len(failed) - 5} more" if len(failed) > 5 else ""
            raise Faulted(
                f"{len(failed)} tasks failed: {'; '.join(failed[:5])}{more}. Call `sweep` again "
                "with the same folder to execute them again",
                details={"failed": failed},
            )
        self._programs.merge(self._parts, self._folder)
        self._rows, self._faults = HtmlList(), {}
        self._read(self._folder)
        self._end_merged()

    def _store(self, task: Task, archive: bytes) -> Path:
        """Writes a part atomically: to a temporary folder, which is then renamed."""
        name = hashlib.blake2b(task.runs.encode(), digest_size=8).hexdigest()
        draft, part = (self._parts / f"{prefix}runs-{name}" for prefix in (".", ""))
        try:
            draft.mkdir()
            _part.unpack(archive, draft, task.runs, task.model_version)
            draft.rename(part)
        except BaseException as error:
            shutil.rmtree(draft, ignore_errors=True)
            if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise StorageFull(
                    f"failed to write a part to {self._parts}: {error}; free disk space, and call "
                    "`sweep` again with the same folder"
                ) from error
            raise
        return part

    def _read(self, part: Path) -> list[ResultRow]:
        """Adds the rows and faults of a folder, and returns the rows."""
        rows = []
        try:
            # The first line is the header.
            lines = (part / "runs.jsonl").read_bytes().splitlines()[1:]
            runs = [msgspec.json.decode(line, type=_Line) for line in lines]
        except (FileNotFoundError, msgspec.DecodeError) as error:
            raise IncorrectState(
                f"{part} is damaged: {error}; remove it to execute its runs again",
                details={"field": "folder"},
            ) from None
        for run in runs:
            if run.fault is not None:
                self._faults[run.run] = run.fault
            if run.row is not None:
                rows.append(run.row)
        self._rows += rows
        return rows

    def _done(self) -> list[Path]:
        """The folders of the received parts."""
        return sorted(self._parts.glob("runs-*"))


def _ignore_errors(work: Callable[..., Any], **arguments: Any) -> None:
    """Calls `work`, and ignores its errors: a connection that is closed may be lost already."""
    with contextlib.suppress(Exception):
        work(**arguments)


def _lock(folder: Path) -> Callable[[], None]:
    """Creates a folder and locks it. Returns how to unlock it."""
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / "sweep.lock").open("ab")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise Conflict(
            f"another process is using {folder}: wait until it ends, or choose another folder",
            details={"field": "folder"},
        ) from None

    def unlock() -> None:
        # Forked workers inherit the descriptor, so closing it here would not release the lock.
        fcntl.flock(file, fcntl.LOCK_UN)
        file.close()

    return unlock
