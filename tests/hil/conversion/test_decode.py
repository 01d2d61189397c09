"""Decoding of bus frames into a table, compared with cantools."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hil_support import CALM, frames_of, shipped_rig
from hypothesis import given
from hypothesis import strategies as st

import liftgate_hil as lh
from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, REMOTE, logged
from liftgate_hil.conversion.convert import convert
from liftgate_hil.conversion.decode import Decoder, seen_in
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_recording
from liftgate_hil.signals import columns_of

DBC = Path(__file__).parents[3] / "dbc" / "liftgate.dbc"


def database_of(*lines: str, number: int = 100, length: int = 64) -> Any:
    text = f'VERSION ""\nBU_: A\nBO_ {number} M: {length} A\n' + "".join(f" {x}\n" for x in lines)
    return cantools.database.load_string(text, "dbc")


def frames_at(stamps: list[int], rows: list[tuple[int, bytes]]) -> Any:
    frames = logged(frames_of(rows), 0, True)
    frames["time_ns"] = stamps
    return frames


def table_of(database: Any, *blocks: Any) -> dict[str, np.ndarray]:
    decoder = Decoder(database.messages)
    rows = np.concatenate(list(decoder.rows(blocks)))
    return dict(zip(decoder.signals, rows.T, strict=True))


@st.composite
def layouts(draw: Any) -> str:
    """Draw a signal anywhere in 64 bytes, of at most 52 bits, which a float represents exactly."""
    length = draw(st.integers(1, 52))
    first = draw(st.integers(0, 512 - length))  # the first bit, in the order of the bytes
    if draw(st.booleans()):
        place, order = first, 1
    else:
        place, order = 8 * (first // 8) + 7 - first % 8, 0
    sign = draw(st.sampled_from("+-"))
    scale = draw(st.sampled_from(["1", "0.01", "-2.5", "1e-06"]))
    offset = draw(st.sampled_from(["0", "-40", "0.1"]))
    return f'SG_ S : {place}|{length}@{order}{sign} ({scale},{offset}) [0|0] "" A'


@CALM
@given(layouts(), st.lists(st.binary(min_size=64, max_size=64), min_size=1, max_size=4))
def test_any_signal_is_decoded_as_by_cantools(layout: str, payloads: list[bytes]) -> None:
    database = database_of(layout)
    frames = frames_at(list(range(len(payloads))), [(100 | FD, each) for each in payloads])
    expected = [database.decode_message(100, each)["S"] for each in payloads]
    assert table_of(database, frames)["M.S"].tolist() == expected


@pytest.mark.parametrize(("bits", "kind"), [(32, "<f4"), (64, "<f8")])
def test_a_float_is_decoded(bits: int, kind: str) -> None:
    database = database_of(f'SG_ S : 8|{bits}@1- (2,1) [0|0] "" A', f"SIG_VALTYPE_ 100 S : {bits // 32};")
    payload = b"\0" + np.array([-0.15625], dtype=kind).tobytes()
    database.messages[0].signals[0].conversion.is_float = True
    frames = frames_at([0], [(100 | FD, payload.ljust(64, b"\0"))])
    assert table_of(database, frames)["M.S"].tolist() == [0.6875]


def test_a_signal_is_held_until_its_next_frame() -> None:
    database = database_of(
        'SG_ S : 0|8@1+ (1,0) [0|0] "" A', "", 'BO_ 101 N: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] "" A'
    )
    first = frames_at([5, 5, 7], [(100, b"\1" * 8), (101, b"\2" * 8), (100, b"\3" * 8)])
    second = frames_at([7, 9], [(101, b"\4" * 8), (101, b"\5" * 8)])
    table = table_of(database, first, second)
    assert table["time_s"].tolist() == [5e-9, 7e-9, 9e-9]  # what has one time is one row
    assert table["M.S"].tolist() == [1.0, 3.0, 3.0]
    assert table["N.T"].tolist() == [2.0, 4.0, 5.0]


BYTE = '8@1+ (1,0) [0|0] "" A'


@pytest.mark.parametrize(
    ("signals", "payloads", "expected"),
    [
        (  # a frame that is too short says nothing of the second
            (f"SG_ S : 0|{BYTE}", f"SG_ T : 8|{BYTE}"),
            (b"\1", b"\2\3", b"\4"),
            {"M.S": [1.0, 2.0, 4.0], "M.T": [math.nan, 3.0, 3.0]},
        ),
        (  # multiplexed
            ('SG_ Page M : 0|4@1+ (1,0) [0|0] "" A', f"SG_ One m1 : 8|{BYTE}", f"SG_ Two m2 : 8|{BYTE}"),
            (b"\1\7", b"\2\x08", b"\3\x09"),
            {"M.Page": [1.0, 2.0, 3.0], "M.One": [7.0, 7.0, 7.0], "M.Two": [math.nan, 8.0, 8.0]},
        ),
    ],
)
def test_a_signal_has_no_value_before_its_first_frame(
    signals: tuple[str, ...], payloads: tuple[bytes, ...], expected: dict[str, list[float]]
) -> None:
    table = table_of(database_of(*signals), frames_at([1, 2, 3], [(100, each) for each in payloads]))
    for name, values in expected.items():
        np.testing.assert_array_equal(table[name], values)


def test_foreign_remote_and_error_frames_are_not_decoded() -> None:
    database = database_of('SG_ S : 0|8@1+ (1,0) [0|0] "" A')
    rows = [(100 | EXTENDED, b"\1"), (100 | REMOTE, b""), (100 | ERROR, b"\1"), (99, b"\1")]
    frames = frames_at([1, 2, 3, 4], rows)
    assert list(Decoder(database.messages).rows([frames])) == []
    assert seen_in([frames], {"M": database.messages[0]}) == []
    ours = frames_at([1], [(100 | FD, b"\1")])
    assert seen_in([frames, ours], {"M": database.messages[0]}) == database.messages


def test_frames_logged_out_of_order_are_sorted_by_time() -> None:
    database = database_of('SG_ S : 0|8@1+ (1,0) [0|0] "" A')
    second = 1_000_000_000
    stamps = [0, 2 * second, 25 * second, 24 * second, 26 * second, 26 * second, 17 * second]
    blocks = [frames_at([stamp], [(100, bytes([k]))]) for k, stamp in enumerate(stamps)]
    for table in (table_of(database, *blocks), table_of(database, np.concatenate(blocks))):
        assert table["time_s"].tolist() == [0.0, 2.0, 17.0, 24.0, 25.0, 26.0]
        assert table["M.S"].tolist() == [0.0, 1.0, 6.0, 3.0, 2.0, 5.0]


def test_frames_more_than_10_s_out_of_order_are_refused() -> None:
    database = database_of('SG_ S : 0|8@1+ (1,0) [0|0] "" A')
    stamps = [5_000_000_000, 20_000_000_000, 4_000_000_000]
    frames = [frames_at([each], [(100, b"\1")]) for each in stamps]
    with pytest.raises(ConfigError, match=r"the frame at 4\.000000 s comes more than 10 s after a later one"):
        table_of(database, *frames)


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_the_bus_log_of_a_run_is_decoded_as_by_cantools(tmp_path: Path) -> None:
    lh.run("demo", duration=1.5, record=[tmp_path / "run.log"])
    done = convert(tmp_path / "run.log", tmp_path / "out.csv", str(DBC))
    (note,) = done.notes  # none on the frames, which are in the table
    assert note.startswith("units omitted (DriveCommand.LeftDuty: %, ")
    assert note.endswith("): .csv holds names only; allowed: .parquet, .mf4, .mcap")
    database = cantools.database.load_file(DBC)
    expected: dict[float, dict[str, float]] = {}
    held: dict[str, float] = {}
    for line in (tmp_path / "run.log").read_text().splitlines():
        stamp, _, frame, _ = line.split()
        number, _, payload = frame.partition("#")
        message = database.get_message_by_frame_id(int(number, 16))
        values = message.decode(bytes.fromhex(payload), decode_choices=False)
        held |= {f"{message.name}.{name}": value for name, value in values.items()}
        expected[float(stamp.strip("()"))] = dict(held)
    found = open_recording(tmp_path / "out.csv")
    rows = np.concatenate(list(found.rows(list(found.signals))))
    assert rows[:, 0].tolist() == list(expected)
    for row, values in zip(rows, expected.values(), strict=True):
        told = {name: x for name, x in zip(found.signals, row, strict=True) if not math.isnan(x)}
        told.pop("time_s")
        assert told == values


@pytest.mark.filterwarnings("ignore")
def test_a_rig_may_be_named_in_place_of_a_database(tmp_path: Path) -> None:
    lh.run("demo", duration=0.2, record=[tmp_path / "run.mf4"])
    done = convert(tmp_path / "run.mf4", tmp_path / "out.mcap", "liftgate")
    said = f"{len(columns_of(2))} columns omitted: with --rig the table holds the bus signals instead"
    assert done.notes == (said,)
    assert done.frames > 100
    found = open_recording(tmp_path / "out.mcap")
    assert "LeftDrive.MotorCurrent" in found.signals
    assert found.signals["LeftDrive.MotorCurrent"].unit == "A"
    assert {name.partition(".")[0] for name in found.signals} < {"time_s", *shipped_rig().messages}


def test_a_nan_in_a_float_signal_is_decoded_as_nan() -> None:
    database = database_of('SG_ S : 0|32@1- (1,0) [0|0] "" A', length=8)
    database.messages[0].signals[0].is_float = True
    sent = [np.float32(value).tobytes() + bytes(4) for value in (1.5, math.nan, 7.5)]
    found = table_of(database, frames_at([1, 2, 3], [(100, each) for each in sent]))["M.S"]
    assert np.array_equal(found, [1.5, math.nan, 7.5], equal_nan=True)


@pytest.mark.parametrize("sign", "+-")
def test_a_signal_of_more_than_64_bits_has_the_value_that_cantools_decodes(sign: str) -> None:
    database = database_of(f'SG_ S : 0|136@1{sign} (1,0) [0|0] "" A', length=32)
    data = bytes(range(200, 217)) + bytes(15)
    wanted = database.decode_message("M", data)["S"]
    found = table_of(database, frames_at([1], [(100 | FD, data)]))["M.S"]
    assert found[0] == pytest.approx(float(wanted), rel=1e-12)
