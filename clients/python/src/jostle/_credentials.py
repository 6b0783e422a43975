"""Credentials of a person, and the role that a daemon assigns to a client."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec

from ._errors import invalid
from ._wire import OF_CONTROLLERS, Role, WhoAmI

_FILE = "credentials.json"


class Credentials(msgspec.Struct, frozen=True):
    """The content of `credentials.json`. Its `repr` has no secrets."""

    person: str
    role: Role
    endpoint: str
    token: str
    password: str
    page: str | None = None

    def __repr__(self) -> str:
        return f"Credentials({self.person!r}, {self.role!r})"


def read_credentials(folder: str | os.PathLike[str] | None) -> tuple[Credentials, Path] | None:
    """Reads a folder of `jostled auth`; None is the one in `JOSTLE_CREDENTIALS`, if any.

    Raises:
        InvalidArgument: It contains no credentials.
    """
    folder = os.environ.get("JOSTLE_CREDENTIALS") or None if folder is None else folder
    if folder is None:
        return None
    path = Path(folder) / _FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=Credentials), Path(folder)
    except (OSError, msgspec.DecodeError) as error:
        raise invalid(
            "credentials",
            f"{path}: {error}: give a folder of credentials that `jostled auth` created",
        ) from None


def zenoh_auth(credentials: Credentials, folder: Path) -> dict[str, Any]:
    """The settings of zenoh for authentication."""
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


# The queries that require an operator, and the verbs that they are rejected for.
_QUERIES_OF_OPERATORS = {"recording": "record", "audit": "audit"}


def restricted_verb(selector: str) -> str | None:
    """The verb for which a role may be rejected; None for a query of every role."""
    key = selector.partition("?")[0]
    _, is_command, verb = key.partition("/cmd/")
    return verb if is_command else _QUERIES_OF_OPERATORS.get(key.partition("/get/")[2])


def denial_reason(who: WhoAmI, verb: str) -> str:
    """The message for a verb that requires another role, with the daemon's words."""
    takes = "a controller" if verb in OF_CONTROLLERS else "an operator"
    if who.person is None or who.role is None:
        identity = "the request has no token of a known person"
    else:
        article = "an" if who.role == "operator" else "a"
        identity = f"you are {who.person}, {article} {who.role}"
    return f"{identity}, and {verb} takes {takes}: ask whoever runs the daemon"
