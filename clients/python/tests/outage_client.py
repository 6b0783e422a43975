"""The client of `test_outages.py`: makes every call of `tests/outages.toml` at the same time.

    python outage_client.py ENDPOINT LAST_STEP

It makes each call with `jostle` and with `jostle.aio`, to the swarms `FORM` and `FORM-run`, which
reach LAST_STEP after the outage, and `FORM-steered`, which is paused. It prints `ready` when each
call has begun, reads a line when the outage is over, continues until each call has succeeded after
that, and prints what it saw as a line of JSON. Times are those of `time.monotonic`, which all
processes share.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jostle
from jostle import aio

TIMEOUT_SECS = 40.0
SHORT_TIMEOUT_SECS = 1.0
# Between two requests of a kind.
PAUSE_SECS = 0.05
LAST_NOTE = "last"
# Undefined, and so it does not hold, until there are informed individuals.
LAST_CONDITION = "front >= 0"

# By the call: its beginning, its end and the code of its error.
seen: dict[str, list[tuple[float, float, str | None]]] = {}
# By the call: what a stream yielded, or the notes that were sent and those that succeeded.
got: dict[str, list[Any]] = {}
said: list[tuple[float, str, str]] = []
is_over = threading.Event()
loop = asyncio.new_event_loop()


class Log(logging.Handler):
    """Keeps what the package says."""

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps a record."""
        said.append((time.monotonic(), record.levelname, record.getMessage()))


def done(value: Any) -> Any:
    """The result of a call: one of `jostle.aio` is awaited."""

    async def awaited() -> Any:
        return await value

    if inspect.isawaitable(value):
        return asyncio.run_coroutine_threadsafe(awaited(), loop).result()
    return value


def each(stream: Any) -> Iterator[Any]:
    """The items of a stream."""
    while True:
        try:
            yield done(anext(stream)) if hasattr(stream, "__anext__") else next(stream)
        except (StopIteration, StopAsyncIteration):
            return


def once(call: str, work: Callable[[], object]) -> bool:
    """Makes a call and notes how it ends; returns whether it succeeds."""
    began, code = time.monotonic(), None
    try:
        work()
    except jostle.JostleError as error:
        code = error.code
    seen.setdefault(call, []).append((began, time.monotonic(), code))
    return code is None


def repeat(call: str, work: Callable[[], object]) -> None:
    """Makes a call again and again, until it has succeeded after the outage."""
    while True:
        is_last = is_over.is_set()
        if once(call, work) and is_last:
            return
        time.sleep(PAUSE_SECS)


def commands(call: str, swarm: Any) -> None:
    """Writes numbered notes into the journal."""
    sent, noted = got.setdefault(f"{call} sent", []), got.setdefault(call, [])

    def annotate() -> None:
        sent.append(f"note {len(sent)}")
        done(swarm.annotate(sent[-1]))
        noted.append(sent[-1])

    repeat(call, annotate)


def advances(call: str, swarm: Any) -> None:
    """Advances by a step each time, and joins again if the controller was removed."""
    ada = done(swarm.join("ada", jostle.ids([0]), deadline=60.0))
    steps = got.setdefault(call, [])

    def advance() -> None:
        try:
            steps.append(done(ada.advance(timeout=TIMEOUT_SECS)).step)
        except jostle.NotFound:
            done(ada.sync())
            raise

    repeat(call, advance)


def items(
    call: str, stream: Any, take: Callable[[Any], Any], is_last: Callable[[Any], bool]
) -> None:
    """Reads a stream until its last item."""
    taken = got.setdefault(call, [])

    def read() -> None:
        for item in each(stream):
            taken.append(take(item))
            if is_last(item):
                return
        raise jostle.NotFound("the stream has ended")

    once(call, read)


def note(event: jostle.Event) -> tuple[int, int, str]:
    """The number of an event, what it skips, and its note or its kind."""
    return event.number, event.skipped, (event.args or {}).get("text", event.kind)


def work_of(form: str, client: Any, short: Any, last: int) -> dict[str, Callable[[], object]]:
    """The calls by name."""
    swarm, brief = client.swarm(form), short.swarm(form)
    states, events = swarm.states(), swarm.events()
    return {
        "read": lambda: repeat(f"{form} read", lambda: done(swarm.status())),
        "short_read": lambda: repeat(f"{form} short_read", lambda: done(brief.status())),
        "command": lambda: commands(f"{form} command", swarm),
        "states": lambda: items(
            f"{form} states",
            states,
            lambda it: (it.epoch, it.step, it.frame),
            lambda it: it.step == last,
        ),
        "events": lambda: items(
            f"{form} events", events, note, lambda it: note(it)[2] == LAST_NOTE
        ),
        "wait": lambda: once(f"{form} wait", lambda: done(swarm.wait(step=last, show=False))),
        "condition": lambda: once(f"{form} condition", lambda: done(swarm.wait(LAST_CONDITION))),
        "run": lambda: once(
            f"{form} run",
            lambda: done(
                client.swarm(f"{form}-run").run(until_step=last, rate=1.0, wait=True, show=False)
            ),
        ),
        "advance": lambda: advances(f"{form} advance", client.swarm(f"{form}-steered")),
    }


def main() -> None:
    """Makes the calls."""
    endpoint, last = sys.argv[1], int(sys.argv[2])
    logging.getLogger("jostle").addHandler(Log())
    threading.Thread(target=loop.run_forever, daemon=True).start()
    calls: list[Callable[[], object]] = []
    for form, module in (("jostle", jostle), ("aio", aio)):
        client, short = (
            done(module.connect(endpoint, client=form, timeout=TIMEOUT_SECS)) for _ in range(2)
        )
        # Not by `connect`: if an attempt of zenoh to connect reaches its timeout just when the
        # daemon accepts it, zenoh 1.10 keeps a connection that it does not read, and the daemon
        # rejects all others of this session.
        getattr(short, "_sync", short)._session.timeout = SHORT_TIMEOUT_SECS
        calls += work_of(form, client, short, last).values()
    with ThreadPoolExecutor(len(calls)) as pool:
        working = [pool.submit(call) for call in calls]
        while len(seen) < 8 or not all(got.get(f"{form} states") for form in ("jostle", "aio")):
            time.sleep(PAUSE_SECS)
        # A wait and a run have begun a moment after the requests.
        time.sleep(0.3)
        print("ready", flush=True)
        sys.stdin.readline()
        is_over.set()
        for work in working:
            work.result()
    print(json.dumps({"seen": seen, "got": got, "said": said}), flush=True)


if __name__ == "__main__":
    main()
