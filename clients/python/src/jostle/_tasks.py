"""The tasks of a sweep on an executor."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from queue import Empty, SimpleQueue
from typing import Any, Self

from . import _part
from ._delivery import Lost, Target, read_piece
from ._errors import Unavailable
from ._experiment import Files
from ._extras import import_extra
from ._plan import Task

DASK = "dask:"
"""Prefix of the address of a Dask scheduler."""

# How long a wait may last. Python handles a signal that arrives just before a wait, such as
# Ctrl-C, only after it.
_SIGNAL_SECS = 0.5


class Tasks:
    """Submits tasks, and returns those that have ended. Leaving the `with` block cancels the rest.

    Args:
        executor: See `sweep`.
        files: The experiment's files.
        jostled: Path of `jostled` on each worker; None searches.
        folder: The absolute path of the folder of parts.
        token: The content of its lock.

    Raises:
        Unavailable: There is no Dask scheduler at this address.
    """

    def __init__(
        self,
        executor: Executor | str | Any,
        files: Files,
        jostled: str | None,
        folder: str,
        token: str,
    ) -> None:
        # The future of each task that has not ended or is being received, by its runs.
        self._futures: dict[str, Any] = {}
        # None wakes the reader after `close`.
        self._ended: SimpleQueue[tuple[Task, Any] | None] = SimpleQueue()
        self._client: Any = None
        # Callbacks of `close`, called in reverse order.
        self._open = contextlib.ExitStack()
        options: dict[str, Any] = {}
        extra: tuple[Any, ...] = ()
        if isinstance(executor, str):
            executor = self._connect(executor.removeprefix(DASK))
        if hasattr(executor, "get_executor"):
            self._client = executor
            # Otherwise Dask gives equal tasks of two sweeps the same key, and cancelling one sweep
            # cancels both.
            options = {"pure": False}
        elif executor is None:
            processes = _part.Processes()
            executor = ThreadPoolExecutor(len(os.sched_getaffinity(0)))
            self._open.callback(executor.shutdown, wait=True, cancel_futures=True)
            self._open.callback(processes.terminate)
            extra = (processes,)
        target = Target(folder, token, reads_workers=self._client is not None)
        submit: Callable[..., Any] = executor.submit
        self._submit: Callable[[str], Any] = lambda runs: submit(
            _part.run_part, files, runs, jostled, target, *extra, **options
        )
        self._open.callback(_ignore_errors, self._cancel)

    def _connect(self, address: str) -> Any:
        distributed: Any = import_extra("distributed", "dask")
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise Unavailable(
                f"no Dask scheduler answers at {address}: {error}; check the address, and "
                "whether the scheduler runs",
                details={"field": "executor"},
            ) from None
        # The connection may be lost already.
        self._open.callback(_ignore_errors, client.close)
        return client

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancels the tasks that have not ended, and closes what this object opened."""
        self._open.close()
        self._ended.put(None)

    def submit(self, task: Task) -> None:
        """Submits a task; one that has ended is executed again."""
        self._forget(task)
        future = self._futures[task.runs] = self._submit(task.runs)
        future.add_done_callback(lambda ended: self._ended.put((task, ended)))

    def ended(self) -> Iterator[tuple[Task, Any]]:
        """Each task that has ended, with its future, until all have or are cancelled.

        A Dask worker keeps the files of a task until the next one is taken.
        """
        while self._futures:
            try:
                ended = self._ended.get(timeout=_SIGNAL_SECS)
            except Empty:
                continue
            if ended is None:
                return
            task, future = ended
            if self._futures.get(task.runs) is not future:
                continue
            yield task, future
            if self._futures.get(task.runs) is future:
                self._forget(task)
            # Otherwise its result is in memory until the next one is there.
            del ended, future

    def _forget(self, task: Task) -> None:
        future = self._futures.pop(task.runs, None)
        if future is not None and self._client is not None:
            # The worker then removes the files that it keeps.
            _ignore_errors(future.release)

    def read(self, future: Any, worker: str, path: str, offset: int) -> bytes:
        """Reads a piece of a file of a task on a Dask worker. It is empty at the end of the file.

        Raises:
            Lost: The file or the worker is gone.
        """
        # A connection to a worker that is known to be gone would be retried for 30 s.
        if future.status == "finished":
            try:
                # Not a task, which would wait for those before it.
                return bytes(self._client.run(read_piece, path, offset, workers=[worker])[worker])
            except Exception as error:
                raise Lost(f"{path} on {worker}: {error!r}") from error
        raise Lost(f"{path} on {worker}: the worker is gone")

    def _cancel(self) -> None:
        futures = list(self._futures.values())
        if self._client is not None:
            self._client.cancel(futures)
            return
        for future in futures:
            future.cancel()


def _ignore_errors(work: Callable[[], Any]) -> None:
    """Calls `work`, and ignores its errors: a connection that is closed may be lost already."""
    with contextlib.suppress(Exception):
        work()
