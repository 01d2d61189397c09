"""A gate to step by hand: in this process, without a bus, at no pace but the caller's.

with Gate(vehicle="suv", rig="liftgate", initial="closed", seed=1) as gate:
gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
frames = gate.step(0.010)              # list[can.Message] that the gate sent meanwhile
gate.truth["gate_angle_deg"], gate.sensed["left_current_a"]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil import session
from liftgate_hil.codec.frames import FD, Frames
from liftgate_hil.commanding import CyclicCommand
from liftgate_hil.config.arguments import number_of, seed_of
from liftgate_hil.config.restbus import value_in
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Fault, fault_of
from liftgate_hil.config.toml import show
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.single_request import Bench, clear_codes, read_codes
from liftgate_hil.diagnostics.tester import Diagnostics, Tester, is_asking_once
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import ConfigError, PlantDivergedError
from liftgate_hil.injection.by_hand import STIFFNESS, held_obstacle, obstacle_in, surroundings_in
from liftgate_hil.injection.orders import Orders
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.loop.edges import DRIVES, Edge, edges_since
from liftgate_hil.loop.episode import DIVERGED, Script, Stretch, run_stretch
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.loop.tick import constants_in, initial_loop
from liftgate_hil.signals import COLUMN_PLACE, SENSED_PREFIX, columns_of
from liftgate_hil.staging import injections_of
from liftgate_hil.stimuli import restbus
from liftgate_hil.stimuli.bus_faults import going_on
from liftgate_hil.stimuli.faults import Injection
from liftgate_hil.stimuli.mailbox import hold
from liftgate_hil.stimuli.moments import START, Instant
from liftgate_hil.stimuli.restbus import SignalChange
from liftgate_hil.stimuli.scene import scene_of
from liftgate_hil.stimuli.slots import CLOSED
from liftgate_plant.compiler import compiled
from liftgate_plant.hall import RING_SIZE
from liftgate_plant.initial import closed_state, initial_state
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    import can

_ROWS, _FRAMES = 1024, 8192  # the latter with room for twice what a tick may bring


class Gate:
    """The gate behind its rig: frames and commands in, frames out, and all that is so in between.

    `vehicle` and `rig` are shipped names, files or objects; `settings` (KEY=VALUE) replace the vehicle's keys;
    `draw` and `ideal` say which car of the file, see `load_vehicle`;
    `initial` is "closed" (latched), "open" or an angle in degrees; `rate` [Hz] is of the ticks. Not for several
    threads at once. Raises ConfigError.
    """

    def __init__(
        self,
        vehicle: str | Path | Vehicle = "suv",
        rig: str | Path | Rig = "liftgate",
        initial: str | float = "closed",
        seed: int = 0,
        rate: float = 1000.0,
        settings: Sequence[str] = (),
        draw: int | None = None,
        ideal: bool = False,
    ) -> None:
        vehicle = session.vehicle_of(vehicle, settings, session.variant_of(draw, ideal))
        self.rig = rig = session.rig_of(rig)
        rate = number_of("rate", rate, *session.RATES, "Hz")
        self._drives = vehicle.drives
        self._vehicle = vehicle
        self._faults: list[InjectedFault] = []
        self._ordered: tuple[Fault, ...] = ()  # by frames of a test bench
        self._orders = Orders(rig, _GateTarget(self))
        self._opening = CLOSED._replace(messages=rig.ordering, may_change=True)
        self._signals: dict[str, float] = {}  # of the restbus
        self._config = session.loop_config_of(vehicle, rig, rate, seed_of(seed))
        angle = session.angle_from(initial, vehicle.gate.open_angle)
        state = initial_state(self._config.plant, angle)
        if initial == "closed":
            state = closed_state(self._config.plant, self._config.load)
        self._memory = Memory(_ROWS, _FRAMES)
        self._is_closed = False
        self._bus = Adapter(rig, vehicle.drives)
        self._command = CyclicCommand(rig, self._config, self._bus.node.reference)
        self._script = Script(
            scene=scene_of(constants_in(self._config), tables=rig.tables, opening=self._opening),
            ticks=0,
            is_last=0,
            is_recorded=1,
            edges=RING_SIZE // 2,
        )
        self._now = Stretch(initial_loop(self._config, state, RING_SIZE), self._bus.state, 1, 0, 0)
        self._run = compiled(run_stretch)
        self._row = np.full(len(COLUMN_PLACE), np.nan)
        self._distance = vehicle.gate.length
        self._waiting: list[tuple[int, int, bytes]] = []
        self._edges: list[Edge] = []

    def __enter__(self) -> Gate:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give back what it holds; once is enough. What it has seen can still be read; it does nothing more."""
        if not self._is_closed:
            self._is_closed = True
            self._memory.close()

    def _check_open(self) -> None:
        if self._is_closed:
            raise ConfigError("this gate is closed; allowed: another Gate")

    @property
    def time(self) -> float:
        """Model time [s]."""
        return self._now.loop.tick * self._config.step

    @property
    def truth(self) -> dict[str, float]:
        """What is so, by the names of recording columns; empty before the first step."""
        return self._columns("")

    @property
    def sensed(self) -> dict[str, float]:
        """What the sensors make of it, by the same names."""
        return self._columns(SENSED_PREFIX)

    def _columns(self, prefix: str) -> dict[str, float]:
        if self._now.loop.tick == 0:
            return {}
        names = [
            name
            for name in columns_of(self._drives)
            if name.startswith(SENSED_PREFIX) == bool(prefix)
        ]
        return {name.removeprefix(prefix): float(self._row[COLUMN_PLACE[name]]) for name in names}

    @property
    def summary(self) -> Summary:
        """What became of all frames so far."""
        loop = self._now.loop
        return Summary(
            clock="lockstep",
            ticks=loop.tick,
            model_time_s=self.time,
            frames_sent=int(self._memory.shared.control.sent[0]),
            command_timeouts=loop.timeouts,
            received=loop.counts,
            injections=self._orders.count,
            injected=list(self._orders.done),
            injections_refused=self._orders.refused,
        )

    def command(self, command: None = None, /, **quantities: float | str | bool) -> None:
        """What is sent every command cycle from now on, by quantity, through rig and codec, with counter and
        checksum: `left_duty`, `right_duty` [%], `left_direction`, `right_direction` or `direction` for both
        (coast, open, close, brake), `latch_release`; `latch_cinch` is sent where it is named. What is not
        named is 0 (coast). `command(None)` goes silent.

        Raises ConfigError.
        """
        self._check_open()
        if command is not None:
            raise ConfigError(
                f"`command` {show(command)}: allowed: None, or quantities by their names"
            )
        if quantities:
            self._command.change(quantities)
        else:
            self._command.silence()

    def send(self, message: can.Message) -> None:
        """A frame that the gate reads in the next tick. Raises ConfigError."""
        from liftgate_hil.transport.messages import NotAFrameError, fields_of

        self._check_open()
        try:
            identifier, length, flags, data = fields_of(message)
        except NotAFrameError as error:
            raise ConfigError(f"`send` {error}") from error
        self._waiting.append((identifier | (FD if flags else 0), length, data))

    def set(self, **surroundings: float | None) -> None:
        """Surroundings from the next tick on: `road_slope_deg=8`, `supply_voltage_v`, `hand_force_n` and so on;
        switches (`handle_pulled`) take True and False; None clears. Raises ConfigError.
        """
        self._check_open()
        self._hold(surroundings_in(surroundings))

    def obstacle(
        self,
        angle_deg: float,
        stiffness: float = STIFFNESS,
        distance: float | None = None,
        damping: float = 0.0,
        gap: float = 0.0,
        meets: str = "closing",
        lateral: float = 0.0,
    ) -> None:
        """Put a compliant body (N/m, N s/m) in the gate's way at an angle, a distance [m] from the hinge (default:
        the gate's edge) and a lateral position [m] (positive to the left), met while closing or opening.

        Raises ConfigError.
        """
        self._check_open()
        given = {
            "angle_deg": angle_deg,
            "stiffness": stiffness,
            "distance": distance,
            "damping": damping,
            "gap": gap,
            "meets": meets,
            "lateral": lateral,
        }
        self._hold(held_obstacle(obstacle_in(given, self._distance)))

    def clear_obstacle(self) -> None:
        """Take it away."""
        self._check_open()
        self._hold(held_obstacle(None))

    def _hold(self, values: Mapping[str, float]) -> None:
        """What acts from the next tick on."""
        hold(self._script.scene.held, values)

    def signal(self, name: str, value: float | str | None) -> None:
        """What another control unit sends (`MESSAGE.SIGNAL` of the rig's database, in its unit or by its label),
        from now on in its message's cycle, with counter and protection; the message's other signals have their
        start values. None: this one has its start value again.

        Raises ConfigError.
        """
        self._check_open()
        issues = ConfigIssues("`signal`")
        tables, taken = self.rig.tables, self.rig.mapped
        if value is None and name in self._signals:
            value = restbus.start_value(tables.messages, name)
        number = value_in("", str(name), value, tables, taken, issues)
        issues.raise_if_any()
        assert number is not None
        is_new = name not in self._signals
        self._signals[name] = number
        if is_new:
            self._change_scene()
        place = list(self._signals).index(name)
        self._script.scene.restbus.transmission.values[place] = number

    def fault(
        self, kind: str, where: str | None = None, *, seed: int = 0, **values: Any
    ) -> InjectedFault:
        """Break something from the next tick on: a kind of docs/scenario.md, which drive's (`left`, `right`,
        `both`) or which message's, and the kind's own values: `gate.fault("hall_a_stuck", where="left", value=0)`.
        What it gives has `clear()`, which mends it.

        Raises ConfigError.
        """
        self._check_open()
        fault = replace(fault_of(kind, where, {"seed": seed, **values}), start=Instant(self.time))
        # What is wrong with it, beside those that there are, is told before it counts.
        self._injections([*self._ordered, *(each.fault for each in self._faults), fault])
        made = InjectedFault(self, fault)
        self._faults.append(made)
        self._change_scene()
        return made

    def _inject(self, faults: Sequence[Fault]) -> None:
        """What frames of a test bench have ordered. Raises ConfigError."""
        self._injections(faults)
        self._ordered = tuple(faults)
        self._change_scene()

    def _injections(self, faults: Sequence[Fault]) -> list[Injection]:
        names = (*self._signals, *self.rig.settable)
        sent = {name.partition(".")[0] for name in names}
        return injections_of(faults, self._vehicle, self.rig, sent)

    def _clear(self, fault: InjectedFault) -> None:
        self._faults = [each for each in self._faults if each is not fault]
        self._change_scene()

    def _change_scene(self) -> None:
        """A scene with the faults and the restbus that there are now; what has begun goes on where it is."""
        before = self._script.scene
        scene = scene_of(
            constants_in(self._config),
            injections=self._injections([*self._ordered, *(each.fault for each in self._faults)]),
            tables=self.rig.tables,
            changes=[SignalChange(START, *each) for each in self._signals.items()],
            opening=self._opening,
        )
        restbus.going_on(before.restbus, scene.restbus)
        on_its_way = going_on(before.bus_faults, scene.bus_faults)
        scene = scene._replace(held=before.held, bus_faults=on_its_way, tester=before.tester)
        self._script = self._script._replace(scene=scene)

    def read_dtcs(self, cycle: Callable[[], object]) -> dict[str, int]:
        """The trouble codes of the ECU under test: the status byte (ISO 14229-1) of each by its text, for example
        {"B1A01-62": 0x2F}, read by a tester beside the gate as the rig's `[diagnostics]` says: UDS
        ReadDTCInformation, reportDTCByStatusMask with `status_mask`.

        `cycle` is once through the caller's loop: the gate steps, the ECU gets what gate and tester have sent, and
        what it sends goes to the gate. It is called, without arguments, until the ECU has answered.

            def cycle():
                for message in ecu.step(gate.time, gate.step(0.010)):
                    gate.send(message)

            gate.clear_dtcs(cycle)
            gate.fault("hall_a_stuck", where="left", value=0)
            for _ in range(300):
                cycle()
            assert "B1A01-62" in gate.read_dtcs(cycle)

        Raises DiagnosticsError where the ECU refuses the request, with its `nrc`, or does not answer within
        `timeout_ms` (5 s after "response pending", 60 s at most); ConfigError where the rig has no `[diagnostics]`
        or `cycle` does not step this gate; and what `cycle` raises.
        """
        return read_codes(*self._to_be_asked("read_dtcs", cycle))

    def clear_dtcs(self, cycle: Callable[[], object]) -> None:
        """Clear all trouble codes of the ECU under test: UDS ClearDiagnosticInformation of all groups. `cycle`
        and what is raised are as with `read_dtcs`.
        """
        clear_codes(*self._to_be_asked("clear_dtcs", cycle))

    def _to_be_asked(self, name: str, cycle: Callable[[], object]) -> tuple[Diagnostics, Bench]:
        """How the ECU can be asked, and where. Raises ConfigError."""
        self._check_open()
        own = self.rig.diagnostics
        if own is None:
            said = "has no [diagnostics]; allowed: with one that has, with request and response"
            raise ConfigError(f"`{name}`: the rig {self.rig.source} {said}")
        if not services.is_there():
            raise ConfigError(f"`{name}`: trouble codes {services.MISSING}")
        if not callable(cycle):
            raise ConfigError(f"`cycle` {show(cycle)}: allowed: a function without arguments")
        if is_asking_once(self._script.scene.tester):
            raise ConfigError(f"`{name}`: the tester waits for a response; allowed: after that")
        return own, Bench(self._put_tester, cycle, lambda: self.time)

    def _put_tester(self, tester: Tester) -> None:
        self._script = self._script._replace(scene=self._script.scene._replace(tester=tester))

    def step(self, seconds: float) -> list[can.Message]:
        """Advance by a time [s], rounded to ticks, at least one; the frames that the gate sent meanwhile.

        Raises PlantDivergedError.
        """
        from liftgate_hil.transport.messages import message_of

        self._check_open()
        if not isinstance(seconds, Real) or isinstance(seconds, bool) or not 0.0 < seconds <= 1e6:
            raise ConfigError(f"`step` {show(seconds)}: allowed: above 0, up to 1e6 s")
        end = self._now.loop.tick + max(1, round(seconds / self._config.step))
        messages: list[can.Message] = []
        self._edges = []
        while self._now.loop.tick < end:
            seen = int(self._now.loop.sensors.edges.written[0])
            self._advance(self._next_stop(end))
            control = self._memory.shared.control[0]
            self._row[:] = self._memory.shared.rows[control.rows - 1]
            for row in self._memory.shared.frames[: control.frames]:
                if row["is_sent"]:
                    frames = Frames(
                        1,
                        np.array([row["identifier"]]),
                        np.array([row["length"]]),
                        row["payload"].reshape(1, -1),
                    )
                    message = message_of(frames, 0)
                    message.timestamp = row["time_ns"] * 1e-9
                    messages.append(message)
            self._orders.look(self._memory.shared.frames[: control.frames], self.time)
            control.rows = control.frames = 0
            self._edges += edges_since(self._now.loop.sensors.edges, seen)
            if self._now.outcome == DIVERGED:
                raise PlantDivergedError(f"the plant diverged at {self.time:.3f} s")
        return messages

    def edges(self, drive: str) -> list[Edge]:
        """The edges of a drive's Hall sensors, `left` or `right`, during the last `step`, in the order of time.

        Raises ConfigError.
        """
        drives = DRIVES[: self._drives]
        if drive not in drives:
            raise ConfigError(f"`edges` {show(drive)}: allowed: {', '.join(drives)}")
        return [edge for edge in self._edges if edge.drive == drive]

    def _next_stop(self, end: int) -> int:
        """Where the next command is due, or the end."""
        tick = self._now.loop.tick
        is_ordered = any(self._orders.is_one(identifier) for identifier, _, _ in self._waiting)
        if len(self._waiting) > wire.CAPACITY or is_ordered:
            return tick + 1
        if math.isfinite(release := self._orders.next_release):
            end = min(end, max(tick + 1, math.ceil(release / self._config.step - 1e-6)))
        if not self._command.is_on:
            return min(end, tick + _ROWS)
        cycle = self._command.cycle
        return min(end, (tick // cycle + 1) * cycle, tick + _ROWS)

    def _advance(self, stop: int) -> None:
        """Give what is to be given, and tick until `stop`."""
        self._waiting += self._command.frames_at(self._now.loop.tick)
        sent = self._now.node.port.sent
        given, self._waiting = self._waiting[: wire.CAPACITY], self._waiting[wire.CAPACITY :]
        for place, (identifier, length, data) in enumerate(given):
            sent.identifiers[place], sent.lengths[place] = identifier, length
            sent.data[place, : len(data)] = np.frombuffer(data, dtype=np.uint8)
        start = self._now._replace(pending=len(given))
        script = self._script._replace(ticks=stop)
        self._now = self._run(self._config, self._bus.node, start, script, self._memory.shared)


class _GateTarget:
    """Obeys the orders of a test bench, see Target."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate

    def inject(self, faults: Sequence[Fault]) -> None:
        """See Target."""
        self._gate._inject(faults)

    def set_signals(
        self, values: Mapping[str, float], instead_of: float = math.nan, rest: float = math.nan
    ) -> None:
        """See Target."""
        for name, value in values.items():
            now = self._gate._signals.get(name)
            if math.isnan(instead_of) or now == instead_of:
                self._gate.signal(name, rest if math.isnan(value) else value)

    def reset(self) -> None:
        """See Target."""
        raise ConfigError(
            "request reset; allowed with [reset] signal: this gate's ECU is the caller's"
        )


class InjectedFault:
    """A fault that a gate has, until it is cleared."""

    def __init__(self, gate: Gate, fault: Fault) -> None:
        self._gate = gate
        self.fault = fault

    def clear(self) -> None:
        """Mend it from the next tick on; once is enough."""
        self._gate._clear(self)
