"""Pictures of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.float64]]

_PANELS = (
    ("gate angle [deg]", ("gate_angle_deg",)),
    ("motor current [A]", ("left_current_a", "right_current_a")),
    ("Hall speed [counts/s]", ("left_hall_count", "right_hall_count")),
    ("pinch force [N]", ("pinch_force_n",)),
)
_WINDOW = 0.05  # s over which Hall counts are differenced


def hall_speed(times: NDArray[np.float64], counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts per second over a short window, as an ECU would see them."""
    rows = max(1, round(_WINDOW / float(np.median(np.diff(times)))))
    speed = np.zeros(len(counts))
    speed[rows:] = (counts[rows:] - counts[:-rows]) / (times[rows:] - times[:-rows])
    return speed


def plot_run(path: Path, columns: Columns, marks: Sequence[tuple[float, str]], title: str) -> None:
    """Angle, currents, Hall speed and pinch force over time, with marked moments; a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    times = columns["time_s"]
    figure, axes = plt.subplots(len(_PANELS), 1, figsize=(11, 10), sharex=True)
    for axis, (label, names) in zip(axes, _PANELS, strict=True):
        for name in names:
            if name not in columns:
                continue
            values = columns[name]
            if name.endswith("_hall_count"):
                values = hall_speed(times, values)
            style = "--" if name.startswith("right_") else "-"
            axis.plot(times, values, style, linewidth=1.2, label=name.split("_")[0])
        if len(names) > 1:
            axis.legend(loc="upper right", fontsize=8)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        for time, _ in marks:
            axis.axvline(time, color="tab:red", linewidth=1.0, linestyle=":")
    for time, text in marks:
        axes[0].annotate(
            text,
            (time, axes[0].get_ylim()[1]),
            xytext=(4, -12),
            textcoords="offset points",
            color="tab:red",
            fontsize=9,
        )
    axes[-1].set_xlabel("time [s]")
    axes[0].set_title(title)
    figure.tight_layout()
    try:
        figure.savefig(path, dpi=110)
    finally:
        plt.close(figure)
