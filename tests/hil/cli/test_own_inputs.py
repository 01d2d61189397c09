"""No command writes to a file that it reads, whatever name or link leads to that file.

Each command gets an input as its output, by a hard link: it must refuse, and the input must stay.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from campaign_support import SHORT

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.shipped import data_root, find_config
from liftgate_hil.errors import ConfigError

RESTS = """
duration = 0.05
include = ["included.toml"]
rig = "rig.toml"
vehicle = "vehicle.toml"
[[profile]]
quantity = "road_slope_deg"
csv = "slope.csv"
[[expect]]
name = "rests"
always = "gate_angle_deg < 1"
"""
INPUTS = {
    "scenario.toml": RESTS,
    "included.toml": 'description = "included"\nseed = 1\n',
    "slope.csv": "time_s,road_slope_deg\n0,0\n1,5\n",
    "voltage.csv": "time_s,voltage_v\n0,1\n0.05,2\n",
    "table.csv": "time_s,gate_angle_deg\n0,0\n0.001,0\n0.05,0\n",
    "map.toml": '[columns]\nvoltage_v = "voltage_v"\n',
    "judge.toml": '[columns]\ngate_angle_deg = "gate_angle_deg"\n',
    "short.toml": SHORT,
}
ECU = "class Ecu:\n    period_s = 0.01\n    def step(self, now_s, frames):\n        return []\n"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with inputs of all kinds."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "own_ecu", raising=False)
    for name, text in INPUTS.items():
        Path(name).write_text(text)
    Path("own_ecu.py").write_text(ECU)
    shutil.copy(find_config("vehicles", "suv"), "vehicle.toml")
    shutil.copy(data_root() / "dbc" / "liftgate.dbc", "gate.dbc")
    shipped = find_config("rigs", "liftgate").read_text()
    Path("rig.toml").write_text(shipped.replace('"liftgate.dbc"', '"gate.dbc"'))
    return tmp_path


def contents(folder: Path) -> Mapping[str, bytes]:
    """Return the files of a folder by name, without the bytecode of an ECU in Python."""
    files = [each for each in folder.rglob("*") if each.is_file() and each.parent.name != "__pycache__"]
    return {str(each.relative_to(folder)): each.read_bytes() for each in files}


# Commands, with OUT for the file to write; its name, and the inputs that it must not be: all where it is the first
# of a kind, one where it writes in the same way.
ONE = ("scenario.toml",)
OF_A_RUN = ("scenario.toml", "included.toml", "slope.csv", "vehicle.toml", "rig.toml", "gate.dbc", "own_ecu.py")
RUN = "--clock free --duration 0.05 --ecu reference --scenario scenario.toml --record OUT"
TEST = "test scenario.toml --ecu own_ecu:Ecu"
JUDGE = "judge table.csv --scenario scenario.toml --map judge.toml"
IDENTIFY = "identify table.csv --vehicle vehicle.toml --map map.toml --estimate motor.resistance"
VALIDATE = "validate table.csv --vehicle vehicle.toml --map map.toml"
OF_FITTING = ("table.csv", "vehicle.toml", "map.toml")
SIMULATE = "simulate --vehicle vehicle.toml --input voltage.csv --map map.toml"
OF_RESULTS = ("verdicts.json", "junit.xml", "report.html", "scenario.log")
OF_A_CAMPAIGN = ("results.parquet", "report.html", "DATA.md", "worst.toml")
CASES = [
    (RUN, "out.csv", OF_A_RUN[:-1]),
    (RUN, "out.mf4", ONE),
    (f"{TEST} --json OUT", "out.json", OF_A_RUN),
    (f"{TEST} --junit OUT", "out.xml", ONE),
    (f"{TEST} --html OUT", "out.html", ONE),
    (f"{TEST} --results out", "out/scenario.csv", OF_A_RUN),
    *((f"{TEST} --results out", f"out/{name}", ONE) for name in OF_RESULTS),
    (f"{TEST} --results out --retry-inconclusive 1", "out/scenario-attempt-1.csv", ONE),
    (f"{TEST} --results out --recordings failed", "out/scenario.csv", ONE),
    (f"{JUDGE} --json OUT", "out.json", ("table.csv", "judge.toml", *OF_A_RUN[:-1])),
    (f"{JUDGE} --junit OUT", "out.xml", ONE),
    (f"{JUDGE} --html OUT", "out.html", ("table.csv",)),
    (f"{IDENTIFY} --result OUT", "out.json", OF_FITTING),
    (f"{IDENTIFY} --html OUT", "out.html", OF_FITTING[:1]),
    (f"{IDENTIFY} --save-vehicle OUT", "out.toml", ("vehicle.toml",)),
    (f"{VALIDATE} --result OUT", "out.json", OF_FITTING),
    (f"{VALIDATE} --html OUT", "out.html", OF_FITTING[:1]),
    (f"{SIMULATE} --output OUT", "out.csv", ("voltage.csv", "map.toml", "vehicle.toml")),
    (f"{SIMULATE} --output out.csv --edges OUT", "edges.csv", ("voltage.csv", "vehicle.toml")),
    ("convert table.csv OUT", "out.csv", ("table.csv",)),
    ("convert recorded.log OUT --rig rig.toml", "out.csv", ("recorded.log", "rig.toml", "gate.dbc")),
    ("plot table.csv --output OUT", "out.png", ("table.csv",)),
    ("plot recorded.log --rig rig.toml --output OUT", "out.svg", ("recorded.log", "rig.toml", "gate.dbc")),
    ("plot --figure forces --vehicle vehicle.toml --output OUT", "out.pdf", ("vehicle.toml",)),
    ("compare table.csv voltage.csv --output OUT", "out.html", ("table.csv", "voltage.csv")),
    ("rig draft gate.dbc --output OUT", "out.toml", ("gate.dbc",)),
    ("demo --clock free --scenario short.toml --output out", "out/demo.csv", ("short.toml",)),
    *(
        ("campaign short.toml --vary angle=60,70 --output out", f"out/{name}", ("short.toml",))
        for name in OF_A_CAMPAIGN
    ),
]


@pytest.mark.parametrize(("command", "target", "inputs"), CASES)
def test_a_command_refuses_to_write_to_its_own_inputs(
    here: Path, capsys: pytest.CaptureFixture[str], command: str, target: str, inputs: tuple[str, ...]
) -> None:
    if "recorded.log" in inputs:
        Path("recorded.log").write_text("(1700000000.000000) can0 220#0000000000000000 R\n")
    for name in inputs:
        out = here / target
        out.parent.mkdir(exist_ok=True)
        os.link(here / name, out)
        before = contents(here)
        code = main(command.replace("OUT", target).split())
        said = capsys.readouterr().err
        assert code == 2, (name, said)
        assert "input" in said or "already exists" in said, (name, said)
        after = contents(here)
        assert {path: after.get(path) for path in before} == before, name
        assert out.samefile(here / name)
        out.unlink()
        shutil.rmtree(here / "out", ignore_errors=True)


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_run_by_the_python_api_refuses_to_write_to_its_inputs(here: Path, name: str) -> None:
    (here / "out.csv").symlink_to(name)
    before = contents(here)
    with pytest.raises(ConfigError, match=r"out\.csv: is an input file"):
        lh.run("scenario.toml", ecu="own_ecu:Ecu", record="out.csv")
    assert contents(here) == before


def test_a_recording_does_not_replace_files_of_a_campaign(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import pyarrow.parquet as pq

    assert main(["campaign", "short.toml", "--vary", "angle=60", "--jobs", "1", "--output", "out", "--quiet"]) == 0
    variant = pq.read_table("out/results.parquet").to_pylist()[0]["variant"]
    os.link("out/results.parquet", "own.parquet")
    os.link("short.toml", "run.csv")
    before = contents(here)
    for target in ("own.parquet", "out/results.parquet", "run.csv"):
        assert main(["campaign", "out", "--replay", variant, "--record", target]) == 2
        said = capsys.readouterr().err
        assert f"--record {target}: " in said
    assert contents(here) == before
    Path("run.csv").unlink()
    Path("run.csv").write_text("somebody's")
    assert main(["campaign", "out", "--replay", variant, "--record", "run.csv"]) == 0
    assert Path("run.previous.csv").read_text() == "somebody's"
    assert "run.csv: the recording that was there is now run.previous.csv" in capsys.readouterr().err
