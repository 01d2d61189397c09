"""Result of a suite: the outcome of each scenario, or of each recorded run, with counts and provenance."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.judging.verdict import worst
from liftgate_hil.report.provenance import Provenance
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Outcome, VerdictCounts, counts_of, verdict_of


# fmt: off
@dataclass(frozen=True)
class SuiteResult(DescribedResult):
    """Result of a suite of scenarios, or of recorded runs."""

    scenarios: Annotated[tuple[Outcome, ...], Shown("scenarios in the order given; of `judge` recordings")]
    provenance: Annotated[Provenance, Shown("see Provenance")]
    mutation: Annotated[MutationResult | None, Shown("`test --mutants` only: which defects of the reference ECU "
        "the scenarios find; else null")] = None

    @property
    def verdict(self) -> Annotated[str, Shown("the worst of all scenarios and of `mutation`: `pass`, "
        "`inconclusive`, `fail` or `error`")]:
        """The worst of all scenarios and of the mutation testing."""
        tested = [] if self.mutation is None else [self.mutation.verdict]
        return worst([verdict_of(self.scenarios), *tested])

    @property
    def expectations(self) -> Annotated[VerdictCounts, Shown("how many expectations have which verdict")]:
        """Numbers of expectations by verdict."""
        return counts_of(self.scenarios)

    # fmt: on
    def to_json(self, indent: int | None = 2) -> str:
        """Return the JSON of `test` and `judge`, with an indent."""
        return json.dumps(self.to_dict(), indent=indent, ensure_ascii=False, allow_nan=False)
