"""Every call of a client and of an experiment, and what the client must send."""

from __future__ import annotations

import base64
import math
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np

import jostle
from recorder import EXPANDED, SNAPSHOT, Sent, fixture
from rows import FILES, LONG, PLAN, TAPE, File, Row, call, cmd, node_cmd, node_get
from rows_of_swarms import ATTRACTIONS, CHOICES, PARAMETERS

PLAYED = fixture("experiment.reply")["result"]["progress"]["name"]
DEFAULTS: dict[str, Any] = {
    **{it["name"]: it["default"] for it in PARAMETERS},
    "n": 4,
    "start": {"kind": "disc"},
}


def _other(index: int, parameter: dict[str, Any]) -> Any:
    """A value in its range: not the default, and of a real number not that of another."""
    if parameter["choices"]:
        return parameter["choices"][-1]
    least = parameter["minimum"] or parameter["exclusive_minimum"] or 0
    most = parameter["maximum"] or math.inf
    if parameter["kind"] == "integer":
        return int(min(least + index + 1, most))
    return least + min(most - least, 1) * (index + 1) / 64


EVERYTHING = fixture("create.args.everything")["spec"]
OTHERS: dict[str, Any] = {
    # The fixture has every field of a spec, which a test of the contract checks.
    **{it: value for it, value in EVERYTHING.items() if it != "start"},
    **{it["name"]: _other(index, it) for index, it in enumerate(PARAMETERS)},
    "n": 3,
    "attraction": {"kind": "voronoi"},
    "measures": ["drift", "milling"],
    "rate": None,
}
GIVEN = {"kind": "given", "x": [0.0, 2.0, 4.0], "y": [1.0, 1.5, 2.0], "alpha": [0.0, 0.5, 1.0]}


def _create(spec: Any, sent: dict[str, Any], exist_ok: bool = False) -> Row:
    taken = call("school", spec, exist_ok=True) if exist_ok else call("school", spec)
    args = {"name": "school", "spec": sent, "exist_ok": exist_ok}
    return Row("Client.create", taken, [node_cmd("create", args)])


CREATIONS = [
    _create({"n": 4}, {"n": 4}),
    _create({"n": np.int64(4), "seed": 3}, {"n": 4, "seed": 3}, exist_ok=True),
    _create(jostle.Spec(n=4), DEFAULTS),
    _create(
        jostle.Spec(**OTHERS, start=jostle.given([0, 2, 4], [1, 1.5, 2], np.array([0, 0.5, 1]))),
        {**OTHERS, "start": GIVEN},
    ),
    _create(
        jostle.Spec(n=4, start=jostle.disc(9.5)),
        {**DEFAULTS, "start": {"kind": "disc", "radius": 9.5}},
    ),
    *(_create(jostle.Spec(n=4, **it), {**DEFAULTS, **it}) for it in CHOICES),
    *(
        _create(jostle.Spec(n=4, attraction=it), {**DEFAULTS, "attraction": it})
        for it in ATTRACTIONS
    ),
    *(_create({"n": 4, **it}, {"n": 4, **it}) for it in (*CHOICES, {"rate": None})),
]

_SNAPSHOT = base64.b64encode(SNAPSHOT).decode()


def _restored(name: str) -> list[Sent]:
    return [node_cmd("restore", {"name": name, "snapshot": _SNAPSHOT})]


def _record(taken: Any, **args: Any) -> Row:
    return Row("Client.record", taken, [node_cmd("record", {"begin": {"swarm": "school", **args}})])


def _uploaded(name: str, content: bytes, start: int, end: int) -> Sent:
    piece = base64.b64encode(content[start:end]).decode()
    args = {"name": name, "offset": start, "length": len(content), "bytes": piece}
    return node_cmd("replay", {"upload": args})


def _opened(name: str, **args: Any) -> Sent:
    return node_cmd("replay", {"open": {"name": name, **args}}, timeout_secs=60.0)


def _pieces(*pieces: tuple[int, int]) -> list[Sent]:
    """The queries of pieces of a recording: the part and the offset."""
    return [
        node_get("get/recordings"),
        *(
            node_get(f"get/recording?name=night;part={part};offset={offset}")
            for part, offset in pieces
        ),
    ]


CLIENTS = [
    *CREATIONS,
    Row("Client.restore", call(SNAPSHOT, "twin"), _restored("twin")),
    Row(
        "Client.restore",
        call(snapshot=jostle.Snapshot.from_bytes(SNAPSHOT), name="twin"),
        _restored("twin"),
    ),
    Row("Client.restore", call(File("school.snapshot"), "other"), _restored("other")),
    Row("Client.discard", call("school"), [node_cmd("discard", {"name": "school"})]),
    Row("Client.discard", call(name="other"), [node_cmd("discard", {"name": "other"})]),
    _record(call("school")),
    _record(call("school", "night"), recording="night"),
    _record(call(swarm="school", recording="night"), recording="night"),
    _record(call("school", every=np.int64(50)), every=50),
    _record(call("school", steps=1000), steps=1000),
    _record(call("school", drop_when_behind=True), drop_when_behind=True),
    _record(call("school", max_bytes=1 << 20), max_bytes=1 << 20),
    _record(call("school", temporary=True), temporary=True),
    _record(
        call(
            "school",
            "night",
            every=3,
            steps=10,
            drop_when_behind=True,
            max_bytes=5000,
            temporary=True,
        ),
        recording="night",
        every=3,
        steps=10,
        drop_when_behind=True,
        max_bytes=5000,
        temporary=True,
    ),
    Row(
        "Client.stop_recording",
        call("night"),
        [node_cmd("record", {"stop": {"recording": "night"}})],
    ),
    Row(
        "Client.delete_recording",
        call("night"),
        [node_cmd("record", {"delete": {"recording": "night"}})],
    ),
    # It has three parts of four bytes each.
    Row("Client.fetch_recording", call("night", File("new")), _pieces((0, 0), (1, 0), (2, 0))),
    Row(
        "Client.fetch_recording",
        call(recording="night", path=File("half")),
        _pieces((0, 4), (1, 2), (2, 0)),
    ),
    Row(
        "Client.replay",
        call(recording="night"),
        [_opened("night", recording="night")],
    ),
    Row(
        "Client.replay",
        call(name="shown", recording="night"),
        [_opened("shown", recording="night")],
    ),
    Row(
        "Client.replay",
        call(File("tape.mcap")),
        [_uploaded("tape", TAPE, 0, 20), _opened("tape")],
    ),
    Row(
        "Client.replay",
        call(path=File("long.mcap"), name="shown"),
        [
            _uploaded("shown", LONG, 0, 184_320),
            _uploaded("shown", LONG, 184_320, 200_016),
            _opened("shown"),
        ],
    ),
    Row("Client.submit", call(PLAN), [node_cmd("experiment", {"submit": {"toml": PLAN}})]),
    Row(
        "Client.submit",
        call({"name": "small", "grid": [{"n": np.array([3, 8])}]}),
        [
            node_cmd(
                "experiment",
                {"submit": {"toml": 'name = "small"\n\n[[grid]]\nn = [\n    3,\n    8,\n]\n'}},
            )
        ],
    ),
    Row(
        "Client.submit",
        call(source=File("plan.toml"), name="other"),
        [node_cmd("experiment", {"submit": {"toml": PLAN, "name": "other"}})],
    ),
    Row(
        "Client.submit",
        call(PLAN, again=True),
        [node_cmd("experiment", {"submit": {"toml": PLAN, "again": True}})],
    ),
    Row(
        "Client.submit",
        call(File("points.toml")),
        [
            node_cmd(
                "experiment",
                {
                    "submit": {
                        "toml": FILES,
                        "points": "n\n3\n",
                        "start": "c25hcHNob3Q=",
                        "setpoints": "step,id,direction\n",
                    }
                },
            )
        ],
    ),
    Row(
        "Client.play",
        call(PLAN),
        [
            node_cmd("experiment", {"expand": {"toml": PLAN}}),
            node_cmd("create", {"name": PLAYED, "spec": EXPANDED["spec"], "exist_ok": False}),
            *(
                cmd("batch", it["args"], swarm=PLAYED, at_step=it["at_step"])
                for it in EXPANDED["commands"]
            ),
        ],
    ),
    Row(
        "Client.play",
        call(source=PLAN, run=np.int64(2), name="live"),
        [
            node_cmd("experiment", {"expand": {"toml": PLAN, "run": "2"}}),
            node_cmd("create", {"name": "live", "spec": EXPANDED["spec"], "exist_ok": False}),
            *(
                cmd("batch", it["args"], swarm="live", at_step=it["at_step"])
                for it in EXPANDED["commands"]
            ),
        ],
    ),
    Row(
        "Client.play",
        call(File("points.toml")),
        [
            node_cmd(
                "experiment",
                {
                    "expand": {
                        "toml": FILES,
                        "points": "n\n3\n",
                        "start": "c25hcHNob3Q=",
                        "setpoints": "step,id,direction\n",
                    }
                },
            ),
            node_cmd("create", {"name": PLAYED, "spec": EXPANDED["spec"], "exist_ok": False}),
            *(
                cmd("batch", it["args"], swarm=PLAYED, at_step=it["at_step"])
                for it in EXPANDED["commands"]
            ),
        ],
    ),
    # The reply has the lines 1 to 4, and names an earlier one.
    Row(
        "Client.audit",
        call(),
        [
            node_get(f"get/audit?before={before};limit={limit}")
            for before, limit in ((2**64 - 1, 100), (1, 96))
        ],
    ),
    Row(
        "Client.audit",
        call(limit=None),
        [node_get(f"get/audit?before={before};limit=1000") for before in (2**64 - 1, 1)],
    ),
    Row(
        "Client.audit",
        call(
            user="olga",
            client="ada",
            verb="delete",
            name="school",
            since=datetime(2026, 11, 28, 7, tzinfo=UTC),
            until=datetime(2026, 11, 28, 8, 0, 0, 500_000, tzinfo=timezone(timedelta(hours=1))),
            limit=np.int64(3),
        ),
        [
            node_get(
                f"get/audit?before={2**64 - 1};limit=3;user=olga;client=ada;verb=delete"
                ";name=school;from_time=1795849200.0;to_time=1795849200.5"
            )
        ],
    ),
    *(
        Row(f"Client.{noun}", call(), [node_get(f"get/{noun}")])
        for noun in (
            "experiments",
            "recordings",
            "swarms",
            "hello",
            "whoami",
            "status",
            "schema",
            "metrics",
        )
    ),
]

_RESULTS = [node_get(f"experiment/small/results?after={after};limit=1000") for after in (0, 2)]

EXPERIMENTS = [
    Row("Experiment.progress", call(), [node_get("experiment/small/progress")]),
    Row("Experiment.wait", call(), [node_get("experiment/small/progress")]),
    *(
        Row(f"Experiment.{verb}", call(), [node_cmd("experiment", {verb: {"name": "small"}})])
        for verb in ("pause", "resume", "cancel", "delete")
    ),
    Row("Experiment.rows", call(), _RESULTS),
    Row("Experiment.frame", call(), _RESULTS),
    Row(
        "Experiment.order",
        call("n=5 #0"),
        [node_get(f"experiment/small/order?run=n=5 #0;after={after}") for after in (0, 3)],
    ),
    Row(
        "Experiment.series",
        call("n=5 #0"),
        [node_get(f"experiment/small/series?run=n=5 #0;after={after}") for after in (0, 3)],
    ),
    Row(
        "Experiment.trajectory",
        call("n=5 #0"),
        [
            node_get(f"experiment/small/series?run=n=5 #0;after={after};of=individuals")
            for after in (0, 3)
        ],
    ),
]

ROWS = [*CLIENTS, *EXPERIMENTS]
