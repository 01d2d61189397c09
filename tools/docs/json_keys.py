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
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.playback.player import Played
from liftgate_hil.report.provenance import Provenance
from liftgate_hil.testing.suite_result import SuiteResult
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
    {
        **keys_of(Summary, [LinkCounts]),
        "stop_reason": "signal that stopped the run: `SIGINT`, `SIGTERM`; else `given up`, if the bench ended it "
        "early (exit code 3), or `duration`",
        "maxima": "largest value of each column of recordings",
        "maxima.COLUMN": "in the unit of the [signal](signals.md); null: unknown",
        "minima": "smallest value of each column of recordings",
        "minima.COLUMN": "in the unit of the [signal](signals.md); null: unknown",
        "verdict": "`pass`, `fail`, `error` or `inconclusive`: the worst of the expectations; "
        "null: there are none. The exit code of `run` reports on the bench alone",
        "expectations": "verdicts on the scenario's expectations, see Expectation",
        "notes": "what may explain the run, as texts, such as requests that the ECU does not take",
        "provenance": "see Provenance",
        "pinch": "`demo` only: the contact with the largest pinch force; null: nothing was pinched",
        "pinch.peak_n": "largest pinch force [N]",
        "pinch.time_s": "model time of it [s]",
        "pinch.gate_angle_deg": "gate angle at that time [deg]",
        "pinch.contact_start_s": "begin of the contact: model time [s]",
        "pinch.contact_end_s": "end of the contact: model time [s]",
        "pinch.reversal_time_s": "from the first touch to the reversal [s]; null: the gate did not reverse",
        "pinch.reversal_further_deg": "how far the gate went on after the first touch [deg]; null: as above",
        "pinch.reversal_back_deg": "how far it moved back after the reversal [deg]; null: as above",
        "pinch.limits": "force limits, borrowed from other doors",
        "pinch.limits[].force_n": "the limit [N]",
        "pinch.limits[].longest_s": "how long it may be exceeded without interruption [s]",
        "pinch.limits[].source": "where the limit is from",
        "pinch.limits[].is_judged": "whether the demo fails if it is exceeded",
        "pinch.limits[].margin_n": "limit minus largest force [N]",
        "pinch.limits[].over_s": "longest time above the limit without interruption [s]",
    },
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
