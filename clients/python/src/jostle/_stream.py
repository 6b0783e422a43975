"""A stream of what a swarm publishes, as an iterator."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import zenoh

from ._arguments import check_seconds
from ._attachment import Arrival
from ._decode import read_event, read_reply
from ._errors import Busy, DeadlineExceeded, Internal, NotFound, PermissionDenied, Unavailable
from ._link import LIVELINESS_TIMEOUT_SECS
from ._outage import Outage
from ._presence import Presence, State
from ._published import belongs
from ._session import Session
from ._threads import listen
from ._wire import Swarms

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

# A private daemon that is not reachable may have ended, which no token shows.
_AWAY_INTERVAL_SECS = 0.2
# The last message may be lost, and no later one shows that: after this time without a message the
# daemon is queried.
_SILENCE_SECS = 5.0


class Reader(Protocol[T_co]):
    """Decodes what a swarm publishes into the items of a stream."""

    def first(self) -> Iterable[T_co]:
        """The items before all that are published; called after the stream has subscribed."""

    def read(self, payload: bytes, arrival: Arrival | None = None, /) -> Iterable[T_co]:
        """The items of a payload that arrived."""

    def poll(self) -> Iterable[T_co]:
        """The items that may have been lost since the last message."""

    def refresh(self) -> Iterable[T_co]:
        """The items that may have been lost while the daemon was not reachable.

        Meanwhile the swarm may have been replaced by another of its name.
        """


class _Token(NamedTuple):
    """A liveliness token of the swarm, or of a daemon, that appeared or disappeared."""

    node: str
    is_swarm: bool
    is_alive: bool
    at: float


class _Inbox:
    """The queue between the subscriber threads and the iterating thread.

    The threads reference this and not the stream, so that an unreferenced stream is collected.
    """

    def __init__(self, capacity: int, swarm: str) -> None:
        self.swarm = swarm
        self.changed = threading.Condition()
        self.samples: deque[tuple[zenoh.Sample, int]] = deque(maxlen=capacity)
        self.closed = False
        self.deleted = False
        self.tokens: deque[_Token] = deque()

    def on_sample(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.samples.append((sample, time.time_ns()))
            self.changed.notify_all()

    def on_end(self, sample: zenoh.Sample) -> None:
        if not belongs(sample, self.swarm, "event"):
            return
        try:
            kind = read_event(sample.payload.to_bytes()).kind
        except Internal:
            # A stream of events raises it in the iterating thread; this thread must continue.
            return
        if kind == "deleted":
            self.end()

    def on_event(self, sample: zenoh.Sample) -> None:
        # In one thread: the last event is queued before the end.
        self.on_sample(sample)
        self.on_end(sample)

    def on_token(self, sample: zenoh.Sample) -> None:
        # `jostle/school/alive/main` or `jostle/@node/main/alive`.
        *_, owner, last = str(sample.key_expr).split("/")
        is_swarm = last != "alive"
        is_alive = sample.kind == zenoh.SampleKind.PUT
        with self.changed:
            node = last if is_swarm else owner
            self.tokens.append(_Token(node, is_swarm, is_alive, time.monotonic()))
            self.changed.notify_all()

    def has_news(self) -> bool:
        """Whether there is anything to handle; called with `changed` locked."""
        return bool(self.samples or self.tokens) or self.closed or self.deleted

    def end(self) -> None:
        """The swarm was deleted."""
        with self.changed:
            self.deleted = True
            self.changed.notify_all()

    def close(self) -> None:
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class Stream(Generic[T]):
    """The messages that a swarm publishes; `Swarm.states`, `orders` and `events` make one.

        with swarm.events(timeout=10.0) as events:
            deleted = next(event for event in events if event.kind == "deleted")

    It is an iterator. It ends when the swarm is deleted or the stream is closed. `close()` closes
    it, and so does leaving its `with` block, closing its swarm or client, or dropping the last
    reference.

    While the daemon is not reachable, such as during a restart, it waits for it without a limit,
    and goes on with what it missed. It logs a warning when that begins and when it ends, to the
    logger `jostle`. It raises `NotFound` if the daemon comes back without the swarm, and
    `Unavailable` if it was a private one that has ended.
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
        self._noun = noun
        self._inbox = _Inbox(capacity, swarm)
        self._presence = Presence()
        self._outage = Outage(session.endpoint, f"the stream of {noun}s of swarm {swarm!r}")
        # The daemon of the swarm, once its token is known; any until then.
        self._node = "*"
        # When the token of the swarm disappeared.
        self._lost_at: float | None = None
        self._is_stale = False
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
            tokens = session.zenoh.liveliness().declare_subscriber(
                session.node_key("*", "alive"), history=True
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
            until = min(it for it in self._deadlines(deadline) if it is not None)
            with inbox.changed:
                inbox.changed.wait_for(inbox.has_news, until - time.monotonic())
                if inbox.closed or (inbox.deleted and not inbox.samples):
                    return None
                received = inbox.samples.popleft() if inbox.samples else None
                tokens = list(inbox.tokens)
                inbox.tokens.clear()
            for token in tokens:
                self._see(token)
            if received is not None:
                self._silent_since = time.monotonic()
                sample, unix_nanos = received
                if not belongs(sample, self._swarm, self._noun):
                    # What belongs here may have gone elsewhere, as in an interruption.
                    self._is_stale = True
                    continue
                attachment = None if sample.attachment is None else sample.attachment.to_bytes()
                arrival = Arrival(unix_nanos, attachment)
                return self._reader.read(sample.payload.to_bytes(), arrival)
            if tokens:
                # Others may follow.
                continue
            if (items := self._recover()) is not None:
                return items
            now = time.monotonic()
            is_present = self._presence.state is State.PRESENT
            if is_present and now >= self._silent_since + _SILENCE_SECS:
                self._silent_since = now
                return self._reader.poll()
            if deadline is not None and now >= deadline:
                raise self._timed_out()

    def _deadlines(self, deadline: float | None) -> tuple[float | None, ...]:
        """When to look again, although nothing was received."""
        now, state = time.monotonic(), self._presence.state
        silence_ends = self._silent_since + _SILENCE_SECS if state is State.PRESENT else None
        stale = now if self._is_stale else None
        away = now + _AWAY_INTERVAL_SECS if state is State.AWAY else None
        return deadline, silence_ends, stale, away, self._presence.deadline

    def _timed_out(self) -> DeadlineExceeded:
        why = "it may be paused"
        if self._outage.is_ongoing:
            why = f"the daemon at {self._session.endpoint} is not reachable"
        what = f"swarm {self._swarm!r} published nothing within {self._timeout:g} s"
        return DeadlineExceeded(f"{what}: {why}")

    def _see(self, token: _Token) -> None:
        if not token.is_swarm:
            if self._node in ("*", token.node):
                self._presence.node_token(token.is_alive, token.at)
            return
        was_present = self._presence.state is State.PRESENT
        self._presence.swarm_token(token.is_alive, token.at)
        if not token.is_alive:
            if was_present:
                self._lost_at = token.at
            return
        self._node = token.node
        if not was_present:
            self._is_stale = True
            # It may have begun and ended before this thread read the first token.
            self._outage.begin(self._lost_at)
            self._outage.end()

    def _recover(self) -> Iterable[T] | None:
        """What was missed, if the swarm is back; nothing if that cannot be queried.

        Raises:
            NotFound: Its daemon came back without it.
            Unavailable: Its daemon cannot come back.
        """
        if self._is_stale:
            self._is_stale = False
            try:
                return self._reader.refresh()
            except (Busy, NotFound, PermissionDenied, Unavailable):
                # If it is an outage, the tokens show it; if not, the next message has the present.
                return None
        if self._presence.state is State.AWAY:
            if self._session.is_over():
                self.close()
                raise self._session.disconnected()
            self._outage.begin(self._lost_at)
        until = self._presence.deadline
        if until is not None and time.monotonic() >= until:
            self._judge()
        return None

    def _judge(self) -> None:
        """Asks the daemon what has become of a swarm whose token disappeared.

        Raises:
            NotFound: The daemon came back without it.
        """
        session, now = self._session, time.monotonic()
        try:
            key = session.node_key(self._node, "get/swarms")
            reply = session.get_once(key, swarm=None, timeout=LIVELINESS_TIMEOUT_SECS)
        except (Busy, PermissionDenied, Unavailable):
            self._presence.ask_later(now)
            return
        if self._swarm in {it.swarm for it in read_reply(reply, Swarms).swarms}:
            self._see(_Token(self._node, True, True, now))
        elif self._presence.state is State.MISSING:
            self._inbox.end()
        else:
            self.close()
            raise NotFound(
                f"the daemon is back, but without swarm {self._swarm!r}: create it again",
                details={"swarm": self._swarm},
            )

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
