"""Keys of the JSON of `doctor`, of `rig check`, and of campaigns."""

from __future__ import annotations

from liftgate_hil.campaigns.run import CampaignFigures
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
        "seconds_each": "time that a variant took in a trial before [s], from which batches are sized",
        "workers": "number of workers",
        "files": "files that were read, by purpose",
        "files.PURPOSE": "a file",
        "files.PURPOSE.path": "path of the file",
        "files.PURPOSE.sha256": "SHA-256 of its content, in hexadecimal digits",
        **{name: meaning for name, meaning in PROVENANCE.keys.items() if not name.startswith("sources")},
        "analysis.expectation": "`--worst`, `--probability`: name of the expectation",
        "analysis.evaluations": "`--worst`, `--probability`: number of evaluations",
        "analysis.variant": "`--worst`: the variant with the smallest margin, as in `results.parquet`",
        "analysis.margin": "`--worst`: its margin, in `margin_unit`; null: no variant has one",
        "analysis.margin_unit": "`--worst`: unit of the margins; empty: none, or comparisons in several units",
        "analysis.values": "`--worst`: its values",
        "analysis.values.NAME": "value of what was varied",
        "analysis.found_after": "`--worst`: evaluations until it was found, random ones included; null: none",
        "analysis.first_failure_after": "`--worst`: evaluations until the first failure; null: none fails",
        "analysis.failures": "`--worst`: number of failures",
        "analysis.stopped": "`--worst`: why the search ended, in words",
        "analysis.evidence": "`--worst`: how sure the result is, in words",
        "analysis.restarts": "`--worst`: descents that were begun",
        "analysis.random": "`--worst`: as many random draws, for comparison",
        "analysis.random.evaluations": "number of draws",
        "analysis.random.margin": "smallest margin, in the expectation's unit; null: no draw has one",
        "analysis.random.first_failure_after": "draws until the first failure; null: none fails",
        "analysis.random.failures": "number of failures",
        "analysis.probability": "`--probability`: probability of failure, 0 to 1; null: unknown",
        "analysis.low": "`--probability`: begin of its interval; null: unknown",
        "analysis.high": "`--probability`: end of its interval; null: unknown",
        "analysis.confidence": "`--probability`: confidence of the interval, 0 to 1",
        "analysis.variation": "`--probability`: coefficient of variation; null: unknown",
        "analysis.is_upper_bound": "`--probability`: true: the probability is only known to be lower",
        "analysis.method": "`--probability`: method of the estimate",
        "analysis.of_these_searching": "`--probability`: evaluations that only searched for failures",
        "analysis.without_verdict": "`--probability`: evaluations without a margin",
        "analysis.pockets": "`--probability`: separate regions of failures that were found",
        "analysis.against": "`--against`: comparison of two ECUs",
        "analysis.against.ecus": "names of the ECUs: [first, second]",
        "analysis.against.variants": "variants that both have gone through",
        "analysis.against.differing": "variants whose verdict or margins differ, see `differences.parquet`",
        "analysis.against.verdicts": "variants by the two verdicts",
        "analysis.against.verdicts.PAIR": "number of variants; the key is e.g. `pass / fail`",
    },
    {},
)
