"""Provenance in recordings: files, seed, clock, rate, versions, the vehicle."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import can
import pytest
from c_library import build, needs_compiler

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.shipped import find_config
from liftgate_hil.conversion.convert import convert
from liftgate_hil.ecu.calibration import CALIBRATED
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_recording

pytest.importorskip("asammdf")
pytest.importorskip("mcap")
pytest.importorskip("pyarrow")
pytestmark = pytest.mark.filterwarnings("ignore")  # asammdf's own

SILENT = """
#include "liftgate_ecu.h"
LIFTGATE_ECU_EXPORT void *liftgate_ecu_create(void) { static int one; return &one; }
LIFTGATE_ECU_EXPORT void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
LIFTGATE_ECU_EXPORT int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{ (void)ecu; (void)now_ns; (void)in; (void)count; (void)out; (void)capacity; return 0; }
"""
HOLDING = (".mf4", ".mcap", ".parquet")
SCENARIO = """
duration = 0.3
seed = 7
initial = 20
[parameters]
rod = 10_000
[[obstacle]]
angle_deg = 15
stiffness = "$rod"
"""


def run(folder: Path, *suffixes: str, **more: Any) -> None:
    """Run SCENARIO with a stiffer rod and another resistance, recorded in a file of each suffix."""
    (folder / "s.toml").write_text(SCENARIO)
    files = [folder / f"run{suffix}" for suffix in suffixes]
    settings = ["motor.resistance=0.8"]
    lh.run(folder / "s.toml", parameters={"rod": 20_000}, settings=settings, record=files, **more)


def provenance_in(path: Path) -> str:
    """Provenance read by the format's own reader."""
    if path.suffix == ".mf4":
        from asammdf import MDF

        with MDF(path) as measured:
            (attachment,) = measured.attachments
            assert attachment.file_name == "liftgate-hil-run.json"
            return bytes(measured.extract_attachment(0)[0]).decode()
    if path.suffix == ".parquet":
        from pyarrow import parquet

        return parquet.read_schema(path).metadata[b"liftgate-hil run"].decode()
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        (attachment,) = make_reader(stream).iter_attachments()
    assert (attachment.name, attachment.media_type) == ("liftgate-hil-run.json", "application/json")
    return attachment.data.decode()


@pytest.mark.parametrize("suffix", HOLDING)
def test_a_recording_holds_files_seed_and_versions_of_its_run(tmp_path: Path, suffix: str) -> None:
    run(tmp_path, suffix, rate=2000.0)
    told = json.loads(provenance_in(tmp_path / f"run{suffix}"))
    assert (told["seed"], told["clock"], told["rate_hz"]) == (7, "free", 2000.0)
    assert (told["duration_s"], told["parameters"]) == (0.3, {"rod": 20_000.0})
    assert told["initial_deg"] == pytest.approx(20.0)
    assert {"liftgate-hil", "python", "numba", "numpy"} <= set(told["versions"])
    assert told["vehicle"]["left"]["motor"]["resistance"] == 0.8
    for name, path in (
        ("scenario", tmp_path / "s.toml"),
        ("vehicle", find_config("vehicles", "suv")),
        ("rig", find_config("rigs", "liftgate")),
        ("dbc", Path(__file__).parents[3] / "dbc" / "liftgate.dbc"),
    ):
        assert told["files"][name]["text"] == path.read_text(encoding="utf-8")
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        assert told["files"][name]["sha256"] == digest
    assert open_recording(tmp_path / f"run{suffix}").about == provenance_in(tmp_path / f"run{suffix}")


def test_the_same_run_gives_byte_identical_recordings(tmp_path: Path) -> None:
    run(tmp_path, ".mcap", ".parquet")
    first = {path: path.read_bytes() for path in tmp_path.glob("run.*")}
    run(tmp_path, ".mcap", ".parquet")
    assert {path: path.read_bytes() for path in first} == first


@pytest.mark.parametrize(("suffix", "mark"), [(".asc", "// "), (".trc", "; ")])
def test_asc_and_trc_carry_a_short_provenance_as_comments_and_their_frames_read_the_same(
    tmp_path: Path, suffix: str, mark: str
) -> None:
    run(tmp_path, suffix, ".log")
    path = tmp_path / f"run{suffix}"
    lines = path.read_text(encoding="utf-8").splitlines()
    digest = hashlib.sha256((tmp_path / "s.toml").read_bytes()).hexdigest()
    assert f"{mark}seed = 7" in lines
    assert f"{mark}rod = 20000.0" in lines
    assert f"{mark}scenario = {tmp_path / 's.toml'}, SHA-256 {digest}" in lines
    with can.LogReader(path) as found, can.LogReader(tmp_path / "run.log") as expected:
        assert [bytes(m.data) for m in found] == [bytes(m.data) for m in expected]


def test_a_recording_by_the_recorder_process_has_the_provenance_too(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    line = ["--bus", "virtual:origin", "--duration", "0.2", "--overrun-limit", "60", "--seed", "3"]
    assert main([*line, "--quiet", "--record", str(path)]) == 0
    told = json.loads(provenance_in(path))
    assert (told["seed"], told["clock"]) == (3, "realtime")
    assert open_recording(path).start_ns > 0


def test_a_provenance_larger_than_a_pipe_buffer_reaches_the_recorder_process(tmp_path: Path) -> None:
    long = tmp_path / "s.toml"
    long.write_text(SCENARIO + "# " + "x" * 300_000 + "\n")
    path = tmp_path / "run.mcap"
    line = ["--bus", "virtual:long", "--duration", "0.2", "--overrun-limit", "60"]
    assert main([*line, "--quiet", "--scenario", str(long), "--record", str(path)]) == 0
    assert json.loads(provenance_in(path))["files"]["scenario"]["text"] == long.read_text()


def test_converting_keeps_the_provenance_or_reports_its_loss(tmp_path: Path) -> None:
    run(tmp_path, ".mf4")
    about = open_recording(tmp_path / "run.mf4").about
    path = tmp_path / "run.mf4"
    for suffix in (".mcap", ".mf4", ".parquet"):
        done = convert(path, tmp_path / f"next{suffix}")
        path = tmp_path / f"next{suffix}"
        assert open_recording(path).about == about
        assert not [note for note in done.notes if "provenance" in note]
    run(tmp_path, ".log", ".mf4")
    for suffix, what in ((".asc", "shortened"), (".trc", "shortened"), (".blf", "omitted")):
        (note,) = (
            each for each in convert(tmp_path / "run.mf4", tmp_path / f"out{suffix}").notes if "prov" in each
        )
        assert note.startswith(f"provenance {what}: {suffix} ")
        content = (tmp_path / f"out{suffix}").read_bytes()
        assert (b"liftgate-hil" in content and b"suv" in content) == (what == "shortened")
    done = convert(path, tmp_path / "out.csv")
    assert done.notes == ("provenance omitted: .csv cannot hold it; allowed: .parquet, .mf4, .mcap",)


def test_a_table_of_simulate_has_a_provenance_too(tmp_path: Path) -> None:
    table = tmp_path / "in.csv"
    table.write_text("time_s,voltage_v\n0,9\n0.1,3\n")
    path = tmp_path / "out.parquet"
    line = f"simulate --input {table} --duration 0.2 --step 0.002 --seed 5 --output {path}"
    assert main(line.split()) == 0
    told = json.loads(provenance_in(path))
    assert (told["clock"], told["rate_hz"], told["seed"]) == ("offline", 500.0, 5)
    assert told["duration_s"] == 0.2
    assert told["files"]["input"]["text"] == table.read_text()
    assert set(told["files"]) == {"input", "vehicle"}


def test_converting_a_recording_with_a_damaged_provenance_is_refused(tmp_path: Path) -> None:
    from pyarrow import parquet

    run(tmp_path, ".parquet")
    table = parquet.read_table(tmp_path / "run.parquet")
    for about in (b'{"seed": 1', b"[]", b'{"seed": 1}'):
        table = table.replace_schema_metadata({b"liftgate-hil run": about})
        parquet.write_table(table, tmp_path / "hurt.parquet")
        with pytest.raises(ConfigError, match=r"hurt\.parquet: cannot be read: its provenance is damaged"):
            convert(tmp_path / "hurt.parquet", tmp_path / "out.mcap")


def test_a_vehicle_from_a_file_or_a_program_is_in_the_provenance(tmp_path: Path) -> None:
    vehicle = tmp_path / "mine.toml"
    vehicle.write_bytes(find_config("vehicles", "suv").read_bytes())
    lh.run("demo", duration=0.1, vehicle=vehicle, record=[tmp_path / "run.mcap"])
    told = json.loads(open_recording(tmp_path / "run.mcap").about)
    assert told["files"]["vehicle"]["path"] == str(vehicle)
    loaded = lh.load_vehicle("suv")
    lh.run("demo", duration=0.1, vehicle=loaded, record=[tmp_path / "run.mcap"])
    told = json.loads(open_recording(tmp_path / "run.mcap").about)
    assert "vehicle" not in told["files"]  # it was made by a program: only its values are known
    assert told["vehicle"]["drives"] == 2


def test_files_included_by_a_scenario_are_in_the_provenance(tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text("[parameters]\nrod = 5_000\n")
    (tmp_path / "bench.toml").write_text('include = ["deep.toml"]\nseed = 4\n')
    (tmp_path / "s.toml").write_text('include = ["bench.toml"]\nduration = 0.1\n')
    lh.run(tmp_path / "s.toml", record=[tmp_path / "run.mcap", tmp_path / "run.asc"])
    told = json.loads(open_recording(tmp_path / "run.mcap").about)["files"]
    included = {name: Path(each["path"]).name for name, each in told.items() if "incl" in name}
    assert included == {"included 1": "deep.toml", "included 2": "bench.toml"}
    for name, file in included.items():
        assert told[name]["text"] == (tmp_path / file).read_text()
        digest = hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()
        assert told[name]["sha256"] == digest
        assert f"{name} = {tmp_path / file}, SHA-256 {digest}" in (tmp_path / "run.asc").read_text()


class Silent:
    """An ECU that sends nothing."""

    def step(self, now_s: float, frames: list[can.Message]) -> list[can.Message]:
        return []


def ecu_of(path: Path, **how: Any) -> dict[str, Any]:
    """Return the ECU's part of the provenance in a recording of the demo."""
    lh.run("demo", duration=0.05, record=[path], **how)
    told: dict[str, Any] = json.loads(open_recording(path).about)["ecu"]
    return told


def test_the_ecu_is_in_the_provenance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    reference = ecu_of(path)
    assert (reference["kind"], reference["version"]) == ("reference", lh.__version__)
    assert reference["calibration"]["blank_time"] == 0.5
    paced = ecu_of(path, settings=["coding.anti_trap_limits=2"])
    assert paced["calibration"]["excess_learned"] == 2 * CALIBRATED.excess_learned
    mine = tmp_path / "my_silent_ecu.py"
    mine.write_text("class Ecu:\n    def step(self, now_s, frames):\n        return []\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert ecu_of(path, ecu="my_silent_ecu:Ecu") == {
        "kind": "python", "class": "my_silent_ecu:Ecu", "path": str(mine),
        "sha256": hashlib.sha256(mine.read_bytes()).hexdigest(),
    }  # fmt: skip
    own = ecu_of(path, ecu=Silent(), clock="lockstep")
    assert (own["kind"], own["path"]) == ("python", __file__)


@needs_compiler
def test_the_file_of_an_ecu_library_is_in_the_provenance(tmp_path: Path) -> None:
    library = build(tmp_path, SILENT)
    assert ecu_of(tmp_path / "run.mcap", ecu=str(library)) == {
        "kind": "library", "path": str(library),
        "sha256": hashlib.sha256(library.read_bytes()).hexdigest(),
    }  # fmt: skip


def test_an_ecu_on_a_bus_is_in_the_provenance_as_such(tmp_path: Path) -> None:
    path = tmp_path / "run.asc"
    line = ["--bus", "virtual:nobody", "--duration", "0.1", "--clock", "free", "--quiet"]
    assert main([*line, "--record", str(path)]) == 0
    assert "// ecu = bus" in path.read_text().splitlines()
