"""Figures of one experiment: measured against simulated, prediction errors, residual tests."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.identification.result import Experiment, Series
from liftgate_hil.report.drawing import FINAL, INITIAL, INK, MARK, MEASURED, limits, line, new_figure, style
from liftgate_hil.report.numbers import axis_label, column_label, fit, significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LETTERS, _MOST_LINES = 18, 3  # of an axis label, beside a panel of 1.3 inch
_ORDER = ("current", "speed", "position", "hall", "angle")


def _drawn(experiment: Experiment) -> list[Series]:
    """Return the series to draw, in order from the motor to the gate, left before right."""

    def place(series: Series) -> tuple[int, str]:
        kinds = [i for i, kind in enumerate(_ORDER) if kind in series.output]
        return (kinds[0] if kinds else len(_ORDER), series.output)

    return sorted(experiment.series, key=place)


def trace_figure(experiment: Experiment) -> Figure:
    """Draw the input voltage and every output, measured and simulated, one above the other."""
    rows = _drawn(experiment)
    with style():
        figure = new_figure(1.5 + 1.75 * len(rows))
        axes = figure.subplots(
            len(rows) + 1, 1, sharex=True, squeeze=False, height_ratios=[0.55, *[1.0] * len(rows)]
        )[:, 0]
        line(axes[0], experiment.times, experiment.voltage, INK, linewidth=1.0, drawstyle="steps-post")
        axes[0].set_ylabel("voltage [V]")
        for axis, series in zip(axes[1:], rows, strict=True):
            _traces(axis, series)
        axes[-1].set_xlabel("time [s]")
        for axis in axes:
            axis.margins(x=0.01)
        if rows:
            handles, labels = axes[1].get_legend_handles_labels()
            legend = figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
            for handle in legend.get_lines():
                handle.set_linewidth(max(2.0, handle.get_linewidth()))
        figure.align_ylabels(axes)
    return figure


def _traces(axis: Axes, series: Series) -> None:
    measured, final, before = series.measured, series.simulated, series.before
    # Wide, as the model's line lies on it where the fit is good.
    line(axis, series.times, measured, MEASURED, linewidth=3.5, label="measured", solid_capstyle="butt")
    fits = f"fit: {fit(series.fit_percent)} %"
    if len(before):
        line(axis, series.times, before, INITIAL, linestyle=(0, (5, 2)), linewidth=1.2, label="initial model")
        fits = f"fit: initial model {fit(series.fit_before)} %, estimated model {fit(series.fit_percent)} %"
    name = "estimated model" if len(before) else "model"
    line(axis, series.times, final, FINAL, linewidth=1.1, label=name)
    bounds = limits(np.concatenate([measured, final]), before)
    if bounds is not None:
        axis.set_ylim(*bounds)
    axis.set_ylabel(_wrapped(series.output))
    axis.set_title(fits, loc="right", pad=2.0, fontsize=8.0)


def error_figure(experiment: Experiment) -> Figure:
    """Draw the prediction error of every output over time; white noise would be ideal."""
    rows = _drawn(experiment)
    with style():
        figure = new_figure(0.6 + 1.3 * max(len(rows), 1))
        axes = figure.subplots(max(len(rows), 1), 1, sharex=True, squeeze=False)[:, 0]
        for axis, series in zip(axes, rows, strict=False):
            error = series.measured - series.simulated
            line(axis, series.times, error, FINAL, linewidth=0.7)
            axis.axhline(0.0, color=INK, linewidth=0.8)
            bounds = limits(error, np.zeros(1))
            if bounds is not None:
                axis.set_ylim(*bounds)
            axis.set_ylabel(_wrapped(series.output))
            axis.set_title(f"rms {significant(series.rms, 3)}", loc="right", pad=2.0, fontsize=8.0)
            axis.margins(x=0.01)
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels(axes)
    return figure


def residual_figure(experiment: Experiment) -> Figure:
    """Draw the autocorrelation of every residual and its correlation with the input, with the 99 % band."""
    rows = _drawn(experiment)
    with style():
        figure = new_figure(0.9 + 1.35 * max(len(rows), 1))
        axes = figure.subplots(max(len(rows), 1), 2, sharex="col", squeeze=False)
        for (own, across), series in zip(axes, rows, strict=False):
            reach = (len(series.crosscorrelation) - 1) // 2
            later = series.autocorrelation[1:]  # it is 1 at lag 0
            _stems(own, np.arange(1, len(later) + 1), later, series.band)
            _stems(across, np.arange(-reach, reach + 1), series.crosscorrelation, series.band)
            own.set_ylabel(_wrapped(column_label(series.output)[0]))
        axes[0, 0].set_title("autocorrelation")
        axes[0, 1].set_title("correlation with the voltage")
        for axis in axes[-1]:
            axis.set_xlabel("lag [samples]")
        figure.align_ylabels(axes[:, 0])
    return figure


def _stems(axis: Axes, lags: np.ndarray, values: np.ndarray, band: float) -> None:
    known = np.isfinite(values)
    outside = known & (np.abs(values) > band)
    if np.isfinite(band):
        axis.axhspan(-band, band, color=MARK, alpha=0.22, linewidth=0.0)
    for chosen, colour in ((known & ~outside, MEASURED), (outside, FINAL)):
        axis.vlines(lags[chosen], 0.0, values[chosen], colors=colour, linewidth=2.0)
    axis.axhline(0.0, color=INK, linewidth=0.8)
    reach = max([1.3 * band if np.isfinite(band) else 0.1, *np.abs(values[known]).tolist()])
    axis.set_ylim(-1.08 * reach, 1.08 * reach)


def _wrapped(column: str) -> str:
    """Return an axis label in lines that fit a panel: words, then the unit."""
    label = axis_label(column) if "_" in column else column_label(column)[0]
    words, bracket, unit = label.rpartition(" [")
    lines = wrap(words if bracket else label, _LETTERS)[:_MOST_LINES]
    return "\n".join([*lines, *([f"[{unit}"] if bracket else [])])
