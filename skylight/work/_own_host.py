"""By which names a server of this machine goes: what tells its own pages from rebound names.

A page of another site can send requests to 127.0.0.1, by DNS rebinding even from a name that it
chose for that address; its browser puts that name into the Host header.
"""

import ipaddress
import socket
from urllib.parse import urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "::1")


def is_own(host: str, bound: str) -> bool:
    """Whether a Host header names this server, which was bound to the host ``bound``.

    By any address where it listens on all of them: what rebinding needs is a name.
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name in (*LOOPBACK, bound.lower()):
        return True
    if bound not in ("0.0.0.0", "::"):
        return False
    return name == socket.gethostname().lower() or _is_address(name)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
