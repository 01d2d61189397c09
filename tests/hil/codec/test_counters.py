"""Alive counters of any width, start and step: values sent, accepted, and missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from cantools.database.can import Message, Signal
from hil_support import CALM, FREE, frames_of, issues_of, taken, transmitted
from hypothesis import given
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config
from liftgate_hil.codec.counter import MOST_VALUES, product
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.config.messages import message_options
from liftgate_hil.errors import ConfigError, ConfigIssues

CYCLE = 10_000_000


def bus_of(bits: int, counter: Any, sending: bool = False, order: str = "little_endian") -> BusConfig:
    start = 3 if order == "little_endian" else 5
    signals = [Signal("Counter", start, bits, order), Signal("Value", 72, 8, "little_endian")]
    message = Message(0x123, "M", 10, signals, cycle_time=10)
    issues = ConfigIssues("rig.toml")
    options = message_options(issues, {"M": {"counter": counter}}, Messages([message]))
    mapping = SignalMapping("v", "M", "Value")
    bus = build_bus_config({"M": message}, [mapping], options, {"v": FREE}, issues, sending)
    issues.raise_if_any()
    return bus


def value_in(frames: Any, bits: int, order: str) -> int:
    signals = [Signal("Counter", 3 if order == "little_endian" else 5, bits, order)]
    decoded = Message(0x123, "M", 10, signals).decode(frames.data[0, :10].tobytes(), scaling=False)
    return int(decoded["Counter"])


@st.composite
def countings(draw: st.DrawFn) -> tuple[int, dict[str, Any]]:
    bits = draw(st.one_of(st.integers(1, 8), st.integers(1, 64)))
    top = (1 << min(bits, 63)) - 1
    lowest = draw(st.one_of(st.just(0), st.integers(0, top - 1)))
    most = min(top, lowest + MOST_VALUES - 1)
    highest = draw(st.one_of(st.just(most), st.integers(lowest + 1, most)))
    span = highest - lowest
    step = draw(st.one_of(st.sampled_from((1, -1)), st.integers(1, span))) * draw(st.sampled_from((1, -1)))
    start = draw(st.integers(lowest, highest))
    keys = {"lowest": lowest, "highest": highest, "start": start, "step": step}
    return bits, {"signal": "Counter", **keys}


@CALM
@given(countings(), st.sampled_from(("little_endian", "big_endian")), st.integers(0, 2**40))
def test_each_frame_has_the_next_counter_value_and_none_counts_as_lost(
    counting: tuple[int, dict[str, Any]], order: str, before: int
):
    bits, given = counting
    there, here = bus_of(bits, given, True, order), bus_of(bits, given, False, order)
    sent, _ = transmitted(there, [1.0])
    sent.sent[0] = before
    reception, counts = nothing_received(here, 1), NO_COUNTS
    span = given["highest"] - given["lowest"] + 1
    for number in range(5):
        sent, frames = transmitted(there, [1.0], sent)
        expected = (given["start"] - given["lowest"] + given["step"] * (before + number)) % span
        assert value_in(frames, bits, order) == given["lowest"] + expected
        reception, counts = taken(here, reception, counts, frames, number * CYCLE)
    assert counts == NO_COUNTS._replace(accepted=5)


@CALM
@given(countings(), st.integers(1, 6))
def test_lost_frames_are_counted_modulo_the_counter_range(counting: tuple[int, dict[str, Any]], missing: int):
    bits, given = counting
    there, here = bus_of(bits, given, True), bus_of(bits, given)
    modulus = int(here.messages[0].modulus)
    sent, first = transmitted(there, [1.0])
    reception, counts = taken(here, nothing_received(here, 1), NO_COUNTS, first, 0)
    for _ in range(missing + 1):
        sent, frames = transmitted(there, [1.0], sent)
    _, counts = taken(here, reception, counts, frames, CYCLE)
    if (missing + 1) % modulus == 0:
        assert counts == NO_COUNTS._replace(accepted=1, counter=1)
    else:
        assert counts == NO_COUNTS._replace(accepted=2, lost=missing % modulus)


@pytest.mark.parametrize(
    ("given", "values"),
    [
        ({"lowest": 1, "highest": 14}, range(1, 15)),
        ({"step": 4, "start": 1}, (1, 5, 9, 13)),
        ({"lowest": 2, "highest": 7, "step": 3}, (2, 5)),
    ],
)
def test_a_value_outside_the_counter_sequence_is_refused(given: dict[str, int], values: Sequence[int]):
    bus = bus_of(4, {"signal": "Counter", **given})
    for value in range(16):
        frame = frames_of([(0x123, (value << 3).to_bytes(10, "little"))])
        after, counts = taken(bus, nothing_received(bus, 1), NO_COUNTS, frame, 0)
        assert (counts.counter, counts.accepted) == ((0, 1) if value in values else (1, 0)), value
        assert (after.counter[0] == -1) == (value not in values)


def test_a_refused_counter_value_does_not_restart_the_sequence():
    bus = bus_of(4, {"signal": "Counter", "highest": 9})
    reception, counts = nothing_received(bus, 1), NO_COUNTS
    for number, value in enumerate((3, 12, 6)):
        frame = frames_of([(0x123, (value << 3).to_bytes(10, "little"))])
        reception, counts = taken(bus, reception, counts, frame, number * CYCLE)
    assert counts == NO_COUNTS._replace(accepted=2, counter=1, lost=1)  # 4 or 5: one of them came


@CALM
@given(st.integers(2, MOST_VALUES), st.data())
def test_modular_products_are_exact_up_to_the_largest_modulus(modulus: int, data: st.DataObject):
    first, second = (data.draw(st.integers(0, modulus - 1)) for _ in range(2))
    assert product(first, second, modulus) == first * second % modulus


def test_modular_products_of_machine_code_equal_those_of_python():
    for modulus in (2, 15, 2**32, MOST_VALUES - 59, MOST_VALUES):
        for first, second in ((modulus - 1, modulus - 1), (modulus // 2, modulus - 1), (1, 0)):
            expected = first * second % modulus
            assert compiled(product)(first, second, modulus) == expected


@pytest.mark.parametrize(
    ("bits", "given", "message"),
    [
        (4, {"step": 0}, "counter.step: 0; allowed: -15 to -1, 1 to 15"),
        (4, {"step": 16}, "counter.step: 16; allowed: -15 to -1, 1 to 15"),
        (4, {"step": True}, "counter.step: True; allowed: -15 to -1, 1 to 15"),
        (1, {"step": 0.5}, "counter.step: 0.5; allowed: -1 or 1"),
        (4, {"highest": 16}, "counter.highest: 16; Counter has 4 bits; allowed: up to 15"),
        (4, {"lowest": 7, "highest": 7}, "counter.lowest: 7; allowed: 0 to 6, below highest"),
        (4, {"lowest": 1, "start": 0}, "counter.start: 0; allowed: 1 to 15"),
        (4, {"start": -1}, "counter.start: -1; allowed: a whole number from 0 to 2^width - 1"),
        (4, {"signal": "No"}, "counter.signal: 'No'; allowed: one of Counter, Value"),
        (4, {"width": 4}, "counter.width: 4: unknown key; allowed: signal, start, step, lowest, highest"),
        (64, {}, "counter: Counter takes 9223372036854775808 values; allowed: up to 2^48"),
    ],
)  # fmt: skip
def test_an_invalid_counter_is_reported_in_one_line(bits: int, given: dict[str, Any], message: str):
    (issue,) = issues_of(bus_of, bits, {"signal": "Counter", **given})
    assert f"rig.toml: messages.M.{message}" in issue


def test_a_counter_of_64_bits_may_have_up_to_2_to_48_values():
    for lowest in (0, 2**62):
        given = {"signal": "Counter", "lowest": lowest, "highest": lowest + 2**48 - 1}
        assert bus_of(64, given).messages[0].modulus == 2**48
    with pytest.raises(ConfigError, match="has 64 bits; allowed: up to 9223372036854775807"):
        bus_of(64, {"signal": "Counter", "lowest": 2**63 - 9, "highest": 2**63})
