"""The judges of the chaos test: each detects the violation that it is for.

The test itself is a stage of `./check`, see `chaos/__init__.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import ANY

import pytest

import jostle
from chaos import controllers, crashes, guarantees, meter, plan, recordings, replies, report
from chaos.clients import UnnamedRequests
from chaos.context import FullDisk, Observations, RecordingSpan
from chaos.controller_process import Exchange
from chaos.finding import Finding
from chaos.observer import Observer, SwarmLog
from chaos.requests import Request, RequestLog
from chaos.viewers import ViewerRecord


def request(verb: str, number: int, answer: dict[str, Any] | None, **fields: Any) -> Request:
    payload = None if answer is None else json.dumps(answer).encode()
    one = Request("a", "key", verb, {}, None, "me", f"r{number}", answer=payload, answered=1.0)
    for name, value in fields.items():
        setattr(one, name, value)
    return one


def entry(seq: int, number: int, **fields: Any) -> jostle.JournalEntry:
    given = {"epoch": 1, "step": seq, "time": 0.0, "verb": "set", "args": {}, "client": "me"}
    return jostle.JournalEntry(seq=seq, request_id=f"r{number}", **{**given, **fields})


def context(sent: list[Request], log: SwarmLog, **fields: Any) -> Any:
    requests = RequestLog()
    for one in sent:
        requests.add(one)
    observer = SimpleNamespace(logs={"a": log})
    return SimpleNamespace(requests=requests, observer=observer, observed=Observations(), **fields)


def test_a_command_with_a_reply_must_be_in_the_journal_once_with_its_seq() -> None:
    sent = [request("set", 1, {"seq": 1}), request("set", 2, {"seq": 2})]
    complete = SwarmLog(journal={1: entry(1, 1), 2: entry(2, 2)})
    assert replies.durable(context(sent, complete))[0]
    assert replies.order(context(sent, complete))[0]
    assert not replies.order(context(sent[::-1], complete))[0]
    for wrong in (
        {1: entry(1, 1)},
        {1: entry(1, 1), 3: entry(3, 2)},
        {1: entry(1, 1), 2: entry(2, 2), 3: entry(3, 2)},
    ):
        assert not replies.durable(context(sent, SwarmLog(journal=wrong)))[0]


def test_a_rejected_command_must_not_be_in_the_journal() -> None:
    rejected = request("set", 1, None, errors=["conflict"])
    assert replies.errors(context([rejected], SwarmLog()))[0]
    assert not replies.errors(context([rejected], SwarmLog(journal={1: entry(1, 1)})))[0]
    it = context([request("set", 2, None, errors=["storage_full"])], SwarmLog())
    fine: dict[str, Any] = {
        "filled": 1.0,
        "rejected_at": 2.0,
        "freed": 3.0,
        "accepted": 3.1,
        "ran": 5,
        "rejections": 2,
        "deleted": True,
    }
    it.observed.full = FullDisk(**fine, stepped=(3, 0))
    assert replies.full(it)[0]
    for wrong in (
        {"changed": 1},
        {"ran": 0},
        {"accepted": 9.0},
        {"others": ["busy"]},
        {"deleted": False},
    ):
        it.observed.full = FullDisk(**{**fine, **wrong}, stepped=(3, 0))
        assert not replies.full(it)[0], wrong
    it.observed.full = FullDisk(**{**fine, "rejections": 0}, stepped=(3, 0))
    assert replies.full(it).cases == 0


def test_a_request_that_a_kill_interrupts_must_get_a_reply() -> None:
    node = SimpleNamespace(down=lambda: [(5.0, 6.0)])

    def judged(**fields: Any) -> Finding:
        one = request("set", 1, fields.pop("reply", None), **fields)
        return replies.timeouts(context([one], SwarmLog(), node=node))

    assert not judged(sent=0.0, timeouts=2).holds
    assert not judged(sent=4.0).holds
    pending = judged(sent=4.0, reply={"seq": 1}, answered=7.0)
    assert (pending.holds, pending.cases) == (True, 1)
    for fields in (
        {"sent": 4.0, "reply": {"seq": 1}, "answered": 4.5},
        {"sent": 5.5},
        {"sent": 4.0, "errors": ["conflict"]},
    ):
        other = judged(**fields)
        assert (other.holds, other.cases) == (True, 0), fields


def test_a_step_must_begin_where_one_ended_and_not_before_a_durable_step() -> None:
    def steps(*given: tuple[int, int, int]) -> bool | None:
        results = [
            {"step": end, "result": {"steps": end - base, "durable_step": safe}}
            for base, end, safe in given
        ]
        sent = [request("step", k, it, swarm="stepped") for k, it in enumerate(results)]
        return replies.steps(context(sent, SwarmLog()))[0]

    assert steps((0, 5, 0), (5, 9, 5), (5, 8, 8))
    assert not steps((0, 5, 0), (5, 9, 9), (5, 8, 8)), "a durable step was rolled back"
    assert not steps((0, 5, 0), (3, 8, 3)), "a step was rolled back in part"


def test_a_request_sent_again_must_get_the_same_reply() -> None:
    assert replies.resent(context([request("set", 1, {}, resent=[True, True])], SwarmLog()))[0]
    wrong = request("set", 1, {}, resent=[True, False])
    assert not replies.resent(context([wrong], SwarmLog()))[0]


@pytest.mark.parametrize(
    ("events", "holds"),
    [
        ([(1, 1), (1, 2), (2, 1048577), (2, 1048578)], True),
        ([(1, 1), (1, 2), (2, 3), (2, 1048577), (3, 2097153)], True),
        ([(1, 1), (1, 3)], False),
        ([(1, 1), (1, 1048577)], False),
        ([(1, 1), (2, 1048577), (2, 1048579)], False),
    ],
)
def test_only_a_kill_explains_missing_events(events: list[tuple[int, int]], holds: bool) -> None:
    assert replies.events(context([], SwarmLog(events=events)))[0] == holds
    assert not replies.numbers(context([], SwarmLog(duplicates=[7])))[0]
    assert not replies.journal(context([], SwarmLog(missing=[7])))[0]


def test_a_step_that_decreases_for_a_viewer_is_a_violation() -> None:
    it = context([], SwarmLog(), seen=[ViewerRecord(states=3)])
    assert controllers.viewers(it)[0]
    it.seen[0].back.append(["a", 1, 5, 1, 4])
    assert not controllers.viewers(it)[0]


def test_an_advance_may_not_wait_longer_than_a_deadline() -> None:
    def waits(*times: tuple[float, float]) -> bool | None:
        exchanges = [Exchange(sent, at, 1, 1, [], []) for sent, at in times]
        ada = SimpleNamespace(exchanges=lambda: exchanges)
        node = SimpleNamespace(down=lambda: [(100.0, 101.0)])
        return controllers.waits(context([], SwarmLog(), node=node, controllers={"ada": ada}))[0]

    assert waits((0.0, 0.1), (1.0, 3.1), (99.0, 105.0))
    assert not waits((0.0, 0.1), (1.0, 5.0))


def test_a_recording_may_lose_a_minute_and_must_continue() -> None:
    def judge(epochs: dict[int, list[int]]) -> bool | None:
        it = context([], SwarmLog())
        it.observed.recorded = {"take": RecordingSpan("recorded", 0.0, 0)}
        it.observed.recordings = {"take": SimpleNamespace(phase="recording")}
        it.observed.kills, it.observed.steps = [100.0], [{"recorded": (1, 5000)}]
        it.observed.read = {"take": {"epochs": epochs}}
        return recordings.crashes(it)[0]

    assert judge({1: [0, 3000], 2: [4990, 9000]})
    assert not judge({1: [0, 1000], 2: [4990, 9000]}), "more than a minute is lost"
    assert not judge({1: [0, 4900]}), "it did not continue"


def test_twins_are_compared_with_each_other() -> None:
    def twins(one: dict[int, int], other: dict[int, int]) -> Finding:
        seen = [ViewerRecord(twins={"twin-1": one}), ViewerRecord(twins={"twin-2": other})]
        it = context([], SwarmLog(), seen=seen)
        it.observed.reexecuted = {"twin-1": ("hash", "hash"), "twin-2": ("hash", "hash")}
        return crashes.twins(it)

    assert twins({5: 1, 10: 2}, {5: 1, 15: 3}) == Finding(True, ANY, 1)
    assert not twins({5: 1, 10: 2}, {5: 1, 10: 3}).holds
    assert twins({5: 1}, {10: 2}).cases == 0, "no step was seen of both"


def test_a_journal_after_a_restart_is_compared_with_the_one_before() -> None:
    def compare(*entries: jostle.JournalEntry) -> tuple[int, list[int]]:
        log = SwarmLog(journal={seq: entry(seq, seq) for seq in (1, 2, 3)})
        Observer._compare(log, list(entries))
        return log.compared, log.missing

    assert compare(entry(1, 1), entry(2, 2), entry(3, 3)) == (3, [])
    assert compare(entry(1, 1), entry(3, 3)) == (2, [2])
    assert compare() == (0, []), "no entry was compared"


def empty(seconds: float = 300.0) -> Any:
    """A run in which nothing was observed."""
    drawn = plan.draw(7, seconds, 20, 100)
    logs = {name: SwarmLog() for name in drawn.specs}
    lifecycle = SimpleNamespace(existing=set(), deleted=set())
    unnamed = SimpleNamespace(requests=UnnamedRequests(), swarm="unnamed")
    return SimpleNamespace(
        plan=drawn,
        began=0.0,
        requests=RequestLog(),
        observer=SimpleNamespace(logs=logs, health=[], faulted=set()),
        observed=Observations(ended=0),
        seen=[ViewerRecord()],
        controllers={},
        clients=SimpleNamespace(lifecycle=lifecycle, unnamed=unnamed),
        node=SimpleNamespace(runs=[], data=Path("/nowhere"), down=list),
        meter=SimpleNamespace(run_of=None),
    )


def test_without_observations_no_guarantee_holds() -> None:
    verdicts = guarantees.judge(empty())
    assert sum(bool(it.test) for it in verdicts) < 20 < len(verdicts)
    # No recording has failed, since the disk was never full.
    idle = {"on a full disk a recording fails, and its frames stay readable"}
    for verdict in verdicts:
        if not verdict.test and verdict.guarantee not in idle:
            assert verdict.holds is False, verdict


def verdict(
    monkeypatch: pytest.MonkeyPatch, holds: bool | None, count: int, seconds: float = 300.0
) -> guarantees.Verdict:
    def judge(context: Any) -> Finding:
        return Finding(holds, f"{count} seen", count)

    judged = guarantees.Judged(judge, lambda plan: plan.seconds / 60.0)
    monkeypatch.setattr(guarantees, "_GUARANTEES", [("a part", "a guarantee", judged)])
    (only,) = guarantees.judge(empty(seconds))
    return only


def test_a_guarantee_with_too_few_cases_is_violated(monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict(monkeypatch, True, 5).holds is True
    assert verdict(monkeypatch, True, 4).holds is False
    assert verdict(monkeypatch, True, 4).seen == "4 seen: too few cases, 4 of 5"
    assert verdict(monkeypatch, False, 5).holds is False
    assert verdict(monkeypatch, None, 0).holds is None


def test_a_short_run_names_the_guarantees_that_it_does_not_judge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few = verdict(monkeypatch, True, 0, seconds=60.0)
    assert (few.holds, few.seen) == (None, "0 seen: too few cases, 0 of 1")
    assert verdict(monkeypatch, True, 1, seconds=60.0).holds is True
    assert verdict(monkeypatch, False, 0, seconds=60.0).holds is False, "a violation is one"
    without = verdict(monkeypatch, None, 0, seconds=60.0)
    shown = guarantees.Verdict("a part", "another guarantee", "", None, "tests::shown")
    for one in (few, without):
        assert report.summary([one, shown]).splitlines() == [
            "not judged in this run: a guarantee",
            "0 guarantees hold, 1 not judged",
        ]
    assert report.summary([shown]) == "0 guarantees hold"
    failed = guarantees.Verdict("a part", "a guarantee", "", False)
    assert report.summary([failed]) == "1 guarantees are violated: a guarantee"


def test_the_same_seed_gives_the_same_plan() -> None:
    assert plan.draw(7, 300.0, 20, 100) == plan.draw(7, 300.0, 20, 100)
    assert plan.draw(7, 300.0, 20, 100) != plan.draw(8, 300.0, 20, 100)
    assert len(plan.draw(7, 300.0, 20, 100).specs) == 20
    assert meter.least_squares([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == 2.0
