"""Candump's text by lines: what python-can makes of it, faster; what only python-can knows is left to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import CALM, shipped_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement import log_frames
from liftgate_hil.measurement.log_frames import LogFrames, read_frames

NAMES = ["Gate", "LeftDrive"]  # 0x220, 0x210
LINES = st.builds(
    "({:.6f}) {} {}{}{}".format,
    st.integers(0, 2_000_000_000_000_000).map(lambda us: us / 1e6),
    st.sampled_from(["can0", "vcan1", "any"]),
    st.sampled_from(["220#", "210#", "2A1#", "00000220#", "20000080#", "220##0", "220##1"]),
    st.one_of(st.binary(max_size=8).map(lambda data: data.hex().upper()), st.just("11ab")),
    st.sampled_from(["", " R", " T"]),
)
OTHERS = st.sampled_from(["(1.500000) can0 220#R", "(1.500000) can0 220#R8 R", "(3.000000) can0 210#R T"])


def same(one: LogFrames, other: LogFrames) -> None:
    assert one.times.tolist() == other.times.tolist()
    assert (one.notes, one.span) == (other.notes, other.span)
    for a, b in zip(one.frames, other.frames, strict=True):
        np.testing.assert_array_equal(a, b)


@settings(CALM, max_examples=40)
@given(
    lines=st.lists(st.one_of(LINES, OTHERS), max_size=20), end=st.sampled_from(["\n", "\r\n", "\n(1.0) can0 22"])
)
def test_lines_are_what_python_can_makes_of_them(
    lines: list[str], end: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "lines.log"  # the same one each time: folders take longer
    path.write_bytes("".join(f"{line}\n" for line in lines)[:-1].encode() + end.encode() if lines else b"")
    read: Any = log_frames._by_lines
    by_lines = read_frames(path, NAMES, shipped_rig())
    assert read(path, ()) is not None
    try:
        log_frames._by_lines = lambda *_: None
        same(by_lines, read_frames(path, NAMES, shipped_rig()))
    finally:
        log_frames._by_lines = read


def test_a_block_may_end_within_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "m.log"
    path.write_text("".join(f"({0.01 * k:.6f}) can0 220#{k:02X}00000000 T\n" for k in range(50)))
    whole = read_frames(path, NAMES, shipped_rig())
    assert whole.frames.count == 50
    monkeypatch.setattr(log_frames, "_BLOCK", 37)
    same(read_frames(path, NAMES, shipped_rig()), whole)


@pytest.mark.parametrize("line", ["0.1 can0 220#00", "(0.1) can0 220#" + "00" * 65, "rubbish"])
def test_what_is_no_line_of_candump_is_reported(tmp_path: Path, line: str) -> None:
    path = tmp_path / "m.log"
    path.write_text(f"(0.000000) can0 220#00\n{line}\n(0.200000) can0 220#00\n")
    with pytest.raises(ConfigError, match=r"m\.log: cannot be read"):
        read_frames(path, NAMES, shipped_rig())
