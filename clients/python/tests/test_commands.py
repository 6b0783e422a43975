"""Every command and every query, as a user calls them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import jostle
from jostle import _queries, _waits

Create = Callable[..., jostle.Swarm]


def test_hello_and_status_identify_the_daemon(client: jostle.Client, create: Create) -> None:
    hello = client.hello()
    assert hello.node == client.node
    assert hello.wire_version == 1
    assert hello.limits.max_message_bytes >= 1 << 16
    before = client.status()
    create(n=7)
    after = client.status()
    assert after.swarms == before.swarms + 1
    assert after.individuals == before.individuals + 7
    assert after.clients >= 1
    assert after.uptime_secs >= before.uptime_secs


def test_defaults_are_those_of_the_daemon(client: jostle.Client, create: Create) -> None:
    assert create(n=3).spec() == jostle.Spec(n=3)
    named = jostle.Spec(n=4, pi1=2.0, seed=9, dt=0.01, rate=None, start=jostle.disc(5.0))
    swarm = client.create("spec", named)
    try:
        assert swarm.spec() == named
    finally:
        swarm.delete()


def test_a_created_swarm_is_listed_and_paused(client: jostle.Client, create: Create) -> None:
    swarm = create(n=3)
    status = swarm.status()
    assert (status.swarm, status.phase, status.step, status.n) == (swarm.name, "paused", 0, 3)
    assert status.reason == "created"
    assert status.parameters.pi1 == 4.0
    assert status.order.mean_order is None
    (summary,) = [s for s in client.swarms() if s.swarm == swarm.name]
    assert (summary.phase, summary.step, summary.n, summary.informed) == ("paused", 0, 3, 0)
    assert [s.swarm for s in client.swarms()] == sorted(s.swarm for s in client.swarms())


def test_create_accepts_an_equal_swarm_with_exist_ok(client: jostle.Client) -> None:
    spec = jostle.Spec(n=3, seed=1)
    swarm = client.create("equal", spec)
    try:
        swarm.step(5)
        assert client.create("equal", spec, exist_ok=True).status().step == 5
        with pytest.raises(jostle.AlreadyExists):
            client.create("equal", spec)
        with pytest.raises(jostle.AlreadyExists):
            client.create("equal", jostle.Spec(n=4), exist_ok=True)
    finally:
        swarm.delete()


def test_step_returns_the_step_reached(create: Create) -> None:
    swarm = create(n=5)
    result = swarm.step(10)
    assert (result.step, result.steps, result.phase) == (10, 10, "paused")
    assert result.time == pytest.approx(0.2)
    assert result.state_hash == swarm.status().state_hash
    state = swarm.step(np.int64(2), state=True)
    assert (state.step, state.n, state.state_hash) == (12, 5, swarm.status().state_hash)
    assert state.x.tobytes() == swarm.state().x.tobytes()
    assert swarm.step().step == 13


def test_run_until_waits_for_the_end(create: Create) -> None:
    swarm = create(n=5)
    result = swarm.run(until_step=20, rate=None)
    assert (result.until_step, result.rate) == (20, None)
    assert swarm.wait(step=20).step == 20
    assert swarm.wait(phase="paused").reason == "finished"
    # A time is reached at the first step at or after it.
    assert swarm.run(until=0.61, wait=True).step == 31


def test_rate_left_out_is_unchanged_and_none_is_as_fast_as_possible(create: Create) -> None:
    swarm = create(n=2, rate=3.0)
    assert swarm.run().rate == 3.0
    assert swarm.run(rate=np.float64(0.5)).rate == 0.5
    assert swarm.run(rate=None).rate is None
    assert swarm.run().rate is None
    assert swarm.pause().phase == "paused"
    assert swarm.pause().phase == "paused"


def test_set_changes_only_the_given_parameters(create: Create) -> None:
    swarm = create(n=5)
    result = swarm.set(pi3=1.25, publish_every=np.int32(2))
    assert (result.before.pi3, result.now.pi3) == (1.0, 1.25)
    assert (result.before.publish_every, result.now.publish_every) == (5, 2)
    assert (result.before.pi1, result.now.pi1, result.scaled_by) == (4.0, 4.0, 1.0)
    assert swarm.set(pi2=0.25, pi4=5.0).now.pi3 == 1.25
    assert swarm.status().parameters == jostle.ParameterValues(
        pi1=4.0,
        pi2=0.25,
        pi3=1.25,
        pi4=5.0,
        contacts="endpoints",
        stepping="position",
        relinearise=0,
        attraction={"kind": "all"},
        noise=0.0,
        publish_every=2,
    )
    changed = swarm.set(stepping="velocity", attraction={"kind": "voronoi"}, noise=0.5).now
    assert (changed.stepping, changed.noise) == ("velocity", 0.5)
    assert (changed.attraction["kind"], changed.contacts) == ("voronoi", "endpoints")


def test_a_note_is_in_journal_and_events_and_changes_nothing(create: Create) -> None:
    swarm = create(n=5)
    before = swarm.status()
    reply = swarm.annotate("Kamera 2 ersetzt: ü")
    assert (reply.seq, reply.step, reply.phase) == (before.seq + 1, 0, "paused")
    assert swarm.status().state_hash == before.state_hash
    (entry,) = swarm.journal()
    assert (entry.verb, entry.args) == ("annotate", {"text": "Kamera 2 ersetzt: ü"})
    event = swarm.history()[-1]
    assert (event.kind, event.verb, event.args) == ("command", "annotate", entry.args)
    for wrong in ("", "a" * 1001, "two\nlines", 7):
        with pytest.raises(jostle.InvalidArgument) as caught:
            swarm.annotate(wrong)  # type: ignore[arg-type]
        assert caught.value.details["field"] == "text"
    assert swarm.status().seq == reply.seq


def test_a_protected_swarm_is_neither_deleted_nor_reset(create: Create) -> None:
    swarm = create(n=5)
    before = swarm.status()
    assert not before.protected
    reply = swarm.protect()
    assert (reply.seq, reply.step, reply.phase) == (before.seq + 1, 0, "paused")
    after = swarm.status()
    assert (after.protected, after.state_hash) == (True, before.state_hash)
    for rejected in (swarm.delete, swarm.reset, swarm.at(7).delete, swarm.at(7).reset):
        with pytest.raises(jostle.IncorrectState, match=f"`jostle protect --off {swarm.name}`"):
            rejected()
    with pytest.raises(jostle.InvalidArgument) as caught:
        swarm.protect(on=2)  # type: ignore[arg-type]
    assert caught.value.details["field"] == "on"
    swarm.step(3)
    swarm.protect(on=False)
    assert not swarm.status().protected
    assert swarm.reset().step == 0


def test_a_condition_pauses_or_changes_the_swarm_once(create: Create) -> None:
    swarm = create(n=5)
    assert swarm.status().when is None
    # It holds at once: the swarm pauses after one step.
    swarm.when("order>=0", pause=True)
    assert swarm.status().when == ["order >= 0"]
    assert swarm.step(7).steps == 1
    assert (swarm.status().reason, swarm.status().when) == ("condition", None)
    status = swarm.run(until="order >= 0", rate=None, wait=True)
    assert (status.step, status.phase) == (2, "paused")
    swarm.when("order >= 0", commands=[jostle.Set(pi3=2.0)])
    assert swarm.step(7).steps == 7
    assert swarm.status().parameters.pi3 == 2.0
    fired = [entry.step for entry in swarm.journal() if entry.verb == "fired"]
    assert fired == [1, 2, 3]
    swarm.when("order >= 0", commands=[jostle.Set(pi3=1.5), jostle.Set(pi2=0.5)])
    swarm.step()
    swarm.set(pi3=1.0)
    assert swarm.status().parameters.pi2 == 0.5
    # Each change has a number, and none is missing.
    assert [entry.skipped for entry in swarm.journal()] == [0] * len(swarm.journal())
    swarm.when("order > 1", pause=True)
    swarm.when(cancel=True)
    assert swarm.status().when is None
    for wrong in ("", "ordr > 1", "msd > 1", 7):
        with pytest.raises(jostle.InvalidArgument) as caught:
            swarm.when(wrong, pause=True)  # type: ignore[arg-type]
        assert caught.value.details["field"] == "condition"
    with pytest.raises(jostle.InvalidArgument, match="request_id"):
        swarm.run(until="order > 1", request_id="one")
    with pytest.raises(jostle.InvalidArgument, match="name one end"):
        swarm.run(until="order > 1", until_step=9)
    assert swarm.status().when is None


def test_a_run_until_a_condition_says_whether_it_held(
    create: Create, client: jostle.Client
) -> None:
    swarm = create(n=5, rate=1.0)
    other = client.swarm(swarm.name)
    for end, reason in (
        (other.pause, "requested"),
        (other.reset, "reset"),
        (lambda: other.when("order >= 0", pause=True), "condition"),
    ):
        with ThreadPoolExecutor() as pool:
            run = pool.submit(swarm.run, until="order > 1", wait=True)
            while swarm.status().phase != "running":
                time.sleep(0.01)
            end()
            with pytest.raises(jostle.IncorrectState, match=r"before order > 1 held") as caught:
                run.result(60.0)
        assert caught.value.details["reason"] == reason
        left = swarm.status().conditions or []
        assert [it.condition for it in left] == ([] if reason == "reset" else ["order > 1"])
        for it in left:
            assert it.id in str(caught.value)
        swarm.when(cancel=True)
    with pytest.raises(jostle.DeadlineExceeded, match=r"removes the condition") as late:
        swarm.run(until="order > 1", wait=True, timeout=0.5)
    [waiting] = swarm.status().conditions or []
    assert f"id={waiting.id!r}" in str(late.value)
    # Given again it is the same one.
    assert swarm.when("order > 1", pause=True).id == waiting.id
    swarm.pause()
    swarm.when(cancel=True, id=waiting.id)
    assert swarm.status().conditions is None
    # It is removed if the run is rejected, and others are not.
    kept = swarm.when("order > 0.999", pause=True).id
    with swarm.join("ada", jostle.ids([0])), pytest.raises(jostle.IncorrectState):
        swarm.run(until="order > 1", wait=True)
    assert [it.id for it in swarm.status().conditions or []] == [kept]
    assert swarm.run(until="order >= 0", rate=None, wait=True).reason == "condition"


def test_longer_bodies_need_make_room(create: Create) -> None:
    swarm = create(n=20, pi1=1.0)
    swarm.step(500)
    result = swarm.set(pi1=8.0, make_room=True)
    assert result.now.pi1 == 8.0
    assert result.scaled_by >= 1.0


def test_inform_and_uninform_with_every_selection(create: Create) -> None:
    swarm = create(n=10, seed=3)
    assert swarm.inform(jostle.ids(np.array([4, 2])), np.pi / 2, weight=0.75).ids == [2, 4]
    state = swarm.state()
    assert state.informed.nonzero()[0].tolist() == [2, 4]
    assert state.direction[2] == np.pi / 2
    assert state.weight[2] == 0.75
    assert state.order.direction == pytest.approx(np.pi / 2)
    assert len(swarm.inform(jostle.count(3), 0.0).ids) == 3
    assert len(swarm.inform(jostle.fraction(0.5), 0.0).ids) == 5
    assert swarm.inform(jostle.within(0.0, 0.0, 1e3), 0.0).ids == list(range(10))
    assert swarm.status().informed == 10
    (front,) = swarm.inform(jostle.foremost(1, along=0.0), 0.0).ids
    assert front == int(np.argmax(swarm.state().position[:, 0]))
    assert len(swarm.uninform({"count": 4}).ids) == 4
    assert swarm.uninform({"fraction": 1.0}).n == 10
    assert swarm.status().informed == 0


def test_informed_for_a_time_expires(create: Create) -> None:
    swarm = create(n=3)
    swarm.inform(jostle.ids([1]), 0.0, for_time=0.1)
    assert swarm.step(4, state=True).informed.tolist() == [False, True, False]
    assert not swarm.step(2, state=True).informed.any()


def test_inject_and_remove(create: Create) -> None:
    swarm = create(n=5)
    assert swarm.inject(2).ids == [5, 6]
    at = np.array([[100.0, 0.0, 0.5], [110.0, 0.0, -0.5]])
    result = swarm.inject(at=at, direction=0.25, weight=2.0)
    assert (result.ids, result.n) == ([7, 8], 9)
    state = swarm.state()
    np.testing.assert_allclose(state.position[-2:], at[:, :2], rtol=0, atol=1e-12)
    assert state.alpha[-2:].tolist() == [0.5, -0.5]
    assert state.weight[-2:].tolist() == [2.0, 2.0]
    (alone,) = swarm.inject(1, within=(-100.0, 50.0, 2.0)).ids
    assert math.dist(swarm.state().position[-1], (-100.0, 50.0)) <= 2.0
    assert swarm.inject(1, within={"x": 50.0, "y": 50.0, "radius": 3.0}).n == 11
    result = swarm.remove(jostle.ids([0, alone]))
    assert (result.ids, result.n) == ([0, alone], 9)
    assert 0 not in swarm.state().id


def test_reset_begins_a_new_epoch_at_the_start(create: Create) -> None:
    swarm = create(n=5, seed=1)
    start = swarm.status()
    swarm.step(10)
    result = swarm.reset()
    assert (result.step, result.seed, result.phase) == (0, 1, "paused")
    assert result.epoch > start.epoch
    assert result.state_hash == start.state_hash
    assert swarm.reset(seed=2).state_hash != start.state_hash
    assert swarm.status().seed == 2


def test_delete_ends_a_swarm(client: jostle.Client) -> None:
    swarm = client.create("short-lived", jostle.Spec(n=2))
    assert swarm.delete().swarm == "short-lived"
    assert "short-lived" not in [summary.swarm for summary in client.swarms()]
    with pytest.raises(jostle.NotFound):
        swarm.status()


def test_leaving_a_with_block_deletes_nothing(client: jostle.Client, create: Create) -> None:
    with create(n=2) as swarm:
        stream = swarm.states()
    assert list(stream) == []
    assert swarm.status().n == 2


def test_wait_returns_when_the_step_is_reached_and_in_the_phase(create: Create) -> None:
    swarm = create(n=3)
    swarm.step(5)
    assert swarm.wait(step=3).step == 5
    assert swarm.wait(phase="paused").phase == "paused"
    swarm.run(until_step=50, rate=None)
    assert swarm.wait(step=40, timeout=20.0).step >= 40


def test_wait_for_a_condition_changes_nothing(create: Create) -> None:
    swarm, twin = create(n=12, seed=7), create(n=12, seed=7)
    assert swarm.wait("order >= 0").step == 0
    with pytest.raises(jostle.DeadlineExceeded):
        swarm.wait("msd(1) > 0", timeout=0.05)
    assert swarm.status().when is None
    for one in (swarm, twin):
        one.inform(jostle.count(2), direction=1.0)
    swarm.run(until_step=400, rate=50.0)
    assert swarm.wait("msd(1) > 0.01 for 0.5", timeout=20.0).step >= 75
    swarm.wait(step=400)
    twin.step(400)
    assert swarm.status().state_hash == twin.status().state_hash
    for wrong in ("ordr > 1", ""):
        with pytest.raises(jostle.InvalidArgument):
            swarm.wait(wrong)
    with pytest.raises(jostle.InvalidArgument):
        swarm.wait("order > 0", step=1)  # type: ignore[call-overload]
    with pytest.raises(jostle.InvalidArgument, match=";"):
        swarm.wait("order > 0; phase=paused")


def test_a_wait_whose_token_arrives_late_is_asked_again_for_a_time(
    create: Create, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = create(n=3)
    missed = jostle.IncorrectState("no token", details={"token": "key"})
    query, left = swarm._session.get_once, 12

    def without_token(*arguments: Any, **options: Any) -> Any:
        nonlocal left
        left -= 1
        if left >= 0:
            raise missed
        return query(*arguments, **options)

    monkeypatch.setattr(swarm._session, "get_once", without_token)
    # As often as the token may be missed within this time, each at once.
    assert swarm.wait("order >= 0").step == 0
    assert left < 0
    monkeypatch.setattr(_queries, "_TOKEN_TIMEOUT_SECS", 0.2)
    left = 10**6
    with pytest.raises(jostle.IncorrectState, match="no token"):
        swarm.wait("order >= 0")


def test_a_wait_that_has_ended_leaves_its_place_to_the_next(create: Create) -> None:
    swarm = create(n=3)
    for _ in range(40):
        with pytest.raises(jostle.DeadlineExceeded):
            swarm.wait("msd(1) > 0", timeout=0.02)


def test_a_wait_takes_no_id_that_the_daemon_may_still_know(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(_waits, "time", SimpleNamespace(monotonic=lambda: now))
    wait_ids = _waits.WaitIds()
    first, second, third = (wait_ids.take() for _ in range(3))
    wait_ids.give_back(second)
    now = 14.0
    wait_ids.give_back(first)
    assert wait_ids.take() not in (first, second, third)
    now = 16.0
    assert wait_ids.take() == second
    assert wait_ids.take() not in (first, second, third)


def test_wait_gives_the_reason_why_a_step_will_not_be_reached(create: Create) -> None:
    swarm = create(n=3)
    with pytest.raises(jostle.IncorrectState, match="step 0") as caught:
        swarm.wait(step=10)
    assert caught.value.step == 0
    with pytest.raises(jostle.DeadlineExceeded):
        swarm.wait(phase="running", timeout=0.05)
    with pytest.raises(jostle.InvalidArgument):
        swarm.wait(step=1, phase="paused")  # type: ignore[call-overload]
    with pytest.raises(jostle.InvalidArgument):
        swarm.run(wait=True)


def test_a_given_start_is_exact_to_the_bit(client: jostle.Client) -> None:
    x = np.array([0.1, -7.0000000000000009, 20 / 3])
    y = np.array([1e-300, np.nextafter(3.0, 4.0), -0.0])
    alpha = np.array([-270.02419291642303, 5e-324, np.pi])
    swarm = client.create("given", jostle.Spec(n=3, start=jostle.given(x, y, alpha)))
    try:
        state = swarm.state()
        assert state.origin == (0, 0)
        assert (state.x.tobytes(), state.y.tobytes()) == (x.tobytes(), y.tobytes())
        assert state.alpha.tobytes() == alpha.tobytes()
        start = swarm.spec().start
        assert isinstance(start, jostle.Given)
        assert np.array(start.alpha).tobytes() == alpha.tobytes()
    finally:
        swarm.delete()


def test_a_swarm_can_have_one_individual(create: Create) -> None:
    swarm = create(n=1)
    swarm.inform(jostle.count(1), 0.0)
    state = swarm.step(1500, state=True)
    assert (state.n, state.position.shape) == (1, (1, 2))
    assert math.cos(state.alpha[0]) == pytest.approx(1.0)
    with pytest.raises(jostle.InvalidArgument):
        swarm.remove(jostle.count(1))


def test_the_same_commands_lead_to_the_same_hash(create: Create) -> None:
    def run() -> tuple[list[str], bytes]:
        swarm = create(n=20, seed=5)
        hashes = [swarm.step(50).state_hash]
        informed = swarm.inform(jostle.fraction(0.2), 1.0)
        swarm.set(pi3=2.0)
        hashes.append(swarm.step(50).state_hash)
        swarm.inject(2)
        swarm.remove(jostle.ids(informed.ids[:1]))
        state = swarm.step(50, state=True)
        return [*hashes, str(state.state_hash)], state.x.tobytes()

    assert run() == run()


def test_every_command_is_an_event_with_its_client(create: Create) -> None:
    swarm = create(n=3)
    with swarm.events(timeout=20.0) as events:
        swarm.set(pi3=2.0)
        event = next(event for event in events if event.kind == "command")
    assert (event.verb, event.args, event.client) == ("set", {"pi3": 2.0}, "pytest")
    assert event.request_id is not None
