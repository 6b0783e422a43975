"""Why a TLS connection failed, when the daemon's certificate is for other names."""

from __future__ import annotations

import ipaddress
import re
import socket
import ssl
from pathlib import Path

from ._errors import Unavailable

_TIMEOUT_SECS = 1.0

# OpenSSL's X509_V_ERR_HOSTNAME_MISMATCH and X509_V_ERR_IP_ADDRESS_MISMATCH.
_MISMATCHES = (62, 64)

# Every certificate of a daemon has these.
_OWN_NAMES = ("localhost", "127.0.0.1", "::1")


def split_endpoint(endpoint: str) -> tuple[str, str, str]:
    """The protocol, host and port of an endpoint such as `tls/[::1]:7447`."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = re.split("[#?]", address, maxsplit=1)[0].rpartition(":")
    return protocol, host.strip("[]"), port


def certificate_mismatch(endpoint: str, folder: Path) -> Unavailable | None:
    """The error if the certificate at `endpoint` is for other names; None if that is not why.

    `folder` is the one of the credentials, whose `ca.pem` is trusted.
    """
    protocol, host, port = split_endpoint(endpoint)
    if protocol != "tls" or not port.isdecimal():
        return None
    try:
        context = ssl.create_default_context(cafile=folder / "ca.pem")
        try:
            _certificate(context, host, int(port))
        except ssl.SSLCertVerificationError as error:
            if error.verify_code not in _MISMATCHES:
                return None
        else:
            return None
        context.check_hostname = False
        names = _names(_certificate(context, host, int(port)))
    except (OSError, ValueError):
        return None
    others = [name for name in names if name not in _OWN_NAMES]
    hosts = "".join(f" --host {name}" for name in [*others, host])
    return Unavailable(
        f"the certificate of the daemon at {endpoint} does not name {host}; it names "
        f"{', '.join(names)}: connect by one of these, or run `jostled auth address{hosts} "
        "--auth-dir FOLDER` on the daemon's machine and restart the daemon",
        details={"endpoint": endpoint, "host": host, "names": names},
    )


def _certificate(context: ssl.SSLContext, host: str, port: int) -> object:
    """Connects and returns the certificate of the server after it is verified."""
    with (
        socket.create_connection((host, port), timeout=_TIMEOUT_SECS) as plain,
        context.wrap_socket(plain, server_hostname=host) as stream,
    ):
        return stream.getpeercert()


def _names(certificate: object) -> list[str]:
    """The names and addresses of a certificate as `ssl` has it."""
    if not isinstance(certificate, dict):
        return []
    names = []
    for kind, name in certificate.get("subjectAltName", ()):
        # OpenSSL writes ::1 as 0:0:0:0:0:0:0:1, in capitals.
        is_address = kind == "IP Address"
        names.append(str(ipaddress.ip_address(name.strip())) if is_address else name)
    return names
