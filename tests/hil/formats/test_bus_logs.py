"""Bus logs of vehicles and other tools: each line or object is read as a frame, or reported."""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, REMOTE, no_logged
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.rig_table import mapped_messages
from liftgate_hil.conversion.convert import convert
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.bus_log import BUS_ERROR
from liftgate_hil.formats.open import open_file, open_recording
from liftgate_hil.formats.recording import ReadOptions, Recording, read_options
from liftgate_hil.testing.tested import judge


class Read(NamedTuple):
    """A frame read from a log; its payload in hexadecimal, or R and the length of a remote frame."""

    time_s: float
    identifier: int
    payload: str
    is_sent: bool


def frames_in(log: Recording) -> list[Read]:
    """Return all frames of a log, with times rounded to 1 µs."""
    found = []
    for row in np.concatenate([no_logged(), *log.frames()]):
        is_remote = row["identifier"] & REMOTE
        payload = f"R{row['length']}" if is_remote else bytes(row["payload"][: row["length"]]).hex()
        found.append(Read(round(row["time_ns"] / 1e9, 6), int(row["identifier"]), payload, bool(row["is_sent"])))
    return found


def written(path: Path, *lines: str, end: str = "\n") -> Path:
    path.write_text("\n".join(lines) + end, encoding="utf-8")
    return path


def read(path: Path, *lines: str, how: ReadOptions | None = None) -> tuple[list[Read], tuple[str, ...]]:
    """Return the frames read from a text, and the notes of the reader."""
    log = open_file(written(path, *lines), how=how or ReadOptions())
    return frames_in(log), log.notes


def refusal(path: Path, *lines: str) -> str:
    """Return the single issue with which a log of these lines is refused."""
    written(path, *lines)
    with pytest.raises(ConfigError) as caught:
        list(open_recording(path).frames())
    (issue,) = caught.value.issues
    return issue


@pytest.fixture
def zone(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return a function that sets this computer's time zone."""

    def as_of(name: str) -> None:
        monkeypatch.setenv("TZ", name)
        time.tzset()

    yield as_of
    monkeypatch.undo()
    time.tzset()


# What python-can's writers write is read as python-can's readers read it.


@st.composite
def messages(draw: st.DrawFn, can_fd: bool = True) -> can.Message:
    is_fd = can_fd and draw(st.booleans())
    is_remote = not is_fd and draw(st.booleans())
    is_extended = draw(st.booleans())
    length = draw(st.sampled_from(LENGTHS)) if is_fd else draw(st.integers(0, 8))
    return can.Message(
        timestamp=1_759_122_000.0 + draw(st.integers(0, 10**6)) / 1e6,
        arbitration_id=draw(st.integers(0, (1 << (29 if is_extended else 11)) - 1)),
        is_extended_id=is_extended,
        is_remote_frame=is_remote,
        is_fd=is_fd,
        bitrate_switch=is_fd and draw(st.booleans()),
        error_state_indicator=is_fd and draw(st.booleans()),
        dlc=length,
        data=None if is_remote else draw(st.binary(min_size=length, max_size=length)),
        is_rx=draw(st.booleans()),
        channel=0,
        check=True,
    )


def as_read(message: can.Message) -> tuple[int, str, bool]:
    """Return identifier with flags, payload (as in Read) and whether it was sent, of a message."""
    identifier = message.arbitration_id
    for is_so, flag in (
        (message.is_extended_id, EXTENDED), (message.is_remote_frame, REMOTE), (message.is_fd, FD),
        (message.bitrate_switch, BRS), (message.error_state_indicator, ESI),
    ):  # fmt: skip
        identifier |= flag if is_so else 0
    payload = f"R{message.dlc}" if message.is_remote_frame else bytes(message.data).hex()
    return identifier, payload, not message.is_rx


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log", ".trc"])
def test_logs_written_by_python_can_are_read_to_the_last_bit(
    suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"python-can{suffix}"
    kinds = messages(can_fd=suffix != ".trc")

    @settings(CALM, max_examples=30)
    @given(st.lists(kinds, min_size=1, max_size=30))
    def check(sent: list[can.Message]) -> None:
        if suffix == ".log":  # python-can's writer leaves out the length of a remote frame
            for each in sent:
                each.dlc = 0 if each.is_remote_frame else each.dlc
        if suffix == ".trc":  # and there remote frames
            sent = [each for each in sent if not each.is_remote_frame] or [can.Message(timestamp=1.0, channel=0)]
        sent.sort(key=lambda each: each.timestamp)  # its ASC has the wall clock of what is earlier than the first
        with can.Logger(path) as logger:
            for each in sent:
                logger.on_message_received(each)
        log = open_file(path)
        assert [each[1:] for each in frames_in(log)] == [as_read(each) for each in sent]
        assert log.notes == ()

    check()


TEXTS = {
    ".asc": (
        ["date Mon Sep 29 13:00:00.000 2025", "base hex  timestamps absolute", "no internal events logged"],
        "{:.6f} 1  {:X}  Rx   d 2 01 0{:X}",
    ),
    ".trc": ([";$FILEVERSION=2.0", ";$COLUMNS=N,O,T,I,d,l,D"], "7 {:.3f} DT {:04X} Rx 2 01 0{:X}"),
    ".log": ([], "({:.6f}) can0 {:03X}#010{:X}"),
}
STRANGE = st.text(st.characters(codec="utf-8", exclude_characters="\n\r\0"), min_size=1, max_size=30).map(
    lambda text: "!" + text
)


@pytest.mark.parametrize("suffix", TEXTS)
def test_undefined_lines_are_counted_and_all_others_are_read(
    suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"strange{suffix}"
    head, form = TEXTS[suffix]

    @settings(CALM, max_examples=40)
    @given(st.lists(st.one_of(st.none(), STRANGE), min_size=1, max_size=40))
    def check(replaced: list[str | None]) -> None:
        lines = [text or form.format(0.01 * k, 0x100 + k, k % 16) for k, text in enumerate(replaced)]
        found, notes = read(path, *head, *lines)
        assert [each.identifier for each in found] == [0x100 + k for k, text in enumerate(replaced) if not text]
        count = sum(text is not None for text in replaced)
        first = 1 + len(head) + next((k for k, text in enumerate(replaced) if text), 0)
        assert len(notes) == (count > 0)
        for note in notes:
            assert note.startswith(
                f"{count} line{'s' * (count > 1)} left out (not understood), the first in line "
            )
            assert f"line {first}: " in note

    check()


@pytest.mark.parametrize("suffix", TEXTS)
def test_a_last_line_without_a_line_end_is_read_only_if_it_is_complete(tmp_path: Path, suffix: str) -> None:
    head, form = TEXTS[suffix]
    lines = [form.format(0.01 * k, 0x100, k) for k in range(3)]
    path = written(tmp_path / f"m{suffix}", *head, *lines, end="")
    assert len(frames_in(open_file(path))) == 3
    path.write_text(path.read_text(encoding="utf-8")[:-1], encoding="utf-8")
    log = open_file(path)
    if suffix == ".asc":  # whose last byte could be 0, with a digit
        assert len(frames_in(log)) == 3
    else:
        assert len(frames_in(log)) == 2
        (note,) = log.notes
        assert "truncated" in note


# ASC.

HEAD = ("date Mon Sep 29 01:00:00.000 pm 2025", "base hex  timestamps absolute", "no internal events logged")


def test_relative_timestamps_of_asc_are_accumulated(tmp_path: Path) -> None:
    found, _ = read(
        tmp_path / "m.asc", HEAD[0], "base hex  timestamps relative", HEAD[2],
        "0.010000 1 123 Rx d 1 01", "0.500000 Start of measurement", "0.003000 1 123 Rx d 1 02",
    )  # fmt: skip
    assert [each.time_s for each in found] == [0.01, 0.513]


def test_entries_of_asc_other_than_frames_are_known_or_reported_by_kind(tmp_path: Path) -> None:
    found, notes = read(
        tmp_path / "m.asc", *HEAD, "Begin Triggerblock Mon Sep 29 01:00:00.000 pm 2025",
        "   0.000000 Start of measurement", "0.000000 CANFD Start of measurement",
        "-0.500000 1  120             rx   d 2 01 00 Length = 246000 BitCount = 125 ID = 288",
        "0.010000 1  120             TxRq d 2 01 00", "0.010240 1  18FF0120x Tx   D 9 01 02 03 04 05 06 07 08",
        "0.02 1 ErrorFrame ECC: 10100010", "0.03 canfd   1 Rx ErrorFrame 0 0",
        "0.04 1 Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%", "0.05 CAN 1 Status:chip status error active",
        "0.06 1 EngineData Rx d 1 00", "0.07 J1939TP FEE3p 6 0 0 - Rx d 2 01 02", "0.08 Li 30 Rx 2 01 02",
        "0.09 CANXL 1 Rx 120 0", "0.10 Fr RMSG 0 0", "0.11 ETH 1 Rx 3c:0", "// a remark", "End TriggerBlock",
        "0.12 1 J1939TP FEE3p 6 0 0 - Rx d 2 01 02", "0.13 AFDX 1 Tx 1 64", "0.14 GPS-Device: 1 La: 48.8 Lo: 9.0",
        "0.15 COM2 Rx 10400 1 83", "0.16 Comment: 105 a door", "0.17 0 16777215 0 1 GMGroup: G GMMarker: [1]",
        "0.18 canfd 1 Tx ErrorFrame Not Acknowledge error", "0.19 1 120 Rx r 4",
    )  # fmt: skip
    error = ERROR | BUS_ERROR
    assert found[0] == Read(-0.5, 0x120, "0100", False)
    assert found[1] == Read(0.01024, 0x18FF0120 | EXTENDED, "0102030405060708", True)
    assert (found[2].identifier, found[-1][1:3]) == (error, (0x120 | REMOTE, "R4"))
    assert [each.is_sent for each in found if each.identifier == error] == [False, False, True]
    told = "\n".join(notes)
    for kind in (
        "TxRq", "1 line left out (a message's name", "2 J1939", "LIN", "CAN XL", "FlexRay", "Ethernet", "AFDX",
        "GPS", "serial line event",
    ):  # fmt: skip
        assert kind in told, kind
    assert "not understood" not in told


@pytest.mark.parametrize(
    "line",
    [
        "0.02 1 120 foo d 1 01", "0.02 1 120 Rx x 1 01", "0.02 1 800 Rx d 1 01", "0.02 1 120 Rx d g 01",
        "0.02 canfd 1", f"{'9' * 20}.0 1 120 Rx d 1 01", f"{'9' * 400} 1 120 Rx d 1 01", "0.02",
        "0.02 CANFD 1 foo ErrorFrame",
    ],
)  # fmt: skip
def test_an_undefined_line_of_asc_is_counted_and_the_others_are_read(tmp_path: Path, line: str) -> None:
    found, notes = read(tmp_path / "m.asc", *HEAD, "0.01 1 120 Rx d 1 01", line, "0.03 1 120 Rx d 1 03")
    assert [each.payload for each in found] == ["01", "03"]
    (note,) = notes
    assert note.startswith("1 line left out (not understood), the first in line 5: ")


def test_a_log_of_two_buses_needs_the_choice_of_one(tmp_path: Path) -> None:
    lines = ["0.01 1 120 Rx d 1 00", "0.02 2 120 Rx d 1 01", "0.03 CANFD 2 Rx 121 1 0 9 12 " + "01 " * 12]
    path = tmp_path / "m.asc"
    assert refusal(path, *HEAD, *lines) == (
        f"{path}: frames of 2 buses, can0 and can1; allowed: one, by `recording_channel`"
    )
    found, notes = read(path, *HEAD, *lines, how=read_options("can1"))
    assert [(each.time_s, each.identifier) for each in found] == [(0.02, 0x120), (0.03, 0x121 | FD | BRS)]
    assert notes == ("1 frame left out (of another bus than can1), the first in can0",)
    with pytest.raises(ConfigError, match=r"`recording_channel` can7: not in .*; allowed: can0, can1"):
        read(path, *HEAD, *lines, how=read_options("can7"))


def test_canfd_lines_may_have_message_names_and_further_numbers(tmp_path: Path) -> None:
    data = " ".join(f"{k:02x}" for k in range(12))
    tail = "102203 130 303000 c8a4f2f9 46500250 4b140250 20012507 2001040d"
    found, notes = read(
        tmp_path / "m.asc", *HEAD,
        f"30.000100 CANFD   1 Rx        11  EngineDataFD   1 1 9 12 {data} {tail.replace('303000', '7000')}",
        f"30.000200 CANFD   1 Tx   1234567x                1 0 9 12 {data} {tail}",
        "30.000300 CANFD   1 Rx        12                 0 0 2  2 01 02 102203 130 200040 0 0 0 0 0",
        "30.000400 CANFD   1 Rx        13                 0 0 4  0 102203 130 10 0 0 0 0 0",
        "30.000500 CANFD   1 Rx        14                 0 0 0  0 102203 130 1000 0 0 0 0 0",
    )  # fmt: skip
    assert [each.identifier for each in found] == [
        0x11 | FD | BRS | ESI, 0x1234567 | EXTENDED | FD | BRS, 0x12, 0x13 | REMOTE, 0x14 | FD,
    ]  # fmt: skip
    assert notes == ()


# Local time, in all three formats alike.


@pytest.mark.parametrize(
    "stated",
    [
        "Mon Sep 29 01:00:00.000 pm 2025", "Mon Sep 29 13:00:00.000 2025", "Mon Sep 29 13:00:00 2025",
        "Mo Sep 29 13:00:00.0 2025", "Mon Sep 29 01:00:00 PM 2025", "2025-09-29 13:00:00",
    ],
)  # fmt: skip
def test_header_times_are_local_time(tmp_path: Path, zone: Any, stated: str) -> None:
    zone("Asia/Shanghai")
    path = written(tmp_path / "m.asc", *HEAD, f"Begin Triggerblock {stated}", "0.01 1 120 Rx d 1 00")
    assert open_file(path).start_ns == 1_759_122_000 * 10**9
    assert open_file(path, how=read_options(timezone="UTC")).start_ns == (1_759_122_000 + 8 * 3600) * 10**9


def test_an_unknown_date_format_is_noted_and_gives_no_wall_clock(tmp_path: Path) -> None:
    path = written(tmp_path / "m.asc", *HEAD, "Begin Triggerblock lun. 29 sept. 2025", "0.01 1 120 Rx d 1 00")
    log = open_file(path)
    assert log.start_ns == 0
    assert log.notes == ("its date 'lun. 29 sept. 2025' is not understood: no wall clock applies",)


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc"])
def test_written_headers_have_local_time_and_are_read_as_such(tmp_path: Path, zone: Any, suffix: str) -> None:
    zone("America/New_York")
    source = written(tmp_path / "m.log", "(1759122000.123000) can0 120#00")
    convert(source, tmp_path / f"m{suffix}")
    assert open_file(tmp_path / f"m{suffix}").start_ns == 1_759_122_000_123_000_000
    text = (tmp_path / f"m{suffix}").read_bytes()
    if suffix == ".asc":
        assert b"Begin Triggerblock Mon Sep 29 01:00:00.123 2025" in text
    elif suffix == ".trc":
        assert b"Start time: 2025-09-29 01:00:00.123" in text
    else:
        assert struct.unpack_from("<8H", text, 40) == (2025, 9, 1, 29, 1, 0, 0, 123)


# TRC.


def test_every_version_of_trc_is_read(tmp_path: Path) -> None:
    head = (";$STARTTIME=45929.5",)
    first = Read(0.0171, 0x300, "0001", False)
    for version, lines, count in (
        ("1.0", ["1)      17  0300  2  00 01", "2) 18 18FF0102 8 RTR", "3) 19 0008 4 ERROR 00 19 08 08",
                 "4) 20 FFFFFFFF 4 00 00 00 04 BUSLIGHT"], 3),
        ("1.1", ["1)      17.1  Rx  0300  2  00 01", "2) 18.0 Tx 18FF0102 8 RTR", "3) 19.0 Error 0008 4 00 19",
                 "4) 20.0 Warng FFFFFFFF 4 00 00 00 04 BUSLIGHT"], 3),
        ("1.2", ["1)      17.1 1  Rx  0300  2  00 01", "2) 18.0 1 Tx 18FF0102 8 RTR"], 2),
        ("1.3", ["1)      17.1 1  Rx  0300 -  2  00 01", "2) 18.0 1 Tx 18FF0102 - 8 RTR"], 2),
    ):  # fmt: skip
        path = tmp_path / "m.trc"
        marked = [f";$FILEVERSION={version}", *head] if version != "1.0" else []
        found, notes = read(path, *marked, *lines)
        assert found[0] == (first if version != "1.0" else first._replace(time_s=0.017)), version
        assert found[1][1:3] == (0x18FF0102 | EXTENDED | REMOTE, "R8"), version
        assert len(found) == count, version
        assert len(notes) == (len(lines) > 3), version
    found, notes = read(
        tmp_path / "m.trc", ";$FILEVERSION=2.1", ";$COLUMNS=N,O,T,B,I,d,R,L,D", *head,
        "1 17.1 DT 1 0300 Rx - 2 00 01", "2 18.0 FB 1 0301 Rx - 9 " + "00 " * 12, "3 19.0 RR 1 0302 Tx - 3",
        "4 20.0 ER 1 - Rx - 5 04 00 02 00 00", "5 21.0 ST 1 - Rx - 4 00 00 00 08", "6 22.0 EC 1 - Rx - 2 01 01",
        "7 23.0 BI 1 0303 Rx - 0",
    )  # fmt: skip
    assert [each.identifier for each in found] == [
        0x300, 0x301 | FD | BRS, 0x302 | REMOTE, ERROR | BUS_ERROR, 0x303 | FD | ESI,
    ]  # fmt: skip
    assert [note[:6] for note in notes] == ["1 line"] * 2


# BLF.


def blf(path: Path, *objects: bytes, inside: Sequence[bytes] = ()) -> Path:
    """Write a BLF file with objects outside a container, and others inside an uncompressed one."""
    body = b"".join(inside)
    held = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(body), 10, 0, len(body)) + body if inside else b""
    content = b"".join(objects) + held
    header = struct.pack("<4sL8xQQLL8H8H", b"LOGG", 144, 144 + len(content), 0, 0, 0, *[0] * 16)
    path.write_bytes(header.ljust(144, b"\0") + content)
    return path


def blf_object(kind: int, body: bytes, stamp_ns: int = 0) -> bytes:
    """Return an object of a BLF file of a type (`kind`), with its time [ns]."""
    text = struct.pack("<4sHHLLLHHq", b"LOBJ", 32, 1, 32 + len(body), kind, 2, 0, 0, stamp_ns) + body
    return text + b"\0" * (len(text) % 4)


def blf_message(number: int, flags: int = 0, stamp_ns: int = 0, channel: int = 1) -> bytes:
    """Return a CAN message of a BLF file with the identifier `number` and the payload 01 02."""
    return blf_object(1, struct.pack("<HBBL8s", channel, flags, 2, number, b"\1\2"), stamp_ns)


def test_objects_of_blf_inside_and_outside_containers_are_read_or_reported(tmp_path: Path) -> None:
    path = blf(
        tmp_path / "m.blf", blf_message(0x100, 0, -500_000_000), blf_message(0x101, 1), blf_message(0x102, 2),
        blf_object(11, b"lin"), blf_object(4, b"statistics"), blf_object(999, b"new"), blf_object(2, b"\1\0\0\0"),
        inside=[blf_message(0x103, 0x81, 10_000_000), blf_object(96, b"marker"), blf_object(1, b"short")],
    )  # fmt: skip
    log = open_file(path)
    found = frames_in(log)
    assert [each.identifier for each in found] == [0x100, 0x101, ERROR | BUS_ERROR, 0x103 | REMOTE]
    assert (found[0].time_s, found[1].is_sent, found[3].payload, found[3].is_sent) == (-0.5, True, "R2", True)
    assert log.notes == (
        "1 TxRq object left out (a request to send, which is no frame on the bus), the first in object 3",
        "1 LIN object left out (no CAN frame), the first in object 4",
        "1 object left out (of an unknown type, 999), the first in object 6",
        "1 object left out (not understood), the first in object 10",
    )


def test_an_identifier_of_blf_with_too_many_bits_is_left_out(tmp_path: Path) -> None:
    messages = [blf_message(number) for number in (0x100, 0x15555555, 0xF5555555, 0x95555555)]
    log = open_file(blf(tmp_path / "m.blf", *messages))
    assert [each.identifier for each in frames_in(log)] == [0x100, 0x15555555 | EXTENDED]
    assert log.notes == ("2 objects left out (not understood), the first in object 2",)


def test_a_damaged_blf_is_refused_and_a_truncated_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "m.blf"
    head = blf(path).read_bytes()
    packed = zlib.compress(b"".join(blf_message(number) for number in range(0x700)))
    begin = struct.pack("<4sHHLLH14x", b"LOBJ", 16, 1, 32 + len(packed), 10, 2)
    for content, said in (
        (b"LOGG", "truncated or damaged"),
        (head + begin + b"\xff" * len(packed), "truncated or damaged"),
        (head + begin[:20], "neither rows nor frames, but 1 object left out (truncated, the last one)"),
        (
            blf(path, *[blf_object(71, b"frame")] * 2).read_bytes(),
            "neither rows nor frames, but 2 Ethernet objects left",
        ),
    ):
        path.write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            open_recording(path)
        assert str(caught.value).startswith((f"{path}: cannot be read: {said}", f"{path}: {said}"))
        assert "Error -" not in str(caught.value)
    path.write_bytes(head + begin + packed[: len(packed) // 2])
    log = open_file(path)
    found = [each.identifier for each in frames_in(log)]
    assert found == list(range(len(found)))
    assert 0x300 < len(found) < 0x700
    assert "1 container left out (truncated, what is there is read), the first in the file's end" in log.notes


# candump.


def test_all_forms_of_candump_lines_are_read_or_reported(tmp_path: Path) -> None:
    path = tmp_path / "m.log"
    found, notes = read(
        path, "(1607120998.528012) can0 123#1122334455667788_B", "(1607120998.628012) can0 123##D0200 T",
        "(1607120998.728012) can0 20000004#0004000000000000", "(1607120998.738012) can0 123# 01 00",
        "(1607120998.748012) can0 123#0100 // a door", "(1607120998.758012) can0 123#0100 R the door opens",
        "(2020-12-04 22:29:58.768012) can0 1ABCDEF0#R", "(1607120998.778012) can0 123#01 ad hoc",
        "(1607120998.788012) can0 123#010", "(1607120998.798012) can0 123##0" + "00" * 9,
    )  # fmt: skip
    assert [each[1:3] for each in found[:6]] == [
        (0x123, "1122334455667788"), (0x123 | FD | BRS, "0200"), (ERROR | 4, "0004000000000000"),
        (0x123, "0100"), (0x123, "0100"), (0x123, "0100"),
    ]  # fmt: skip
    assert found[6][1:3] == (0x1ABCDEF0 | EXTENDED | REMOTE, "R0")
    assert len(found) == 7
    (note,) = notes
    assert note.startswith(
        "3 lines left out (not understood), the first in line 8: '(1607120998.778012) can0 123#01"
    )


@pytest.mark.parametrize("digits", [10, 20, 400])
@pytest.mark.parametrize("form", ["can0 123#01", "can0 123#01 a remark"])  # the second is read line by line
def test_a_candump_line_with_an_impossible_time_is_left_out(tmp_path: Path, digits: int, form: str) -> None:
    lines = ["(1.000000) can0 123#02", f"({'9' * digits}.000000) {form}", "(2.000000) can0 123#03"]
    found, notes = read(tmp_path / "m.log", *lines)
    assert [each.payload for each in found] == ["02", "03"]
    (note,) = notes
    assert note.startswith("1 line left out (not understood), the first in line 2: ")


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["  can0  123   [2]  01 00"], "candump's output on a terminal"),
        ([" (2018-12-06 09:31:30.572475)  can0  123   [2]  01 00"], "candump's output on a terminal"),
        (["(000.000000) can0 123#01", "(000.200074) can0 123#02", "(000.100074) can0 123#03"], "distances"),
        (["***BUSMASTER Ver 3.2.2***", "14:09:20:1820 Rx 1 0x123 s 2 01 00"], "BUSMASTER"),
        (["***HEX***", "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***"], "BUSMASTER"),
        (["version https://git-lfs.github.com/spec/v1", "oid sha256:00"], "Git LFS"),
    ],
)  # fmt: skip
def test_other_formats_with_the_suffix_log_are_reported(tmp_path: Path, lines: list[str], said: str) -> None:
    assert said in refusal(tmp_path / "m.log", *lines)


@pytest.mark.parametrize(
    ("name", "line", "said"),
    [
        ("m.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2", "is a log of SavvyCAN; allowed: saved by"),
        ("m.csv", "ID,Data Bytes", "is a log of SavvyCAN without times"),
        ("m.txt", "166.064000 CXX GVRET-PC Reverse Engineering Tool Output V138", "is a CRTD log"),
    ],
)
def test_bus_logs_of_other_tools_with_the_suffix_of_a_table_are_reported_by_name(
    tmp_path: Path, name: str, line: str, said: str
) -> None:
    (tmp_path / name).write_text(f"{line}\n166064000,0000021A,false,Rx,0,2,FE,36\n")
    with pytest.raises(ConfigError, match=said):
        open_file(tmp_path / name)


# Two logs of one run whose headers are in different zones.


def test_logs_that_differ_by_whole_hours_are_refused_as_of_different_time_zones(tmp_path: Path, zone: Any) -> None:
    zone("Asia/Shanghai")
    scenario = tmp_path / "s.toml"
    scenario.write_text('duration = 0.5\n[[expect]]\nname = "x"\nalways = "Gate.Angle < 90"\n', encoding="utf-8")
    for name, hour in (("one", "13"), ("other", "05")):
        lines = [f"{0.01 * k:.6f} 1 220 Rx d 6 00 00 00 00 00 00" for k in range(60)]
        written(tmp_path / f"{name}.asc", *HEAD, f"Begin Triggerblock Mon Sep 29 {hour}:00:00.000 2025", *lines)
    files = [tmp_path / "one.asc", tmp_path / "other.asc"]
    with pytest.raises(ConfigError, match=r"8 h after .*as if one header had another zone's time"):
        judge(files, scenario, rig="liftgate", one_run=True)


@pytest.mark.parametrize(
    ("attribute", "own", "expected"), [("1", "", True), ("0", "", False), ("0", "true", True)]
)
def test_can_fd_frames_have_brs_where_database_or_rig_say_so(
    tmp_path: Path, attribute: str, own: str, expected: bool
) -> None:
    (tmp_path / "fd.dbc").write_text(
        'VERSION ""\nBS_:\nBU_: ECU Gate\n'
        'BO_ 832 Cmd: 8 ECU\n SG_ Duty : 0|8@1- (1,0) [-100|100] "%" Gate\n'
        'BO_ 833 Sens: 12 Gate\n SG_ Curr : 0|16@1- (0.01,0) [-320|320] "A" ECU\n'
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD","ExtendedCAN_FD";\n'
        'BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";\nBA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\n'
        'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'
        f'BA_DEF_DEF_ "CANFD_BRS" "{attribute}";\nBA_ "VFrameFormat" BO_ 833 2;\n',
        encoding="utf-8",
    )
    brs = f"[messages.Sens]\nbrs = {own}\n" if own else ""
    (tmp_path / "rig.toml").write_text(
        'dbc = "fd.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n[outputs]\nleft_current = "Sens.Curr"\n' + brs,
        encoding="utf-8",
    )
    config = load_rig(tmp_path / "rig.toml").output_config()
    (row,) = config.messages
    assert bool(row.format & BRS) is expected
    assert row.format & FD
    shown = {each.message: each.format for each in mapped_messages(load_rig(tmp_path / "rig.toml"))}
    assert shown == {"Cmd": "classic", "Sens": "CAN FD with BRS" if expected else "CAN FD"}


def test_a_log_without_frames_is_refused_with_what_it_contains(tmp_path: Path) -> None:
    counted = "   1.000000 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%"
    said = refusal(tmp_path / "t.asc", *HEAD[:2], "// a comment", counted)
    assert "neither rows nor frames, at most comments, statistics, markers" in said


@pytest.mark.parametrize("date", ["Mon Sep 29 13:00:00.250 2025", "Mon Sep 29 01:00:00.250 pm 2025"])
def test_the_date_of_asc_is_used_where_no_trigger_block_has_one(tmp_path: Path, date: str) -> None:
    rest = "base hex timestamps absolute", "0.01 1 120 Rx d 1 00"
    path = written(tmp_path / "m.asc", f"date {date}", *rest)
    assert open_file(path, how=read_options(timezone="UTC")).start_ns == 1_759_150_800_250_000_000
    written(path, "date yesterday", *rest)
    assert open_file(path).notes == ("its date 'yesterday' is not understood: no wall clock applies",)


def test_the_start_time_of_trc_1_0_is_read_from_its_text(tmp_path: Path) -> None:
    path = tmp_path / "m.trc"
    lines = [";   Start time: {}", ";-----", "     1)      1059.9  0300  7  00 00 00 00 04 00 00", ""]
    path.write_text("\n".join(lines).format("29.09.2025 13:00:00.123.0"))
    assert open_file(path, how=read_options(timezone="UTC")).start_ns == 1_759_150_800_123_000_000
    path.write_text("\n".join(lines).format("9/29/2025 1:00:00 PM"))
    assert open_file(path).notes == ("its start '9/29/2025 1:00:00 PM' is not understood: no wall clock applies",)
