"""Connections to the page's server: those that stand still, or are too many, are dropped.

Anybody on this machine can connect without the token: such connections must not keep those with it out.
"""

from __future__ import annotations

import asyncio
import resource
from typing import Any

from liftgate_hil.dashboard.guard import AUTHORISED

_MOST = 200  # connections; fewer where the process may have fewer descriptors
_RESERVED = 64  # descriptors for everything else
_FIRST_S = 2.0  # s for the first request on a connection: one segment may be lost, sent again after 1 s (RFC 6298)
_REQUEST_S = 10.0  # s for a further one, after a request with the token


def watched(protocol: Any) -> Any:
    """Return uvicorn's protocol of an HTTP connection, which drops connections.

    One above the first `_MOST` takes the place of the oldest one on which no request with the token has come.
    """
    most = max(1, min(_MOST, resource.getrlimit(resource.RLIMIT_NOFILE)[0] - _RESERVED))
    strangers: dict[Any, None] = {}  # connections without such a request, in the order in which they came

    class Watched(protocol):  # type: ignore[misc]
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            strangers[self] = None
            self.app: Any = self._tracked(self.app)
            self._watch(self.cycle)
            if len(self.connections) > most:
                oldest = next(iter(strangers))
                del strangers[oldest]
                oldest.transport.abort()

        def _tracked(self, app: Any) -> Any:
            async def serve(scope: Any, receive: Any, send: Any) -> None:
                extensions = {**scope.get("extensions", {}), AUTHORISED: lambda: strangers.pop(self, None)}
                await app({**scope, "extensions": extensions}, receive, send)

            return serve

        def handle_websocket_upgrade(self, *arguments: Any) -> None:
            strangers.pop(self, None)  # a WebSocket without the token is refused at once
            super().handle_websocket_upgrade(*arguments)

        def _watch(self, cycle: Any) -> None:
            limit = _FIRST_S if self in strangers else _REQUEST_S
            self._limit = asyncio.get_running_loop().call_later(limit, self._look, cycle)

        def _look(self, cycle: Any) -> None:
            if self not in self.connections:  # it is a WebSocket's now, or closed
                return
            if self.cycle is cycle and (cycle is None or cycle.response_complete):
                self.transport.close()
            else:
                self._watch(self.cycle)

        def connection_lost(self, exc: Exception | None) -> None:
            self._limit.cancel()
            strangers.pop(self, None)
            super().connection_lost(exc)

    return Watched
