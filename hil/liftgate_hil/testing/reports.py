"""Outcomes of a suite as JSON; for JUnit XML see `junit`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from liftgate_hil.judging.shown_verdict import expectation_json
from liftgate_hil.testing.suite import Outcome, counts_of, verdict_of


def as_json(outcomes: Sequence[Outcome], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the whole suite for JSON; what is not a finite number is null."""
    return {
        "verdict": verdict_of(outcomes),
        "expectations": counts_of(outcomes),
        "scenarios": [_scenario(each) for each in outcomes],
        "provenance": dict(provenance),
    }


def as_text(content: Mapping[str, Any]) -> str:
    """Return the content for JSON as text."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)


def _scenario(outcome: Outcome) -> dict[str, Any]:
    setup = outcome.case.plan.setup
    return {
        "file": outcome.case.file,
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "notes": outcome.notes,
        "condition_times": {} if outcome.result is None else dict(outcome.result.condition_times),
        "description": setup.scenario.description,
        "requirement": list(setup.scenario.requirement),
        "vehicle": setup.vehicle_name,
        "ecu": None if outcome.case.recordings else _ecu(outcome),
        "seed": setup.seed,
        "parameters": dict(setup.scenario.parameters),
        "clock": outcome.case.job.request.clock,
        "wall_s": outcome.wall_s,
        "expectations": [expectation_json(each) for each in outcome.expectations],
        "attempts": [
            {
                "verdict": each.verdict,
                "expectations": [expectation_json(verdict) for verdict in each.expectations],
                "recordings": _recordings(each),
            }
            for each in outcome.attempts
        ],
        "recordings": _recordings(outcome),
        "sources": {name: each._asdict() for name, each in outcome.case.plan.sources.items()},
    }


def _ecu(outcome: Outcome) -> dict[str, str | None]:
    identity = outcome.case.plan.ecu_identity
    name = next((str(identity[each]) for each in ("class", "path", "version") if each in identity), "")
    others = {key: identity.get(key) for key in ("sha256", "mutant")}
    return {"kind": identity["kind"], "name": name, **others}


def _recordings(outcome: Outcome) -> list[str]:
    return [] if outcome.result is None else [str(path) for path in outcome.result.recording]
