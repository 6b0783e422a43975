"""Tables about arguments: which calls take which, and which are not sent, each with the reason."""

from __future__ import annotations

from typing import Any

import numpy as np

from rows import Arguments, File, call
from rows_of_swarms import POSES, WIRE_POSES

ENVELOPE: dict[str, list[Any]] = {
    "at_step": [41, 0],
    "expect_step": [40, 0],
    "expect_epoch": [3, 0],
    "timeout": [2.25, 3600],
    "request_id": ["mine"],
}
"""The options around the arguments of a command, and values to send: none may be lost, nor a 0."""

_ALL = ("at_step", "expect_step", "expect_epoch", "timeout", "request_id")
_EXPECTING = ("expect_step", "expect_epoch", "timeout", "request_id")
_PLAIN = ("timeout", "request_id")

TAKEN: dict[str, tuple[str, ...]] = {
    "Swarm.run": _ALL,
    "Swarm.pause": _ALL,
    "Swarm.step": _ALL,
    "Swarm.reset": _ALL,
    "Swarm.set": _ALL,
    "Swarm.inform": _ALL,
    "Swarm.uninform": _ALL,
    "Swarm.inject": _ALL,
    "Swarm.remove": _ALL,
    "Swarm.batch": _ALL,
    "Swarm.annotate": _ALL,
    "Swarm.protect": _ALL,
    "Swarm.when": _ALL,
    "Swarm.delete": _ALL,
    "Swarm.join": _EXPECTING,
    "Controller.leave": _EXPECTING,
    "Controller.advance": ("timeout",),
    "Swarm.fork": _PLAIN,
    "Swarm.seek": _PLAIN,
    "Client.create": _PLAIN,
    "Client.restore": _PLAIN,
    "Client.discard": _PLAIN,
    "Client.record": _PLAIN,
    "Client.stop_recording": _PLAIN,
    "Client.delete_recording": _PLAIN,
    "Client.submit": _PLAIN,
    "Client.replay": ("timeout",),
}
"""Which of them each call takes."""

SHOWN: dict[str, Arguments] = {
    "Swarm.run": call(until=3.0, wait=True),
    "Swarm.wait": call(step=60),
    "Swarm.frame": call(2),
    "Client.fetch_recording": call("night", File("new")),
    "Client.replay": call(File("tape.mcap")),
    "Experiment.wait": call(),
}
"""The calls that show a bar."""

VALUES: list[tuple[str, Arguments, Any]] = [
    ("ids", call([3, np.uint32(1)]), {"ids": [3, 1]}),
    ("count", call(np.int64(2)), {"count": 2}),
    ("fraction", call(0.25), {"fraction": 0.25}),
    ("within", call(1.5, y=-2.0, radius=3.0), {"within": {"x": 1.5, "y": -2.0, "radius": 3.0}}),
    ("informed", call(), {"informed": True}),
    ("informed", call(False), {"informed": False}),
    ("foremost", call(2, along=0.75), {"foremost": {"count": 2, "along": 0.75}}),
    ("disc", call(), {"kind": "disc"}),
    ("disc", call(9.5), {"kind": "disc", "radius": 9.5}),
    (
        "given",
        call([0, 1], y=[2, 3], alpha=np.array([0.5, 1.5])),
        {"kind": "given", "x": [0.0, 1.0], "y": [2.0, 3.0], "alpha": [0.5, 1.5]},
    ),
    ("poses", call(POSES), WIRE_POSES),
]
"""Calls that build arguments, and what is sent of them."""

_FILE = "reads a file of this machine"
_PICTURE = "draws on this machine"

NOT_SENT: dict[tuple[str, str], str] = {
    ("Swarm.at", "step"): "is the option `at_step` of every command",
    ("Client.swarm", "name"): "is in the key of every row of Swarm",
    ("Client.experiment", "name"): "is in the key of every row of Experiment",
    ("Client.play", "timeout"): "is that of each of its requests: test_play.py",
    ("Client.play", "request_id"): "those of its requests begin with it: test_play.py",
    ("Experiment.wait", "timeout"): "ends the wait on this machine: test_timeouts.py",
    ("Swarm.states", "timeout"): "ends the wait on this machine: test_timeouts.py",
    ("Swarm.orders", "timeout"): "ends the wait on this machine: test_timeouts.py",
    ("Swarm.events", "timeout"): "ends the wait on this machine: test_timeouts.py",
    ("local", "show"): _PICTURE,
    ("View.wait", "timeout"): _PICTURE,
    ("Swarm.view", "seconds"): _PICTURE,
    ("Swarm.view", "hz"): _PICTURE,
    ("Snapshot.from_bytes", "data"): "reads bytes of this machine",
    ("Snapshot.load", "path"): _FILE,
    ("Snapshot.save", "path"): "writes a file of this machine",
    ("Snapshot.save", "force"): "writes a file of this machine",
    ("Recording.to_csv", "path"): "writes a file of this machine",
    ("Recording.to_extxyz", "path"): "writes a file of this machine",
    ("read_recording", "path"): _FILE,
    ("read_table", "path"): _FILE,
    ("frame", "records"): "makes a table on this machine",
    ("WhoAmI.may", "verb"): "looks into a reply",
    **{
        ("sweep", argument): "a sweep needs no daemon: test_sweep.py"
        for argument in ("source", "executor", "folder", "task_secs", "jostled", "again")
    },
    ("Sweep.wait", "show"): _PICTURE,
    ("Objective.rows", "values"): "a search needs no daemon: test_objective.py",
    ("env.ParallelEnv", "neighbours"): "is about what agents observe: test_env.py",
    ("env.ParallelEnv", "sight"): "is about what agents observe: test_env.py",
    ("env.ParallelEnv.action_space", "agent"): "is about the environment's spaces: test_env.py",
    ("env.ParallelEnv.observation_space", "agent"): "is about the environment's spaces",
    ("env.ParallelEnv.reset", "options"): "there are none",
    ("env.ShepherdEnv.reset", "options"): "there are none",
    **{
        (f"env.{name}", argument): "is about the episode on this machine: test_env.py"
        for name in ("ParallelEnv", "ShepherdEnv")
        for argument in ("max_steps", "render_mode")
    },
}
"""The arguments of which nothing is sent, and why."""

NO_REQUEST: dict[str, str] = {
    "Client.close": "ends the connection",
    "Local.close": "ends the daemon",
    "Swarm.close": "ends its streams",
    "Controller.cancel": "joins again if an exchange is under way: test_controllers.py",
    "Stream.close": "ends it",
    "Recording.frame": "makes a table of a file",
    **dict.fromkeys(
        ["Sweep.cancel", "Sweep.faults", "Sweep.frame", "Sweep.rows"],
        "a sweep needs no daemon: test_sweep.py",
    ),
    "View.show": _PICTURE,
    "View.stop": _PICTURE,
    "env.ParallelEnv.render": _PICTURE,
    "env.ShepherdEnv.render": _PICTURE,
    **dict.fromkeys(
        ["env.ParallelEnv.fork", "env.ShepherdEnv.fork"],
        "a copy compares its hash with that of a real swarm: test_env_copies.py",
    ),
    "env.ParallelEnv.state": "is what the last step led to",
}
"""The calls without arguments that send nothing that could be compared, and why."""

NOT_OFFERED: dict[tuple[str, str], str] = {
    ("control", ".epoch"): "a controller has one epoch, and `sync` renews it",
    ("record", ".begin.format"): "is sent by earlier versions alone; the daemon records MCAP",
    ("step", ".return=none"): "is left out, since it is the default",
    ("advance", ".return=none"): "is left out, since it is the default",
}
"""What the contract's arguments have and this package does not send, and why."""

_NO_STEP = "is about the daemon, which has no step"
_NO_EPOCH = "is about the daemon, which has no epoch"
_OWN = "a controller generates and stores its own, so that an advance is executed once"

NOT_AROUND: dict[tuple[str, str], str] = {
    **{
        (call, name): _NO_STEP if "step" in name else _NO_EPOCH
        for call, taken in TAKEN.items()
        if call.startswith("Client.")
        for name in ("at_step", "expect_step", "expect_epoch")
        if name not in taken
    },
    **{
        (call, "at_step"): "a controller joins and leaves when its program runs"
        for call in ("Swarm.join", "Controller.leave")
    },
    ("Controller.advance", "at_step"): "it is made for the step that the controller is at",
    ("Controller.advance", "expect_step"): _OWN,
    ("Controller.advance", "expect_epoch"): "`expect_step` does: an epoch begins at another step",
    ("Controller.advance", "request_id"): _OWN,
    ("Client.replay", "request_id"): "a replay that is opened again is `already_exists`",
    **{
        ("Swarm.fork", name): "its `step` selects the state, also a past one"
        for name in ("at_step", "expect_step", "expect_epoch")
    },
    **{
        ("Swarm.seek", name): "what a replay shows at a place is always the same"
        for name in ("at_step", "expect_step", "expect_epoch")
    },
    **{(call, "client"): "is the connection's" for call in TAKEN},
}
"""What the envelope of the contract has and a call does not take, and why."""
