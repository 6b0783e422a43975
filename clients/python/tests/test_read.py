"""Decoding and encoding without a daemon: states, errors, arguments."""

from __future__ import annotations

import json
import struct
from typing import Any

import cbor2
import numpy as np
import pytest

import jostle
from jostle._arguments import check_name, poses, to_json
from jostle._decode import read_event, read_reply
from jostle._errors import read_error
from jostle._state import read_state, read_step_reply

ORDER = {
    "order": 0.5,
    "mean_order": None,
    "velocity": [0.5, 0.0],
    "mean_velocity": None,
    "direction": None,
    "drift": None,
    "mean_drift": None,
}
CERTIFICATE = {
    "worst_gap": None,
    "residual": 0.0,
    "degraded": 0,
    "crossed": 0,
    "contacts": 0,
    "iterations": 0,
}
ENVELOPE = {"swarm": "demo", "epoch": 1, "step": 3, "time": 0.06, "phase": "paused", "seq": 5}
X = [0.1, -511.9999999999999]
ALPHA = [-270.02419291642303, 5e-324]


def doubles(*numbers: float) -> cbor2.CBORTag:
    return cbor2.CBORTag(86, struct.pack(f"<{len(numbers)}d", *numbers))


def state_map(**changes: Any) -> dict[str, Any]:
    return {
        "swarm": "demo",
        "epoch": 1,
        "frame": 2,
        "step": 3,
        "time": 0.06,
        "phase": "paused",
        "origin": [-1, 2],
        "id": cbor2.CBORTag(70, struct.pack("<2I", 0, 7)),
        "x": doubles(*X),
        "y": doubles(1e-300, 0.0),
        "alpha": doubles(*ALPHA),
        "weight": doubles(0.0, 0.5),
        "direction": doubles(0.0, -0.0),
        "order": ORDER,
        "certificate": CERTIFICATE,
        **changes,
    }


def test_columns_are_the_same_doubles_and_views_of_the_message() -> None:
    state = read_state(cbor2.dumps(state_map()))
    assert state.x.tobytes() == struct.pack("<2d", *X)
    assert state.alpha.tobytes() == struct.pack("<2d", *ALPHA)
    assert np.signbit(state.direction).tolist() == [False, True]
    assert state.id.dtype == np.uint32
    assert state.id.tolist() == [0, 7]
    assert state.n == 2
    assert not state.x.flags.owndata
    assert not state.x.flags.writeable


def test_positions_are_absolute() -> None:
    state = read_state(cbor2.dumps(state_map(x=doubles(1.0, 2.0), y=doubles(3.0, 4.0))))
    assert state.position.tolist() == [[-1023.0, 2051.0], [-1022.0, 2052.0]]
    assert state.informed.tolist() == [False, True]


def test_an_empty_column_and_fields_of_a_newer_daemon_are_read() -> None:
    columns = dict.fromkeys(("x", "y", "alpha", "weight", "direction"), doubles())
    empty = state_map(id=cbor2.CBORTag(70, b""), **columns, colour="red")
    empty["order"] = {**ORDER, "milling": 0.1}
    assert read_state(cbor2.dumps(empty)).position.shape == (0, 2)


def test_the_state_in_the_reply_to_step_has_its_hash() -> None:
    within = {"steps": 2, "durable_step": 2, "state_hash": "abc", "state": state_map()}
    result, state = read_step_reply(cbor2.dumps({**ENVELOPE, "result": within}))
    assert (result.steps, result.seq, result.state_hash) == (2, 5, "abc")
    assert state is not None
    assert (state.state_hash, state.n) == ("abc", 2)


@pytest.mark.parametrize(
    "change",
    [
        {"x": [0.1, 0.2]},
        {"x": cbor2.CBORTag(82, b"\0" * 16)},
        {"x": cbor2.CBORTag(86, b"\0" * 15)},
        {"x": cbor2.CBORTag(86, "text")},
        {"x": doubles(1.0)},
        {"phase": "dancing"},
        {"origin": [1]},
        {"step": -0.5},
    ],
)
def test_a_state_that_violates_the_contract_is_rejected(change: dict[str, Any]) -> None:
    with pytest.raises(jostle.Internal):
        read_state(cbor2.dumps(state_map(**change)))


def test_a_state_without_a_column_or_truncated_is_rejected() -> None:
    fields = state_map()
    del fields["y"]
    payload = cbor2.dumps(state_map())
    for wrong in (cbor2.dumps(fields), b"", payload[:-1], payload[:20], cbor2.dumps([1]), b"{}"):
        with pytest.raises(jostle.Internal):
            read_state(wrong)
    with pytest.raises(jostle.Internal):
        read_step_reply(cbor2.dumps({**ENVELOPE, "result": {"steps": 2, "state_hash": "abc"}}))


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("not_found", jostle.NotFound),
        ("already_exists", jostle.AlreadyExists),
        ("invalid_argument", jostle.InvalidArgument),
        ("incorrect_state", jostle.IncorrectState),
        ("resource_exhausted", jostle.ResourceExhausted),
        ("busy", jostle.Busy),
        ("conflict", jostle.Conflict),
        ("permission_denied", jostle.PermissionDenied),
        ("contested", jostle.Contested),
        ("storage_full", jostle.StorageFull),
        ("deadline_exceeded", jostle.DeadlineExceeded),
        ("faulted", jostle.Faulted),
        ("internal", jostle.Internal),
        ("haunted", jostle.JostleError),
    ],
)
def test_every_code_has_its_class(code: str, kind: type[jostle.JostleError]) -> None:
    fields = {"code": code, "message": "no", "details": {"field": "n"}, "step": 7}
    error = read_error(json.dumps(fields).encode())
    assert type(error) is kind
    assert (error.code, error.message, str(error)) == (code, "no", "no")
    assert (error.details, error.step) == ({"field": "n"}, 7)


def test_other_payloads_are_not_read_as_errors() -> None:
    for payload in (b"Timeout", b"[]", b"{}", b'{"code": 7}', b"\xff"):
        assert read_error(payload) is None


def test_a_reply_that_violates_the_contract_is_internal() -> None:
    for payload in (b"", b"[]", b"{}", b'{"swarm": "a", "result": null}', b"\xff"):
        with pytest.raises(jostle.Internal):
            read_reply(payload, jostle.Status)
        with pytest.raises(jostle.Internal):
            read_event(payload)


def test_an_event_of_an_unknown_kind_is_read() -> None:
    fields: dict[str, Any] = dict.fromkeys(("number", "epoch", "step", "time"), 1)
    fields |= {"swarm": "a", "phase": "paused"}
    event = read_event(json.dumps({**fields, "event": {"kind": "waltz", "step": 9}}).encode())
    assert (event.kind, event.step) == ("waltz", 1)


def test_numbers_and_columns_of_numpy_are_sent_as_numbers() -> None:
    sent = to_json({"a": np.float64(0.1), "b": np.int32(3), "c": np.arange(2)})
    assert json.loads(sent) == {"a": 0.1, "b": 3, "c": [0, 1]}


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), np.float64("nan"), -np.inf])
def test_a_number_that_is_not_finite_is_rejected_with_its_name(wrong: float) -> None:
    args = {"select": jostle.within(0.0, wrong, 1.0), "direction": 0.0}
    with pytest.raises(jostle.InvalidArgument, match=r"select\.within\.y") as caught:
        to_json({"request_id": "a", "args": args})
    assert caught.value.details == {"field": "select.within.y"}
    spec = jostle.Spec(n=1, dt=wrong)
    with pytest.raises(jostle.InvalidArgument, match=r"spec\.dt"):
        to_json({"args": {"spec": spec}})


def test_values_without_a_json_form_are_rejected() -> None:
    loop: list[Any] = []
    loop.append(loop)
    for wrong in (object(), {1, 2}, b"bytes", loop):
        with pytest.raises(jostle.InvalidArgument):
            to_json({"args": {"n": wrong}})


@pytest.mark.parametrize(
    "name", ["", "*", "**", "a$*", "@node", "a/b", "A", "-a", "a b", "a\0", "a\n", "ä", "a" * 65]
)
def test_a_name_that_would_be_another_key_is_rejected(name: str) -> None:
    with pytest.raises(jostle.InvalidArgument):
        check_name("swarm", name)


def test_a_given_start_needs_three_equal_columns_of_finite_numbers() -> None:
    start = jostle.given(np.array([0.1]), [2], (np.float32(0.5),))
    assert (start.x, start.y, start.alpha) == ([0.1], [2.0], [0.5])
    wrong: list[tuple[Any, Any, Any]] = [
        ([1.0], [1.0], [1.0, 2.0]),
        ([[1.0]], [[1.0]], [[1.0]]),
        (1.0, 1.0, 1.0),
        (["a"], [1.0], [1.0]),
        ([1.0], [float("nan")], [1.0]),
    ]
    for columns in wrong:
        with pytest.raises(jostle.InvalidArgument):
            jostle.given(*columns)


def test_poses_are_rows_of_three() -> None:
    assert poses(np.array([[1, 2, 3]])) == [{"x": 1.0, "y": 2.0, "alpha": 3.0}]
    assert poses([(1, 2, 3), (4, 5, 6)])[1] == {"x": 4.0, "y": 5.0, "alpha": 6.0}
    wrong: list[Any] = [[1, 2, 3], [(1, 2)], [("a", 1, 2)], [(1, 2, 3), (1, 2)]]
    for rows in wrong:
        with pytest.raises(jostle.InvalidArgument):
            poses(rows)


def test_ids_are_whole_numbers() -> None:
    assert jostle.ids(np.array([3, 4], np.uint32)) == {"ids": [3, 4]}
    wrong: list[Any] = [[1.5], np.array([1.0]), "ab", [None]]
    for individuals in wrong:
        with pytest.raises(jostle.InvalidArgument):
            jostle.ids(individuals)
