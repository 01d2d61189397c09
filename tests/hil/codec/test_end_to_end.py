"""AUTOSAR E2E: checksums against the package autosar-e2e, the state machine against its specification."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import e2e.p01
import e2e.p02
import e2e.p05
import pytest
from cantools.database.can import Message, Signal
from hil_support import (
    CALM,
    FREE,
    forgotten,
    frames_of,
    loop_config,
    outside,
    rig_of,
    start_of,
    taken,
    transmitted,
)
from hypothesis import given
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_compiler.kinds import kind_of, text_of
from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config
from liftgate_hil.codec.check_state import INIT, INVALID, NODATA, STATE, VALID
from liftgate_hil.codec.protection import EndToEnd, MessageOptions
from liftgate_hil.codec.receive import NO_COUNTS, Counts, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import transmit
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.loop.tick import tick
from liftgate_hil.plan.setup import rig_from

MS = 1_000_000
CYCLE = 10 * MS
MODULI = {"e2e-p01": 15, "e2e-p02": 16, "e2e-p05": 256}
LIST = tuple((37 * i + 11) % 256 for i in range(16))

Sender = Callable[[int, float], bytes]  # counter, value → payload


def message_of(profile: str, length: int = 8) -> Message:
    """A message with CRC and counter where the profile's standard variant has them, and a value."""
    size = 16 if profile == "e2e-p05" else 8
    counter = Signal("Counter", size, 8 if profile == "e2e-p05" else 4, "little_endian")
    signals = [
        Signal("Crc", 0, size, "little_endian"),
        counter,
        Signal("Nibble", 12, 4, "little_endian"),
        Signal("Value", 24, 16, "little_endian"),
    ]
    if profile == "e2e-p05":
        del signals[2]
    return Message(0x123, "M", length, signals, cycle_time=10)


def bus_config_of(
    profile: str, sending: bool = False, length: int = 8, timeout_cycles: float = 3.0, mode: str = "", **more: Any
) -> BusConfig:
    message = message_of(profile, length)
    ids = LIST if profile == "e2e-p02" else (0x1A2B,)
    nibble = "Nibble" if mode == "nibble" else None
    if profile == "e2e-p01" and mode:
        more["data_id_mode"] = mode
    options = MessageOptions(
        timeout_cycles=timeout_cycles,
        counter="Counter",
        checksum="Crc",
        e2e=EndToEnd(profile, ids, nibble=nibble, **more),
    )
    issues = ConfigIssues("test")
    bus = build_bus_config(
        {"M": message}, [SignalMapping("v", "M", "Value")], {"M": options}, {"v": FREE}, issues, sending
    )
    issues.raise_if_any()
    return bus


def theirs(profile: str, mode: str = "both", length: int = 8) -> Sender:
    """Return a function of counter and value that makes a frame with the package autosar-e2e."""
    modes = {
        "both": e2e.p01.E2E_P01_DATAID_BOTH,
        "alternating": e2e.p01.E2E_P01_DATAID_ALT,
        "low": e2e.p01.E2E_P01_DATAID_LOW,
        "nibble": e2e.p01.E2E_P01_DATAID_NIBBLE,
    }

    def send(counter: int, value: float) -> bytes:
        data = bytearray(length)
        data[3:5] = int(value).to_bytes(2, "little")
        if profile == "e2e-p01":
            data[1] = counter | (0xA0 if mode == "nibble" else 0)
            e2e.p01.e2e_p01_protect(data, 0x1A2B, data_id_mode=modes[mode], increment_counter=False)
        elif profile == "e2e-p02":
            data[1] = counter
            e2e.p02.e2e_p02_protect(data, bytes(LIST), increment_counter=False)
        else:
            data[2] = counter
            e2e.p05.e2e_p05_protect(data, 0x1A2B, increment_counter=False)
        return bytes(data)

    return send


@pytest.fixture(scope="module", params=["plain", "compiled"])
def codec(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    if request.param == "plain":
        return receive, transmit
    return compiled(receive), compiled(transmit)


VARIANTS = [
    ("e2e-p01", "both"),
    ("e2e-p01", "alternating"),
    ("e2e-p01", "low"),
    ("e2e-p01", "nibble"),
    ("e2e-p02", "both"),
    ("e2e-p05", "both"),
]


@pytest.mark.parametrize(("profile", "mode"), VARIANTS)
@pytest.mark.parametrize("length", [5, 8, 64])
def test_sent_frames_equal_those_of_autosar_e2e(codec: tuple[Any, Any], profile: str, mode: str, length: int):
    bus = bus_config_of(profile, sending=True, length=length, mode=mode)
    their = theirs(profile, mode, length)
    modulus = MODULI[profile]
    sent = None
    for number in range(2 * modulus + 3):
        value = (number * 977) % 65536
        sent, frames = transmitted(bus, [float(value)], sent, call=codec[1])
        assert frames.data[0, :length].tobytes() == their(number % modulus, value)


@pytest.mark.parametrize(("profile", "mode"), VARIANTS)
def test_frames_of_the_reference_package_are_accepted(codec: tuple[Any, Any], profile: str, mode: str):
    bus = bus_config_of(profile, mode=mode)
    their = theirs(profile, mode)
    modulus = MODULI[profile]
    reception, counts = nothing_received(bus, 1), NO_COUNTS
    for number in range(40):
        frame = frames_of([(0x123, their(number % modulus, 100 + number))])
        reception, counts = taken(bus, reception, counts, frame, number * CYCLE, codec[0])
    # The first shows that there is data, the second is the first of the window.
    assert counts == NO_COUNTS._replace(accepted=39, unqualified=1)
    assert reception.values[0] == 139.0


@pytest.mark.parametrize(("profile", "mode"), VARIANTS)
@CALM
@given(st.integers(0, 63), st.integers(0, 14))
def test_every_flipped_bit_is_detected(profile: str, mode: str, bit: int, counter: int):
    bus = bus_config_of(profile, mode=mode)
    payload = bytearray(theirs(profile, mode)(counter, 0x1234))
    payload[bit // 8] ^= 1 << bit % 8
    reception = nothing_received(bus, 1)
    _, counts = taken(bus, reception, NO_COUNTS, frames_of([(0x123, bytes(payload))]), 0)
    assert counts == NO_COUNTS._replace(checksum=1)


def test_a_frame_with_another_data_id_is_refused():
    bus = bus_config_of("e2e-p05")
    bus.end_to_end.data_ids[0][:] = 0x1A2C
    frame = frames_of([(0x123, theirs("e2e-p05")(0, 1))])
    _, counts = taken(bus, nothing_received(bus, 1), NO_COUNTS, frame, 0)
    assert counts.checksum == 1


# The sequence. A run is a list of counters, None for a cycle without a frame, and "x" for a broken one.

Step = int | str | None


def payload_of(their: Sender, step: int | str, value: float) -> bytes:
    payload = bytearray(their(0 if isinstance(step, str) else step, value))
    payload[7] ^= isinstance(step, str)
    return bytes(payload)


def run(bus: BusConfig, steps: list[Step], profile: str = "e2e-p01") -> tuple[list[str], list[int]]:
    """Return the cause under which each frame was counted, and the state after each step."""
    their = theirs(profile)
    reception, counts = nothing_received(bus, 1), NO_COUNTS
    causes, states = [], []
    for number, step in enumerate(steps):
        now = number * CYCLE
        reception, _ = forgotten(bus, reception, now)
        before = counts
        if step is not None:
            frame = frames_of([(0x123, payload_of(their, step, number))])
            reception, counts = taken(bus, reception, counts, frame, now)
        causes.append(cause_of(before, counts))
        states.append(int(reception.memory[0, STATE]))
    return causes, states


def cause_of(before: Counts, after: Counts) -> str:
    changed = [name for name in Counts._fields if name != "lost" and getattr(after, name) != getattr(before, name)]
    return changed[0] if changed else ""


def test_a_repeated_frame_is_refused():
    causes, _ = run(bus_config_of("e2e-p01"), [0, 1, 1, 2, 2, 3])
    assert causes == [
        "unqualified", "accepted", "counter", "accepted", "counter", "accepted",
    ]  # fmt: skip


@pytest.mark.parametrize("allowed", [1, 2, 3])
@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_max_delta_limits_the_number_of_lost_frames_that_are_tolerated(allowed: int, step: int):
    bus = bus_config_of("e2e-p05", max_delta=allowed)
    causes, _ = run(bus, [250, 251, (251 + step) % 256], "e2e-p05")
    # The step is made within one cycle, so nothing excuses it.
    assert causes[2] == ("accepted" if step <= allowed else "counter")


def test_after_a_sequence_error_counting_continues_from_the_refused_frame():
    causes, states = run(bus_config_of("e2e-p01"), [0, 1, 9, 10, 11])
    assert causes == ["unqualified", "accepted", "counter", "accepted", "accepted"]
    assert states == [INIT, VALID, INVALID, VALID, VALID]


def test_resynchronisation_takes_the_configured_number_of_frames():
    causes, _ = run(bus_config_of("e2e-p01", sync=2), [0, 1, 9, 10, 11, 12])
    assert causes == ["unqualified", "accepted", "counter", "unqualified", "unqualified", "accepted"]


def test_each_cycle_without_a_frame_tolerates_one_more_lost_frame():
    bus = bus_config_of("e2e-p01")
    assert run(bus, [0, 1, 3])[0][-1] == "counter"
    assert run(bus, [0, 1, None, 3])[0][-1] == "accepted"
    assert run(bus, [0, 1, None, 4])[0][-1] == "counter"


def test_lost_frames_are_counted():
    bus = bus_config_of("e2e-p01", max_delta=3)
    reception, counts = nothing_received(bus, 1), NO_COUNTS
    for number, counter in enumerate((13, 14, 2, 3)):
        frame = frames_of([(0x123, theirs("e2e-p01")(counter, 0))])
        reception, counts = taken(bus, reception, counts, frame, number * CYCLE)
    assert counts == NO_COUNTS._replace(accepted=3, unqualified=1, lost=2)


def test_counter_value_15_is_refused_in_profile_1():
    causes, _ = run(bus_config_of("e2e-p01"), [13, 14, 15, 0])
    assert causes == ["unqualified", "accepted", "checksum", "accepted"]


def test_after_a_time_out_the_state_machine_starts_again():
    bus = bus_config_of("e2e-p01")
    causes, states = run(bus, [0, 1, None, None, None, 7, 8])
    assert states == [INIT, VALID, VALID, VALID, NODATA, INIT, VALID]
    assert causes[-2:] == ["unqualified", "accepted"]


def reference_states(
    steps: list[str], window: int, min_ok: tuple[int, ...], max_error: tuple[int, ...]
) -> list[int]:
    """Return the states of E2E_SMCheck as specified, for steps "ok", "error" and "other"."""
    state, held, states = NODATA, [], []
    for step in steps:
        if state == NODATA:
            state = INIT if step != "error" else NODATA
        else:
            held = [*held, step][-window:]
            good, bad = held.count("ok"), held.count("error")
            passes = [bad <= e and good >= o for o, e in zip(min_ok, max_error, strict=True)]
            if state == INIT:
                state = VALID if passes[0] else INVALID if bad > max_error[0] else INIT
            elif state == VALID:
                state = VALID if passes[1] else INVALID
            else:
                state = VALID if passes[2] else INVALID
        states.append(state)
    return states


LIMITS = st.tuples(*[st.integers(0, 6)] * 3)


@CALM
@given(st.lists(st.sampled_from(["ok", "error", "other"]), max_size=25), st.integers(1, 6), LIMITS, LIMITS)
def test_the_state_machine_follows_the_specification(
    kinds: list[str], window: int, min_ok: tuple[int, int, int], max_error: tuple[int, int, int]
):
    bus = bus_config_of("e2e-p05", window=window, min_ok=min_ok, max_error=max_error)
    counter, steps, real = 0, [], []
    for number, kind in enumerate(kinds):
        if kind == "error":
            steps.append("x")
        elif kind == "other" and any(isinstance(each, int) for each in steps):
            steps.append(counter)  # a repetition
        else:
            counter = (counter + 1) % 256
            steps.append(counter)
        first = isinstance(steps[-1], int) and not any(isinstance(e, int) for e in steps[:-1])
        real.append("ok" if kind == "other" and first else kind)
        assert len(steps) == number + 1
    # All within one cycle: no time-out comes in between.
    their = theirs("e2e-p05")
    reception, counts, states = nothing_received(bus, 1), NO_COUNTS, []
    for step in steps:
        frame = frames_of([(0x123, payload_of(their, step, 0))])
        reception, counts = taken(bus, reception, counts, frame, 0)
        states.append(int(reception.memory[0, STATE]))
    assert states == reference_states(real, window, min_ok, max_error)


def test_only_the_valid_state_passes_data_on():
    limits = {"min_ok": (3, 2, 4), "max_error": (0, 1, 0)}
    bus = bus_config_of("e2e-p01", window=4, timeout_cycles=100.0, **limits)
    causes, states = run(bus, [0, 1, 2, 3, "x", "x", 4, 5, 6, 7, 8])
    assert states == [INIT, INIT, INIT, VALID, VALID, INVALID, *[INVALID] * 3, VALID, VALID]
    accepted = [number for number, cause in enumerate(causes) if cause == "accepted"]
    assert accepted == [3, 9, 10]


# The rig.

DATABASE = """VERSION ""
BS_:
BU_: ECU Gate
BO_ 256 Cmd: 8 ECU
 SG_ Crc : 0|8@1+ (1,0) [0|0] "" Gate
 SG_ Counter : 8|4@1+ (1,0) [0|0] "" Gate
 SG_ Nibble : 12|4@1+ (1,0) [0|0] "" Gate
 SG_ Duty : 16|16@1- (0.01,0) [-100|100] "%" Gate
 SG_ Long : 32|16@1+ (1,0) [0|0] "" Gate
BO_ 257 Out: 8 Gate
 SG_ Crc : 0|16@1+ (1,0) [0|0] "" ECU
 SG_ Counter : 16|8@1+ (1,0) [0|0] "" ECU
 SG_ Current : 24|16@1- (0.01,0) [0|0] "A" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 257 10;
"""

RIG = """dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
[outputs]
left_current = "Out.Current"
[messages.Cmd]
protection = "e2e-p01"
counter = "Counter"
checksum = "Crc"
data_id = 0x0107
data_id_mode = "nibble"
data_id_nibble = "Nibble"
max_delta_counter = 2
sync_counter = 1
state_machine = { window = 3, min_ok_init = 2, max_error_valid = 1 }
[messages.Out]
protection = "e2e-p05"
counter = "Counter"
checksum = "Crc"
data_id = 0xBEEF
"""


def test_a_rig_with_e2e_protection_uses_the_same_machine_code_as_the_shipped_rig(tmp_path: Path):
    theirs, shipped = (
        text_of(kind_of(loop_config(rig=rig))) for rig in (rig_of(tmp_path, DATABASE, RIG), rig_from("liftgate"))
    )
    assert theirs == shipped


def test_a_rig_protects_sent_and_received_frames(tmp_path: Path):
    rig = rig_of(tmp_path, DATABASE, RIG)
    config = loop_config(rig=rig)
    state = start_of(config, latched=False)
    replies = []
    for number in range(60):
        rows = []
        if number % 10 == 0:
            data = bytearray(8)
            data[1] = number // 10 | 0x10
            data[2:4] = (5000).to_bytes(2, "little")
            e2e.p01.e2e_p01_protect(
                data, 0x0107, data_id_mode=e2e.p01.E2E_P01_DATAID_NIBBLE, increment_counter=False
            )
            rows = [(0x100, bytes(data))]
        state, frames, _, _ = tick(config, state, frames_of(rows), outside())
        replies += [frames.data[row, :8].tobytes() for row in range(frames.count)]
    assert state.counts == NO_COUNTS._replace(accepted=4, unqualified=2)
    assert state.plant.left.current > 0.5
    assert len(replies) == 6
    assert all(e2e.p05.e2e_p05_check(reply, 0xBEEF) for reply in replies)
    assert [reply[2] for reply in replies] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"e2e-p01"', '"e2e-p7"', "protection.*e2e-p7.*simple, e2e-p01"),
        ("data_id = 0x0107", "data_id = 70000", r"data_id: 70000; allowed: .*0 to 65535"),
        ("data_id = 0x0107", "", "data_id: .*allowed"),
        ("data_id = 0x0107", "data_id_list = [1]", "data_id_list: e2e-p01 has none"),
        ('"nibble"', '"odd"', "data_id_mode"),
        ('"nibble"', '"low"', "data_id_nibble: allowed"),
        ('data_id_nibble = "Nibble"', 'data_id_nibble = "Long"', "Long: allowed: .*4 bits"),
        ('counter = "Counter"\nchecksum = "Crc"\ndata_id = 0x', 'checksum = "Crc"\ndata_id = 0x',
         "counter: missing"),
        ('checksum = "Crc"\ndata_id = 0x0', 'checksum = "Long"\ndata_id = 0x0', "fills one byte"),
        ("window = 3", "window = 33", "window: 33; allowed: .*1 to 32"),
        ("window = 3", "window = true", "window"),
        ("min_ok_init = 2", "min_ok_init = 4", "min_ok_init: 4; allowed: .*0 to 3"),
        ("min_ok_init = 2", "min_okay = 2", "min_okay"),
        ("max_delta_counter = 2", "max_delta_counter = 15", "max_delta_counter: 15"),
        ('data_id = 0xBEEF', 'data_id = 1\nchecksum_kind = "xor8"', "checksum_kind: e2e-p05 has"),
        ('"e2e-p05"', '"e2e-p02"', r"data_id_list: .*16 whole numbers"),
        ('"e2e-p05"', '"simple"', "data_id: allowed with protection"),
    ],
)  # fmt: skip
def test_an_invalid_profile_is_reported(tmp_path: Path, old: str, new: str, said: str):
    assert old in RIG
    with pytest.raises(ConfigError, match=said):
        rig_of(tmp_path, DATABASE, RIG.replace(old, new, 1))
