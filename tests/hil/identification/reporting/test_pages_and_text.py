from dataclasses import replace

import numpy as np
import pytest
import report_support
from html_page import Page

from liftgate_hil.identification.reporting import html
from liftgate_hil.identification.reporting.findings import with_warnings
from liftgate_hil.identification.reporting.html import identification_html, validation_html
from liftgate_hil.identification.reporting.text import WIDTH, identification_text, validation_text


def shortened(result, outputs=0):
    """Keep all outputs of the first `outputs` experiments and one of the others, as each panel takes 0.1 s."""
    first, others = result.experiments[:outputs], result.experiments[outputs:]
    return replace(result, experiments=(*first, *(replace(each, series=each.series[:1]) for each in others)))


@pytest.fixture(scope="module")
def pages(found, judged, hostile):
    return {
        "found": identification_html(shortened(found, 1)),
        "judged": validation_html(shortened(judged, 1)),
        "hostile": identification_html(shortened(hostile)),
    }


@pytest.mark.parametrize("name", ["found", "judged", "hostile"])
def test_a_report_page_is_well_formed_and_self_contained(name, pages):
    page = Page(pages[name])
    assert page.links
    page.check_alone()
    pages[name].encode("utf-8")


def test_names_from_files_are_escaped_in_report_pages(pages):
    page = Page(pages["hostile"])
    assert "<script>alert('x')</script>&\"$\\frac{a}" in page.text
    assert "\x1b" not in pages["hostile"]
    assert "\u202e" not in pages["hostile"]


def test_warnings_come_first_on_a_report_page(pages):
    text = Page(pages["found"]).text
    order = [
        "motor.inductance is not identifiable: its standard deviation is 15 times its value", "only their product",
        "residuals are not white", "std %", "2.128", "before %", "Measured and simulated", "decimated from",
    ]  # fmt: skip
    places = [text.index(each) for each in order]
    assert places == sorted(places)


def test_a_report_page_has_every_figure(pages):
    assert pages["found"].count("<figure") == 4 + 3 * 2
    assert pages["judged"].count("<figure") == 3 * 2
    assert Page(pages["found"]).tags.count("svg") == 10


def test_a_report_page_of_long_measurements_stays_small():
    found = report_support.identification(10_000, names=("a.csv",), columns=("left_current_a",))
    assert len(identification_html(found).encode()) < 300_000


def test_of_many_experiments_only_some_are_drawn_and_the_others_are_named(monkeypatch):
    monkeypatch.setattr(html, "svg", lambda *_: "<svg></svg>")  # drawn as a picture elsewhere
    judged = report_support.validation(60, names=[f"{i}.csv" for i in range(10)], columns=("left_current_a",))
    page = Page(validation_html(judged))
    assert page.tags.count("svg") == 8 * 3
    assert "no figures, to keep the page small: 8.csv, 9.csv" in page.text


def test_an_empty_result_still_gives_a_page(judged):
    assert "svg" not in Page(identification_html(report_support.nothing())).tags
    assert "0 experiments" in Page(validation_html(replace(judged, experiments=()))).text


def test_a_failed_search_still_gives_a_page(found):
    lost = replace(
        found,
        parameters=tuple(replace(each, value=np.nan, std=np.nan, identifiable=False) for each in found.parameters),
        covariance=np.full((5, 5), np.nan),
        correlation=np.full((5, 5), np.nan),
        noise_variance=np.full((4, 4), np.inf),
        loss=np.nan,
        history=np.array([np.nan, np.inf]),
        condition_number=np.inf,
        experiments=shortened(found).experiments[:1],  # they do not tell that it failed
    )
    assert "motor.resistance is not identifiable" in Page(identification_html(with_warnings(lost))).text


# The same on a terminal.


def test_text_tables_fit_the_width_of_a_terminal(found, judged, hostile):
    for text in (identification_text(found), validation_text(judged), identification_text(hostile)):
        assert max(map(len, text.splitlines())) <= WIDTH
        assert all(line == line.rstrip() for line in text.splitlines())


def test_each_parameter_is_reported_in_one_line(found):
    line = next(each for each in identification_text(found).splitlines() if "0.708" in each)
    assert line.split() == [
        "motor.resistance", "2.128", "0.022", "1.0", "0.708", "+201", "ohm", "yes",
    ]  # fmt: skip


def test_warnings_precede_the_parameter_table_in_the_text_report(found):
    text = identification_text(found)
    start = text.index("Parameters")
    assert 0 < text.index("motor.inductance is not identifiable: its standard") < start
    assert 0 < text.index("only their product is told") < start
    assert 0 < text.index("motor.load_torque: at its lower bound") < start
    assert 0 < text.index("residuals are not white") < start


def test_the_text_report_shows_criteria_noise_fits_correlations_limits_and_initial_states(found):
    text = identification_text(found)
    for part in (
        "NoiseVar", "0.04910", "FPE", "AIC ", "AICc", "BIC", "condition number  3.20e+07", "10.40 -> 53.66",
        "not white", "the step became shorter", "9 iterations", "61 simulations", "12.3 s", "decimated from",
        "-0.950", "2.085 … 2.171", "no limit … no limit", "open.csv: left_position", "robust",
    ):  # fmt: skip
        assert part in text, part


def test_a_validation_report_shows_fit_and_phases(judged):
    text = validation_text(judged)
    assert "->" not in text
    for part in ("fit %", "running", "99.67", "667", "decimated", "close.csv"):
        assert part in text, part


def test_control_characters_in_names_do_not_reach_the_terminal(hostile):
    text = identification_text(hostile)
    assert all(each.isprintable() or each == "\n" for each in text)


def test_an_empty_result_still_gives_a_text_report():
    text = identification_text(report_support.nothing())
    assert "Criteria" in text
    assert "Attention" not in text


def test_wide_noise_matrices_are_broken_into_blocks(found):
    names = tuple(f"output_number_{i}_of_many_a" for i in range(12))
    wide = replace(found, outputs=names, noise_variance=-1.23456e-7 * np.ones((12, 12)))
    assert max(map(len, identification_text(wide).splitlines())) <= WIDTH
    assert identification_text(wide).count("-1.235e-07") == 144


def test_a_negative_fit_is_pointed_out(judged):
    first = judged.experiments[0]
    worse = replace(first, series=(replace(first.series[0], fit_percent=-3.0), *first.series[1:]))
    assert "worse than the mean value: left_current_a" in validation_text(
        with_warnings(replace(judged, experiments=(worse,)))
    )
