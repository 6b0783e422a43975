"""The program steer.py without the package jostle: with eclipse-zenoh, cbor2 and json.

    jostled demo &
    python bare_zenoh.py demo

Reading is a subscription to `jostle/NAME/state`: CBOR whose columns are typed arrays (RFC 8746),
byte strings of little-endian doubles. Steering is a query on `jostle/NAME/cmd/VERB`: JSON.
"""

import argparse
import array
import json
import math
import os
from typing import Any

import cbor2
import zenoh


def open_session(endpoint: str) -> zenoh.Session:
    """Connects to the daemon at `endpoint` and to no other."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def ask(session: zenoh.Session, key: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
    """Sends a query and returns the reply: swarm, epoch, step, time, phase, seq and `result`."""
    payload = None if args is None else json.dumps(args)
    for reply in session.get(key, payload=payload, encoding="application/json"):
        if reply.ok:
            return dict(json.loads(reply.ok.payload.to_bytes()))
        raise SystemExit(f"{key}: {reply.err.payload.to_string() if reply.err else 'no reply'}")
    raise SystemExit(f"{key}: no reply; is the daemon running, and is there a swarm of that name?")


def centre(state: dict[str, Any]) -> tuple[float, float]:
    """The mean absolute position; positions are 1024 · origin + (x, y)."""
    columns = [array.array("d", state[name].value) for name in ("x", "y")]
    x, y = (1024 * k + sum(c) / len(c) for k, c in zip(state["origin"], columns, strict=True))
    return x, y


def follow(states: Any, direction: float, time_units: float) -> None:
    """Prints the drift along `direction`, radians, for `time_units`."""
    begin = last = cbor2.loads(states.recv().payload.to_bytes())
    while last["time"] < begin["time"] + time_units:
        before = last
        while last["time"] < before["time"] + time_units / 6:
            last = cbor2.loads(states.recv().payload.to_bytes())
        (x0, y0), (x1, y1) = centre(before), centre(last)
        along = (x1 - x0) * math.cos(direction) + (y1 - y0) * math.sin(direction)
        drift = along / (last["time"] - before["time"])
        print(f"{last['time']:9.1f}  {last['order']['order']:5.2f}  {drift:+6.2f}", flush=True)


def main() -> None:
    """Informs a tenth of the swarm of two directions in turn, and uninforms it."""
    parser = argparse.ArgumentParser(description="Steers a running swarm by a tenth of it.")
    parser.add_argument("name", help="name of a running swarm, such as demo")
    parser.add_argument(
        "--endpoint", default=os.environ.get("JOSTLE_ENDPOINT", "tcp/127.0.0.1:7447")
    )
    parser.add_argument("--for", dest="time_units", type=float, default=60.0, help="time per leg")
    args = parser.parse_args()
    swarm = f"jostle/{args.name}"

    with open_session(args.endpoint) as session:
        # The channel keeps only the newest state.
        states = session.declare_subscriber(f"{swarm}/state", zenoh.handlers.RingChannel(1))
        status = ask(session, f"{swarm}/get/status")
        if status["phase"] != "running":
            raise SystemExit(f"{args.name} is {status['phase']}: run it first")
        select: dict[str, Any] = {"count": max(1, round(status["result"]["n"] / 10))}
        for direction in (0.0, math.pi / 2):
            inform = {"select": select, "direction": direction, "weight": 1.0}
            informed = ask(session, f"{swarm}/cmd/inform", inform)["result"]["ids"]
            select = {"ids": informed}
            print(f"{informed} towards {math.degrees(direction):.0f}°")
            print("     time  order   drift")
            follow(states, direction, args.time_units)
        ask(session, f"{swarm}/cmd/uninform", {"select": select})


if __name__ == "__main__":
    main()
