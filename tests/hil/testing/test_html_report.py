"""HTML report of a suite: contents, escaping, and size."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from html_page import Page

from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing import html_report
from liftgate_hil.testing.html_report import SuiteReport
from liftgate_hil.testing.outcome import Outcome, not_run
from liftgate_hil.testing.suite import cases_of, run_case

CLOSING = """
description = "closing onto a rod"
requirement = ["LG-12", "LG-7"]
duration = 2.5
initial = 50
[parameters]
most = 100
[[request]]
time = 0.1
action = "close"
[[obstacle]]
angle_deg = 47
stiffness = 20_000
start = "gate_angle_deg < 49.9"
[[fault]]
kind = "spring_weak"
where = "left"
factor = 0.75
start = 0.2
end = 2
[[profile]]
quantity = "supply_voltage_v"
points = [[0, 12.5], [2, 11]]
[[expect]]
name = "soft"
always = "pinch_force_n < $most"
[[expect]]
name = "reverses"
eventually = "gate_rate_degps > 1"
after = "pinch_force_n > 5"
within_s = 0.5
for_s = 0.05
[[expect]]
name = "says so"
eventually = "DriveCommand.LeftDirection == 1"
after = "pinch_force_n > 5"
[[expect]]
name = "waits for ever"
eventually = "gate_rate_degps > 1"
after = "pinch_force_n > 5000"
"""
RESTS = 'duration = 0.2\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n'
HOSTILE = '<script>alert("1")</script>" onload="x" \u202e\\u0000 & ]]> </style>'
ORIGIN = Provenance("liftgate-hil test <x>", "2026-01-01T00:00:00+00:00", {}, {"numpy": "2"})


def outcomes_of(folder: Path, **files: str) -> list[Outcome]:
    """Write scenario files (name, content) to a folder, and run them one after the other."""
    for name, content in files.items():
        (folder / f"{name}.toml").write_text(content)
    template = Job(RunRequest(), is_summarized=True)
    paths = [folder / f"{name}.toml" for name in files]
    return [run_case(case) for case in cases_of(paths, template)]


def html_of(outcomes: Sequence[Outcome]) -> str:
    report = SuiteReport()
    return report.html([report.take(each) for each in outcomes], ORIGIN)


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> list[Outcome]:
    return outcomes_of(tmp_path_factory.mktemp("suite"), closing=CLOSING, rests=RESTS)


@pytest.fixture(scope="module")
def page(outcomes: list[Outcome]) -> Any:
    return Page(html_of(outcomes))


def test_an_html_report_is_one_file_without_scripts_and_external_links(page: Any) -> None:
    page.check_alone()
    assert page.links


def test_an_html_report_begins_with_a_summary_and_ends_with_its_provenance(page: Any) -> None:
    head = page.text[: page.text.index("Not passed")]
    for said in (
        "Test report: fail", "5, of which 3 pass, 1 fail, 1 inconclusive, 0 error", "20.0 % of the expectations",
        "2: 1 pass, 1 fail", "reference", "suv", "liftgate.toml", "free", "model time",
    ):  # fmt: skip
        assert said in head
    tail = page.text[page.text.index("Provenance") :]
    for said in ("liftgate-hil test <x>", "2026-01-01", "numpy 2"):
        assert said in tail
        assert said not in head.partition("verdict")[2]
    assert len(re.findall(r"\b[0-9a-f]{64}\b", tail)) == 5  # vehicle, rig, dbc, two scenarios


def test_requirements_link_to_scenarios_and_expectations(page: Any) -> None:
    matrix = page.text[page.text.index("Requirements") : page.text.index("Force limits")]
    first, second, none = (matrix.index(each) for each in ("LG-12", "LG-7", "none"))
    assert first < second < none
    for part in (matrix[first:second], matrix[second:none]):
        places = [part.index(each) for each in ("soft", "reverses", "says so", "waits for ever")]
        assert places == sorted(places)
    assert "rests" in matrix[none:]
    assert matrix[first - 5 : first].strip() == "fail"  # of a requirement the worst counts
    assert matrix[none - 5 : none].strip() == "pass"
    assert {"#s1", "#s1e2", "#s2e1"} <= set(page.links)


def test_a_force_limit_is_listed_with_the_regulation_of_equal_value(page: Any, tmp_path: Path) -> None:
    part = page.text[page.text.index("Force limits") : page.text.index("Scenarios")]
    assert "UN R21 (1.5 and 5.8)" in part
    assert "FMVSS 118" in part
    assert "closing.toml: soft" in part
    assert "reverses" not in part  # that force is a trigger
    other = RESTS + '[[expect]]\nname = "bus"\nalways = "77 > BenchStatus.PinchForce"\n'
    other += '[[expect]]\nname = "met"\neventually = "pinch_force_n > 6"\n'
    other += '[[expect]]\nname = "held"\nnever = "pinch_force_n < -7"\n'
    (outcome,) = outcomes_of(tmp_path, other=other)
    told = Page(html_of([outcome])).text
    assert "77 N none of the rules listed here" in told
    assert not re.search(r"\b[67] N none of the rules", told)  # a force that shall be exceeded is no limit
    (outcome,) = outcomes_of(tmp_path, rests=RESTS)
    assert "Force limits" not in Page(html_of([outcome])).text


def test_a_limit_on_the_time_over_a_force_uses_the_vehicles_limit(tmp_path: Path) -> None:
    timed = '[set]\n"gate.pinch_limit" = 150\n' + RESTS.split("\n", 1)[1]
    timed = "duration = 0.2\n" + timed.replace("gate_angle_deg < 1", "pinch_over_limit_s < 0.75")
    told = Page(html_of(outcomes_of(tmp_path, timed=timed))).text
    assert "150 N EN 12453, building doors" in told
    assert "timed.toml: rests (time over it)" in told


def test_included_files_are_listed_as_sources(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text("[parameters]\nmost = 1\n")
    including = 'include = ["bench.toml"]\n' + RESTS
    (outcome,) = outcomes_of(tmp_path, including=including)
    sources = outcome.case.plan.sources
    assert sources["included 1"].path.endswith("bench.toml")
    assert sources["included 1"].sha256 in Page(html_of([outcome])).text


def test_scenario_names_in_tables_omit_their_common_folder(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    found = outcomes_of(tmp_path, **{"a": RESTS, "x/b": RESTS})
    page = Page(html_of(found))
    matrix = page.text[page.text.index("Requirements") : page.text.index("Scenarios")]
    assert re.search(r" rests [\d.]+ deg a\.toml ", matrix)
    assert re.search(r" rests [\d.]+ deg x/b\.toml", matrix)
    for name in ("a.toml", "x/b.toml"):
        (outcome,) = (each for each in found if each.case.file.endswith(name))
        assert outcome.case.file in page.text


def test_a_scenario_is_described_in_words(page: Any, outcomes: list[Any]) -> None:
    part = page.text[page.text.index("closing onto a rod") : page.text.index("What is expected")]
    for said in (
        "LG-12, LG-7", "most = 100", "starts at 50 deg, seed 0", "at 0.1 s: close is requested",
        "profile of supply_voltage_v: 12.5 V at 0 s, 11 V at 2 s; interpolated linearly",
        "obstacle at 47 deg, 1 m from the hinge, 20000 N/m, met while closing; from gate_angle_deg < 49.9",
        f"(the condition came true at {outcomes[0].result.condition_times['gate_angle_deg < 49.9']:.3f} s)",
        "fault spring_weak, left, factor = 0.75: from 0.2 s until 2 s (the drive's spring has less force)",
    ):  # fmt: skip
        assert said in part


def test_an_expectation_is_shown_with_formula_numbers_and_pictures(page: Any, outcomes: list[Outcome]) -> None:
    soft, reverses, _, waits = outcomes[0].expectations
    text = page.text
    assert (soft.verdict, reverses.verdict) == ("fail", "pass")
    assert soft.margin is not None
    assert f"{soft.margin:.4g} N of pinch_force_n < 100" in text
    assert "always pinch_force_n < 100" in text
    assert "eventually gate_rate_degps > 1 for 0.05 s without interruption" in text
    assert reverses.window_s is not None
    assert f"triggered {reverses.window_s[0]:g} s" in text
    assert f"violated {soft.time_s:g} s" in text
    assert f"margin {soft.margin:.4g} N" in text
    assert "== 1 (open)" in text  # as the database calls it
    assert f"in the 0.05 s up to {reverses.margin_time_s:.6g} s" in text
    assert waits.verdict == "inconclusive"
    assert "The whole run: the window never opened." in text


# 102: both 102 plus and less the margin lie in the bin of the overview that holds the peak.
@pytest.mark.parametrize(("most", "verdict"), [(100.0, "fail"), (102.0, "fail"), (107.5, "fail"), (200.0, "pass")])
def test_a_margin_is_drawn_from_the_limit_to_the_peak(most: float, verdict: str, tmp_path: Path) -> None:
    (outcome,) = outcomes_of(tmp_path, a=CLOSING.replace("most = 100", f"most = {most}"))
    assert outcome.expectations[0].verdict == verdict
    pictures = re.findall(r"<svg.*?</svg>", html_of([outcome]), re.DOTALL)[:2]
    assert len(pictures) == 2  # of the window, and closely
    for svg in pictures:
        curve = "".join(re.findall(r'class="k k0(?: b)?" d="([^"]*)"', svg))
        peak = min(float(each) for each in re.findall(r"[\d.]+ (-?[\d.]+)(?=[LMZ]|$)", curve))
        (limit,) = re.findall(r'class="limit" d="M[\d.]+ ([\d.]+)H', svg)
        (ends,) = re.findall(r'class="margin" d="M[\d.]+ ([\d.]+)V([\d.]+)"', svg)
        assert [float(each) for each in ends] == [float(limit), peak]


def test_the_hold_time_of_a_condition_is_drawn(outcomes: list[Outcome]) -> None:
    reverses = outcomes[0].expectations[1]
    assert reverses.window_s is not None
    assert reverses.margin_time_s is not None
    found = html_of(outcomes)
    section = found[found.index('id="s1e2"') : found.index('id="s1e3"')]
    (begin, end) = re.findall(r'd="M([\d.]+) [\d.]+v8v-4H([\d.]+)v-4v8"', section)[0]
    edges = [float(each) for each in re.findall(r'class="edge" d="M([\d.]+)', section)]
    pixels = (edges[1] - edges[0]) / (reverses.window_s[1] - reverses.window_s[0])
    assert float(end) - float(begin) == pytest.approx(0.05 * pixels, abs=0.2)
    into = reverses.margin_time_s - reverses.window_s[0]
    assert float(end) - edges[0] == pytest.approx(into * pixels, abs=0.2)


def test_time_itself_is_drawn_only_if_a_condition_has_no_other_signal(tmp_path: Path) -> None:
    late = RESTS.replace("gate_angle_deg < 1", "gate_angle_deg < 1 or time_s < 0.1")
    alone = RESTS.replace("gate_angle_deg < 1", "time_s < 1")
    first, second = outcomes_of(tmp_path, late=late, alone=alone)
    for outcome, drawn in ((first, False), (second, True)):
        assert ("time_s [s]" in Page(html_of([outcome])).text) == drawn


def test_passed_expectations_are_folded_and_others_are_open(page: Any) -> None:
    assert re.search(r'<details id="s1e1" open>', page.html)
    assert re.search(r'<details id="s1e2">', page.html)
    assert re.search(r'<details id="s1e4" open>', page.html)
    assert page.tags.count("svg") >= 5


def test_texts_from_files_are_escaped_in_reports(tmp_path: Path) -> None:
    name = HOSTILE.replace('"', '\\"').replace("\\u0000", "")
    content = (
        f'description = "{name}"\nrequirement = ["{name}", "{"R" * 5000}"]\nduration = 0.1\n'
        f'[[expect]]\nname = "{name}"\nnever = "gate_angle_deg < 1"\n'
        f'[[expect]]\nname = "{"long " * 4000}"\nalways = "gate_angle_deg < 1"\n'
    )
    found = html_of(outcomes_of(tmp_path, **{"a<b>&'c": content}))
    page = Page(found)
    page.check_alone()
    assert page.text.count('<script>alert("1")</script>" onload="x"') >= 4
    assert "\u202e" not in found
    assert "a<b>&'c.toml" in page.text
    assert len(found) < 150_000
    assert found.count("<style>") == found.count("</style>") == 1


def test_a_scenario_that_could_not_run_is_reported(outcomes: list[Outcome]) -> None:
    lost = not_run(outcomes[1].case, "stopped before it began")
    text = Page(html_of([outcomes[0], lost])).text
    assert "Incomplete: stopped early, and 1 scenario did not end." in text
    assert "Test report: error" in text


def test_the_total_size_of_pictures_is_limited(outcomes: list[Outcome], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html_report, "MOST_PASSED", 30_000)
    many = [outcomes[1]] * 40 + [outcomes[0]] * 5 + [outcomes[1]] * 40
    many = [replace(each, case=replace(each.case, file=f"{k}.toml")) for k, each in enumerate(many)]
    found = html_of(many)
    assert "expectations have none." in Page(found).text
    passed = re.findall(r'<details id="s\d+e\d+">.*?</details>', found, re.DOTALL)
    pictures = [each for one in passed for each in re.findall(r"<figure>.*?</figure>", one, re.DOTALL)]
    assert 10_000 < sum(map(len, pictures)) <= 30_000
    others = re.findall(r'<details id="s\d+e\d+" open>.*?</details>', found, re.DOTALL)
    assert len(others) == 5 * 2
    assert all("<svg" in each for each in others)  # what does not pass keeps its own


def test_trace_summaries_are_discarded_once_drawn(outcomes: list[Outcome]) -> None:
    result = outcomes[0].result
    assert result is not None
    assert result.trace_summaries
    kept = SuiteReport().take(outcomes[0]).result
    assert kept is not None
    assert not kept.trace_summaries
