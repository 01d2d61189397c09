"""Commands of an operator while a run goes on, from the page or a script: each is a table of one key.

{"obstacle": {"angle_deg": 35, "stiffness": 10000}}     {"set": {"road_slope_deg": 8}}
{"fault": {"kind": "hall_a_stuck", "where": "left", "value": 0}}
{"signal": {"Body.VehicleSpeed": 3.5}}     {"request": "open"}
{"clear": "obstacle" | "set" | "faults" | "signals" | "all"}
{"clear": {"set": "road_slope_deg"}}     {"clear": {"signal": "Body.VehicleSpeed"}}
{"clear": {"fault": {"kind": "hall_a_stuck", "where": "left"}}}
{"record": {"file": "run.mf4"}}     {"record": null}     {"mark": "text"}

A command overrides the scenario and a test bench's messages, until it is cleared; `record` and `mark` do not act
on the gate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from liftgate_hil.config.bus_fault import located
from liftgate_hil.config.restbus import value_in
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault, fault_of
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigError, ConfigIssues, printable
from liftgate_hil.formats.recording import COMMAND
from liftgate_hil.operate.buttons import ButtonPresser
from liftgate_hil.operate.by_hand import held_obstacle, obstacle_in, surroundings_in
from liftgate_hil.operate.further_recording import FurtherRecording
from liftgate_hil.operate.loop_target import Target
from liftgate_hil.signals import OBSTACLE
from liftgate_hil.stimuli.command_queue import LENGTH, SLOTS
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import REQUESTS

COMMANDS = ("obstacle", "set", "fault", "signal", "request", "clear", "record", "mark")
_SERIES_S = 1.0  # s between two settings of a series, at most
_BESIDE = ("record", "mark")  # commands that do not act on the gate
# Signals that may be set: all of them and all faults are cleared at once.
MOST_SIGNALS = LENGTH - 2 * SLOTS
_MOST_LISTED = 1000  # commands of a run that are kept in `done`
_CLEARED = ("obstacle", "set", "faults", "signals", "all")

Which = tuple[Any, ...]  # see Fault.identity


class CommandedFault(NamedTuple):
    """Fault that an operator has injected, with the content of its command."""

    fault: Fault
    content: Mapping[str, object]


class Operator:
    """Executes an operator's commands on a running gate.

    `edge` is the distance of the gate's edge from its hinge [m]; `ask` makes a request to an ECU in this process
    (False: it cannot), other ECUs are asked by the rig's buttons.
    """

    def __init__(
        self, rig: Rig, target: Target, edge: float, ask: Callable[[str], bool] = lambda action: False
    ) -> None:
        self._rig, self._target, self._edge = rig, target, edge
        self._ask = ask
        self._buttons = ButtonPresser(rig, target)
        self._obstacle: Mapping[str, object] = {}
        self._set: dict[str, float] = {}
        self._faults: dict[Which, CommandedFault] = {}
        self._signals: dict[str, object] = {}
        self.recording: FurtherRecording | None = None  # set once the run has a memory
        self.report: Callable[[float, str], None] = lambda now, done: None  # told what was done, and when
        self.kinds: set[str] = set()  # of faults that were injected
        # Settings of one quantity, as a slider makes them: the first and the last one are reported.
        self._series, self._series_at = "", -math.inf
        self._last_of_series: tuple[float, str] | None = None  # when, and what was done
        self._is_listed = False  # the last command is the last one of `done`
        self.count = 0  # commands executed that act on the gate
        self.done: list[str] = []  # the first of these in words, with their times; of a series the last one

    def in_force(self) -> Mapping[str, object]:
        """Return the commands in force, executed and not cleared, in the form of commands."""
        return {
            "obstacle": dict(self._obstacle) or None,
            "set": dict(self._set),
            "faults": [dict(each.content) for each in self._faults.values()],
            "signals": dict(self._signals),
            "record": None if self.recording is None else self.recording.in_force(),
        }

    def look(self, now: float) -> None:
        """Release buttons whose hold time is over at a scenario time [s]; end a series of settings after 1 s."""
        self._buttons.release(now)
        if now - self._series_at > _SERIES_S:
            self.end_series()

    def obey(self, command: object, now: float) -> str:
        """Execute a command at a time [s] of the scenario, and return a text on what was done.

        It takes effect with the next tick. Raises ConfigError for one that is invalid, or for which there is no
        room yet.
        """
        series = _series_of(command)
        continues = bool(series) and series == self._series and now - self._series_at <= _SERIES_S
        if not continues:
            self.end_series()
        done = printable(self._obey(command, now))
        self._series, self._series_at = series, now
        if set(_BESIDE) & set(command):  # type: ignore[call-overload]  # it was obeyed, so it is a table
            self.report(now, done)
            return done
        self.count += 1
        if continues and self._is_listed:
            self.done.pop()
        self._is_listed = len(self.done) < _MOST_LISTED
        if self._is_listed:
            self.done.append(f"{now:.3f} s: {done}")
        if continues:
            self._last_of_series = now, done
        else:
            self._tell(now, done)
        return done

    def end_series(self) -> None:
        """Report the last value of a series of settings, the first of which was reported at once."""
        self._series = ""
        if self._last_of_series is not None:
            self._tell(*self._last_of_series)
            self._last_of_series = None

    def _tell(self, now: float, done: str) -> None:
        """Report an executed command, and write it as a mark to the recordings."""
        self.report(now, done)
        if self.recording is not None:
            self.recording.note(now, f"{COMMAND}{done}")

    def _obey(self, command: object, now: float) -> str:
        """Execute a command and return what was done as text, neither counted nor reported. Raises ConfigError."""
        allowed = "; allowed: one of " + ", ".join(COMMANDS)
        if not isinstance(command, dict) or len(command) != 1:
            raise ConfigError(f"{show(command)[:200]}: not a table of one key{allowed}")
        (name, content), *_ = command.items()
        if name not in COMMANDS:
            raise ConfigError(f"{show(name)[:80]}: no such command{allowed}")
        if name == "request":
            if content not in REQUESTS:
                raise ConfigError(f"request {show(content)}; allowed: one of {', '.join(REQUESTS)}")
            if self._ask(content):
                return f"request {content}"
            self._buttons.request(content, now)
            self._signals = {name: value for name, value in self._signals.items() if not self._buttons.has(name)}
            return f"request {content}"
        if name == "clear":
            return self._clear(content)
        if name in _BESIDE:
            return self._beside(name, content, now)
        if not isinstance(content, dict) or not content:
            raise ConfigError(f"{name} {show(content)[:200]}; allowed: a table with its keys")
        do: dict[str, Callable[[Mapping[str, object], float], str]] = {
            "obstacle": self._put_obstacle, "set": self._surround, "fault": self._add_fault, "signal": self._send,
        }  # fmt: skip
        return do[name](content, now)

    def _beside(self, name: str, content: object, now: float) -> str:
        """Execute `record` or `mark`, which do not act on the gate; return what was done. Raises ConfigError."""
        if self.recording is None:
            raise ConfigError(f"{name}: this run cannot be recorded now; allowed: once it is ready")
        if name == "mark":
            self.recording.mark(now, content)
            return f"mark {content}"
        if content is None:
            return f"recording stopped: {self.recording.stop()}"
        if not isinstance(content, dict) or set(content) != {"file"}:
            raise ConfigError(f'record {show(content)[:80]}; allowed: {{"file": NAME}}, or null to stop')
        self.recording.start(content["file"])
        return f"recording to {content['file']}"

    def _put_obstacle(self, content: Mapping[str, object], now: float) -> str:
        self._target.hold(held_obstacle(obstacle_in(content, self._edge)))
        self._obstacle = dict(content)
        units = {name: signal.unit for name, signal in OBSTACLE.items() if name != "angle_deg"}
        return "obstacle " + _words(content, units)

    def _surround(self, content: Mapping[str, object], now: float) -> str:
        """Set surroundings, and return a text on what was done; None clears one. Raises ConfigError."""
        held = surroundings_in(content)
        self._target.hold(held)
        both = {**self._set, **held}
        self._set = {name: value for name, value in both.items() if not math.isnan(value)}
        return "set " + _words(content)

    def _send(self, content: Mapping[str, object], now: float) -> str:
        issues, numbers = ConfigIssues("signal"), {}
        for name, value in content.items():
            if value is None and name in self._signals:
                numbers[name] = math.nan
                continue
            issues.originate(f"{name}.signal", "signal")  # whose issues state the name
            issues.originate(f"{name}.value", f"signal {name}")
            number = value_in(f"{name}.", name, value, self._rig.tables, self._rig.mapped, issues)
            numbers[name] = math.nan if number is None else number
        both = {**self._signals, **content}
        if len(both) > MOST_SIGNALS:
            issues.take([f"signal: {len(both)} signals; allowed: up to {MOST_SIGNALS} at a time"])
        issues.raise_if_any()
        self._target.set_signals(numbers)
        for name in numbers:
            self._buttons.forget(name)
        self._signals = {name: value for name, value in both.items() if value is not None}
        return "signal " + _words(content)

    def _add_fault(self, content: Mapping[str, Any], now: float) -> str:
        values = {str(name): value for name, value in content.items()}
        kind, where = str(values.pop("kind", "")), values.pop("where", None)
        fault = located(replace(fault_of(kind, where, values), start=Instant(now)), self._rig)
        which = fault.identity
        others = {key: each for key, each in self._faults.items() if key != which}
        self._inject({**others, which: CommandedFault(fault, dict(content))})
        self.kinds.add(fault.kind)
        return "fault " + _words(content)

    def _clear(self, content: object) -> str:
        if isinstance(content, dict) and len(content) == 1:
            (name, one), *_ = content.items()
            if name == "set":
                self._surround({str(one): None}, 0.0)
                return f"clear set {one}"
            if name == "signal" and isinstance(one, str) and one in self._signals:
                self._send({one: None}, 0.0)
                return f"clear signal {one}"
            if name == "fault" and isinstance(one, dict) and "kind" in one:
                return self._clear_fault(one)
        if not isinstance(content, str) or content not in _CLEARED:
            one = '{"set": NAME}, {"signal": NAME of one that was set}, {"fault": {"kind": …, "where": …}}'
            raise ConfigError(f"clear {show(content)[:200]}; allowed: one of {', '.join(_CLEARED)}, {one}")
        if content in ("obstacle", "all"):
            self._target.hold(held_obstacle(None))
            self._obstacle = {}
        if content in ("set", "all") and self._set:
            self._surround(dict.fromkeys(self._set), 0.0)
        if content in ("faults", "all"):
            self._inject({})
        if content in ("signals", "all") and self._signals:
            self._send(dict.fromkeys(self._signals), 0.0)
        return f"clear {content}"

    def _clear_fault(self, one: Mapping[str, object]) -> str:
        found = [
            which
            for which, (_, content) in self._faults.items()
            if all(content.get(name) == value for name, value in one.items())
        ]
        if not found:
            known = "; ".join(_words(each.content) for each in self._faults.values()) or "none"
            text = f"clear: fault {_words(one)}: not set by a command"
            raise ConfigError(f"{text} (those of the scenario stay); allowed: {known}")
        self._inject({key: each for key, each in self._faults.items() if key not in found})
        return f"clear fault {_words(one)}"

    def _inject(self, faults: dict[Which, CommandedFault]) -> None:
        """Put these faults in force in place of all before. Raises ConfigError, and changes nothing then."""
        self._target.inject([each.fault for each in faults.values()])
        self._faults = faults


def _series_of(command: object) -> str:
    """Return the one quantity that a command sets; "": the command cannot belong to a series of settings."""
    content = command.get("set") if isinstance(command, dict) else None
    return str(next(iter(content))) if isinstance(content, dict) and len(content) == 1 else ""


def _words(content: Mapping[str, object], units: Mapping[str, str] | None = None) -> str:
    """Return the values of a command as text; `units` are those that the names do not state."""
    parts = []
    for name, value in content.items():
        shown = f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value)
        if name == "id" and isinstance(value, int):  # a CAN identifier
            shown = f"{value:#x}"
        parts.append(f"{name} {shown} {(units or {}).get(name, '')}".rstrip())
    return ", ".join(parts)
