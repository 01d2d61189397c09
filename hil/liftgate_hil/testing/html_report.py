"""HTML report of a suite: one page with verdicts, requirements, and a picture of each expectation.

The size of all pictures is limited, and they are taken as the scenarios end: what passes has a share of its own,
so that many passes leave room for what fails.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from liftgate_hil.errors import number_of
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, Verdict, margin_text, worst
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.page import Markup, alert, page, pairs, section, table, text
from liftgate_hil.report.trace_plot import STYLE as TRACE_STYLE
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Outcome, counts_of, subject_of, verdict_of
from liftgate_hil.testing.picture import expectation_svgs, left_out
from liftgate_hil.testing.sections import (
    badge,
    figures_of,
    limits_section,
    mutants_section,
    scenario_section,
    value_names,
)

MOST_PASSED, MOST_OTHERS = 8_000_000, 16_000_000  # bytes of pictures
NO_REQUIREMENT = "none"

_STYLE = """
:root { --pass: #00704f; --fail: #b3261e; --unsure: #8a5a00; }
@media (prefers-color-scheme: dark) { :root { --pass: #2fc79c; --fail: #ff8a80; --unsure: #f2bd5b; } }
@media print { :root { --pass: #00704f; --fail: #b3261e; --unsure: #8a5a00; } }
.v { font-weight: 700; border: 1.5px solid currentColor; border-radius: .3rem; padding: 0 .4rem; font-size: .85em;
  white-space: nowrap; }
.pass { color: var(--pass); } .fail, .error { color: var(--fail); } .inconclusive { color: var(--unsure); }
.error { border-style: double; border-width: 3px; } h1 .v { font-size: .8em; vertical-align: .08em; }
a { color: var(--final); text-decoration-thickness: 1px; text-underline-offset: 2px; }
code { font: .9em ui-monospace, monospace; overflow-wrap: anywhere; }
td { overflow-wrap: anywhere; } td.n { overflow-wrap: normal; }
section.scenario { border-top: 2px solid var(--grid); margin-top: 2rem; padding-top: .2rem;
  content-visibility: auto; contain-intrinsic-size: auto 60rem; }
section.scenario h3 { font-size: 1.1rem; margin: .8rem 0 .2rem; }
details { border: 1px solid var(--grid); border-radius: .4rem; padding: .35rem .8rem; margin: .7rem 0; }
summary { cursor: pointer; overflow-wrap: anywhere; } summary b { font-weight: 600; }
summary .soft { color: var(--soft); } details figure { margin: .6rem 0 .3rem; }
@media print { details { break-inside: avoid; } section.scenario { content-visibility: visible; }
  details::details-content { content-visibility: visible; height: auto; }
  a { color: inherit; text-decoration: none; } section.scenario h3 { break-after: avoid; } }
"""


class SuiteReport:
    """Collects the pictures of outcomes while a suite runs, and makes the HTML report at its end."""

    def __init__(self) -> None:
        self._figures: dict[tuple[str, str], str] = {}
        self._left = {True: MOST_PASSED, False: MOST_OTHERS}

    def take(self, outcome: Outcome) -> Outcome:
        """Draw an outcome's pictures and keep them up to a size limit; return it without its trace summaries."""
        result = outcome.result
        if result is None:
            return outcome
        rig = outcome.case.plan.rig
        expectations = outcome.case.plan.setup.scenario.expectations
        for expectation, verdict in zip(expectations, outcome.expectations, strict=True):
            trace_summary = result.trace_summaries.get(expectation.name)
            is_pass = verdict.verdict == PASS
            if trace_summary is None or self._left[is_pass] <= 0:
                continue
            names = value_names(rig)
            drawn = expectation_svgs(expectation, verdict, trace_summary, names)
            found = figures_of(drawn, verdict, trace_summary, left_out(trace_summary, names))
            self._left[is_pass] -= len(found.encode())
            if self._left[is_pass] > 0:
                self._figures[outcome.case.file, expectation.name] = found
        return replace(outcome, result=replace(result, trace_summaries={}))

    def html(
        self, outcomes: Sequence[Outcome], provenance: Provenance, mutation: MutationResult | None = None
    ) -> str:
        """Return the suite's HTML report; `mutation` is the result of mutation testing, if there was any."""
        title = f"Test report: {verdict_of(outcomes)}"
        if mutation is not None:  # these tests are what is tested, and the verdict of the sound ECU is no score
            matrix = mutation.matrix
            title = f"Mutation testing: {'stopped before its end' if matrix is None else matrix.summary()}"
        summary = _summary(outcomes)
        return page(
            title,
            f"{number_of(len(outcomes), subject_of(outcomes))}, liftgate-hil "
            f"{provenance.versions.get('liftgate-hil', '')}, {provenance.date}",
            [
                *([] if mutation is None else [mutants_section(mutation)]),
                summary if mutation is None else section("The ECU without a defect", summary),
                section("Not passed", _not_passed(outcomes)),
                section("Requirements", _requirements(outcomes)),
                limits_section(outcomes),
                section(
                    f"{subject_of(outcomes).capitalize()}s",
                    self._note(outcomes),
                    *(scenario_section(place, each, self._figures) for place, each in enumerate(outcomes)),
                ),
                section("Provenance", _origin(outcomes, provenance)),
            ],
            TRACE_STYLE + _STYLE,
        )

    def _note(self, outcomes: Sequence[Outcome]) -> str:
        ran = sum(len(each.expectations) for each in outcomes if each.result is not None)
        lacking = ran - len(self._figures)
        note = "Pictures of passed expectations are folded: click a line to open them."
        if lacking > 0 and min(self._left.values()) <= 0:
            most = (MOST_PASSED + MOST_OTHERS) / 1e6
            note += (
                f" To keep the page small, pictures take {most:.0f} MB at most: {lacking} expectations have none."
            )
        return f'<p class="soft">{text(note)}</p>'


def _summary(outcomes: Sequence[Outcome]) -> str:
    counts = counts_of(outcomes)
    total, counted = counts.total, ", ".join(f"{number} {name}" for name, number in counts.by_verdict().items())
    scenarios = [each.verdict for each in outcomes]
    by_scenario = ", ".join(
        f"{scenarios.count(name)} {name}" for name in (PASS, FAIL, INCONCLUSIVE, ERROR) if name in scenarios
    )
    setups = [each.case.plan.setup for each in outcomes]
    what = subject_of(outcomes)
    run = [
        ("ECU", _each(_ecu_name(outcome) for outcome in outcomes)),
        ("vehicle", _each(Path(each.vehicle_name).name for each in setups)),
        ("rig", _each(Path(each.case.plan.rig.source).name for each in outcomes)),
        ("seed", _each(str(each.seed) for each in setups)),
        ("clock", _each(outcome.case.job.request.clock for outcome in outcomes)),
        ("timing", _timing(outcomes)),
    ]
    if what == "recording":
        run = [("judged by", _each(each.scenario.source for each in setups)), run[2]]
    rows = [
        ("verdict", badge(verdict_of(outcomes))),
        ("expectations", f"{total}, of which {counted}"),
        ("inconclusive", f"{100.0 * counts.inconclusive_share:.1f} % of the expectations"),
        (f"{what}s", f"{len(outcomes)}: {by_scenario}"),
        ("folder", str(_folder(outcomes))),
        *run,
    ]
    stopped = [each for each in outcomes if each.reason.startswith("stopped")]
    warning = f"Incomplete: stopped early, and {number_of(len(stopped), what)} did not end."
    return alert([warning] if stopped else []) + pairs(rows)


def _ecu_name(outcome: Outcome) -> str:
    job = outcome.case.job
    name = str(job.request.ecu) if isinstance(job.request.ecu, str | Path) else type(job.request.ecu).__name__
    return f"{name}, mutant {job.mutant}" if job.mutant else name


def _each(values: Iterable[str], most: int = 5) -> str:
    """Return the different values joined by commas, at most `most` of them, and how many more there are."""
    found = list(dict.fromkeys(values))
    more = f" and {len(found) - most} more: see the scenarios" if len(found) > most else ""
    return ", ".join(found[:most]) + more


def _timing(outcomes: Sequence[Outcome]) -> str:
    """Return in words whether the bench was on time in all runs."""
    summaries = [
        each.result.summary
        for each in outcomes
        if each.result is not None and each.result.summary.clock == "realtime"
    ]
    if not summaries:
        return "model time: the bench cannot be late"
    missed = sum(each.overruns for each in summaries)
    dropped = sum(each.link.dropped for each in summaries)
    late = [each.timing.lateness.max_us for each in summaries if each.timing.lateness.count]
    text = f"{missed} ticks missed, {dropped} received frames dropped"
    if late:
        text += f", latest tick {max(late):.1f} µs late"
    kept = "was on time" if not missed and not dropped else "was late: see the scenarios"
    return f"the bench {kept}; {text}"


def _not_passed(outcomes: Sequence[Outcome]) -> str:
    names = _short_names(outcomes)
    rows = [
        (
            badge(verdict.verdict),
            _link(place, verdict.name, number),
            verdict.reason,
            margin_text(verdict),
            _link(place, names[place]),
        )
        for place, number, _, verdict in _numbered(outcomes)
        if verdict.verdict != PASS
    ]
    heads = ("verdict", "expectation", "reason", "margin", subject_of(outcomes))
    return table(heads, rows, ("n", "name", "soft", "n", "name"))


def _requirements(outcomes: Sequence[Outcome]) -> str:
    """Return the HTML table of requirement, scenario, expectation, verdict; rows without requirement last."""
    names = _short_names(outcomes)
    found: dict[str, list[tuple[int, int, Verdict]]] = {}
    without = []
    for place, number, outcome, verdict in _numbered(outcomes):
        requirements = outcome.case.plan.setup.scenario.requirement
        for each in requirements:
            found.setdefault(each, []).append((place, number, verdict))
        if not requirements:
            without.append((place, number, verdict))
    groups = [*found.items(), *([(NO_REQUIREMENT, without)] if without else [])]
    rows = []
    for name, members in groups:
        whole, seen = worst(verdict.verdict for *_, verdict in members), -1
        for k, (place, number, verdict) in enumerate(members):
            rows.append(
                (
                    Markup(f"{badge(whole)} {text(name)}") if not k else "",
                    badge(verdict.verdict),
                    _link(place, verdict.name, number),
                    margin_text(verdict),
                    _link(place, names[place]) if place != seen else "",
                )
            )
            seen = place
    heads = ("requirement", "verdict", "expectation", "margin", subject_of(outcomes))
    return table(heads, rows, ("name", "n", "name", "r", "name"))


def _folder(outcomes: Sequence[Outcome]) -> Path:
    """Return the common folder of the scenario files, or of the recordings, of all outcomes."""
    folders = [Path(each.case.file).parent.parts for each in outcomes]
    shared = [names[0] for names in zip(*folders, strict=False) if len(set(names)) == 1]
    differs = [len(set(names)) > 1 for names in zip(*folders, strict=False)]
    return Path(*shared[: differs.index(True)] if True in differs else shared)


def _short_names(outcomes: Sequence[Outcome]) -> list[str]:
    """Return each outcome's path of scenario or recording, relative to the common folder."""
    folder = _folder(outcomes)
    return [str(Path(each.case.file).relative_to(folder)) for each in outcomes]


def _numbered(outcomes: Sequence[Outcome]) -> Iterable[tuple[int, int, Outcome, Verdict]]:
    for place, outcome in enumerate(outcomes):
        for number, verdict in enumerate(outcome.expectations):
            yield place, number, outcome, verdict


def _link(place: int, label: str, number: int | None = None) -> Markup:
    target = f"s{place + 1}" + ("" if number is None else f"e{number + 1}")
    return Markup(f'<a href="#{target}">{text(label)}</a>')


def _origin(outcomes: Sequence[Outcome], provenance: Provenance) -> str:
    """Return the HTML of the results' origin: command, machine, versions, all source files, processor features."""
    found: Mapping[tuple[str, str], str] = {
        (each.path, each.sha256): name for outcome in outcomes for name, each in outcome.case.plan.sources.items()
    }
    made = [
        ("command line", Markup(f"<code>{text(provenance.command_line)}</code>")),
        ("date", provenance.date),
        ("machine", f"{provenance.platform}, {provenance.libc}, {provenance.processor}"),
        ("versions", ", ".join(f"{name} {each}" for name, each in provenance.versions.items())),
    ]
    rows = [(name, path, digest) for (path, digest), name in found.items()]
    features = f"processor features: {provenance.processor_features}"
    return (
        pairs(made)
        + table(("source", "file", "SHA-256"), rows, ("n", "", ""))
        + f'<details><summary class="soft">machine code compiled for</summary>'
        f"<p>{text(features)}</p></details>"
    )
