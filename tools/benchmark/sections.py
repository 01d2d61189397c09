"""Sections of the report: each measures, and returns its lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tools.benchmark import (
    campaigns,
    costs,
    episodes,
    identification,
    inactive,
    page_clients,
    parts,
    processes,
    replays,
    tables,
)
from tools.benchmark.checkouts import name_of
from tools.benchmark.effort import WHOLE, Effort
from tools.benchmark.units import paragraph, shown
from tools.c_translator.build import BUILDS, compare
from tools.c_translator.build import ROUNDS as STEP_ROUNDS


def step_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about the compiled plant step against its C translation."""
    points = compare(effort.of(STEP_ROUNDS), BUILDS[: effort.builds])
    lines = [
        "## The step against C",
        "",
        paragraph(
            """The plant's step, translated to C and built in several ways, in turns with ours; the ratio is our
            time to that build's, so under 1 is faster than C. Without FMA the results are bit-equal; builds with
            it show what it would bring. CPU time, medians."""
        ),
        "",
        "| | ours | " + " | ".join(each.name for each in BUILDS) + " |",
        "|---|---|" + "---|" * len(BUILDS),
    ]
    for name, point in points.items():
        cells = [
            f"**{point.ratio(each.name):.2f}** ({shown(point.translations[each.name])})"
            if each.name in point.translations
            else "not measured"
            if each.is_installed
            else "not installed"
            for each in BUILDS
        ]
        lines.append(f"| {name} | {shown(point.compiled)} | {' | '.join(cells)} |")
    return [*lines, ""]


def episode_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about the closed loop in machine code."""
    lines = [
        "## The closed loop in machine code",
        "",
        paragraph(
            """An episode of the demo (gate, sensors, codec both ways, ECU, rows) against the plant's step with its
            sensors under the very same inputs, in turns; CPU time of a tick, medians. Python ECUs are called every
            10 ms."""
        ),
        "",
        "| | ratio, median | ratio of the minima | episode | plant and sensors |",
        "|---|---|---|---|---|",
    ]
    for name, each in episodes.measure(effort.of(episodes.ROUNDS), effort.ticks).items():
        lines.append(
            f"| {name} | **{each.ratio:.2f}** | {each.least_ratio:.2f} | {shown(each.episode)} "
            f"| {shown(each.plant)} |"
        )
    lines += ["", "| `demo --clock free`, at the margin | × real time | × real time of CPU |", "|---|---|---|"]
    lines += [
        f"| {name} | **{pace.wall:.0f}** | {pace.cpu:.0f} |" for name, pace in processes.paces(effort).items()
    ]
    return [*lines, ""]


def inactive_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about faults and expectations that a scenario contains and that do nothing."""
    return [
        "## Faults and expectations that do nothing",
        "",
        paragraph(
            """An episode of the demo with faults that never come and with expectations, against the same without,
            in turns; CPU time of a tick, its judge's included: medians of the rounds, and the ratio of the minima.
            A fault that waits for a condition has it evaluated in each tick."""
        ),
        "",
        *inactive.table(inactive.measure(effort.of(inactive.ROUNDS), effort.ticks)),
        "",
    ]


def campaign_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about campaigns."""
    return [
        "## Campaigns",
        "",
        paragraph(
            """Variants of a trapping scenario of 10 s with the reference ECU, a rod and a temperature drawn. The
            bare episode is the closed loop in machine code alone, of the very same variants, in turns. Then
            `liftgate-hil campaign` as a command; memory is that of all of its processes, shared pages counted
            once."""
        ),
        "",
        *campaigns.lines(effort.variants, effort.many_variants, effort.of(campaigns.ROUNDS)),
        "",
    ]


def replay_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about the lateness of `replay` against other players of logs."""
    rounds, seconds = effort.of(replays.ROUNDS), effort.replay_seconds
    lines = [
        "## Lateness of a replay",
        "",
        paragraph(
            f"""The same log of {seconds:g} s, 1000 frames a second at no period, played in turns by
            `liftgate-hil replay`, python-can's `can.player` and can-utils' `canplayer` ({rounds} rounds,
            medians); stamps are the kernel's, of what arrives. Of each run the frame that is earliest against the
            log counts as on time. Ours also tells its lateness itself, from when each frame was due."""
        ),
        "",
    ]
    found = {}
    if effort.is_on_vcan:
        found["a real vcan0, in a User-Mode Linux machine of one CPU where this kernel has none"] = (
            replays.on_vcan(rounds, seconds)
        )
    found["udp_multicast, python-can's own bus on this machine"] = replays.measure(
        f"udp_multicast:{replays.GROUP}", rounds, seconds, effort.is_warmed
    )
    for bus, figures in found.items():
        if figures is not None:
            lines += [f"On {bus}:", "", *replays.table(figures), ""]
    return lines


def page_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about clients of the operator's page."""
    rounds, seconds = effort.of(page_clients.ROUNDS), effort.page_seconds
    return [
        "## Lateness with clients of the page",
        "",
        paragraph(
            f"""Runs with `--dashboard`, in turns without clients and with {page_clients.CLIENTS}, one of which
            never reads; {rounds} pairs of {seconds:g} s. The clients run while no other program does and off the
            CPU of the loop, as if they were on another machine; the page's server belongs to the bench and gives
            way as always. The ratio is the median of the pairs' own, with its interval; p is that of Wilcoxon's
            signed-rank test on the pairs, for missed ticks that of the sign test, both two-sided: a small one
            would say that clients change the lateness."""
        ),
        "",
        *page_clients.table(page_clients.measure(rounds, seconds, effort.policies)),
        "",
    ]


def parts_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about the cost of each optional part of the plant and its sensors."""
    lines = [
        "## What each part costs",
        "",
        paragraph(
            """A step of the moving SUV with its sensors: of the ideal gate, with one part more each, and as
            shipped, in turns. CPU time, medians of rounds; the ratio is the median of each round's own."""
        ),
        "",
        "| | tick | to the ideal gate's | least |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {shown(each.tick)} | **{each.ratio:.2f}** | {shown(each.least)} |"
        for name, each in parts.measure(effort.of(parts.ROUNDS)).items()
    ]
    return [*lines, ""]


def start_section(roots: Sequence[Path], effort: Effort = WHOLE) -> list[str]:
    """Return the section about the times of commands from start to exit."""
    lines = [
        "## Start",
        "",
        paragraph(
            """Commands that do next to nothing but start, cold with an empty cache of machine code, warm with what
            that has left (medians). CPU time includes the process that compiles."""
        ),
        "",
        "| from start to exit | | cold: wall | cold: CPU | warm: wall | warm: CPU |",
        "|---|---|---|---|---|---|",
    ]
    for name, each in processes.compiles(roots, effort).items():
        lines += [
            f"| {name} | {name_of(root)} | {_start(times.cold)} | {_start(times.warm)} |"
            for root, times in each.items()
        ]
    return [*lines, ""]


def _start(times: processes.Times | None) -> str:
    """Return two cells of a table: wall time and CPU time."""
    if times is None:
        return "not measured | not measured"
    return f"{shown(times.wall)} | **{shown(times.cpu)}**"


def table_section(roots: Sequence[Path], effort: Effort = WHOLE) -> list[str]:
    """Return the section about an hour of `simulate` in each format of tables."""
    seconds = effort.table_seconds
    lines = [
        "## An hour of `simulate`",
        "",
        paragraph(
            f"""{seconds * 1000:,.0f} rows of all columns at 1 ms, from start to exit, in each format of
            tables. Simulating and writing overlap, so that the wall time is less than the CPU time where two CPUs
            are free."""
        ),
        "",
        "| | format | | wall | CPU | memory at most | file |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {motion} | `{suffix}` | {name_of(root)} | {shown(each.wall)} | **{shown(each.cpu)}** "
        f"| {each.peak / 1e6:.0f} MB | {each.size / 1e6:,.0f} MB |"
        for (motion, suffix, root), each in tables.measure(roots, effort).items()
    ]
    return [*lines, ""]


def identification_section(against: Path | None, effort: Effort = WHOLE) -> list[str]:
    """Return the section about the cost of `identify` by number of rows."""
    by_rows = [
        # Another checkout may take minutes for a million rows.
        identification.table((rows,), against if rows < 1_000_000 else None, rounds)
        for rows, rounds in effort.identify_rows
    ]
    return [
        "## `identify` by rows",
        "",
        paragraph(
            """The whole command, start-up included and the machine code on the disk: `--preset thesis-1` on a gate
            that goes back and forth; the least of the runs. Simulations run on all CPUs. Where the search begins
            far off, a problem of few rows leads it near, and all rows are needed some twenty times."""
        ),
        "",
        *by_rows[0],
        *(line for each in by_rows[1:] for line in each[2:]),
        "",
    ]


def cost_section(effort: Effort = WHOLE) -> list[str]:
    """Return the section about the cost of steps, ticks and whole commands."""
    lines = ["## Cost", "", "| | |", "|---|---|"]
    figures = costs.measure(effort)
    lines += [f"| {name} | {shown(value)} |" for name, value in figures.items()]
    hot = figures[costs.HOT]
    return [*lines, f"| ticks a second that one core makes, with socket I/O | {1.0 / hot:,.0f} |", ""]
