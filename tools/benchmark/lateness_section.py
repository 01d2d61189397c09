"""Section of the report about lateness, paired with cyclictest, with its figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.loop.priority import PRIORITY
from liftgate_hil.loop.statistics import in_words
from tools.benchmark import lateness
from tools.benchmark.effort import WHOLE, Effort
from tools.benchmark.lateness import Condition, Pairs, Times
from tools.benchmark.units import paragraph


def lateness_section(folder: Path, rounds: int, seconds: float, effort: Effort = WHOLE) -> list[str]:
    """Return the section about lateness against cyclictest, and write its figure benchmark.png."""
    conditions = lateness.CONDITIONS[: effort.conditions]
    pairs, delays = lateness.measure(rounds, seconds, conditions)
    plot(folder / "benchmark.png", pairs)
    return [
        "## Lateness, paired with cyclictest",
        "",
        paragraph(
            f"""{rounds} rounds of {seconds:g} s each, in turns; medians of the rounds, stolen is a sum. Where two
            figures stand, ours comes first. Loaded: two busy processes, and a busy pure-Python thread in the
            loop's own process. Stolen: what the hypervisor took from all CPUs meanwhile; p99.9 and beyond, and
            the misses of FIFO, are mostly that. SCHED_OTHER lets a sleep end late by the timer slack, 50 µs by
            default: ours sets 1 ns, cyclictest does not, unless the condition says so, and that alone makes p50's
            ratio below 1. Ours also asks for the scheduler's shortest slice."""
        ),
        "",
        *lateness_table(pairs),
        "",
        "![Share of wake-ups later than a time, ours and cyclictest's](benchmark.png)",
        "",
        "## Command to feedback",
        "",
        paragraph(
            """From a command on the wire to the first feedback frame with the motor current that shows it, at
            1 kHz and a feedback cycle of 5 ms; the command's phase is swept over the feedback's:"""
        ),
        "",
        *(f"- {condition}: {in_words(each)}" for condition, each in delays.items()),
        "",
    ]


def lateness_table(pairs: list[Pairs]) -> list[str]:
    """Return the lines of the lateness table, in which the ratios are the first columns."""
    lines = [
        "| | p50, ratio | p99, ratio | missed, median | missed, sum | p50 µs | p99 µs | p99.9 µs | max µs "
        "| stolen ms |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for pair in pairs:
        p50, p99, p999, top = (pair.medians(share) for share in (0.5, 0.99, 0.999, 1.0))
        missed, median, stolen = pair.missed(), pair.missed_median(), pair.stolen()
        lines.append(
            f"| {pair.condition} | **{p50[2]:.2f}** | **{p99[2]:.2f}** "
            f"| {median[0]:g} : {median[1]:g} | {missed[0]} : {missed[1]} "
            + "".join(f"| {ours:.0f} : {theirs:.0f} " for ours, theirs, _ in (p50, p99, p999, top))
            + f"| {stolen[0]:.0f} : {stolen[1]:.0f} |"
        )
    return lines


def plot(path: Path, pairs: list[Pairs]) -> None:
    """Write a figure of the share of wake-ups that are later than a lateness, over that lateness [µs].

    Each round is a thin line, all rounds together are a thick one: ours is solid, cyclictest's dashed and
    narrower, so that equal curves are both seen.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        2, len(pairs) // 2, figsize=(16, 7.4), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for panel, pair in zip(panels.T.flat, pairs, strict=True):
        for runs, label, looks in (
            (pair.ours, "liftgate-hil", {"color": "C0", "linestyle": "-", "linewidth": 3.0}),
            (pair.theirs, "cyclictest", {"color": "C1", "linestyle": (0, (4, 1.5)), "linewidth": 1.8}),
        ):
            for run in runs:
                panel.step(*_later([run]), where="post", color=looks["color"], alpha=0.3, linewidth=0.6)
            panel.step(*_later(runs), where="post", label=f"{label}, all rounds", **looks)
        panel.set_title(_in_words(pair.condition), fontsize="medium", loc="left")
        panel.set(xscale="log", yscale="log", xlim=(5, 2e4), ylim=(1e-5, 1.0))
        panel.set_xticks((10, 100, 1000, 10_000), ("10", "100", "1,000", "10,000"))
        panel.set_yticks([10.0**-k for k in range(6)], [f"{10.0 ** (2 - k):g} %" for k in range(6)])
        panel.grid(alpha=0.3)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, handlelength=4)
    figure.supxlabel("lateness of a wake-up [µs]")
    figure.supylabel("share of wake-ups that are later")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _later(runs: list[Times]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return latenesses [µs] and the share of the wake-ups of all runs that are later than each."""
    late = np.concatenate([run.late_us for run in runs])
    number = np.concatenate([run.number for run in runs])
    order = np.argsort(late, kind="stable")
    later = 1.0 - np.cumsum(number[order]) / number.sum()
    return late[order], np.maximum(later, 1e-6)


def _in_words(condition: Condition) -> str:
    """Return a condition for whoever does not know the names of Linux's policies."""
    policy = f"priority {PRIORITY} (FIFO)" if condition.fifo else "no priority (SCHED_OTHER)"
    slack = ", equal timer slack" if condition.same_slack else ""
    load = "machine under load" if condition.loaded else "idle machine"
    return f"{condition.rate:,.0f} Hz, {policy}\n{load}{slack}"
