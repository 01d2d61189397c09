"""Page docs/accuracy.md: errors of the fixed step on random vehicles, and at random points of bridges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tools.accuracy.bridges import BAR, FLOOR, Apart
from tools.accuracy.study import ANGLE_BAR, CURRENT_BAR, STEP, TOLERANCE, Errors

_HEAD = """# How exact a step is

`make accuracy` wrote this: {count} vehicles drawn at random about the three shipped ones, each in three to five
phases drawn at random (`tools/accuracy/cases.py`), at a step of {step:g} ms, against a solution in which every
change of regime is a located event (`tests/reference/event_solution.py`, relative tolerance {tolerance:g}).
Among them: one drive and two, unlike and alike; duties, applied voltages, braking, coasting; source resistance,
steps and ramps of the supply; friction over speed, load, temperature and place; hinge friction; gas springs;
gates that twist; motors that warm up; obstacles with gap and damping anywhere along the edge; hand, wind, snow,
slope; the latch.

"""


def page_of(found: Sequence[Errors]) -> str:
    """Return the page's beginning, with its part about random vehicles."""
    solved = [each for each in found if not each.trouble]
    met = [each for each in solved if each.is_met]
    lines = [
        _HEAD.format(count=len(found), step=1e3 * STEP, tolerance=TOLERANCE),
        f"**{len(met)} of {len(solved)}** stay under {CURRENT_BAR:g} mA rms in each current and "
        f"under {ANGLE_BAR:g}° in angle and twist.\n\n",
        "| | median | 90 % | 99 % | worst |\n|---|---|---|---|---|\n",
    ]
    for name, unit, digits in (("current", "mA rms", 3), ("angle", "°", 6), ("warmth", "K", 5)):
        values = [getattr(each, name) for each in solved]
        cells = [f"{np.quantile(values, share):.{digits}f}" for share in (0.5, 0.9, 0.99, 1.0)]
        what = {"current": "current", "angle": "angle, twist", "warmth": "temperatures"}[name]
        lines.append(f"| {what} [{unit}] | {' | '.join(cells)} |\n")
    if len(met) < len(solved):
        lines.append("\nThe others:\n\n| case | current [mA rms] | angle [°] |\n|---|---|---|\n")
        lines += [
            f"| {each.number} | {each.current:.3f} | {each.angle:.5f} |\n" for each in solved if not each.is_met
        ]
    if len(solved) < len(found):
        lines.append("\nThe reference could not solve:\n\n")
        lines += [f"- case {each.number}: {each.trouble}\n" for each in found if each.trouble]
    return "".join(lines)


_BRIDGES = """
## Bridges that switch

{count} points drawn at random (`tools/accuracy/bridges.py`): one drive or two on one source, alike and unlike,
slow, diode and fast freewheeling, 1 to 20 kHz, source 9 to 16 V behind 0 to 0.2 Ω, duties of both directions,
back-EMF from −0.3 to 1.1 of the source, against a solution that follows every switch and diode
(`tests/reference/switched_bridges.py`). Errors are relative to the value, those of currents under
{floor:g} A to {floor:g} A.

**{met} of {count}** stay within {bar:g} % in mean, effective value and what the source gives.

| | median | 90 % | 99 % | worst |
|---|---|---|---|---|
"""


def bridges_of(found: Sequence[Apart]) -> str:
    """Return the page's part about bridges that switch."""
    met = sum(each.is_met for each in found)
    lines = [_BRIDGES.format(count=len(found), floor=FLOOR, met=met, bar=100.0 * BAR)]
    for name, title, factor in (
        ("mean", "mean [%]", 100.0),
        ("rms", "effective value [%]", 100.0),
        ("drawn", "of the source [%]", 100.0),
        ("terminal", "terminal voltage [mV]", 1e3),
    ):
        values = [factor * getattr(each, name) for each in found]
        cells = [f"{np.quantile(values, share):.4f}" for share in (0.5, 0.9, 0.99, 1.0)]
        lines.append(f"| {title} | {' | '.join(cells)} |\n")
    lines += [f"\nPoint {each.number} does not.\n" for each in found if not each.is_met]
    return "".join(lines)
