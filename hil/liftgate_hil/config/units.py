"""Units in the spellings of files and databases, and their conversion to a quantity's unit in the catalogue.

A unit is a factor to the first unit of its dimension, kept as numerator and denominator so that conversions are
exact if possible, and for temperatures an offset. Spellings are compared without spaces, dots and multiplication
signs; words of three or more letters in any case, shorter ones and those that may begin with milli or mega
(mA, mPa) as they stand.
"""

from __future__ import annotations

import functools
import math
import re
import unicodedata
from collections.abc import Mapping
from typing import NamedTuple

from liftgate_plant.signals import Signal

Conversion = tuple[float, float]  # ours = factor · theirs + offset
SAME: Conversion = (1.0, 0.0)


class Unit(NamedTuple):
    """A unit, defined by: first unit of its dimension = numerator / denominator · this unit + offset."""

    numerator: float
    denominator: float = 1.0
    offset: float = 0.0


_TURN = 2.0 * math.pi
_NUMBER = Unit(1.0)
_NONE = ("1", "-", "--", "n/a", "na", "none", "unitless", "dimensionless", "SED")

# Spellings by dimension and unit. Messages use the first spelling.
_SPELLINGS: Mapping[str, Mapping[Unit, tuple[str, ...]]] = {
    "current": {
        Unit(1): ("A", "amp", "amps", "ampere", "amperes", "amper", "A_DC"),
        Unit(1, 1000): ("mA", "milliamp", "milliamps", "milliampere", "milliamper", "mAmp",
                        "mAmps"),
        Unit(1, 1_000_000): ("µA", "uA", "microampere"),
        Unit(1000): ("kA", "kiloampere"),
    },
    "voltage": {
        Unit(1): ("V", "volt", "volts", "VDC", "V_DC"),
        Unit(1, 1000): ("mV", "millivolt", "millivolts", "mVolt"),
        Unit(1, 1_000_000): ("µV", "uV"),
        Unit(1000): ("kV", "kilovolt"),
    },
    "time": {
        Unit(1): ("s", "sec", "secs", "second", "seconds", "Sek", "Sekunde", "Sekunden"),
        Unit(1, 1000): ("ms", "msec", "millis", "millisecond", "milliseconds", "Millisekunden"),
        Unit(1, 1_000_000): ("µs", "us", "usec", "µsec", "microsecond", "microseconds"),
        Unit(1, 1_000_000_000): ("ns", "nsec"),
        Unit(60): ("min", "minute", "minutes", "Minuten"),
        Unit(3600): ("h", "hour", "hours", "Stunden"),
    },
    "angle": {  # of a gate, and turns of a motor
        Unit(1): ("rev", "revs", "revolution", "revolutions", "turn", "turns", "Umdr", "Umdrehung",
                  "Umdrehungen"),
        Unit(1, 360): ("deg", "°", "degree", "degrees", "Grad", "degs", "ang_deg", "Winkelgrad",
                       "degreofarc"),
        Unit(1, _TURN): ("rad", "radian", "radians"),
        Unit(1, 360_000): ("mdeg", "millidegree", "millidegrees"),
        Unit(1, 1_296_000): ("arcsec",),
        Unit(1, 1000.0 * _TURN): ("mrad",),
        Unit(1, 21_600): ("arcmin",),
    },
    "rate of turning": {
        Unit(1): ("rev/s", "rps", "1/s", "Hz", "s-1", "U/s", "rev/sec", "turns/s", "Umdr/s", "r/s",
                  "hertz"),
        Unit(1, 60): ("rpm", "1/min", "rev/min", "U/min", "min-1", "/min", "r/min", "Umdr/min", "upm",
                      "1/minute", "minutinver", "revs/min", "rotations/min"),
        Unit(1, _TURN): ("rad/s", "rad/sec", "rads/s", "rad/second", "radps"),
        Unit(1, 360): ("deg/s", "°/s", "deg/sec", "degree/s", "degrees/s", "Grad/s", "dps", "deg/second",
                       "degree/sec", "degps", "degrees/sec"),
        Unit(1, 360_000): ("mdeg/s",),
    },
    "force": {
        Unit(1): ("N", "newton", "newtons"),
        Unit(1000): ("kN", "kilonewton"),
        Unit(1, 1000): ("mN",),
        Unit(10): ("daN",),
        Unit(9.80665): ("kgf",),
        Unit(4.4482216152605): ("lbf",),
    },
    "torque": {
        Unit(1): ("Nm", "newtonmeter", "newtonmetre", "newton-meter"),
        Unit(1, 1000): ("mNm",),
        Unit(1, 100): ("Ncm",),
        Unit(1000): ("kNm",),
    },
    "impulse": {
        Unit(1): ("Ns", "newtonsecond"),
    },
    "spring rate": {
        Unit(1): ("N/m",),
        Unit(1000): ("N/mm", "kN/m"),
        Unit(100): ("N/cm",),
    },
    "acceleration": {
        Unit(1): ("m/s2", "m/s/s", "m/sec2", "m/ss", "mps2", "m/(s2)", "ms-2"),
        Unit(9.80665): ("g", "G", "g0", "gn"),
        Unit(9.80665, 1000): ("mg", "mgn", "milli-g"),
        Unit(1, 1000): ("mm/s2",),
    },
    "pressure": {
        Unit(1): ("Pa", "pascal", "N/m2"),
        Unit(100): ("hPa", "mbar", "millibar"),
        Unit(1000): ("kPa",),
        Unit(100_000): ("bar",),
        Unit(1_000_000): ("MPa",),
        Unit(6894.757293168): ("psi",),
    },
    "mass": {
        Unit(1): ("kg", "kilogram", "kilograms"),
        Unit(1, 1000): ("g", "gram", "grams"),
        Unit(1000): ("t", "tonne"),
    },
    "temperature": {
        Unit(1): ("°C", "degC", "C", "celsius", "degreeC", "degreesC", "GradC", "GradCelsius", "degcelsius",
                  "degreecelsius", "degreescelsius", "degrecelsi", "deg_C", "temp_C"),
        Unit(1, 1, -273.15): ("K", "kelvin", "degK", "°K"),
        Unit(5, 9, -160.0 / 9.0): ("°F", "degF", "fahrenheit", "degreeF", "deg_F"),
    },
    "share": {
        _NUMBER: (*_NONE[:3], "0..1", "0-1", "ratio", "fraction", "p.u.", "pu", "per unit", "norm"),
        Unit(1, 100): ("%", "percent", "per cent", "Prozent", "pct", "perc"),
        Unit(1, 1000): ("‰", "permille", "Promille"),
    },
    "number": {
        _NUMBER: (*_NONE, "count", "counts", "cnt", "cnts", "inc", "incr", "increments", "Inkremente", "Ink",
                  "pulse", "pulses", "Impuls", "Impulse", "Imp", "edge", "edges", "tick", "ticks", "steps",
                  "bool", "boolean", "bit", "bits", "flag", "state", "status", "enum", "number", "#",
                  "Anzahl", "step", "raw", "digit", "Flanken"),
    },
    # No quantity has these; they are known so that a contradiction is recognised.
    "speed": {Unit(1): ("m/s", "m/sec"), Unit(1, 3.6): ("km/h", "kph", "kmh"),
              Unit(0.44704): ("mph",), Unit(1, 1000): ("mm/s",)},
    "length": {Unit(1): ("m", "meter", "metre"), Unit(1, 1000): ("mm", "millimeter", "millimetre"),
               Unit(1, 100): ("cm",), Unit(1000): ("km",), Unit(0.0254): ("in", "inch")},
    "resistance": {Unit(1): ("Ω", "ohm", "ohms"), Unit(1, 1000): ("mΩ", "mOhm"),
                   Unit(1000): ("kΩ", "kOhm")},
    "power": {Unit(1): ("W", "watt", "watts"), Unit(1000): ("kW",)},
}  # fmt: skip


def _folded(text: str) -> str:
    """Return a unit's spelling normalized: without spaces, multiplication signs and irrelevant upper case."""
    # UTF-8 that was read as cp1252 has a letter before each of these signs.
    text = re.sub("Â(?=[°²³µ·])", "", text)
    text = unicodedata.normalize("NFKC", text).replace("μ", "µ").replace("º", "°").replace("−", "-")
    text = re.sub(r"^\[(.*)\]$|^\((.*)\)$", r"\1\2", text.strip())
    text = text.removeprefix("Unit_")  # Volkswagen's spelling
    text = re.sub(r"[\s·*×^]|\.(?!\.)(?<!\.\.)", "", text)
    letters = sum(each.isalpha() for each in text)
    return text if letters < 3 or (letters <= 5 and text[0] in "mM") else text.casefold()


@functools.cache
def _known() -> Mapping[str, Mapping[str, Unit]]:
    """Return the known units by dimension and normalized spelling."""
    return {
        dimension: {_folded(name): unit for unit, names in units.items() for name in names}
        for dimension, units in _SPELLINGS.items()
    }


@functools.cache
def dimension_of(signal: Signal) -> str:
    """Return the dimension of a quantity of the catalogue.

    Without a unit it is a number, or a share if it is not whole.
    """
    if signal.unit == "":
        return "number" if signal.is_whole or signal.values else "share"
    return dimensions_named(signal.unit)[0]


def dimensions_named(unit: str) -> list[str]:
    """Return the dimensions of a unit's spelling ([]: unknown); `g` is a mass and an acceleration."""
    return [dimension for dimension, units in _known().items() if _folded(unit) in units]


_MARKED = re.compile(
    r"(?P<bare>.*\S)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>(?:[^()]|\([^()]*\))*)\))\s*", re.DOTALL
)
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)|\{([^{}]*)\}|<([^<>]*)>")
_ENDING = re.compile(r"\s+in\s+(?=\S+$)|[_/,:|.\s-]+(?=\S)")  # what separates a unit from the name before it
_WORD = re.compile(r"[^\W\d_]{2,}")
_PER = re.compile(r"_per_|_p_|_(?=s$|min$|sec$|m$|mm$)")  # rad_per_s, rad_s


def marked_unit(name: str) -> tuple[str, str]:
    """Return a column's name and the text in brackets or parentheses behind it, as in `U [V]`; "": none."""
    parts = _MARKED.fullmatch(name)
    if parts is None:
        return name, ""
    return parts["bare"], (parts["square"] or parts["round"] or "").strip()


@functools.lru_cache(10_000)
def headed_unit(name: str) -> str:
    """Return the known unit in brackets or parentheses at the end of a column's name; "" if there is none."""
    unit = marked_unit(name)[1]
    return unit if unit and dimensions_named(unit) else ""


@functools.lru_cache(10_000)
def unit_in(name: str, signal: Signal) -> str:
    """Return the unit that another program's column name states for a quantity; "" if it states none.

    In brackets of any kind a known unit counts, and any text behind the name but a number, which is an index.
    After a slash, a space, an underscore and the like (`F/kN`, `F_kN`, `w_rad_s`) a unit of the quantity counts,
    after a slash also another one. What is stated and no unit of the quantity is refused where it is used; so is
    `mV?` of `U_mV_raw`, a word that may be one.
    """
    inner = [next(filter(None, found.groups()), "").strip() for found in _BRACKETS.finditer(name)]
    if known := [each for each in inner if not each.isdigit() and dimensions_named(each)]:
        return known[-1]
    marked = marked_unit(name)[1]
    if marked and (not marked.isdigit() or marked == "1"):
        return marked
    own = {each.casefold(): each for each in spellings(signal)}
    endings = [name[mark.end() :].strip() for mark in _ENDING.finditer(name) if name[: mark.start()].strip()]
    for ending in endings:
        for unit in (ending, _PER.sub("/", ending)):
            if unit.isdigit():
                continue
            if conversion(signal, unit) is not None:
                return unit
            if unit.casefold() in own:  # files whose headers are in lower case
                return own[unit.casefold()]
    for slash in re.finditer("/", name):
        unit = name[slash.end() :].strip()
        if not unit.isdigit() and dimensions_named(unit):
            return unit
    words = [word for word in _WORD.findall(name) if conversion(signal, word) not in (None, SAME)]
    return f"{words[-1]}?" if words else ""


@functools.cache
def conversion(signal: Signal, unit: str) -> Conversion | None:
    """Return the conversion from a unit to the quantity's own; None if the unit is unknown or does not fit."""
    units = _known()[dimension_of(signal)]
    theirs = units.get(_folded(unit))
    if theirs is None:
        return None
    ours = units[_folded(signal.unit)] if signal.unit else _NUMBER
    factor = theirs.numerator * ours.denominator / (theirs.denominator * ours.numerator)
    offset = (theirs.offset - ours.offset) * ours.denominator / ours.numerator
    return factor, offset


def allowed_units(signal: Signal) -> str:
    """Return a quantity's allowed units as a text for a message."""
    return ", ".join(units[0] for units in _SPELLINGS[dimension_of(signal)].values())


def spellings(signal: Signal) -> Mapping[str, Conversion]:
    """Return all spellings of a quantity's units, each with its conversion to the quantity's own unit."""
    found = {
        name: conversion(signal, name) for names in _SPELLINGS[dimension_of(signal)].values() for name in names
    }
    return {name: factors for name, factors in found.items() if factors is not None}
