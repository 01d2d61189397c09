"""Sections of a test report: each scenario with its pictures, mutants that scenarios find, force limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from liftgate_hil.config.rig import Rig
from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.judging.expectation import Expectation
from liftgate_hil.judging.trace_summary import TraceSummary
from liftgate_hil.judging.verdict import PASS, REPLAY, Verdict, margin_text
from liftgate_hil.plan.force_limits import force_limits_of
from liftgate_hil.report.page import Markup, alert, bullets, figure, pairs, section, table, text
from liftgate_hil.report.pinch import BORROWED, ORIGINS, OWN_LIMIT
from liftgate_hil.signals import COLUMNS
from liftgate_hil.testing.mutation import MutationResult
from liftgate_hil.testing.outcome import Outcome
from liftgate_hil.testing.picture import Names, decided
from liftgate_hil.testing.words import happenings, window_words

_MOST_HAPPENINGS = 60
_MOST_KILLERS = 6  # expectations that are named for a mutant
_MOST_USERS = 4  # and for a limit
_STEPPED_AGAIN = (
    "the gate was simulated again with the recorded commands, and these shifted by the delay: all agree"
)


def badge(verdict: str) -> Markup:
    """Return a verdict as a highlighted label in HTML."""
    return Markup(f'<span class="v {text(verdict)}">{text(verdict)}</span>')


def value_names(rig: Rig) -> Names:
    """Return the function from the name of a column or bus signal to its labels, by value; {}: it has none."""

    def found(name: str) -> Mapping[float, str]:
        if name in COLUMNS:
            return {float(k): label for k, label in enumerate(COLUMNS[name].values)}
        message, _, signal = name.partition(".")
        if message not in rig.messages:
            return {}
        own = next((each for each in rig.messages[message].signals if each.name == signal), None)
        choices = own.choices if own is not None else None
        return {float(value): str(label) for value, label in (choices or {}).items()}

    return found


def figures_of(drawings: Sequence[str], verdict: Verdict, trace_summary: TraceSummary, left_out: int) -> str:
    """Return the HTML of an expectation's pictures, around window and margin, with captions; "": no pictures."""
    found = []
    for drawing, view in zip(drawings, (trace_summary.view, trace_summary.near), strict=False):
        notes = []
        if view is trace_summary.near:
            notes.append("Around the margin.")
        elif verdict.window_s is None:
            notes.append("The whole run: the window never opened.")
        if view is not None and view.ticks > 1:
            each = f"{1e3 * view.bin_s:g} ms"
            notes.append(f"Drawn: the smallest and the largest value of each {each}, so that no peak is lost.")
        if left_out and view is trace_summary.view:
            notes.append(f"{left_out} more signals are not drawn.")
        found.append(figure(drawing, " ".join(notes)))
    return "\n".join(found)


def scenario_section(place: int, outcome: Outcome, figures: Mapping[tuple[str, str], str]) -> str:
    """Return the HTML section of a scenario; `figures` are its expectations' pictures, by file and name."""
    scenario = outcome.case.plan.setup.scenario
    expectations = [each.with_numbers(scenario.parameters) for each in scenario.expectations]
    result = outcome.result
    came = () if result is None else (result.condition_times, result.summary.model_time_s)
    happened = [] if outcome.case.recordings else happenings(scenario, *came)
    rest = len(happened) - _MOST_HAPPENINGS
    entries = [*happened[:_MOST_HAPPENINGS], *([f"and {rest} more"] if rest > 0 else [])]
    parts = [
        f'<section class="scenario" id="s{place + 1}">',
        f"<h3>{badge(outcome.verdict)} {text(outcome.case.file)}</h3>",
        f"<p>{text(' '.join(str(scenario.description).split()))}</p>" if scenario.description else "",
        alert([outcome.reason] if outcome.reason else []),
        f"<h4>Notes</h4>\n{bullets(outcome.notes)}" if outcome.notes else "",
        pairs(_facts(outcome)),
        f"<h4>What happens</h4>\n{bullets(entries)}" if entries else "",
        "<h4>What is expected</h4>",
        *(
            _expectation(f"s{place + 1}e{k + 1}", each, verdict, figures, outcome.case.file)
            for k, (each, verdict) in enumerate(zip(expectations, outcome.expectations, strict=True))
        ),
        "</section>",
    ]
    return "\n".join(part for part in parts if part)


def _facts(outcome: Outcome) -> Sequence[tuple[str, str]]:
    setup, result, job = outcome.case.plan.setup, outcome.result, outcome.case.job
    scenario, request = setup.scenario, outcome.case.plan.request
    parameters = ", ".join(f"{name} = {value:g}" for name, value in scenario.parameters.items())
    settings = ", ".join(f"{each.key} = {each.value}" for each in scenario.settings)
    source = outcome.case.plan.sources.get("scenario")
    is_recorded = bool(outcome.case.recordings)
    rows = [
        ("requirement", ", ".join(scenario.requirement) or "none"),
        ("parameters", parameters),
        ("rig", Path(outcome.case.plan.rig.source).name),
    ]
    if is_recorded:
        rows.append(("judged by", scenario.source))
    else:
        rows[2:2] = [
            ("set", ", ".join(filter(None, (settings, ", ".join(job.request.settings))))),
            ("vehicle", f"{Path(setup.vehicle_name).name}, starts {_start(outcome)}, seed {setup.seed}"),
        ]
        rows.append(("clock", f"{request.clock}, {request.rate:g} Hz"))
    if result is not None and is_recorded:
        summary = result.summary
        rows.append(("rows", f"{summary.ticks}, up to {summary.model_time_s:.6g} s"))
    elif result is not None:
        rows.append(("run", "; ".join(result.summary.lines())))
    if result is not None and result.recording:
        rows.append(("recordings", ", ".join(map(str, result.recording))))
    if source is not None:
        rows.append(("SHA-256", source.sha256))
    rows.append(("took", f"{outcome.wall_s:.2f} s"))
    return [row for row in rows if row[1]]


def _start(outcome: Outcome) -> str:
    initial = outcome.case.job.request.initial
    initial = outcome.case.plan.setup.scenario.initial if initial is None else initial
    return initial if isinstance(initial, str) else f"at {initial:g} deg"


def _expectation(
    target: str, expectation: Expectation, verdict: Verdict, figures: Mapping[tuple[str, str], str], file: str
) -> str:
    instant = decided(expectation, verdict)
    is_sharp = instant is not None and verdict.time_s != verdict.margin_time_s
    margin = f"margin {margin_text(verdict)}" if verdict.has_margin else ""
    rows = [
        ("formula", Markup(f"<code>{text(expectation.formula)}</code>")),
        ("window", window_words(expectation, verdict.window_s)),
        ("margin", _margin(verdict, expectation.hold)),
        *([(instant[1], f"at {instant[0]:.6g} s")] if instant and is_sharp else []),
        *([("the bench was late", _STEPPED_AGAIN)] if verdict.method == REPLAY else []),
        ("reason", verdict.reason),
    ]
    is_open = "" if verdict.verdict == PASS else " open"
    return "\n".join(
        [
            f'<details id="{target}"{is_open}><summary>{badge(verdict.verdict)} '
            f'<b>{text(expectation.name)}</b> <span class="soft">{text(margin)}</span></summary>',
            pairs([row for row in rows if row[1]]),
            figures.get((file, expectation.name), ""),
            "</details>",
        ]
    )


def _margin(verdict: Verdict, hold: float) -> str:
    if not verdict.has_margin:
        return ""
    label = margin_text(verdict)
    if verdict.decided_by:
        label += f" of {verdict.decided_by}"
    if verdict.margin_time_s is not None:
        held = f"in the {hold:g} s up to" if hold else "at"
        label += f", {held} {verdict.margin_time_s:.6g} s"
    return label


def mutants_section(mutation: MutationResult) -> str:
    """Return the HTML section on mutants: survivors, then killed ones, then expectations that prove nothing."""
    parts = [f"<p><b>{text(mutation.reason)}.</b></p>"] if mutation.reason else []
    matrix = mutation.matrix
    if matrix is None:
        return section("Mutants", *parts)
    tolerated = [(name, MUTANTS[name].meaning, matrix.where(name)) for name in matrix.tolerated]
    unreached = [(name, MUTANTS[name].meaning) for name in matrix.never_reached]
    rows = []
    for each in MUTANTS.values():
        killers = [f"{file}: {name}" for file, name in matrix.kills(each.name)]
        more = [f"and {len(killers) - _MOST_KILLERS} more"] if len(killers) > _MOST_KILLERS else []
        if killers:
            rows.append((each.name, each.meaning, "; ".join([*killers[:_MOST_KILLERS], *more])))
    parts += [
        "<p>Each mutant of the reference ECU has one defect. It is killed if an expectation fails that the ECU "
        "without a defect passes.</p>"
    ]
    if tolerated:
        parts += [
            "<p>Survived, reached and tolerated: in a scenario the defect changes the ECU's state or "
            "command, and no expectation fails. A stricter expectation kills them; if only internal ECU state "
            "differs, add a scenario that exposes it. "
            "<code>--ecu mutant:NAME</code> runs a scenario with one of them.</p>",
            table(("mutant", "defect", "differs in"), tolerated, ("n", "", "name")),
        ]
    if unreached:
        parts += [
            "<p>Survived, never reached: in every control cycle of every scenario these do what the ECU without a "
            "defect does. It takes another scenario: the manual's page on the pack has one for each mutant.</p>",
            table(("mutant", "defect"), unreached, ("n", "")),
        ]
    if rows:
        parts += ["<p>Killed:</p>", table(("mutant", "defect", "killed by"), rows, ("n", "", ""))]
    for story, expectations in (
        ("Expectations that pass with every mutant, and without an ECU, prove nothing:", matrix.prove_nothing),
        (
            "Expectations that do not pass even with the ECU without a defect can kill no mutant:",
            matrix.not_counted,
        ),
    ):
        items = "".join(f"<li>{text(file)}: {text(name)}</li>" for file, name in expectations)
        parts += [f"<p>{story}</p><ul>{items}</ul>"] if items else []
    return section("Mutants", *parts)


def limits_section(outcomes: Sequence[Outcome]) -> str:
    """Return the HTML section on the pinch force limits that expectations use, and their origin; "": none."""
    users: dict[float, list[str]] = {}
    for outcome in outcomes:
        plan = outcome.case.plan
        for limit in force_limits_of(plan.setup.scenario, plan.setup.vehicle, plan.rig):
            name = limit.expectation if limit.longest_s == 0.0 else f"{limit.expectation} (time over it)"
            users.setdefault(limit.force_n, []).append(f"{outcome.case.file}: {name}")
    rows = []
    for force in sorted(users):
        found = list(dict.fromkeys(users[force]))
        more = f" and {len(found) - _MOST_USERS} more" if len(found) > _MOST_USERS else ""
        rows.append((f"{force:g} N", ORIGINS.get(force, OWN_LIMIT), ", ".join(found[:_MOST_USERS]) + more))
    if not rows:
        return ""
    return section(
        "Force limits",
        f"<p>{text(BORROWED)} An expectation on the force alone checks neither how long it lasts nor the other "
        "limits of that rule.</p>",
        table(("limit", "the same value appears in", "used by"), rows, ("n", "", "name")),
    )
