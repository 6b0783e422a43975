"""Sweeps: executes an experiment in tasks of an executor, on this machine or on many."""

from __future__ import annotations

import concurrent.futures
import contextlib
import fcntl
import hashlib
import os
import shutil
import tomllib
import uuid
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgspec

from ._arguments import check_seconds
from ._atomic_file import sync_folder
from ._delivery import LOCK, RUNS, Lost, check, missing, raise_full, receive
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
from ._models import model_conflict
from ._part import Header, check_version
from ._plan import Programs, Task
from ._progress import Bar
from ._repr import HtmlList
from ._results import of_rows
from ._snapshot import Snapshot
from ._tasks import DASK, Tasks
from ._wire import ResultRow

if TYPE_CHECKING:
    import pandas

UNNAMED = "the experiment"
"""What errors call an experiment that is not in a file of the caller."""

# The limit of `jostle experiment plan --secs`.
_MAX_TASK_SECS = 1e9
# How often a task is executed whose files are lost with their worker. Cheap tasks are lost rarely;
# one that is lost each time takes longer than its workers live.
_MAX_ATTEMPTS = 5


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
    again: bool = False,
) -> Sweep:
    """Executes an experiment without a daemon, split into tasks of an executor.

        with jostle.sweep("order.toml", folder="results") as sweep:
            for row in sweep:
                print(row.run, row.v)

    A task is `jostled run` of one or more runs in a temporary folder of the worker. Its results are
    stored in `FOLDER.parts` and are merged into `folder` when all are finished. If a sweep is
    interrupted, a call with the same folder executes only the missing runs.

    The results include the files of the runs, such as trajectories, of any size if the workers see
    `FOLDER.parts` or are those of a Dask client. On other executors a task fails if its files have
    more than 64 MiB.

    Args:
        source: The experiment: a file, the text of one, or a mapping of its fields. If an earlier
            version of the model computed a part of its `start`, there is a warning.
        executor: Any `concurrent.futures.Executor`; a Dask client, not its executor;
            `"dask:tcp://HOST:PORT"`, the address of a Dask scheduler, which needs `jostle[dask]`;
            None is every core of this machine. Workers need this package with its programs, in the
            same version.
        folder: The folder of the results, the same as `jostled run` writes.
        task_secs: Expected seconds of work of a task on one core.
        jostled: Path of `jostled`, the same on this machine and on every worker, with `jostle`
            beside it; None searches as `local` does.
        again: If an earlier version of the model executed the runs in the folder or in
            `FOLDER.parts`, execute all of them again beside it, in `FOLDER-model2` under version 2:
            `Sweep.folder` names it. Otherwise no run is added to them: `Sweep.rows` has their rows,
            and `Sweep.wait` raises `Conflict`.

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
    made = Sweep(source, executor, path, secs, jostled)
    beside = made._other_model.details.get("again") if made._other_model else None
    if again and beside is not None:
        return Sweep(source, executor, Path(beside), secs, jostled)
    return made


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
        # That of the parts, which can only be merged if they have the same.
        self._header: Header | None = None
        # Why no run is added to the results.
        self._other_model: Conflict | None = None
        self._planned: list[Task] = []
        self._done_secs = 0.0
        self._is_merged = False
        self._is_cancelled = False
        # Callbacks of `cancel`, called in reverse order.
        self._open = contextlib.ExitStack()
        try:
            unlock, self._token = _lock(self._parts)
            self._open.callback(unlock)
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
            Conflict: A worker has another version of the model, or another version executed runs
                in the folder: `details["model_version"]` is that version, and `details["again"]`
                the folder in which `again=True` executes all of them again.
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
            Conflict: A worker has another version of the model, or another version executed runs
                in the folder: `details["model_version"]` is that version, and `details["again"]`
                the folder in which `again=True` executes all of them again.
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
                if self._other_model is None:
                    self._end_merged()
                else:
                    self._open.close()
                return
        if self._done() and not self._files.is_stored(self._parts):
            raise IncorrectState(
                f"{self._parts} contains parts of another experiment: remove it, or choose another "
                "folder",
                details={"field": "folder"},
            )
        file = self._files.store(self._parts)
        incomplete = self._incomplete()
        planned = self._plan(file, task_secs, self._parts)
        if self._other_model is not None:
            self._read_parts()
            self._open.close()
            return
        if incomplete:
            for part in incomplete:
                part.rename(part.with_name(f".{part.name}"))
            planned = self._plan(file, task_secs, self._parts)
        for draft in self._parts.glob(".*"):
            # Or a part that was being written when an earlier sweep was killed.
            shutil.rmtree(draft, ignore_errors=True)
        self._planned = planned
        self._read_parts()
        start = self._files.start
        if planned and start is not None:
            snapshot = Snapshot.from_bytes(start)
            earlier = [it.model_version for it in snapshot.earlier_models]
            first = min(snapshot.model_version, *earlier, planned[0].model_version)
            if first < planned[0].model_version:
                warnings.warn(
                    f"the runs start from a state of version {first} of the model, and are "
                    f"executed by version {planned[0].model_version}",
                    RuntimeWarning,
                    stacklevel=4,
                )

    def _incomplete(self) -> list[Path]:
        """Received parts that lack files, such as those of an earlier version."""
        parts = self._done()
        measure = tomllib.loads(self._files.toml).get("measure", {}) if parts else {}
        found = []
        for part in parts:
            with _damaged(part):
                if missing(part, bool(measure.get("record_every"))):
                    found.append(part)
        return found

    def _plan(self, file: Path, secs: float, done: Path) -> list[Task]:
        """Tasks for the runs that are missing in `done`; none if no run is added to it."""
        try:
            return self._programs.plan(file, secs, done)
        except Conflict as error:
            theirs = error.details.get("model_version")
            if theirs is None:
                raise
            ours = self._programs.model_version()
            self._other_model = model_conflict(self._folder, theirs, ours)
            return []
        except InvalidArgument as error:
            # With the caller's name of the experiment in place of the copy's.
            rest = error.message.removeprefix(str(file))
            name = source_label(self._source) if rest != error.message else ""
            raise invalid("source", name + rest) from None

    def _check_merged(self) -> None:
        """Checks that the folder has all results of this experiment."""
        # As `jostled run` compares them.
        if not self._files.is_stored(self._folder):
            raise IncorrectState(
                f"{self._folder} contains another experiment or other files: choose another folder",
                details={"field": "folder"},
            )
        file = self._folder / EXPERIMENT
        if self._plan(file, _MAX_TASK_SECS, self._folder):
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

    def _results(self) -> Iterator[list[ResultRow]]:
        """The rows of each task when it is finished. Then all are merged."""
        if self._other_model is not None:
            raise self._other_model
        if self._is_merged:
            return
        self._check_cancelled()
        failed: list[str] = []
        try:
            if self._planned:
                yield from self._execute(failed)
            self._check_cancelled()
            self._end(failed)
        except BaseException:
            self.cancel()
            raise

    def _check_cancelled(self) -> None:
        if self._is_cancelled:
            raise IncorrectState(
                "the sweep was cancelled: call `sweep` again with the same folder to resume it",
                details={"field": "folder"},
            )

    def _execute(self, failed: list[str]) -> Iterator[list[ResultRow]]:
        """Executes the tasks, and adds the reasons of those that fail to `failed`."""
        folder = str(self._parts.absolute())
        tasks = self._open.enter_context(
            Tasks(self._executor, self._files, self._jostled, folder, self._token)
        )
        for task in self._planned:
            tasks.submit(task)
        attempts: Counter[str] = Counter()
        for task, future in tasks.ended():
            try:
                result = future.result()
            except concurrent.futures.CancelledError:
                raise Unavailable(
                    f"the tasks of runs {task.runs} and others were lost or cancelled: call "
                    "`sweep` again with the same folder to resume it",
                    details={"runs": task.runs},
                ) from None
            except StorageFull:
                raise
            except Faulted as error:
                failed.append(error.message)
                continue
            except Exception as error:
                # An error of the executor, or of the worker before it calls `run_part`.
                failed.append(f"runs {task.runs}: {error!r}")
                continue
            try:
                part = self._store(task, result, partial(tasks.read, future))
            except Lost as error:
                self._check_cancelled()
                attempts[task.runs] += 1
                if attempts[task.runs] < _MAX_ATTEMPTS:
                    tasks.submit(task)
                else:
                    failed.append(f"runs {task.runs}: lost {_MAX_ATTEMPTS} times, last {error}")
                continue
            except Faulted as error:
                failed.append(error.message)
                continue
            finally:
                # Its memory is free while the caller uses the rows.
                del result, future
            self._done_secs += task.expected_secs
            yield self._read(part)

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

    def _store(self, task: Task, result: object, read: Callable[[str, str, int], bytes]) -> Path:
        """Writes a part atomically: to a temporary folder, which is then renamed."""
        name = hashlib.blake2b(task.runs.encode(), digest_size=8).hexdigest()
        draft = self._parts / f".runs-{uuid.uuid4().hex}"
        part = self._parts / f"runs-{name}"
        try:
            draft = receive(result, self._parts, draft, task.runs, read)
            check_version(draft, task.model_version, self._header)
            check(draft, task.runs)
            draft.rename(part)
            sync_folder(self._parts)
        except BaseException as error:
            shutil.rmtree(draft, ignore_errors=True)
            raise_full(self._parts, error)
            raise
        return part

    def _read(self, part: Path) -> list[ResultRow]:
        """Adds the rows and faults of a folder, and returns the rows."""
        rows = []
        with _damaged(part), (part / RUNS).open("rb") as lines:
            self._header = msgspec.json.decode(next(lines, b"{}"), type=Header)
            # `jostled run` may have been killed while it wrote the last line.
            whole = (it for it in lines if self._other_model is None or it.endswith(b"\n"))
            runs = [msgspec.json.decode(line, type=_Line) for line in whole]
        # Of several lines of one run, which was executed again, the last is valid.
        for run in {it.run: it for it in runs}.values():
            if run.fault is not None:
                self._faults[run.run] = run.fault
            if run.row is not None:
                rows.append(run.row)
        self._rows += rows
        return rows

    def _read_parts(self) -> None:
        """Adds the rows and faults of the received parts."""
        versions = set()
        for part in self._done():
            self._read(part)
            versions.add(self._header and self._header.model_version)
        if self._other_model is not None and len(versions) > 1:
            # A table would mix them.
            self._rows, self._faults = HtmlList(), {}

    def _done(self) -> list[Path]:
        """The folders of the received parts."""
        return sorted(self._parts.glob("runs-*"))


@contextlib.contextmanager
def _damaged(part: Path) -> Iterator[None]:
    """Reports the error of reading a part."""
    try:
        yield
    except (FileNotFoundError, msgspec.DecodeError) as error:
        raise IncorrectState(
            f"{part} is damaged: {error}; remove it to execute its runs again",
            details={"field": "folder"},
        ) from None


def _lock(folder: Path) -> tuple[Callable[[], None], str]:
    """Creates a folder and locks it. Returns how to unlock it, and the content of its lock."""
    folder.mkdir(parents=True, exist_ok=True)
    file = (folder / LOCK).open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise Conflict(
            f"another process is using {folder}: wait until it ends, or choose another folder",
            details={"field": "folder"},
        ) from None
    # A worker that reads it sees this folder, and not another one of the same name.
    token = uuid.uuid4().hex
    file.truncate(0)
    file.write(token)
    file.flush()

    def unlock() -> None:
        # Forked workers inherit the descriptor, so closing it here would not release the lock.
        fcntl.flock(file, fcntl.LOCK_UN)
        file.close()

    return unlock, token
