"""Read and change a vehicle file; allowed keys and ranges are defined at the parameters themselves, in `plant`."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, dotted_keys, keys_of
from liftgate_hil.config.settings import Setting, applied, apply_setting
from liftgate_hil.config.toml import (
    Table,
    check_kind,
    copied_table,
    known_keys,
    number,
    read_text,
    read_toml,
    show,
    table,
    text,
    value_at,
)
from liftgate_hil.config.variant import AS_FILED, Variant, settings_for, spreads_of
from liftgate_hil.errors import ConfigIssues, with_unit
from liftgate_plant import gate as gate_body
from liftgate_plant import hall
from liftgate_plant.friction_profile import MOST_PLACES, places_of
from liftgate_plant.gate import GateParameters
from liftgate_plant.latch import Latch
from liftgate_plant.quantity import Points, Quantity
from liftgate_plant.sensors import Sensors, encoder_of
from liftgate_plant.signals import SIDES
from liftgate_plant.vehicle import DriveTables, Vehicle

# Top-level keys; `identification` says how values were estimated, and nothing here depends on it.
_KNOWN = ("drives", *DRIVE_TABLES, *BODY_TABLES, *SIDES, "spread", "identification")
_GEOMETRIES = 64  # linkages of which it is kept whether they are possible
_ROUNDED = 1.01  # data sheets round the constants of a motor, and measurements scatter


@dataclass(frozen=True)
class VehicleFile:
    """A vehicle file as it was read; vehicles with other settings are created from it without reading it again."""

    path: Path
    name: str  # as it was requested: a shipped name or a path
    raw: Table

    @functools.cached_property
    def _is_spread_sound(self) -> bool:
        """Whether the file's table `[spread]` has no issues, whatever its other values are."""
        issues = ConfigIssues("")
        spreads_of(issues, self.raw)
        return issues.count == 0

    def vehicle(self, settings: Sequence[Setting] = (), variant: Variant = AS_FILED) -> Vehicle:
        """Return a variant of the vehicle with settings applied. Raises ConfigError with all issues."""
        raw: Table = copied_table(self.raw)
        origins = applied(raw, settings_for(raw, variant, settings, str(self.path)))
        if self._is_spread_sound and raw.get("spread") == self.raw.get("spread"):
            raw.pop("spread", None)  # which need not be checked again
        return vehicle_of(raw, str(self.path), origins)


def read_vehicle(path: Path, name: str = "") -> VehicleFile:
    """Return a vehicle file as read, values unchecked; `name` as by the user. Raises ConfigError."""
    content = read_toml(path)
    check_kind(path, content, "vehicle", _KNOWN)
    return VehicleFile(path, name or str(path), content)


def load_vehicle(path: Path, settings: Sequence[Setting] = (), variant: Variant = AS_FILED) -> Vehicle:
    """Read a vehicle file; return a variant with settings applied. Raises ConfigError with all issues."""
    return read_vehicle(path).vehicle(settings, variant)


def vehicle_of(raw: Table, source: str, origins: Mapping[str, str] | None = None) -> Vehicle:
    """Return the vehicle of a file's content; `source`, `origins`: as in ConfigIssues. Raises ConfigError."""
    issues = ConfigIssues(source, origins)
    known_keys(issues, "", raw, _KNOWN, dotted_keys())
    spreads_of(issues, raw)
    drives = raw.get("drives")
    if isinstance(drives, bool) or drives not in (1, 2):
        text = "missing" if drives is None else show(drives)
        issues.add("drives", f"{text}; allowed: 1 (left only) or 2")
    if drives == 1 and "right" in raw:
        issues.add("right", "this gate has drives = 1, the left one; allowed: no such table")
    left = _drive_tables(issues, raw, "left")
    # If a gate has no right drive, that gets the left one's constants, and is never stepped.
    right = left if drives == 1 else _drive_tables(issues, raw, "right")
    parts = {
        name: _fields(issues, name, table(issues, name, raw.get(name, {})), kind)
        for name, kind in BODY_TABLES.items()
    }
    issues.raise_if_any()
    vehicle = Vehicle(
        drives=int(raw["drives"]),
        left=DriveTables(**{name: kind(**left[name]) for name, kind in DRIVE_TABLES.items()}),
        right=DriveTables(**{name: kind(**right[name]) for name, kind in DRIVE_TABLES.items()}),
        **{name: kind(**parts[name]) for name, kind in BODY_TABLES.items()},
    )
    if raw.get("latch") and "half" not in raw["latch"]:
        issues.add("latch.half", "missing; allowed: above 0, or no table [latch]")
    _check_whole(issues, vehicle)
    issues.raise_if_any()
    _check_friction(issues, vehicle)
    issues.raise_if_any()
    return vehicle


def issues_with(vehicle: Vehicle, with_friction: bool = True) -> list[str]:
    """Return the issues of a vehicle that arise from several values together, a line each.

    The loader refuses such a vehicle, and `with_friction` also one whose friction cannot be tabulated.
    """
    issues = ConfigIssues("")
    _check_whole(issues, vehicle)
    if with_friction and not issues.lines:
        _check_friction(issues, vehicle)
    return [line.removeprefix(": ") for line in issues.lines]


def _check_whole(issues: ConfigIssues, vehicle: Vehicle) -> None:
    """Note the issues that arise from several values together, except that of the friction's table."""
    _check_motors(issues, vehicle)
    _check_geometry(issues, vehicle.gate)
    _check_inertia(issues, vehicle.gate)
    _check_encoder(issues, vehicle.sensors)
    _check_shunt(issues, vehicle.sensors)
    _check_bridges(issues, vehicle)
    _check_latch(issues, vehicle.latch)


def _drive_tables(issues: ConfigIssues, raw: Table, side: str) -> dict[str, dict[str, Any]]:
    """Return a drive's fields by table, noting issues; keys in the side's own tables override the shared ones."""
    own = raw.get(side, {})
    if side in raw:
        own = table(issues, side, own)
        known_keys(issues, side, own, DRIVE_TABLES)
    result = {}
    for name, kind in DRIVE_TABLES.items():
        # An issue of a shared table is the same line for both drives, and so is reported once.
        shared = table(issues, name, raw.get(name, {}))
        mine = table(issues, f"{side}.{name}", own.get(name, {}))
        result[name] = _fields(issues, name, {**shared, **mine}, kind, side, mine)
    return result


def _fields(
    issues: ConfigIssues, prefix: str, given: Table, kind: type, side: str = "", own: Table | None = None
) -> dict[str, Any]:
    """Return a table's fields in SI and radians, noting issues; the keys in `own` come from one side's table."""
    keys = keys_of(kind)
    known_keys(issues, prefix, {k: v for k, v in given.items() if k not in (own or {})}, keys)
    known_keys(issues, f"{side}.{prefix}", own or {}, keys)
    result: dict[str, Any] = {}
    for key, (field, quantity, origin, default) in keys.items():
        dotted = f"{side}.{prefix}.{key}" if own and key in own else f"{prefix}.{key}"
        if key not in given:
            if default is not None:
                result[field] = default
            else:
                issues.add(dotted, f"missing; {quantity.meaning}, {_allowed(quantity)}")
            continue
        result[field] = _value(issues, dotted, given[key], quantity, origin)
    return result


def _value(issues: ConfigIssues, key: str, value: object, quantity: Quantity, origin: type) -> Any:
    """Return a value in SI and radians: number, word, curve or point; if invalid, a substitute and an issue."""
    if quantity.options:
        word = text(issues, key, value, quantity.options)
        return word if word in quantity.options else quantity.options[0]
    if origin is float:
        found = number(issues, key, value, quantity.low, quantity.high, _unit(quantity), quantity.least)
        if quantity.is_whole and found % 1.0 > 0.0:
            issues.add(key, f"{found:g}; {_allowed(quantity)}")
        return quantity.scale * found
    if origin is Points:
        return _points(issues, key, value, quantity)
    if not isinstance(value, list) or len(value) != 2:
        issues.add(key, f"{show(value)} is not a point; {_allowed(quantity, '[x, y], each of ')}")
        return (0.0, 0.0)
    return tuple(
        number(issues, f"{key}[{i}]", each, quantity.low, quantity.high, _unit(quantity))
        for i, each in enumerate(value)
    )


def _points(issues: ConfigIssues, key: str, value: object, quantity: Quantity) -> Any:
    """Return pairs (share, value) with rising shares, as of a curve; issues are noted."""
    pairs = value if isinstance(value, list) else [value]
    if not isinstance(value, list) or not all(isinstance(p, list) and len(p) == 2 for p in pairs):
        issues.add(key, f"{show(value)}; allowed: [[share, value], …] with shares from 0 to 1, rising")
        return ()
    result = tuple(
        (
            number(issues, f"{key}[{k}][0]", share, 0.0, 1.0, ""),
            number(issues, f"{key}[{k}][1]", each, quantity.low, quantity.high, _unit(quantity)),
        )
        for k, (share, each) in enumerate(pairs)
    )
    for k in range(1, len(result)):
        if result[k][0] <= result[k - 1][0]:
            issues.add(f"{key}[{k}][0]", f"{result[k][0]:g} after {result[k - 1][0]:g}; allowed: shares that rise")
    return result


def _allowed(quantity: Quantity, form: str = "") -> str:
    """Return the allowed values of a quantity in words, with `form` before the range."""
    if quantity.options:
        return f"allowed: {', '.join(quantity.options)}"
    return f"allowed: {with_unit(f'{form}{quantity.range}', _unit(quantity))}"


def _unit(quantity: Quantity) -> str:
    """Return a quantity's unit as shown to the user; "" for a pure number."""
    return "" if quantity.unit == "1" else quantity.unit


def _check_motors(issues: ConfigIssues, vehicle: Vehicle) -> None:
    """Note an issue if a motor creates energy: shaft power c1Φ i ω must not exceed the EMF's power c2Φ n i."""
    limits = [each.motor.speed_constant / (2.0 * math.pi) for each in (vehicle.left, vehicle.right)]
    given = [each.motor.torque_constant for each in (vehicle.left, vehicle.right)]
    for side, value, limit in zip(SIDES[: vehicle.drives], given, limits, strict=False):
        if value > limit * _ROUNDED:
            key = "motor.torque_constant"
            issues.add(
                key if given[0] == given[1] and limits[0] == limits[1] else f"{side}.{key}",
                f"{value:g} makes energy with speed_constant = {limit * 2.0 * math.pi:g}; "
                f"allowed: up to speed_constant/2π = {limit:.4g} N m/A, and {_ROUNDED - 1.0:.0%} for rounding",
            )


def _check_inertia(issues: ConfigIssues, gate: GateParameters) -> None:
    """Note an issue if the gate's moment of inertia about its hinge is implausible.

    It is at least m r² of the centre of gravity, and no part of the gate is further from the hinge than r plus the
    diagonal of the gate. A value beyond these limits by more than a factor of ten is a mistake, not an estimate.
    """
    radius = gate_body.linkage(gate).gravity_radius
    reach = radius + math.hypot(gate.length, gate.thickness)
    low, high = 0.1 * gate.mass * radius**2, 10.0 * gate.mass * reach**2
    if gate.inertia != 0.0 and not low <= gate.inertia <= high:
        issues.add(
            "gate.inertia",
            f"{gate.inertia:g} with this mass, length and gravity_point; allowed: {low:.3g} to {high:.3g} kg m², "
            "or 0: from mass and plate",
        )


def _check_encoder(issues: ConfigIssues, sensors: Sensors) -> None:
    """Note an issue if the Hall sensors' tolerances may displace edges so far that their order changes."""
    most, beside = hall.MOST_DISPLACED, hall.farthest(encoder_of(sensors))
    if beside > most + 1e-9:
        issues.add(
            "sensors",
            "hall_pitch_error, hall_phase_error_deg, hall_duty_error, hall_hysteresis_deg and hall_jitter_deg "
            f"move an edge by up to {90.0 * beside:.3g} electrical degrees (3 σ); "
            f"allowed: {90.0 * most:.3g} in total, as edges are 90 apart",
        )


def _check_shunt(issues: ConfigIssues, sensors: Sensors) -> None:
    """Note issues with shunt and current window: flags are 0 or 1; some keys exclude or require others."""
    for key in ("shunt_low_side", "shunt_sampled_on"):
        if getattr(sensors, key) not in (0.0, 1.0):
            issues.add(f"sensors.{key}", f"{getattr(sensors, key):g}; allowed: 0 or 1")
    if sensors.current_window > 0.0 and sensors.current_filter > 0.0:
        issues.add(
            "sensors.current_window",
            f"{sensors.current_window:g} beside current_filter = {sensors.current_filter:g}; allowed: one of them",
        )
    if sensors.shunt_sampled_on > 0.0 and sensors.shunt_low_side == 0.0:
        issues.add("sensors.shunt_sampled_on", "without shunt_low_side; allowed: together")


def _check_bridges(issues: ConfigIssues, vehicle: Vehicle) -> None:
    """Note an issue if freewheeling other than slow has no PWM frequency."""
    for side, own in zip(SIDES[: vehicle.drives], (vehicle.left, vehicle.right), strict=False):
        frequency, freewheeling = own.bridge.pwm_frequency, own.bridge.freewheeling
        prefix = "bridge" if vehicle.left.bridge == vehicle.right.bridge else f"{side}.bridge"
        if frequency == 0.0 and freewheeling != "slow":
            issues.add(f"{prefix}.freewheeling", f"{freewheeling} without pwm_frequency; allowed: together")
        if prefix == "bridge":
            break


def _check_latch(issues: ConfigIssues, own: Latch) -> None:
    """Note issues with a latch's striker positions unless full < half <= entry; with half = 0 it has none."""
    if own.half == 0.0:
        return
    if own.full >= own.half:
        issues.add("latch.full", f"{own.full:g}; allowed: less than half = {own.half:g} m")
    if own.entry < own.half:
        issues.add("latch.entry", f"{own.entry:g}; allowed: half = {own.half:g} m or more")


def _check_friction(issues: ConfigIssues, vehicle: Vehicle) -> None:
    """Note an issue if MOST_PLACES points are too few to tabulate the friction over the gate's travel."""
    stroke = gate_body.linkage(vehicle.gate).stroke
    if places_of(vehicle, stroke) > MOST_PLACES:
        issues.add(
            "friction",
            f"position_length, or spindle.lead with eccentricity, is too short for a travel of {stroke:.3g} m; "
            f"allowed: at least {stroke / MOST_PLACES * 36:.2g} m",
        )


def _check_geometry(issues: ConfigIssues, gate: GateParameters) -> None:
    """Note an issue if the actuator's length does not increase all the way from closed to open."""
    link = gate_body.linkage(gate)
    if text := _geometry_issue(link, gate.open_angle):
        issues.add("gate", text)


@functools.lru_cache(_GEOMETRIES)
def _geometry_issue(link: gate_body.Linkage, open_angle: float) -> str:
    """Return as text what is wrong with an actuator's linkage up to an angle [rad]; "": nothing."""
    if min(link.body_radius, link.gate_radius) < 1e-6:
        return "gate_point or body_point lies on the hinge; allowed: a lever arm"
    angles = [open_angle * i / 100.0 for i in range(101)]
    if min(gate_body.length(link.body_radius, link.gate_radius, link.offset, angle) for angle in angles) < 1e-6:
        return "gate_point and body_point coincide; allowed: an actuator that has a length"
    least = min(gate_body.lever(link, angle) for angle in angles)
    if least > 1e-4:
        return ""
    return (
        f"the actuator's lever arm falls to {least:.4g} m between 0 and "
        f"open_angle_deg; allowed: hinge, gate_point and body_point that keep it above 0.0001 m"
    )


_COORDINATE = re.compile(r"(.+)\[([01])\]")


def vehicle_text(
    source: Path, settings: Sequence[Setting], values: Mapping[str, float], origin: Mapping[str, Any]
) -> str:
    """Return the TOML text of `source` with `settings` and `values` (by dotted name) applied.

    `origin` becomes the table `[identification]`, which states the provenance of the values.
    """
    import tomlkit

    read_toml(source)  # raises ConfigError if it is invalid
    document: Any = tomlkit.parse(read_text(source))
    for setting in settings:
        apply_setting(document, setting)
    for name, value in values.items():
        _put(document, name, value)
    document.pop("identification", None)
    document["identification"] = dict(origin)
    text: str = tomlkit.dumps(document)
    return text


def _put(document: Any, name: str, value: float) -> None:
    """Set one value in a TOML document, also in the tables of drives that override the key."""
    match = _COORDINATE.fullmatch(name)
    names = (match[1] if match else name).split(".")
    places = [names]
    if names[0] not in SIDES:
        places += [[side, *names] for side in SIDES if value_at(document, [side, *names]) is not None]
    for path in places:
        table = document
        for key in path[:-1]:
            table = table.setdefault(key, {})
        if match:
            table[path[-1]][int(match[2])] = value
        else:
            table[path[-1]] = value
