"""MF4 files of other programs and loggers: conversions, invalid samples, unfinished files, MDF 3."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from liftgate_hil.codec.frames import EXTENDED, FD
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_file, open_recording

DBC = Path(__file__).parents[3] / "dbc" / "liftgate.dbc"

asammdf = pytest.importorskip("asammdf")
from_dict = pytest.importorskip("asammdf.blocks.conversion_utils").from_dict

TIMES = np.arange(6) * 0.01
LINEAR = {"a": 0.01, "b": 0.0}
INIT = {"val_0": 65534.0, "text_0": b"Init", "val_1": 65535.0, "text_1": b"Invalid"}
DATA = "CAN_DataFrame.DataBytes"


def channel(name: str, raw: Any, conversion: dict[str, Any] | None = None, unit: str = "deg", **how: Any) -> Any:
    made = None if conversion is None else from_dict(dict(conversion))
    return asammdf.Signal(np.asarray(raw), TIMES, name=name, unit=unit, conversion=made, **how)


def saved(path: Path, *groups: list[Any]) -> Path:
    """Save groups of channels in an MF4 file; return its path."""
    with asammdf.MDF(version="4.10") as measured:
        for group in groups:
            measured.append(group, acq_name=path.stem if len(groups) == 1 else "")
        measured.save(path, overwrite=True)
    return path


def default(conversion: dict[str, Any]) -> dict[str, Any]:
    """Return the entry of value texts that applies this conversion to all other values."""
    return {"default_addr": from_dict(dict(conversion))}


def read(path: Path, name: str) -> list[float]:
    """Return the values of a column without missing ones. Raises ConfigError with all issues."""
    issues: list[str] = []
    found = open_file(path).read([name], issues)
    if issues:
        raise ConfigError(issues)
    return found[name].values.tolist()


def rows_of(path: Path, name: str) -> list[float]:
    """Return the values of a column as they are in rows, NaN for missing ones."""
    recording = open_recording(path)
    return np.concatenate(list(recording.rows(["time_s", name])))[:, 1].tolist()


RAW = np.array([65534, 2000, 2000, 65535, 3000, 3000], dtype="u2")


def test_a_value_text_of_a_scaled_signal_counts_as_missing_and_is_counted(tmp_path: Path) -> None:
    """A database's labels for single values are stored as value texts."""
    path = saved(tmp_path / "m.mf4", [channel("Angle", RAW, INIT | default(LINEAR))])
    assert read(path, "Angle") == [20.0, 20.0, 30.0, 30.0]
    assert rows_of(path, "Angle") == pytest.approx([np.nan, 20.0, 20.0, np.nan, 30.0, 30.0], nan_ok=True)
    recording = open_recording(path)
    list(recording.rows(["time_s", "Angle"]))
    assert any("2 samples left out (Angle: a value text, or invalid)" in note for note in recording.notes)


@pytest.mark.parametrize(("conversion", "unit"), [(INIT | default(LINEAR), "deg"), (INIT, "deg"), (INIT, "")])
def test_a_signal_with_only_value_texts_is_refused(tmp_path: Path, conversion: dict[str, Any], unit: str) -> None:
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.full(6, 65534, dtype="u2"), conversion, unit)])
    with pytest.raises(ConfigError, match="no numbers, only value texts or invalid samples"):
        read(path, "Angle")
    assert np.isnan(rows_of(path, "Angle")).all()


@pytest.mark.parametrize("first", [0, 1])
def test_a_state_with_value_texts_is_read_as_its_numbers(tmp_path: Path, first: int) -> None:
    raw = np.array([0, 1, 1, 0, 0, 1], dtype="u1") + first
    states = {"val_0": float(first), "text_0": b"closed", "val_1": 1.0 + first, "text_1": b"open"}
    path = saved(tmp_path / "m.mf4", [channel("Latch", raw, states, "")])
    assert read(path, "Latch") == rows_of(path, "Latch") == raw.tolist()


@pytest.mark.parametrize("conversion", [{"a": 1.0, "b": 0.0}, {"a": 0.5, "b": -1.0}])
def test_a_numeric_conversion_is_applied(tmp_path: Path, conversion: dict[str, float]) -> None:
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6, dtype="i2"), conversion)])
    expected = (np.arange(6) * conversion["a"] + conversion["b"]).tolist()
    assert read(path, "Angle") == rows_of(path, "Angle") == expected


def test_an_invalid_sample_counts_as_missing_in_columns_and_in_rows(tmp_path: Path) -> None:
    bits = np.array([False, True, False, False, True, False])
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0), invalidation_bits=bits)])
    assert read(path, "Angle") == [0.0, 2.0, 3.0, 5.0]
    assert rows_of(path, "Angle") == pytest.approx([0.0, np.nan, 2.0, 3.0, np.nan, 5.0], nan_ok=True)


def test_a_non_numeric_channel_is_left_out_with_a_note(tmp_path: Path) -> None:
    text = channel("Remark", np.array([b"a"] * 6), unit="", encoding="utf-8")
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0)), text])
    recording = open_recording(path)
    assert list(recording.signals) == ["time_s", "Angle"]
    assert "Remark left out: not numeric" in recording.notes
    with pytest.raises(ConfigError, match="Remark: not numeric"):
        read(path, "Remark")


def test_channels_with_the_same_name_get_the_names_of_their_groups(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    with asammdf.MDF(version="4.10") as measured:
        for group, value in (("Motor A", 1.0), ("Motor B", 2.0)):
            measured.append([channel("I", np.full(6, value), unit="A")], acq_name=group)
        measured.save(path)
    assert list(open_file(path).names) == ["Motor A.I", "Motor B.I"]
    assert read(path, "Motor B.I") == [2.0] * 6


def test_mdf_3_is_refused_with_how_to_convert_it(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    with asammdf.MDF(version="3.30") as measured:
        measured.append([channel("Angle", np.arange(6.0))])
        written = Path(measured.save(tmp_path / "m.mdf"))
    for name in (path, path.with_suffix(".dat"), written):
        written = written.rename(name)
        with pytest.raises(ConfigError, match=r"MDF 3\.30; allowed: MDF 4, to which asammdf converts it"):
            open_file(name)


def test_an_mf4_file_with_another_suffix_is_reported(tmp_path: Path) -> None:
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0))]).rename(tmp_path / "m.dat")
    with pytest.raises(ConfigError, match=r"m\.dat: is MDF; allowed: a name that ends in \.mf4"):
        open_file(path)


@pytest.mark.parametrize("is_finished", [True, False])
def test_a_file_truncated_anywhere_is_refused(tmp_path: Path, is_finished: bool) -> None:
    whole = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0))]).read_bytes()
    if not is_finished:  # the length of the last block of data is missing, too (bit 2)
        whole = b"UnFinMF " + whole[8:60] + bytes([0b101]) + whole[61:]
    path, said = tmp_path / "cut.mf4", set()
    for length in range(7, len(whole), len(whole) // 12):
        path.write_bytes(whole[:length])
        try:
            read(path, "Angle")
        except ConfigError as error:
            said.update(error.issues)
    assert said == {f"{path}: cannot be read: truncated or damaged"}


def test_an_unfinalized_file_without_its_data_is_refused_and_nothing_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0))])
    content = bytearray(path.read_bytes())
    content[:8], content[60] = b"UnFinMF ", 0b100  # the length of the last block of data is missing
    (group,) = struct.unpack_from("<Q", content, 64 + 24)
    struct.pack_into("<Q", content, group + 24 + 16, 64)  # the header block instead of one of data
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="cannot be read: truncated or damaged"):
        open_file(path)
    assert capfd.readouterr() == ("", "")


def test_a_file_that_is_no_mdf_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    path.write_bytes(b"time_s,angle_deg\n" * 20)
    with pytest.raises(ConfigError, match="cannot be read: no MDF file; allowed: one that begins with MDF"):
        open_file(path)


def test_an_unfinalized_file_of_a_logger_is_read_and_not_modified(tmp_path: Path) -> None:
    """Its identification says so, and the count of records is missing (ASAM MDF 4.1, unfinalized flags)."""
    path = saved(tmp_path / "m.mf4", [channel("Angle", np.arange(6.0))])
    content = bytearray(path.read_bytes())
    content[:8], content[60] = b"UnFinMF ", 0b1
    path.write_bytes(content)
    assert read(path, "Angle") == rows_of(path, "Angle") == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert path.read_bytes() == content


def test_channels_with_the_same_name_in_one_group_are_all_read(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    with asammdf.MDF(version="4.10") as measured:
        measured.append([channel("Angle", np.full(6, value)) for value in (1.0, 2.0)], common_timebase=True)
        measured.append([channel("group 0.Angle", np.full(6, 3.0))])
        measured.save(path)
    file = open_file(path)
    assert sorted(read(path, name)[0] for name in file.names) == [1.0, 2.0, 3.0]
    assert read(path, "group 0.Angle") == [3.0] * 6


def test_a_group_with_times_in_another_unit_than_seconds_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "m.mf4"
    with asammdf.MDF(version="4.10") as measured:
        measured.append([channel("Angle", np.arange(6.0))])
        measured.groups[0].channels[0].unit = "ms"
        measured.save(path)
    assert "group 0 left out: its times are in 'ms'; allowed: s" in open_file(path).notes


def test_constant_frame_fields_are_read_from_the_conversions_of_their_group(tmp_path: Path) -> None:
    """A CANedge writes a group for each bus, direction and kind of identifier, and stores an index there."""
    path, index = tmp_path / "m.mf4", np.arange(6)
    lengths = np.array([0, 1, 8, 9, 10, 15], "u1")
    stored = {
        "BusChannel": index.astype("u1"), "ID": 0x18FEDF00 + index.astype("u4"), "IDE": index.astype("u1"),
        "DLC": lengths, "DataLength": lengths, "Dir": index.astype("u1"), "EDL": np.ones(6, "u1"),
    }  # fmt: skip
    samples = np.zeros(
        6, [*((f"CAN_DataFrame.{name}", x.dtype) for name, x in stored.items()), (DATA, "u1", (64,))]
    )
    for name, values in stored.items():
        samples[f"CAN_DataFrame.{name}"] = values
    samples[DATA] = 7
    codes = {f"phys_{k}": float(value) for k, value in enumerate((0, 1, 8, 12, 16, 64))}
    codes |= {f"raw_{k}": float(value) for k, value in enumerate(lengths)}
    conversions = {
        "BusChannel": {"a": 0.0, "b": 9.0}, "IDE": {"a": 0.0, "b": 1.0}, "Dir": {"a": 0.0, "b": 1.0},
        "DataLength": codes,
    }  # fmt: skip
    with asammdf.MDF(version="4.10") as measured:
        measured.append([asammdf.Signal(samples, TIMES, name="CAN_DataFrame")])
        for each in measured.groups[0].channels:
            if made := conversions.get(each.name.removeprefix("CAN_DataFrame.")):
                each.conversion = from_dict(dict(made))
        measured.save(path)
    recording = open_recording(path)
    assert recording.channel == "can9"
    (frames,) = recording.frames()
    assert frames["identifier"].tolist() == [0x18FEDF00 + k | EXTENDED | FD for k in range(6)]
    assert frames["is_sent"].all()
    assert frames["length"].tolist() == [0, 1, 8, 12, 16, 64]
    assert frames["payload"][3].tolist() == [7] * 12 + [0] * 52


def test_a_file_with_frames_and_signals_of_several_groups_is_read_as_frames(tmp_path: Path) -> None:
    """CANape and python-can write such files, with the decoded signals beside the frames."""
    import can

    path = tmp_path / "m.mf4"
    with can.MF4Writer(path, database=str(DBC)) as writer:
        for k in range(20):
            for identifier, length in ((0x220, 8), (0x210, 8)):
                data = bytes([k] * length)
                writer.on_message_received(can.Message(0.01 * k, identifier, is_extended_id=False, data=data))
    found = open_recording(path)
    assert found.signals == {}
    assert any(note.startswith("its columns are left out: columns in several groups") for note in found.notes)
    assert sum(map(len, found.frames())) == 40
