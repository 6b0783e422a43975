"""zenoh 1.10.2: closing a session with many matching subscriptions blocks all queries.

    python zenoh-close.py 500 1000 2000

One session listens and has a queryable; one client declares N subscriptions whose keys all match a
published key, and closes; another client sends a query every 10 ms. Prints, for each N, the longest
time that a query took while the first client's subscriptions were removed.
"""

import json
import sys
import threading
import time

import zenoh


def open_session(mode: str, kind: str, endpoint: str) -> zenoh.Session:
    """A session that uses one endpoint and no discovery."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{kind}/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def longest_query(count: int) -> float:
    """Seconds of the longest query while a session with `count` subscriptions is closed."""
    endpoint = "tcp/127.0.0.1:17448"
    with open_session("router", "listen", endpoint) as server:
        server.declare_queryable("demo/a/get", lambda query: query.reply("demo/a/get", "ok"))
        publisher = server.declare_publisher("demo/a/state")
        leaving = open_session("client", "connect", endpoint)
        for k in range(count):
            # Distinct keys that all match `demo/a/state`, since `$*` matches nothing, too.
            bits = [letter + "$*" * (k >> n & 1) for n, letter in enumerate("demoastate")]
            key = "".join(bits[:4]) + "/" + bits[4] + "/" + "".join(bits[5:])
            key = "$*" * (k >> 10 & 1) + key
            leaving.declare_subscriber(key, lambda _: None)
        publisher.put("1")
        with open_session("client", "connect", endpoint) as client:
            list(client.get("demo/a/get"))
            threading.Thread(target=leaving.close).start()
            longest = 0.0
            for _ in range(100):
                start = time.monotonic()
                list(client.get("demo/a/get", timeout=120))
                longest = max(longest, time.monotonic() - start)
                time.sleep(0.01)
    return longest


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(f"{argument} subscriptions: {longest_query(int(argument)):.3f} s", flush=True)
