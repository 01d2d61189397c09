"""Figures of one experiment (traces, errors, residual tests), and of the estimates of all."""

from __future__ import annotations

import math
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.identification.result import Experiment, Identification, LikelihoodProfile, Series
from liftgate_hil.report.drawing import (
    FINAL,
    INITIAL,
    INK,
    MARK,
    MEASURED,
    WIDTH,
    limits,
    line,
    log_axis,
    new_figure,
    style,
    widened,
)
from liftgate_hil.report.numbers import axis_label, clean, column_label, fit, significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LETTERS, _MOST_LINES = 18, 3  # of an axis label, beside a panel of 1.3 inch
_ORDER = ("current", "speed", "position", "hall", "angle")
LIMIT_95 = 3.84  # 95 % limit of the deviance for one parameter
_ACROSS = 3
_LEAST_SIDE = 4.8  # inches: less has no room for names


def _drawn(experiment: Experiment) -> list[Series]:
    """Return an experiment's series to draw, in order from the motor to the gate, left before right."""

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
    """Return a column's axis label in lines that fit a panel: words, then the unit."""
    label = axis_label(column) if "_" in column else column_label(column)[0]
    words, bracket, unit = label.rpartition(" [")
    lines = wrap(words if bracket else label, _LETTERS)[:_MOST_LINES]
    return "\n".join([*lines, *([f"[{unit}"] if bracket else [])])


def correlation_figure(result: Identification) -> Figure:
    """Draw the correlation matrix of the parameters, with their names at its sides."""
    names = [clean(each.name, 28) for each in result.parameters]
    count = len(names)
    side = min(max(2.4 + 0.62 * count, _LEAST_SIDE), WIDTH)
    with style():
        figure = new_figure(side * 0.74, side)
        axis = figure.subplots()
        shown = np.ma.masked_invalid(result.correlation)
        mesh = axis.pcolormesh(shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0, rasterized=count > 25)
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.grid(visible=False)
        middles = np.arange(count) + 0.5
        axis.set_xticks(middles, names, rotation=40, ha="right", rotation_mode="anchor")
        axis.set_yticks(middles, names)
        axis.tick_params(length=0)
        for spine in axis.spines.values():
            spine.set_visible(False)
        if count <= 14:
            _write_cells(axis, result.correlation)
        figure.colorbar(mesh, ax=axis, label="correlation", shrink=0.8)
    return figure


def _write_cells(axis: Axes, values: np.ndarray) -> None:
    for (row, column), value in np.ndenumerate(values):
        text = f"{value:.2f}".replace("-", "−") if np.isfinite(value) else "—"
        colour = "white" if abs(value) > 0.65 else "black" if np.isfinite(value) else INK
        axis.text(column + 0.5, row + 0.5, text, ha="center", va="center", color=colour, fontsize=8)


def parameter_figure(result: Identification) -> Figure:
    """Draw the estimates relative to initial values other than 0, with two standard deviations to either side."""
    shown = [each for each in result.parameters if each.initial != 0.0]
    with style():
        figure = new_figure(0.9 + 0.36 * max(len(shown), 1))
        axis = figure.subplots()
        ratios = np.array([each.value / each.initial for each in shown])
        errors = np.array([2.0 * each.shown_std / abs(each.initial) for each in shown])
        identifiable = np.array([each.identifiable for each in shown], dtype=bool) & np.isfinite(errors)
        low, high = _ratio_limits(ratios, errors, identifiable)
        for row, (ratio, error) in enumerate(zip(ratios, errors, strict=True)):
            colour = FINAL if identifiable[row] else INITIAL
            start = max(ratio - error, low) if np.isfinite(error) else low
            stop = min(ratio + error, high) if np.isfinite(error) else high
            axis.hlines(row, start, stop, colors=colour, linewidth=5.0, alpha=0.45)
            axis.plot(ratio, row, "o" if identifiable[row] else "D", color=colour, markersize=5.0)
        axis.axvline(1.0, color=INK, linewidth=1.0, linestyle=(0, (5, 2)))
        if low > 0.0 and high / low > 6.0:
            log_axis(axis, "x")
            if high / low < 100.0:
                axis.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else "")
        axis.set_xlim(low, high)
        axis.set_ylim(len(shown) - 0.4, -0.6)
        labels = [
            clean(each.name, 30) + ("" if known else " (not identifiable)")
            for each, known in zip(shown, identifiable, strict=True)
        ]
        axis.set_yticks(range(len(shown)), labels)
        axis.set_xlabel("estimate / initial value, ± 2 standard deviations")
    return figure


def _ratio_limits(ratios: np.ndarray, errors: np.ndarray, identifiable: np.ndarray) -> tuple[float, float]:
    """Return the limits of the axis: 1, all `ratios`, and ratio ± error of identifiable ones, with a margin."""
    ends = [1.0, *ratios.tolist(), *(ratios + errors)[identifiable].tolist()]
    lows = [1.0, *ratios.tolist(), *(ratios - errors)[identifiable].tolist()]
    high = max(each for each in ends if math.isfinite(each))
    low = min(each for each in lows if math.isfinite(each))
    if low > 0.0 and high / low > 6.0:
        return low / 1.3, high * 1.3
    margin = 0.08 * (high - low) or 0.1
    return widened(low - margin, high + margin)


def loss_figure(result: Identification) -> Figure:
    """Draw the loss after each iteration."""
    from matplotlib.ticker import MaxNLocator

    history = np.asarray(result.history, dtype=np.float64)
    with style():
        figure = new_figure(2.3)
        axis = figure.subplots()
        shown = np.where(np.isfinite(history), history, np.nan)
        axis.plot(np.arange(len(shown)), shown, "o-", color=FINAL, markersize=4.0)
        if len(shown) and np.nanmin(np.append(shown, 1.0)) > 0.0:
            log_axis(axis, "y")
            low, high = widened(*axis.get_ylim())
            axis.set_ylim(low if low > 0.0 else None, high)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlabel("iteration")
        axis.set_ylabel("loss")
    return figure


def profile_figure(result: Identification) -> Figure:
    """Draw each requested profile likelihood of a parameter, with the 95 % limit and interval."""
    profiles = result.profiles
    units = {each.name: each.unit for each in result.parameters}
    across = min(max(len(profiles), 2), _ACROSS)
    rows = max(-(-len(profiles) // across), 1)
    with style():
        figure = new_figure(0.3 + 2.1 * rows)
        axes = figure.subplots(rows, across, squeeze=False).ravel()
        for axis, profile in zip(axes, profiles, strict=False):
            _profile(axis, profile, units.get(profile.name, ""))
        for axis in axes[len(profiles) :]:
            axis.set_visible(False)
        for axis in axes[::across]:
            axis.set_ylabel("deviance")
    return figure


def _profile(axis: Axes, profile: LikelihoodProfile, unit: str) -> None:
    deviance = np.where(np.isfinite(profile.deviance), profile.deviance, np.nan)
    values = np.asarray(profile.values, dtype=np.float64)
    axis.plot(values, deviance, ".-", color=FINAL, markersize=4.0)
    axis.axhline(LIMIT_95, color=INITIAL, linewidth=1.0, linestyle=(0, (5, 2)))
    bounds = limits(np.array([0.0, 2.5 * LIMIT_95]), np.empty(0))
    if bounds is not None:
        axis.set_ylim(*bounds)
    positive = len(values) and values.min() > 0.0
    if positive and values.max() / values.min() > 20.0:
        log_axis(axis, "x")
    else:
        axis.ticklabel_format(axis="x", useOffset=False, scilimits=(-3, 4))
        axis.locator_params(axis="x", nbins=4)
    ends = axis.get_xlim()
    low = profile.low if math.isfinite(profile.low) else ends[0]
    high = profile.high if math.isfinite(profile.high) else ends[1]
    axis.axvspan(low, high, color=MARK, alpha=0.16, linewidth=0.0)
    axis.set_xlim(*ends)
    axis.annotate(
        "95 %", (1.0, LIMIT_95), xycoords=("axes fraction", "data"), xytext=(-2, 3),
        textcoords="offset points", ha="right", fontsize=8, color=INK,
    )  # fmt: skip
    axis.set_title(clean(profile.name, 30), fontsize=8.5)
    axis.set_xlabel(f"[{clean(unit, 12)}]" if unit else "")
