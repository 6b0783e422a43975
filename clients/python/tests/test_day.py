"""The judges of a day in a lab: each turns red at what it is there for.

The day itself is a stage of `./check`, see `day/__init__.py`.
"""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

import jostle
from day import answers, company, films, meter, plan
from day.chronicle import Past
from day.controllers import Exchange
from day.lab import Full, Notes, Recorded
from day.ledger import Asked, Ledger
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
    }
    it.notes.full = Full(**fine, stepped=(3, 0))
    assert answers.full(it)[0]
    for wrong in (
        {"changed": 1},
        {"ran": 0},
        {"taken": 9.0},
        {"others": ["busy"]},
        {"refusals": 0},
    ):
        it.notes.full = Full(**{**fine, **wrong}, stepped=(3, 0))
        assert not answers.full(it)[0], wrong
    silent = asked("set", 3, None, silences=2)
    assert not answers.silence(lab([silent], Past()))[0]


def test_a_step_must_begin_where_one_ended_and_behind_nothing_safe() -> None:
    def steps(*told: tuple[int, int, int]) -> bool:
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
    def waits(*times: tuple[float, float]) -> bool:
        exchanges = [Exchange(sent, at, 1, 1, [], []) for sent, at in times]
        ada = SimpleNamespace(exchanges=lambda: exchanges)
        node = SimpleNamespace(down=lambda: [(100.0, 101.0)])
        return company.waits(lab([], Past(), node=node, controllers={"ada": ada}))[0]

    assert waits((0.0, 0.1), (1.0, 3.1), (99.0, 105.0))
    assert not waits((0.0, 0.1), (1.0, 5.0))


def test_a_recording_may_lose_a_minute_and_must_go_on() -> None:
    def crashes(epochs: dict[int, list[int]]) -> bool:
        it = lab([], Past())
        it.notes.recorded = {"take": Recorded("film", 0.0, 0)}
        it.notes.recordings = {"take": SimpleNamespace(phase="recording")}
        it.notes.kills, it.notes.steps = [100.0], [{"film": (1, 5000)}]
        it.notes.read = {"take": {"epochs": epochs}}
        return films.crashes(it)[0]

    assert crashes({1: [0, 3000], 2: [4990, 9000]})
    assert not crashes({1: [0, 1000], 2: [4990, 9000]}), "more than a minute is gone"
    assert not crashes({1: [0, 4900]}), "it did not go on"


def test_the_same_seed_is_the_same_day() -> None:
    assert plan.draw(7, 300.0, 20, 100) == plan.draw(7, 300.0, 20, 100)
    assert plan.draw(7, 300.0, 20, 100) != plan.draw(8, 300.0, 20, 100)
    assert len(plan.draw(7, 300.0, 20, 100).specs) == 20
    assert meter.least_squares([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == 2.0
