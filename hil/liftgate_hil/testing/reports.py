"""A suite's outcomes for machines: JSON, and JUnit XML as CI servers read it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, Verdict
from liftgate_hil.testing.suite import Outcome, counts_of, subject_of, verdict_of

_NOT_IN_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def as_json(outcomes: Sequence[Outcome], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The whole suite; what is not a number is null."""
    return {
        "verdict": verdict_of(outcomes),
        "expectations": counts_of(outcomes),
        "scenarios": [_scenario(each) for each in outcomes],
        "provenance": dict(provenance),
    }


def _scenario(outcome: Outcome) -> dict[str, Any]:
    setup, result = outcome.case.parts.setup, outcome.result
    return {
        "file": outcome.case.file,
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "notes": outcome.notes,
        "description": setup.scenario.description,
        "requirement": list(setup.scenario.requirement),
        "vehicle": setup.vehicle_name,
        "seed": setup.seed,
        "parameters": dict(setup.scenario.parameters),
        "clock": outcome.case.job.options.clock,
        "wall_s": outcome.wall_s,
        "expectations": [expectation_json(each) for each in outcome.expectations],
        "recordings": [str(path) for path in result.recording] if result is not None else [],
        "sources": {name: each._asdict() for name, each in outcome.case.parts.sources.items()},
    }


def expectation_json(verdict: Verdict) -> dict[str, Any]:
    """One verdict; what is not a number is null."""

    def known(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    return {
        "name": verdict.name,
        "verdict": verdict.verdict,
        "margin": known(verdict.margin),
        "margin_unit": verdict.margin_unit,
        "time_s": known(verdict.time_s),
        "reason": verdict.reason,
        "uncertainty": known(verdict.uncertainty),
        "window_s": list(verdict.window_s) if verdict.window_s is not None else None,
        "margin_time_s": known(verdict.margin_time_s),
        "decided_by": verdict.decided_by,
    }


def as_junit(outcomes: Sequence[Outcome]) -> bytes:
    """A suite a scenario, or a recorded run, a test case an expectation: what fails is a failure, what is
    inconclusive or an error is an error, nothing is skipped.
    """
    command = "judge" if subject_of(outcomes) == "recording" else "test"
    root = ElementTree.Element("testsuites", name=f"liftgate-hil {command}")
    for outcome in outcomes:
        verdicts = [each.verdict for each in outcome.expectations]
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=_text(outcome.case.file),
            tests=str(len(verdicts)),
            failures=str(verdicts.count(FAIL)),
            errors=str(verdicts.count(ERROR) + verdicts.count(INCONCLUSIVE)),
            skipped="0",
            time=f"{outcome.wall_s:.3f}",
        )
        _add_properties(suite, outcome)
        for each in outcome.expectations:
            case = ElementTree.SubElement(
                suite,
                "testcase",
                classname=_text(outcome.case.file),
                name=_text(each.name),
                time=f"{outcome.wall_s / len(verdicts):.3f}",
            )
            if each.verdict != PASS:
                kind = "failure" if each.verdict == FAIL else "error"
                said = line_of(each)
                told = ElementTree.SubElement(case, kind, type=each.verdict, message=_text(said))
                told.text = _text(said)
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content


def _add_properties(suite: ElementTree.Element, outcome: Outcome) -> None:
    setup = outcome.case.parts.setup
    properties = ElementTree.SubElement(suite, "properties")
    told = [("vehicle", setup.vehicle_name), ("seed", str(setup.seed))]
    if outcome.case.recordings:
        told = [("scenario", setup.scenario.source)]
        told += [("recording", str(path)) for path in outcome.case.recordings]
    told += [("requirement", each) for each in setup.scenario.requirement]
    told += [
        (f"parameter.{name}", f"{value:g}") for name, value in setup.scenario.parameters.items()
    ]
    for name, value in told:
        ElementTree.SubElement(properties, "property", name=_text(name), value=_text(value))


def _text(said: str) -> str:
    """Without what XML cannot hold."""
    return _NOT_IN_XML.sub("?", said)


def line_of(verdict: Verdict) -> str:
    """An expectation's verdict on one line."""
    parts = [verdict.verdict]
    if verdict.margin is not None:
        unit = f" {verdict.margin_unit}" if verdict.margin_unit else ""
        doubt = f" ± {verdict.uncertainty:.2g}" if verdict.uncertainty else ""
        parts.append(f"margin {verdict.margin:.4g}{doubt}{unit}")
    if verdict.time_s is not None:
        parts.append(f"at {verdict.time_s:.3f} s")
    line = ", ".join(parts)
    return f"{line}: {verdict.reason}" if verdict.reason else line
