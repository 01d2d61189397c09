from dataclasses import replace

import numpy as np
import pytest
import report_support
from html_page import Page

from liftgate_hil.identification.reporting import html
from liftgate_hil.identification.reporting.findings import with_warnings
from liftgate_hil.identification.reporting.html import identification_html, validation_html


def shortened(result, outputs=0):
    """All outputs of the first `outputs` experiments, one of the others: a panel takes a tenth of a second."""
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
def test_a_page_is_well_formed_and_refers_to_nothing_outside(name, pages):
    page = Page(pages[name])
    assert page.links
    page.check_alone()
    pages[name].encode("utf-8")


def test_names_from_files_are_text_only(pages):
    page = Page(pages["hostile"])
    assert "<script>alert('x')</script>&\"$\\frac{a}" in page.text
    assert "\x1b" not in pages["hostile"]
    assert "\u202e" not in pages["hostile"]


def test_warnings_come_first(pages):
    text = Page(pages["found"]).text
    order = [
        "motor.inductance is not identifiable: its standard deviation is 15 times its value", "only their product",
        "residuals are not white", "std %", "2.128", "before %", "Measured and simulated", "decimated from",
    ]  # fmt: skip
    places = [text.index(each) for each in order]
    assert places == sorted(places)


def test_a_page_has_every_figure(pages):
    assert pages["found"].count("<figure") == 4 + 3 * 2
    assert pages["judged"].count("<figure") == 3 * 2
    assert Page(pages["found"]).tags.count("svg") == 10


def test_a_page_of_long_measurements_stays_small():
    found = report_support.identification(10_000, names=("a.csv",), columns=("left_current_a",))
    assert len(identification_html(found).encode()) < 300_000


def test_many_experiments_are_all_in_the_table_but_not_all_drawn(monkeypatch):
    monkeypatch.setattr(html, "svg", lambda *_: "<svg></svg>")  # drawn as a picture elsewhere
    judged = report_support.validation(60, names=[f"{i}.csv" for i in range(10)], columns=("left_current_a",))
    page = Page(validation_html(judged))
    assert page.tags.count("svg") == 8 * 3
    assert "no figures, to keep the page small: 8.csv, 9.csv" in page.text


def test_a_result_with_nothing_in_it_is_still_a_page(judged):
    assert "svg" not in Page(identification_html(report_support.nothing())).tags
    assert "0 experiments" in Page(validation_html(replace(judged, experiments=()))).text


def test_a_failed_search_is_still_a_page(found):
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
