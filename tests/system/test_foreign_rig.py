"""The demo runs unchanged on a foreign database."""

from __future__ import annotations

import csv
from pathlib import Path

import cantools
import pytest

from liftgate_hil.cli.main import main

RIG = Path(__file__).parent / "foreign" / "foreign.toml"
STORY = [
    "opening",
    "open",
    "closing",
    "trapped while closing",
    "reversal done, stopped",
    "opening",
    "open",
    "closing",
    "closed and latched",
]


def check_story(printed: str) -> None:
    told = [line.split(" deg  ")[1] for line in printed.splitlines() if " deg  " in line]
    assert [text[: len(start)] for text, start in zip(told, STORY, strict=True)] == STORY


def test_the_demo_runs_on_a_foreign_database(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["demo", "--rig", str(RIG), "--clock", "free", "--output", str(tmp_path)]
    assert main(arguments) == 0
    check_story(capsys.readouterr().out)
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")

    # The recording is theirs, and their database reads the gate's motion out of it.
    database = cantools.database.load_file(RIG.with_name("foreign.dbc"))
    feedback = database.get_message_by_name("KlappeIst")
    angles = []
    for line in (tmp_path / "demo.log").read_text().splitlines():
        name, _, payload = line.split()[2].partition("##")
        if int(name, 16) == feedback.frame_id:
            values = feedback.decode(bytes.fromhex(payload[1:]), allow_excess=False)
            angles.append(values["Winkel"])
    assert max(angles) == pytest.approx(1.4, abs=0.02)
    assert angles[-1] == pytest.approx(0.0, abs=2e-4)
    with (tmp_path / "demo.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert float(rows[-1]["latched"]) == 1.0


def test_the_demo_runs_on_a_rig_as_drafted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    database = Path(__file__).parents[1] / "hil/config/foreign/gm_plgm.dbc"
    rig = tmp_path / "drafted.toml"
    assert main(["rig", "draft", str(database), "--output", str(rig)]) == 0
    assert main(["rig", "check", str(rig)]) == 0
    capsys.readouterr()
    assert main(["demo", "--rig", str(rig), "--clock", "free", "--no-record"]) == 0
    check_story(capsys.readouterr().out)


def test_a_repeated_run_on_a_foreign_database_is_bit_identical(tmp_path: Path) -> None:
    recordings = []
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        arguments = ["demo", "--rig", str(RIG), "--clock", "free", "--duration", "20", "--output", str(folder)]
        main([*arguments, "--quiet", "--set", "sensors.current_noise=0.05"])
        recordings.append([(folder / f"demo.{kind}").read_bytes() for kind in ("csv", "log")])
    assert recordings[0] == recordings[1]
