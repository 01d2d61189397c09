"""Summaries, heat maps, comparisons and report pages of hand-made campaign results."""

from __future__ import annotations

import errno
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from html_page import Page
from scipy import stats

from liftgate_hil.campaigns.adaptive import Evaluated, Probability, Worst
from liftgate_hil.campaigns.probability.subset_simulation import SubsetEstimate
from liftgate_hil.campaigns.reporting import adaptive_sections
from liftgate_hil.campaigns.reporting.combined import PartResult, by_value, combined_report
from liftgate_hil.campaigns.reporting.comparison import comparison_of, comparison_section
from liftgate_hil.campaigns.reporting.heat_map import cells_of, heat_map
from liftgate_hil.campaigns.reporting.report import heat_section, incomplete, interval, report, worst
from liftgate_hil.campaigns.reporting.summary import CampaignSummary, summary_of
from liftgate_hil.campaigns.search.worst_search import SearchEnd
from liftgate_hil.campaigns.store import StoreError
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.page import page

HOSTILE = '<script>alert("1")</script> & \' $x^2 \\frac{ "'
PROVENANCE = Provenance("liftgate-hil campaign 'a & b'", "2026-01-02T03:04:05+00:00")
NAN = math.nan
Values = Sequence[float | None]


def _sign(margin: float | None) -> str:
    return "inconclusive" if margin is None or math.isnan(margin) else "pass" if margin >= 0.0 else "fail"


def write(
    path: Path, verdicts: Sequence[str], varied: dict[str, Any], margins: dict[str, Values], **more: Any
) -> Path:
    """Write a file of campaign results, and return its path."""
    count = len(verdicts)
    columns: dict[str, Any] = {"variant": [f"{k:032x}" for k in range(count)]}
    columns |= {name: pa.array(each, pa.float64()) for name, each in varied.items()}
    columns["verdict"] = list(verdicts)
    judged = more.get("judged", {name: [_sign(one) for one in each] for name, each in margins.items()})
    columns |= {f"verdict.{name}": pa.array(each, pa.string()) for name, each in judged.items()}
    columns |= {f"margin.{name}": pa.array(each, pa.float64(), from_pandas=True) for name, each in margins.items()}
    force = more.get("force", np.zeros(count))
    columns["peak_pinch_force_n"] = pa.array(force, pa.float64(), from_pandas=True)
    columns["error"] = pa.array(more.get("errors", [None] * count), pa.string())
    pq.write_table(pa.table(columns), path)
    return path


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write(
        tmp_path / "results.parquet",
        ["pass", "fail", "fail", "error", "inconclusive", "fail", "error", "error"],
        {"rod": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]},
        {
            "soft": [4.0, -1.0, 2.0, None, None, -3.0, None, None],
            "far": [1.0, 1.0, -2.0, None, 0.0, 5.0, None, None],
        },
        force=[0.0, 120.0, 80.0, NAN, 10.0, 300.0, NAN, NAN],
        errors=[None, None, None, "it broke", None, None, "no such", "it broke"],
    )


def test_verdicts_margins_and_errors_are_counted(small: Path) -> None:
    found = summary_of(small, ["rod"], ["soft", "far"], margin_units=("N", ""))
    assert found.count == 8
    assert found.counts == {"pass": 1, "inconclusive": 1, "fail": 3, "error": 3}
    soft, far = found.expectations
    assert soft == ("soft", 2, 2, 4, -3.0, f"{5:032x}", "N")
    assert far == ("far", 4, 1, 3, -2.0, f"{2:032x}", "")
    assert list(found.errors) == [("it broke", 2), ("no such", 1)]  # the most frequent first


def test_the_report_is_about_the_expectation_that_fails_most_or_the_chosen_one(small: Path) -> None:
    assert summary_of(small, ["rod"], ["soft", "far"]).driver == "margin.soft"
    found = summary_of(small, ["rod"], ["soft", "far"], "far")
    assert found.driver == "margin.far"
    np.testing.assert_array_equal(found.result, [1.0, 1.0, -2.0, NAN, 0.0, 5.0, NAN, NAN])


def test_the_report_is_about_the_pinch_force_where_nothing_fails(tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["pass"] * 3, {"rod": [1, 2, 3]}, {"soft": [1, 2, 3]}, force=[5.0, 9.0, 7.0])
    found = summary_of(path, ["rod"], ["soft"])
    assert found.driver == "peak_pinch_force_n"
    assert [each.force for each in found.worst] == [9.0, 7.0, 5.0]


def test_the_worst_variants_come_first_and_variants_without_a_result_are_not_listed(small: Path) -> None:
    worst = summary_of(small, ["rod"], ["soft", "far"]).worst
    assert [each.margin for each in worst] == [-3.0, -1.0, 2.0, 4.0]
    assert worst[0] == (f"{5:032x}", (6.0,), "fail", -3.0, 300.0)


def test_only_the_ten_worst_variants_are_listed_with_ties_in_file_order(tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["fail"] * 40, {"rod": range(40)}, {"soft": [-1.0] * 20 + [-2.0] * 20})
    assert [each.values[0] for each in summary_of(path, ["rod"], ["soft"]).worst] == list(range(20, 30))


def test_a_name_with_dots_or_brackets_is_not_taken_for_another_one_that_it_begins_with(tmp_path: Path) -> None:
    varied = {"gate.gravity_point[0]": [0.1, 0.2], "gate": [5.0, 6.0]}
    path = write(tmp_path / "r", ["pass", "fail"], varied, {"a": [1.0, 2.0], "a.b": [3.0, -4.0]})
    found = summary_of(path, list(varied), ["a", "a.b"])
    assert found.values["gate.gravity_point[0]"].tolist() == [0.1, 0.2]
    assert [each.least for each in found.expectations] == [1.0, -4.0]


def test_results_without_any_margin_can_be_summarized(tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["error"] * 3, {"rod": [1, 2, 3]}, {"soft": [None] * 3}, force=[NAN] * 3)
    found = summary_of(path, ["rod"], ["soft"])
    assert math.isnan(found.expectations[0].least)
    assert found.worst == []


def test_a_heat_map_cell_has_the_worst_result_of_its_variants() -> None:
    across, down = np.array([1.0, 1.0, 2.0, 2.0, 2.0]), np.array([5.0, 5.0, 5.0, 7.0, 7.0])
    results = np.array([3.0, 9.0, 4.0, NAN, 6.0])
    high = cells_of(across, down, results, is_low_worst=False)
    assert (high.rows, high.columns) == (("5", "7"), ("1", "2"))
    np.testing.assert_array_equal(high.worst, [[9.0, 4.0], [NAN, 6.0]])
    low = cells_of(across, down, results, is_low_worst=True)
    np.testing.assert_array_equal(low.worst, [[3.0, 4.0], [NAN, 6.0]])


@pytest.mark.parametrize(
    ("spaced", "low", "high"),
    [(np.linspace, 5.0, 10.0), (np.linspace, -3.0, 3.0), (np.geomspace, 1.0, 1000.0)],  # as wide in the logarithm
)
def test_heat_map_cells_of_continuous_values_hold_each_variant_once(spaced: Any, low: float, high: float) -> None:
    generator = np.random.default_rng(1)
    across = generator.permutation(spaced(low, high, 500))
    results = generator.random(500)
    cells = cells_of(across, generator.uniform(-1.0, 1.0, 500), results, is_low_worst=False)
    assert cells.worst.shape == (10, 10)
    column = np.clip(np.digitize(across, spaced(low, high, 11)) - 1, 0, 9)
    for k in range(10):
        own = results[column == k]
        assert np.nanmax(cells.worst[:, k], initial=-1.0) == max(own, default=-1.0)


def test_a_value_that_is_uniform_from_0_has_classes_of_equal_width() -> None:
    x = np.random.default_rng(1).uniform(0.0, 10.0, 500)
    assert np.isfinite(cells_of(x, np.zeros(500), np.ones(500), False).worst).mean() > 0.9


def test_heat_map_cells_are_named_after_distinct_class_middles() -> None:
    cells = cells_of(np.linspace(0.0, 20.0, 100), np.linspace(0.0, 1.0, 100) // 0.5, np.ones(100), False)
    assert cells.columns == tuple(f"{each:g}" for each in range(1, 20, 2))
    close = cells_of(np.array([1234567.0, 1234568.0]), np.zeros(2), np.ones(2), False)
    assert len(set(close.columns)) == 2


def cell_styles(good: float, bad: float, *values: float) -> list[tuple[bool, str, str]]:
    """Return for each cell of a heat map whether it is framed, its colour and its text."""
    cells = cells_of(np.arange(float(len(values))), np.zeros(len(values)), np.array(values), False)
    html = heat_map(cells, "x", "y", good, bad, 1)
    return [
        (bool(a), b, c)
        for a, b, c in re.findall(r'<td( class="over")? style="background:#(\w{6})">([^<]*)<', html)
    ]


def test_heat_map_cells_go_from_green_to_yellow_and_are_red_and_framed_only_beyond_the_limit() -> None:
    assert cell_styles(50.0, 100.0, 20.0, 50.0, 75.0, 100.0, 100.1) == [
        (False, "91cf60", "20.0"),
        (False, "91cf60", "50.0"),
        (False, "c8de80", "75.0"),
        (False, "ffeea0", "100.0"),
        (True, "f47b5a", "100.1"),
    ]
    low_is_bad = [each[0] for each in cell_styles(10.0, 0.0, -0.1, 0.0, 5.0, 20.0)]
    assert low_is_bad == [True, False, False, False]


def test_a_heat_map_marks_cells_without_a_variant_and_escapes_its_labels() -> None:
    cells = cells_of(np.array([1.0, 2.0]), np.array([1.0, 2.0]), np.array([1.0, 2.0]), False)
    html = heat_map(cells, HOSTILE, HOSTILE, 0.0, 1.0)
    assert html.count('<td class="none">·</td>') == 2
    assert "<script" not in html
    assert Page(html).text.count("<script>alert") == 2


def many(
    tmp_path: Path, name: str = "soft", count: int = 240, limit: float = 100.0, force_limit: float | None = None
) -> CampaignSummary:
    """Return the summary of a grid of 6 × 40 variants whose force rises with both varied values."""
    rod = np.repeat(np.arange(6.0), 40)[:count]
    angle = np.tile(np.linspace(10.0, 70.0, 40), 6)[:count]
    force = 20.0 * rod + angle
    verdicts = ["fail" if each > limit else "pass" for each in force]
    path = write(
        tmp_path / "many.parquet", verdicts, {"rod": rod, "angle": angle}, {name: limit - force}, force=force
    )
    return summary_of(path, ["rod", "angle"], [name], force_limit=force_limit)


def made_report(summary: CampaignSummary, more: Sequence[str] = (), title: str = "Campaign: trap") -> str:
    return report(title, summary, {"rod": "N/m", "angle": "deg"}, "out/a & b", PROVENANCE, more)


def tile_with(html: str, words: str) -> str:
    """Return the CSS class of the tile with a label."""
    (found,) = re.findall(rf'<div class="tile (\w*)"><b>[^<]*</b><span>[^<]*{re.escape(words)}', html)
    return str(found)


def test_a_force_is_coloured_good_or_bad_only_by_a_judged_limit(tmp_path: Path) -> None:
    """Otherwise a green "none fails" would stand beside a red force that no expectation judges."""
    html = made_report(many(tmp_path, limit=400.0))
    assert "None of 240 variants fails." in Page(html).text
    assert tile_with(html, "largest pinch force; no single limit is judged") == ""
    assert tile_with(html, "press with more than 100 N, for reference only: UN R21 5.8, car windows") == ""
    assert 'class="over"' not in html
    assert "line: 100 N, for reference only" in html
    html = made_report(many(tmp_path, limit=400.0, force_limit=400.0))
    assert tile_with(html, "largest pinch force; judged: at most 400 N") == "fine"
    assert "for reference only" not in html
    html = made_report(many(tmp_path, limit=100.0, force_limit=100.0))
    assert tile_with(html, "judged: at most 100 N") == "bad"
    assert 'class="over"' in html
    assert "framed: over the limit of 100 N" in html


def test_judged_results_stand_before_values_shown_for_reference(tmp_path: Path) -> None:
    for html in (
        made_report(many(tmp_path)),
        combined_report("All", "x", [part(many(tmp_path), "Rods")], PROVENANCE, True, "reference"),
    ):
        places = [
            html.index(each) for each in ("fail: ", "smallest margin", "Largest pinch force", "explains alone")
        ]
        assert places == sorted(places)


def test_values_have_their_units_everywhere_in_the_report(tmp_path: Path) -> None:
    shown = Page(made_report(many(tmp_path))).text
    assert "N at 5 N/m" in shown  # the sentence
    assert "rod [N/m] ↓" in shown  # the heat map
    assert re.search(r"rod \d+ % \S+ … \S+ 5 N/m", shown)  # where the force is highest
    assert "variant rod [N/m] angle [deg] verdict" in shown  # the worst ones


def test_long_names_have_line_breaks_so_that_tables_fit_the_page(tmp_path: Path) -> None:
    name = "environment.ambient_temperature_degc"
    varied = {name: np.repeat([1.0, 2.0], 20), "rod": np.tile(np.arange(20.0), 2)}
    path = write(tmp_path / "r", ["pass"] * 40, varied, {}, force=np.arange(40.0))
    html = made_report(summary_of(path, list(varied), []))
    heads = [each for each in re.findall(r"<t[hd][^>]*>([^<]*(?:<wbr>[^<]*)*)</t[hd]>", html) if "ambient" in each]
    assert heads
    assert all("environment.<wbr>ambient_<wbr>temperature_<wbr>degc" in each for each in heads)


def test_a_report_is_one_self_contained_page(tmp_path: Path) -> None:
    shown = Page(made_report(many(tmp_path)))
    shown.check_alone()
    assert "angle [deg]" in shown.text
    assert "240 variants" in shown.text
    assert (
        f"{(20.0 * np.repeat(np.arange(6), 40) + np.tile(np.linspace(10, 70, 40), 6) > 100).sum()} of 240"
        in shown.text
    )


def test_a_report_escapes_hostile_names_and_errors(tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["error"], {"rod": [1.0]}, {"soft": [None]}, force=[NAN], errors=[HOSTILE])
    for html in (
        made_report(many(tmp_path, HOSTILE), title=HOSTILE),
        made_report(summary_of(path, ["rod"], ["soft"])),
    ):
        shown = Page(html)
        shown.check_alone()
        assert HOSTILE in shown.text.replace("\xa0", " ")


@pytest.mark.parametrize("verdict", ["pass", "fail", "error", "inconclusive"])
def test_a_report_of_a_single_variant_is_a_self_contained_page(verdict: str, tmp_path: Path) -> None:
    margin = {"pass": 1.0, "fail": -1.0}.get(verdict)
    force = [NAN if verdict == "error" else 3.0]
    path = write(tmp_path / "r", [verdict], {"rod": [1.0]}, {"soft": [margin]}, force=force)
    Page(made_report(summary_of(path, ["rod"], ["soft"]))).check_alone()


def test_the_report_of_an_incomplete_campaign_without_variation_says_that_it_is_incomplete(tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["pass"], {}, {})
    shown = Page(made_report(summary_of(path, [], []), [incomplete(False)]))
    shown.check_alone()
    assert "Incomplete: variants that were not evaluated stand as errors. Go on with --resume." in shown.text
    assert incomplete(True) == ""


def test_a_report_has_the_command_that_replays_the_worst_variant(tmp_path: Path) -> None:
    summary = many(tmp_path)
    line = f"liftgate-hil campaign 'out/a & b' --replay {summary.worst[0].variant[:12]} --record worst.mf4"
    assert line in Page(worst(summary, {}, "out/a & b")).text


@pytest.mark.parametrize("is_whole", [True, False])
def test_an_empty_cell_of_a_heat_map_is_explained(tmp_path: Path, is_whole: bool) -> None:
    x = {"a": np.array([0.0, 0.0, 1.0, 1.0]), "b": np.array([0.0, 1.0, 0.0, 1.0])}
    force = np.array([10.0, 20.0, 30.0, 40.0 if is_whole else 0.0])
    summary = summary_of(write(tmp_path / "r", ["pass"] * 4, x, {}, force=force), list(x), [])
    html = heat_section(summary, {})
    assert "Largest pinch force" in html
    assert (" ·: no variant, or nothing was pinched or known." in html) != is_whole


def test_heat_maps_show_the_two_values_that_explain_most(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    x = {name: generator.integers(0, 4, 300).astype(float) for name in ("idle", "strong", "weak")}
    force = 10.0 * x["strong"] + 3.0 * x["weak"]
    summary = summary_of(write(tmp_path / "r", ["pass"] * 300, x, {}, force=force), list(x), [])
    html = heat_section(summary, {})
    assert "strong" in html
    assert "weak" in html
    assert "idle" not in html


def test_one_varied_value_has_no_heat_map(tmp_path: Path) -> None:
    varied = {"rod": np.arange(30.0), "angle": np.full(30, 5.0)}
    path = write(tmp_path / "r", ["pass"] * 30, varied, {}, force=np.arange(30.0))
    assert heat_section(summary_of(path, list(varied), []), {}) == ""


@pytest.mark.parametrize(("failed", "count"), [(0, 10), (3, 10), (10, 10), (1, 5000)])
def test_the_interval_of_a_failure_share_is_that_of_clopper_and_pearson(failed: int, count: int) -> None:
    expected = stats.binomtest(failed, count).proportion_ci(method="exact")
    shown = interval(failed, count).removesuffix(" %")
    low, _, high = shown.partition(" to ")
    assert float(low) == pytest.approx(100.0 * expected.low, rel=0.05)
    assert float(high) == pytest.approx(100.0 * expected.high, rel=0.05)
    assert "e" not in shown
    assert interval(0, 0) == "unknown"


def part(summary: CampaignSummary, title: str, is_complete: bool = True) -> PartResult:
    return PartResult(title, summary, {"angle": "deg"}, f"out/{title}", "about", is_complete)


def test_a_combined_report_is_one_self_contained_page_with_the_findings_of_each_part(tmp_path: Path) -> None:
    summary = many(tmp_path, HOSTILE)
    parts = [part(summary, "Rods"), part(summary, "Other <b>rods</b>")]
    shown = Page(combined_report("All & all", "of <i>both</i>", parts, PROVENANCE, has_all=True, ecu="reference"))
    shown.check_alone()
    assert "480 variants" in shown.text
    assert "Other <b>rods</b>: what drives it" in shown.text
    assert "Incomplete" not in shown.text


@pytest.mark.parametrize("titles", [("Rods", "Rods"), ("Rods 1", "rods-1"), ("—", "…")])
def test_parts_with_equal_titles_make_a_valid_page(titles: tuple[str, str], tmp_path: Path) -> None:
    parts = [part(many(tmp_path), each) for each in titles]
    Page(combined_report("All", "", parts, PROVENANCE, True, "reference")).check_alone()


@pytest.mark.parametrize(("has_all", "is_complete"), [(False, True), (True, False)])
def test_a_combined_report_says_that_it_is_incomplete(has_all: bool, is_complete: bool, tmp_path: Path) -> None:
    path = write(tmp_path / "r", ["pass"], {}, {})
    parts = [part(summary_of(path, [], []), "Rods", is_complete)]
    assert "Incomplete" in Page(combined_report("All", "of both", parts, PROVENANCE, has_all, "reference")).text


def test_forces_are_tabulated_by_the_value_that_explains_most_of_them(tmp_path: Path) -> None:
    shown = Page(by_value(many(tmp_path), {"rod": "N/m"})).text
    assert "Largest pinch force by rod" in shown
    assert "rod [N/m]" in shown
    assert "5 40 140 N 167 N 170 N 100 %" in shown
    assert "100 N, for reference only" in shown
    both = Page(by_value(many(tmp_path, force_limit=160.0), {"rod": "N/m"})).text
    assert "largest over 160 N over 100 N" in both
    assert "5 40 140 N 167 N 170 N 17.5 % 100 %" in both


VERDICTS = ["pass", "pass", "fail", "fail", "inconclusive"]


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    varied = {"rod": [1, 2, 3, 4, 5]}
    margins = {"a.b": [1.0, 2.0, -1.0, -2.0, None], "c": [1.0, 2.0, 3.0, 4.0, None]}
    others = {"a.b": [1.0, 2.5, 0.5, -2.0, None], "c": [1.0, 12.0, 3.0, 4.125, None]}
    other_verdicts = ["pass", "pass", "pass", "fail", "inconclusive"]
    return (
        write(tmp_path / "one.parquet", VERDICTS, varied, margins),
        write(tmp_path / "two.parquet", other_verdicts, varied, others),
    )


def test_a_comparison_lists_changed_verdicts_first_then_the_largest_differences(two: tuple[Path, Path]) -> None:
    found = comparison_of(*two, ["rod"], ["a.b", "c"], ("one", "two"))
    assert found.differing["rod"].to_pylist() == [3.0, 2.0, 4.0]
    assert found.differing["largest_difference"].to_pylist() == [1.5, 10.0, 0.125]
    assert found.differing["against.margin.a.b"].to_pylist() == [0.5, 2.5, -2.0]
    assert found.to_dict() == {
        "ecus": ["one", "two"],
        "variants": 5,
        "differing": 3,
        "verdicts": {"fail / fail": 1, "fail / pass": 1, "inconclusive / inconclusive": 1, "pass / pass": 2},
    }


def test_equal_results_have_no_differences(two: tuple[Path, Path]) -> None:
    found = comparison_of(two[0], two[0], ["rod"], ["a.b", "c"], ("one", HOSTILE))
    assert found.differing.num_rows == 0
    shown = Page(comparison_section(found, {"rod": "N/m"})).text
    assert "have the same verdicts and margins in all 5 variants" in shown


def test_the_section_of_a_comparison_makes_a_self_contained_page(two: tuple[Path, Path]) -> None:
    found = comparison_of(*two, ["rod"], ["a.b", "c"], ("one", HOSTILE))
    shown = Page(page("Two", "", [comparison_section(found, {"rod": "N/m"})]))
    shown.check_alone()
    assert "Of 5 variants 3 differ, 1 in the verdict." in shown.text
    assert HOSTILE in shown.text


HISTORY = [
    Evaluated((1.0,), 4.0, 1, False),
    Evaluated((2.0,), NAN, 2, False),
    Evaluated((3.0,), -1.5, 3, True),
    Evaluated((4.0,), -0.5, 4, True),
    Evaluated((5.0,), 0.0, 5, True),
]


def end_of(budget: int) -> SearchEnd:
    fields = dict.fromkeys(SearchEnd.__annotations__, 0)
    return SearchEnd(**{**fields, "evaluations": budget, "reason": "budget used", "evidence": "none"})  # type: ignore[arg-type]


def test_a_search_result_has_its_smallest_margin_and_its_first_failure() -> None:
    found = adaptive_sections.worst_result(
        Worst(end_of(5), HISTORY, HISTORY[:2]), "soft", "abc", ["rod"]
    ).to_dict()
    assert (found["margin"], found["values"], found["found_after"]) == (-1.5, {"rod": 3.0}, 3)
    assert (found["first_failure_after"], found["failures"]) == (3, 3)
    assert found["random"] == {"evaluations": 2, "margin": 4.0, "first_failure_after": None, "failures": 0}


@pytest.mark.parametrize("history", [HISTORY, HISTORY[1:2], []])
def test_a_page_with_the_section_of_a_worst_case_search_is_self_contained(history: list[Evaluated]) -> None:
    own = adaptive_sections.worst_section(Worst(end_of(4), history, HISTORY), HOSTILE, {"rod": "N/m"}, "run <it>")
    Page(page("Worst", "", [own])).check_alone()


def estimate(probability: float, **more: Any) -> SubsetEstimate:
    own = {"low": 0.5 * probability, "high": 2e-4, "variation": 0.2, "evaluations": 900, "unknown": 3}
    rest = {"bounded": False, "method": "importance sampling", "levels": ()}
    return SubsetEstimate(probability, **{**own, **rest, **more})


def test_a_probability_is_reported_with_its_interval_and_the_number_of_plain_draws_it_replaces() -> None:
    own = Probability(estimate(1e-4), np.zeros((2, 3)), 100)
    shown = Page(page("P", "", [adaptive_sections.probability_section(own, HOSTILE)]))
    shown.check_alone()
    assert "fails with a probability of 0.0001 (95 %: 5e-05 to 0.0002)" in shown.text
    assert "249,975 plain random draws" in shown.text
    assert "1,000, 100 of them searching for pockets" in shown.text


def test_a_probability_without_an_observed_failure_is_reported_as_a_bound() -> None:
    own = Probability(estimate(0.0, bounded=True, variation=math.inf), np.zeros((0, 3)), 100)
    assert "its probability of failure is below 0.0002" in adaptive_sections.probability_section(own, "soft")
    assert adaptive_sections.probability_result(own, "soft").to_dict()["variation"] is None


def test_expectations_without_a_margin_are_counted_by_their_verdicts(tmp_path: Path) -> None:
    """An expectation on a trouble code has no margin, and a comparison of states may fail with a margin of 0."""
    rod, margins = {"rod": [1.0, 2.0, 3.0]}, {"code": [None] * 3, "state": [0.0] * 3}
    judged = {"code": ["fail", "pass", "pass"], "state": ["fail", "fail", "pass"]}
    path = write(tmp_path / "r", judged["state"], rod, margins, judged=judged, force=[5.0, 7.0, 6.0])
    found = summary_of(path, ["rod"], ["code", "state"])
    assert [(each.name, each.passed, each.failed, each.undecided) for each in found.expectations] == [
        ("code", 2, 1, 0),
        ("state", 1, 2, 0),
    ]
    assert found.driver == "margin.state"
    only = summary_of(path, ["rod"], ["code"])
    assert only.driver == "peak_pinch_force_n"  # nothing else tells one failure from another
    assert worst(only, {}, "folder").count(">force [N]<") == 1


def test_variants_that_differ_only_in_the_verdict_on_a_trouble_code_are_different(tmp_path: Path) -> None:
    rod, margins = {"rod": [1.0, 2.0]}, {"code": [None] * 2, "other": [-1.0] * 2}
    verdicts = [{"code": ["pass", each], "other": ["fail"] * 2} for each in ("pass", "fail")]
    one, two = (
        write(tmp_path / str(k), ["fail"] * 2, rod, margins, judged=each) for k, each in enumerate(verdicts)
    )
    found = comparison_of(one, two, ["rod"], ["code", "other"], ("one", "two"))
    assert found.differing["rod"].to_pylist() == [2.0]


def test_a_margin_that_only_one_of_two_ecus_has_is_a_difference(tmp_path: Path) -> None:
    one, two = (
        write(tmp_path / name, ["fail"], {"rod": [1.0]}, {"a": [margin]}, judged={"a": ["fail"]})
        for name, margin in (("one", None), ("two", 4.0))
    )
    assert comparison_of(one, two, ["rod"], ["a"], ("one", "two")).differing.num_rows == 1


def test_unreadable_results_are_reported_with_the_operating_systems_reason(tmp_path: Path) -> None:
    whole, gone = write(tmp_path / "whole.parquet", ["pass"], {}, {}), tmp_path / "gone.parquet"
    for call in (
        lambda: summary_of(gone, [], []),
        lambda: comparison_of(gone, whole, [], [], ("one", "two")),
        lambda: comparison_of(whole, gone, [], [], ("one", "two")),
    ):
        with pytest.raises(StoreError, match=rf"^{gone}: {os.strerror(errno.ENOENT)}$"):
            call()
