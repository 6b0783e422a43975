"""Experiments: grids of runs that a daemon carries out, whether anybody looks on or not."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self

import msgspec
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
    Unavailable,
)
from ._link import Link
from ._reading import read_map, read_reply
from ._results import ExperimentResult, OrderSeries, Progress, ResultRow, ResultsPage

if TYPE_CHECKING:
    import pandas

_LOOK_AGAIN_SECS = 0.5
# How long a daemon that is gone is waited for: it goes on when it is back.
_RETURN_SECS = 60.0
_WHOLE = 1000

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

    def progress(self) -> Progress:
        """How far it is.

        Raises:
            NotFound: There is none of that name.
        """
        return read_reply(self._get("progress"), Progress)

    def wait(self, timeout: float | None = None, *, show: bool | None = None) -> Self:
        """Waits until it is finished, also when the daemon is away for a moment.

        Args:
            timeout: Seconds; None is however long it takes.
            show: Show a bar on standard error; None is if that is a terminal.

        Raises:
            DeadlineExceeded: Not within `timeout`; it goes on.
            IncorrectState: It was cancelled.
            Faulted: It failed.
        """
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        began = time.monotonic()
        bar = _bar(self._name) if (sys.stderr.isatty() if show is None else show) else None
        lost: float | None = None
        try:
            while True:
                try:
                    progress = self.progress()
                    lost = None
                except Unavailable:
                    lost = lost or time.monotonic()
                    if time.monotonic() - lost > _RETURN_SECS:
                        raise
                else:
                    if bar is not None:
                        bar.show(progress)
                    if progress.is_over:
                        return self._finished(progress)
                if seconds is not None and time.monotonic() - began >= seconds:
                    raise DeadlineExceeded(
                        f"experiment {self._name!r} is not finished after {seconds} s: it goes on",
                        details={"after_secs": seconds},
                    )
                rest(_LOOK_AGAIN_SECS)
        finally:
            if bar is not None:
                bar.close()

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
        rows: list[ResultRow] = []
        after = 0
        while True:
            page = read_reply(self._get(f"results?after={after};limit=1000"), ResultsPage)
            rows += page.rows
            if page.next is None:
                return rows
            after = page.next

    def frame(self) -> pandas.DataFrame:
        """The same as a table of pandas, its columns those of `results.csv`.

        `pip install jostle[pandas]` brings what it needs.
        """
        import pandas as pd

        columns = ResultRow.__struct_fields__
        frame = pd.DataFrame([msgspec.structs.astuple(row) for row in self.rows()], columns=columns)
        # Of no number at all pandas would make a column of objects.
        return frame.astype({"v_pd": "float64"})

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

    def _get(self, rest: str) -> bytes:
        key = self._link.node_key(self._node, f"experiment/{self._name}/{rest}")
        return self._link.get(key, swarm=None)


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


class _Bar(Protocol):
    """Shows how far an experiment is."""

    def show(self, progress: Progress) -> None:
        """Shows it."""

    def close(self) -> None:
        """Leaves the last on the screen."""


class _Plain:
    """A line that changes."""

    def show(self, progress: Progress) -> None:
        left = progress.left_secs
        until = "" if left is None else f", {left:.0f} s left"
        done = f"{100 * progress.share:3.0f} %, {progress.finished} of {progress.runs} runs{until}"
        sys.stderr.write(f"\r\x1b[K{progress.name} {progress.phase} {done}")
        sys.stderr.flush()

    def close(self) -> None:
        sys.stderr.write("\n")


class _Tqdm:
    """The bar of tqdm."""

    def __init__(self, tqdm: Any, name: str) -> None:
        form = "{desc} {percentage:3.0f}%|{bar}| {postfix} [{elapsed}<{remaining}]"
        self._bar = tqdm.tqdm(total=_WHOLE, desc=name, bar_format=form)

    def show(self, progress: Progress) -> None:
        self._bar.set_postfix_str(
            f"{progress.phase}, {progress.finished} of {progress.runs} runs", refresh=False
        )
        self._bar.update(round(_WHOLE * progress.share) - self._bar.n)

    def close(self) -> None:
        self._bar.close()


def _bar(name: str) -> _Bar:
    try:
        tqdm = importlib.import_module("tqdm.auto")
    except ImportError:
        return _Plain()
    return _Tqdm(tqdm, name)
