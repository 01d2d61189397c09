"""Page docs/campaigns-at-scale.md: the cost, the simulation, the first bottleneck, the check, the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tools.benchmark.machine import machine_lines
from tools.scheduling import remedy
from tools.scheduling.check import Checked, lines_of
from tools.scheduling.figures import CODE, Figures, rows_of
from tools.scheduling.measure import Stored
from tools.scheduling.model import CAUSES, Case, Result, simulate

VARIANTS, WORKERS = (10**4, 10**6, 10**8), (2, 100, 2000)
LARGEST = Case(VARIANTS[-1], WORKERS[-1])
_SHOWN = 0.005  # of the workers' time, from which a cause is shown
_WORDS = {
    "preparation": "design and list of batches",
    "start": "start of the workers",
    "client": "waiting for the client, which passes batches on and takes results in",
    "scheduler": "waiting for Dask's scheduler",
    "store": "writing to the store",
    "task": "overhead of a batch",
    "cores": "waiting for a core that others use",
    "deaths": "what a worker had done when it died, and its start again",
    "tail": "waiting for the last batches",
    "merge": "bringing results together",
    "report": "the report, which one process makes of all rows",
}
_HEAD = """# Campaigns at scale

Made by `make scheduling`. A campaign on 2,000 workers is simulated (`tools/scheduling/model.py`, discrete
events): batches, workers that start, are slow or die, the store, Dask's scheduler, and the client: the process
that runs `liftgate-hil campaign`. Its inputs were measured on one machine, or are marked as assumed. A variant
is 10 s of model time, a gate that closes onto a rod (`docs/examples/rod.toml`), with two values varied. How to
run one: [a campaign on a cluster](cluster.md).

"""
_INPUTS = """## Inputs of the simulation

The client's cost of a batch is that of the executor itself: batches without work go through a real Dask scheduler,
which names as many workers as a large cluster has, while two answer. All of them share this machine's cores, so
the figure is an upper bound.

| | | source |
|---|---|---|
"""
_CHECK = """## The check

Worker processes on this machine, and the simulation of the same. Cores: what the machine's other processes
left. Start and variant are CPU times of runs with one process. Where other processes use all the remaining
time, a run gets its share only: the check then tests the cost of batches, of starts and of the client, not the
number of cores.

"""
_PASSAGE = """Batches without work through a cluster. What a batch costs is from the first and the last line.

"""
_STEPS = """## The first bottleneck

{variants:,} variants on {workers:,} workers, as the code was: the client took **{memory:.0f} GB of memory**,
most of it for the report; on a machine with less the campaign ended there.
Of the workers' time most went into **{first}**, {share:.0f} %.

{few:,} variants: most went into **{small}**, {small_share:.0f} %.
Batches of {size} variants were over before the client could pass on others.
Each line adds a remedy to those above it.

| | time | efficiency | costs most | memory |
|---|---|---|---|---|
"""


def page_of(
    figures: Figures, files: Stored, checked: tuple[Sequence[Checked], Sequence[Checked]], load: float
) -> str:
    """Return the page."""
    runs, passages = checked
    lines = [
        *_cost(figures),
        *_simulated(figures),
        *_steps(figures),
        _CHECK.rstrip("\n"),
        "",
        *lines_of(runs),
        _PASSAGE.rstrip("\n"),
        "",
        *lines_of(passages),
        *_inputs(figures, files),
        "## The machine",
        "",
        *machine_lines(),
        f"- load average before: {load:.1f}; other processes lengthen all times but CPU times",
    ]
    return _HEAD + "\n".join(lines) + "\n"


def _cost(figures: Figures) -> list[str]:
    variants = 10**6
    core_hours = variants * figures.variant_s / 3600.0
    lines = [
        "## What a million variants cost",
        "",
        f"**{core_hours:.1f} core hours** of evaluation, at {1e3 * figures.variant_s:.1f} ms of CPU time each; "
        "with what the workers wait for:",
        "",
        "| workers | time | core hours |",
        "|---|---|---|",
    ]
    for workers in WORKERS:
        result = simulate(Case(variants, workers), figures)
        lines.append(f"| {workers:,} | {_time(result.seconds)} | {workers * result.seconds / 3600.0:.1f} |")
    return [
        *lines,
        "",
        "A scenario with preconditions, diagnostics or a user's ECU takes more, in proportion.",
        "",
    ]


def _simulated(figures: Figures) -> list[str]:
    lines = [
        "## The simulation",
        "",
        "Efficiency: time in which workers evaluate, over the time of all workers until the report is there. "
        f"Causes of {100.0 * _SHOWN:g} % and more.",
        "",
        "| variants | workers | batch | files | time | efficiency | the rest | memory | deaths |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for variants in VARIANTS:
        for workers in WORKERS:
            each = simulate(Case(variants, workers), figures)
            lines.append(
                f"| {variants:,} | {workers:,} | {each.size:,} | {each.files:,} | {_time(each.seconds)} "
                f"| {100.0 * each.efficiency:.0f} % | {_causes(each)} | {_bytes(each.memory)} | {each.deaths} |"
            )
    return [*lines, "", *(f"- {cause}: {_WORDS[cause]}" for cause in CAUSES), ""]


def _causes(result: Result) -> str:
    found = sorted(((result.share(cause), cause) for cause in CAUSES), reverse=True)
    return ", ".join(f"{cause} {100.0 * share:.0f} %" for share, cause in found if share >= _SHOWN) or "—"


def _steps(figures: Figures) -> list[str]:
    found = remedy.steps(LARGEST, figures)
    small = Case(VARIANTS[1], WORKERS[-1])
    few = remedy.steps(small, figures)
    first, smaller = found[0].result, few[0].result
    head = _STEPS.format(
        variants=LARGEST.variants, workers=LARGEST.workers, first=_WORDS[first.bottleneck],
        share=100.0 * first.share(first.bottleneck), memory=1e-9 * first.memory, few=small.variants,
        small=_WORDS[smaller.bottleneck], small_share=100.0 * smaller.share(smaller.bottleneck), size=smaller.size,
    )  # fmt: skip
    lines = [head.rstrip("\n")]
    for steps in found, few:
        lines += [_step(each) for each in steps]
    last = found[-1].result
    return [
        *lines,
        "",
        f"What costs most now: {_WORDS[last.bottleneck]}. Without slow machines the efficiency is "
        f"{100.0 * _without_slow(figures):.0f} %.",
        "",
    ]


def _step(step: remedy.Step) -> str:
    own = step.result
    return (
        f"| {own.case.variants:,}: {step.what} | {_time(own.seconds)} | {100.0 * own.efficiency:.0f} % "
        f"| {_causes_first(own)} | {_bytes(own.memory)} |"
    )


def _without_slow(figures: Figures) -> float:
    return simulate(LARGEST, replace(figures, slow_share=0.0), CODE).efficiency


def _causes_first(result: Result) -> str:
    return f"{result.bottleneck} {100.0 * result.share(result.bottleneck):.0f} %"


def _inputs(figures: Figures, files: Stored) -> list[str]:
    lines = [_INPUTS.rstrip("\n")]
    for meaning, value, unit, source in rows_of(figures):
        lines.append(f"| {meaning} | {_value(value)} {unit} | {source} |".replace("  |", " |"))
    listed = ", ".join(f"{1e3 * seconds:.1f} ms for {count:,}" for count, seconds in files.listing.items())
    return [
        *lines,
        "",
        f"Listing a folder of files: {listed}. A row takes {files.bytes_each:.0f} B in the store.",
        "",
    ]


def _value(value: float) -> str:
    return f"{value:.3g}"


def _bytes(count: float) -> str:
    return f"{1e-9 * count:.1f} GB" if count >= 1e8 else f"{1e-6 * count:.0f} MB"


def _time(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
