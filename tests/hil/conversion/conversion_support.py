"""Helpers shared by the tests of comparisons and pictures of recordings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from hil_support import frames_of

from liftgate_hil.codec.frames import logged
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.signals import columns_of

HEAD = "time_s,left_current_a,gate_angle_deg\n"
ROWS = [(0.001 * k, math.sin(k / 30.0), 0.5 * k) for k in range(100)]
FRAMES = [(0x100 + k % 3, bytes([k])) for k in range(50)]
STAMPS = [0.01 * k + 0.5 for k in range(50)]


def table(path: Path, rows: list[tuple[float, ...]], head: str = HEAD) -> Path:
    path.write_text(head + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    return path


def log(path: Path, rows: list[tuple[int, bytes]], stamps: list[float], epoch_ns: int = 0) -> Path:
    frames = logged(frames_of(rows), 0, True)
    frames["time_ns"] = np.round(np.array(stamps) * 1e9)
    recorder = open_writer(path, Content(columns_of(2), "can0"))
    recorder.begin(epoch_ns)
    recorder.write_frames(frames)
    recorder.close()
    return path
