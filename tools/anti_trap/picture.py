"""Picture of docs/anti-trap.md: force over the travel, force and false reversals over the tolerance scale."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tools.anti_trap.study import CONDITIONS, FACTORS, GAPS, LIMIT, VEHICLES, Many, largest_of
from tools.anti_trap.trials import Outcome

# Colour, dashes, width and marker: a wide line under narrower, dashed ones, so that equal curves are all seen.
_LOOKS = (("C0", "-", 4.0, "o"), ("C1", (0, (4, 2)), 2.4, "s"), ("C2", (0, (1, 1.5)), 1.6, "^"))
_TICKS_DEG = (0.5, 1, 2, 5, 10, 20, 50)
_LEAST_PERCENT = 0.1  # below which the axis is linear, so that 0 is on it


def draw(
    path: Path, travel: Mapping[str, Mapping[str, Outcome]], trade: Mapping[float, Mapping[str, Many]]
) -> None:
    """Write the picture as PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(15, 5.2), layout="constrained")
    left, middle, right = axes
    for vehicle, (colour, dashes, width, marker) in zip(VEHICLES, _LOOKS, strict=True):
        looks: dict[str, Any] = {
            "color": colour, "linestyle": dashes, "linewidth": width, "marker": marker, "markersize": 5,
        }  # fmt: skip
        peaks = np.array([each.peaks for each in travel[vehicle].values()])
        left.plot(GAPS, np.nanmax(peaks, axis=0), label=vehicle, **looks)
        middle.plot(FACTORS, [largest_of(trade[factor][vehicle]) for factor in FACTORS], **looks)
        shares = [100.0 * trade[factor][vehicle].false / trade[factor][vehicle].judged for factor in FACTORS]
        right.plot(FACTORS, shares, clip_on=False, zorder=3, **looks)
    for axis in (left, middle):
        _line(axis, LIMIT, f"{LIMIT:g} N (UN R21, car windows)")
        axis.set(ylabel="largest pinch force [N]", ylim=(0.0, 1.05 * max(axis.get_ylim())))
    left.set(xscale="log", xlabel="gate angle at which it meets the rod [°]")
    left.set_title(f"Force over the travel, worst of {len(CONDITIONS)} conditions", loc="left")
    left.set_xticks(_TICKS_DEG, [f"{each:g}" for each in _TICKS_DEG])
    middle.set_title("Force on the rods of drawn cars", loc="left")
    right.set_yscale("symlog", linthresh=_LEAST_PERCENT)
    right.set(ylabel="motions that reverse falsely [%]", ylim=(0.0, 150.0))
    right.set_yticks((0, 0.1, 1, 10, 100), ("0", "0.1", "1", "10", "100"))
    right.set_title("False reversals of drawn cars", loc="left")
    for axis in (middle, right):
        axis.set(xscale="log", xlabel="tolerance scale (1: as calibrated)")
        axis.set_xticks(FACTORS, [f"{each:g}" for each in FACTORS])
    for axis in axes:
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=len(VEHICLES), handlelength=4)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _line(axis: Any, value: float, label: str) -> None:
    """Draw a level with its label at the left end, where the curves are lower."""
    axis.axhline(value, color="0.35", linestyle=(0, (6, 3)), linewidth=1.0)
    axis.annotate(
        label, (0.0, value), (5, 3), xycoords=("axes fraction", "data"), textcoords="offset points", color="0.25",
    )  # fmt: skip
