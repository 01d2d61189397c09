"""Plausibility of a row: finite numbers within what a gate can have."""

from __future__ import annotations

import math

import pytest

from liftgate_hil.loop.advance import is_sound
from liftgate_plant.signals import Truth, signals_of

REST = Truth(*(0.0 for _ in Truth._fields))
CATALOGUE = signals_of(Truth)
MOVING = [
    name
    for name in Truth._fields
    if name.endswith(("_current_a", "_speed_rps", "_position_rev", "_angle_deg", "_rate_degps"))
]


@pytest.mark.parametrize("name", Truth._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_row_with_nan_or_infinity_is_not_plausible(name: str, value: float) -> None:
    assert is_sound(REST)
    assert not is_sound(REST._replace(**{name: value}))


@pytest.mark.parametrize("name", MOVING)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_row_beyond_the_ranges_of_the_catalogue_is_not_plausible(name: str, sign: float) -> None:
    limit = CATALOGUE[name].high
    assert is_sound(REST._replace(**{name: sign * limit}))
    assert not is_sound(REST._replace(**{name: sign * 1.001 * limit}))
