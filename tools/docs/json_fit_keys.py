"""Keys of the JSON of `identify`, of its plan, and of `validate`: those that the results show."""

from __future__ import annotations

from liftgate_hil.described_result import keys_of
from liftgate_hil.identification.design import ExperimentPlan
from liftgate_hil.identification.result import Experiment, Identification, Validation
from liftgate_hil.report.provenance import Provenance
from tools.docs.json_keys import PROVENANCE, Document, Shared

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
