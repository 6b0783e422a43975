"""Experiments: grids of runs that a daemon carries out, whether anybody looks on or not."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from ._arguments import check_name, check_seconds
from ._cancel import rest
from ._errors import (
    DeadlineExceeded,
    Faulted,
    IncorrectState,
    Internal,
    InvalidArgument,
    JostleError,
    Unavailable,
)
from ._link import Link
from ._progress import Bar
from ._reading import read_map, read_reply
from ._results import ExperimentResult, OrderSeries, Progress, ResultRow, ResultsPage, of_rows
from ._show import Listed, trouble

if TYPE_CHECKING:
    import pandas

_LOOK_AGAIN_SECS = 0.5
# How long a daemon that is gone is waited for: it goes on when it is back.
_RETURN_SECS = 60.0

Source = str | os.PathLike[str] | Mapping[str, Any]
"""What an experiment is made from: a file, the text of one, or what such a text says."""


class Experiment:
    """An experiment on a daemon; `experiment` and `Client.submit` make one.

    It goes on without this object. Of what is finished, nothing is ever done again.
    """

    def __init__(self, link: Link, node: str, name: str) -> None:
        self._link = link
        self._node = node
        self._name = check_name("experiment", name)

    @property
    def name(self) -> str:
        """Its name."""
        return self._name

    def __repr__(self) -> str:
        return f"Experiment({self._name!r} at {self._link.endpoint})"

    def _repr_html_(self) -> str:
        try:
            return self.progress()._repr_html_()
        except JostleError as error:
            return trouble(error)

    def progress(self) -> Progress:
        """How far it is.

        Raises:
            NotFound: There is none of that name.
        """
        return self._progress(None)

    def wait(self, timeout: float | None = None, *, show: bool | None = None) -> Self:
        """Waits until it is finished, also when the daemon is away for a moment.

        Args:
            timeout: Seconds; None is however long it takes.
            show: Show a bar; None is if it is seen, on a terminal or in a notebook.

        Raises:
            DeadlineExceeded: Not within `timeout`; it goes on.
            IncorrectState: It was cancelled.
            Faulted: It failed.
        """
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        began = time.monotonic()
        lost: float | None = None
        with Bar(self._name, show) as bar:
            while True:
                left = None if seconds is None else began + seconds - time.monotonic()
                try:
                    progress = self._progress(left)
                    lost = None
                except Unavailable:
                    lost = lost or time.monotonic()
                    if time.monotonic() - lost > _RETURN_SECS:
                        raise
                else:
                    bar.show(progress.share, progress._told())
                    if progress.is_over:
                        return self._finished(progress)
                if seconds is not None and time.monotonic() - began >= seconds:
                    raise DeadlineExceeded(
                        f"experiment {self._name!r} is not finished after {seconds} s: it goes on",
                        details={"after_secs": seconds},
                    )
                rest(_LOOK_AGAIN_SECS)

    def _finished(self, progress: Progress) -> Self:
        if progress.phase == "finished":
            return self
        kind = IncorrectState if progress.phase == "cancelled" else Faulted
        why = f" ({progress.message})" if progress.message else ""
        raise kind(
            f"experiment {self._name!r} {'was ' if kind is IncorrectState else ''}"
            f"{progress.phase}{why}, {progress.finished} of {progress.runs} runs are finished: "
            "`resume` goes on",
            details={"phase": progress.phase},
        )

    def pause(self) -> Progress:
        """Has its runs stand still; the next experiment begins."""
        return self._command("pause")

    def resume(self) -> Progress:
        """Has it go on when it was paused or cancelled, or failed."""
        return self._command("resume")

    def cancel(self) -> Progress:
        """Ends it; what is finished is kept."""
        return self._command("cancel")

    def delete(self) -> Progress:
        """Deletes it with its results, when it is over; how it stood.

        Raises:
            IncorrectState: It is not over: cancel it first.
        """
        return self._command("delete")

    def rows(self) -> list[ResultRow]:
        """What came of the runs that are finished by now, in the order of its plan."""
        rows: Listed[ResultRow] = Listed()
        after = 0
        while True:
            page = read_reply(self._get(f"results?after={after};limit=1000"), ResultsPage)
            rows += page.rows
            if page.next is None:
                return rows
            after = page.next

    def frame(self) -> pandas.DataFrame:
        """The same as a table of pandas, its columns those of `results.csv`.

        Raises:
            ImportError: pandas is missing; `pip install jostle[pandas]` brings it.
        """
        return of_rows(self.rows())

    def order(self, run: str) -> OrderSeries:
        """The order of one run over time, if the experiment measures it.

        Args:
            run: Its name, as `rows` has it.

        Raises:
            InvalidArgument: The experiment measures no such thing.
            NotFound: There is no such run.
            IncorrectState: It is not finished so far.
        """
        parts: list[OrderSeries] = []
        after: int | None = 0
        while after is not None:
            fields = read_map(self._get(f"order?run={_selected(run)};after={after}"))
            after = fields.get("next")
            parts.append(
                OrderSeries(run, *(_column(fields, name) for name in ("time", "order", "drift")))
            )
        time_, order, drift = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("time", "order", "drift")
        )
        return OrderSeries(run, time_, order, drift)

    def _command(self, what: Literal["pause", "resume", "cancel", "delete"]) -> Progress:
        return send(self._link, self._node, {what: {"name": self._name}}).progress

    def _progress(self, timeout: float | None) -> Progress:
        """How far it is; the reply takes no longer than `timeout` seconds, or the client's."""
        if timeout is not None:
            timeout = min(max(timeout, 0.001), self._link.timeout)
        return read_reply(self._get("progress", timeout), Progress)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        key = self._link.node_key(self._node, f"experiment/{self._name}/{rest}")
        return self._link.get(key, swarm=None, timeout=timeout)


def send(
    link: Link,
    node: str,
    args: dict[str, Any],
    timeout: float | None = None,
    request_id: str | None = None,
) -> ExperimentResult:
    """Has a daemon do something with an experiment."""
    key = link.node_key(node, "cmd/experiment")
    payload = link.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
    return read_reply(payload, ExperimentResult)


def to_toml(source: Source) -> str:
    """The text of an experiment's file.

    Raises:
        InvalidArgument: It cannot be one.
        OSError: The file cannot be read.
    """
    if isinstance(source, Mapping):
        return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in source.items())
    if isinstance(source, str) and "\n" in source:
        return source
    return Path(source).read_text(encoding="utf-8")


def _key(key: object) -> str:
    return json.dumps(str(key), ensure_ascii=False)


def _value(value: Any) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False)
        case Mapping():
            fields = ", ".join(f"{_key(key)} = {_value(it)}" for key, it in value.items())
            return f"{{ {fields} }}"
        case list() | tuple() | range():
            return f"[{', '.join(map(_value, value))}]"
    raise InvalidArgument(
        f"{value!r} is none of what a file of an experiment holds: numbers, words, truths, lists "
        "and dictionaries",
        details={"field": "toml"},
    )


def _selected(run: str) -> str:
    if ";" in run:
        raise InvalidArgument(f"{run!r} is no name of a run", details={"field": "run"})
    return run


def _column(fields: Mapping[str, Any], name: str) -> NDArray[np.float64]:
    column = fields.get(name)
    data = getattr(column, "value", None)
    if not isinstance(data, bytes):
        raise Internal(f"the daemon sent an order whose {name} is no column")
    return np.frombuffer(data, "<f8")
