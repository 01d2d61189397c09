"""Page docs/anti-trap.md and its figure, from the results of the study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tools.anti_trap.figures import Figures
from tools.anti_trap.picture import draw
from tools.anti_trap.study import (
    CONDITIONS,
    FREE,
    GAPS,
    LIMIT,
    RODS,
    VEHICLES,
    Energy,
    Many,
    largest_of,
    speed_for,
)
from tools.anti_trap.trials import DISTANCE, Outcome

_INTRODUCTION = f"""# The reference ECU's anti-trap

Made by `make anti-trap`. The reference ECU is no product: it is a baseline to compare your ECU with. It knows
the gate by its bus only, and has one calibration for all vehicles (`hil/liftgate_hil/ecu/calibration.py`). Each
vehicle's `[coding]` scales two of its values: the closing speed and the tolerance.

It judges the **load** of the drives, i − K dn/dt, with the motors' currents and their speed by the period of
the Hall edges (`LeftHall`, `RightHall`), both behind the same filter: an obstacle slows the rotors down before
it shows in the current. The load is compared with the load at the same position in earlier motions. The
tolerance is the sum of a constant, a share of the load, the error of the position where the load changes along
the travel, and the error of K while the commanded speed changes. In the first half second of a motion nothing
is judged. A rod of 10 N/mm stands {DISTANCE:g} m from the hinge; forces are peaks.
"""


def written(folder: Path, found: Figures) -> None:
    """Write anti-trap.md and its picture, anti-trap.png, to a folder."""
    lines = [_INTRODUCTION]
    lines += _travel(found.travel)
    lines += _many(found.many)
    lines += _trade(found.trade)
    lines += _rods(found.rods, found.energies)
    (folder / "anti-trap.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(folder / "anti-trap.png", found.travel, found.trade)


def _worst(outcomes: Mapping[str, Outcome]) -> tuple[float, str, float]:
    """Return the largest force of a vehicle, as (peak [N], condition, gap [deg])."""
    return max(
        (peak, name, gap)
        for name, each in outcomes.items()
        for gap, peak in zip(GAPS, each.peaks, strict=True)
        if not math.isnan(peak)
    )


def _travel(travel: Mapping[str, Mapping[str, Outcome]]) -> list[str]:
    lines = [
        "## Over the whole travel",
        "",
        f"{len(GAPS)} gaps from {GAPS[0]:g}° ({1e3 * DISTANCE * math.radians(GAPS[0]):.0f} mm at the edge) to "
        f"{GAPS[-1]:g}°, under {len(CONDITIONS)} conditions: {'; '.join(CONDITIONS)}. After learning, at 12 V.",
        "",
        "| | opens in | closes in | largest force | where | false reversals | rods not reached |",
        "|---|---|---|---|---|---|---|",
    ]
    for vehicle in VEHICLES:
        outcomes = travel[vehicle]
        plain = outcomes[next(iter(CONDITIONS))]
        peak, name, gap = _worst(outcomes)
        false = sum(each.false for each in outcomes.values())
        judged = 2 * FREE * len(outcomes)
        missed = sum(each.missed for each in outcomes.values())
        lines.append(
            f"| {vehicle} | {plain.opening:.1f} s | {plain.closing:.1f} s | **{peak:.0f} N** | {gap:g}°, {name} "
            f"| {false} of {judged} | {missed} of {len(GAPS) * len(outcomes)} |"
        )
    return [*lines, ""]


def _many(many: Mapping[str, Many]) -> list[str]:
    total, false = sum(each.judged for each in many.values()), sum(e.false for e in many.values())
    lines = [
        "## Cars of a production",
        "",
        f"{sum(each.cars for each in many.values())} cars drawn from the vehicles' `[spread]`, each at a voltage "
        f"of 9.5 to 15 V, at -20 to 60 °C and on a slope of ±8° of its own; after learning {FREE} openings and "
        f"closings undisturbed, then a rod somewhere. **{false} of {total}** motions reversed falsely.",
        "",
        "| | cars | false | force, median | 95 % | largest |",
        "|---|---|---|---|---|---|",
    ]
    for vehicle, each in many.items():
        middle, high = np.quantile(each.peaks, (0.5, 0.95))
        lines.append(
            f"| {vehicle} | {each.cars} | {each.false} of {each.judged} | {middle:.0f} N | {high:.0f} N "
            f"| {largest_of(each):.0f} N |"
        )
    return [*lines, ""]


def _trade(trade: Mapping[float, Mapping[str, Many]]) -> list[str]:
    lines = [
        "## What a larger tolerance costs",
        "",
        "All tolerances are multiplied by a factor, the tolerance scale: 1 is calibrated. The table has the "
        "largest force on the rods of the drawn cars, and how many of their motions reverse falsely.",
        "",
        "![Largest pinch force over the travel; largest pinch force and share of false reversals over the "
        "tolerance scale](anti-trap.png)",
        "",
        "| tolerance scale | " + " | ".join(f"{each}: force, false" for each in VEHICLES) + " |",
        "|---|" + "---|" * len(VEHICLES),
    ]
    for factor, found in trade.items():
        cells = [
            f"{largest_of(found[each]):.0f} N, {found[each].false} of {found[each].judged}" for each in VEHICLES
        ]
        lines.append(f"| {factor:g} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _rods(rods: Mapping[tuple[str, float], list[Any]], energies: Mapping[str, Energy]) -> list[str]:
    lines = [
        "## Stiffer rods, and what physics allows",
        "",
        f"A rod of stiffness k that takes {LIMIT:g} N has taken up F²/2k. What moves at the edge with the speed v "
        "has ½ m v², nearly all of it in the rotors: without any brake the force would be v √(k m), so that only "
        "the first speed below were allowed. The motors, reversed at full voltage as soon as the load shows, take "
        "up the rest; the second speed is the one at which the peak is the limit with the reference ECU, closing "
        "as a whole slower, at 35°. The load shows late: the gate's mass on its mechanism, and at some places the "
        "backlash, keep it from the motors for 10 to 25 ms.",
        "",
        "| | gate, kg at the edge | rotors, kg at the edge | rod | at the calibrated speed | unbraked "
        "| with the ECU |",
        "|---|---|---|---|---|---|---|",
    ]
    for vehicle in VEHICLES:
        gate, rotors = energies[vehicle]
        for rod in RODS:
            points = rods[vehicle, rod]
            speed, peak = points[0]
            alone = LIMIT / math.sqrt(rod * (gate + rotors))
            allowed = speed_for(points)
            shown = "slower than measured" if math.isnan(allowed) else f"{allowed:.3f} m/s"
            if allowed >= speed:
                shown = f"{speed:.3f} m/s and more"
            lines.append(
                f"| {vehicle} | {gate:.1f} | {rotors:.0f} | {1e-3 * rod:g} N/mm | {peak:.0f} N at {speed:.3f} m/s "
                f"| {alone:.3f} m/s | {shown} |"
            )
    return lines
