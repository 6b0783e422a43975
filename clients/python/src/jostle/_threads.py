"""Threads for calls that block, for subscribers and for views.

None of them keeps the interpreter from exiting; its exit joins them, see `_shutdown`.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

import zenoh

# A worker waits this long for its next call, seconds. With a thread for each call the awaited
# lock-step loop takes 1.5 times as long (best of 30 times 100 exchanges, 640 µs against 420 µs).
_IDLE_SECS = 2.0
_JOIN_TIMEOUT_SECS = 1.0

# The queues of the idle workers. The operations of a list are atomic.
_idle: list[SimpleQueue[Callable[[], None]]] = []
_is_exiting = False


class _Thread(threading.Thread):
    """A thread of this package."""


def start_thread(work: Callable[[], None], name: str) -> threading.Thread | None:
    """Starts a thread that calls `work`, which raises nothing; returns the thread.

    During the interpreter's exit no thread can start: it calls `work` itself, and returns None.
    """
    if _is_exiting:
        work()
        return None
    thread = _Thread(target=work, name=name, daemon=True)
    thread.start()
    return thread


def call_in_thread(work: Callable[[], None]) -> None:
    """Calls `work`, which raises nothing, in an idle worker or in a new one.

    There is no limit: calls may wait for each other, and a pool of fixed size would deadlock.
    """
    try:
        _idle.pop().put(work)
    except IndexError:
        queue: SimpleQueue[Callable[[], None]] = SimpleQueue()
        queue.put(work)
        start_thread(lambda: _serve(queue), "jostle-worker")


def _serve(queue: SimpleQueue[Callable[[], None]]) -> None:
    """Calls what the queue receives, until it was idle."""
    while True:
        try:
            work = queue.get(timeout=_IDLE_SECS)
        except Empty:
            try:
                _idle.remove(queue)
            except ValueError:
                # `call_in_thread` has just taken it, and is about to put a call.
                continue
            return
        work()
        # An idle worker references nothing of its last call.
        del work
        if _is_exiting:
            return
        _idle.append(queue)


def listen(
    subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]],
    callback: Callable[[zenoh.Sample], None],
) -> None:
    """Calls `callback` with every sample, in a thread, until the subscriber is undeclared.

    zenoh would run a callback in a thread that keeps the interpreter from exiting.
    """
    handler = subscriber.handler

    def run() -> None:
        with contextlib.suppress(zenoh.ZError):
            while True:
                callback(handler.recv())

    start_thread(run, "jostle-listener")


def is_exiting() -> bool:
    """Whether the interpreter exits, so that no thread can start."""
    return _is_exiting


def stop_threads() -> None:
    """Starts no more threads, and ends the idle ones."""
    global _is_exiting
    _is_exiting = True
    while _idle:
        _idle.pop().put(lambda: None)


def join_threads() -> None:
    """Waits a moment for every thread."""
    for thread in threading.enumerate():
        if isinstance(thread, _Thread):
            thread.join(_JOIN_TIMEOUT_SECS)


# A forked process has none of them.
os.register_at_fork(after_in_child=_idle.clear)
