"""Keys of the JSON that the program writes, with meaning and unit.

Keys are dotted paths: `a.b` is key `b` of object `a`, `a[].b` that of each object in list `a`. A last part in
capitals stands for a name that varies, e.g. a column. A test compares the keys with those that are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from liftgate_hil.config.described_result import keys_of
from liftgate_hil.conversion.compare import Comparison
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.playback.player import Played
from liftgate_hil.report.provenance import Provenance
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
    "Expectation",
    "The verdict on one `[[expect]]`, see [verdicts](verdicts.md).",
    {
        "name": "name of the expectation",
        "verdict": "`pass`, `inconclusive`, `fail` or `error`",
        "margin": "distance to the limit, in `margin_unit`; negative: failed; 0: see `verdict`; null: undecided",
        "margin_unit": "unit of `margin`; empty: it has none",
        "time_s": "when it was decided: model time [s]; null: never",
        "reason": "why, in words; may be empty",
        "uncertainty": "how far the bench's lateness may have moved the margin, in `margin_unit`; null: not at "
        "all, or unknown",
        "method": "`direct`: from the run as it was; `replay`: the bench was late, and the gate was stepped "
        "again; null: undecided",
        "window_s": "when it was judged, as far as the run went: [from, to], model time [s]; null: the window "
        "never opened",
        "margin_time_s": "when the margin was reached: model time [s]; null: unknown",
        "decided_by": "comparison of the condition that the margin is of, with numbers for parameters",
        "formula": "what was expected, with numbers for parameters; empty: there is no verdict on it",
    },
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
    {
        "verdict": "the worst of all scenarios and of `mutation`: `pass`, `inconclusive`, `fail` or `error`",
        "expectations": "how many expectations have which verdict",
        "expectations.pass": "number of expectations that passed",
        "expectations.inconclusive": "number of those undecided",
        "expectations.fail": "number of those that failed",
        "expectations.error": "number of those that could not be judged",
        "expectations.inconclusive_share": "share of undecided expectations, 0 to 1",
        "scenarios": "scenarios in the order given; of `judge` recordings",
        "scenarios[].file": "the scenario, or the recordings that were judged",
        "scenarios[].verdict": "the worst of its expectations; `error`: it did not reach its end",
        "scenarios[].reason": "why it did not reach its end; else empty",
        "scenarios[].notes": "texts that may explain the verdict",
        "scenarios[].condition_times": "when each condition with which a stimulus begins came true; "
        "those that never did are missing",
        "scenarios[].condition_times.CONDITION": "model time [s]",
        "scenarios[].description": "`description` of the scenario",
        "scenarios[].requirement": "list: `requirement` of the scenario",
        "scenarios[].vehicle": "name of the vehicle",
        "scenarios[].ecu": "the ECU under test; null: judged from recordings",
        "scenarios[].ecu.kind": "`reference`, `library`, `python` or `bus`",
        "scenarios[].ecu.name": "path of a library, MODULE:CLASS, or the version of the reference ECU",
        "scenarios[].ecu.sha256": "SHA-256 of the file of a library or a class, in hexadecimal digits; else null",
        "scenarios[].ecu.mutant": "name of the reference ECU's defect, with `--ecu mutant:NAME`; else null",
        "scenarios[].seed": "seed of noise and scatter",
        "scenarios[].parameters": "parameters of the scenario, with `--set-parameter`",
        "scenarios[].parameters.NAME": "value, in the unit in which the scenario uses it",
        "scenarios[].clock": "clock of the run: `realtime`, `lockstep` or `free`; of `judge`: `recorded`",
        "scenarios[].wall_s": "elapsed time of the run [s]",
        "scenarios[].expectations": "its expectations, see Expectation",
        "scenarios[].attempts": "earlier, inconclusive attempts, with `--retry-inconclusive`",
        "scenarios[].attempts[].verdict": "verdict of the attempt",
        "scenarios[].attempts[].expectations": "its expectations, see Expectation",
        "scenarios[].attempts[].recordings": "files that the attempt wrote",
        "scenarios[].recordings": "files that the run wrote",
        "scenarios[].sources": "files that were read, by purpose",
        "scenarios[].sources.PURPOSE": "a file",
        "scenarios[].sources.PURPOSE.path": "path of the file",
        "scenarios[].sources.PURPOSE.sha256": "SHA-256 of its content, in hexadecimal digits",
        "provenance": "see Provenance",
        "mutation": "`test --mutants` only: which defects of the reference ECU the scenarios find",
        "mutation.verdict": "`pass`; `fail`: fewer are killed than --mutation-threshold says; `error`: stopped",
        "mutation.reason": "why, in words; empty where no share is required",
        "mutation.threshold": "share of --mutation-threshold, 0 to 1; null: none was given",
        "mutation.score": "share of the mutants that are killed, 0 to 1; null: stopped before its end",
        "mutation.mutants": "all mutants",
        "mutation.mutants[].name": "name of the mutant",
        "mutation.mutants[].meaning": "its defect",
        "mutation.mutants[].is_reached": "whether the defect makes a difference to the ECU in any control cycle",
        "mutation.mutants[].reached_in": "list: scenarios in which it does",
        "mutation.mutants[].propagated_in": "list: those in which it also changes a command, and so the gate",
        "mutation.mutants[].killed_by": "expectations that pass with the sound ECU and fail with the mutant",
        "mutation.mutants[].killed_by[].file": "scenario",
        "mutation.mutants[].killed_by[].expectation": "name of its expectation",
        "mutation.prove_nothing": "expectations that pass with every mutant, and without an ECU",
        "mutation.prove_nothing[].file": "scenario",
        "mutation.prove_nothing[].expectation": "name of its expectation",
        "mutation.not_counted": "expectations that the sound ECU itself does not pass: they can kill no mutant",
        "mutation.not_counted[].file": "scenario",
        "mutation.not_counted[].expectation": "name of its expectation",
    },
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
