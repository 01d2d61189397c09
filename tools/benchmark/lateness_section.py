"""Section of the report about lateness, paired with cyclictest, with its figure."""

from __future__ import annotations

from pathlib import Path

from liftgate_hil.loop.statistics import in_words
from tools.benchmark import lateness
from tools.benchmark.effort import WHOLE, Effort
from tools.benchmark.lateness import Pairs
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
    """Write a figure of the share of wake-ups that are later than a lateness, over that lateness [µs]."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    figure, panels = plt.subplots(2, len(pairs) // 2, figsize=(16, 7), sharex=True, sharey=True, squeeze=False)
    for panel, pair in zip(panels.T.flat, pairs, strict=True):
        for runs, label, colour in ((pair.ours, "liftgate-hil", "C0"), (pair.theirs, "cyclictest", "C1")):
            for number, run in enumerate(runs):
                later = 1.0 - np.cumsum(run.number) / run.number.sum()
                panel.step(
                    run.late_us, np.maximum(later, 1e-6), where="post", color=colour,
                    alpha=0.5, linewidth=1.0, label=label if number == 0 else None,
                )  # fmt: skip
        panel.set_title(str(pair.condition), fontsize="medium")
        panel.set(xscale="log", yscale="log", xlim=(5, 2e4), ylim=(1e-5, 1.0))
        panel.grid(alpha=0.3)
    panels[0, 0].legend()
    figure.supxlabel("lateness of a wake-up [µs]")
    figure.supylabel("share of wake-ups that are later")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
