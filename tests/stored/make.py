#!/usr/bin/env python3
"""Writes the files that a build of jostle stores, with its replies: fixtures for later builds.

    target/venv/bin/python tests/stored/make.py TARGET/release tests/stored/COMMIT

The first argument is the folder with the binaries `jostled` and `jostle` of that commit. The second
one is created; it must not exist. The daemon is killed, not stopped, while an experiment runs, a
controller is a member and a recording is active, so that the data folder is that of a crash.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import zenoh

EXPERIMENT = """\
name = "half"
seed = 3
replicates = 2
duration = 2000
[[grid]]
n = [4, 12, 60]
[measure]
order_every = 20000
"""

RESULTS = """\
name = "results"
seed = 3
replicates = 2
duration = 20
[[grid]]
pi1 = [1, 4]
n = [3, 8]
informed = [0, 1]
[measure]
order_every = 100
"""


def main() -> None:
    """Writes every part of the fixture."""
    binaries, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    out.mkdir(parents=True)
    (out / "results.toml").write_text(RESULTS)
    run = [binaries / "jostled", "run", out / "results.toml", "-o", out / "results"]
    subprocess.run([*run, "--threads", "1"], check=True, stdout=subprocess.DEVNULL)

    serve = [binaries / "jostled", "serve", "--listen", "tcp/127.0.0.1:0", "--http", ""]
    serve += ["--node", "test", "--experiment-threads", "1", "--data-dir", out / "data"]
    # A part of a recording ends after half a second, not after a minute.
    environment = {**os.environ, "FAILPOINTS": "recording-part=return(500)"}
    daemon = subprocess.Popen(
        serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    )
    try:
        assert daemon.stdout
        endpoint = daemon.stdout.readline().removeprefix("listening on ").strip()
        with open_session(endpoint) as session:
            expected = fill(session, [binaries / "jostle", "-e", endpoint], out)
            # `leave` would be a command, so the token is kept until the daemon is killed.
            daemon.kill()
            daemon.wait()
    finally:
        daemon.kill()
        daemon.wait()
    (out / "expected.json").write_text(json.dumps(expected, indent=1, sort_keys=True) + "\n")
    # Secrets, caches and locks.
    for name in ("page-token", "jostle.sqlite-shm", "reserve", "lock"):
        (out / "data" / name).unlink(missing_ok=True)
    shutil.rmtree(out / "data" / "replays", ignore_errors=True)


def open_session(endpoint: str) -> zenoh.Session:
    """Connects to the daemon at `endpoint` only."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def fill(session: zenoh.Session, jostle: list[Any], out: Path) -> dict[str, Any]:
    """Runs the scenario; returns what the daemon replied."""
    requests: list[dict[str, Any]] = []

    def send(key: str, request: dict[str, Any] | None = None) -> Any:
        payload = None if request is None else json.dumps(request)
        replies = session.get(f"jostle/{key}", payload=payload, encoding="application/json")
        for reply in replies:
            if reply.ok:
                return json.loads(reply.ok.payload.to_bytes())
            raise SystemExit(f"{key}: {reply.err and reply.err.payload.to_string()}")
        raise SystemExit(f"{key}: no reply")

    def command(key: str, args: dict[str, Any], **envelope: Any) -> Any:
        request = {"client": "fixture", "request_id": f"r{len(requests)}", "args": args, **envelope}
        reply = send(key, request)
        requests.append({"key": f"jostle/{key}", "request": request, "reply": reply})
        return reply

    node = "@node/test"
    # Every kind of change, a scheduled command, and a fork.
    command(f"{node}/cmd/create", {"name": "school", "spec": {"n": 12, "seed": 5}})
    command("school/cmd/step", {"steps": 300})
    command("school/cmd/inform", {"select": {"count": 3}, "direction": 0.5})
    command("school/cmd/set", {"pi1": 3.0, "make_room": True})
    command("school/cmd/inject", {"count": 2})
    command("school/cmd/remove", {"select": {"ids": [1]}})
    command("school/cmd/uninform", {"select": {"count": 1}})
    command("school/cmd/step", {"steps": 300})
    batch = [
        {"verb": "set", "args": {"pi3": 2.0}},
        {"verb": "inform", "args": {"select": {"fraction": 0.2}, "direction": -1.0}},
    ]
    command("school/cmd/batch", {"commands": batch})
    command("school/cmd/inform", {"select": {"count": 1}, "direction": 2.0}, at_step=2000)
    command("school/cmd/fork", {"name": "other"})
    command("school/cmd/step", {"steps": 400})
    command("other/cmd/step", {"steps": 100})
    command("other/cmd/reset", {"seed": 9})
    command("other/cmd/step", {"steps": 50})

    # A controller that is a member when the daemon is killed.
    command(f"{node}/cmd/create", {"name": "led", "spec": {"n": 6, "seed": 2}})
    token = session.liveliness().declare_token("jostle/led/ctl/ada/alive")
    command("led/cmd/join", {"controller": "ada", "select": {"ids": [0, 1]}})
    for k in range(5):
        points = {"ids": [0, 1], "direction": [0.3 * k, -0.2 * k], "weight": [2.0, 0.5]}
        advance = {"controller": "ada", "steps": 10, "set": points}
        command("led/cmd/advance", advance, expect_step=10 * k)

    # One that is protected and has a condition, and one that has faulted.
    command(f"{node}/cmd/create", {"name": "guarded", "spec": {"n": 5, "seed": 3}})
    command("guarded/cmd/protect", {"on": True})
    command("guarded/cmd/when", {"condition": "order > 0.999 for 5000", "event": "aligned"})
    command("guarded/cmd/step", {"steps": 120})
    longest = {"n": 60, "pi4": 1e6, "dt": 0.2497, "seed": 2}
    command(f"{node}/cmd/create", {"name": "broken", "spec": longest})
    command("broken/cmd/run", {})
    while send("broken/get/status")["phase"] != "faulted":
        time.sleep(0.05)

    # A file that a client writes.
    run([*jostle, "snapshot", "school", "-o", out / "school.snapshot"])
    restore = [*jostle, "restore", out / "school.snapshot", "restored"]
    run(restore)
    future = send("restored/cmd/step", {"steps": 1200})
    future_hash = send("restored/get/status")["result"]["state_hash"]
    send("restored/cmd/delete", {})

    # Recordings of the daemon, and one by a client.
    command(f"{node}/cmd/create", {"name": "filmed", "spec": {"n": 5, "seed": 7}})
    for name in ("film", "table", "going"):
        begin = {"swarm": "filmed", "recording": name, "every": 20}
        command(f"{node}/cmd/record", {"begin": begin})
    client = subprocess.Popen(
        [*jostle, "record", "filmed", "-o", out / "filmed.mcap", "--steps", "800"],
        stdout=subprocess.DEVNULL,
    )
    time.sleep(2)
    send("filmed/cmd/run", {"until_step": 1000, "rate": 20.0})
    assert client.wait(60) == 0
    send("filmed/get/wait?step=1000;timeout_secs=25")
    # A running swarm is recovered at its last command, which is this one.
    command("filmed/cmd/pause", {})
    time.sleep(0.5)
    for name in ("film", "table"):
        command(f"{node}/cmd/record", {"stop": {"recording": name}})

    swarms = {}
    for name in ("school", "other", "led", "guarded", "broken", "filmed"):
        verified = send(f"{name}/get/verify")
        assert verified["result"]["differs_at"] is None, verified
        swarms[name] = {
            "status": send(f"{name}/get/status"),
            "spec": send(f"{name}/get/spec")["result"],
            "journal": send(f"{name}/get/journal?limit=1000")["result"]["entries"],
            "controllers": send(f"{name}/get/controllers")["result"],
        }
    recordings = send(f"{node}/get/recordings")["result"]
    # The store persists a step a few milliseconds after its reply.
    time.sleep(1)

    # An experiment that is half finished.
    command(f"{node}/cmd/experiment", {"submit": {"toml": EXPERIMENT}})
    while send(f"{node}/experiment/half/results")["finished"] < 3:
        time.sleep(0.05)
    del token
    return {
        "requests": requests,
        "swarms": swarms,
        "recordings": recordings,
        "experiment": send(f"{node}/experiment/half/results"),
        "snapshot": {"step": future["step"], "steps": 1200, "state_hash": future_hash},
    }


def run(command: list[Any]) -> None:
    """Runs a command line; its output is not needed."""
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
