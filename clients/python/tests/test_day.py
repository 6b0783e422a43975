"""The judges of a day in a lab: each turns red at what it is there for.

The day itself is a stage of `./check`, see `day/__init__.py`.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import ANY

import pytest

import jostle
from day import answers, company, crashes, films, meter, plan, promises
from day.chronicle import Chronicle, Past
from day.controllers import Exchange
from day.finding import Finding
from day.lab import Full, Notes, Recorded
from day.ledger import Asked, Ledger
from day.scientists import Nameless
from day.viewers import Seen


def asked(verb: str, number: int, answer: dict[str, Any] | None, **fields: Any) -> Asked:
    payload = None if answer is None else json.dumps(answer).encode()
    one = Asked("a", "key", verb, {}, None, "me", f"r{number}", answer=payload, answered=1.0)
    for name, value in fields.items():
        setattr(one, name, value)
    return one


def entry(seq: int, number: int, **fields: Any) -> jostle.JournalEntry:
    told = {"epoch": 1, "step": seq, "time": 0.0, "verb": "set", "args": {}, "client": "me"}
    return jostle.JournalEntry(seq=seq, request_id=f"r{number}", **{**told, **fields})


def lab(sent: list[Asked], past: Past, **fields: Any) -> Any:
    ledger = Ledger()
    for one in sent:
        ledger.note(one)
    chronicle = SimpleNamespace(pasts={"a": past})
    return SimpleNamespace(ledger=ledger, chronicle=chronicle, notes=Notes(), **fields)


def test_an_answered_command_must_be_there_once_under_its_number() -> None:
    sent = [asked("set", 1, {"seq": 1}), asked("set", 2, {"seq": 2})]
    there = Past(journal={1: entry(1, 1), 2: entry(2, 2)})
    assert answers.durable(lab(sent, there))[0]
    assert answers.order(lab(sent, there))[0]
    assert not answers.order(lab(sent[::-1], there))[0]
    for wrong in (
        {1: entry(1, 1)},
        {1: entry(1, 1), 3: entry(3, 2)},
        {1: entry(1, 1), 2: entry(2, 2), 3: entry(3, 2)},
    ):
        assert not answers.durable(lab(sent, Past(journal=wrong)))[0]


def test_what_was_refused_must_not_be_there() -> None:
    refused = asked("set", 1, None, refusals=["conflict"])
    assert answers.errors(lab([refused], Past()))[0]
    assert not answers.errors(lab([refused], Past(journal={1: entry(1, 1)})))[0]
    it = lab([asked("set", 2, None, refusals=["storage_full"])], Past())
    fine: dict[str, Any] = {
        "filled": 1.0,
        "refused": 2.0,
        "freed": 3.0,
        "taken": 3.1,
        "ran": 5,
        "refusals": 2,
        "deleted": True,
    }
    it.notes.full = Full(**fine, stepped=(3, 0))
    assert answers.full(it)[0]
    for wrong in (
        {"changed": 1},
        {"ran": 0},
        {"taken": 9.0},
        {"others": ["busy"]},
        {"deleted": False},
    ):
        it.notes.full = Full(**{**fine, **wrong}, stepped=(3, 0))
        assert not answers.full(it)[0], wrong
    it.notes.full = Full(**{**fine, "refusals": 0}, stepped=(3, 0))
    assert answers.full(it).cases == 0
    silent = asked("set", 3, None, silences=2)
    assert not answers.silence(lab([silent], Past()))[0]


def test_a_step_must_begin_where_one_ended_and_behind_nothing_safe() -> None:
    def steps(*told: tuple[int, int, int]) -> bool | None:
        results = [
            {"step": end, "result": {"steps": end - base, "durable_step": safe}}
            for base, end, safe in told
        ]
        sent = [asked("step", k, it, swarm="still") for k, it in enumerate(results)]
        return answers.steps(lab(sent, Past()))[0]

    assert steps((0, 5, 0), (5, 9, 5), (5, 8, 8))
    assert not steps((0, 5, 0), (5, 9, 9), (5, 8, 8)), "what was safe was taken back"
    assert not steps((0, 5, 0), (3, 8, 3)), "a step was taken back in part"


def test_an_answer_must_be_the_same_again() -> None:
    assert answers.again(lab([asked("set", 1, {}, again=[True, True])], Past()))[0]
    assert not answers.again(lab([asked("set", 1, {}, again=[True, False])], Past()))[0]


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
def test_events_may_miss_what_a_kill_explains(events: list[tuple[int, int]], holds: bool) -> None:
    assert answers.events(lab([], Past(events=events)))[0] == holds
    assert not answers.numbers(lab([], Past(twice=[7])))[0]
    assert not answers.journal(lab([], Past(forgotten=[7])))[0]


def test_a_step_that_a_viewer_saw_go_back_is_told() -> None:
    it = lab([], Past(), seen=[Seen(states=3)])
    assert company.viewers(it)[0]
    it.seen[0].back.append(["a", 1, 5, 1, 4])
    assert not company.viewers(it)[0]


def test_nobody_may_wait_longer_than_a_deadline() -> None:
    def waits(*times: tuple[float, float]) -> bool | None:
        exchanges = [Exchange(sent, at, 1, 1, [], []) for sent, at in times]
        ada = SimpleNamespace(exchanges=lambda: exchanges)
        node = SimpleNamespace(down=lambda: [(100.0, 101.0)])
        return company.waits(lab([], Past(), node=node, controllers={"ada": ada}))[0]

    assert waits((0.0, 0.1), (1.0, 3.1), (99.0, 105.0))
    assert not waits((0.0, 0.1), (1.0, 5.0))


def test_a_recording_may_lose_a_minute_and_must_go_on() -> None:
    def crashes(epochs: dict[int, list[int]]) -> bool | None:
        it = lab([], Past())
        it.notes.recorded = {"take": Recorded("film", 0.0, 0)}
        it.notes.recordings = {"take": SimpleNamespace(phase="recording")}
        it.notes.kills, it.notes.steps = [100.0], [{"film": (1, 5000)}]
        it.notes.read = {"take": {"epochs": epochs}}
        return films.crashes(it)[0]

    assert crashes({1: [0, 3000], 2: [4990, 9000]})
    assert not crashes({1: [0, 1000], 2: [4990, 9000]}), "more than a minute is gone"
    assert not crashes({1: [0, 4900]}), "it did not go on"


def test_twins_are_held_against_each_other() -> None:
    def twins(one: dict[int, int], other: dict[int, int]) -> Finding:
        it = lab([], Past(), seen=[Seen(twins={"twin-1": one}), Seen(twins={"twin-2": other})])
        it.notes.again = {"twin-1": ("hash", "hash"), "twin-2": ("hash", "hash")}
        return crashes.twins(it)

    assert twins({5: 1, 10: 2}, {5: 1, 15: 3}) == Finding(True, ANY, 1)
    assert not twins({5: 1, 10: 2}, {5: 1, 10: 3}).holds
    assert twins({5: 1}, {10: 2}).cases == 0, "no step was seen of both"


def test_a_past_that_is_told_again_is_held_against_the_one_before() -> None:
    def told_again(*entries: jostle.JournalEntry) -> tuple[int, list[int]]:
        past = Past(journal={seq: entry(seq, seq) for seq in (1, 2, 3)})
        Chronicle._compare(past, list(entries))
        return past.compared, past.forgotten

    assert told_again(entry(1, 1), entry(2, 2), entry(3, 3)) == (3, [])
    assert told_again(entry(1, 1), entry(3, 3)) == (2, [2])
    assert told_again() == (0, []), "nothing was held against anything"


def nothing() -> Any:
    """A day on which nothing was seen."""
    drawn = plan.draw(7, 300.0, 20, 100)
    pasts = {name: Past() for name in drawn.specs}
    breeder = SimpleNamespace(alive=set(), gone=set())
    careless = SimpleNamespace(nameless=Nameless(), swarm="nameless")
    return SimpleNamespace(
        plan=drawn,
        began=0.0,
        ledger=Ledger(),
        chronicle=SimpleNamespace(pasts=pasts, health=[], faulted=set()),
        notes=Notes(ended=0),
        seen=[Seen()],
        controllers={},
        people=SimpleNamespace(breeder=breeder, careless=careless),
        node=SimpleNamespace(lives=[], data=Path("/nowhere"), down=list),
        meter=SimpleNamespace(life=None),
    )


def test_where_nothing_was_seen_no_promise_holds() -> None:
    verdicts = promises.judge(nothing())
    assert sum(it.seen.startswith("shown by") for it in verdicts) < 20 < len(verdicts)
    # No recording has failed, since the disk was never full.
    idle = {"a full disk ends one as failed; what it had stays"}
    for verdict in verdicts:
        if not verdict.seen.startswith("shown by") and verdict.promise not in idle:
            assert verdict.holds is False, verdict


def test_a_promise_that_was_seen_too_seldom_does_not_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def verdict(holds: bool | None, count: int) -> promises.Verdict:
        def judge(lab: Any) -> Finding:
            return Finding(holds, f"{count} seen", count)

        judged = promises.Judged(judge, lambda plan: plan.seconds / 60.0)
        monkeypatch.setattr(promises, "_PROMISES", [("a part", "a promise", judged)])
        (only,) = promises.judge(nothing())
        return only

    assert verdict(True, 5).holds is True
    assert verdict(True, 4).holds is False
    assert verdict(True, 4).seen == "4 seen: too few to judge, 4 of 5"
    assert verdict(False, 5).holds is False
    assert verdict(None, 0).holds is None


def test_the_same_seed_is_the_same_day() -> None:
    assert plan.draw(7, 300.0, 20, 100) == plan.draw(7, 300.0, 20, 100)
    assert plan.draw(7, 300.0, 20, 100) != plan.draw(8, 300.0, 20, 100)
    assert len(plan.draw(7, 300.0, 20, 100).specs) == 20
    assert meter.least_squares([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == 2.0
