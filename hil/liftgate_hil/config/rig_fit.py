"""Check that a rig fits a vehicle and a loop rate: ranges of signals against quantities, cycles against ticks.

A signal stays at the end of its range when the quantity goes beyond, and nothing on the bus shows it. What every
opening and closing needs must therefore fit, unless the rig says `saturates = true`; what is reached only in
extremes, e.g. by a stalled motor, is reported as a note.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.codec.bus_config import SignalMapping, counted_range
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.sending import LONGEST_MS, SendType, cycle_of, send_type_of
from liftgate_hil.config.drafting.candidates import NOBODY, is_protection
from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.inject import FAULT
from liftgate_hil.config.plausibility import notes_on_vehicle
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.signal_mapping import missing_values
from liftgate_hil.config.signal_name import notes_on_j1939
from liftgate_hil.config.units import conversion
from liftgate_hil.errors import ConfigIssues, with_unit
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PANEL
from liftgate_plant import gate
from liftgate_plant.gate import GRAVITY
from liftgate_plant.vehicle import DriveTables, Vehicle

NS = 1_000_000_000
_DUTY = 0.5  # that every motion needs


class ExpectedRange(NamedTuple):
    """Expected range of a quantity: `low` to `high` in every opening and closing, and the extremes."""

    low: float
    high: float
    lowest: float
    highest: float


def _whole(low: float, high: float) -> ExpectedRange:
    """Return a range that every motion covers in full, so that its ends are also the extremes."""
    return ExpectedRange(low, high, low, high)


def _part(share: float, most: float) -> ExpectedRange:
    """Return a symmetrical range: ±`share`·`most` in every motion, ±`most` in the extreme."""
    return ExpectedRange(-share * most, share * most, -most, most)


def expected_values(vehicle: Vehicle) -> dict[str, ExpectedRange]:
    """Return a vehicle's known ranges of values by quantity; without "true_", names are for both."""
    link = gate.linkage(vehicle.gate)
    open_deg = math.degrees(vehicle.gate.open_angle)
    supply, slope = vehicle.supply.voltage, vehicle.environment.road_slope
    weights = [
        GRAVITY * math.cos(link.gravity_angle + slope + share * vehicle.gate.open_angle)
        for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    ambient = vehicle.environment.ambient_temperature
    drives = (vehicle.left, vehicle.right)[: vehicle.drives]
    stalled = sum(supply / drive.motor.resistance for drive in drives)
    lowest = max(0.0, supply - vehicle.supply.internal_resistance * stalled)
    found = {
        "gate_angle": _whole(0.0, open_deg),
        "gate_rate": _part(0.1, open_deg),  # at most: opened within a second
        "terminal_voltage": ExpectedRange(max(lowest, 0.8 * supply), supply, lowest, supply),
        "supply_voltage": _whole(supply, supply),
        "ambient_temperature": _whole(ambient, ambient),
        "road_slope": _whole(math.degrees(slope), math.degrees(slope)),
        "gate_acceleration": _whole(min(weights), max(weights)),
    }
    for side, drive in zip(("left", "right"), drives, strict=False):
        found |= {f"{side}_{name}": each for name, each in _of_a_drive(vehicle, drive, link.stroke).items()}
        found[f"{side}_motor_temperature"] = _whole(ambient, ambient)
        found[f"true_{side}_current"] = _part(0.1, supply / drive.motor.resistance)  # without the sensor's limit
    return found


def _of_a_drive(vehicle: Vehicle, drive: DriveTables, stroke: float) -> dict[str, ExpectedRange]:
    """Return the expected ranges of one drive, by names without its side; extremes: stalled or without load."""
    sensors, motor, supply = vehicle.sensors, drive.motor, vehicle.supply.voltage
    stall = supply / motor.resistance
    turns = stroke * drive.gear.ratio / drive.spindle.lead
    fastest = supply / motor.speed_constant
    counted = fastest * sensors.hall_counts * sensors.hall_sample_period
    force = motor.torque_constant * stall * 2.0 * math.pi * drive.gear.ratio / drive.spindle.lead
    return {
        "current": _part(0.1, min(sensors.current_gain * stall, sensors.current_limit)),
        "voltage": _part(0.5, supply),
        "duty": _part(_DUTY, 1.0),
        "hall_count": _whole(0.0, turns * sensors.hall_counts),
        "hall_speed": _part(0.5, counted),
        "position": _whole(0.0, turns),
        "speed": _part(0.5, fastest),
        "force": _part(0.01, force),
    }


def check_fit(rig: Rig, vehicle: Vehicle, rate: float) -> None:
    """Raise ConfigError if a rig does not fit a vehicle and a loop rate [Hz].

    Reasons: a signal cannot hold what every motion of the vehicle needs, a message is sent more than once a tick,
    or a message that injects faults has labels of unknown kinds.
    """
    issues = ConfigIssues(rig.source)
    for wire, expected, held in _ranged(rig, vehicle):
        if not _holds(held, expected.low, expected.high):
            unit = BUS_OUTPUTS[wire.quantity].unit
            issues.add(
                f"outputs.{wire.quantity}",
                f"{wire.message}.{wire.signal} has the range {_span(*held, unit)}, any motion of this vehicle "
                f"needs {_span(expected.low, expected.high, unit)}; allowed: a signal that covers that "
                "(signed, or with an offset), or saturates = true",
            )
    for name, cycle_ns in _cycles(rig, (*rig.inputs, *rig.outputs)):
        if 0 < cycle_ns < round(NS / rate):
            issues.add(
                f"messages.{name}.cycle_ms",
                f"{cycle_ns / 1e6:g}; allowed: {1e3 / rate:g} or more, a tick at `rate` {rate:g} Hz",
            )
    for order in rig.orders:
        unknown = [each for each in order.labels if order.what == FAULT and each not in FAULT_KINDS]
        if unknown:
            signal, allowed = order.signals["kind"], ", ".join(FAULT_KINDS)
            issues.add("inject.fault.kind", f"{signal}: {', '.join(unknown)}; allowed: {allowed}")
    issues.raise_if_any()


def notes_on_fit(rig: Rig, vehicle: Vehicle, rate: float) -> list[str]:
    """Return notes for the user before a run, a line each: on the vehicle itself, and on the rig for it."""
    notes = [f"vehicle: {each}" for each in notes_on_vehicle(vehicle)]
    root, source = data_root().resolve(), Path(rig.source).resolve()
    if rig.database.resolve().is_relative_to(root / "dbc") and not source.is_relative_to(root):
        notes.append(
            f"{rig.source}: dbc: {rig.database.name} is the shipped one, as no file of that name is beside the rig"
        )
    for wire, expected, held in _ranged(rig, vehicle):
        is_refused = not _holds(held, expected.low, expected.high)
        if not is_refused and not _holds(held, expected.lowest, expected.highest):
            unit = BUS_OUTPUTS[wire.quantity].unit
            notes.append(
                f"{rig.source}: outputs.{wire.quantity}: {wire.message}.{wire.signal} has the range "
                f"{_span(*held, unit)} and saturates; this vehicle reaches "
                f"{_span(expected.lowest, expected.highest, unit)}"
            )
    notes += _uneven_cycles(rig, rate)
    for wire in rig.inputs:
        missing = missing_values(wire)
        if missing and wire.basis != "unknown":
            notes.append(
                f"{rig.source}: inputs.{wire.quantity}.values: {', '.join(missing)} missing: no frame can carry "
                "it, and an ECU that sends it (the reference ECU does) cannot be used"
            )
    return [
        *notes,
        *_sent_by_the_ecu(rig),
        *_coasting_drive(rig, vehicle),
        *_weak_duties(rig),
        *_without_timeout(rig),
        *_unprotected(rig),
        *notes_on_j1939([rig.messages[name] for name in rig.mapped], rig.source),
        *_other_counters(rig),
        *_other_scales(rig),
        *_latched_by_angle(rig),
    ]


def _uneven_cycles(rig: Rig, rate: float) -> Iterator[str]:
    """Yield a note, with all sent messages concerned, for each cycle that is no whole number of ticks."""
    found: dict[int, list[str]] = {}
    for name, cycle_ns in _cycles(rig, rig.outputs):
        ticks = cycle_ns * rate / NS
        if abs(ticks - round(ticks)) > 1e-6 * ticks:
            found.setdefault(cycle_ns, []).append(name)
    for cycle_ns, (first, *others) in found.items():
        same = f"; the same for {', '.join(others)}" if others else ""
        yield (
            f"{rig.source}: messages.{first}.cycle_ms: {cycle_ns / 1e6:g} is not a whole number of ticks of "
            f"{1e3 / rate:g} ms: the cycle is kept on average, each frame up to a tick late{same}"
        )


def _sent_by_the_ecu(rig: Rig) -> Iterator[str]:
    """Yield a note for each output message whose sender in the database is that of the motor command."""
    duties = {wire.message for wire in rig.inputs if wire.quantity.endswith("_duty")}
    ecus = {each for name in duties for each in rig.messages[name].senders} - NOBODY
    for name in dict.fromkeys(wire.message for wire in rig.outputs):
        if shared := sorted(ecus.intersection(rig.messages[name].senders)):
            wires = [f"outputs.{wire.quantity}" for wire in rig.outputs if wire.message == name]
            yield (
                f"{rig.source}: {', '.join(wires)}: {name} is a message of {', '.join(shared)} in the database, "
                f"which also sends {', '.join(sorted(duties))}: both the ECU and this gate would send it"
            )


def _coasting_drive(rig: Rig, vehicle: Vehicle) -> Iterator[str]:
    """Yield a note for a vehicle with two drives if the rig has no command for the right one."""
    mapped = {wire.quantity: wire for wire in rig.inputs}
    if vehicle.drives == 2 and "left_duty" in mapped and "right_duty" not in mapped:
        left = mapped["left_duty"]
        yield (
            f"{rig.source}: inputs.right_duty is missing: the vehicle has two drives, and the right motor coasts; "
            f'one command for both: right_duty = "{left.message}.{left.signal}", for one drive: drives = 1'
        )


def _weak_duties(rig: Rig) -> Iterator[str]:
    """Yield a note for each duty whose signal's range cannot move a gate, e.g. a share taken for percent."""
    for wire in rig.inputs:
        most = max(map(abs, wire.quantity_range(rig.messages[wire.message].get_signal_by_name(wire.signal))))
        if wire.quantity.endswith("_duty") and wire.basis != "unknown" and most < 100.0 * _DUTY:
            yield (
                f"{rig.source}: inputs.{wire.quantity}: {wire.message}.{wire.signal} reaches {most:g} % at most: "
                "is its unit a share (1) and not %?"
            )


def _unprotected(rig: Rig) -> Iterator[str]:
    """Yield a note for each signal named like a counter or a checksum for which the rig has no such entry."""
    received = {wire.message for wire in rig.inputs}
    carried = {(wire.message, wire.signal) for wire in (*rig.inputs, *rig.outputs)}
    for name in rig.mapped:
        message, options = rig.messages[name], rig.options.get(name, MessageOptions())
        for signal in message.signals:
            kind = is_protection(message, signal)
            if not kind or getattr(options, kind) is not None or (name, signal.name) in carried:
                continue
            what = (
                "is not checked: wrong frames are accepted"
                if name in received
                else "is sent with its initial value"
            )
            key = f"{rig.source}: messages.{name}.{kind}"
            yield f"{key} is missing: by its name {signal.name} is one, and it {what}"


def _other_counters(rig: Rig) -> Iterator[str]:
    """Yield a note for each counter that counts beyond its range in the database."""
    for name, options in rig.options.items():
        if options.counter is None or options.e2e is not None or name not in rig.mapped:
            continue
        signal = rig.messages[name].get_signal_by_name(options.counter)
        own = options.counting.lowest, options.counting.highest_value(signal.length)
        theirs = counted_range(signal)
        lowest = f"lowest = {theirs[0]}" if own[0] < theirs[0] else ""
        highest = f"highest = {theirs[1]}" if own[1] > theirs[1] else ""
        if lowest or highest:
            yield (
                f"{rig.source}: messages.{name}.counter: {options.counter} goes from {own[0]} to {own[1]}, in the "
                f"database from {theirs[0]} to {theirs[1]}: is {', '.join(filter(None, (lowest, highest)))}?"
            )


def _without_timeout(rig: Rig) -> Iterator[str]:
    """Yield a note for each ECU message without a timeout by its send type: its values never expire."""
    for name in dict.fromkeys(wire.message for wire in rig.inputs if wire.quantity not in PANEL):
        send_type = send_type_of(rig.messages[name], rig.options.get(name, MessageOptions()))
        if send_type is not SendType.CYCLIC:
            yield (
                f"{rig.source}: messages.{name}: by the database it is sent {send_type.value}, so its values hold "
                "until the next frame, and an ECU that falls silent goes unnoticed; cycle_ms states a cycle, and "
                "with it a time-out"
            )


def _latched_by_angle(rig: Rig) -> Iterator[str]:
    """Yield a note for a bus with a coarse angle and no latch switch: 0 is shown before latching."""
    angle = next((wire for wire in rig.outputs if wire.quantity == "gate_angle"), None)
    if angle is None or any(wire.quantity == "latch_state" for wire in rig.outputs):
        return
    if not rig.messages[angle.message].get_signal_by_name(angle.signal).is_float:
        yield (
            f"{rig.source}: outputs.latch_state is missing: with the angle alone an ECU (the reference ECU, too) "
            f"takes the gate for latched at 0 deg, which {angle.message}.{angle.signal} shows before it is latched"
        )


def _other_scales(rig: Rig) -> Iterator[str]:
    """Yield a note for each scale or unit of the rig that contradicts the database's unit."""
    for section, wires, quantities in (("inputs", rig.inputs, BUS_INPUTS), ("outputs", rig.outputs, BUS_OUTPUTS)):
        for wire in wires:
            quantity = quantities[wire.quantity]
            stated = (rig.messages[wire.message].get_signal_by_name(wire.signal).unit or "").strip()
            if wire.basis == "unit" and conversion(quantity, stated) not in (
                None,
                conversion(quantity, wire.unit),
            ):
                yield (
                    f"{rig.source}: {section}.{wire.quantity}: unit {wire.unit!r}, while the database's unit is "
                    f"{stated!r}"
                )
            if wire.basis != "rig" or not wire.unit or not quantity.unit:
                continue
            by_unit = conversion(quantity, wire.unit)
            # Many rigs need the opposite sign.
            if by_unit is None or not math.isclose(abs(wire.scale), by_unit[0], rel_tol=1e-3):
                means = "is not one of its units" if by_unit is None else f"means {by_unit[0]:g}"
                yield (
                    f"{rig.source}: {section}.{wire.quantity}: scale {wire.scale:g}, while the "
                    f"database's unit {wire.unit!r} {means}"
                )


def _ranged(rig: Rig, vehicle: Vehicle) -> Iterator[tuple[SignalMapping, ExpectedRange, tuple[float, float]]]:
    """Yield each output that must not saturate and has a known range, with that and the one of its signal."""
    expected = expected_values(vehicle)
    for wire in rig.outputs:
        name = wire.quantity
        wanted = expected.get(name, expected.get(name.removeprefix("true_")))
        if wanted is None or wire.saturates or wire.basis == "unknown":
            continue
        yield wire, wanted, rig.range_held(wire)


def _cycles(rig: Rig, mappings: Iterable[SignalMapping]) -> Iterator[tuple[str, int]]:
    """Yield name and cycle [ns] of each message of these signals; 0: none; invalid cycles are left out."""
    for name in dict.fromkeys(wire.message for wire in mappings):
        cycle = cycle_of(rig.messages[name], rig.options.get(name, MessageOptions()))
        if 0.0 <= cycle <= LONGEST_MS:  # else it is an issue of the rig
            yield name, round(cycle * 1e6)


def _holds(held: tuple[float, float], low: float, high: float) -> bool:
    """Whether the range `held` includes that from `low` to `high`."""
    return held[0] <= low and high <= held[1]


def _span(low: float, high: float, unit: str) -> str:
    return with_unit(f"{low:.4g} to {high:.4g}", unit)
