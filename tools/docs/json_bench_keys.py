"""Keys of the JSON of `doctor`, of `rig check`, and of campaigns."""

from __future__ import annotations

from liftgate_hil.campaigns.prepared import Pace
from liftgate_hil.campaigns.reporting.adaptive_sections import ProbabilityResult, WorstResult
from liftgate_hil.campaigns.reporting.comparison import ResultsComparison
from liftgate_hil.campaigns.run import CampaignFigures
from liftgate_hil.config.sources import Source
from liftgate_hil.described_result import keys_of
from liftgate_hil.doctor.examination import DoctorReport
from liftgate_hil.plan.rig_check import RigReport
from tools.docs.json_keys import PROVENANCE, Document

DOCTOR = Document(
    "`doctor --json`", "Checks of this machine, and the measurements behind them.", keys_of(DoctorReport), {}
)

RIG = Document(
    "`rig check --json`",
    "What a rig maps. Ranges and steps are the signals', in the quantity's unit.",
    keys_of(RigReport),
    {},
)

_ANALYSIS = {**keys_of(WorstResult), **keys_of(ProbabilityResult)}
CAMPAIGN = Document(
    "`campaign.json`",
    "In the folder of a [campaign](campaigns.md), beside `results.parquet` with a row for each variant.",
    {
        "format": "version of this file's format",
        **keys_of(CampaignFigures),
        "identity": "SHA-256 of all that decides the results: equal for campaigns whose results may be mixed",
        "request": "what was asked for: the arguments of the [command](command-line.md)",
        "request.scenario": "the scenario",
        "request.vary": "list: `--vary`",
        "request.ecu": "`--ecu`",
        "request.against": "`--against`: the other ECU; empty: none",
        "request.vehicle": "`--vehicle`; null: that of the scenario",
        "request.rig": "`--rig`; null: that of the scenario",
        "request.settings": "list: `--set`",
        "request.parameters": "`--set-parameter`",
        "request.parameters.NAME": "value, in the unit in which the scenario uses it",
        "request.seed": "`--seed`; null: that of the scenario",
        "request.draw": "`--draw`; null: not given",
        "request.ideal": "`--ideal`",
        "request.rate": "`--rate` [Hz]",
        "request.duration": "`--duration` [s]; null: that of the scenario",
        "request.kind": "`design`, `worst` or `probability`",
        "request.expectation": "expectation of `--worst` or `--probability`; else empty",
        "request.samples": "`--samples`",
        "request.method": "`--method`; empty: the default",
        "request.sampling_seed": "`--sampling-seed`",
        "request.evaluations": "`--evaluations`; 0: the default",
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
