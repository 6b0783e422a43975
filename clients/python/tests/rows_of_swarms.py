"""Every call of a swarm and of a controller, and what the client must send."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

import contract
import jostle
from recorder import Sent, fixture
from rows import AnyId, AtMost, File, Row, call, cmd, get, put

HOUR: dict[str, Any] = {"timeout_secs": 3600.0}
STATE = [get("state"), get("get/status")]
"""How a state is queried: the status has the length of the bodies, the state does not."""

SELECTS: list[tuple[Any, dict[str, Any]]] = [
    (jostle.ids(np.array([3, 1])), {"ids": [3, 1]}),
    (jostle.count(np.int64(2)), {"count": 2}),
    (jostle.fraction(0.25), {"fraction": 0.25}),
    (jostle.within(1.5, -2.0, 3.0), {"within": {"x": 1.5, "y": -2.0, "radius": 3.0}}),
    (jostle.informed(), {"informed": True}),
    (jostle.foremost(2, 0.75), {"foremost": {"count": 2, "along": 0.75}}),
]
ATTRACTIONS: list[dict[str, Any]] = [
    {"kind": "all", "accuracy": 1e-6},
    {"kind": "voronoi"},
    {"kind": "metric", "radius": 3.0},
    {"kind": "topological", "neighbours": 7},
    {"kind": "power", "exponent": -1.0},
]
POSES = [(1.0, 2.0, 0.5), (-1.0, 0.0, 3.0)]
WIRE_POSES = [{"x": 1.0, "y": 2.0, "alpha": 0.5}, {"x": -1.0, "y": 0.0, "alpha": 3.0}]
PARAMETERS = fixture("parameters.reply")["result"]["parameters"]
CHOICES: list[dict[str, Any]] = [
    {it["name"]: choice} for it in PARAMETERS for choice in it["choices"] if isinstance(choice, str)
]
"""Every value of the parameters that are one of several words."""

_SET = {it["name"] for it in PARAMETERS if "set" in it["changed_by"]}
SET_CHOICES = [it for it in CHOICES if it.keys() <= _SET]
ALL_SET: dict[str, Any] = {
    name: value
    for message, path in contract.fixtures("json")
    if message == "set.args"
    for name, value in json.loads(path.read_text(encoding="utf-8")).items()
}
"""Every argument of `set`: the fixtures are complete, which a test of the contract checks."""


def _changes() -> list[tuple[Any, dict[str, Any]]]:
    """Every change of a batch, and how it is sent."""
    anyone, one = jostle.count(1), {"count": 1}
    changes: list[tuple[Any, dict[str, Any]]] = [
        (jostle.Set(pi3=2.0), {"verb": "set", "args": {"pi3": 2.0}}),
        (jostle.Set(**ALL_SET), {"verb": "set", "args": ALL_SET}),
        *(
            (jostle.Set(attraction=it), {"verb": "set", "args": {"attraction": it}})
            for it in ATTRACTIONS
        ),
        *((jostle.Set(**it), {"verb": "set", "args": it}) for it in SET_CHOICES),
        (jostle.Set(noise=0.0), {"verb": "set", "args": {"noise": 0.0}}),
        (
            jostle.Inform(anyone, 0.5),
            {"verb": "inform", "args": {"select": one, "direction": 0.5}},
        ),
        (
            jostle.Inform(anyone, 0.0, weight=2.0, for_time=4.0),
            {
                "verb": "inform",
                "args": {"select": one, "direction": 0.0, "weight": 2.0, "for_time": 4.0},
            },
        ),
        (jostle.Inject(2), {"verb": "inject", "args": {"count": 2}}),
        (
            jostle.Inject(2, within={"x": 0.0, "y": 1.0, "radius": 4.0}, direction=0.0, weight=1.5),
            {
                "verb": "inject",
                "args": {
                    "count": 2,
                    "within": {"x": 0.0, "y": 1.0, "radius": 4.0},
                    "direction": 0.0,
                    "weight": 1.5,
                },
            },
        ),
        (
            jostle.Inject(at=jostle.poses(POSES)),
            {"verb": "inject", "args": {"at": WIRE_POSES}},
        ),
    ]
    for select, sent in SELECTS:
        changes += [
            (
                jostle.Inform(select, 1.0),
                {"verb": "inform", "args": {"select": sent, "direction": 1.0}},
            ),
            (jostle.Uninform(select), {"verb": "uninform", "args": {"select": sent}}),
            (jostle.Remove(select), {"verb": "remove", "args": {"select": sent}}),
        ]
    return changes


def _set(**args: Any) -> Row:
    return Row("Swarm.set", call(**args), [cmd("set", args)])


def _selecting() -> list[Row]:
    """The calls that take a selection, with every kind of it."""
    rows = []
    for select, sent in SELECTS:
        rows += [
            Row(
                "Swarm.inform",
                call(select, 0.5),
                [cmd("inform", {"select": sent, "direction": 0.5})],
            ),
            Row("Swarm.uninform", call(select), [cmd("uninform", {"select": sent})]),
            Row("Swarm.remove", call(select), [cmd("remove", {"select": sent})]),
            _join(call("ada", select), select=sent),
        ]
    return rows


def _join(taken: Any, **terms: Any) -> Row:
    defaults = {
        "mode": "lockstep",
        "deadline_secs": 5.0,
        "on_timeout": "hold",
        "driving": False,
        "again": False,
    }
    return Row("Swarm.join", taken, [cmd("join", {"controller": "ada", **defaults, **terms})])


QUESTIONS = [
    Row("Swarm.status", call(), [get("get/status")]),
    Row("Swarm.spec", call(), [get("get/spec")]),
    Row("Swarm.state", call(), STATE),
    Row("Swarm.parameters", call(), [get("get/parameters")]),
    Row("Swarm.measure", call("order"), [get("get/measures?names=order")]),
    Row("Swarm.measures", call(), [get("get/measures")]),
    Row(
        "Swarm.measures",
        call("order", "clusters.count(0.1)"),
        [get("get/measures?names=order,clusters.count(0.1)")],
    ),
    Row(
        "Swarm.histogram",
        call("pair_correlation", bins=4, max=2.5),
        [get("get/measures?histogram=pair_correlation;bins=4;max=2.5")],
    ),
    Row("Swarm.controllers", call(), [get("get/controllers")]),
    Row("Swarm.snapshot", call(), [get("get/snapshot")]),
    Row("Swarm.verify", call(), [get("get/verify?timeout_secs=3600.000")]),
    Row("Swarm.verify", call(timeout=2), [get("get/verify?timeout_secs=2.000")]),
    Row("Swarm.as_experiment", call(), [get("get/experiment")]),
    Row(
        "Swarm.as_experiment",
        call(replicates=np.int64(20)),
        [get("get/experiment?replicates=20")],
    ),
    Row(
        "Swarm.as_experiment",
        call(File("found.toml"), replicates=2),
        [get("get/experiment?replicates=2;setpoints=found.setpoints.csv")],
    ),
    # A page has two events, of the numbers 3 to 7, or two entries, 1 to 3.
    Row(
        "Swarm.history",
        call(),
        [get(f"get/events?after={after};limit=1000") for after in (0, 4, 6)],
    ),
    Row(
        "Swarm.history",
        call(after=5),
        [get("get/events?after=5;limit=1000")],
    ),
    Row(
        "Swarm.journal",
        call(),
        [get(f"get/journal?after=0;limit=1000{line}") for line in ("", ";line=3")],
    ),
    Row("Swarm.journal", call(after=2), [get("get/journal?after=2;limit=1000")]),
    Row(
        "Swarm.journal",
        call(2, from_step=np.int64(3), to_step=90, verb="set", client="olga"),
        [get("get/journal?after=2;limit=1000;from_step=3;to_step=90;verb=set;client=olga")],
    ),
    Row(
        "Swarm.wait",
        call(step=60),
        [get("get/wait?step=60;timeout_secs=30.000")],
    ),
    Row("Swarm.wait", call(step=0), [get("get/wait?step=0;timeout_secs=30.000")]),
    # A progress bar queries the daemon more often.
    Row("Swarm.wait", call(step=60, show=True), [get("get/wait?step=60;timeout_secs=0.250")]),
    Row(
        "Swarm.wait",
        call(phase="paused"),
        [get("get/wait?phase=paused;timeout_secs=30.000")],
    ),
    Row(
        "Swarm.wait",
        call(phase="running", timeout=20.0),
        [Sent(AtMost("jostle/school/get/wait?phase=running;timeout_secs=", 20.0))],
    ),
    Row(
        "Swarm.wait",
        call("order > 0.9"),
        [Sent(AnyId("jostle/school/get/wait?condition=order > 0.9;id=", ";timeout_secs=30.000"))],
    ),
    Row("Swarm.states", call(), STATE),
    Row("Swarm.orders", call(), [get("get/status")]),
    Row("Swarm.events", call(), [get("get/events?after=9007199254740991;limit=1000")]),
    Row("Swarm.events", call(after=5), [get("get/events?after=5;limit=1000")]),
    Row(
        "Swarm.events",
        call(after=0),
        [get(f"get/events?after={after};limit=1000") for after in (0, 4, 6)],
    ),
]


def _stepped(steps: int, expect_step: int) -> Sent:
    args = {"steps": steps, "return": "state"}
    return cmd("step", args, expect_step=expect_step, expect_epoch=1, **HOUR)


FRAMES = [
    Row("Swarm.frame", call(), STATE),
    Row(
        "Swarm.frame",
        call(3),
        [*STATE, _stepped(1, 40), _stepped(1, 41), _stepped(1, 42)],
    ),
    Row(
        "Swarm.frame",
        call(np.int64(5), every=2),
        [*STATE, _stepped(2, 40), _stepped(2, 42), _stepped(1, 44)],
    ),
]

COMMANDS = [
    Row("Swarm.run", call(), [cmd("run", {})]),
    Row("Swarm.run", call(12.5), [cmd("run", {"until_time": 12.5})]),
    Row("Swarm.run", call(until_step=151), [cmd("run", {"until_step": 151})]),
    Row(
        "Swarm.run",
        call(until=0.0, until_step=0),
        [cmd("run", {"until_time": 0.0, "until_step": 0})],
    ),
    Row("Swarm.run", call(rate=2.0), [cmd("run", {"rate": 2.0})]),
    Row("Swarm.run", call(rate=None), [cmd("run", {"rate": None})]),
    Row("Swarm.run", call(rate=..., at_step=41), [cmd("run", {}, at_step=41)]),
    Row(
        "Swarm.run",
        call(until_step=151, rate=None, wait=True, expect_step=40),
        [
            cmd("run", {"until_step": 151, "rate": None}, expect_step=40),
            get("get/wait?step=151;timeout_secs=30.000"),
        ],
    ),
    Row(
        "Swarm.run",
        call(until=3.0, wait=True, show=True),
        [cmd("run", {"until_time": 3.0}), get("get/wait?step=151;timeout_secs=0.250")],
    ),
    Row("Swarm.pause", call(), [cmd("pause", {})]),
    Row("Swarm.when", call(cancel=True), [cmd("when", {"cancel": True})]),
    Row(
        "Swarm.when",
        call(cancel=True, id="3f9c01be"),
        [cmd("when", {"cancel": True, "id": "3f9c01be"})],
    ),
    Row(
        "Swarm.when",
        call("order > 0.9", event="mine", from_step=np.int64(3), before_step=9),
        [
            cmd(
                "when",
                {"condition": "order > 0.9", "event": "mine", "from_step": 3, "before_step": 9},
            )
        ],
    ),
    Row(
        "Swarm.when",
        call(
            "order > 0.9", commands=[{"verb": "set", "args": {"pi3": 2.0}}], draw=7, protocol=True
        ),
        [
            cmd(
                "when",
                {
                    "condition": "order > 0.9",
                    "commands": [{"verb": "set", "args": {"pi3": 2.0}}],
                    "draw": 7,
                    "protocol": True,
                },
            )
        ],
    ),
    Row(
        "Swarm.when",
        call("order > 0.9", pause=True),
        [cmd("when", {"condition": "order > 0.9", "pause": True})],
    ),
    Row(
        "Swarm.when",
        call("order > 0.9", commands=[change for change, _ in _changes()]),
        [
            cmd(
                "when",
                {"condition": "order > 0.9", "commands": [sent for _, sent in _changes()]},
            )
        ],
    ),
    Row("Swarm.annotate", call("ready"), [cmd("annotate", {"text": "ready"})]),
    Row("Swarm.protect", call(), [cmd("protect", {"on": True})]),
    Row("Swarm.protect", call(on=False), [cmd("protect", {"on": False})]),
    Row("Swarm.step", call(), [cmd("step", {"steps": 1}, **HOUR)]),
    Row("Swarm.step", call(np.int64(50)), [cmd("step", {"steps": 50}, **HOUR)]),
    Row(
        "Swarm.step",
        call(state=True),
        [cmd("step", {"steps": 1, "return": "state"}, **HOUR), get("get/status")],
    ),
    Row(
        "Swarm.step",
        call(3, state=True, at_step=41),
        [cmd("step", {"steps": 3, "return": "state"}, at_step=41, **HOUR)],
    ),
    Row(
        "Swarm.step",
        call(3, state=True, expect_step=0, expect_epoch=2, timeout=2.5, request_id="mine"),
        [
            cmd(
                "step",
                {"steps": 3, "return": "state"},
                expect_step=0,
                expect_epoch=2,
                timeout_secs=2.5,
                request_id="mine",
            ),
            get("get/status"),
        ],
    ),
    Row("Swarm.reset", call(), [cmd("reset", {})]),
    Row("Swarm.reset", call(np.uint64(7)), [cmd("reset", {"seed": 7})]),
    Row("Swarm.reset", call(seed=0), [cmd("reset", {"seed": 0})]),
    _set(pi3=2.0),
    *(_set(**{name: value}) for name, value in ALL_SET.items() if name != "make_room"),
    *(_set(attraction=it) for it in ATTRACTIONS),
    *(_set(**it) for it in SET_CHOICES),
    _set(pi2=0.0, noise=0.0, relinearise=0),
    _set(pi1=6.0, make_room=True),
    _set(**ALL_SET),
    Row(
        "Swarm.inform",
        call(jostle.count(2), direction=0.0, weight=2.0, for_time=4.0),
        [
            cmd(
                "inform",
                {"select": {"count": 2}, "direction": 0.0, "weight": 2.0, "for_time": 4.0},
            )
        ],
    ),
    Row(
        "Swarm.inform",
        call(jostle.count(2), np.float64(0.5), weight=2.0),
        [cmd("inform", {"select": {"count": 2}, "direction": 0.5, "weight": 2.0})],
    ),
    Row(
        "Swarm.inform",
        call(select=jostle.count(2), direction=0.5, for_time=4.0),
        [cmd("inform", {"select": {"count": 2}, "direction": 0.5, "for_time": 4.0})],
    ),
    Row("Swarm.inject", call(3), [cmd("inject", {"count": 3})]),
    Row("Swarm.inject", call(at=POSES), [cmd("inject", {"at": WIRE_POSES})]),
    Row(
        "Swarm.inject",
        call(3, within=(1.0, -2.0, 4.0)),
        [cmd("inject", {"count": 3, "within": {"x": 1.0, "y": -2.0, "radius": 4.0}})],
    ),
    Row(
        "Swarm.inject",
        call(3, within={"x": 1.0, "y": -2.0, "radius": 4.0}),
        [cmd("inject", {"count": 3, "within": {"x": 1.0, "y": -2.0, "radius": 4.0}})],
    ),
    Row(
        "Swarm.inject",
        call(count=3, direction=0.0),
        [cmd("inject", {"count": 3, "direction": 0.0})],
    ),
    Row(
        "Swarm.inject",
        call(np.int64(3), direction=0.5, weight=1.5),
        [cmd("inject", {"count": 3, "direction": 0.5, "weight": 1.5})],
    ),
    *_selecting(),
    Row(
        "Swarm.batch",
        call([change for change, _ in _changes()]),
        [cmd("batch", {"commands": [sent for _, sent in _changes()]})],
    ),
    Row(
        "Swarm.batch",
        call([{"verb": "set", "args": {"pi3": 2.0}}]),
        [cmd("batch", {"commands": [{"verb": "set", "args": {"pi3": 2.0}}]})],
    ),
    Row(
        "Swarm.batch",
        call([{"verb": "set", "args": {"pi3": 2.0}}], draw=np.int64(7)),
        [cmd("batch", {"commands": [{"verb": "set", "args": {"pi3": 2.0}}], "draw": 7})],
    ),
    Row(
        "Swarm.batch",
        call([{"verb": "set", "args": {"pi3": 2.0}}], protocol=True),
        [cmd("batch", {"commands": [{"verb": "set", "args": {"pi3": 2.0}}], "protocol": True})],
    ),
    Row("Swarm.delete", call(), [cmd("delete", {})]),
    Row("Swarm.fork", call("twin"), [cmd("fork", {"name": "twin"})]),
    Row(
        "Swarm.fork",
        call("twin", np.int64(50)),
        [cmd("fork", {"name": "twin", "step": 50}, **HOUR)],
    ),
    Row(
        "Swarm.fork",
        call("twin", step=0, timeout=2.5),
        [cmd("fork", {"name": "twin", "step": 0}, timeout_secs=2.5)],
    ),
    Row("Swarm.seek", call(step=50), [cmd("seek", {"step": 50})]),
    Row("Swarm.seek", call(time=2.5), [cmd("seek", {"time": 2.5})]),
    Row("Swarm.seek", call(fraction=0.5), [cmd("seek", {"fraction": 0.5})]),
    Row("Swarm.seek", call(step=0), [cmd("seek", {"step": 0})]),
    Row("Swarm.seek", call(time=0.0), [cmd("seek", {"time": 0.0})]),
    Row("Swarm.seek", call(fraction=0.0), [cmd("seek", {"fraction": 0.0})]),
    _join(call("ada")),
    _join(
        call(
            "ada",
            jostle.ids([1, 2]),
            mode="free_running",
            deadline=0.25,
            on_timeout="free",
            driving=True,
            again=True,
        ),
        select={"ids": [1, 2]},
        mode="free_running",
        deadline_secs=0.25,
        on_timeout="free",
        driving=True,
        again=True,
    ),
    _join(call("ada", mode="lockstep", on_timeout="hold"), mode="lockstep", on_timeout="hold"),
    *(_join(call("ada", mode=it), mode=it) for it in ("free_running",)),
    *(_join(call("ada", on_timeout=it), on_timeout=it) for it in ("free", "pause")),
    _join(call("ada", deadline=np.float64(60.0)), deadline_secs=60.0),
    _join(call("ada", driving=True), driving=True),
    _join(call("ada", again=True), again=True),
]


def _advance(taken: Any, **args: Any) -> Row:
    sent = cmd("advance", {"controller": "ada", **args}, expect_step=40, **HOUR)
    return Row("Controller.advance", taken, [sent])


NAN = math.nan
BOTH = {"ids": [1, 2], "direction": [0.5, 0.5]}
"""One direction for the two that the controller steers."""

DRIVEN: dict[str, Any] = {
    "ids": [2, 1],
    "direction": [0.5, -0.5],
    "weight": [2.0, 0.0],
    "turn": [0.25, None],
    "speed": [None, 0.5],
}
DRIVE: dict[str, Any] = {
    "ids": np.array([2, 1]),
    "direction": np.array([0.5, -0.5]),
    "weight": [2.0, 0.0],
    "turn": [0.25, NAN],
    "speed": [NAN, 0.5],
}
_POINTS: list[tuple[dict[str, Any], dict[str, Any]]] = [
    ({"direction": 0.5}, BOTH),
    ({"direction": 0.0}, {"ids": [1, 2], "direction": [0.0, 0.0]}),
    ({"direction": 0.5, "ids": [2]}, {"ids": [2], "direction": [0.5]}),
    ({"direction": 0.5, "weight": 2.0}, {**BOTH, "weight": [2.0, 2.0]}),
    ({"direction": 0.5, "weight": 0.0}, {**BOTH, "weight": [0.0, 0.0]}),
    ({"direction": 0.5, "turn": 0.25}, {**BOTH, "turn": [0.25, 0.25]}),
    ({"direction": 0.5, "speed": 0.0}, {**BOTH, "speed": [0.0, 0.0]}),
    (DRIVE, DRIVEN),
]
"""Set-points, and how they are sent."""

CONTROLLERS = [
    _advance(call()),
    _advance(call(np.int64(5)), steps=5),
    _advance(call(state=True), **{"return": "state"}),
    *(_advance(call(**given), set=sent) for given, sent in _POINTS),
    _advance(call(5, **DRIVE, state=True), steps=5, set=DRIVEN, **{"return": "state"}),
    *(Row("Controller.put", call(**given), [put(sent)]) for given, sent in _POINTS),
    Row("Controller.leave", call(), [cmd("leave", {"controller": "ada"})]),
    Row("Controller.sync", call(), [get("get/controllers"), get("state")]),
    # A controller that left joins again, with its options and individuals.
    Row(
        "Controller.sync",
        call(),
        [
            get("get/controllers"),
            get("state"),
            cmd(
                "join",
                {
                    "controller": "zoe",
                    "select": {"ids": [1, 2]},
                    "mode": "free_running",
                    "deadline_secs": 0.25,
                    "on_timeout": "pause",
                    "driving": True,
                    "again": True,
                },
            ),
            get("state"),
        ],
        joined={
            "mode": "free_running",
            "deadline": 0.25,
            "on_timeout": "pause",
            "driving": True,
        },
        name="zoe",
    ),
]

ROWS = [*QUESTIONS, *FRAMES, *COMMANDS, *CONTROLLERS]
