"""What a swarm publishes, as an iterator."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Generic, Self, TypeVar

import zenoh

from ._arguments import check_seconds
from ._errors import DeadlineExceeded, Internal, Unavailable
from ._link import Link, listen
from ._messages import read_event

T = TypeVar("T")

# When a swarm's token goes without the event that says so, this is how long its daemon's token is
# watched: a daemon that stops takes both away, one after the other.
_FAREWELL_SECS = 1.0
_LOOK_AGAIN_SECS = 0.05


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
        read: Callable[[bytes], T | None],
        first: Callable[[], T | None],
        *,
        capacity: int,
        timeout: float | None,
    ) -> None:
        self._link = link
        self._swarm = swarm
        self._read = read
        self._inbox = _Inbox(capacity)
        self._first: T | None = None
        self._subscribers: list[zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]] = []
        self._timeout = None if timeout is None else check_seconds("timeout", timeout)
        inbox, session = self._inbox, link.session
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
            self._first = first()
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
        self._subscribers.append(subscriber)
        listen(subscriber, take)

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        if self._first is not None:
            first, self._first = self._first, None
            return first
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        while True:
            payload = self._take(deadline)
            if payload is None:
                self.close()
                raise StopIteration
            item = self._read(payload.to_bytes())
            if item is not None:
                return item

    def _take(self, deadline: float | None) -> zenoh.ZBytes | None:
        """The next payload; None at the end."""
        inbox = self._inbox
        while True:
            with inbox.changed:
                remaining = None if deadline is None else deadline - time.monotonic()
                news = inbox.changed.wait_for(inbox.has_news, remaining)
                if inbox.closed:
                    return None
                if inbox.payloads:
                    return inbox.payloads.popleft()
                if inbox.deleted:
                    return None
            if not news:
                raise DeadlineExceeded(
                    f"swarm {self._swarm!r} published nothing within {self._timeout:g} s: "
                    "it may be paused"
                )
            self._await_farewell()

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
        self._first = None
        self._inbox.close()
        subscribers, self._subscribers = self._subscribers, []
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
        if hasattr(self, "_subscribers"):
            self.close()
