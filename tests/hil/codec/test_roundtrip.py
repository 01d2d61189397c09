"""Signals of any database: our receive and transmit against cantools' decode and encode."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import cantools
import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hil_support import CALM, FREE, bus_config_of, frames_of, j1850, taken, transmitted
from hypothesis import assume, given
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_hil.codec.bus_config import SignalMapping, pages_of, raw_range
from liftgate_hil.codec.frames import EXTENDED, FD, empty_frames
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.receive import NO_COUNTS, Counts, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import encode, first_transmission, times_sent, transmit
from liftgate_plant import signals as catalogue

NAN = float("nan")


class Codec(NamedTuple):
    """Receive and transmit, as Python or as machine code."""

    receive: Callable[..., Counts]
    transmit: Callable[..., Any]


@pytest.fixture(scope="module", params=["plain", "compiled"])
def codec(request: pytest.FixtureRequest) -> Codec:
    if request.param == "plain":
        return Codec(receive, transmit)
    return Codec(compiled(receive), compiled(transmit))


def take(codec: Codec, bus: BusConfig, identifier: int, payload: bytes) -> tuple[Any, Counts]:
    """Return the values received in one frame, and the counts."""
    quantities = 1 + int(max(bus.signals.quantity, default=0))
    frames = frames_of([(identifier, payload)])
    start = nothing_received(bus, quantities)
    reception, counts = taken(bus, start, NO_COUNTS, frames, 0, codec.receive)
    return reception.values, counts


def put(codec: Codec, bus: BusConfig, values: list[float]) -> bytes:
    """Return the payload in which the only message is sent with these values."""
    _, frames = transmitted(bus, values, call=codec.transmit)
    assert frames.count == 1
    return frames.data[0, : int(frames.lengths[0])].tobytes()


@st.composite
def signals(draw: st.DrawFn, size: int) -> list[Signal]:
    """Draw signals side by side in `size` bytes, some Intel, some Motorola, with gaps."""
    result: list[Signal] = []
    position = 0
    order = ""
    while len(result) < 8:
        position += draw(st.integers(0, 9))
        mine = draw(st.sampled_from(("little_endian", "big_endian")))
        if mine != order:
            position = 8 * math.ceil(position / 8)
            order = mine
        kind = draw(st.sampled_from(("unsigned", "signed", "float", "double")))
        length = {"float": 32, "double": 64}.get(kind) or draw(st.integers(1, 64))
        if position + length > 8 * size:
            break
        start = position
        if order == "big_endian":
            start = 8 * (position // 8) + 7 - position % 8
        conversion = BaseConversion.factory(
            scale=draw(st.sampled_from((1, 0.1, 0.01, 0.005, 0.5, 3, -1, -0.25, 1e-3, 250.0))),
            offset=draw(st.sampled_from((0, -40, -55, 0.5, 1000, -12.34))),
            is_float=kind in ("float", "double"),
        )
        result.append(
            Signal(f"S{len(result)}", start, length, order, is_signed=kind == "signed", conversion=conversion)
        )
        position += length
    assume(result)
    return result


@st.composite
def messages(draw: st.DrawFn) -> Message:
    is_fd = draw(st.booleans())
    size = draw(st.sampled_from((8, 12, 24, 64) if is_fd else (1, 3, 5, 8)))
    extended = draw(st.booleans())
    return Message(
        draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
        "M",
        size,
        draw(signals(size)),
        is_extended_frame=extended,
        is_fd=is_fd,
        strict=True,
    )


def identifier_of(message: Message) -> int:
    return message.frame_id | (EXTENDED if message.is_extended_frame else 0)


def layout_for(message: Message, sending: bool = False) -> BusConfig:
    mappings = [SignalMapping(signal.name, "M", signal.name) for signal in message.signals]
    return bus_config_of({"M": message}, mappings, sending=sending)


def slack(signal: Signal, raw: float) -> float:
    """Return the rounding error of raw · factor + offset in double precision."""
    return 4e-16 * (abs(raw * signal.scale) + abs(signal.offset))


@CALM
@given(messages(), st.binary(min_size=64, max_size=64))
def test_received_values_are_those_decoded_by_cantools(codec: Codec, message: Message, payload: bytes):
    payload = payload[: message.length]
    raw = message.decode(payload, decode_choices=False, scaling=False)
    expected = message.decode(payload, decode_choices=False)
    sound = all(
        math.isfinite(raw[signal.name]) and abs(expected[signal.name]) <= 1e300 for signal in message.signals
    )
    values, counts = take(codec, layout_for(message), identifier_of(message), payload)
    if not sound:
        assert counts == NO_COUNTS._replace(out_of_range=1)
        assert np.isnan(values).all()
        return
    assert counts == NO_COUNTS._replace(accepted=1)
    for value, signal in zip(values, message.signals, strict=True):
        assert value == pytest.approx(expected[signal.name], rel=0.0, abs=slack(signal, raw[signal.name]))


@CALM
@given(messages(), st.data())
def test_sent_frames_are_those_encoded_by_cantools(codec: Codec, message: Message, data: st.DataObject):
    raw: dict[str, float] = {}
    for signal in message.signals:
        if signal.is_float:
            raw[signal.name] = data.draw(st.floats(-1e6, 1e6, width=32))
        else:
            low, high = (int(end) for end in raw_range(signal))
            # What a double holds exactly: the tables are of doubles.
            edge = 1 << 50
            raw[signal.name] = data.draw(st.integers(max(low, -edge), min(high, edge)))
    wanted = message.encode(raw, scaling=False)
    values = []
    for signal in message.signals:
        nudge = 0.0 if signal.is_float else data.draw(st.floats(-0.3, 0.3))
        values.append((raw[signal.name] + nudge) * signal.scale + signal.offset)
    sent = put(codec, layout_for(message, sending=True), values)
    got = message.decode(sent, decode_choices=False, scaling=False)
    for signal in message.signals:
        if signal.is_float:  # scaled and back: a last digit may differ
            step = max(abs(raw[signal.name]), abs(signal.offset / signal.scale), 1e-30)
            relative = 2.5e-7 if signal.length == 32 else 1e-15
            assert got[signal.name] == pytest.approx(raw[signal.name], abs=relative * step)
        elif abs(raw[signal.name]) < 1 << 40:
            assert got[signal.name] == raw[signal.name]
    if all(not s.is_float and abs(raw[s.name]) < 1 << 40 for s in message.signals):
        assert sent == wanted


@CALM
@given(messages(), st.data())
def test_a_value_reads_back_within_half_a_quantum(codec: Codec, message: Message, data: st.DataObject):
    bus = layout_for(message, sending=True)
    values = []
    for signal in message.signals:
        low, high = raw_range(signal)
        raw = data.draw(st.floats(max(low, -1e6), min(high, 1e6)))
        values.append(raw * signal.scale + signal.offset)
    payload = put(codec, bus, values)
    back, counts = take(codec, layout_for(message), identifier_of(message), payload)
    assert counts.accepted == 1
    decoded = message.decode(payload, decode_choices=False)
    for value, got, signal in zip(values, back, message.signals, strict=True):
        quantum = abs(signal.scale)
        if signal.is_float:
            raw = (value - signal.offset) / signal.scale
            quantum *= max(abs(raw), abs(signal.offset / signal.scale), 1e-30) * (
                2.4e-7 if signal.length == 32 else 1e-15
            )
        limit = 0.5 * quantum + slack(signal, abs(value / signal.scale))
        assert abs(decoded[signal.name] - value) <= limit
        assert abs(got - value) <= limit


EXTREMES = (1e3, 1e10, 9e15, 1e18, 1e19, 4e19, 1e30, 1e200, math.inf)


@CALM
@given(messages(), st.sampled_from(EXTREMES), st.sampled_from((1.0, -1.0)))
def test_an_out_of_range_value_is_sent_as_the_nearest_limit(
    codec: Codec, message: Message, size: float, sign: float
):
    bus = layout_for(message, sending=True)
    payload = put(codec, bus, [sign * size] * len(message.signals))
    got = message.decode(payload, decode_choices=False, scaling=False)
    for signal in message.signals:
        if signal.is_float:
            assert math.isfinite(got[signal.name])
            continue
        low, high = raw_range(signal)
        raw = (sign * size - float(signal.offset)) / float(signal.scale)
        if raw >= high:
            # A double cannot hold the limit of a long signal: the nearest that fits will do.
            assert got[signal.name] == pytest.approx(high, rel=1e-15)
        elif raw <= low:
            assert got[signal.name] == pytest.approx(low, rel=1e-15)


@pytest.mark.parametrize("factor", [2.0, -2.0, 1.0, 1e-3])
@pytest.mark.parametrize("value", [math.inf, -math.inf])
@pytest.mark.parametrize("length", [32, 64])
def test_a_float_whose_range_times_its_factor_is_infinite_is_sent_finite(
    codec: Codec, factor: float, value: float, length: int
):
    conversion = BaseConversion.factory(is_float=True, scale=factor)
    message = Message(1, "M", 8, [Signal("S0", 0, length, "little_endian", conversion=conversion)])
    payload = put(codec, layout_for(message, sending=True), [value])
    raw = message.decode(payload, scaling=False)["S0"]
    assert math.isfinite(raw)
    assert math.copysign(1.0, raw) == math.copysign(1.0, value * factor)


LENGTHS = (1, 7, 8, 16, 24, 31, 32, 33, 53, 54, 63, 64)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("value", [1e30, -1e30, math.inf, -math.inf])
def test_signals_of_every_length_saturate_at_their_limits(codec: Codec, signed: bool, value: float):
    wrong = {}
    for length in LENGTHS:
        signal = Signal("S0", 0, length, "little_endian", is_signed=signed)
        message = Message(1, "M", 8, [signal])
        payload = put(codec, layout_for(message, sending=True), [value])
        got = int(message.decode(payload, decode_choices=False)["S0"])
        bits = length - signed
        limit = (1 << bits) - 1 if value > 0.0 else -(1 << bits) * signed
        # A double cannot hold the limits of the long ones: the nearest that fits will do.
        if abs(got - limit) > 1e-15 * abs(limit):
            wrong[length] = got
    assert not wrong


def test_the_upper_half_of_a_64_bit_unsigned_signal_is_sent(codec: Codec):
    signal = Signal("S0", 0, 64, "little_endian")
    message = Message(1, "M", 8, [signal])
    payload = put(codec, layout_for(message, sending=True), [1.5 * 2.0**63])
    assert int.from_bytes(payload, "little") == 3 << 62


def test_an_unavailable_quantity_is_sent_as_its_start_value(codec: Codec):
    first = Signal("S0", 0, 16, "little_endian", raw_initial=1234)
    second = Signal("S1", 23, 16, "big_endian", is_signed=True, raw_initial=-5)
    message = Message(1, "M", 8, [first, second])
    bus = layout_for(message, sending=True)
    assert message.decode(put(codec, bus, [7.0, NAN])) == {"S0": 7, "S1": -5}
    assert message.decode(put(codec, bus, [NAN, 7.0])) == {"S0": 1234, "S1": 7}


def test_a_message_without_any_available_quantity_is_not_sent(codec: Codec):
    message = Message(1, "M", 8, [Signal("S0", 0, 16, "little_endian", raw_initial=1234)])
    bus = layout_for(message, sending=True)
    after, frames = transmitted(bus, [NAN], call=codec.transmit)
    assert (frames.count, after.sent.tolist()) == (0, [0])


@pytest.mark.parametrize(("low", "high"), [(-10, 20), (0, 0), (5, 5)])
def test_the_databases_range_applies_both_ways_and_an_empty_one_is_ignored(codec: Codec, low: float, high: float):
    signal = Signal(
        "S0", 0, 16, "little_endian", is_signed=True, minimum=low, maximum=high,
        conversion=BaseConversion.factory(scale=0.1, offset=0),
    )  # fmt: skip
    message = Message(1, "M", 8, [signal])
    there = low < high
    payload = put(codec, layout_for(message, sending=True), [500.0])
    assert message.decode(payload)["S0"] == pytest.approx(20.0 if there else 500.0)
    over = (201).to_bytes(2, "little", signed=True) + bytes(6)
    _values, counts = take(codec, layout_for(message), 1, over)
    assert counts == NO_COUNTS._replace(**{"out_of_range" if there else "accepted": 1})
    limit = (200).to_bytes(2, "little", signed=True) + bytes(6)
    assert take(codec, layout_for(message), 1, limit)[1].accepted == 1


@pytest.mark.parametrize("length", [24, 32, 40, 48])
@pytest.mark.parametrize("signed", [False, True])
def test_the_range_of_a_long_signal_is_exact_to_the_last_quantum(codec: Codec, length: int, signed: bool):
    limit = 2 ** (length - 2)
    low = -limit if signed else 0
    signal = Signal("S0", 0, length, "little_endian", is_signed=signed, minimum=low, maximum=limit)
    message = Message(1, "M", 8, [signal])
    bus = layout_for(message, sending=True)
    assert message.decode(put(codec, bus, [1e15]))["S0"] == limit
    assert message.decode(put(codec, bus, [-1e15]))["S0"] == low
    # What is sent, a receiver with the same database takes.
    assert take(codec, layout_for(message), 1, put(codec, bus, [1e15]))[1].accepted == 1


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
@pytest.mark.parametrize("length", [32, 64])
def test_nan_and_infinite_floats_are_refused(codec: Codec, length: int, bad: float):
    conversion = BaseConversion.factory(is_float=True)
    signal = Signal("S0", 0, length, "little_endian", conversion=conversion)
    message = Message(1, "M", 8, [signal])
    values, counts = take(codec, layout_for(message), 1, message.encode({"S0": bad}))
    assert counts == NO_COUNTS._replace(out_of_range=1)
    assert np.isnan(values).all()


def test_scale_and_offset_of_the_rig_convert_both_ways(codec: Codec):
    signal = Signal("S0", 7, 16, "big_endian", conversion=BaseConversion.factory(scale=0.5, offset=-100))
    message = Message(1, "M", 8, [signal])
    wire = SignalMapping("q", "M", "S0", scale=-0.2, offset=3.0)
    bus = bus_config_of({"M": message}, [wire], sending=True)
    payload = put(codec, bus, [3.0 - 0.2 * 60.0])
    assert message.decode(payload)["S0"] == 60.0
    values, _ = take(codec, bus, 1, payload)
    assert values[0] == pytest.approx(3.0 - 0.2 * 60.0)


COLOURS = catalogue.Signal("", 0.0, 3.0, "colour", ("red", "green", "blue", "none"))


def colour_layout(values: dict[str, float | str]) -> tuple[Message, BusConfig]:
    signal = Signal(
        "S0", 0, 8, "little_endian",
        conversion=BaseConversion.factory(scale=2, offset=10, choices={3: "Rot", 7: "Blau"}),
    )  # fmt: skip
    message = Message(1, "M", 8, [signal])
    wire = SignalMapping("colour", "M", "S0", values=values)
    return message, bus_config_of({"M": message}, [wire], quantities={"colour": COLOURS})


def test_enumerations_are_mapped_by_label_and_by_physical_number(codec: Codec):
    _message, bus = colour_layout({"red": "Rot", "blue": "Blau", "none": 50})
    for raw, ours in ((3, 0.0), (7, 2.0), (20, 3.0)):
        values, counts = take(codec, bus, 1, bytes([raw, *bytes(7)]))
        assert counts.accepted == 1
        assert values[0] == ours
        assert put(codec, bus, [ours])[0] == raw


@pytest.mark.parametrize("raw", [0, 1, 2, 4, 8, 21, 255])
def test_a_number_outside_the_mapped_enumeration_is_refused(codec: Codec, raw: int):
    _, bus = colour_layout({"red": "Rot", "blue": "Blau", "none": 50})
    assert take(codec, bus, 1, bytes([raw, *bytes(7)]))[1].out_of_range == 1


def multiplexed() -> Message:
    """A message with two signals that share their bits, and one that is in every frame."""
    return Message(
        0x18FF1234,
        "M",
        8,
        [
            Signal("Mux", 4, 4, "little_endian", is_multiplexer=True),
            Signal("A", 15, 16, "big_endian", multiplexer_ids=[2, 5], multiplexer_signal="Mux"),
            Signal("B", 8, 24, "little_endian", is_signed=True, multiplexer_ids=[3],
                   multiplexer_signal="Mux"),
            Signal("C", 40, 16, "little_endian"),
        ],
        is_extended_frame=True,
    )  # fmt: skip


@CALM
@given(st.binary(min_size=8, max_size=8))
def test_multiplexed_signals_are_read_only_under_their_own_multiplexer_values(codec: Codec, payload: bytes):
    message = multiplexed()
    mappings = [SignalMapping(name, "M", name) for name in ("A", "B", "C")]
    bus = bus_config_of({"M": message}, mappings)
    values, counts = take(codec, bus, identifier_of(message), payload)
    assert counts.accepted == 1
    try:
        expected = message.decode(payload)
    except cantools.database.DecodeError:  # a value of the multiplexer that means nothing
        expected = {"C": int.from_bytes(payload[5:7], "little")}
    for name, value in zip(("A", "B", "C"), values, strict=True):
        if name in expected:
            assert value == expected[name]
        else:
            assert np.isnan(value)


@pytest.mark.parametrize(("name", "value"), [("B", -77.0), ("C", 4000.0)])
def test_a_multiplexed_signal_is_sent_with_its_multiplexer_value(codec: Codec, name: str, value: float):
    message = multiplexed()
    bus = bus_config_of({"M": message}, [SignalMapping("B", "M", "B"), SignalMapping("C", "M", "C")], sending=True)
    payload = put(codec, bus, [value if each == name else 0.0 for each in ("B", "C")])
    decoded = message.decode(payload)
    assert decoded["Mux"] == 3
    assert decoded[name] == value


def test_a_multiplexer_page_has_the_start_values_of_all_its_signals(codec: Codec):
    own = [
        Signal("Mux", 0, 8, "little_endian", is_multiplexer=True),
        Signal("A", 8, 8, "little_endian", multiplexer_ids=[1], multiplexer_signal="Mux"),
        Signal("B", 16, 8, "little_endian", raw_initial=8, multiplexer_ids=[1], multiplexer_signal="Mux"),
        Signal("C", 16, 8, "little_endian", raw_initial=9, multiplexer_ids=[2], multiplexer_signal="Mux"),
    ]
    message = Message(0x100, "M", 8, own)
    bus = bus_config_of({"M": message}, [SignalMapping("A", "M", "A")], sending=True)
    assert message.decode(put(codec, bus, [5.0])) == {"Mux": 1, "A": 5, "B": 8}


def test_signals_under_several_multiplexer_values_are_sent_in_turn(codec: Codec):
    """The last transmission sends all pages at once, and the same tables read all values back."""
    message, names = multiplexed(), ("A", "B", "C")
    mappings = [SignalMapping(name, "M", name) for name in names]
    options = {"M": MessageOptions(cycle_ms=10.0)}
    bus = bus_config_of({"M": message}, mappings, options, sending=True)
    values = np.array([1234.0, -77.0, 4000.0])
    transmission = first_transmission(bus, len(values))
    transmission.values[:] = values
    cycle, seen = 10**7, []
    for k in range(1, 6):
        transmission.due_ns[0] = transmission.next_ns[0] = k * cycle
        frames = codec.transmit(bus, transmission, k * cycle, False)
        assert frames.count == 1
        seen.append(message.decode(frames.data[0, :8].tobytes()))
    assert seen[:2] == [{"Mux": 2, "A": 1234, "C": 4000}, {"Mux": 3, "B": -77, "C": 4000}]
    assert seen[2:] == [seen[0], seen[1], seen[0]]
    frames = codec.transmit(bus, transmission, 7 * cycle, True)
    payloads = [frames.data[k, :8].tobytes() for k in range(frames.count)]
    assert [message.decode(each)["Mux"] for each in payloads] == [3, 2]
    heard = bus_config_of({"M": message}, mappings)
    reception = nothing_received(heard, len(names))
    for k, payload in enumerate(payloads):
        rows = frames_of([(identifier_of(message), payload)])
        reception, _ = taken(heard, reception, NO_COUNTS, rows, k, codec.receive)
    assert reception.values.tolist() == values.tolist()


@given(st.lists(st.sets(st.integers(0, 5), min_size=1, max_size=3), min_size=1, max_size=6))
def test_each_signal_is_on_a_sent_page_and_no_page_is_sent_without_a_signal(places: list[set[int]]):
    """For signals under any sets of multiplexer values."""
    own = [
        Signal(f"S{k}", 8 + 8 * k, 8, multiplexer_ids=sorted(ids), multiplexer_signal="Mux")
        for k, ids in enumerate(places)
    ]
    mux = Signal("Mux", 0, 8, is_multiplexer=True)
    message = Message(1, "M", 64, [mux, *own], is_fd=True, strict=False)
    pages = pages_of(message, [each.name for each in own])
    values = [page["Mux"] for page in pages]
    assert values == sorted(set(values))
    assert all(ids & set(values) for ids in places)
    assert all(any(value in ids for ids in places) for value in values)


@pytest.mark.parametrize("page", [0, 1])
def test_how_often_a_signal_was_sent_counts_only_frames_of_its_multiplexer_page(page: int):
    message = multiplexed()
    mappings = [SignalMapping(name, "M", name) for name in ("A", "B", "C")]
    bus = bus_config_of({"M": message}, mappings, sending=True)
    transmission, told = first_transmission(bus, 3), []
    for sent in range(6):
        transmission.sent[0] = sent
        told.append(times_sent(bus, transmission, 0, page))
    assert told == ([0, 1, 1, 2, 2, 3] if page == 0 else [0, 0, 1, 1, 2, 2])
    assert times_sent(bus, transmission, 0, 2) == 5
    assert times_sent(bus, transmission, -1, 2) == 0


NESTED = """VERSION ""
BS_:
BU_: A
BO_ 100 M: 8 A
 SG_ Outer M : 0|4@1+ (1,0) [0|15] "" A
 SG_ Inner m1M : 8|4@1+ (1,0) [0|15] "" A
 SG_ Deep m2 : 16|16@1+ (1,0) [0|65535] "" A
 SG_ Other m3 : 8|24@1+ (1,0) [0|16777215] "" A

SG_MUL_VAL_ 100 Inner Outer 1-1;
SG_MUL_VAL_ 100 Deep Inner 2-2;
SG_MUL_VAL_ 100 Other Outer 3-3;
"""


def test_a_signal_under_two_multiplexers_is_read_only_if_both_values_match(codec: Codec):
    message = cantools.database.load_string(NESTED).messages[0]
    bus = bus_config_of({"M": message}, [SignalMapping("Deep", "M", "Deep")])
    there = message.encode({"Outer": 1, "Inner": 2, "Deep": 777})
    assert take(codec, bus, 100, there)[0][0] == 777
    # The bits of `Inner` belong to another signal here.
    elsewhere = message.encode({"Outer": 3, "Other": 0x123402})
    assert message.decode(elsewhere) == {"Outer": 3, "Other": 0x123402}
    assert np.isnan(take(codec, bus, 100, elsewhere)[0][0])


def test_a_signal_under_two_multiplexers_is_sent_with_the_values_of_both(codec: Codec):
    message = cantools.database.load_string(NESTED).messages[0]
    bus = bus_config_of({"M": message}, [SignalMapping("Deep", "M", "Deep")], sending=True)
    assert message.decode(put(codec, bus, [777.0])) == {"Outer": 1, "Inner": 2, "Deep": 777}


def test_a_64_byte_message_with_a_29_bit_identifier_has_counter_and_checksum():
    message = Message(
        0x1ABCDEF0, "M", 64,
        [Signal("Value", 503, 16, "big_endian"), Signal("Alive", 0, 4, "little_endian"),
         Signal("Sum", 24, 8, "little_endian")],
        is_extended_frame=True, is_fd=True,
    )  # fmt: skip
    options = {"M": MessageOptions(counter="Alive", checksum="Sum")}
    bus = bus_config_of({"M": message}, [SignalMapping("Value", "M", "Value")], options, {"Value": FREE})
    frames = empty_frames(1)
    encode(bus, 0, np.array([513.0]), 35, frames, 0)
    payload = frames.data[0].tobytes()
    assert frames.identifiers[0] == 0x1ABCDEF0 | EXTENDED | FD
    assert frames.lengths[0] == 64
    assert message.decode(payload) == {"Value": 513, "Alive": 3, "Sum": j1850(0x1ABCDEF0, payload, 3)}
