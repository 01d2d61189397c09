"""Small plots of signals: content, position and size."""

from __future__ import annotations

import re

import numpy as np
import pytest
from html_page import Page

from liftgate_hil.report.trace_plot import ConstantLine, Margin, Panel, Picture, SignalLine, trace_svg

TIMES = np.linspace(1.0, 3.0, 201)


def panel(values: np.ndarray, *levels: ConstantLine, margin: Margin | None = None) -> Panel:
    return Panel("force_n", "N", [SignalLine("force_n", values, values)], list(levels), margin)


def drawn(*panels: Panel, window: tuple[float, float] | None = None) -> str:
    return trace_svg(Picture(TIMES, panels, window, "triggered", None), "a picture")


def heights(svg: str, name: str) -> list[float]:
    """Heights of the horizontal lines of a CSS class."""
    return [float(each) for each in re.findall(rf'class="{name}" d="M[\d.]+ (-?[\d.]+)H[\d.]+"', svg)]


def test_axes_have_names_units_and_round_numbers() -> None:
    svg = drawn(panel(np.linspace(0.0, 100.0, 201)))
    words = Page(svg).text
    assert "force_n [N]" in words
    assert "time [s]" in words
    assert {"0", "50", "100", "1.5", "3.0"} <= set(words.split())


def test_limits_are_drawn_as_labelled_lines() -> None:
    svg = drawn(
        panel(np.zeros(201), ConstantLine(80.0, "< 80 N", False), ConstantLine(5.0, "trigger: > 5 N", True))
    )
    assert "< 80 N" in Page(svg).text
    (limit,) = heights(svg, "limit")
    (trigger,) = heights(svg, "trigger")
    assert limit < trigger  # higher up


def test_a_distant_limit_does_not_flatten_the_signal() -> None:
    values = np.sin(TIMES)
    svg = drawn(panel(values, ConstantLine(1e4, "< 10000 N", False)))
    assert heights(svg, "limit") == []
    assert "↑ < 10000 N" in Page(svg).text
    points = re.findall(r"[\d.]+ (-?[\d.]+)(?=L|\")", svg)
    assert max(map(float, points)) - min(map(float, points)) > 80.0
    # Beside a signal that does not move there is nothing to be crushed.
    assert len(heights(drawn(panel(np.zeros(201), ConstantLine(1e4, "", False))), "limit")) == 1


def test_a_margin_is_drawn_from_the_limit_to_the_value() -> None:
    values = np.where(np.arange(201) == 100, 90.0, 0.0)
    margin = Margin(float(TIMES[100]), 100.0, 90.0, "margin 10 N")
    svg = drawn(panel(values, ConstantLine(100.0, "< 100 N", False), margin=margin))
    assert "margin 10 N" in Page(svg).text
    (limit,) = heights(svg, "limit")
    found = re.search(r'class="margin" d="M([\d.]+) ([\d.]+)V([\d.]+)"', svg)
    assert found is not None
    across, first, last = map(float, found.groups())
    assert first == limit
    assert re.search(rf"{across:g} {last:g}(?=L|\")", svg)  # on the curve


@pytest.mark.parametrize("value", [0.0, 50.0, 96.0, 99.5, 100.0, 100.5, 104.0])
def test_the_label_of_a_margin_does_not_overlap_a_limit(value: float) -> None:
    values = np.where(np.arange(201) == 100, value, 0.0)
    margin = Margin(float(TIMES[100]), 100.0, value, "margin here")
    svg = drawn(panel(values, ConstantLine(100.0, "< 100 N", False), margin=margin))
    (limit,) = heights(svg, "limit")
    found = re.search(r'<text x="[\d.]+" y="([\d.]+)"[^>]*>margin here<', svg)
    assert found is not None
    baseline = float(found[1])
    assert not baseline - 9.0 < limit < baseline + 2.0  # letters of 11 px


def test_gaps_and_signals_without_values_are_shown() -> None:
    values = np.where((np.arange(201) > 50) & (np.arange(201) < 60), np.nan, 1.0)
    svg = drawn(panel(values))
    (path,) = re.findall(r'class="k k0" d="([^"]*)"', svg)
    assert path.count("M") == 2
    assert "no value" in Page(drawn(panel(np.full(201, np.nan)))).text
    for broken in (np.full(201, np.inf), np.full(201, 1e300)):
        assert "nan" not in drawn(panel(broken))


def test_steps_keep_their_corners_and_constant_lines_have_two_points() -> None:
    (path,) = re.findall(r'class="k k0" d="([^"]*)"', drawn(panel(np.where(np.arange(201) < 100, 0.0, 1.0))))
    points = [tuple(map(float, each.split())) for each in path[1:].split("L")]
    assert len(points) == 4
    assert points[0][1] == points[1][1]
    assert points[2][1] == points[3][1]
    assert points[2][0] - points[1][0] < 5.0


def test_a_bin_of_several_values_is_drawn_as_a_band() -> None:
    band = Panel("x", "", [SignalLine("x", np.zeros(201), np.ones(201))])
    (path,) = re.findall(r'class="k k0 b" d="([^"]*)"', drawn(band))
    assert path.endswith("Z")
    assert path.count(" ") == 4  # a rectangle


@pytest.mark.parametrize("window", [(1.5, 2.0), (1.0, 3.0), (0.0, 9.0), (2.9, 2.95), (1.01, 1.02)])
def test_both_ends_of_a_window_are_labelled(window: tuple[float, float]) -> None:
    svg = drawn(panel(np.zeros(201)), window=window)
    words = Page(svg).text
    assert f"triggered {window[0]:g} s" in words
    assert f"window ends {window[1]:g} s" in words
    inside = [1.0 <= each <= 3.0 for each in window]
    assert svg.count('class="edge"') == sum(inside)
    places = [float(each) for each in re.findall(r'<text[^>]* x="(-?[\d.]+)"', svg)]
    assert 0.0 <= min(places) <= max(places) <= 880.0


def test_named_values_are_labelled_and_escaped_at_the_axis() -> None:
    own = Panel("latched", "", [SignalLine("latched", np.zeros(201), np.ones(201))])
    own.names = {0.0: "open", 1.0: "latched & <shut>"}
    words = Page(drawn(own)).text
    assert "0 open" in words
    assert "1 l" in words
    assert "<shut>" not in drawn(own)


def test_a_plot_of_noise_stays_small() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(1000) * 0.001
    low, high = rng.normal(-5, 1, 1000), rng.normal(5, 1, 1000)
    picture = Picture(times, [Panel("x", "", [SignalLine("x", low, high)])])
    assert len(trace_svg(picture, "noise")) < 30_000


def test_a_single_tick_can_be_plotted() -> None:
    one = np.array([1.0])
    picture = Picture(one, [Panel("x", "", [SignalLine("x", one, one)])], (1.0, 1.0), "window opens")
    assert "nan" not in trace_svg(picture, "<one & only>")
