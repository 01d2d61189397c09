"""Conversion of units: known spellings give the right value, unknown units give none."""

from __future__ import annotations

import math

import pytest

from liftgate_hil.config import units
from liftgate_hil.config.units import conversion, dimension_of, dimensions_named, spellings
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, COLUMNS
from liftgate_plant.signals import Signal

QUANTITIES = {**COLUMNS, **BUS_OUTPUTS, **{f"in {name}": each for name, each in BUS_INPUTS.items()}}


def of_unit(unit: str) -> Signal:
    return Signal(unit, -1e9, 1e9, "")


COUNT = Signal("", -1e9, 1e9, "", is_whole=True)
SHARE = Signal("", -1.0, 1.0, "")


@pytest.mark.parametrize("name", QUANTITIES)
def test_the_unit_of_every_quantity_is_known(name: str):
    quantity = QUANTITIES[name]
    assert conversion(quantity, quantity.unit or "1") == (1.0, 0.0)


@pytest.mark.parametrize(
    ("ours", "unit", "theirs", "is_ours"),
    [
        ("A", "mA", 2500.0, 2.5),
        ("A", "Amps", 2.5, 2.5),
        ("A", "[A]", 2.5, 2.5),
        ("A", "µA", 2e6, 2.0),
        ("A", "\u03bcA", 2e6, 2.0),  # a Greek letter that looks alike
        ("V", "mV", 12_000.0, 12.0),
        ("V", "Volt", 12.0, 12.0),
        ("deg", "Grad", 30.0, 30.0),
        ("deg", "Degree", 30.0, 30.0),
        ("deg", "DEG", 30.0, 30.0),
        ("deg", "\u00c2°", 30.0, 30.0),  # UTF-8 that was read as cp1252
        ("deg", "rad", math.pi, 180.0),
        ("deg", "mrad", 1000.0 * math.pi, 180.0),
        ("rev/s", "rpm", 3000.0, 50.0),
        ("rev/s", "U/min", 3000.0, 50.0),
        ("rev/s", "1/min", 3000.0, 50.0),
        ("rev/s", "min^-1", 3000.0, 50.0),
        ("rev/s", "min⁻¹", 3000.0, 50.0),
        ("rev/s", "rad/s", 2.0 * math.pi, 1.0),
        ("rev/s", "°/s", 720.0, 2.0),
        ("deg/s", "rad/s", math.pi, 180.0),
        ("deg/s", "rpm", 10.0, 60.0),
        ("rev", "deg", 90.0, 0.25),
        ("°C", "deg C", 20.0, 20.0),
        ("°C", "deg. C", 20.0, 20.0),
        ("°C", "℃", 20.0, 20.0),
        ("°C", "K", 293.15, 20.0),
        ("°C", "degF", 68.0, 20.0),
        ("N", "kN", 0.2, 200.0),
        ("N/mm", "N/m", 5000.0, 5.0),
        ("m/s²", "m/s^2", 9.81, 9.81),
        ("m/s²", "g", 1.0, 9.80665),
        ("kg", "g", 500.0, 0.5),
        ("µs", "ms", 1.5, 1500.0),
        ("s", "ms", 250.0, 0.25),
        ("Pa", "hPa", 3.0, 300.0),
        ("Pa", "kPa", 3.0, 3000.0),
        ("Pa", "bar", 0.02, 2000.0),
        ("N m", "N·m", 3.0, 3.0),
        ("N m", "Nm", 3.0, 3.0),
        ("%", "1", 0.5, 50.0),
        ("%", "0..1", 0.5, 50.0),
        ("%", "Prozent", 50.0, 50.0),
    ],
)
def test_a_value_in_a_known_unit_is_converted_to_ours(ours: str, unit: str, theirs: float, is_ours: float):
    factors = conversion(of_unit(ours), unit)
    assert factors is not None
    assert factors[0] * theirs + factors[1] == pytest.approx(is_ours, rel=1e-12)


@pytest.mark.parametrize(
    ("ours", "unit"),
    [
        (of_unit("A"), "V"),
        (of_unit("A"), "MA"),
        (of_unit("A"), "0.1 A"),
        (of_unit("A"), ""),
        (of_unit("A"), "furlong"),
        (of_unit("deg"), "%"),  # a slope in per cent is no factor
        (of_unit("deg"), "°C"),
        (of_unit("°C"), "deg"),
        (of_unit("Pa"), "mPa"),  # nor is it MPa
        (of_unit("Pa"), "km/h"),
        (of_unit("%"), ""),
        (of_unit("%"), "V"),
        (COUNT, "rpm"),
        (COUNT, "rev"),
        (COUNT, "%"),
        (SHARE, "A"),
        (SHARE, ""),
    ],
)
def test_a_unit_of_another_dimension_or_unknown_has_no_conversion(ours: Signal, unit: str):
    assert conversion(ours, unit) is None


def test_a_spelling_means_only_one_unit_of_a_dimension():
    for known in units._SPELLINGS.values():
        meant: dict[str, units.Unit] = {}
        for unit, names in known.items():
            for name in names:
                assert meant.setdefault(units._folded(name), unit) == unit, name


def test_a_count_and_a_share_have_different_dimensions_and_units():
    assert dimension_of(COUNT) == "number"
    assert dimension_of(SHARE) == "share"
    assert conversion(COUNT, "counts") == (1.0, 0.0)
    assert conversion(SHARE, "%") == (0.01, 0.0)
    assert dimensions_named("g") == ["acceleration", "mass"]


def test_the_spellings_of_a_unit_have_their_conversions():
    assert spellings(of_unit("A"))["mA"] == (0.001, 0.0)
    assert spellings(of_unit("A"))["A"] == (1.0, 0.0)
