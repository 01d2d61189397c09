"""Frames of a log that are wanted: by lines at once or one by one, in blocks of any size, with the silences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hil_support import CALM, shipped_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.formats import bus_log, candump_file
from liftgate_hil.measurement.log_frames import LogFrames, read_frames

NAMES = ["Gate", "LeftDrive"]  # 0x220, 0x210
LINES = st.builds(
    "({:.6f}) can0 {}{}{}".format,
    st.integers(0, 2_000_000_000_000_000).map(lambda us: us / 1e6),
    st.sampled_from(["220#", "210#", "2A1#", "00000220#", "20000080#", "220##0", "220##1"]),
    st.one_of(st.binary(max_size=8).map(lambda data: data.hex().upper()), st.just("11ab")),
    st.sampled_from(["", " R", " T"]),
)
OTHERS = st.sampled_from(
    ["(1.500000) can0 220#R", "(1.500000) can0 220#R8 R", "(3.000000) can0 210#R T", "rubbish", ""]
)


def same(one: LogFrames, other: LogFrames) -> None:
    assert one.times_ns.tolist() == other.times_ns.tolist()
    assert (one.notes, one.span, one.silences) == (other.notes, other.span, other.silences)
    for a, b in zip(one.frames, other.frames, strict=True):
        np.testing.assert_array_equal(a, b)


@settings(CALM, max_examples=40)
@given(
    lines=st.lists(st.one_of(LINES, OTHERS), max_size=20), end=st.sampled_from(["\n", "\r\n", "\n(1.0) can0 22"])
)
def test_lines_read_at_once_are_those_read_one_by_one(
    lines: list[str], end: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "lines.log"  # the same one each time: folders take longer
    path.write_bytes("".join(f"{line}\n" for line in lines)[:-1].encode() + end.encode() if lines else b"")
    at_once = read_frames(path, NAMES, shipped_rig())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(candump_file, "_at_once", lambda *_: None)
        same(at_once, read_frames(path, NAMES, shipped_rig()))


def test_a_block_may_end_within_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "m.log"
    path.write_text("".join(f"({0.2 * k:.6f}) can0 220#{k:02X}00000000 T\n" for k in range(50)))
    whole = read_frames(path, NAMES, shipped_rig())
    assert whole.frames.count == 50
    assert whole.silences[0] == (0.0, 0.2)
    assert len(whole.silences) == 49
    monkeypatch.setattr(bus_log, "_FIRST_BYTES", 37)
    monkeypatch.setattr(bus_log, "_BLOCK_BYTES", 41)
    same(read_frames(path, NAMES, shipped_rig()), whole)


@pytest.mark.parametrize(("benches", "notes"), [(1, 0), (2, 1)])
def test_two_benches_under_the_name_of_one_bus_are_noted(tmp_path: Path, benches: int, notes: int) -> None:
    rig, path = shipped_rig(), tmp_path / "m.log"
    cycle = 1e-3 * rig.cycle_ms("Gate")
    lines = [f"({cycle * k:.6f}) can0 220#{k % 16:02X}00000000 T\n" * benches for k in range(50)]
    path.write_text("".join(lines))
    said = [note for note in read_frames(path, NAMES, rig).notes if "times as often" in note]
    assert len(said) == notes
    assert all(note.startswith("Gate comes ") and "two benches" in note for note in said)
