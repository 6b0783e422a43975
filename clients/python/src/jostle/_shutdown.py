"""What happens to sessions at the interpreter's exit and after a fork.

At exit sessions are closed before the interpreter ends: a thread that is blocked within zenoh at
that moment would abort the process. After a fork the child has none of zenoh's threads, so any
destructor of a zenoh object would block forever. The fork handler leaks one reference to each of
them with `Py_IncRef`: objects that a module holds would be destroyed when the child exits.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import weakref
from collections.abc import Iterator
from typing import Protocol

from ._errors import Unavailable
from ._threads import join_threads, stop_threads


class _Session(Protocol):
    """A session that this process opened."""

    def close(self) -> None:
        """Closes it and its streams."""

    def zenoh_objects(self) -> Iterator[object]:
        """The objects whose destructors call zenoh."""


open_sessions: weakref.WeakSet[_Session] = weakref.WeakSet()
"""The sessions of this process that are referenced."""

# Whether this process has used zenoh, and whether it was forked from one that had.
_is_used = False
_is_lost = False


def use_zenoh() -> None:
    """Records that this process uses zenoh.

    Raises:
        Unavailable: The process was forked from one that had used zenoh. zenoh would wait forever
            for threads that the child does not have.
    """
    global _is_used
    check_usable()
    _is_used = True


def check_usable() -> None:
    """Checks that this process can use zenoh.

    Raises:
        Unavailable: The process was forked from one that had used zenoh.
    """
    if _is_lost:
        raise forked()


def forked() -> Unavailable:
    """The error in a process that was forked from one that had connected."""
    return Unavailable(
        "this process was forked from one that had connected, and no connection survives a fork: "
        'start processes with `context="forkserver"`, as in `gymnasium.vector.AsyncVectorEnv(..., '
        'context="forkserver")`, or call `multiprocessing.set_start_method("forkserver")` before, '
        "and connect there"
    )


def _leak_zenoh() -> None:
    """In a forked child: leaks the objects of zenoh, whose destructors would block."""
    global _is_lost
    _is_lost = _is_used
    for session in list(open_sessions):
        for thing in session.zenoh_objects():
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing))
    open_sessions.clear()


os.register_at_fork(after_in_child=_leak_zenoh)


@atexit.register
def _close_sessions() -> None:
    stop_threads()
    for session in list(open_sessions):
        session.close()
    join_threads()
