"""What was measured before the first bottlenecks were removed, on the machine of the page, to be compared with."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from tools.scheduling.figures import CODE, Figures, Rules
from tools.scheduling.model import Case, Result, simulate

# Measured with 6,000 batches without work through a cluster of 2,000 workers, others using the machine too: 26 s,
# and 13 s with the remedy, within the same minute. The executor fetched each answer by itself.
SUBMIT_S, RESULT_S, SCHEDULER_S = 0.0003, 0.0041, 0.00115
REPORT_BYTES = 364.0  # of a row, where the report read the names of all variants too
RULES = Rules(passing_s=0.0, most_files=20_000, is_merged_meanwhile=False)


class Step(NamedTuple):
    """A step from the campaign as it was to how it is, with a simulation."""

    what: str
    result: Result


def before(figures: Figures) -> Figures:
    """Return the figures as they were."""
    return replace(
        figures, submit_s=SUBMIT_S, submit_each_s=0.0, result_s=RESULT_S, scheduler_s=SCHEDULER_S,
        summary_bytes=REPORT_BYTES,
    )  # fmt: skip


def steps(case: Case, figures: Figures) -> list[Step]:
    """Simulate a campaign as it was, and with each remedy added."""
    was = before(figures)
    client = replace(figures, summary_bytes=REPORT_BYTES)
    given = (
        ("as it was", was, RULES),
        ("answers fetched together", client, RULES),
        ("no batch shorter than its passage", client, replace(RULES, passing_s=CODE.passing_s)),
        (f"up to {CODE.most_files:,} files", client, replace(CODE, is_merged_meanwhile=False)),
        ("results written while others are evaluated", client, CODE),
        ("report without the names of all variants", figures, CODE),
    )
    return [Step(what, simulate(case, own, rules)) for what, own, rules in given]
