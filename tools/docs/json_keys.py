"""Keys of the JSON that the program writes, with meaning and unit.

Keys are dotted paths: `a.b` is key `b` of object `a`, `a[].b` that of each object in list `a`. A last part in
capitals stands for a name that varies, e.g. a column. A test compares the keys with those that are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from liftgate_hil.conversion.compare import Comparison
from liftgate_hil.described_result import keys_of
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.playback.player import Played
from liftgate_hil.report.provenance import Provenance
from liftgate_hil.report.run_report import DemoReport
from liftgate_hil.testing.tested import SuiteResult
from liftgate_hil.transport.base import LinkCounts


class Shared(NamedTuple):
    """Object that several documents contain."""

    title: str
    intro: str
    keys: Mapping[str, str]


class Document(NamedTuple):
    """JSON that a command writes; `shared` are the objects in it that have tables of their own, by their paths."""

    title: str
    intro: str
    keys: Mapping[str, str]
    shared: Mapping[str, Shared]

    def paths(self) -> set[str]:
        """Return the paths of all keys, those of the shared objects included."""
        return {*self.keys} | {f"{at}.{key}" for at, shared in self.shared.items() for key in shared.keys}


PROVENANCE = Shared(
    "Provenance",
    "`provenance` of the documents below. `SOURCE_DATE_EPOCH` of the environment replaces the date.",
    keys_of(Provenance),
)
LINK = Shared(
    "Link",
    "`link`: errors on the way to and from the wire. All values are numbers of events.",
    keys_of(LinkCounts),
)
EXPECTATION = Shared(
    "Expectation", "The verdict on one `[[expect]]`, see [verdicts](verdicts.md).", keys_of(Verdict)
)

WITHOUT_FILES = Shared(
    PROVENANCE.title,
    PROVENANCE.intro,
    {name: meaning for name, meaning in PROVENANCE.keys.items() if not name.startswith("sources.")},
)

RUN = Document(
    "`run --json`, `demo --json`",
    "The summary of a run; without a subcommand the same. It goes to stdout when the run has ended. Times of the "
    "loop are measured on the clock `realtime` only; else they are null.",
    keys_of(DemoReport, [LinkCounts, Verdict, Provenance]),
    {"link": LINK, "expectations[]": EXPECTATION, "provenance": PROVENANCE},
)

VERDICTS = Document(
    "`test --json FILE`, `judge --json FILE`, `verdicts.json`",
    "The verdicts of a suite; `--results FOLDER` writes them as `verdicts.json`.",
    keys_of(SuiteResult, [Verdict, Provenance]),
    {
        "scenarios[].expectations[]": EXPECTATION,
        "scenarios[].attempts[].expectations[]": EXPECTATION,
        "provenance": WITHOUT_FILES,
    },
)

REPLAY = Document(
    "`replay --json`",
    "The summary of a replay.",
    keys_of(Played, [LinkCounts, Provenance]),
    {"link": LINK, "provenance": PROVENANCE},
)

COMPARE = Document(
    "`compare --json`", "Differences between two recordings: the second minus the first.", keys_of(Comparison), {}
)
