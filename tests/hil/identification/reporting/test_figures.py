import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import report_support
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from liftgate_hil.identification.reporting import figures
from liftgate_hil.identification.result import Experiment
from liftgate_hil.report.drawing import limits, new_figure, png, style, svg, thin

EXPERIMENT = (figures.trace_figure, figures.error_figure, figures.residual_figure)
ESTIMATES = (figures.parameter_figure, figures.correlation_figure, figures.loss_figure, figures.profile_figure)


def words(figure):
    return {each.get_text() for each in figure.findobj(lambda each: hasattr(each, "get_text"))}


# The figures of usual results, and those with names of any characters: test_pages_and_text.py.


def test_figures_of_traces_label_quantities_units_and_models(found, judged):
    shown = words(figures.trace_figure(found.experiments[0]))
    assert shown >= {
        "time [s]", "voltage [V]", "left current\n[A]", "left speed\n[rev/s]", "left position\n[rev]",
        "gate angle\n[deg]", "measured", "initial model", "estimated model",
    }  # fmt: skip
    assert "initial model" not in words(figures.trace_figure(judged.experiments[0]))


def spoilt(experiment, values):
    """An experiment whose models diverge halfway, each output to its own one of `values`."""
    rows = []
    for each, value in zip(experiment.series, values, strict=False):
        bad = each.simulated.copy()
        bad[len(bad) // 2 :] = value
        rows.append(
            replace(
                each, simulated=bad, before=bad, fit_percent=-np.inf, rms=np.inf, maximum=np.nan,
                autocorrelation=each.autocorrelation * np.nan, band=np.nan,
            )
        )  # fmt: skip
    return replace(experiment, series=tuple(rows))


@pytest.mark.parametrize("draw", EXPERIMENT)
def test_an_experiment_with_a_diverged_model_is_drawn(draw, found):
    spoilt_ones = spoilt(found.experiments[0], (np.nan, np.inf, 1e300))
    assert len(spoilt_ones.series) == 3
    assert png(draw(spoilt_ones), 40)


@pytest.mark.parametrize("draw", EXPERIMENT)
def test_an_experiment_with_no_or_one_sample_is_drawn(draw):
    empty = Experiment("empty", np.empty(0), np.empty(0), ())
    lone = report_support.experiment_of("short", 60, 1)
    one = replace(
        lone.series[0],
        times=np.zeros(1), measured=np.ones(1), simulated=np.ones(1), before=np.empty(0),
        autocorrelation=np.ones(1), crosscorrelation=np.zeros(1), band=np.inf,
    )  # fmt: skip
    none = replace(one, times=np.empty(0), measured=np.empty(0), simulated=np.empty(0))
    for experiment in (empty, replace(lone, series=(one,)), replace(lone, series=(none, one))):
        assert png(draw(experiment), 40)


def test_estimates_with_infinite_nan_and_negative_values_are_drawn(found):
    strange = replace(
        found,
        history=np.array([np.inf, -1.0, np.nan]),
        parameters=tuple(replace(each, value=-each.value) for each in found.parameters),
        correlation=np.full((5, 5), np.nan),
    )
    alone = report_support.estimates()[4]
    bare = replace(found, parameters=(alone,), correlation=np.ones((1, 1)), history=np.empty(0))
    lost = replace(found, parameters=tuple(replace(each, value=np.nan, std=np.nan) for each in found.parameters))
    for result in (strange, bare, lost):
        for draw in ESTIMATES:
            assert png(draw(result), 40)


def test_svg_figures_use_the_colours_of_the_page_and_identifiers_of_their_own(found):
    figure = figures.parameter_figure(found)
    one, other = svg(figure, "one", "t"), svg(figure, "other", "t")
    assert "var(--final, #0072b2)" in one
    assert "var(--ink" in one
    assert 'id="one-' in one
    assert "one-" not in other
    assert "http" not in one
    assert svg(figure, "one", "t") == one  # the same bytes every time


def test_svg_tick_labels_keep_their_digits_when_paths_are_rounded(found):
    first = found.experiments[0]
    row = first.series[0]
    small = replace(row, measured=row.measured * 1e-3, simulated=row.simulated * 1e-3)
    text = svg(figures.error_figure(replace(first, series=(small,))), "x", "t")
    assert re.search(r">.?0\.000[1-9]", text)
    assert not re.search(r' d="[^"]*\.\d{3}', text)


@given(
    arrays(np.float64, st.integers(0, 300), elements=st.floats(-1e6, 1e6) | st.just(np.nan)), st.integers(4, 60)
)
def test_thinned_curves_keep_their_peaks_within_the_limit_of_points(values, limit):
    times = np.arange(len(values), dtype=np.float64)
    few_times, few = thin(times, values, limit)
    assert len(few) == len(few_times) <= max(limit, 0)
    assert (np.diff(few_times) > 0).all()
    known = values[np.isfinite(values)]
    if len(known):
        assert np.nanmax(few) == known.max()
        assert np.nanmin(few) == known.min()


def test_a_diverging_initial_model_does_not_flatten_the_drawn_measurement():
    low, high = limits(np.array([0.0, 1.0]), np.array([-1e6, 1e6]))
    assert -1.5 < low < -0.9
    assert 1.9 < high < 2.5
    assert limits(np.array([np.nan]), np.empty(0)) is None


@pytest.mark.parametrize("level", [0.0, 1.0, 12.0, -3e-5, 4e7])
def test_a_signal_constant_but_for_rounding_gets_a_readable_axis(level):
    values = level * (1.0 + 1e-12 * np.arange(100) / 100) + (1e-30 if level == 0.0 else 0.0)
    low, high = limits(values, values)
    assert low <= values.min()
    assert high >= values.max()
    with style():
        figure = new_figure(2.0)
        axis = figure.subplots()
        axis.plot(values)
        axis.set_ylim(low, high)
        figure.draw_without_rendering()
        texts = [each.get_text() for each in axis.get_yticklabels()]
        assert axis.yaxis.get_offset_text().get_text() in ("", "1e−5", "1e7", "1e−30", "1e-30", "1e-5")
    assert all(len(each) <= 8 for each in texts), texts


def test_an_axis_label_breaks_a_long_column_name_and_puts_its_unit_on_the_last_line():
    assert figures._wrapped("left_winding_temperature_degc") == "left winding\ntemperature\n[°C]"
    assert figures._wrapped("left_current_a") == "left current\n[A]"


def test_matplotlib_is_not_loaded_until_something_is_drawn():
    imports = "import sys; from liftgate_hil.identification.reporting import html, text"
    code = f"{imports}; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
