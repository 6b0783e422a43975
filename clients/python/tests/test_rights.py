"""A daemon with users, over TLS and on this machine."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

import jostle
from conftest import JOSTLED, Daemon, eventually
from contract import PROTO
from jostle import aio

PEOPLE = {"vera": "viewer", "cleo": "controller", "olga": "operator"}

OF_CONTROLLERS = ["join", "advance", "leave", "annotate"]
"""The verbs that controllers may use, by the table in `docs/security.md`."""

_DOCUMENT = (PROTO / "asyncapi.json").read_text(encoding="utf-8")
SWARM_VERBS = sorted(set(re.findall(r"\{prefix\}/\{swarm\}/cmd/(\w+)", _DOCUMENT)))
NODE_VERBS = sorted(set(re.findall(r"\{prefix\}/@node/\{node\}/cmd/(\w+)", _DOCUMENT)))
"""The verbs of the contract, all of which operators may use."""


@pytest.fixture(scope="module")
def auth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rights") / "auth"
    people = [f"{name}={role}" for name, role in PEOPLE.items()]
    subprocess.run([JOSTLED, "--auth-dir", folder, "auth", "init", *people], check=True)
    return folder


@pytest.fixture(scope="module")
def lab(auth: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JOSTLED_AUTH_DIR", str(auth))
        daemon = Daemon(tmp_path_factory.mktemp("lab"), "tls/127.0.0.1:0")
    yield daemon
    daemon.stop()


def enter(lab: Daemon, auth: Path, name: str) -> jostle.Client:
    return jostle.connect(lab.endpoint, credentials=auth / "people" / name)


def test_each_user_has_the_permissions_of_their_role(lab: Daemon, auth: Path) -> None:
    clients = {name: enter(lab, auth, name) for name in PEOPLE}
    swarm = clients["olga"].create("s", {"n": 3, "seed": 1})
    for name, role in PEOPLE.items():
        who = clients[name].whoami()
        assert (who.person, who.role) == (name, role)
        assert clients[name].swarm("s").status().n == 3
    assert clients["olga"].whoami().may("delete")
    assert not clients["vera"].whoami().may("join")

    for name, role in (("vera", "a viewer"), ("cleo", "a controller")):
        began = time.monotonic()
        with pytest.raises(jostle.PermissionDenied) as caught:
            clients[name].swarm("s").pause()
        assert f"you are {name}, {role}, and pause takes an operator" in str(caught.value)
        assert time.monotonic() - began < 5.0
        with pytest.raises(jostle.PermissionDenied, match="create takes an operator"):
            clients[name].create("another", {"n": 3})
    with pytest.raises(jostle.PermissionDenied, match="join takes a controller"):
        clients["vera"].swarm("s").join("vera")
    with pytest.raises(jostle.PermissionDenied, match="annotate takes a controller"):
        clients["vera"].swarm("s").annotate("note")
    clients["cleo"].swarm("s").annotate("note")
    with (
        pytest.raises(jostle.PermissionDenied, match="a controller of yours is called cleo"),
        clients["cleo"].swarm("s").join("arm", select=jostle.count(1)),
    ):
        pass
    with clients["cleo"].swarm("s").join("cleo-arm", select=jostle.count(1)) as controller:
        assert controller.advance(2).step == 2
    assert [entry.client for entry in swarm.journal() if entry.verb == "join"] == [
        f"cleo:{clients['cleo']._session.client}"
    ]
    for client in clients.values():
        client.close()


def test_whoami_lists_the_permissions_of_each_role(lab: Daemon, auth: Path) -> None:
    permitted: dict[str, tuple[list[str], list[str]]] = {
        "vera": ([], []),
        "cleo": (sorted(OF_CONTROLLERS), []),
        "olga": (SWARM_VERBS, NODE_VERBS),
    }
    for name, (verbs, node_verbs) in permitted.items():
        with enter(lab, auth, name) as client:
            who = client.whoami()
        assert (who.person, who.role) == (name, PEOPLE[name])
        assert (sorted(who.verbs), sorted(who.node_verbs)) == (verbs, node_verbs)
        for verb in [*SWARM_VERBS, *NODE_VERBS]:
            assert who.may(verb) == (verb in verbs or verb in node_verbs), verb


def test_the_audit_log_says_who_did_what_to_operators_only(lab: Daemon, auth: Path) -> None:
    with (
        enter(lab, auth, "olga") as olga,
        enter(lab, auth, "cleo") as cleo,
        enter(lab, auth, "vera") as vera,
    ):
        swarm = olga.create("audited", {"n": 3})
        cleo.swarm("audited").annotate("ready")
        swarm.set(pi3=1.1)
        assert [entry.verb for entry in swarm.journal()] == ["annotate", "set"]
        assert [entry.verb for entry in swarm.journal(client="cleo")] == ["annotate"]
        assert [entry.verb for entry in swarm.journal(verb="set", from_step=0)] == ["set"]
        assert swarm.journal(to_step=0, verb="step") == []
        with pytest.raises(jostle.InvalidArgument, match="no verb of a swarm"):
            swarm.journal(verb="sets")
        swarm.delete()
        lines = olga.audit(name="audited")
        assert [(line.user, line.client, line.verb, line.count) for line in lines] == [
            ("olga", olga._session.client, "create", 1),
            ("cleo", cleo._session.client, "annotate", 1),
            ("olga", olga._session.client, "set", 1),
            ("olga", olga._session.client, "delete", 1),
        ]
        assert all(line.outcomes == [jostle.AuditOutcome(outcome="ok", count=1)] for line in lines)
        now = datetime.now(UTC)
        assert all(timedelta(0) < now - line.when < timedelta(minutes=5) for line in lines)
        assert olga.audit(name="audited", verb="delete", user="olga") == lines[3:]
        assert olga.audit(name="audited", limit=2, since=timedelta(minutes=5)) == lines[2:]
        assert olga.audit(name="audited", until=now - timedelta(hours=1)) == []
        for client, role in ((vera, "vera, a viewer"), (cleo, "cleo, a controller")):
            with pytest.raises(jostle.PermissionDenied) as caught:
                client.audit()
            assert f"you are {role}, and audit takes an operator" in str(caught.value)


def test_states_and_events_reach_a_viewer(lab: Daemon, auth: Path) -> None:
    with enter(lab, auth, "vera") as vera, enter(lab, auth, "olga") as olga:
        swarm = olga.create("seen", {"n": 3, "publish_every": 1, "rate": None})
        with vera.swarm("seen").states() as states:
            swarm.step(3)
            assert next(state.step for state in states if state.step > 0) > 0
        swarm.set(pi3=1.1)
        with vera.swarm("seen").events(after=0) as events:
            assert any(event.verb == "set" for event in events_until_set(events))


def events_until_set(events: Iterator[jostle.Event]) -> Iterator[jostle.Event]:
    for event in events:
        yield event
        if event.verb == "set":
            return


def test_a_rejected_client_gets_an_error_soon(lab: Daemon, auth: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "auth"
    subprocess.run([JOSTLED, "--auth-dir", elsewhere, "auth", "init", "olga=operator"], check=True)
    began = time.monotonic()
    with pytest.raises(jostle.PermissionDenied, match="pass your credentials"):
        jostle.connect(lab.endpoint)
    with pytest.raises(jostle.PermissionDenied, match="rejects olga"):
        jostle.connect(lab.endpoint, credentials=elsewhere / "people" / "olga")
    assert time.monotonic() - began < 6.0
    with pytest.raises(jostle.InvalidArgument, match="credentials"):
        jostle.connect(lab.endpoint, credentials=tmp_path)
    with pytest.raises(jostle.InvalidArgument, match="in the clear"):
        jostle.connect("tcp/192.0.2.1:7447", credentials=auth / "people" / "olga")


def test_an_address_that_the_certificate_does_not_name_is_reported_with_the_remedy(
    auth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JOSTLED_AUTH_DIR", str(auth))
    daemon = Daemon(tmp_path, "tls/127.0.0.2:0")
    try:
        began = time.monotonic()
        with pytest.raises(jostle.Unavailable) as caught:
            enter(daemon, auth, "olga")
        assert time.monotonic() - began < 5.0
        text = str(caught.value)
        assert "does not name 127.0.0.2; it names localhost, 127.0.0.1, ::1:" in text
        assert "`jostled auth address --host 127.0.0.2 --auth-dir FOLDER`" in text
        assert caught.value.details["host"] == "127.0.0.2"
        assert caught.value.details["names"] == ["localhost", "127.0.0.1", "::1"]
    finally:
        daemon.stop()


def test_set_points_contain_the_token(lab: Daemon, auth: Path) -> None:
    with enter(lab, auth, "olga") as olga, enter(lab, auth, "cleo") as cleo:
        swarm = olga.create("steered", {"n": 3, "seed": 1})
        samples: list[zenoh.Sample] = []
        with olga._session.zenoh.declare_subscriber("jostle/steered/ctl/*") as seen:
            with cleo.swarm("steered").join(
                "cleo", jostle.ids([0]), mode="free_running", deadline=10.0
            ) as controller:

                def received() -> bool:
                    # The subscription may reach the controller's session after a set-point.
                    controller.put(direction=0.5)
                    samples.extend(filter(None, [seen.try_recv()]))
                    return bool(samples)

                eventually("a set-point", received)
            token = json.loads((auth / "people/cleo/credentials.json").read_text())["token"]
            assert samples[0].attachment is not None
            assert samples[0].attachment.to_string() == token
        swarm.delete()


def test_the_environment_and_asyncio_use_the_credentials(
    lab: Daemon, auth: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JOSTLE_CREDENTIALS", str(auth / "people" / "cleo"))
    with jostle.connect(lab.endpoint) as client:
        assert client.whoami().person == "cleo"

    async def whoami() -> str | None:
        async with aio.connect(lab.endpoint) as client:
            return (await client.whoami()).person

    assert asyncio.run(whoami()) == "cleo"


def test_no_secret_is_in_a_repr(lab: Daemon, auth: Path) -> None:
    from jostle._credentials import read_credentials

    identity = read_credentials(auth / "people" / "olga")
    assert identity is not None
    with enter(lab, auth, "olga") as client:
        shown = f"{identity!r} {client!r} {client._session!r} {client._repr_html_()}"
    assert identity[0].token not in shown
    assert identity[0].password not in shown
    assert identity[0].token not in lab.log.read_text()


def test_any_zenoh_client_connects_with_the_files_of_the_folder(lab: Daemon, auth: Path) -> None:
    folder = auth / "people" / "olga"
    config = zenoh.Config.from_file(str(folder / "zenoh.json5"))
    config.insert_json5("connect/endpoints", json.dumps([lab.endpoint]))
    token = json.loads((folder / "credentials.json").read_text())["token"]
    with zenoh.open(config) as session:
        hellos = [reply.ok for reply in session.get("jostle/@node/*/get/hello")]
        (hello,) = [json.loads(reply.payload.to_bytes()) for reply in hellos if reply is not None]
        key = f"jostle/@node/{hello['node']}/cmd/create"
        request = json.dumps({"name": "bare", "spec": {"n": 3}})
        (refused,) = session.get(key, payload=request)
        assert refused.err is not None
        assert json.loads(refused.err.payload.to_bytes())["code"] == "permission_denied"
        (created,) = session.get(key, payload=request, attachment=token)
        assert created.ok is not None


def test_the_written_settings_are_valid(auth: Path) -> None:
    settings = auth / "jostled.toml"
    line = [str(JOSTLED), "--config", str(settings), "config", "explain", "--json"]
    explained = subprocess.run(line, check=True, capture_output=True, text=True).stdout
    assert str(auth) in explained
    assert "tls/127.0.0.1:7447" in explained
