"""What ends with the interpreter, and what a process forked from it leaves alone."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING

import zenoh

from ._errors import Unavailable

if TYPE_CHECKING:
    from ._link import Link

_JOIN_SECS = 1.0

open_links: weakref.WeakSet[Link] = weakref.WeakSet()
"""Those that this process opened and somebody holds."""

# Whether this process has used zenoh, and whether it was forked from one that had.
_is_used = False
_is_lost = False

_threads: weakref.WeakSet[threading.Thread] = weakref.WeakSet()


def listen(
    subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]], take: Callable[[zenoh.Sample], None]
) -> None:
    """Calls `take` with every sample, from a thread of its own, until it is undeclared.

    A callback given to zenoh would run in a thread that keeps the interpreter from exiting.
    """
    handler = subscriber.handler

    def run() -> None:
        with contextlib.suppress(zenoh.ZError):
            while True:
                take(handler.recv())

    thread = threading.Thread(target=run, name="jostle-listener", daemon=True)
    join_at_exit(thread)
    thread.start()


def join_at_exit(thread: threading.Thread) -> None:
    """Has the interpreter's end wait for a thread that ends soon after every link is closed."""
    _threads.add(thread)


def use_zenoh() -> None:
    """Notes that zenoh is used from now on.

    Raises:
        Unavailable: It was used before this process was forked, and would wait for ever for
            threads that there are none of here.
    """
    global _is_used
    if _is_lost:
        raise forked()
    _is_used = True


def forked() -> Unavailable:
    """The error in a process that was forked from one that had connected already."""
    return Unavailable(
        "this process was forked from one that had connected already, which no connection "
        "survives: have it started anew, as multiprocessing does in its contexts `spawn` and "
        "`forkserver`, and connect there"
    )


def _keep_for_ever() -> None:
    """In a process forked from this one: lets go of nothing of zenoh's, which would not return."""
    global _is_lost
    _is_lost = _is_used
    for link in list(open_links):
        for stream in list(link.streams):
            for subscriber in stream.subscribers:
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(subscriber))
        for controller in list(link.controllers):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(controller))
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(link.session))
    open_links.clear()
    _threads.clear()


os.register_at_fork(after_in_child=_keep_for_ever)


@atexit.register
def _close_links() -> None:
    # A thread that waits within zenoh when the interpreter goes would abort the process.
    for link in list(open_links):
        link.close()
    for thread in list(_threads):
        thread.join(_JOIN_SECS)
