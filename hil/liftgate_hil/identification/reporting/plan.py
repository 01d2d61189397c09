"""Report of a plan of experiments as text, and its inputs as files."""

from __future__ import annotations

import math
import re

from liftgate_hil.identification.design import Candidate, ExperimentPlan, Ranked
from liftgate_hil.identification.reporting.text import table
from liftgate_hil.report.numbers import significant


def plan_text(plan: ExperimentPlan) -> str:
    """Return the candidates, best first, and the order in which to combine them, as text."""
    heads = ["experiment", "log10 det", *(f"{name} ±" for name in plan.names)]
    align = "l" + "r" * (len(heads) - 1)
    lines = ["Experiments, the most informative first (expected standard deviations)", ""]
    lines += table(heads, [_row(each) for each in plan.ranked], align)
    lines += ["", "Best sequence, each experiment together with all before it", ""]
    lines += table(heads, [_row(each) for each in plan.order], align)
    return "\n".join(lines)


def _row(each: Ranked) -> list[str]:
    criterion = significant(each.log_det) if math.isfinite(each.log_det) else "not all identifiable"
    stds = [
        "not identifiable" if math.isinf(std) else f"{significant(100.0 * float(std), 2)} %"
        for std in each.relative_std
    ]
    return [each.candidate.name, criterion, *stds]


def input_name(planned: Candidate) -> str:
    """Return the name of an experiment as a part of a file's name."""
    return re.sub("[^a-z0-9.+-]+", "-", planned.name.lower())


def input_csv(planned: Candidate) -> str:
    """Return voltage and slope of an experiment as CSV, a row where they change, which holds until the next."""
    last = len(planned.times) - 1
    rows = [k for k in range(last + 1) if k in (0, last) or planned.voltage[k] != planned.voltage[k - 1]]
    slope = f"{planned.road_slope_deg:g}"
    lines = [f"{planned.times[k]:.9g},{planned.voltage[k]:.9g},{slope}\n" for k in rows]
    return "time_s,voltage_v,road_slope_deg\n" + "".join(lines)
