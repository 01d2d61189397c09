"""Report of a plan of experiments, as text and as JSON."""

from __future__ import annotations

import math
import re
from typing import Any

from liftgate_hil.identify.design import Candidate, Plan, Ranked
from liftgate_hil.identify.reporting.text import table
from liftgate_hil.report.numbers import significant


def plan_text(plan: Plan) -> str:
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


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return the plan for JSON; a number that is not finite is None."""

    def row(each: Ranked) -> dict[str, Any]:
        return {
            "experiment": each.candidate.name,
            "initial_angle_deg": each.candidate.angle_deg,
            "road_slope_deg": each.candidate.road_slope_deg,
            "log10_det": each.log_det if math.isfinite(each.log_det) else None,
            "relative_std": {
                name: float(std) if math.isfinite(std) else None
                for name, std in zip(plan.names, each.relative_std, strict=True)
            },
        }

    return {
        "parameters": list(plan.names),
        "ranked": [row(each) for each in plan.ranked],
        "order": [row(each) for each in plan.order],
    }
