"""Claims: liveliness tokens that show when several daemons hold one name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from ._errors import Contested

_STANDINGS = ("waiting", "serving", "changed")


class Claim(NamedTuple):
    """A daemon's claim to a name, and whether the daemon serves that name.

    `instance` is one run of the daemon.
    """

    instance: str
    node: str
    standing: str

    @property
    def serves(self) -> bool:
        """Whether the daemon executes commands on the name."""
        return self.standing != "waiting"


def read_claims(keys: Iterable[str]) -> list[Claim]:
    """The claims in the keys of tokens.

    Such as `jostle/demo/claim/lab/0191-ab/serving` of a swarm, and
    `jostle/@node/lab/claim/0191-ab/serving` of a daemon.
    """
    claims = []
    for key in keys:
        before, node, instance, standing = key.split("/")[-4:]
        if node == "claim":
            node = before
        if standing in _STANDINGS:
            claims.append(Claim(instance, node, standing))
    return sorted(claims)


def contested_error(swarm: str, claims: Iterable[Claim]) -> Contested | None:
    """The error if several daemons serve the name; a daemon whose standing changes counts once."""
    serving = {(it.instance, it.node): it for it in claims if it.serves}
    if len(serving) < 2:
        return None
    names = " and ".join(f'"{it.node}"' for it in serving.values())
    return _error(
        swarm,
        serving.values(),
        f"the daemons {names} each have a swarm {swarm!r}, so none executes anything on it: stop "
        f"all but one, or delete it on all but one with `jostle delete {swarm} --node NAME` "
        "(Client.discard)",
    )


def unserved_error(swarm: str, claims: Iterable[Claim]) -> Contested | None:
    """The error if a daemon holds the name and does not serve it."""
    claims = list(claims)
    waiting = next((it for it in claims if not it.serves), None)
    if waiting is None:
        return None
    serving = next((it for it in claims if it.serves), None)
    why = "because it waits for the claims of other daemons"
    if serving is not None:
        why = f'because daemon "{serving.node}" does'
    return _error(
        swarm,
        [waiting] if serving is None else [waiting, serving],
        f'daemon "{waiting.node}" does not serve its swarm {swarm!r}, {why}: connect to the other '
        f"daemon, or delete one of the two with `jostle delete {swarm} --node NAME` "
        "(Client.discard)",
    )


def _error(swarm: str, claims: Iterable[Claim], message: str) -> Contested:
    claims = list(claims)
    details = {
        "swarm": swarm,
        "nodes": [it.node for it in claims],
        "instances": [it.instance for it in claims],
    }
    return Contested(message, details=details)
