"""Keys of the state that the server of the operator's page answers: those of STATE, and what is in them."""

from __future__ import annotations

from liftgate_hil.dashboard.source import STATE
from liftgate_hil.described_result import keys_of
from liftgate_hil.loop.histogram import Quantiles
from liftgate_hil.signals import COLUMNS, Bench
from tools.docs.json_keys import EXPECTATION

IN_SHORT = ("name", "verdict", "margin", "margin_unit", "time_s")  # keys of a verdict while the run goes on
_IN_WORDS = {
    "margin_text": "margin as it is printed, with its uncertainty and unit; —: there is none to show",
    "times_text": "when it was decided, and where that is another time, when the margin was reached, as it is "
    "printed; empty: never",
}
_TIMES = {
    "lateness_us": "how late ticks began, over the run",
    "execution_us": "execution time of a tick",
    "command_delay_us": "command delay",
}
_METHOD = "`direct`: from the run as it was; `replay`: the gate was stepped again; empty: undecided"


def _with_unit(meaning: str, unit: str) -> str:
    return f"{meaning} [{unit}]" if unit else meaning


_INSIDE = {
    "end.verdict": "`pass`, `inconclusive`, `fail` or `error`",
    "end.ending": "the verdict, or what stands in its place: `stopped` before the end, with nothing failed; "
    "`given up`: the bench has ended the run early",
    "end.reason": "why, in words; may be empty",
    "end.expectations": "the verdicts on the expectations",
    **{
        f"end.expectations[].{name}": _METHOD if name == "method" else meaning
        for name, meaning in EXPECTATION.keys.items()
    },
    **{f"end.expectations[].{name}": meaning for name, meaning in _IN_WORDS.items()},
    "end.exit_code": "exit code of the run's process; null: unknown",
    "end.pinch_peak_n": "largest pinch force of the run [N]; null: nothing was pinched",
    "end.pinch_peak_s": "its time [s]",
    "truth.COLUMN": "in the unit of the [signal](signals.md)",
    "sensed.COLUMN": "in the unit of the [signal](signals.md)",
    "command.QUANTITY": "a quantity of the [rig file](rig.md)",
    "command.QUANTITY.value": "value in `unit`, or its label in the database",
    "command.QUANTITY.unit": "unit in the database",
    "command.QUANTITY.signal": "message and signal that carry it",
    "loop.clock": "clock of the run",
    "loop.rate_hz": "ticks per second [Hz]",
    "loop.tick": "ticks that were done",
    **{f"loop.{name}": _with_unit(COLUMNS[name].meaning, COLUMNS[name].unit) for name in Bench._fields},
    **{
        path: text
        for name, meaning in _TIMES.items()
        for path, text in {
            f"loop.{name}": f"{meaning}; null: not measured",
            **{f"loop.{name}.{key}": each for key, each in keys_of(Quantiles).items()},
        }.items()
    },
    "bus.channel": "name of the bus",
    "bus.bitrate": "bit rate [bit/s]",
    "bus.load_percent": "bus load over the last second [%]; null: unknown",
    "bus.sent": "frames sent",
    "bus.received": "frames received",
    "bus.unsent": "frames that were not sent",
    "bus.dropped": "frames that were dropped before the gate read them",
    "bus.bus_offs": "times that the controller went bus-off",
    "bus.not_shown": "frames of messages beyond the first 500, which `messages` leaves out",
    "bus.overwritten": "rows and frames that the server was too slow to read, since it attached",
    "bus.command_age_s": "age of the last valid command [s]; null: there is none",
    "bus.accepted": "valid frames of mapped messages; null: unknown",
    "bus.rejected": "rejected frames; null: unknown",
    "bus.foreign": "frames with identifiers that the rig does not receive; null: unknown",
    "in_force.obstacle": "the obstacle, with the keys of the command; null: none",
    "in_force.set": "values that were set, by quantity, in its unit",
    "in_force.faults": "faults: a list, each with the keys of the command",
    "in_force.signals": "signals that were set: `Message.Signal` and its value",
    "in_force.record": "the recording that was begun: `file` and `phase`; null: none",
    "acting.obstacle": "the obstacle in the gate's way; null: none",
    "acting.obstacle.angle_deg": "gate angle at which the gate meets it [deg]",
    "acting.obstacle.distance": "distance from the hinge [m]",
    "acting.obstacle.meets": "`closing` or `opening`: direction of motion in which the gate meets it",
    "acting.spring_health": "share of the springs' force that is left, by drive: 1 without a fault",
    "acting.spring_health.left": "of the left drive",
    "acting.spring_health.right": "of the right drive, where there is one",
    **{f"verdicts[].{name}": EXPECTATION.keys[name] for name in IN_SHORT},
    **{f"verdicts[].{name}": meaning for name, meaning in _IN_WORDS.items()},
    "verdicts[].verdict": "`pending`, `pass`, `inconclusive`, `fail` or `error`",
    "messages[].id": "identifier in hexadecimal digits, followed by x if it has 29 bits",
    "messages[].name": "name in the database; empty: unknown",
    "messages[].direction": "`sent` or `received` by the gate",
    "messages[].count": "frames so far",
    "messages[].cycle_ms": "time between the last two frames [ms]; null: there was one",
    "messages[].time_s": "model time of the last frame [s]",
    "messages[].data": "its payload: bytes in hexadecimal digits",
    "messages[].signals": "its decoded signals; empty: unknown message",
    "messages[].signals.SIGNAL": "value in the database's unit, or its label",
    **{f"histograms.{name}": f"{meaning}: list of [from µs, to µs, count]" for name, meaning in _TIMES.items()},
}
STATE_KEYS = {
    path: meaning
    for name, own in STATE.items()
    for path, meaning in {
        name: own,
        **{each: text for each, text in _INSIDE.items() if each.startswith((f"{name}.", f"{name}["))},
    }.items()
}
