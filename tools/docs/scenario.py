"""docs/scenario.md: every key of a scenario file. Keys and ranges are the checker's answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.signals import PROFILES
from tools.docs.checker import UNKNOWN, WRONG, a_range, allowed, keys_of
from tools.docs.markdown import code, number, page, table

_INTRO = """\
A scenario file is TOML: what happens over time around the gate, and what the driver asks of the ECU, for
`--scenario` and `liftgate_hil.run`. [`demo.toml`](../configs/scenarios/demo.toml) is the demo's;
`liftgate-hil init` copies it. Times are seconds of model time since the start. `"$name"` stands wherever a
number may, and is the parameter of that name."""

TOP = {
    "description": ("", "any text", "for people"),
    "requirement": ("", "any", "the identifiers of what it tests; for people"),
    "duration": ("until stopped", "", "the end of the run"),
    "vehicle": ("suv", "a shipped name or a file", "looked for beside the scenario first"),
    "rig": ("liftgate", "a shipped name or a file", "looked for beside the scenario first"),
    "seed": ("0", "", "of noise and of what differs from run to run"),
    "initial": ("closed", "", "where the gate starts, at rest; closed it is latched"),
    "parameters": ("", "a table of numbers", "names and values, which `parameters` of `lh.run` replaces"),
    "set": ("", "a table", "keys of the vehicle file and their values: `\"environment.road_slope_deg\" = 5`"),
    "profile": ("", "[[profile]] tables", "a quantity over time, below"),
    "obstacle": ("", "[[obstacle]] tables", "something in the gate's way, below"),
    "request": ("", "[[request]] tables", "what the driver asks of the ECU, below"),
}  # fmt: skip
PROFILE = {
    "quantity": ("required", "", "one of those below; each once"),
    "points": ("required", "[[time, value], …]", "the value at each time; before the first the vehicle's"),
    "interpolation": ("linear", "", "straight lines, or each held until the next, as switches are"),
}  # fmt: skip
OBSTACLE = {
    "start": ("0", "", "when it is put there; it counts only once the gate has been clear of it"),
    "end": ("never", "", "when it is taken away"),
    "angle_deg": ("required", "", ""),
    "distance": ("1", "", ""),
    "stiffness": ("10000", "", ""),
    "damping": ("0", "", ""),
    "gap": ("0", "", ""),
    "lateral": ("0", "", ""),
    "meets": ("closing", "", "the way in which the gate meets it"),
}  # fmt: skip
REQUEST = {
    "time": ("required", "", "when the button is pressed"),
    "action": ("required", "", "which"),
}


def scenario_page() -> str:
    """The page."""
    from liftgate_hil.signals import OBSTACLE as SIGNALS

    answers = _answers()
    meanings = {
        key: (default, what, meaning or SIGNALS[key].meaning)
        for key, (default, what, meaning) in OBSTACLE.items()
    }
    quantities = (
        (code(name), each.unit, f"{number(each.low)} to {number(each.high)}", each.meaning)
        for name, each in PROFILES.items()
    )
    return page(
        "Scenario files",
        _INTRO,
        "## The file",
        "`vehicle`, `rig`, `seed`, `initial` and `set` are defaults: flags and arguments win.",
        _table(answers, "", TOP),
        "## `[[profile]]`",
        _table(answers, "profile[0]", PROFILE),
        "Quantities, also of `Gate.set`, of input columns, and of a test bench's panel (there without the unit):",
        table(("quantity", "unit", "range", "meaning"), quantities),
        "## `[[obstacle]]`",
        "A body that gives way as a spring, such as a test rod of 10, 20 or 65 N/mm. Of several at a time the "
        "first in the file counts; a panel's goes before all of them.",
        _table(answers, "obstacle[0]", meanings),
        "## `[[request]]`",
        "For an ECU that has a button: the reference ECU, a C library, a Python object with `request`.",
        _table(answers, "request[0]", REQUEST),
    )


def _answers() -> dict[str, str]:
    """What the checker says to a scenario in which all is wrong."""
    top: dict[str, Any] = dict.fromkeys(("duration", "seed", "initial"), -1)
    return allowed(
        load_scenario,
        {
            **top,
            UNKNOWN: 1,
            "profile": [dict.fromkeys(PROFILE, WRONG) | {UNKNOWN: 1}],
            "obstacle": [dict.fromkeys(OBSTACLE, WRONG) | {UNKNOWN: 1}],
            "request": [dict.fromkeys(REQUEST, WRONG) | {UNKNOWN: 1}],
        },
    )


def _table(
    answers: Mapping[str, str], prefix: str, told: Mapping[str, tuple[str, str, str]]
) -> str:
    """The keys of a table, as the checker lists them."""
    return table(("key", "allowed", "default", "meaning"), _rows(answers, prefix, told))


def _rows(
    answers: Mapping[str, str], prefix: str, told: Mapping[str, tuple[str, str, str]]
) -> Iterator[tuple[str, ...]]:
    for key in keys_of(answers, prefix):
        default, what, meaning = told[key]
        answer = answers.get(f"{prefix}.{key}" if prefix else key, "")
        yield code(key), what or a_range(answer), default, meaning
