"""Page docs/json.md: every key of the JSON that the program writes."""

from __future__ import annotations

from collections.abc import Mapping

from tools.docs.json_bench_keys import CAMPAIGN, DOCTOR, RIG
from tools.docs.json_fit_keys import EXPERIMENT, IDENTIFY, PLAN, VALIDATE
from tools.docs.json_keys import COMPARE, EXPECTATION, LINK, PROVENANCE, REPLAY, RUN, VERDICTS
from tools.docs.markdown import code, page, table

DOCUMENTS = (RUN, VERDICTS, COMPARE, REPLAY, IDENTIFY, PLAN, VALIDATE, RIG, DOCTOR, CAMPAIGN)
_SHARED = (EXPECTATION, LINK, EXPERIMENT, PROVENANCE)
_INTRO = """\
What commands print with `--json`, and the JSON files that they write. What the server of the operator's page
answers, `/api/state` for example, is described in [HTTP and WebSocket](http-api.md).

Keys are public; the change log names those that change. A number that is unknown or not finite is null.
`a.b` is key `b` of object `a`, and `a[].b` that of each object in list `a`. A part in capitals stands for a name
that varies: `maxima.COLUMN` are `maxima.time_s`, `maxima.gate_angle_deg` and so on. Columns are the
[signals](signals.md). The exit codes are on the page of the [command line](command-line.md)."""


def json_page() -> str:
    """Return the text of the page."""
    parts = [
        part for each in (*DOCUMENTS, *_SHARED) for part in (f"## {each.title}", each.intro, _key_table(each.keys))
    ]
    return page("JSON results", _INTRO, *parts)


def _key_table(keys: Mapping[str, str]) -> str:
    return table(["key", "meaning"], [(code(name), meaning) for name, meaning in keys.items()])
