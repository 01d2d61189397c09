"""docs/scenario.md: every key of a scenario file, from the schema that its reader goes by."""

from __future__ import annotations

from liftgate_hil.config import scenario_keys as keys
from liftgate_hil.config.fault_kinds import FAULT_KINDS, FaultKind
from liftgate_hil.config.schema import Key
from liftgate_hil.signals import PROFILES
from tools.docs.checker import a_range
from tools.docs.markdown import code, number, page, table
from tools.docs.schema import default_of, key_table

_INTRO = """\
A scenario file is TOML: what happens over time around the gate, what the driver asks of the ECU, what breaks, and
what is expected, for `--scenario` and `liftgate_hil.run`. [`demo.toml`](../configs/scenarios/demo.toml) is the
demo's; `liftgate-hil init` copies it. Times are seconds of model time since the start. `"$name"` stands wherever a
number may, and is the parameter of that name. A condition in place of a time is a text, see "Conditions": the
first time that it is true. What it begins or ends acts from the next tick on."""

_CONDITIONS = (
    ("`gate_angle_deg`", "a column of recordings by its name: what is so"),
    ("`sensed.gate_angle_deg`", "what the ECU's sensors make of it"),
    ("`Gate.LatchState`", "`Message.Signal` of the rig's database: what the message's last frame on the bus said"),
    ("`20`, `1e-3`, `$name`", "numbers, and parameters"),
    ("`+ - * /`, `abs()`", "of numbers"),
    ("`< <= > >= == !=`", "one comparison of two numbers, both with the same unit; plain numbers fit any"),
    ("`and`, `or`, `not`", "of comparisons"),
    ("`( )`", "around either"),
)  # fmt: skip

_FAULTS = """\
Several may be there at a time: they change a number, a reading or a frame one after the other, in the order of
the file, so that an offset before a gain is amplified. Along a sensor's wire the order is that of the real one:
the shaft, what is stuck, what is swapped, what is missing or too much; the current, its offsets and gains, the
converter, what is frozen. Frames are changed first, then lost, repeated or delayed.

A fault that was in force for less than the time-out of the message that it acts on, else of the drive command,
is told in a note: what was said last bridges that."""

_WINDOWS = """\
An expectation looks at the ticks of its window `[t0, t0 + within_s]`, both ends in: `t0` is the time `after`, or
the first tick in which that condition is true. Without `within_s` the window lasts to the end of the run. A tick
in which a column or a signal of the condition has no value, or none that is finite, does not count; where
`for_s` is given it is an interruption. The state at time 0 has no row: a window from 0 on begins with the tick
that ends one step later, and a stretch from 0 on is whole with the rows that there are, so that `for_s` may be
all of `within_s`.

A failure says what was measured, what was allowed and when: `pinch_force_n: 171.3 N, allowed below 150 N, at
18.45 s`. Where what was to come true in a window came true behind it, it says so: `true at 4.31 s, allowed until
4.105 s`."""

_VERDICTS = (
    ("`pass`", "it held"),
    ("`inconclusive`", "nothing can be said: `after` or the condition of a stimulus never came true, the end of"
     " the run cut the window off before it was decided, or no tick of it counted; what goes before time 0 did not"
     " come to rest; a fault cannot be made on this bus, or the program that restarts the ECU failed or was not at"
     " its end; in real time the bench itself was late by more than `timing_tolerance_s` in the window, and the"
     " gate stepped again does not confirm the verdict ([tests](tests.md)), or frames were dropped"),
    ("`fail`", "it did not hold"),
    ("`error`", "the run did not come to its end"),
)  # fmt: skip

_MARGINS = """\
Of several verdicts the worst counts, in this order. Each but that of a trouble code has a margin, in the unit of
the comparison that decides it: how much was left before the truth would have changed, negative where it failed. It
is `b − a` for `a < b` and `a <= b`, `a − b` for `a > b` and `a >= b`, `−|a − b|` for `a == b`, `|a − b|` for
`a != b`; `and` has the smaller one of its two, `or` the larger one, `not` the negated one. Of a window it is
the smallest of all ticks (`always`, `never`) or the largest (`eventually`); with `for_s` the largest of the
smallest in any stretch of that length."""

_CODES = """\
`dtc` names a trouble code as SAE J2012 writes it: five characters, which any failure type fits, or with one
(`B1A01-62`). The bench reads the ECU's codes over its diagnostics, as the rig's [`[diagnostics]`](rig.md) says,
again and again, after it has cleared all of them at time 0. `present`: an answer that came in the window reports
the code; `absent`: none does. A code is reported whose status has a bit of the rig's `status_mask`: by default
testFailed (it fails now) or confirmedDTC (it did, and is stored), so that a fault that has gone again is reported,
too, and one that is only pending is not. Without an answer in the window nothing can be said, nor of an absent
code where the ECU has fallen silent before the window's end. There is no margin, and no `for_s`. `judge` reads the
same from a recording with the frames. It needs the extra `uds`."""


def scenario_page() -> str:
    """The page."""
    quantities = (
        (code(name), each.unit, f"{number(each.low)} to {number(each.high)}", each.meaning)
        for name, each in PROFILES.items()
    )
    return page(
        "Scenario files",
        _INTRO,
        "## The file",
        "`vehicle`, `rig`, `seed`, `initial` and `set` are defaults: flags and arguments win.",
        key_table(keys.TOP),
        "## `[[profile]]`",
        "Either `points` or `csv`.",
        key_table(keys.PROFILE),
        "Quantities, also of `Gate.set`, of input columns, and of a test bench's panel (there without the unit):",
        table(("quantity", "unit", "range", "meaning"), quantities),
        "## `[[obstacle]]`",
        "A body that gives way as a spring, such as a test rod of 10, 20 or 65 N/mm. Of several at a time the "
        "first in the file counts; a panel's goes before all of them.",
        key_table(keys.OBSTACLE),
        "## `[[request]]`",
        "For an ECU that has a button: the reference ECU, a C library, a Python object with `request`; for one on "
        "a bus by the signals that the rig's `[requests]` and `[reset]` name; for `reset`, where the rig has no "
        "signal, by its ECUReset (`[reset] uds`), or else by its program. A reset that is refused or fails makes "
        "the scenario inconclusive.",
        key_table(keys.REQUEST),
        "## `[[signal]]`",
        "The restbus: what other control units send, in the cycle of each signal's message, with its counter, "
        "checksum or E2E protection, as the rig's `[messages]` have them. A message is sent from the beginning "
        "on, its other signals with the database's start values. Of several tables for a signal each counts from "
        "its time on.",
        key_table(keys.SIGNAL),
        "## `[[fault]]`",
        _FAULTS,
        key_table(keys.FAULT, {"kind": "a kind"}),
        "The kinds, with the keys that each has beside these:",
        table(("kind", "keys", "is", "meaning"), map(_kind, FAULT_KINDS.values())),
        "## `[[expect]]`",
        "Exactly one of `always`, `eventually`, `never` and `dtc`.",
        key_table(keys.EXPECT),
        "### Conditions",
        table(("written", "is"), _CONDITIONS),
        "### Trouble codes",
        _CODES,
        "### Windows and verdicts",
        _WINDOWS,
        table(("verdict", "when"), _VERDICTS),
        _MARGINS,
    )


def _kind(kind: FaultKind) -> tuple[str, ...]:
    """A kind of fault as a row."""
    return code(kind.name), "; ".join(map(_own, kind.keys)), f"of {kind.of}", kind.meaning


def _own(key: Key) -> str:
    """A key of a kind's own, in a cell."""
    default = "" if default_of(key) == "required" else f", default {default_of(key)}"
    return f"{code(key.name)}: {a_range(key.kind.allowed)}{default}, {key.meaning}"
