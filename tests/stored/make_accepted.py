#!/usr/bin/env python3
"""Writes what a build of jostle accepted and later ones reject: a fixture for later builds.

    target/venv/bin/python tests/stored/make_accepted.py TARGET/release tests/stored/accepted

The first argument is the folder with the binary `jostled` of that build. The second one is created;
it must not exist. The daemon is killed, not stopped, while both experiments run.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from make import open_session

EXPERIMENT = """\
name = "{name}"
seed = 3
replicates = {replicates}
duration = {duration}
[spec]
n = 4
{spec}
[[grid]]
{grid}
[[at]]
time = 1
{command}
"""

WEIGHTLESS = {
    "spec": "pi2 = 0",
    "grid": "pi1 = [2, 4]",
    "command": "inform = { select = { count = 2 }, direction = 0.5 }",
}
# The second point ends by a fault: one individual is left, of which two are to be removed.
FAULT = {
    "spec": "",
    "grid": "fault = [1, 3]",
    "command": """remove = { select = { count = "$fault" } }
[[at]]
time = 1.5
remove = { select = { count = 2 } }""",
}


def main() -> None:
    """Writes every part of the fixture."""
    jostled, out = Path(sys.argv[1]).resolve() / "jostled", Path(sys.argv[2]).resolve()
    out.mkdir(parents=True)
    small = EXPERIMENT.format(name="small", replicates=1, duration=2, **FAULT)
    (out / "small.toml").write_text(small)
    run = [jostled, "run", out / "small.toml", "-o", out / "small", "--threads", "1"]
    subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
    serve = [jostled, "serve", "--listen", "tcp/127.0.0.1:0", "--http", "", "--node", "test"]
    serve += ["--experiment-threads", "1", "--data-dir", out / "data"]
    daemon = subprocess.Popen(serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert daemon.stdout
        endpoint = daemon.stdout.readline().removeprefix("listening on ").strip()
        with open_session(endpoint) as session:
            expected = fill(session)
            daemon.kill()
            daemon.wait()
    finally:
        daemon.kill()
        daemon.wait()
    (out / "replies.json").write_text(json.dumps(expected, indent=1, sort_keys=True) + "\n")
    for name in ("page-token", "jostle.sqlite-shm", "reserve", "lock"):
        (out / "data" / name).unlink(missing_ok=True)


def fill(session: Any) -> dict[str, Any]:
    """Runs the scenario; returns what the daemon replied."""

    def send(key: str, request: dict[str, Any] | None = None) -> Any:
        payload = None if request is None else json.dumps(request)
        for reply in session.get(f"jostle/{key}", payload=payload, encoding="application/json"):
            if reply.ok:
                return json.loads(reply.ok.payload.to_bytes())
            raise SystemExit(f"{key}: {reply.err and reply.err.payload.to_string()}")
        raise SystemExit(f"{key}: no reply")

    # Changes that inform with a weight of 0: at once, of an informed individual, for a step that is
    # reached, in a batch, at a condition, and for a step that is not.
    send("@node/test/cmd/create", {"name": "school", "spec": {"n": 6, "seed": 5, "pi2": 0.0}})
    send("school/cmd/inform", {"select": {"ids": [1]}, "direction": 0.5, "weight": 1.0})
    send("school/cmd/step", {"steps": 20})
    send("school/cmd/inform", {"select": {"ids": [1, 3]}, "direction": 1.0, "for_time": 1e9})
    inject = {"count": 1, "direction": 2.0}
    send("school/cmd/inject", {"at_step": 30, "args": inject})
    inform = {"verb": "inform", "args": {"select": {"count": 2}, "direction": 0.2}}
    send("school/cmd/when", {"condition": "order > -1", "commands": [inform], "from_step": 35})
    send("school/cmd/step", {"steps": 20})
    send("school/cmd/batch", {"commands": [{"verb": "set", "args": {"pi3": 2.0}}, inform]})
    later = {"at_step": 100, "args": {"select": {"ids": [2]}, "direction": 0.2}}
    send("school/cmd/inform", later)
    send("school/cmd/step", {"steps": 20})
    school = {
        "status": send("school/get/status"),
        "journal": send("school/get/journal?limit=1000")["result"]["entries"],
    }
    for name, parts in (("weightless", WEIGHTLESS), ("faults", FAULT)):
        text = EXPERIMENT.format(name=name, replicates=2, duration=200, **parts)
        send("@node/test/cmd/experiment", {"submit": {"toml": text}})
    # The store persists a step a few milliseconds after its reply.
    time.sleep(1)
    pages = {}
    for name in ("weightless", "faults"):
        while (page := send(f"@node/test/experiment/{name}/results"))["finished"] < 1:
            time.sleep(0.02)
        pages[name] = page
        pause = {"pause": {"name": name}}
        send("@node/test/cmd/experiment", pause)
    return {"school": school, "experiments": pages}


if __name__ == "__main__":
    main()
