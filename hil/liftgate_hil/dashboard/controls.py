"""Controls of a page: what can be commanded, with a label in words and the range of a slider."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from liftgate_plant.signals import SUFFIXES

JsonObject = dict[str, Any]

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


def controls_of(commands: Mapping[str, Any]) -> JsonObject:
    """Return a run's commands: quantities with `label`, `slide_low` and `slide_high`, faults with `label`."""
    found = dict(commands)
    for group in ("obstacle", "set"):
        found[group] = {name: _control(name, spec) for name, spec in commands[group].items()}
    found["fault"] = {
        kind: {
            **spec,
            "label": in_words(kind),
            "keys": {name: {**key, "label": in_words(name, key["unit"])} for name, key in spec["keys"].items()},
        }
        for kind, spec in commands["fault"].items()
    }
    return found


def _control(name: str, spec: Mapping[str, Any]) -> JsonObject:
    low, high = _USUAL.get(name, (spec["low"], spec["high"]))
    return {**spec, "label": in_words(name, spec["unit"]), "slide_low": low, "slide_high": high}


def in_words(name: str, unit: str = "") -> str:
    """Return a name as words, without the unit at its end: "Supply voltage" for supply_voltage_v."""
    plain = name.removesuffix(SUFFIXES.get(unit, "") or "\0")
    for short, word in (("hall a ", "Hall A "), ("hall b ", "Hall B "), ("hall ", "Hall ")):
        if plain.replace("_", " ").startswith(short):
            return word + plain.replace("_", " ").removeprefix(short)
    words = plain.replace("_", " ")
    return words[:1].upper() + words[1:]
