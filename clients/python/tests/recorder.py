"""A stand-in for a daemon: a zenoh session that records every message and replies from fixtures."""

from __future__ import annotations

import base64
import copy
import json
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
import zenoh

import contract
from conftest import MAX_WAIT_SECS

NODE = "lab"
PERSON, PASSWORD, TOKEN = "ada", "sesame", "token-of-ada"
FRESH = "(fresh)"
"""Stands for a request id, or a number of a put, that the client makes up."""

_FRESH_ID = re.compile(r"[0-9a-f]{32}(-[0-9]+)?")
# Reply pages have so many entries, so that a client has to request several.
_PAGE = 2
# Recordings have so many parts.
_PARTS = 3
_FIRST_STEP = 40


@dataclass(frozen=True)
class Sent:
    """A message as it leaves a client.

    Attributes:
        selector: The key, and behind `?` the parameters.
        body: The payload, which is JSON; None if there is none.
        attachment: What proves who sent it.
    """

    selector: Any
    body: Any = None
    attachment: str | None = TOKEN


def fixture(name: str) -> dict[str, Any]:
    """A message of the contract."""
    path = contract.PROTO / "fixtures" / f"{name}.json"
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def cbor_fixture(name: str) -> dict[str, Any]:
    """A message of the contract that is CBOR."""
    found: dict[str, Any] = cbor2.loads((contract.PROTO / "fixtures" / f"{name}.cbor").read_bytes())
    return found


SNAPSHOT = cbor2.dumps(cbor_fixture("snapshot.reply")["result"])
"""The bytes of a snapshot."""


def credentials(folder: Path, endpoint: str = "tcp/127.0.0.1:1") -> Path:
    """Writes a folder of credentials, which contain the endpoint."""
    folder.mkdir()
    document = {
        "person": PERSON,
        "role": "operator",
        "endpoint": endpoint,
        "token": TOKEN,
        "password": PASSWORD,
    }
    (folder / "credentials.json").write_text(json.dumps(document), encoding="utf-8")
    return folder


class Recorder:
    """Records what clients send, and replies with the contract's fixtures.

    Attributes:
        is_mute: Whether it holds every query whose key this is true of, and never replies.
        late: Errors that it sends first in reply to a `wait` for a step.
        phase: The phase of every experiment.
        controller: The name of the controller that is listed.
        step: The step that its swarms are at.
        repeats: The requests that it was sent again under the same id.
    """

    def __init__(
        self, endpoint: str, passwords: Path | None = None, *, has_claims: bool = False
    ) -> None:
        self.endpoint = endpoint
        self.late: list[dict[str, Any]] = []
        self.trouble: list[Exception] = []
        self._changed = threading.Condition()
        self.repeats: list[Sent] = []
        self._sent: list[Sent] = []
        self._seen: set[tuple[str, str]] = set()
        self._held: list[zenoh.Query] = []
        self.clear()
        config = zenoh.Config()
        settings: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
        }
        if passwords is not None:
            passwords.write_text(f"{PERSON}:{PASSWORD}\n", encoding="utf-8")
            settings["transport/auth/usrpwd/dictionary_file"] = str(passwords)
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self._kept = [
            self.session.liveliness().declare_token(f"jostle/@node/{NODE}/alive"),
            self.session.liveliness().declare_token(f"jostle/school/alive/{NODE}"),
            # Of a row with another prefix.
            self.session.liveliness().declare_token(f"a/b/@node/{NODE}/alive"),
            # No wildcard matches a part of a key that begins with @.
            self.session.declare_queryable("**", self._hear),
            self.session.declare_queryable("**/@node/**", self._hear),
            self.session.declare_subscriber("**", self._take),
        ]
        if has_claims:
            for name in (f"@node/{NODE}/claim/1", f"school/claim/{NODE}/1"):
                token = self.session.liveliness().declare_token(f"jostle/{name}/serving")
                self._kept.append(token)

    def clear(self) -> None:
        """Clears the record, and replies to everything as at the start."""
        with self._changed:
            self._sent.clear()
            self.repeats.clear()
            self._seen.clear()
        self.phase = "finished"
        self.controller = "ada"
        self.step = _FIRST_STEP
        self.is_mute: Callable[[str], bool] = lambda key: False

    def release(self) -> None:
        """Drops every query that it holds, and replies from now on."""
        self.is_mute = lambda key: False
        with self._changed:
            held, self._held = self._held, []
        del held

    def close(self) -> None:
        """Ends the session."""
        self.release()
        self.session.close()
        assert self.trouble == []

    def sent(self, count: int = 0) -> list[Sent]:
        """Every message since `clear`; waits until there are `count`."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._sent) >= count, MAX_WAIT_SECS)
            return list(self._sent)

    def holds(self, count: int) -> bool:
        """Waits until it holds `count` queries; returns whether it does."""
        with self._changed:
            return self._changed.wait_for(lambda: len(self._held) >= count, MAX_WAIT_SECS)

    def _hear(self, query: zenoh.Query) -> None:
        key, parameters = str(query.key_expr), str(query.parameters)
        body = _read(query.payload)
        selector = f"{key}?{parameters}" if parameters else key
        self._record(Sent(selector, _freshened(body), _text(query.attachment)), key, body)
        with self._changed:
            if self.is_mute(key):
                # A query that is dropped ends as if no queryable matched it.
                self._held.append(query)
                self._changed.notify_all()
                return
        try:
            if key.endswith("/get/wait") and self.late:
                query.reply_err(json.dumps(self.late.pop(0)))
                return
            reply = self._reply(key, dict(_pairs(parameters)), body or {})
            query.reply(key.replace("@node/*", f"@node/{NODE}"), reply)
        except Exception as error:
            self.trouble.append(error)

    def _take(self, sample: zenoh.Sample) -> None:
        body = _read(sample.payload)
        self._record(Sent(str(sample.key_expr), _freshened(body), _text(sample.attachment)))

    def _record(self, sent: Sent, key: str = "", body: dict[str, Any] | None = None) -> None:
        with self._changed:
            if body is not None and "request_id" in body:
                # On a slow machine a client sends the same request again.
                if (key, body["request_id"]) in self._seen:
                    self.repeats.append(sent)
                    return
                self._seen.add((key, body["request_id"]))
            self._sent.append(sent)
            self._changed.notify_all()

    def _reply(self, key: str, parameters: dict[str, str], body: dict[str, Any]) -> bytes:
        if "/@node/" in key:
            reply = self._of_node(key.partition("/@node/")[2].partition("/")[2], parameters, body)
        else:
            (start,) = [key.rindex(it) for it in ("/cmd/", "/get/", "/state") if it in key][:1]
            reply = self._of_swarm(key[start + 1 :], parameters, body)
        return reply if isinstance(reply, bytes) else json.dumps(reply).encode()

    def _of_node(
        self, rest: str, parameters: dict[str, str], body: dict[str, Any]
    ) -> dict[str, Any] | bytes:
        match rest.split("/"):
            case ["get", "recording"]:
                return _piece(int(parameters["part"]), int(parameters["offset"]))
            case ["get", "recordings"]:
                reply = fixture("node.recordings.reply")
                for recording in reply["result"]["recordings"]:
                    recording["parts"] = _PARTS
                return reply
            case ["get", "audit"]:
                # It has the lines 1 to 4.
                reply = fixture("node.audit.reply")
                reply["result"]["oldest"] = 0
                return reply
            case ["get", noun]:
                return fixture(f"node.{noun}.reply")
            case ["cmd", "replay"] if "upload" in body["args"]:
                return fixture("replay.reply.upload")
            case ["cmd", "restore"]:
                return fixture("create.reply")
            case ["cmd", "experiment"] if "expand" in body["args"]:
                return {**fixture("experiment.reply"), "result": _expanded()}
            case ["cmd", verb]:
                return fixture(f"{verb}.reply")
            case ["experiment", _, "progress"]:
                return {**fixture("experiment.progress"), "phase": self.phase}
            case ["experiment", _, "results"]:
                page = fixture("experiment.results")
                return {**page, "next": 2 if parameters["after"] == "0" else None}
            case ["experiment", _, "order" | "series" as noun]:
                of = ".individuals" if "of" in parameters else ""
                page = fixture(f"experiment.{noun}{of}")
                for columns in (page, *page.get("measures", [])):
                    for name, values in columns.items():
                        if name in ("step", "time", "order", "drift", "value"):
                            data = np.array(values, "<f8").tobytes()
                            columns[name] = cbor2.CBORTag(86, data)
                page["next"] = 3 if parameters["after"] == "0" else None
                return cbor2.dumps(page)
        raise AssertionError(rest)

    def _of_swarm(
        self, rest: str, parameters: dict[str, str], body: dict[str, Any]
    ) -> dict[str, Any] | bytes:
        args = body.get("args", {})
        match rest.split("/"):
            case ["state"]:
                return cbor2.dumps(self._state())
            case ["cmd", _] if "at_step" in body:
                return fixture("scheduled.reply")
            case ["cmd", ("step" | "advance") as verb]:
                self.step += args.get("steps", 1)
                reply = self._placed(fixture(f"{verb}.reply"))
                reply["result"]["steps"] = args.get("steps", 1)
                if args.get("return") != "state":
                    return reply
                reply["result"]["state"] = self._state()
                return cbor2.dumps(reply)
            case ["cmd", "join"]:
                return self._placed(fixture("join.reply"))
            case ["cmd", verb]:
                return fixture(f"{verb}.reply")
            case ["get", "wait"]:
                return {**fixture("status.reply"), "step": int(parameters.get("step", 0))}
            case ["get", "events"]:
                return _page(fixture("events.reply"), "events", "number", parameters)
            case ["get", "journal"]:
                return _journal_page(parameters)
            case ["get", "snapshot"]:
                return cbor2.dumps(cbor_fixture("snapshot.reply"))
            case ["get", "controllers"]:
                reply = fixture("controllers.reply")
                reply["result"]["controllers"][0]["controller"] = self.controller
                return reply
            case ["get", "measures"] if "names" in parameters:
                reply = fixture("measures.reply")
                names = parameters["names"].split(",")
                values = [{"name": it, "value": 0.5, "unit": "1"} for it in names]
                return {**reply, "result": {"measures": values}}
            case ["get", "measures"] if "histogram" in parameters:
                bins = {"edges": [0.0, 1.0], "counts": [2], "values": [0.5]}
                histogram = {"name": parameters["histogram"], "unit": "1", **bins}
                reply = fixture("measures.reply")
                return {**reply, "result": {"measures": [], "histogram": histogram}}
            case ["get", "experiment"]:
                return fixture("experiment.file.reply")
            case ["get", noun]:
                return fixture(f"{noun}.reply")
        raise AssertionError(rest)

    def _placed(self, message: dict[str, Any]) -> dict[str, Any]:
        return {**message, "step": self.step, "time": self.step / 50}

    def _state(self) -> dict[str, Any]:
        return self._placed(cbor_fixture("state"))


EXPANDED: dict[str, Any] = {
    "run": "n=3 #0",
    "spec": {"n": 3, "seed": 17},
    "steps": 50,
    "commands": [
        {
            "at_step": step,
            "verb": "batch",
            "args": {"commands": [{"verb": "set", "args": {"pi2": 1}}], "draw": step},
        }
        for step in (0, 7)
    ],
    "stop": None,
}
"""A run as the daemon expands it."""


def _expanded() -> dict[str, Any]:
    result: dict[str, Any] = fixture("experiment.reply")["result"]
    return {**result, "created": False, "expanded": EXPANDED}


def _page(
    reply: dict[str, Any], name: str, number: str, parameters: dict[str, str]
) -> dict[str, Any]:
    """A page of the entries numbered above `after`."""
    reply = copy.deepcopy(reply)
    entries = reply["result"][name]
    reply["result"]["newest"] = entries[-1][number]
    after = int(parameters["after"])
    reply["result"][name] = [it for it in entries if it[number] > after][:_PAGE]
    return reply


def _journal_page(parameters: dict[str, str]) -> dict[str, Any]:
    """A page of the commands after `after`; the first command is line 1 of the journal."""
    reply = fixture("journal.reply")
    result = reply["result"]
    entries = [it for it in result["entries"] if it["seq"] > int(parameters["after"])]
    start = int(parameters.get("line", 1)) - 1
    result["newest"] = result["entries"][-1]["seq"]
    result["entries"] = entries[start : start + _PAGE]
    result["next"] = start + _PAGE + 1 if start + _PAGE < len(entries) else None
    return reply


def _piece(part: int, offset: int) -> dict[str, Any]:
    """A piece of a recording whose every part is four bytes."""
    reply = fixture("node.recording.reply")
    content = base64.b64encode(b"MCAP"[offset:]).decode()
    reply["result"].update(part=part, parts=_PARTS, offset=offset, length=4, bytes=content)
    return reply


def _read(payload: zenoh.ZBytes | None) -> Any:
    raw = b"" if payload is None else payload.to_bytes()
    return json.loads(raw) if raw else None


def _text(attachment: zenoh.ZBytes | None) -> str | None:
    return None if attachment is None else attachment.to_bytes().decode()


def _pairs(parameters: str) -> list[tuple[str, str]]:
    return [(name, value) for name, _, value in (it.partition("=") for it in parameters.split(";"))]


def _freshened(body: Any) -> Any:
    """The body with `FRESH` for what the client made up."""
    if not isinstance(body, dict):
        return body
    body = dict(body)
    if _FRESH_ID.fullmatch(str(body.get("request_id"))):
        body["request_id"] = FRESH
    # Numbers of puts begin with the time in microseconds.
    if abs(body.get("sequence", 0) - time.time_ns() // 1000) < 3600 * 1_000_000:
        body["sequence"] = FRESH
    return body


def fake_jostled(folder: Path, endpoint: str) -> Path:
    """A program that writes its arguments to a file and prints a recorder's endpoint."""
    program = folder / "jostled"
    script = f'printf "%s\\n" "$@" > {folder}/arguments\necho "listening on {endpoint}"\n'
    program.write_text(f"#!/bin/sh\n{script}exec sleep 600\n", encoding="utf-8")
    program.chmod(0o755)
    return program
