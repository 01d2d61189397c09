"""Page docs/json.md: every key of the JSON that the program writes, with meaning and unit, from the types.

Keys are dotted paths: `a.b` is key `b` of object `a`, `a[].b` that of each object in list `a`. A last part in
capitals stands for a name that varies, e.g. a column. A test compares the keys with those that are written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple

from liftgate_hil.campaigns.prepared import Pace
from liftgate_hil.campaigns.reporting.adaptive_sections import ProbabilityResult, WorstResult
from liftgate_hil.campaigns.reporting.comparison import ResultsComparison
from liftgate_hil.campaigns.request import DESIGN, PROBABILITY, WORST, CampaignRequest
from liftgate_hil.campaigns.run import CampaignFigures
from liftgate_hil.config.described import fields_of
from liftgate_hil.config.sources import Source
from liftgate_hil.conversion.compare import Comparison
from liftgate_hil.described_result import keys_of
from liftgate_hil.doctor.examination import DoctorReport
from liftgate_hil.identification.design import ExperimentPlan
from liftgate_hil.identification.result import Experiment, Identification, Validation
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.plan.rig_check import RigReport
from liftgate_hil.playback.player import Played
from liftgate_hil.testing.demo import DemoReport
from liftgate_hil.testing.tested import SuiteResult
from liftgate_hil.transport.base import LinkCounts
from tools.docs.markdown import code, page, table


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

_OWN_TABLES = (Experiment, Provenance)
EXPERIMENT = Shared(
    "Experiment",
    "`experiments[]` of `identify` and `validate`: a measurement and its simulation.",
    keys_of(Experiment),
)
IDENTIFY = Document(
    "`identify --json`, `identify --result FILE.json`",
    "The result of an identification. Values are in the units of the [vehicle file](vehicle.md).",
    keys_of(Identification, _OWN_TABLES),
    {"experiments[]": EXPERIMENT, "provenance": PROVENANCE},
)
PLAN = Document(
    "`identify --plan --json`",
    "Experiments by the information that they give.",
    keys_of(ExperimentPlan, _OWN_TABLES),
    {"provenance": PROVENANCE},
)
VALIDATE = Document(
    "`validate --json`, `validate --result FILE.json`",
    "The comparison of a vehicle with measurements; each statistic over all experiments by output column.",
    keys_of(Validation, _OWN_TABLES),
    {"experiments[]": EXPERIMENT, "provenance": PROVENANCE},
)

DOCTOR = Document(
    "`doctor --json`", "Checks of this machine, and the measurements behind them.", keys_of(DoctorReport), {}
)

RIG = Document(
    "`rig check --json`",
    "What a rig maps. Ranges and steps are the signals', in the quantity's unit.",
    keys_of(RigReport),
    {},
)


def _kept_request() -> dict[str, str]:
    """Return the keys of a campaign's request in campaign.json: its arguments, by their flags."""
    fields = {each.name: each for each in fields_of(CampaignRequest)}
    own = {
        "kind": f"`{DESIGN}`, `{WORST}` or `{PROBABILITY}`",
        "expectation": "expectation of `--worst` or `--probability`; else empty",
        "scenario": "the argument `SCENARIO`",
        "parameters": "`--set-parameter`: object, values by name, in the units in which the scenario uses them",
    }
    found = {}
    for name, value in CampaignRequest("").kept().items():
        field = fields.get(name)
        if field is None or name in own:
            found[f"request.{name}"] = own[name]
            continue
        unit = f" [{each}]" if (each := getattr(field.kind, "unit", "")) else ""
        none = f"; `{json.dumps(value)}`: {field.default_text or 'not given'}" if field.default is None else ""
        flag = field.flag or name.replace("_", "-")
        found[f"request.{name}"] = f"{'list: ' * (value == [])}`--{flag}`{unit}{none}"
    return {**found, "request.parameters.NAME": "value"}


_ANALYSIS = {**keys_of(WorstResult), **keys_of(ProbabilityResult)}
CAMPAIGN = Document(
    "`campaign.json`",
    "In the folder of a [campaign](campaigns.md), beside `results.parquet` with a row for each variant.",
    {
        "format": "version of this file's format",
        **keys_of(CampaignFigures),
        "identity": "SHA-256 of all that decides the results: equal for campaigns whose results may be mixed",
        "request": "what was asked for: the arguments of the [command](command-line.md)",
        **_kept_request(),
        "varied": "list: what was varied, as texts",
        **keys_of(Pace),
        "files": "files that were read, by purpose",
        "files.PURPOSE": "a file",
        **{f"files.PURPOSE.{name}": meaning for name, meaning in keys_of(Source).items()},
        **{name: meaning for name, meaning in PROVENANCE.keys.items() if not name.startswith("sources")},
        **{f"analysis.{name}": _ANALYSIS[name] for name in ("expectation", "evaluations")},
        **{f"analysis.{name}": meaning for name, meaning in _ANALYSIS.items()},
        "analysis.against": "`--against`: comparison of two ECUs",
        **{f"analysis.against.{name}": meaning for name, meaning in keys_of(ResultsComparison).items()},
    },
    {},
)

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
