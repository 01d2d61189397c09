"""Controls of a page: the commands that a run accepts, each with a label in words and a slider's range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

from liftgate_hil.dashboard.page_state import Control, Controls, FaultKey, JsonObject
from liftgate_plant.signals import SUFFIXES

# Where a slider ends; a number beside it takes the whole range.
_USUAL: Mapping[str, tuple[float, float]] = {
    "supply_voltage_v": (6.0, 18.0),  # ISO 16750-2: lowest voltage of code A; that of a failed regulator
    "road_slope_deg": (-11.3, 11.3),  # 20 %, the gradient on which UN R13-H tests parking brakes
    "ambient_temperature_degc": (-40.0, 85.0),  # chosen: inside a car in the cold, and in the sun
    "wind_pressure_pa": (-300.0, 300.0),  # ½ ρ v² of 22 m/s, 9 on Beaufort's scale
    "snow_mass_kg": (0.0, 40.0),  # 20 cm of snow of 150 kg/m³ on 1.3 m²
    "hand_force_n": (-300.0, 300.0),  # chosen: more than drives and springs hold against
    "external_torque_nm": (-200.0, 200.0),  # chosen alike
    "distance": (0.1, 1.5),  # chosen: from the hinge to beyond the edge of a long gate
    "damping": (0.0, 1000.0),  # chosen: above 632 N s/m, critical damping of 10 kg on 10 N/mm
    "lateral": (-0.6, 0.6),  # chosen: half the width of a car's gate
    "gap": (0.0, 0.1),  # chosen
    "stiffness": (1000.0, 65_000.0),  # to the stiffest rod of 49 CFR 571.118 S5
}


class _Switch(NamedTuple):
    """Switch on the page: its name, its two states, the texts of the buttons that set them, and its meaning."""

    label: str
    labels: Sequence[str]
    actions: Sequence[str]
    meaning: str


# The reference ECU takes the driver's requests only, see `ecu.buttons`.
_ONLY_SENT = "it only sets what the gate sends to the ECU; the reference ECU does not react to it"
_SWITCHES: Mapping[str, _Switch] = {
    "handle_pulled": _Switch(
        "Outer handle", ("released", "pulled"), ("Release handle", "Pull handle"),
        f"switch in the gate's outer handle: {_ONLY_SENT}",
    ),
    "button_pressed": _Switch(
        "Button on the gate", ("released", "pressed"), ("Release button", "Press button"),
        f"button on the gate: {_ONLY_SENT}",
    ),
}  # fmt: skip
# Names of a fault's keys where the key itself is no word for them; "": of any kind.
_KEY_LABELS: Mapping[tuple[str, str], str] = {
    ("", "direction"): "Direction, seen from the gate",
    ("babbling", "id"): "CAN identifier (hex)",
    ("contact_resistance", "ohm"): "Resistance",
    ("parameter", "key"): "Key of the vehicle file",
}
_HEX = {("babbling", "id")}  # keys that are shown in hexadecimal digits
# Values with which the form of a fault begins, where the command needs one and has no default.
_TYPICAL: Mapping[tuple[str, str], float | str] = {
    ("contact_resistance", "ohm"): 0.7,  # as much as a motor of the shipped `suv` has
    ("hall_missing", "probability"): 0.5,  # of pack/hall_missing
    ("hall_extra", "rate"): 100.0,  # chosen: some 15 % more edges than a drive of `suv` makes while the gate moves
    ("current_offset", "value"): 2.0,  # chosen: as pack/latch_not_releasing takes for a motor that pushes
    ("current_gain", "factor"): 0.5,  # chosen: the ECU sees half of the force
    ("angle_offset", "value"): 5.0,  # chosen: more than a sensor's tolerance, less than the soft stop
    ("spring_weak", "factor"): 0.7,  # of pack/spring_weak
    ("friction", "factor"): 2.0,  # chosen
    ("parameter", "key"): "gate.mass",
    ("parameter", "value"): 33.0,  # kg: that of `suv`, and 5 kg on it, such as a bicycle rack
    ("frame_delayed", "delay_s"): 0.05,  # chosen: longer than the time-out of three cycles of 10 ms
    ("babbling", "id"): 0,  # the highest priority
    ("babbling", "rate"): 1000.0,  # chosen: a quarter of a bus of 500 kbit/s
}


def controls_of(commands: JsonObject) -> Controls:
    """Return the commands of a run, completed with the labels and ranges that a page shows.

    Quantities have `label`, `slide_low`, `slide_high` and `actions`, faults `label`, and their keys `typical`.
    """
    found = dict(commands)
    for group in ("obstacle", "set"):
        found[group] = {name: _control(name, spec) for name, spec in commands[group].items()}
    found["fault"] = {
        kind: {
            **spec,
            "label": in_words(kind),
            "keys": {name: _fault_key(kind, name, key) for name, key in spec["keys"].items()},
        }
        for kind, spec in commands["fault"].items()
    }
    return cast(Controls, found)


def _control(name: str, spec: JsonObject) -> Control:
    """Return a quantity's control: its limits, label and slider's range, and of a switch its buttons' texts."""
    low, high = _USUAL.get(name, (spec["low"], spec["high"]))
    own = (
        _SWITCHES[name]._asdict() if name in _SWITCHES else {"label": in_words(name, spec["unit"]), "actions": ()}
    )
    return cast(Control, {**spec, "slide_low": low, "slide_high": high, **own})


def _fault_key(kind: str, name: str, key: JsonObject) -> FaultKey:
    """Return the key of a fault command, with its label and the value with which the page's form begins."""
    typical = key["default"] if key["default"] is not None else _TYPICAL.get((kind, name))
    label = _KEY_LABELS.get((kind, name)) or _KEY_LABELS.get(("", name)) or in_words(name, key["unit"])
    return cast(FaultKey, {**key, "label": label, "typical": typical, "is_hex": (kind, name) in _HEX})


def in_words(name: str, unit: str = "") -> str:
    """Return a quantity's name as words without its unit: "Supply voltage" for supply_voltage_v."""
    words = name.removesuffix(SUFFIXES.get(unit, "") or "\0").replace("_", " ")
    for short, word in (("hall a ", "Hall A "), ("hall b ", "Hall B "), ("hall ", "Hall ")):
        if words.startswith(short):
            return word + words.removeprefix(short)
    return words[:1].upper() + words[1:]
