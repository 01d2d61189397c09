"""Page docs/scenario.md: all keys of a scenario file, from the schema by which such files are read."""

from __future__ import annotations

from liftgate_hil.config import scenario_schema as keys
from liftgate_hil.config.described import Field
from liftgate_hil.config.fault_kinds import FAULT_KINDS, FaultKind
from liftgate_hil.signals import PROFILES
from tools.docs.markdown import code, number, page, table
from tools.docs.schema import a_range, key_table

_INTRO = """\
A scenario file is written in TOML. It describes what happens around the gate over time, what the driver requests
from the ECU, which faults are injected, and what is expected. It is used by `--scenario` and `liftgate_hil.run`.
[`demo.toml`](../configs/scenarios/demo.toml) is the scenario of the demo; `liftgate-hil init` copies it.

Times are in seconds of model time since the start of the scenario. `"$name"` may replace any number; it is the
value of the parameter `name`. A time may also be given as a condition, a text as described under "Conditions".
It then is the first time that the condition is true, and what begins or ends with it takes effect from the next
tick on."""

_CONDITIONS = (
    ("`gate_angle_deg`", "a column of recordings by its name: the true value"),
    ("`sensed.gate_angle_deg`", "the same quantity as the ECU's sensor reports it"),
    ("`Gate.LatchState`", "`Message.Signal` of the rig's database: its value in the last frame of the message"),
    ("`20`, `1e-3`, `$name`", "numbers and parameters"),
    ("`+ - * /`, `abs()`", "arithmetic with numbers"),
    ("`< <= > >= == !=`", "one comparison of two numbers with the same unit; plain numbers fit every unit"),
    ("`and`, `or`, `not`", "operators on comparisons"),
    ("`( )`", "parentheses around numbers or comparisons"),
)  # fmt: skip

_FAULTS = """\
Several faults may be active at the same time. They change a parameter, a reading or a frame one after the other,
in the order of the file: an offset that precedes a gain is amplified by it. Within a sensor the order is that of
the real signal chain:

- Hall sensors: shaft, stuck levels, swapped sensors, missing and additional edges.
- Current: offsets and gains, converter, frozen reading.

Faults on the bus first change the frames; then frames are lost, repeated or delayed. In their key `direction`,
`sent` means frames that the gate or the restbus sends, `received` frames that the gate receives.

A note is reported for a fault that was active for less than a time-out: that of the message on which the fault
acts, for all other faults that of the drive command. Receivers keep the last values for such a short time."""

_WINDOWS = """\
An expectation is evaluated in the ticks of its window `[t0, t0 + within_s]`, both ends included. `t0` is the
time `after`, or the first tick in which that condition is true. Without `within_s` the window lasts until the
end of the run. A tick does not count if a column or a signal of the condition has no value in it, or no finite
one; with `for_s` such a tick is an interruption. The initial state at time 0 has no row: a window that starts at
0 begins with the tick that ends one step later. A stretch from 0 on is complete without such a row, so that
`for_s` may be as long as `within_s`.

The reason of a failure states what was measured, what was allowed, and when: `pinch_force_n: 171.3 N, allowed
below 150 N, at 18.45 s`. If a condition became true only after its window, the reason states that, too: `true at
4.31 s, allowed until 4.105 s`."""

_VERDICTS = (
    ("`pass`", "The expectation was met."),
    ("`inconclusive`", "No statement is possible. The window: `after` never became true, the end of the run cut"
     " the window off before it was decided, or none of its ticks counted. The stimuli: the condition of a "
     "stimulus never became true (an expectation that failed stays a `fail`), what precedes time 0 did not "
     "succeed or did not come to rest, a fault is not possible on this bus, or a reset of the ECU failed or had "
     "not ended. Real time: frames were dropped, or the bench itself was late by more than `timing_tolerance_s` "
     "in the window and"
     " stepping the gate again does not confirm the verdict ([verdicts](verdicts.md))."),
    ("`fail`", "The expectation was not met."),
    ("`error`", "The run did not reach its end."),
)  # fmt: skip

_MARGINS = """\
The table is ordered from the best verdict to the worst; of several verdicts the worst counts.

Every verdict except that on a trouble code has a margin, in the unit of the deciding comparison. The margin is
the distance to the point at which the result would have changed; it is negative, or 0, if the expectation
failed. The margin of a condition in one tick is:

- `b − a` for `a < b` and `a <= b`, `a − b` for `a > b` and `a >= b`,
- `−|a − b|` for `a == b`, `|a − b|` for `a != b`,
- the smaller margin of the two for `and`, the larger one for `or`, the negated margin for `not`.

The margin of a window is the smallest of all ticks for `always` and for `never` (of the negated condition), and
the largest for `eventually`. With `for_s` each stretch of that length has its smallest margin; the largest of
these counts."""

_CODES = """\
`dtc` names a trouble code in the notation of SAE J2012: five characters, which match every failure type, or five
characters with a failure type (`B1A01-62`). The bench reads the ECU's codes cyclically over its diagnostics, as
the rig's table [`[diagnostics]`](rig.md) defines, after it has cleared all of them at time 0 (unless the rig
says `clear = false`). `present` means that a response in the window reports the code, `absent` that none does.

A code is reported if its status has a bit of the rig's `status_mask`. By default these are testFailed (the test
fails now) and confirmedDTC (it failed, and the code is stored). A fault that has disappeared again is therefore
reported, too; a code that is only pending is not.

Without a response in the window the verdict is inconclusive. So is that on an absent code if the ECU stopped
responding before the end of the window. There is no margin and no `for_s`. `judge` reads the codes from a
recording that contains the frames. All this needs the package's extra `uds`."""


def scenario_page() -> str:
    """Return the text of the page."""
    quantities = (
        (code(name), each.unit, f"{number(each.low)} to {number(each.high)}", each.meaning)
        for name, each in PROFILES.items()
    )
    return page(
        "Scenario files",
        _INTRO,
        "## The file",
        "`vehicle`, `rig`, `seed`, `initial` and `set` are defaults: flags and arguments override them.",
        key_table(keys.ScenarioTable),
        "## `[[profile]]`",
        "A quantity over time. Exactly one of `points` and `csv` is required.",
        key_table(keys.ProfileTable),
        "The quantities are also those of `Gate.set`, of input columns, and of a test bench's panel (there "
        "without the unit in the name):",
        table(("quantity", "unit", "range", "meaning"), quantities),
        "## `[[obstacle]]`",
        "An elastic body in the gate's way, such as a test rod of 10, 20 or 65 N/mm. If several obstacles are "
        "present at the same time, only the first one in the file acts. An obstacle from a test bench's panel "
        "takes precedence over all of them.",
        key_table(keys.ObstacleTable),
        "## `[[request]]`",
        "A request of the driver to the ECU, or a reset of the ECU. An ECU in this process gets it directly: the "
        "reference ECU, a C library, a Python object with `request`. An ECU on a bus gets it through the signals "
        "that the rig's `[requests]` and `[reset]` name. If `[reset]` has no signal, a `reset` is made by its "
        "ECUReset (`[reset] uds`), or else by its program. A reset that is refused or fails makes the scenario "
        "inconclusive.",
        key_table(keys.RequestTable),
        "## `[[signal]]`",
        "Restbus simulation: signals that other control units send. The bench sends each signal's message in its "
        "cycle, with counter, checksum or E2E protection as given in the rig's `[messages]`. It sends the message "
        "from the start; all other signals of the message have the database's start values. If a signal has "
        "several tables, each one is valid from its time on.",
        key_table(keys.SignalTable),
        "## `[[fault]]`",
        _FAULTS,
        key_table(keys.FaultTable, {"kind": "a kind"}),
        "The kinds, each with its further keys:",
        table(("kind", "keys", "fault", "meaning"), map(_kind, FAULT_KINDS.values())),
        "## `[[expect]]`",
        "What is expected of the run. Exactly one of `always`, `eventually`, `never` and `dtc` is required.",
        key_table(keys.ExpectTable),
        "### Conditions",
        table(("notation", "meaning"), _CONDITIONS),
        "### Trouble codes",
        _CODES,
        "### Windows and verdicts",
        _WINDOWS,
        table(("verdict", "when"), _VERDICTS),
        _MARGINS,
    )


def _kind(kind: FaultKind) -> tuple[str, ...]:
    """Return the table row of a kind of fault."""
    return code(kind.name), "; ".join(map(_own, kind.keys)), f"of {kind.of}", kind.meaning


def _own(key: Field) -> str:
    """Return the text in a cell for a further key of a kind of fault."""
    default = "" if key.default_text == "required" else f", default {key.default_text}"
    return f"{code(key.name)}: {a_range(key.kind.allowed)}{default} – {key.meaning}"
