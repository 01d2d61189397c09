"""Access control of the dashboard's server: only clients with the token, and only from its own pages.

Any web page can have its reader's browser send requests to a server on the same machine; Host and Origin reveal
these, on HTTP and on WebSockets, which a middleware for HTTP would not check.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Collection
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

# For a page that holds its own styles and script, and loads nothing from elsewhere.
POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
    "img-src data:; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

AUTHORISED = "liftgate_hil.authorised"  # extension of a scope: called where a request has the token


class Guard:
    """ASGI middleware for access control: 403 for other hosts and origins, 401 without the token."""

    def __init__(self, app: ASGIApp, token: str, hosts: Collection[str]) -> None:
        self._app, self._token, self._hosts = app, token.encode(), hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a connection on to the application, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, why = self._refusal(scope)
        if not status:
            scope.get("extensions", {}).get(AUTHORISED, lambda: None)()
            await self._app(scope, receive, send)
            return
        is_page = scope["type"] == "http" and scope["path"] == "/"
        response: Response = PlainTextResponse(why, status) if is_page else JSONResponse({"issues": [why]}, status)
        response.headers["Connection"] = "close"
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(response)
        else:
            await response(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, str]:
        """Return the HTTP status and the reason of a refusal; (0, ""): the connection is allowed."""
        headers = Headers(scope=scope)
        host = _with_port(headers.get("host", "").lower())
        own = [*self._hosts, _address_in(scope)]
        if len(headers.getlist("host")) != 1 or host not in own:
            return 403, f"host {host[:200]!r}; allowed: {', '.join(own)}"
        origin = headers.get("origin", f"http://{host}")
        scheme, _, sender = origin.lower().partition("//")
        if scheme != "http:" or _with_port(sender) != host:
            return 403, f"origin {origin[:200]!r}; allowed: http://{host}"
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        bearer = headers.get("authorization", "")
        if bearer.startswith("Bearer "):
            given = bearer.removeprefix("Bearer ")
        if not secrets.compare_digest(given.encode(), self._token):
            return 401, "missing or wrong token: open the address as the server has printed it, with its token"
        return 0, ""


def hosts_of(address: str, port: int) -> list[str]:
    """Return the allowed Host headers HOST:PORT of a server that listens at an address: that, and its names.

    The address that a connection came to is allowed besides.
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


def _address_in(scope: Scope) -> str:
    """Return the server's address HOST:PORT at which a connection arrived."""
    host, port = scope.get("server") or ("", 0)
    host = host.removeprefix("::ffff:")  # an IPv4 address on a socket for both versions
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _with_port(host: str) -> str:
    """Return a Host header with its port; a header without one gets `:80`, which browsers omit."""
    return host if host.rpartition(":")[2].isdecimal() else f"{host}:80"
