"""Which messages belong on which key."""

from __future__ import annotations

import cbor2
import msgspec
import zenoh


class _Head(msgspec.Struct):
    swarm: str
    # Of an order.
    frame: int | None = None
    # Of an event.
    number: int | None = None


# The first field of a state in CBOR, after the byte that begins the map.
_FIRST_FIELD = cbor2.dumps("swarm")


def belongs(sample: zenoh.Sample, swarm: str, noun: str) -> bool:
    """Whether a message is of this swarm and of this noun: `state`, `order` or `event`.

    After a connection was restored, zenoh 1.10 sometimes delivers a message under the key of
    another subscription. One that cannot be decoded belongs: its reader raises the error.
    """
    payload = sample.payload.to_bytes()
    is_cbor = sample.encoding == zenoh.Encoding.APPLICATION_CBOR
    if is_cbor != (noun == "state"):
        return False
    if is_cbor:
        is_named = payload.startswith(_FIRST_FIELD, 1)
        return not is_named or payload.startswith(cbor2.dumps(swarm), 1 + len(_FIRST_FIELD))
    try:
        head = msgspec.json.decode(payload, type=_Head)
    except msgspec.DecodeError:
        return True
    number = head.frame if noun == "order" else head.number
    return head.swarm == swarm and number is not None
