"""Figures of the estimates: uncertainty, correlation, loss and profile likelihood."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from liftgate_hil.identification.result import Identification, LikelihoodProfile
from liftgate_hil.report.drawing import (
    FINAL,
    INITIAL,
    INK,
    MARK,
    WIDTH,
    limits,
    log_axis,
    new_figure,
    style,
    widened,
)
from liftgate_hil.report.numbers import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT_95 = 3.84  # 95 % limit of the deviance for one parameter
_ACROSS = 3
_LEAST_SIDE = 4.8  # inches: less has no room for names


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
    """Draw every estimate with two standard deviations to either side, relative to its initial value."""
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
    """Return the range (low, high) of the axis of estimates, relative to their initial values.

    It holds 1, all `ratios`, and ratio ± error of the identifiable ones, with a margin at both ends.
    """
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
    """Draw the profile likelihood of each parameter, with the 95 % limit and interval."""
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
