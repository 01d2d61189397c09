"""Keys of the JSON of `doctor`, of `rig check`, and of campaigns."""

from __future__ import annotations

from liftgate_hil.campaigns.prepared import Pace
from liftgate_hil.campaigns.reporting.adaptive_sections import ProbabilityResult, WorstResult
from liftgate_hil.campaigns.reporting.comparison import ResultsComparison
from liftgate_hil.campaigns.run import CampaignFigures
from liftgate_hil.config.sources import Source
from liftgate_hil.described_result import keys_of
from liftgate_hil.doctor.examination import DoctorReport
from tools.docs.json_keys import PROVENANCE, Document

DOCTOR = Document(
    "`doctor --json`", "Checks of this machine, and the measurements behind them.", keys_of(DoctorReport), {}
)

RIG = Document(
    "`rig check --json`",
    "What a rig maps. Ranges and steps are the signals', in the quantity's unit.",
    {
        "file": "path of the rig",
        "database": "path of the database",
        "vehicle": "name of the vehicle for which it was checked",
        "rate": "tick rate for which it was checked [Hz]",
        "messages": "messages that carry quantities, those that the gate receives first",
        "messages[].message": "name in the database",
        "messages[].identifier": "CAN identifier, as a number",
        "messages[].is_extended": "whether the identifier has 29 bits",
        "messages[].direction": "`received` or `sent` by the gate",
        "messages[].length": "length [bytes]",
        "messages[].cycle_ms": "cycle time [ms]; 0: none",
        "messages[].format": "of the frames as the gate sends them: `classic`, `CAN FD`, `CAN FD with BRS`",
        "messages[].pages": "number of multiplexer values with which it is sent in turn",
        "messages[].timeout_ms": "timeout [ms]; 0: its values never expire",
        "messages[].send_type": "`cyclic`, `cyclic while active`, `on events`",
        "messages[].protection": "counter and checksum, in words",
        "messages[].unmapped": "its other signals: by name the value with which each is sent; empty: not read",
        "messages[].signals": "its mapped signals",
        "messages[].signals[].quantity": "quantity of the [rig file](rig.md)",
        "messages[].signals[].signal": "signal in the database",
        "messages[].signals[].database_unit": "unit in the database",
        "messages[].signals[].unit": "unit of the quantity",
        "messages[].signals[].conversion": "conversion between the two, in words; empty: none",
        "messages[].signals[].low": "lowest value, in `unit`",
        "messages[].signals[].high": "highest value, in `unit`",
        "messages[].signals[].step": "step, in `unit`; 0: a floating-point signal",
        "restbus_protection": "protection of messages that carry no quantity",
        "restbus_protection.MESSAGE": "counter and checksum, in words",
        "requests": "how requests reach an ECU on a bus",
        "requests.ACTION": "signal and values, in words",
        "inject": "orders that a test bench gives by a message",
        "inject.ORDER": "message and signals of the order, in words",
        "diagnostics": "the tester's settings, see `[diagnostics]` of the [rig file](rig.md); null: none",
        "diagnostics.request": "identifier of requests, as a number; bit 31 is set if it has 29 bits",
        "diagnostics.response": "identifier of responses, alike",
        "diagnostics.padding": "byte that fills frames; -1: none",
        "diagnostics.period": "from one reading to the next [s]",
        "diagnostics.patience": "longest wait for a response [s]",
        "diagnostics.status_mask": "status bits by which a code counts as reported",
        "diagnostics.clears": "whether all codes are cleared before the first reading",
        "diagnostics.names": "messages in the database: [request, response]",
        "notes": "sentences: what does not fit well",
        "issues": "what is wrong, one text each; empty: the rig fits",
    },
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
