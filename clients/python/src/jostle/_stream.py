"""What a swarm publishes, as an iterator."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar

import zenoh

from ._arguments import check_seconds
from ._ends import listen
from ._errors import DeadlineExceeded, Internal, Unavailable
from ._link import Link
from ._reading import read_event

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

# When a swarm's token goes without the event that says so, this is how long its daemon's token is
# watched: a daemon that stops takes both away, one after the other.
_FAREWELL_SECS = 1.0
_LOOK_AGAIN_SECS = 0.05
# What is published last may be lost without a later one that shows it: after such a silence it is
# asked for.
_SILENCE_SECS = 5.0


class Reader(Protocol[T_co]):
    """Makes what a swarm publishes into what a stream yields."""

    def first(self) -> Iterable[T_co]:
        """What comes before all that is published; called once the stream listens."""

    def read(self, payload: bytes) -> Iterable[T_co]:
        """What a payload brings."""

    def look(self) -> Iterable[T_co]:
        """What may have been missed in a silence."""


class _Inbox:
    """What the listening threads leave for the one who iterates.

    They hold this and not the stream, so that a stream nobody holds is collected.
    """

    def __init__(self, capacity: int) -> None:
        self.changed = threading.Condition()
        self.payloads: deque[zenoh.ZBytes] = deque(maxlen=capacity)
        self.closed = False
        self.deleted = False
        self.token_gone = False

    def take_sample(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.payloads.append(sample.payload)
            self.changed.notify_all()

    def take_end(self, sample: zenoh.Sample) -> None:
        try:
            kind = read_event(sample.payload.to_bytes()).kind
        except Internal:
            # Whoever iterates over the events is told of it; this thread has to live on.
            return
        if kind == "deleted":
            with self.changed:
                self.deleted = True
                self.changed.notify_all()

    def take_event(self, sample: zenoh.Sample) -> None:
        # By one thread: the last event comes before the end.
        self.take_sample(sample)
        self.take_end(sample)

    def take_token(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.token_gone = sample.kind == zenoh.SampleKind.DELETE
            self.changed.notify_all()

    def has_news(self) -> bool:
        """Whether there is anything to look at; called with `changed` held."""
        return bool(self.payloads) or self.closed or self.deleted or self.token_gone

    def fate_is_known(self) -> bool:
        """Whether a token that went needs no more watching; called with `changed` held."""
        return self.closed or self.deleted or not self.token_gone

    def close(self) -> None:
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class Stream(Generic[T]):
    """What a swarm publishes; `Swarm.states`, `orders` and `events` make one.

    Iterate over it. It ends when the swarm is deleted or it is closed, and raises `Unavailable`
    when the daemon goes away. It is closed by `close()`, by leaving its `with` block, with its
    swarm or client, or when nobody holds it any more.
    """

    def __init__(
        self,
        link: Link,
        swarm: str,
        noun: str,
        reader: Reader[T],
        *,
        capacity: int,
        timeout: float | None,
    ) -> None:
        self._link = link
        self._swarm = swarm
        self._reader = reader
        self._inbox = _Inbox(capacity)
        self._ready: deque[T] = deque()
        self._silent_since = time.monotonic()
        self.subscribers: list[zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]] = []
        self._timeout = None if timeout is None else check_seconds("timeout", timeout)
        inbox, session = self._inbox, link.session
        link.check_ours()
        try:
            # The end is watched for before anything else, so that it cannot fall in between.
            events = session.declare_subscriber(link.swarm_key(swarm, "event"))
            self._listen(events, inbox.take_event if noun == "event" else inbox.take_end)
            # Of a token that it has not heard of, a session does not tell either when a lost
            # connection takes it away.
            tokens = session.liveliness().declare_subscriber(
                link.swarm_key(swarm, "alive/*"), history=True
            )
            self._listen(tokens, inbox.take_token)
            if noun != "event":
                samples = session.declare_subscriber(
                    link.swarm_key(swarm, noun), zenoh.handlers.RingChannel(capacity)
                )
                self._listen(samples, inbox.take_sample)
            # What was there before anything that will be published, asked for when nothing can be
            # missed any more. Nothing comes of a swarm that is not there, and this says so.
            self._ready.extend(reader.first())
        except zenoh.ZError as error:
            self.close()
            raise Unavailable(f"cannot subscribe to swarm {swarm!r}: {error}") from error
        except BaseException:
            self.close()
            raise
        link.streams.add(self)

    def _listen(
        self,
        subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]],
        take: Callable[[zenoh.Sample], None],
    ) -> None:
        self.subscribers.append(subscriber)
        listen(subscriber, take)

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        self._link.check_ours()
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        while True:
            # `close` puts another in its place, from whatever thread.
            ready = self._ready
            if ready:
                return ready.popleft()
            items = self._take(deadline)
            if items is None:
                self.close()
                raise StopIteration
            ready.extend(items)

    def _take(self, deadline: float | None) -> Iterable[T] | None:
        """What comes next; None at the end."""
        inbox = self._inbox
        while True:
            silence_ends = self._silent_since + _SILENCE_SECS
            until = silence_ends if deadline is None else min(deadline, silence_ends)
            with inbox.changed:
                news = inbox.changed.wait_for(inbox.has_news, until - time.monotonic())
                if inbox.closed or (inbox.deleted and not inbox.payloads):
                    return None
                payload = inbox.payloads.popleft() if inbox.payloads else None
            if payload is not None:
                self._silent_since = time.monotonic()
                return self._reader.read(payload.to_bytes())
            if news:
                self._await_farewell()
            elif time.monotonic() >= silence_ends:
                self._silent_since = time.monotonic()
                return self._reader.look()
            elif deadline is not None and time.monotonic() >= deadline:
                raise DeadlineExceeded(
                    f"swarm {self._swarm!r} published nothing within {self._timeout:g} s: "
                    "it may be paused"
                )

    def _await_farewell(self) -> None:
        """Finds out why the swarm's token went: deleted, back again, or its daemon is gone.

        Raises:
            Unavailable: Its daemon is gone.
        """
        inbox = self._inbox
        deadline = time.monotonic() + _FAREWELL_SECS
        while True:
            if not self._link.nodes():
                self.close()
                raise self._link.gone()
            with inbox.changed:
                if inbox.changed.wait_for(inbox.fate_is_known, _LOOK_AGAIN_SECS):
                    return
                if time.monotonic() > deadline:
                    inbox.deleted = True
                    return

    def close(self) -> None:
        """Stops listening; harmless when done already."""
        if not self._link.is_ours():
            return
        self._ready = deque()
        self._inbox.close()
        subscribers, self.subscribers = self.subscribers, []
        for subscriber in subscribers:
            # A closed session has undeclared them already and does not mind.
            subscriber.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __del__(self) -> None:
        # A failed constructor leaves nothing to close.
        if hasattr(self, "subscribers"):
            self.close()
