"""Page docs/http-api.md: what the server of the operator's page answers, from its code."""

from __future__ import annotations

from liftgate_hil.dashboard import page_state
from liftgate_hil.dashboard.server import ENDPOINTS
from liftgate_hil.described_result import keys_of
from liftgate_hil.operate import operator
from tools.docs.markdown import code, page, table

_INTRO = """\
The server of [the operator's page](operators-page.md) answers scripts, too. Each request needs the token of the
printed address, as `?token=…` or as `Authorization: Bearer …`. All content is JSON, in which NaN is null."""
_COMMANDS = """\
## Commands

A command is an object of one key, with the keys of [scenario files](scenario.md). The answer has `done`, in words,
and `time_s`, or `waits` where the run stands still: it executes the command when it continues."""
_STATE = """\
`a.b` is key `b` of object `a`, and `a[].b` that of each object in list `a`. A part in capitals stands for a name
that varies, e.g. that of a column. Of a recording `loop` holds only those figures that were recorded; `bus` and
`command` are empty. In the stream `span` is added: `low` and `high` of each column since the last state. With
`--scenarios` `started` is added: the scenario that the page has started; null: none runs."""
_CODES = (
    ("200", "done"),
    ("202", "the command waits, see above"),
    ("401", "no token, or a wrong one"),
    ("403", "another host or origin than the page's own; a read-only page; a recording; no `--scenarios`"),
    ("408, 413", "a command that does not come within 10 s, or is longer than 64 KiB"),
    ("410", "the run has ended, or did not begin"),
    ("422", "a value that is not allowed; `issues` say what is"),
)
_CONNECTIONS = """\
A connection on which no request comes within two seconds is closed, after one with the token within ten; so is
a WebSocket whose client takes nothing, or does not answer pings, for ten seconds. A request without the token
ends its connection. Of more than 200 connections the oldest one is dropped on which no request with the token
has come.

A client that is slower than the stream gets one state in place of
several: the latest, with all lines of the log, and the lowest and highest values (`span`) of all of them."""


_PAGES = {
    "About a run (`GET /api/about`)": page_state.AboutRun,
    "About a recording (`GET /api/about`)": page_state.AboutRecording,
    "Geometry (`GET /api/geometry`)": page_state.GateGeometry,
    "Curves (`GET /api/plot`)": page_state.Curves,
    "Trace (`GET /api/trace`)": page_state.BusTrace,
    "Scenarios (`GET /api/run`)": page_state.Startable,
}


def _keys(content: type) -> str:
    return table(["key", "meaning"], ((code(name), meaning) for name, meaning in keys_of(content).items()))


def http_api_page() -> str:
    """Return the text of the page."""
    endpoints = ((each.method, code(each.path), each.meaning) for each in ENDPOINTS)
    forms = [line for line in (operator.__doc__ or "").splitlines() if line.startswith("{")]
    parts = [
        table(["", "path", ""], endpoints),
        _COMMANDS,
        "\n".join(["```", *forms, "```"]),
        "## State (`GET /api/state`)",
        _STATE,
        _keys(page_state.PageState),
        *(part for title, each in _PAGES.items() for part in (f"## {title}", _keys(each))),
        "## Status codes and connections",
        table(["status", "meaning"], _CODES),
        _CONNECTIONS,
    ]
    return page("HTTP and WebSocket", _INTRO, *parts)
