"""The types of this package against the contract's schemas, both ways."""

from __future__ import annotations

import base64
import inspect
import tempfile
import tomllib
import typing
import weakref
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

import contract
import jostle
from contract import OF_CONTROLLERS
from jostle._session import Session
from jostle._wire import ReplayResult

SCHEMAS = contract.schemas()


@pytest.mark.parametrize("name", contract.BY_HAND)
def test_a_class_written_by_hand_has_the_fields_of_its_type(name: str) -> None:
    kind, more = contract.BY_HAND[name]
    assert typing.get_type_hints(kind).keys() == contract.fields(name) | more


def test_every_selection_and_start_is_written_by_hand() -> None:
    selections = [set(typing.get_type_hints(it)) for it in typing.get_args(jostle.Select)]
    assert selections == list(contract.variants("Select").values())
    starts = {"disc": jostle.Disc, "given": jostle.Given}
    assert {tag: set(it.__struct_fields__) for tag, it in starts.items()} == contract.variants(
        "Start"
    )
    assert {it.__struct_config__.tag for it in starts.values()} == starts.keys()


# The arguments of a command with another name than on the wire, and why.
RENAMED = {
    "until_time": "until",  # The most common one, so it has the short name.
    "return": "state",  # `return` is a keyword of Python, and only a state can be returned.
    "commands": "changes",  # A batch cannot contain every command.
    "deadline_secs": "deadline",  # As `timeout_secs` is `timeout`.
}
# `swarm.protect()` protects it; on the wire a command says so.
PROTECTS = ("protect", "on")
# The verbs that the daemon executes, not a swarm.
OF_CLIENTS = {"create", "restore", "discard"}
# One verb with several actions, each with its own method.
OF_EXPERIMENTS = {"experiment", "replay"}
OF_RECORDINGS = {"begin": "record", "stop": "stop_recording", "delete": "delete_recording"}
OF_SEVERAL = OF_EXPERIMENTS | {"record"}
OPTIONS = {"expect_step", "expect_epoch", "request_id", "timeout", "options"}


def test_every_message_of_the_contract_has_its_type() -> None:
    verbs = {name.removesuffix(".args") for name in SCHEMAS if name.endswith(".args")}
    expected = {f"{verb}.args" for verb in verbs} | {"request"}
    assert SCHEMAS.keys() == contract.READ.keys() | contract.OPAQUE | expected
    of_others = OF_CLIENTS | OF_SEVERAL | OF_CONTROLLERS.keys()
    assert all(callable(getattr(jostle.Swarm, verb)) for verb in verbs - of_others)
    assert all(callable(getattr(jostle.Controller, it)) for it in OF_CONTROLLERS.values())
    kinds = {next(iter(kind["properties"])) for kind in SCHEMAS["experiment.args"]["oneOf"]}
    assert all(callable(getattr(jostle.Experiment, kind)) for kind in kinds - {"submit", "expand"})
    assert callable(jostle.Client.submit)
    assert callable(jostle.Client.play)
    kinds = {next(iter(kind["properties"])) for kind in SCHEMAS["record.args"]["oneOf"]}
    assert kinds == OF_RECORDINGS.keys()


@pytest.mark.parametrize(
    "name",
    sorted(
        name
        for name in SCHEMAS
        if name.endswith(".args") and name.removesuffix(".args") not in OF_SEVERAL
    ),
)
def test_every_command_takes_the_arguments_of_its_schema(name: str) -> None:
    verb = name.removesuffix(".args")
    owner: type = jostle.Client if verb in OF_CLIENTS else jostle.Swarm
    owner = jostle.Controller if verb in OF_CONTROLLERS else owner
    method = getattr(owner, OF_CONTROLLERS.get(verb, verb))
    mine = dict(inspect.signature(method).parameters)
    expected = {RENAMED.get(key, key) for key in SCHEMAS[name].get("properties", {})}
    if verb in OF_CONTROLLERS:
        # The controller knows its name and epoch, and counts its puts itself.
        expected -= {"controller", "sequence", "epoch"}
        if "set" in expected:
            expected = expected - {"set"} | set(SCHEMAS[name]["$defs"]["SetPoints"]["properties"])
    if verb == "when":
        expected = expected - {"changes"} | {"commands"}
    own = {"run": {"wait", "show"}}.get(verb, set[str]())
    assert mine.keys() - {"self"} - OPTIONS - own == expected
    for key in SCHEMAS[name].get("required", []):
        if verb not in OF_CONTROLLERS and (verb, key) != PROTECTS:
            assert mine[RENAMED.get(key, key)].default is inspect.Parameter.empty


class Sent(Exception):
    """Ends a command with what it would have sent."""

    def __init__(self, payload: bytes) -> None:
        super().__init__()
        self.message: dict[str, Any] = msgspec.json.decode(payload)


class Token:
    """A placeholder for a liveliness token."""

    def undeclare(self) -> None:
        """Does nothing."""


class Recorder(Session):
    """A session without a daemon: raises `Sent` instead of sending, but lets controllers join."""

    def __init__(self, joined: bytes | None = None) -> None:
        self.joined = joined
        self.client = "ada@lab"
        self.timeout = 5.0
        self.max_message_bytes = None
        self.prefix = "jostle"
        self.endpoint = "nowhere"
        self.streams = weakref.WeakSet()
        self.controllers = weakref.WeakSet()

    def declare_token(self, key: str) -> Any:
        """Returns a placeholder for a token."""
        return Token()

    def put(self, key: str, payload: bytes) -> None:
        """Raises `Sent`."""
        raise Sent(payload)

    def connected(self) -> frozenset[str]:
        """Returns one token."""
        return frozenset({"token"})

    def _query(self, selector: str, swarm: Any, timeout: Any, payload: Any, before: Any) -> bytes:
        if self.joined is not None and selector.endswith("/join"):
            return self.joined
        raise Sent(payload)


def call(verb: str, args: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """What the method of a verb sends with these arguments."""
    if verb == "replay":
        ((what, of),) = args.items()
        client = jostle.Client(Recorder(), "main")
        if what == "open" and "recording" in of:
            with pytest.raises(Sent) as caught:
                client.replay(name=of["name"], recording=of["recording"])
        else:
            with pytest.raises(Sent) as caught:
                Recorder().node_command("main", "replay", dict(args), ReplayResult)
        return caught.value.message
    if verb == "record":
        ((what, of),) = args.items()
        send = getattr(jostle.Client(Recorder(), "main"), OF_RECORDINGS[what])
        with pytest.raises(Sent) as caught:
            send(**of)
        return caught.value.message
    if verb in OF_EXPERIMENTS:
        ((what, of),) = args.items()
        client = jostle.Client(Recorder(), "main")
        if what == "submit":
            with tempfile.TemporaryDirectory() as folder, pytest.raises(Sent) as caught:
                client.submit(
                    _files(of, Path(folder)), name=of.get("name"), again=of.get("again", False)
                )
            return caught.value.message
        if what == "expand":
            with tempfile.TemporaryDirectory() as folder, pytest.raises(Sent) as caught:
                client.play(_files(of, Path(folder)), run=of.get("run"))
            return caught.value.message
        with pytest.raises(Sent) as caught:
            getattr(client.experiment(of["name"]), what)()
        return caught.value.message
    if verb in OF_CONTROLLERS:
        joined = (contract.PROTO / "fixtures" / "join.reply.json").read_bytes()
        name = OF_CONTROLLERS[verb]
        controller = jostle.Swarm(Recorder(joined), "school").join(
            args.get("controller", "ada"),
            mode="free_running" if name == "put" else "lockstep",
        )
        options |= args.get("set", {}) | {k: args[k] for k in ("steps",) if k in args}
        if args.get("return") == "state":
            options["state"] = True
        with pytest.raises(Sent) as caught:
            getattr(controller, name)(**options)
        return caught.value.message
    # `when` has two more actions, so its changes keep the name of the contract.
    renamed = {} if verb == "when" else RENAMED
    arguments = {renamed.get(name, name): value for name, value in args.items()}
    method: Callable[..., object]
    if verb in OF_CLIENTS:
        method = getattr(jostle.Client(Recorder(), "main"), verb)
    else:
        swarm: Any = jostle.Swarm(Recorder(), "school")
        if "at_step" in options:
            swarm = swarm.at(options.pop("at_step"))
        method = getattr(swarm, verb)
    if verb == "restore":
        arguments["snapshot"] = base64.b64decode(arguments["snapshot"])
    if verb == "step" and "state" in arguments:
        arguments["state"] = arguments["state"] == "state"
    if verb == "inject" and "at" in arguments:
        arguments["at"] = [(pose["x"], pose["y"], pose["alpha"]) for pose in arguments["at"]]
    with pytest.raises(Sent) as caught:
        method(**arguments, **options)
    return caught.value.message


def _files(submit: Mapping[str, Any], folder: Path) -> Path:
    """Writes the files of an experiment, and returns the path of its TOML."""
    named = tomllib.loads(submit["toml"])
    if "points" in submit:
        (folder / named["points"]).write_text(submit["points"], encoding="utf-8")
    if "setpoints" in submit:
        (folder / named["setpoints"]).write_text(submit["setpoints"], encoding="utf-8")
    if "start" in submit:
        (folder / named["start"]).write_bytes(base64.b64decode(submit["start"]))
    path = folder / "plan.toml"
    path.write_text(submit["toml"], encoding="utf-8")
    return path


def without_defaults(name: str, args: Mapping[str, Any]) -> dict[str, Any]:
    properties = SCHEMAS[name].get("properties", {})
    return {
        key: value
        for key, value in args.items()
        if "default" not in properties.get(key, {}) or value != properties[key]["default"]
    }


def args_fixtures() -> Iterator[Any]:
    for name, path in contract.fixtures("json"):
        # `record.args.mcap` is what earlier versions sent.
        if name.endswith(".args") and path.stem != "record.args.mcap":
            yield pytest.param(name, msgspec.json.decode(path.read_bytes()), id=path.stem)


@pytest.mark.parametrize(("name", "args"), list(args_fixtures()))
def test_commands_send_what_the_fixtures_contain(name: str, args: dict[str, Any]) -> None:
    sent = call(name.removesuffix(".args"), args)
    if name == "control.args":
        # Not a command, so it has no envelope; the controller numbers it.
        assert sent.keys() == {"sequence", "set"}
        assert sent["set"] == args["set"]
        return
    assert without_defaults(name, sent["args"]) == without_defaults(name, args)
    if name in contract.CHANGES:
        change = contract.CHANGES[name](**args)
        (command,) = call("batch", {"changes": [change]})["args"]["commands"]
        assert command["verb"] == name.removesuffix(".args")
        assert without_defaults(name, command["args"]) == without_defaults(name, args)


def test_the_envelope_is_the_one_of_the_fixture() -> None:
    fixture = msgspec.json.decode((contract.PROTO / "fixtures" / "request.json").read_bytes())
    assert fixture.keys() == SCHEMAS["request"]["properties"].keys()
    options = {
        key: fixture[key] for key in ("request_id", "at_step", "expect_step", "expect_epoch")
    }
    sent = call("inform", fixture["args"], **options, timeout=fixture["timeout_secs"])
    assert sent == fixture


def test_a_request_without_options_has_an_id_and_no_other_fields() -> None:
    first, second = call("pause", {}), call("pause", {})
    assert first.keys() == {"request_id", "client", "timeout_secs", "args"}
    assert first["request_id"] != second["request_id"]
    assert len(first["request_id"]) == 32


def test_the_daemon_serves_the_same_schemas(client: jostle.Client) -> None:
    served = client.schema()
    assert (served.node, served.wire_version) == (client.node, client.hello().wire_version)
    assert served.schemas.keys() == SCHEMAS.keys()
    for name, schema in served.schemas.items():
        defined = SCHEMAS[name]["$defs"]
        own = {key: value for key, value in schema.items() if key not in {"$schema", "title"}}
        nested = own.pop("$defs", {})
        assert {**own, "$defs": defined} == SCHEMAS[name]
        assert {it: defined[it] for it in nested} == nested
