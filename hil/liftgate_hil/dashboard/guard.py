"""Who may talk to the server: those with the token, from pages of its own alone.

A web page of anybody's can have its reader's browser ask a server on the same machine; Host and Origin tell those
apart, on HTTP and on WebSockets, to which a middleware for HTTP would not look.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Collection
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

# Of a page that holds its own styles and script, and asks nobody else.
POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Guard:
    """An ASGI application before another one: 403 for what is not its own, 401 without the token."""

    def __init__(self, app: ASGIApp, token: str, hosts: Collection[str]) -> None:
        self._app, self._token, self._hosts = app, token.encode(), hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, why = self._refusal(scope)
        if not status:
            await self._app(scope, receive, send)
            return
        response = JSONResponse({"issues": [why]}, status)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(response)
        else:
            await response(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, str]:
        """The status and why; 0: it may."""
        headers = Headers(scope=scope)
        host = _with_port(headers.get("host", "").lower())
        own = [*self._hosts, _address_in(scope)]
        if len(headers.getlist("host")) != 1 or host not in own:
            return 403, f"host {host[:200]!r}; allowed: {', '.join(own)}"
        origin = headers.get("origin")
        if origin is not None and not _is_from(origin.lower(), host):
            return 403, f"origin {origin[:200]!r}; allowed: http://{host}"
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        bearer = headers.get("authorization", "")
        if bearer.startswith("Bearer "):
            given = bearer.removeprefix("Bearer ")
        if not secrets.compare_digest(given.encode(), self._token):
            return 401, "no token, or another one; allowed: that of the address that was printed"
        return 0, ""


def hosts_of(address: str, port: int) -> list[str]:
    """What a Host may say for a server that listens at an address, beside the address that a connection came to:
    that, and this machine's names.
    """
    found = [f"[{address}]" if ":" in address else address]
    try:
        is_here = ipaddress.ip_address(address).is_loopback
    except ValueError:
        is_here = address == "localhost"
    if is_here:
        found += ["localhost", "127.0.0.1", "[::1]"]
    else:
        found += ["localhost", socket.gethostname(), socket.getfqdn()]
    return list(dict.fromkeys(f"{each.lower()}:{port}" for each in found))


def _is_from(origin: str, host: str) -> bool:
    return origin.startswith("http://") and _with_port(origin.removeprefix("http://")) == host


def _address_in(scope: Scope) -> str:
    """The address that a connection came to."""
    host, port = scope.get("server") or ("", 0)
    host = host.removeprefix("::ffff:")  # of IPv4 on a socket for both
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _with_port(host: str) -> str:
    """Browsers leave out that of HTTP."""
    return host if host.rpartition(":")[2].isdecimal() else f"{host}:80"
