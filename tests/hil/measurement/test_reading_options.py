"""Options of reading (bus, time zone) apply to tables that are read as measurements, too."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

import liftgate_hil as lh
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.recording import AS_IT_IS
from liftgate_hil.measurement.table import read_measurement
from liftgate_hil.plan.setup import rig_from


def test_a_bus_that_is_not_in_a_file_with_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mf4"
    lh.run("demo", duration=0.1, record=path)
    for name, is_there in (("can0", True), ("can7", False)):
        how = dataclasses.replace(AS_IT_IS, channel=name)
        if is_there:
            assert read_measurement(path, {}, rig_from("liftgate"), how=how)
        else:
            with pytest.raises(ConfigError, match=r"`recording_channel` can7: not in .*; allowed: can0"):
                read_measurement(path, {}, rig_from("liftgate"), how=how)
