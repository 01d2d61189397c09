"""Checks of this machine's timing, measured with the real-time loop's own code."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.doctor.check import Check, Level, judged, number, read
from liftgate_hil.loop.histogram import Quantiles

if TYPE_CHECKING:
    from liftgate_hil.loop.priority import Realtime

RATES = (10_000, 5_000, 4_000, 2_000, 1_000, 500, 400, 200)  # Hz, rates that may be recommended
BUS_COST = 20.0  # µs per tick for a bus's system calls
TICK_COST = 25.0  # µs per tick that was not measured, with cold caches
FEW = 0.001  # share of periods that may be missed
MANY = 0.01  # share of missed periods above which nothing can be tested
MOTION = 10.0  # s that a gate takes to open and close: the window of many expectations
DIRECT = 0.9  # share of such windows to be judged without stepping the gate again
LONG_LOOK = 60.0  # s, measurement in which a single long wake-up is already too many for that
WITH, WITHOUT = "with FIFO scheduling", "without FIFO scheduling"  # modes of measurements
_TICK_TIME = 0.5  # s, duration of the ticks that are timed


class Wakeups(NamedTuple):
    """Measurement of wake-up lateness: its distribution, and the missed periods."""

    lateness: Quantiles
    missed: int  # periods that were missed
    periods: int
    long: int  # number of wake-ups that were late by more than LONG_NS
    duration: float  # s

    @property
    def missed_share(self) -> float:
        """Share of the periods that were missed, 0 to 1."""
        return self.missed / self.periods

    @property
    def direct_share(self) -> float:
        """Estimated share, 0 to 1, of windows of 10 s (MOTION) without a wake-up more than 5 ms (LONG_NS) late.

        Late wake-ups are assumed to be a Poisson process. In a window with one, a verdict needs the replay.
        """
        return math.exp(-self.long * MOTION / self.duration) if self.long else 1.0


def measure(rate: float, duration: float, realtime: Realtime | None = None) -> Wakeups:
    """Measure wake-up lateness at a rate [Hz] for a duration [s], with real-time settings or (None) without."""
    from liftgate_hil.loop.wakeups import measure_wakeups

    periods = max(1, round(rate * duration))
    lateness, missed, long = measure_wakeups(round(1e9 / rate), periods, realtime)
    return Wakeups(lateness, missed, periods, long, periods / rate)


def measure_tick(rate: float, realtime: Realtime | None = None) -> Quantiles:
    """Return the distribution of a tick's execution time in a run without a bus, paced and with cold caches."""
    import numpy as np

    from liftgate_compiler import compiled
    from liftgate_hil.loop import realtime_loop
    from liftgate_hil.loop.histogram import distribution
    from liftgate_hil.loop.realtime_run import memory_for
    from liftgate_hil.loop.rings import EXECUTION
    from liftgate_hil.loop.tick import constants_in, copied, initial_loop
    from liftgate_hil.loop.wakeups import in_own_thread
    from liftgate_hil.plan.plan import loop_config_of
    from liftgate_hil.plan.setup import rig_from, vehicle_from
    from liftgate_hil.stimuli.stimulus_plan import stimulus_plan_of
    from liftgate_plant.initial import initial_state

    config = loop_config_of(vehicle_from(DEFAULT_VEHICLE), rig_from(DEFAULT_RIG), rate, 0)
    memory = memory_for(rate)
    shared, room = memory.shared, realtime_loop.make_room()
    state = initial_loop(config, initial_state(config.plant, 0.0, latched=True))
    code = compiled(realtime_loop.run_realtime)
    # Without a descriptor all reads and writes fail at once.
    nothing = realtime_loop.RunParams(
        descriptor=-1,
        ticks=0,
        limit_ns=2**62,
        command=0,
        feedback=np.zeros(0, dtype=np.int64),
        stimuli=stimulus_plan_of(constants_in(config)),
        is_last=1,
    )
    code(config, copied(state), nothing, shared, room)  # loads the cache before the measurement
    shared.control[:] = np.zeros(1, shared.control.dtype)
    ticks = max(1, round(rate * _TICK_TIME))

    def run() -> None:
        code(config, state, nothing._replace(ticks=ticks), shared, room)

    def end() -> None:
        shared.control[0].stop = 1

    try:
        in_own_thread(run, end, realtime)
        return distribution(shared.histograms[EXECUTION])
    finally:
        memory.close()


def steal(root: Path) -> dict[str, tuple[int, int]]:
    """Return the (stolen, total) time of each CPU since the machine booted, in the kernel's clock ticks."""
    found = {}
    for line in read(root, "proc/stat").splitlines():
        name, *fields = line.split()
        if name.startswith("cpu") and name != "cpu" and len(fields) >= 8:
            times = [number(field, 0) for field in fields[:8]]
            found[name] = (times[7], sum(times))
    return found


def stolen_percent(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]]) -> dict[str, float]:
    """Return each CPU's share of time [%] that a virtual machine's host took between two readings of `steal`."""
    return {
        name: 100.0 * (after[name][0] - taken) / max(after[name][1] - total, 1)
        for name, (taken, total) in before.items()
        if name in after
    }


def stolen(shares: dict[str, float]) -> Check:
    """Return the check on CPU time that a virtual machine's host took away: `shares` [%] by CPU."""
    worst = max(shares, key=lambda name: shares[name], default="")
    if not worst or shares[worst] <= 0.0:
        return Check("stolen time", "ok", "none during the measurement")
    found = f"the host took {shares[worst]:.1f} % of {worst.upper()}'s time during the measurement"
    return judged("stolen time", found, "give this virtual machine CPUs of its own, or use a real machine")


def recommended(lateness: Quantiles, tick: Quantiles | None, wanted: float) -> float:
    """Return the highest rate [Hz], of RATES or `wanted`, at which under 1 wake-up in 1000 skips ticks; 0: none.

    A tick is skipped when it begins or ends more than a period late: p99.9 of the lateness and the time that
    a tick takes have to fit into a period.
    """
    if not lateness.count:
        return 0
    cost = tick.p99_us + BUS_COST if tick is not None and tick.count else TICK_COST
    needed = lateness.p999_us + cost
    return max((rate for rate in (*RATES, wanted) if needed <= 1e6 / rate), default=0)


def lateness(name: str, wakeups: Wakeups, rate: float, mend: str = "") -> Check:
    """Return the check `name` of a measurement's missed periods, with the remedy `mend` where they are many."""
    from liftgate_hil.loop.statistics import in_words

    missed = f"{wakeups.missed} of {wakeups.periods} periods missed"
    found, few = f"{in_words(wakeups.lateness)} at {rate:g} Hz; {missed}", wakeups.missed_share <= FEW
    return Check(name, "ok" if few else "warning", found, "" if few else mend)


def given(refused: Sequence[str], asked: bool) -> Check:
    """Return the check on `refused` real-time requests: a warning if --realtime was `asked`, else `ok`."""
    if not refused:
        return Check("real time", "ok", "a run gets everything that it requests")
    parts = [text.partition("; ") for text in refused]
    found = f"refused: {', '.join(what for what, _, _ in parts)}"
    mend = "; ".join(how.removeprefix("to get it: ") for _, _, how in parts)
    return Check("real time", "warning", found, mend) if asked else Check("real time", "ok", found)


def tick_cost(tick: Quantiles | None, rate: float) -> Check:
    """Check whether a tick's execution time fits into a period at a rate [Hz]; None: it was not measured."""
    if tick is None:
        return Check("tick", "ok", "not measured: the model is not compiled yet")
    share = f"{100.0 * tick.p50_us * 1e-6 * rate:.1f} % of a period at {rate:g} Hz"
    found = f"takes p50 {tick.p50_us:.1f} µs, p99 {tick.p99_us:.1f} µs without a bus: {share}"
    fits = tick.p99_us + BUS_COST <= 1e6 / rate
    return judged("tick", found, "" if fits else "use a lower --rate, or a faster machine")


def verdict(rate: float, modes: dict[str, Wakeups], tick: Quantiles | None, problems: int) -> Check:
    """Judge fitness for real time at a rate [Hz] by the `modes` WITH/WITHOUT FIFO and the number of `problems`."""
    from liftgate_hil.loop.statistics import force_of

    if not modes:
        return Check("verdict", "problem", "not fit for real time", "fix the problems above")
    rates = {mode: recommended(each.lateness, tick, rate) for mode, each in modes.items()}
    # At equal rates the mode with fewer missed periods is the better one.
    best = max(modes, key=lambda mode: (rates[mode], -modes[mode].missed))
    late = modes[best].lateness.p99_us
    reach = {mode: f"up to {rates[mode]:g} Hz" if rates[mode] else "at no rate" for mode in modes}
    others = [f"{mode}: {text}" for mode, text in reach.items() if mode != best]
    without = " --no-realtime" if best == WITHOUT and len(modes) > 1 else ""
    found = f"for up to {rates[best]:g} Hz {best}{f' ({others[0]})' if others else ''}"
    force = f"a command {late:.0f} µs late (p99) adds {force_of(late):.2f} N of pinch force on a 10 N/mm rod"
    quieter = "end other programs, isolate a CPU, follow the advice above"
    missed, percent = modes[best].missed_share, 100.0 * modes[best].missed_share
    level: Level = "ok"
    text, advice = f"fit {found}, and for tests in real time", ""
    if not rates[best]:
        level, text, advice = "problem", "not fit, even 200 Hz would skip ticks", quieter
    elif missed > MANY:
        text = f"not fit: {percent:.1f} % of the periods at {rate:g} Hz were missed {best}"
        level, advice = "problem", quieter
    elif problems:
        level, text, advice = "problem", f"fit {found}, except for the problems above", "fix these"
    elif rates[best] < rate:
        late_ms = 1e-3 * modes[best].lateness.p999_us
        level = "warning"
        text = f"fit {found}, but not {rate:g} Hz: lateness (p99.9: {late_ms:.2g} ms) and tick exceed a period"
        advice = f"use --rate {rates[best]:g}{without}, or {quieter}"
    elif missed > FEW:
        text = f"fit {found}, but {percent:.2f} % of periods were missed at {rate:g} Hz"
        level, advice = "warning", quieter
    elif modes[best].direct_share < DIRECT:
        why = _untimely(modes[best])
        text = f"fit {found}, but not every test in real time would be conclusive: {why}"
        level = "warning"
        advice = f"test with --clock free or lockstep, or --retry-inconclusive 2; {quieter}"
    elif modes[best].duration < LONG_LOOK:
        text = f"fit {found}; for tests in real time, check with --duration {LONG_LOOK:g}"
    return Check("verdict", level, f"{text}; {force}", advice)


def _untimely(wakeups: Wakeups) -> str:
    """Return a text on late wake-ups: their number, and the share of windows in which a verdict needs a replay."""
    from liftgate_hil.loop.wakeups import LONG_NS

    percent = 100.0 * (1.0 - wakeups.direct_share)
    return (
        f"the loop was late by more than {1e-6 * LONG_NS:g} ms {wakeups.long} times in {wakeups.duration:g} s, so "
        f"about {percent:.0f} % of {MOTION:g} s windows would need a replay for their verdict"
    )


# fmt: off
@dataclass(frozen=True)
class LatenessFigures(DescribedResult):
    """Figures of a wake-up lateness measurement, and what follows from them."""

    lateness: Annotated[Quantiles, Shown("distribution", is_flat=True)]
    missed: Annotated[int, Shown("periods that were skipped")]
    periods: Annotated[int, Shown("periods that were measured")]
    long: Annotated[int, Shown("times that the loop was late by more than 5 ms", key="late_by_5_ms")]
    direct_share: Annotated[float, Shown("estimated share of tests' windows without such a delay, 0 to 1")]
    recommended_rate_hz: Annotated[float, Shown("highest rate at which fewer than one wake-up in a thousand skips "
        "ticks [Hz]; 0: none")]
    pinch_force_error_n: Annotated[float, Shown("pinch force that grows during the 99th percentile, on the rod of "
        "10 N/mm [N]")]


@dataclass(frozen=True)
class DoctorFigures(DescribedResult):
    """Measurements of an examination of the machine."""

    rate_hz: Annotated[float, Shown("rate of the measurement [Hz]")]
    duration_s: Annotated[float, Shown("duration of each measurement [s]")]
    lateness: Annotated[LatenessFigures, Shown("lateness of the loop's wake-ups")]
    lateness_realtime: Annotated[LatenessFigures | None, Shown("the same with FIFO scheduling; null: not "
        "possible, or not measured")]
    tick: Annotated[Quantiles | None, Shown("execution time of a tick; null: not compiled yet (see `compile`)")]
    tick_share_percent: Annotated[float | None, Shown("median execution time as a share of the period [%]; null: "
        "as above")]
    stolen_percent: Annotated[Mapping[str, float], Shown("time that the host of a virtual machine took, by CPU",
        keys={"CPU": "share [%]"})]


# fmt: on
def figures(
    rate: float,
    duration: float,
    plain: Wakeups,
    fifo: Wakeups | None,
    tick: Quantiles | None,
    stolen_shares: Mapping[str, float],
) -> DoctorFigures:
    """Return all measurements as figures of the report."""
    from liftgate_hil.loop.statistics import force_of

    def of(wakeups: Wakeups) -> LatenessFigures:
        return LatenessFigures(
            wakeups.lateness,
            wakeups.missed,
            wakeups.periods,
            wakeups.long,
            wakeups.direct_share,
            recommended(wakeups.lateness, tick, rate),
            force_of(wakeups.lateness.p99_us),
        )

    return DoctorFigures(
        rate,
        duration,
        of(plain),
        of(fifo) if fifo is not None else None,
        tick,
        100.0 * tick.p50_us * 1e-6 * rate if tick is not None else None,
        stolen_shares,
    )
