"""Scheduled commands, batches, and the history."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

import jostle
from conftest import MAX_WAIT_SECS

Create = Callable[..., jostle.Swarm]


def test_a_command_for_a_later_step_is_scheduled_and_executed_there(create: Create) -> None:
    swarm = create(n=5)
    later = swarm.at(np.int64(10)).set(pi3=2.0, request_id="later")
    assert isinstance(later, jostle.Scheduled)
    assert (later.applies_at_step, later.step, later.seq) == (10, 0, 0)
    assert swarm.status().scheduled == 1
    assert swarm.step(9).step == 9
    assert swarm.status().parameters.pi3 == 1.0
    assert swarm.step().step == 10
    status = swarm.status()
    assert (status.parameters.pi3, status.scheduled) == (2.0, 0)
    events = [event for event in swarm.history() if event.request_id == "later"]
    assert [(event.kind, event.step) for event in events] == [("scheduled", 0), ("command", 10)]
    assert events[0].applies_at_step == 10


def test_a_command_for_the_current_step_is_executed_at_once(create: Create) -> None:
    swarm = create(n=5)
    swarm.step(3)
    informed = swarm.at(3).inform(jostle.ids([1]), 0.0)
    assert (informed.applies_at_step, informed.step, informed.seq) == (3, 3, 2)
    assert isinstance(informed.outcome, jostle.IdsResult)
    assert informed.outcome.ids == [1]
    changed = swarm.at(3).set(pi1=5.0)
    assert isinstance(changed.outcome, jostle.SetResult)
    assert swarm.state().pi1 == 5.0
    state = swarm.at(3).step(2, state=True).outcome
    assert isinstance(state, jostle.State)
    assert (state.step, len(state.state_hash or "")) == (5, 64)


def test_an_earlier_step_is_a_conflict_and_changes_nothing(create: Create) -> None:
    swarm = create(n=5)
    swarm.step(3)
    with pytest.raises(jostle.Conflict) as caught:
        swarm.at(2).set(pi3=2.0)
    assert caught.value.details == {"field": "at_step", "at_step": 2, "step": 3}
    assert swarm.status().seq == 1
    for wrong in (-1, 1.5, "soon", 2**60):
        with pytest.raises(jostle.InvalidArgument):
            swarm.at(wrong).pause()  # type: ignore[arg-type]


def test_every_command_can_be_scheduled(create: Create) -> None:
    swarm = create(n=5)
    one = jostle.ids([1])
    answers: list[object] = [
        swarm.at(5).set(pi3=2.0),
        swarm.at(5).inform(one, 0.0),
        swarm.at(5).uninform(one),
        swarm.at(5).inject(1),
        swarm.at(5).remove(one),
        swarm.at(5).batch([jostle.Set(pi3=3.0)]),
        swarm.at(5).annotate("note"),
        swarm.at(5).protect(on=False),
        swarm.at(5).when("order > 1", pause=True),
        swarm.at(5).step(3),
        swarm.at(5).step(3, state=True),
        swarm.at(5).run(until_step=9),
        swarm.at(5).pause(),
        swarm.at(6).reset(),
        swarm.at(7).delete(),
    ]
    assert all(isinstance(answer, jostle.Scheduled) for answer in answers)
    assert swarm.status().scheduled == len(answers)
    with pytest.raises(TypeError, match="wait"):
        swarm.at(8).run(until_step=9, wait=True)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"use at\(step\)\.pause"):
        swarm.pause(at_step=8)  # type: ignore[call-arg]
    swarm.reset()
    assert swarm.status().scheduled == 0
    refused = [event for event in swarm.history() if event.kind == "refused"]
    assert len(refused) == len(answers)
    methods = {name for name in vars(jostle.AtStep) if not name.startswith("_")}
    assert {event.verb for event in refused} == methods
    for event in refused:
        assert event.error is not None
        assert (event.error.code, event.error.step) == ("conflict", 0)


def test_a_scheduled_command_that_fails_is_an_event(create: Create) -> None:
    swarm = create(n=3)
    swarm.at(5).remove(jostle.ids([2]), request_id="too late")
    swarm.remove(jostle.ids([2]))
    swarm.step(5)
    (event,) = [event for event in swarm.history() if event.kind == "refused"]
    assert (event.verb, event.request_id, event.client) == ("remove", "too late", "pytest")
    assert event.error is not None
    assert event.error.code == "invalid_argument"


def test_scheduled_commands_are_limited(create: Create) -> None:
    swarm = create(n=2)
    for number in range(1024):
        swarm.at(10 + number).pause()
    with pytest.raises(jostle.ResourceExhausted):
        swarm.at(10).pause()
    assert swarm.status().scheduled == 1024


def test_an_experiment_on_a_running_swarm_is_repeatable(create: Create) -> None:
    def run() -> str:
        swarm = create(n=20, seed=7, rate=5.0)
        swarm.run()
        swarm.at(1000).batch([jostle.Set(pi3=2.0), jostle.Inform(jostle.fraction(0.2), 0.5)])
        swarm.at(1500).uninform(jostle.fraction(1.0))
        swarm.at(2000).pause()
        swarm.run(rate=None)
        assert swarm.wait(phase="paused").step == 2000
        return swarm.status().state_hash

    assert run() == run()


def test_a_batch_is_applied_at_one_step(create: Create) -> None:
    swarm = create(n=5)
    swarm.step(2)
    result = swarm.batch(
        [
            jostle.Set(pi3=np.float64(2.0), publish_every=3),
            jostle.Inform(jostle.ids([0, 1]), direction=0.5, weight=2.0),
            jostle.Uninform(jostle.ids([0])),
            jostle.Inject(at=jostle.poses([[50.0, 0.0, 0.5]]), direction=1.0),
            jostle.Remove(jostle.ids(np.array([2, 3]))),
            {"verb": "inject", "args": {"count": 1}},
        ]
    )
    assert (result.step, result.seq) == (2, 1 + 6)
    verbs = ["set", "inform", "uninform", "inject", "remove", "inject"]
    assert [change.verb for change in result.results] == verbs
    changed, informed, uninformed, injected, removed, again = result.results
    assert changed.now is not None
    assert changed.before is not None
    assert (changed.before.pi3, changed.now.pi3, changed.scaled_by) == (1.0, 2.0, 1.0)
    assert (informed.ids, uninformed.ids, injected.ids) == ([0, 1], [0], [5])
    assert (removed.ids, removed.n, again.ids, again.n) == ([2, 3], 4, [6], 5)
    assert (informed.now, changed.ids) == (None, None)
    (event,) = [event for event in swarm.history() if event.verb == "batch"]
    assert (event.seq, len(event.args["commands"])) == (7, 6)
    assert swarm.status().informed == 2


def test_a_batch_is_applied_as_a_whole_or_not_at_all(create: Create) -> None:
    swarm = create(n=5)
    before = swarm.status()
    wrong: list[tuple[str, Any]] = [
        ("commands[1].args.pi1", jostle.Set(pi1=0.5)),
        ("commands[1].args.select.ids", jostle.Remove(jostle.ids([77]))),
        ("commands[1].args.direction", jostle.Inform(jostle.count(1), float("nan"))),
        ("commands[1]", "set"),
        ("commands[1].verb", {"verb": "step", "args": {}}),
    ]
    for field, change in wrong:
        with pytest.raises(jostle.InvalidArgument) as caught:
            swarm.batch([jostle.Set(pi3=2.0), change])
        assert caught.value.details["field"] == field
    for count in (0, 257):
        with pytest.raises(jostle.InvalidArgument):
            swarm.batch(itertools.repeat(jostle.Set(pi3=2.0), count))
    after = swarm.status()
    assert (after.seq, after.state_hash, after.parameters) == (
        0,
        before.state_hash,
        before.parameters,
    )
    assert swarm.batch(itertools.repeat(jostle.Set(pi3=2.0), 256)).seq == 256


def test_parameters_have_all_that_a_form_needs(create: Create) -> None:
    swarm = create(n=5, rate=None)
    swarm.set(pi3=1.25)
    parameters = swarm.parameters()
    # Neither has a value of its own in a form: a table, and a list.
    spec_fields = set(jostle.Spec.__struct_fields__) - {"start", "measures"}
    assert parameters.keys() == spec_fields
    pi3 = parameters["pi3"]
    assert (pi3.value, pi3.default, pi3.exclusive_minimum, pi3.kind) == (1.25, 1.0, 0.0, "number")
    assert (pi3.live, pi3.changed_by, pi3.minimum) == (True, ["set"], None)
    assert (parameters["n"].value, parameters["n"].kind) == (5, "integer")
    assert (parameters["rate"].nullable, parameters["rate"].value) == (True, None)
    assert parameters["contacts"].choices == ["endpoints", "closest", "clamped"]
    assert parameters["contacts"].value == "endpoints"
    assert {"kind": "voronoi"} in parameters["attraction"].choices
    assert not parameters["dt"].live
    assert all(parameter.doc for parameter in parameters.values())


def test_the_journal_is_what_was_applied_and_leads_to_the_same_state(create: Create) -> None:
    swarm = create(n=10, seed=3)
    swarm.step(20)
    swarm.inform(jostle.fraction(0.3), 0.5, request_id="first")
    swarm.batch([jostle.Set(pi3=2.0), jostle.Inject(2)])
    with pytest.raises(jostle.InvalidArgument):
        swarm.set(pi3=-1.0)
    swarm.step(30)
    entries = swarm.journal()
    assert [entry.verb for entry in entries] == ["step", "inform", "batch", "step"]
    assert [entry.seq for entry in entries] == [1, 2, 4, 5]
    assert [entry.step for entry in entries] == [0, 20, 20, 20]
    assert (entries[1].request_id, entries[1].client) == ("first", "pytest")
    assert {entry.skipped for entry in entries} == {0}
    now = datetime.now(UTC)
    for record in (*entries, *swarm.history()):
        assert record.when is not None
        assert record.unix_secs == record.when.timestamp()
        assert abs(now - record.when) < timedelta(seconds=MAX_WAIT_SECS)
    # A notebook shows the time as text.
    assert entries[0].when is not None
    shown = entries._repr_html_()
    assert entries[0].when.strftime("%Y-%m-%d %H:%M:%S.") in shown
    assert "unix_secs" not in shown
    later = swarm.journal(after=2)
    assert [(entry.seq, entry.skipped) for entry in later] == [(4, 0), (5, 0)]
    assert swarm.journal(after=5) == []

    again = create(n=10, seed=3)
    commands: dict[str, Callable[..., object]] = {
        "step": lambda args: again.step(args["steps"]),
        "inform": lambda args: again.inform(args["select"], args["direction"]),
        "batch": lambda args: again.batch(args["commands"]),
    }
    for entry in entries:
        commands[entry.verb](entry.args)
    assert again.status().state_hash == swarm.status().state_hash


def test_history_and_journal_read_several_pages(create: Create) -> None:
    swarm = create(n=2)
    for number in range(1100):
        swarm.set(pi3=1.0 + number / 1024)
    journal = swarm.journal()
    assert [entry.seq for entry in journal] == list(range(1, 1101))
    assert journal[-1].args == {"pi3": 1.0 + 1099 / 1024}
    created, *history = swarm.history()
    # The daemon has dropped the oldest of them but for the creation, which the reply shows.
    assert (created.number, created.kind, created.skipped) == (1, "created", 0)
    assert history[-1].number == 1101
    assert history[0].skipped == history[0].number - 2 > 0
    assert [event.number for event in history] == list(range(history[0].number, 1102))
    assert [event.number for event in swarm.history(after=1099)] == [1100, 1101]
    assert swarm.history(after=1099)[0].skipped == 0
    assert swarm.history(after=5000) == []
    for read in (swarm.history, swarm.journal):
        with pytest.raises(jostle.InvalidArgument):
            read(after=-1)


def test_a_journal_of_several_pages_has_every_command(create: Create) -> None:
    swarm = create(n=1, pi1=1.0)
    far = np.column_stack([np.arange(900) * 3.0 + 10.123456789, np.zeros((900, 2))])
    for number in range(6):
        swarm.batch([jostle.Inject(at=jostle.poses(far)), jostle.Set(publish_every=7)])
        swarm.remove(jostle.ids(range(900 * number + 1, 900 * (number + 1) + 1)))
    # Each batch takes some 80 KiB, and a page at most 256.
    entries = swarm.journal()
    changes = [2 if entry.verb == "batch" else 1 for entry in entries]
    assert sum(changes) == swarm.status().seq == 18
    assert {entry.skipped for entry in entries} == {0}


def test_a_scheduled_command_can_be_followed_to_its_result(create: Create) -> None:
    swarm = create(n=3, rate=None)
    with swarm.events(timeout=MAX_WAIT_SECS) as events:
        later = swarm.at(50).set(pi3=2.0, request_id="mine")
        assert isinstance(later, jostle.Scheduled)
        swarm.run(until_step=100)
        came = next(e for e in events if e.request_id == "mine" and e.kind != "scheduled")
    assert (came.kind, came.step) == ("command", 50)
