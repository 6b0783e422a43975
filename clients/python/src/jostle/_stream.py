"""A stream of what a swarm publishes, as an iterator."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, Protocol, Self, TypeVar

import zenoh

from ._arguments import check_seconds
from ._decode import read_event
from ._errors import DeadlineExceeded, Internal, Unavailable
from ._session import Session
from ._threads import listen

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

# When a swarm's token is undeclared without the event `deleted`, its daemon's token is watched for
# this long: a daemon that stops undeclares both, one after the other.
_TOKEN_TIMEOUT_SECS = 1.0
_POLL_INTERVAL_SECS = 0.05
# The last message may be lost, and no later one shows that: after this time without a message the
# daemon is queried.
_SILENCE_SECS = 5.0


class Reader(Protocol[T_co]):
    """Decodes what a swarm publishes into the items of a stream."""

    def first(self) -> Iterable[T_co]:
        """The items before all that are published; called after the stream has subscribed."""

    def read(self, payload: bytes) -> Iterable[T_co]:
        """The items of a payload."""

    def poll(self) -> Iterable[T_co]:
        """The items that may have been lost since the last message."""


class _Inbox:
    """The queue between the subscriber threads and the iterating thread.

    The threads reference this and not the stream, so that an unreferenced stream is collected.
    """

    def __init__(self, capacity: int) -> None:
        self.changed = threading.Condition()
        self.payloads: deque[zenoh.ZBytes] = deque(maxlen=capacity)
        self.closed = False
        self.deleted = False
        self.token_undeclared = False

    def on_sample(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.payloads.append(sample.payload)
            self.changed.notify_all()

    def on_end(self, sample: zenoh.Sample) -> None:
        try:
            kind = read_event(sample.payload.to_bytes()).kind
        except Internal:
            # A stream of events raises it in the iterating thread; this thread must continue.
            return
        if kind == "deleted":
            with self.changed:
                self.deleted = True
                self.changed.notify_all()

    def on_event(self, sample: zenoh.Sample) -> None:
        # In one thread: the last event is queued before the end.
        self.on_sample(sample)
        self.on_end(sample)

    def on_token(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.token_undeclared = sample.kind == zenoh.SampleKind.DELETE
            self.changed.notify_all()

    def has_news(self) -> bool:
        """Whether there is anything to handle; called with `changed` locked."""
        return bool(self.payloads) or self.closed or self.deleted or self.token_undeclared

    def is_resolved(self) -> bool:
        """Whether the token is back or the stream is at its end; called with `changed` locked."""
        return self.closed or self.deleted or not self.token_undeclared

    def close(self) -> None:
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class Stream(Generic[T]):
    """The messages that a swarm publishes; `Swarm.states`, `orders` and `events` make one.

        with swarm.events(timeout=10.0) as events:
            deleted = next(event for event in events if event.kind == "deleted")

    It is an iterator. It ends when the swarm is deleted or the stream is closed, and raises
    `Unavailable` when the daemon disconnects. `close()` closes it, and so does leaving its `with`
    block, closing its swarm or client, or dropping the last reference.
    """

    def __init__(
        self,
        session: Session,
        swarm: str,
        noun: str,
        reader: Reader[T],
        *,
        capacity: int,
        timeout: float | None,
    ) -> None:
        self._session = session
        self._swarm = swarm
        self._reader = reader
        self._inbox = _Inbox(capacity)
        self._ready: deque[T] = deque()
        self._silent_since = time.monotonic()
        self.subscribers: list[zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]] = []
        self._timeout = None if timeout is None else check_seconds("timeout", timeout)
        inbox = self._inbox
        session.check_not_forked()
        try:
            # Subscribe to the end first, so that it cannot be missed.
            events = session.zenoh.declare_subscriber(session.swarm_key(swarm, "event"))
            self._listen(events, inbox.on_event if noun == "event" else inbox.on_end)
            # With `history`, since a session that has not seen a token does not report that a lost
            # connection removed it.
            tokens = session.zenoh.liveliness().declare_subscriber(
                session.swarm_key(swarm, "alive/*"), history=True
            )
            self._listen(tokens, inbox.on_token)
            if noun != "event":
                samples = session.zenoh.declare_subscriber(
                    session.swarm_key(swarm, noun), zenoh.handlers.RingChannel(capacity)
                )
                self._listen(samples, inbox.on_sample)
            # Query the present state after subscribing, so that nothing is missed in between. It
            # raises if there is no such swarm.
            self._ready.extend(reader.first())
        except zenoh.ZError as error:
            self.close()
            raise Unavailable(f"cannot subscribe to swarm {swarm!r}: {error}") from error
        except BaseException:
            self.close()
            raise
        session.streams.add(self)

    def _listen(
        self,
        subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]],
        callback: Callable[[zenoh.Sample], None],
    ) -> None:
        self.subscribers.append(subscriber)
        listen(subscriber, callback)

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        self._session.check_not_forked()
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        while True:
            # `close` replaces it, from any thread.
            ready = self._ready
            if ready:
                return ready.popleft()
            items = self._receive(deadline)
            if items is None:
                self.close()
                raise StopIteration
            ready.extend(items)

    def _receive(self, deadline: float | None) -> Iterable[T] | None:
        """The next items; None at the end."""
        inbox = self._inbox
        while True:
            silence_ends = self._silent_since + _SILENCE_SECS
            until = silence_ends if deadline is None else min(deadline, silence_ends)
            with inbox.changed:
                has_news = inbox.changed.wait_for(inbox.has_news, until - time.monotonic())
                if inbox.closed or (inbox.deleted and not inbox.payloads):
                    return None
                payload = inbox.payloads.popleft() if inbox.payloads else None
            if payload is not None:
                self._silent_since = time.monotonic()
                return self._reader.read(payload.to_bytes())
            if has_news:
                self._await_token()
            elif time.monotonic() >= silence_ends:
                self._silent_since = time.monotonic()
                return self._reader.poll()
            elif deadline is not None and time.monotonic() >= deadline:
                raise DeadlineExceeded(
                    f"swarm {self._swarm!r} published nothing within {self._timeout:g} s: "
                    "it may be paused"
                )

    def _await_token(self) -> None:
        """Waits until it is known why the swarm's token was undeclared.

        The swarm was deleted, its token is back, or its daemon disconnected.

        Raises:
            Unavailable: Its daemon disconnected.
        """
        inbox = self._inbox
        deadline = time.monotonic() + _TOKEN_TIMEOUT_SECS
        while True:
            if not self._session.nodes():
                self.close()
                raise self._session.disconnected()
            with inbox.changed:
                if inbox.changed.wait_for(inbox.is_resolved, _POLL_INTERVAL_SECS):
                    return
                if time.monotonic() > deadline:
                    inbox.deleted = True
                    return

    def close(self) -> None:
        """Unsubscribes; a second call does nothing."""
        if not self._session.is_ours():
            return
        self._ready = deque()
        self._inbox.close()
        subscribers, self.subscribers = self.subscribers, []
        for subscriber in subscribers:
            # In a closed session this does nothing.
            subscriber.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.close()

    def __del__(self) -> None:
        # If the constructor raised early there is nothing to close.
        if hasattr(self, "subscribers"):
            self.close()
