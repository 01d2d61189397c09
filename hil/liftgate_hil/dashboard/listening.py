"""Address at which a dashboard page is served on this machine, and the token that grants access."""

from __future__ import annotations

import errno
import os
import re
import secrets
import socket

from liftgate_hil.errors import ConfigError

_TOKEN = "LIFTGATE_HIL_TOKEN"
_WAITS = 32_768  # bytes of one connection, some 0.3 s of the stream
_DEAF_MS = 10_000  # ms for a client to take what was sent to it
_GOOD = re.compile(r"[A-Za-z0-9_-]{16,}")


def bound(address: tuple[str, int]) -> socket.socket:
    """Return a new socket that listens at an address (host, port). Raises ConfigError."""
    host, port = address
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        found = socket.create_server((host, port), family=family, dualstack_ipv6=host == "::")
        # Connections inherit these. Without TCP_NODELAY a reply may wait 40 ms for the last one's acknowledgement;
        # with the system's own buffer size (some 3 MB) a slow reader would see a state 20 s old.
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _WAITS)
        # A client that takes nothing, or is gone without a word, is dropped by the system (tcp(7)).
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _DEAF_MS)
        return found
    except (OSError, OverflowError, UnicodeError) as error:
        text = getattr(error, "strerror", None) or str(error)
        text += ", perhaps by another page" if getattr(error, "errno", None) == errno.EADDRINUSE else ""
        raise ConfigError(
            f"`listen` {host}:{port}: {text}; allowed: an address of this machine, a free port (0: any)"
        ) from error


def new_token() -> str:
    """Return a random token, or LIFTGATE_HIL_TOKEN if given. Raises ConfigError if the given one is unfit."""
    given = os.environ.get(_TOKEN)
    if given is None:
        return secrets.token_urlsafe(24)
    if not _GOOD.fullmatch(given):
        raise ConfigError(f"{_TOKEN}: allowed: 16 or more letters, digits, - and _")
    return given


def hold_token() -> None:
    """Store one token for all pages of this process and its children in the environment. Raises ConfigError."""
    os.environ[_TOKEN] = new_token()


def url_of(wire: socket.socket, host: str, token: str) -> str:
    """Return the page's URL with the token; with this machine's name if the server listens at all addresses."""
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
    shown = f"[{shown}]" if ":" in shown else shown
    return f"http://{shown}:{wire.getsockname()[1]}/?token={token}"
