"""Outcomes of a suite as JUnit XML, as CI servers read it.

It is valid against the schema of Apache Ant's reports (windyroad/JUnit-Schema, JUnit.xsd), whose timestamps have
no time zone: they are UTC here.
"""

from __future__ import annotations

import datetime
import os
import re
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from liftgate_hil.config.shipped import data_root
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, Verdict, line_of
from liftgate_hil.report.files import JUNIT
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Outcome

_NOT_IN_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_NOT_IN_A_CLASS = re.compile(r"[\s.]+")


def as_junit(outcomes: Sequence[Outcome], mutation: MutationResult | None = None) -> bytes:
    """Return JUnit XML: a suite for each scenario or recorded run, a test case for each expectation.

    One that fails is a failure, one that is inconclusive or an error is an error, nothing is skipped. `mutation`
    adds a case for mutation testing that was stopped, or for which a share was required.
    """
    root = ElementTree.Element("testsuites")
    classes = class_names([_subject(each) for each in outcomes])
    for number, (outcome, name) in enumerate(zip(outcomes, classes, strict=True)):
        root.append(_suite(outcome, number, name))
    if mutation is not None and mutation.reason:
        root.append(_of_mutants(len(outcomes), mutation))
    return _written(root)


def _of_mutants(number: int, mutation: MutationResult) -> ElementTree.Element:
    verdict, reason = mutation.verdict, mutation.reason
    suite = _testsuite("mutants", number, "", time.time(), 0.0, [verdict])
    ElementTree.SubElement(suite, "properties")
    case = ElementTree.SubElement(suite, "testcase", classname="mutants", name="mutation threshold", time="0.000")
    if verdict != PASS:
        kind = "failure" if verdict == FAIL else "error"
        ElementTree.SubElement(case, kind, type=verdict, message=reason).text = reason
    ElementTree.SubElement(suite, "system-out").text = reason
    ElementTree.SubElement(suite, "system-err")
    return suite


def issues_as_junit(issues: Sequence[str]) -> bytes:
    """Return JUnit XML of a suite that was not begun: an error for each issue of its files and flags."""
    root = ElementTree.Element("testsuites")
    suite = _testsuite("files and flags", 0, "", time.time(), 0.0, [ERROR] * len(issues))
    root.append(suite)
    ElementTree.SubElement(suite, "properties")
    for each in issues:
        case = ElementTree.SubElement(suite, "testcase", classname="liftgate-hil", name=_text(each), time="0.000")
        ElementTree.SubElement(case, "error", type=ERROR, message=_text(each)).text = _text(each)
    ElementTree.SubElement(suite, "system-out")
    ElementTree.SubElement(suite, "system-err")
    return _written(root)


def class_names(files: Sequence[Path]) -> list[str]:
    """Return the class name of each file's test cases, each unique.

    CI servers recognize a case from run to run by it, and sort by its parts. It is the path without suffix, from
    the folder of the shipped scenarios, else from the working folder, else the name with its folder's, however a
    file was named on the command line.
    """
    found: list[str] = []
    for file in files:
        own = ".".join(_NOT_IN_A_CLASS.sub("_", _text(part)) for part in _parts(file))
        count = sum(name == own or name.startswith(f"{own} (") for name in found)
        found.append(f"{own} ({count + 1})" if count else own)
    return found


def _parts(file: Path) -> tuple[str, ...]:
    """Return the parts of a file's path that name its class, without its suffix, see `class_names`."""
    real = Path(os.path.realpath(file)).with_suffix("")
    for folder in (data_root() / "configs" / "scenarios", Path.cwd()):
        above = Path(os.path.realpath(folder))
        if real.is_relative_to(above):
            return real.relative_to(above).parts
    return real.parts[-2:]


def _subject(outcome: Outcome) -> Path:
    """Return the file that an outcome is of."""
    case = outcome.case
    return case.recordings[0] if case.recordings else Path(case.file)


def _suite(outcome: Outcome, number: int, name: str) -> ElementTree.Element:
    """Return the `testsuite` element of an outcome; `number` is its id, `name` the class of its test cases."""
    verdicts = [each.verdict for each in outcome.expectations]
    package, began = name.rpartition(".")[0], outcome.ended - outcome.wall_s
    suite = _testsuite(outcome.case.file, number, package, began, outcome.wall_s, verdicts)
    properties = ElementTree.SubElement(suite, "properties")
    for own, value in properties_of(outcome):
        ElementTree.SubElement(properties, "property", name=_text(own), value=_text(value))
    for each in outcome.expectations:
        suite.append(_case(each, name, outcome.wall_s / len(verdicts)))
    lines = [f"{each.name}: {line_of(each)}" for each in outcome.expectations]
    lines += [f"note: {each}" for each in outcome.notes]
    ElementTree.SubElement(suite, "system-out").text = _text("\n".join(lines))
    ElementTree.SubElement(suite, "system-err").text = _text(outcome.reason)
    return suite


def _testsuite(
    name: str, number: int, package: str, began: float, seconds: float, verdicts: Sequence[str]
) -> ElementTree.Element:
    """Return an empty `testsuite` element; `began` is in seconds since 1970."""
    return ElementTree.Element(
        "testsuite",
        name=_text(name),
        id=str(number),
        package=package,
        timestamp=datetime.datetime.fromtimestamp(began, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        hostname=_text(socket.gethostname()) or "localhost",
        tests=str(len(verdicts)),
        failures=str(verdicts.count(FAIL)),
        errors=str(verdicts.count(ERROR) + verdicts.count(INCONCLUSIVE)),
        skipped="0",
        time=f"{seconds:.3f}",
    )


def _case(verdict: Verdict, name: str, seconds: float) -> ElementTree.Element:
    """Return the `testcase` element of an expectation; `name` is its class name, `seconds` its duration."""
    case = ElementTree.Element("testcase", classname=name, name=_text(verdict.name), time=f"{seconds:.3f}")
    if verdict.verdict != PASS:
        kind = "failure" if verdict.verdict == FAIL else "error"
        text = _text(line_of(verdict))
        element = ElementTree.SubElement(case, kind, type=verdict.verdict, message=text)
        element.text = text
    return case


def properties_of(outcome: Outcome) -> list[tuple[str, str]]:
    """Return the properties of a run (name, value): vehicle, seed, ECU, recordings, requirements, parameters."""
    setup = outcome.case.plan.setup
    entries = [("vehicle", setup.vehicle_name), ("seed", str(setup.seed))]
    if outcome.case.recordings:
        entries = [("scenario", setup.scenario.source)]
        entries += [("recording", str(path)) for path in outcome.case.recordings]
    else:
        identity = outcome.case.plan.ecu_identity
        entries += [("ecu", str(identity["kind"]))]
        known = [name for name in ("path", "class", "sha256", "mutant") if name in identity]
        entries += [(f"ecu.{name}", str(identity[name])) for name in known]
    entries += [("requirement", each) for each in setup.scenario.requirement]
    return entries + [(f"parameter.{name}", f"{value:g}") for name, value in setup.scenario.parameters.items()]


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    content = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{JUNIT}\n{content}\n'.encode()


def _text(text: str) -> str:
    """Return a text with `?` for each character that XML cannot hold."""
    return _NOT_IN_XML.sub("?", text)
