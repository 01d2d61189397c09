"""JUnit XML of a suite conforms to its schema.

`vendor/JUnit.xsd` is a copy of the schema of Apache Ant's reports, github.com/windyroad/JUnit-Schema (commit
cfa434d), under the Apache License 2.0, which stands in `vendor/JUnit.LICENSE`.
"""

from __future__ import annotations

import datetime
import re
import socket
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from xmlschema import XMLSchema10

from liftgate_hil.cli.main import main
from liftgate_hil.config.shipped import data_root
from liftgate_hil.errors import LiftgateError
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing import suite
from liftgate_hil.testing.junit import as_junit, class_names, issues_as_junit
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Case

HEAD = "duration = 0.1\ninitial = 30\n"
EXPECT = '[[expect]]\nname = "{name}"\nalways = "{condition}"\n'


@pytest.fixture(scope="module")
def schema() -> XMLSchema10:
    return XMLSchema10(Path(__file__).parent / "vendor" / "JUnit.xsd")


def cases_in(folder: Path) -> list[Case]:
    """A scenario that passes, and one that fails, is inconclusive and has a note."""
    (folder / "sub").mkdir()
    (folder / "a.toml").write_text(HEAD + EXPECT.format(name="x", condition="time_s > 0"))
    brief = '[[fault]]\nkind = "supply_open"\nfor_s = 0.01\n'
    late = EXPECT.format(name="z", condition="time_s > 0") + 'after = "time_s > 9"\n'
    fails = EXPECT.format(name="y", condition="time_s < 0.05")
    (folder / "sub" / "b.x.toml").write_text(HEAD + brief + fails + late)
    files = [folder / "a.toml", folder / "sub" / "b.x.toml"]
    return suite.cases_of(files, Job(RunRequest()))


def test_the_junit_xml_is_valid_for_every_verdict(
    tmp_path: Path, schema: XMLSchema10, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pass, fail, inconclusive, error, stopped before and while it runs; with mutants; wrong files."""
    cases = cases_in(tmp_path)
    outcomes = [suite.run_case(each) for each in cases]
    outcomes += suite.run_suite(cases, 1, lambda: True)
    outcomes.append(suite.run_case(cases[0], lambda: True))

    def fail(*_: object) -> None:
        raise LiftgateError("the ECU has crashed \x1b[31m & <ended>")

    with monkeypatch.context() as patch:
        patch.setattr(suite, "execute", fail)
        outcomes.append(suite.run_case(cases[0]))
    assert [each.verdict for each in outcomes] == ["pass", "fail", "error", "error", "error", "error"]
    reasons = [each.reason for each in outcomes[2:]]
    assert reasons[0] == reasons[1] == "stopped before it began"
    assert reasons[2].startswith("stopped at ")
    assert "inconclusive" in [each.verdict for each in outcomes[1].expectations]
    for content in (
        as_junit(outcomes),
        as_junit([]),
        as_junit(outcomes, MutationResult(None)),
        issues_as_junit(["a.toml: duration: missing", "\x00 & <"]),
    ):
        schema.validate(content.decode())
    with pytest.raises(Exception, match="name"):  # the schema does refuse something
        schema.validate(as_junit(outcomes).decode().replace("<testsuites>", '<testsuites name="x">'))


def test_the_junit_xml_written_by_the_commands_is_valid(
    tmp_path: Path, schema: XMLSchema10, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(HEAD + EXPECT.format(name="x", condition="time_s > 0"))
    assert main(["test", "a.toml", "--results", "r"]) == 0
    assert main(["judge", "r/a.csv", "--scenario", "a.toml", "--junit", "judged.xml"]) == 0
    assert main(["test", "a.toml", "--junit", "wrong.xml", "--jobs", "0"]) == 2
    capsys.readouterr()
    for name in ("r/junit.xml", "judged.xml", "wrong.xml"):
        schema.validate(name)


def test_a_junit_suite_has_its_time_and_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = datetime.datetime.fromtimestamp(time.time() - 1.0, datetime.UTC)
    root = ElementTree.fromstring(as_junit([suite.run_case(each) for each in cases_in(tmp_path)]))
    for number, each in enumerate(root):
        stamp = str(each.get("timestamp"))
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", stamp)  # Ant's: without a time zone
        began = datetime.datetime.fromisoformat(f"{stamp}+00:00")
        assert before <= began <= datetime.datetime.now(datetime.UTC)
        assert each.get("hostname") == socket.gethostname()
        assert each.get("id") == str(number)
        # In the order that Ant's schema asks for.
        kinds = list(dict.fromkeys(child.tag for child in each))
        assert kinds == ["properties", "testcase", "system-out", "system-err"]
    assert [each.get("package") for each in root] == ["", "sub"]
    assert [case.get("classname") for case in root.iter("testcase")] == ["a", "sub.b_x", "sub.b_x"]
    assert [case.find("failure") is not None for case in root.iter("testcase")] == [False, True, False]
    assert [case.find("error") is not None for case in root.iter("testcase")] == [False, False, True]
    assert "too short to matter" in str(root[1].findtext("system-out"))


def test_class_names_do_not_depend_on_the_form_of_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "suite" / "deep").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    ways = ("suite/deep/a b.toml", "./suite/../suite/deep/a b.toml", tmp_path / "suite/deep/a b.toml")
    assert {class_names([Path(each)])[0] for each in ways} == {"suite.deep.a_b"}
    pack = data_root() / "configs" / "scenarios" / "pack" / "snow.toml"
    assert class_names([pack]) == ["pack.snow"]
    monkeypatch.chdir(tmp_path / "suite" / "deep")
    assert class_names([pack]) == ["pack.snow"]
    assert class_names([tmp_path / "suite" / "c.toml"]) == ["suite.c"]
    assert class_names([Path("a.toml"), Path("a.csv"), Path("b.toml")]) == ["a", "a (2)", "b"]


def test_a_wrong_scenario_file_leaves_no_earlier_junit_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A CI server that shows the JUnit file of an earlier job would show it green."""
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(HEAD + EXPECT.format(name="x", condition="time_s > 0"))
    flags = ("--junit", "a.xml", "--html", "a.html", "--results", "r")
    assert main(["test", "a.toml", *flags]) == 0
    expected = dict(
        each.partition(": ")[::2] for each in str(suite_of("a.xml").findtext("system-out")).splitlines()
    )
    assert expected["x"].startswith("pass (always time_s > 0), margin 0.001 s")
    Path("a.toml").write_text(HEAD + EXPECT.format(name="x", condition="nonsense > 0"))
    assert main(["test", "a.toml", *flags]) == 2
    told = capsys.readouterr().err
    for name in ("a.xml", "r/junit.xml"):
        (error,) = suite_of(name).iter("error")
        assert "nonsense: no such column" in str(error.get("message"))
        assert str(error.get("message"))[:80] in told
        assert suite_of(name).get("errors") == "1"
        assert [each.tag for each in suite_of(name)] == ["properties", "testcase", "system-out", "system-err"]
    assert not any(Path(each).exists() for each in ("a.html", "r/report.html", "r/verdicts.json"))


def suite_of(name: str) -> ElementTree.Element:
    """Return the first suite of a JUnit XML file."""
    return ElementTree.parse(name).getroot()[0]
