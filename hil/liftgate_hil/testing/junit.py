"""Outcomes of a suite as JUnit XML, which CI servers read.

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
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, line_of
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
    files = [each.case.recordings[0] if each.case.recordings else Path(each.case.file) for each in outcomes]
    for outcome, name in zip(outcomes, class_names(files), strict=True):
        cases = [(each.name, each.verdict, line_of(each)) for each in outcome.expectations]
        lines = [f"{each.name}: {line_of(each)}" for each in outcome.expectations]
        output = "\n".join([*lines, *(f"note: {each}" for each in outcome.notes)])
        _add_suite(root, outcome.case.file, name, cases, outcome, output)
    if mutation is not None and mutation.reason:
        case = ("mutation threshold", mutation.verdict, mutation.reason)
        _add_suite(root, "mutants", "mutants", [case], output=mutation.reason)
    return _xml_of(root)


def issues_as_junit(issues: Sequence[str]) -> bytes:
    """Return JUnit XML of a suite that did not start: an error for each issue of its files and flags."""
    root = ElementTree.Element("testsuites")
    _add_suite(root, "files and flags", "liftgate-hil", [(each, ERROR, each) for each in issues])
    return _xml_of(root)


def class_names(files: Sequence[Path]) -> list[str]:
    """Return the JUnit class names of the files, in their order, each unique, for their test cases.

    CI servers recognize a case from run to run by it, and sort by its parts. It is the path without suffix, from
    the folder of the shipped scenarios, else from the working folder, else the name with its folder's, however a
    file was named on the command line.
    """
    found: list[str] = []
    for file in files:
        real = Path(os.path.realpath(file)).with_suffix("")
        folders = [Path(os.path.realpath(each)) for each in (data_root() / "configs" / "scenarios", Path.cwd())]
        above = next((each for each in folders if real.is_relative_to(each)), None)
        parts = real.parts[-2:] if above is None else real.relative_to(above).parts
        own = ".".join(_NOT_IN_A_CLASS.sub("_", _text(part)) for part in parts)
        count = sum(name == own or name.startswith(f"{own} (") for name in found)
        found.append(f"{own} ({count + 1})" if count else own)
    return found


def _add_suite(
    root: ElementTree.Element,
    name: str,
    owner: str,
    cases: Sequence[tuple[str, str, str]],
    outcome: Outcome | None = None,
    output: str = "",
) -> None:
    """Add a `testsuite` element with its cases (name, verdict, text), whose class name is `owner`."""
    verdicts = [verdict for _, verdict, _ in cases]
    wall_s, ended = (0.0, time.time()) if outcome is None else (outcome.wall_s, outcome.ended)
    suite = ElementTree.SubElement(
        root,
        "testsuite",
        name=_text(name),
        id=str(len(root)),
        package=owner.rpartition(".")[0],
        timestamp=datetime.datetime.fromtimestamp(ended - wall_s, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        hostname=_text(socket.gethostname()) or "localhost",
        tests=str(len(cases)),
        failures=str(verdicts.count(FAIL)),
        errors=str(verdicts.count(ERROR) + verdicts.count(INCONCLUSIVE)),
        skipped="0",
        time=f"{wall_s:.3f}",
    )
    properties = ElementTree.SubElement(suite, "properties")
    for own, value in [] if outcome is None else properties_of(outcome):
        ElementTree.SubElement(properties, "property", name=_text(own), value=_text(value))
    for own, verdict, said in cases:
        seconds = f"{wall_s / len(cases):.3f}"
        case = ElementTree.SubElement(suite, "testcase", classname=owner, name=_text(own), time=seconds)
        if verdict != PASS:
            kind, text = "failure" if verdict == FAIL else "error", _text(said)
            ElementTree.SubElement(case, kind, type=verdict, message=text).text = text
    ElementTree.SubElement(suite, "system-out").text = _text(output)
    ElementTree.SubElement(suite, "system-err").text = "" if outcome is None else _text(outcome.reason)


def properties_of(outcome: Outcome) -> list[tuple[str, str]]:
    """Return a run's JUnit properties (name, value): vehicle, seed, ECU, recordings, requirements, parameters."""
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


def _xml_of(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    content = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{JUNIT}\n{content}\n'.encode()


def _text(text: str) -> str:
    """Return a text with `?` in place of each character that XML cannot hold."""
    return _NOT_IN_XML.sub("?", text)
