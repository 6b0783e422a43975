"""Every call that connects, and what the client must send, or pass to the daemon it starts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from recorder import FRESH, NODE, TOKEN, Sent
from rows import PLAN, File, Row, call, node_cmd
from rows_of_clients import DEFAULTS


@dataclass(frozen=True)
class Stand:
    """A placeholder for what each test has: an endpoint, a client, a program."""

    name: str


ENDPOINT, PROOF, CLIENT, PROGRAM = map(Stand, ("endpoint", "credentials", "client", "program"))

_DEFAULT_CLIENT = f"python-{os.getpid()}"


def _hello(node: str = "*", prefix: str = "jostle", proof: str | None = None) -> Sent:
    return Sent(f"{prefix}/@node/{node}/get/hello", None, proof)


def _request(args: dict[str, Any], client: str, timeout_secs: float) -> dict[str, Any]:
    return {"request_id": FRESH, "client": client, "timeout_secs": timeout_secs, "args": args}


def _paused(
    prefix: str = "jostle",
    client: str = _DEFAULT_CLIENT,
    timeout_secs: float = 5.0,
    proof: str | None = None,
) -> Sent:
    """The call of every test on its connected client."""
    return Sent(f"{prefix}/school/cmd/pause", _request({}, client, timeout_secs), proof)


CONNECTS = [
    Row("connect", call(ENDPOINT), [_hello(), _paused()]),
    Row("connect", call(ENDPOINT, node="lab"), [_hello("lab"), _paused()]),
    Row(
        "connect",
        call(ENDPOINT, prefix="a/b"),
        [_hello(prefix="a/b"), _paused(prefix="a/b")],
    ),
    Row("connect", call(ENDPOINT, client="eve"), [_hello(), _paused(client="eve")]),
    Row("connect", call(endpoint=ENDPOINT, timeout=2.25), [_hello(), _paused(timeout_secs=2.25)]),
    Row(
        "connect",
        call(ENDPOINT, credentials=PROOF),
        [_hello(proof=TOKEN), _paused(proof=TOKEN)],
    ),
]


def _started(*flags: str, folder: str = "(temporary)") -> Sent:
    """The command line of the daemon."""
    own = ["serve", "--listen", "tcp/127.0.0.1:0", "--data-dir", folder]
    return Sent("jostled", [*own, *flags], None)


_QUIET = ("--node=local", "--http=")

LOCALS = [
    Row("local", call(jostled=PROGRAM), [_started(*_QUIET), _hello(), _paused()]),
    Row(
        "local",
        call(File("kept"), jostled=PROGRAM),
        [_started(*_QUIET, folder="kept"), _hello(), _paused()],
    ),
    Row(
        "local",
        call(folder=File("kept"), jostled=PROGRAM, client="eve"),
        [_started(*_QUIET, folder="kept"), _hello(), _paused(client="eve")],
    ),
    Row(
        "local",
        call(jostled=PROGRAM, timeout=2.25),
        [_started(*_QUIET), _hello(), _paused(timeout_secs=2.25)],
    ),
    Row(
        "local",
        call(jostled=PROGRAM, max_individuals=5000, log="debug"),
        [_started(*_QUIET, "--max-individuals=5000", "--log=debug"), _hello(), _paused()],
    ),
    Row(
        "local",
        call(jostled=PROGRAM, node="mine", http="127.0.0.1:0"),
        [_started("--node=mine", "--http=127.0.0.1:0"), _hello(), _paused()],
    ),
]


def _submitted(client: str, timeout_secs: float, **args: Any) -> Sent:
    body = _request({"submit": {"toml": PLAN, **args}}, client, timeout_secs)
    return Sent(f"jostle/@node/{NODE}/cmd/experiment", body, None)


EXPERIMENTS = [
    Row("experiment", call(PLAN, client=CLIENT), [_submitted("ada@lab", 7.5)]),
    Row(
        "experiment",
        call(source=PLAN, name="other", client=CLIENT),
        [_submitted("ada@lab", 7.5, name="other")],
    ),
    Row(
        "experiment",
        call(PLAN, again=True, client=CLIENT),
        [_submitted("ada@lab", 7.5, again=True)],
    ),
    Row(
        "experiment",
        call(File("plan.toml"), endpoint=ENDPOINT),
        [_hello(), _submitted(_DEFAULT_CLIENT, 5.0)],
    ),
]

_SWARM = "env-(fresh)"


def _env_cmd(verb: str, args: dict[str, Any], **envelope: Any) -> Sent:
    body = {**_request(args, _DEFAULT_CLIENT, 5.0), **envelope}
    return Sent(f"jostle/{_SWARM}/cmd/{verb}", body, None)


def _env_created(ids: list[int], **spec: Any) -> list[Sent]:
    created = node_cmd(
        "create",
        {"name": _SWARM, "spec": {**DEFAULTS, "publish_every": 50, **spec}, "exist_ok": False},
        client=_DEFAULT_CLIENT,
        timeout_secs=5.0,
    )
    joined = {
        "controller": "env",
        "select": {"ids": ids},
        "mode": "lockstep",
        "deadline_secs": 5.0,
        "on_timeout": "hold",
        "driving": False,
        "again": False,
    }
    return [_hello(), Sent(created.selector, created.body, None), _env_cmd("join", joined)]


def _env_reset(seed: int) -> list[Sent]:
    # The seed of an episode is drawn from that of the environment.
    drawn = int(np.random.default_rng(seed).integers(2**53))
    return [
        _env_cmd("reset", {"seed": drawn}),
        Sent(f"jostle/{_SWARM}/get/controllers", None, None),
        Sent(f"jostle/{_SWARM}/state", None, None),
    ]


def _env_advanced(ids: list[int], direction: list[float], weight: list[float]) -> list[Sent]:
    points = {"ids": ids, "direction": direction, "weight": weight}
    args = {"controller": "env", "steps": 3, "set": points, "return": "state"}
    return [_env_cmd("advance", args, expect_step=40, timeout_secs=3600.0)]


_OF_ENVS: dict[str, Any] = {"goal": 0.5, "max_weight": 3.0, "steps_per_action": 3, "pi1": 6.0}

ENVS: dict[str, list[Row]] = {
    # Each is created, reset, stepped and closed.
    "ParallelEnv": [
        Row(
            "env.ParallelEnv",
            call(4, 2, **_OF_ENVS, endpoint=ENDPOINT),
            _env_created([0, 1], pi1=6.0),
        ),
        Row("env.ParallelEnv.reset", call(seed=7), _env_reset(7)),
        Row(
            "env.ParallelEnv.step",
            call({"informed_0": np.array([1, 0]), "informed_1": [0, 0]}),
            _env_advanced([0, 1], [0.5, 0.0], [3.0, 0.0]),
        ),
        Row("env.ParallelEnv.close", call(), [_env_cmd("delete", {})]),
    ],
    "ShepherdEnv": [
        Row(
            "env.ShepherdEnv",
            call(n=4, informed=1, **_OF_ENVS, endpoint=ENDPOINT),
            _env_created([0, 1, 2, 3], pi1=6.0),
        ),
        Row("env.ShepherdEnv.reset", call(seed=8), _env_reset(8)),
        # Of the fixture's individuals 1 is the nearest to the centre.
        Row(
            "env.ShepherdEnv.step",
            call(np.array([0, 0, 1, 0])),
            _env_advanced([1], [0.5], [3.0]),
        ),
        Row("env.ShepherdEnv.close", call(), [_env_cmd("delete", {})]),
    ],
}

ROWS = [*CONNECTS, *LOCALS, *EXPERIMENTS, *(row for rows in ENVS.values() for row in rows)]
CALLS = {row.call for row in ROWS}

WITHOUT_OPTIONS: dict[str, str] = {
    **dict.fromkeys(CALLS, "connects, and what it sends then are other calls"),
    "Swarm.frame": "steps from one state to the next, each expected",
    "Client.play": "its options are those of several requests: test_play.py",
    "Controller.sync": "joins on the terms that the controller had",
    **{
        f"Experiment.{verb}": "takes nothing: the client's timeout holds"
        for verb in ("pause", "resume", "cancel", "delete")
    },
}
"""The calls that send commands and take no options, and why."""
