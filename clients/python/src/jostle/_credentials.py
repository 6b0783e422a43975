"""Who somebody is to a daemon, and what proves it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import msgspec

from ._errors import InvalidArgument
from ._show import Shown

Role = Literal["viewer", "controller", "operator"]
"""What a person may do: watch; steer as a controller too; everything."""

_FILE = "credentials.json"


class WhoAmI(Shown, frozen=True, kw_only=True):
    """Who a daemon takes this client for.

    Attributes:
        node: The daemon's name.
        person: Who; None where the daemon knows no people, and for a token that is nobody's.
        role: What they are; None for a token that is nobody's.
        verbs: What they may have swarms execute.
        node_verbs: What they may have the daemon execute.
    """

    node: str
    person: str | None
    role: Role | None
    verbs: list[str]
    node_verbs: list[str]

    def may(self, verb: str) -> bool:
        """Whether `verb` is permitted, such as `"pause"` or `"create"`."""
        return verb in self.verbs or verb in self.node_verbs


class Credentials(msgspec.Struct, frozen=True):
    """What `credentials.json` says, and the folder it is in. The secrets are in no `repr`."""

    person: str
    role: Role
    endpoint: str
    token: str
    password: str
    page: str | None = None

    def __repr__(self) -> str:
        return f"Credentials({self.person!r}, {self.role!r})"


def read_credentials(folder: str | os.PathLike[str] | None) -> tuple[Credentials, Path] | None:
    """Reads a folder that `jostled auth` made; None is that of `JOSTLE_CREDENTIALS`, if any.

    Raises:
        InvalidArgument: It is none.
    """
    folder = os.environ.get("JOSTLE_CREDENTIALS") or None if folder is None else folder
    if folder is None:
        return None
    path = Path(folder) / _FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=Credentials), Path(folder)
    except (OSError, msgspec.DecodeError) as error:
        raise InvalidArgument(
            f"{path}: {error}: credentials are a folder that `jostled auth` made",
            details={"field": "credentials"},
        ) from None


def proofs(credentials: Credentials, folder: Path) -> dict[str, Any]:
    """What zenoh needs to prove who it is."""
    return {
        "transport/auth/usrpwd": {"user": credentials.person, "password": credentials.password},
        "transport/link/tls": {
            "root_ca_certificate": str(folder / "ca.pem"),
            "connect_certificate": str(folder / "certificate.pem"),
            "connect_private_key": str(folder / "key.pem"),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        },
    }


# The verbs that a controller may send.
_OF_CONTROLLERS = ("join", "advance", "leave", "annotate")


def refusal(who: WhoAmI, verb: str) -> str:
    """The words for a verb that takes another role, as the daemon has them."""
    takes = "a controller" if verb in _OF_CONTROLLERS else "an operator"
    if who.person is None or who.role is None:
        told = "no token came along that belongs to a person here"
    else:
        article = "an" if who.role == "operator" else "a"
        told = f"you are {who.person}, {article} {who.role}"
    return f"{told}, and {verb} takes {takes}: ask whoever runs the daemon"
