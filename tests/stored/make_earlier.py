#!/usr/bin/env python3
"""Writes a snapshot as version 1 of the model would have written it: a fixture for clients.

    target/venv/bin/python tests/stored/make_earlier.py TARGET/release tests/stored/earlier.snapshot

The first argument is the folder with the binaries `jostled` and `jostle`. No program of version 1
can be executed: the version, the hash of the state and the digest of a snapshot of these binaries
are replaced. `tests/daemon/models.rs` alters whole data folders in the same way.
"""

import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cbor2
from blake3 import blake3

EARLIER = 1


def main() -> None:
    """Writes the fixture."""
    binaries, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder:
        serve: list[str | Path] = [
            binaries / "jostled",
            "serve",
            "--listen",
            "tcp/127.0.0.1:0",
            "--http",
            "",
        ]
        daemon = subprocess.Popen(
            [*serve, "--data-dir", folder], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        try:
            assert daemon.stdout is not None
            endpoint = next(it for it in daemon.stdout if b"listening on" in it).split()[-1]
            for arguments in (
                ["create", "school", "-n", "12", "--seed", "3"],
                ["step", "school", "60"],
                ["snapshot", "school", "-o", f"{folder}/school.snapshot"],
            ):
                jostle: list[str | Path] = [binaries / "jostle", "-e", endpoint.decode()]
                subprocess.run([*jostle, *arguments], check=True, stdout=subprocess.DEVNULL)
        finally:
            daemon.kill()
            daemon.wait()
        data = Path(folder, "school.snapshot").read_bytes()
    out.write_bytes(altered(data))


def altered(data: bytes) -> bytes:
    """The snapshot with the version `EARLIER`."""
    snapshot = cbor2.loads(data)
    ours = snapshot["model_version"]
    assert state_hash(snapshot, ours) == snapshot["state_hash"]
    hash_ = state_hash(snapshot, EARLIER)
    # Numbers below 24 are one byte.
    for old, new in (
        (b"model_version" + bytes([ours]), b"model_version" + bytes([EARLIER])),
        (snapshot["state_hash"].encode(), hash_.encode()),
    ):
        assert data.count(old) == 1
        data = data.replace(old, new)
    # The digest is over the map without its last entry.
    last = b"fdigestx\x40"
    unsealed = data[: data.rindex(last)]
    assert unsealed[0] == 0xB8
    digest = blake3(bytes([0xB8, unsealed[1] - 1]) + unsealed[2:]).hexdigest()
    return unsealed + last + digest.encode()


def state_hash(snapshot: dict[str, Any], model_version: int) -> str:
    """The hash of the state, as `State::hash_under` defines it, without noise and commands."""
    assert snapshot["spec"]["attraction"] == {"kind": "all"}
    assert not snapshot["drives"]
    assert not snapshot["lapses"]
    of = snapshot["parameters"]
    hashed = struct.pack("<I", model_version)
    hashed += struct.pack(
        "<5d", *(of[it] for it in ("pi1", "pi2", "pi3", "pi4")), snapshot["spec"]["dt"]
    )
    hashed += bytes([0, 0])
    hashed += struct.pack("<QQ", snapshot["spec"]["seed"], snapshot["step"])
    hashed += struct.pack("<qqI", *snapshot["origin"], snapshot["next_id"])
    for name in ("id", "x", "y", "alpha", "weight", "direction"):
        hashed += column(snapshot[name].value, 4 if name == "id" else 8)
    n = len(snapshot["id"].value) // 4
    hashed += struct.pack("<Q", n) + bytes(n)
    memory = snapshot["memory"]
    codes = memory["code"].value[::4]
    hashed += column(memory["first"].value, 4) + column(memory["second"].value, 4)
    hashed += column(codes, 1) + column(memory["multiplier"].value, 8)
    hashed += column(memory["order"].value, 4)
    hashed += struct.pack("<I", memory["order_age"])
    return blake3(hashed).hexdigest()


def column(data: bytes, width: int) -> bytes:
    """The number of entries, and the entries."""
    return struct.pack("<Q", len(data) // width) + data


main()
