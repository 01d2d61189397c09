"""Recordings read by other tools: every frame with its direction, and every signal."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

import liftgate_hil as lh

pytest.importorskip("asammdf")
pytest.importorskip("mcap")

DBC = Path(__file__).parents[2] / "dbc" / "liftgate.dbc"
SCENARIO = """
duration = 2.0
initial = 40
[[request]]
time = 0.1
action = "close"
[[obstacle]]
angle_deg = 35
"""
SUFFIXES = ("log", "asc", "blf", "trc", "mf4", "mcap", "csv")

Frame = tuple[float, int, bool, bytes]  # time, identifier, whether the gate sent it, payload


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the recordings of one run."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "s.toml").write_text(SCENARIO)
    lh.run(folder / "s.toml", record=[folder / f"run.{each}" for each in SUFFIXES])
    return folder


@pytest.fixture(scope="module")
def table(run: Path) -> dict[str, np.ndarray]:
    found = np.genfromtxt(run / "run.csv", delimiter=",", names=True)
    return {name: found[name] for name in found.dtype.names}


@pytest.fixture(scope="module")
def frames(run: Path) -> list[Frame]:
    """Frames of candump's text, parsed independently."""
    result = []
    for line in (run / "run.log").read_text().splitlines():
        stamp, _, frame, way = line.split()
        identifier, _, payload = frame.partition("#")
        number = int(identifier, 16)
        result.append((float(stamp.strip("()")), number, way == "T", bytes.fromhex(payload)))
    assert {number for _, number, is_sent, _ in result if not is_sent} == {0x120}
    assert {0x210, 0x211, 0x220, 0x230} < {number for _, number, is_sent, _ in result if is_sent}
    assert len(result) > 2000
    return result


@pytest.mark.parametrize("suffix", ["asc", "blf", "trc", "mf4"])
@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_python_can_reads_every_frame(run: Path, frames: list[Frame], suffix: str) -> None:
    with can.LogReader(run / f"run.{suffix}") as reader:
        found = [(m.timestamp, m.arbitration_id, not m.is_rx, bytes(m.data)) for m in reader]
    assert [each[1:] for each in found] == [each[1:] for each in frames]
    assert [each[0] for each in found] == pytest.approx([each[0] for each in frames], abs=1e-6)


def messages(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Messages by topic, read by the MCAP library."""
    from mcap.reader import make_reader

    found = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            told = json.loads(message.data)
            assert schema is not None
            assert list(told) == list(json.loads(schema.data)["properties"])
            found[channel.topic].append((message.log_time, told))
    return found


def test_the_mcap_library_reads_every_frame(run: Path, frames: list[Frame]) -> None:
    found = [
        (time / 1e9, each["id"], each["direction"] == "Tx", bytes.fromhex(each["data"]))
        for time, each in messages(run / "run.mcap")["/can"]
    ]
    assert found == frames


def test_the_mcap_library_reads_every_signal(run: Path, table: dict[str, np.ndarray]) -> None:
    told = messages(run / "run.mcap")
    seen = set()
    for topic, prefix in (("/truth", ""), ("/sensed", "sensed_"), ("/bench", "")):
        for name in told[topic][0][1]:
            column = name if name == "time_s" else prefix + name
            values = [each[name] for _, each in told[topic]]
            assert np.array_equal(values, table[column]), column
            seen.add(column)
        times = [time for time, _ in told[topic]]
        assert times == np.round(table["time_s"] * 1e9).astype(int).tolist()
    assert seen == set(table)


@pytest.mark.filterwarnings("ignore")
def test_asammdf_reads_every_signal(run: Path, table: dict[str, np.ndarray]) -> None:
    from asammdf import MDF

    with MDF(run / "run.mf4") as measured:
        for name, values in table.items():
            if name != "time_s":
                signal = measured.get(name)
                assert np.array_equal(signal.samples, values), name
                assert np.array_equal(signal.timestamps, table["time_s"]), name


@pytest.mark.filterwarnings("ignore")
def test_asammdf_reads_every_frame_and_its_direction(run: Path, frames: list[Frame]) -> None:
    from asammdf import MDF

    with MDF(run / "run.mf4") as measured:
        found = {name: measured.get(f"CAN_DataFrame.{name}") for name in ("ID", "Dir", "DataLength")}
        data = measured.get("CAN_DataFrame.DataBytes").samples
    stamps = found["ID"].timestamps
    rows = zip(
        found["ID"].samples.tolist(),
        (found["Dir"].samples == 1).tolist(),  # of ASAM's bus logging: 0 Rx, 1 Tx
        found["DataLength"].samples.tolist(),
        data,
        strict=True,
    )
    ours = [(number, sent, bytes(payload[:length])) for number, sent, length, payload in rows]
    assert ours == [each[1:] for each in frames]
    assert stamps.tolist() == pytest.approx([each[0] for each in frames], abs=1e-9)


@pytest.mark.filterwarnings("ignore")
def test_asammdf_decodes_the_frames_with_the_database(run: Path, frames: list[Frame]) -> None:
    """Its `extract_bus_logging` with the shipped database gives each signal's values at the frames' times."""
    from asammdf import MDF

    database = cantools.database.load_file(DBC)
    expected = defaultdict(list)
    for time, number, _, payload in frames:
        message = database.get_message_by_frame_id(number)
        for name, value in message.decode(payload).items():
            told = value if isinstance(value, int | float) else str(value)
            expected[f"{message.name}.{name}"].append((time, told))
    assert {"LeftDrive.MotorCurrent", "DriveCommand.LeftDuty", "Gate.Angle"} < set(expected)
    found = {}
    with MDF(run / "run.mf4") as measured, measured.extract_bus_logging({"CAN": [(str(DBC), 0)]}) as decoded:
        for place, group in enumerate(decoded.groups):
            number = re.search(r"ID=0x([0-9A-F]+) ", group.channel_group.acq_name)
            assert number is not None
            message = database.get_message_by_frame_id(int(number[1], 16))
            for signal in message.signals:
                read = decoded.get(signal.name, group=place)
                found[f"{message.name}.{signal.name}"] = read.timestamps, read.samples
    assert set(found) == set(expected)
    for name, pairs in expected.items():
        times, values = found[name]
        assert times.tolist() == pytest.approx([time for time, _ in pairs], abs=1e-9), name
        if values.dtype.kind == "S":  # of an enumeration the labels
            assert [each.decode() for each in values.tolist()] == [told for _, told in pairs], name
        else:
            assert values.tolist() == pytest.approx([told for _, told in pairs], rel=1e-12), name
