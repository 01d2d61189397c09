"""The command `campaign`: its messages, its files, and what remains of a campaign that is stopped or killed."""

from __future__ import annotations

import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow.parquet as pq
import pytest
from campaign_support import SHORT

from liftgate_compiler.files import name_beside
from liftgate_hil.campaigns import adaptive
from liftgate_hil.campaigns.folder import DATA, LOCK, Folder
from liftgate_hil.campaigns.outcome_text import outcome_lines
from liftgate_hil.campaigns.store import StoreError
from liftgate_hil.cli.main import main

PATIENCE = 300.0  # s; nothing is judged by it


@pytest.fixture
def scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(SHORT)
    return "short.toml"


def rows_in(folder: str | Path) -> list[dict]:
    """The result rows without the evaluation time, which differs."""
    return pq.read_table(Path(folder) / "results.parquet").drop_columns(["wall_s"]).to_pylist()


def manifest_in(folder: str | Path) -> dict:
    return json.loads((Path(folder) / "campaign.json").read_text())


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--vary", "rood=1"], "--vary rood: allowed: angle, rod, seed, draw, or a key of the vehicle file"),
        (["--vary", "angle"], "--vary angle: allowed: NAME=VALUE,VALUE,…, NAME=FIRST:LAST:COUNT"),
        (["--vary", "angle=1:2"], "--vary angle=1:2: allowed: numbers as VALUE,VALUE,… or FIRST:LAST:COUNT"),
        (
            ["--vary", "angle~uniform(2,1)"],
            "--vary angle: uniform(2,1): allowed: uniform(low, high) with low < high",
        ),
        (["--vary", "angle~gauss(2,1)"], "--vary angle: gauss(2,1): allowed: uniform(low, high)"),
        (["--vary", "angle~uniform(60,70)"], "--samples: missing"),
        (["--vary", "angle=60,70", "--samples", "3"], "--samples 3: allowed: with a distribution"),
        (["--vary", "seed=1.5"], "--vary seed=1.5: allowed: whole numbers from 0"),
        (["--vary", "supply.voltage=-1"], "--vary supply.voltage=-1: -1: allowed: 0 to 60 V"),
        (["--vary", "rod=1e4,1e16"], "--vary rod: 1e+16: rod: 1e+16 is out of range; allowed: -1e+15 to 1e+15"),
        (["--vary", "angle=60", "--vary", "angle=70"], "angle: varied twice"),
        (["--vary", "vehicle"], "--vary vehicle: allowed: a vehicle file with [identification]"),
        (["--worst", "stays shut", "--vary", "angle=60,70"], "--worst stays shut: allowed: stays open"),
        (["--worst", "stays open"], "--worst stays open: allowed: together with --vary"),
        (
            ["--probability", "stays open", "--vary", "angle=1,2", "--evaluations", "100"],
            "--evaluations 100: allowed",
        ),
        (["--worst", "stays open", "--probability", "stays open"], "--worst: allowed without --probability"),
        (["--evaluations", "50", "--vary", "angle=60"], "--evaluations 50: allowed with --worst or --probability"),
        (["--vary", "angle=60", "--record", "a.csv"], "--record: allowed together with --replay"),
        (["--vary", "angle=60", "--replay", "a", "--seed", "5"], "--replay: not together with --vary, --seed"),
        (["--vary", "angle=60", "--ecu", "mutant:none"], "--ecu mutant:none: allowed: mutant: and one of"),
        (["--vary", "angle=60", "--scheduler", "nowhere"], "--scheduler nowhere"),
        (["--vary", "angle=60", "--store", "memory://x"], "--store memory://x: ends with this process"),
        (
            ["--vary", "angle=60,200", "--vary", "rod=1,2"],
            "short.toml: obstacle[0].angle_deg: 200.0 is out of range; allowed: -10 to 180 deg",
        ),
        (
            ["--vary", "angle~uniform(190,200)", "--samples", "2"],
            "short.toml: obstacle[0].angle_deg: 195.0 is out of range; allowed: -10 to 180 deg",
        ),
    ],
)
def test_a_wrong_flag_is_refused_in_one_line(
    scenario: str, flags: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", scenario, *flags]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert not Path("campaign").exists()


def test_a_full_grid_has_one_row_per_combination_and_the_files_describe_the_columns(
    scenario: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--vary", "angle=60,75", "--vary", "supply.voltage=9.5,12,15", "--output", "out", "--jobs", "1"]
    assert main(["campaign", scenario, *flags]) == 0
    rows = rows_in("out")
    assert [(row["supply.voltage"], row["angle"]) for row in rows] == [
        (voltage, angle) for voltage in (9.5, 12.0, 15.0) for angle in (60.0, 75.0)
    ]
    assert list(rows[0])[:4] == ["variant", "angle", "supply.voltage", "verdict"]
    assert {"margin.stays open", "peak_pinch_force_n", "reversal_time_s", "peak_current_a", "error"} <= set(
        rows[0]
    )
    found = manifest_in("out")
    assert found["is_complete"] is True
    assert found["variants"] == 6
    assert sum(found["verdicts"].values()) == 6
    assert found["request"]["vary"] == ["angle=60,75", "supply.voltage=9.5,12,15"]
    assert "6 variants" in capsys.readouterr().out
    page = Path("out/report.html").read_text()
    assert "</html>" in page
    assert "full grid, not a probability" in page
    assert "search chose" not in page
    for name in rows[0]:
        assert f"`{name}`" in Path("out/DATA.md").read_text()


def test_any_result_row_is_replayed_bit_by_bit(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--vary", "angle~uniform(60,79)", "--vary", "draw~integer(0,999)", "--samples", "5", "--jobs", "1"]
    assert main(["campaign", scenario, *flags]) == 0
    for row in rows_in("campaign"):
        assert main(["campaign", "campaign", "--replay", row["variant"][:16]]) == 0
        assert "bit-identical to" in capsys.readouterr().out
    assert main(["campaign", "campaign", "--replay", row["variant"], "--record", "run.csv"]) == 0
    assert Path("run.csv").stat().st_size > 10_000


def test_a_replay_reports_deviations_from_the_campaign(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["campaign", scenario, "--vary", "angle=60,75", "--jobs", "1", "--quiet"]) == 0
    path = Path("campaign/results.parquet")
    table = pq.read_table(path)
    rows = table.to_pylist()
    rows[0]["margin.stays open"] += 1e-12
    pq.write_table(table.from_pylist(rows, schema=table.schema), path)
    assert main(["campaign", "campaign", "--replay", rows[0]["variant"]]) == 1
    assert "not as in the campaign" in capsys.readouterr().out
    assert main(["campaign", "campaign", "--replay", "zz"]) == 2
    assert "--replay zz: no such variant" in capsys.readouterr().err


def test_a_folder_with_a_campaign_is_neither_overwritten_nor_resumed_by_another_one(
    scenario: str, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--vary", "angle=60,75", "--jobs", "1", "--quiet"]
    assert main(["campaign", scenario, *flags]) == 0
    assert main(["campaign", scenario, *flags]) == 2
    assert "has a campaign; allowed: another folder, or --resume" in capsys.readouterr().err
    before = rows_in("campaign")
    assert main(["campaign", scenario, *flags, "--resume"]) == 0
    assert manifest_in("campaign")["evaluated_now"] == 0
    assert rows_in("campaign") == before
    assert main(["campaign", scenario, *flags, "--set", "gate.mass=31", "--resume"]) == 2
    assert "settings: not as the campaign began" in capsys.readouterr().err
    Path(scenario).write_text(SHORT + "# changed\n")
    assert main(["campaign", scenario, *flags, "--resume"]) == 2
    assert "scenario: not as the campaign began" in capsys.readouterr().err
    assert main(["campaign", "campaign", "--replay", before[0]["variant"]]) == 2
    assert "campaign: scenario: not as in the campaign; allowed: the same as there" in capsys.readouterr().err


def test_a_system_clock_that_jumps_changes_no_result(scenario: str, monkeypatch: pytest.MonkeyPatch) -> None:
    flags = ["--vary", "angle=60:79:10", "--jobs", "1", "--quiet"]
    assert main(["campaign", scenario, *flags]) == 0
    real, steps = time.time, itertools.cycle([0.0, 1e6, -1e6, 3600.0])
    monkeypatch.setattr(time, "time", lambda: real() + next(steps))
    assert main(["campaign", scenario, *flags, "--output", "stepped"]) == 0
    assert rows_in("stepped") == rows_in("campaign")
    assert 0.0 < manifest_in("stepped")["seconds"] < PATIENCE


def test_a_folder_in_use_by_another_campaign_is_refused(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--vary", "angle=60,75", "--jobs", "1", "--quiet"]
    folder = Folder(Path("campaign"))
    folder.create()
    with folder.claimed():
        assert main(["campaign", scenario, *flags]) == 2
    assert "--output campaign: another campaign is running there; allowed: another" in capsys.readouterr().err
    assert main(["campaign", scenario, *flags]) == 0


@pytest.mark.parametrize("is_drawn", [False, True])
def test_the_worst_variant_is_written_as_a_scenario_with_the_same_margin(
    scenario: str, capsys: pytest.CaptureFixture[str], is_drawn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = adaptive.search_worst

    def search_worst(*arguments: Any) -> adaptive.Worst:
        found = ours(*arguments)
        return found._replace(search=found.random, random=found.search) if is_drawn else found

    monkeypatch.setattr(adaptive, "search_worst", search_worst)
    flags = [
        "--vary",
        "angle~uniform(70,79)",
        "--vary",
        "seed~integer(0,99)",
        "--evaluations",
        "30",
        "--jobs",
        "1",
    ]
    assert main(["campaign", scenario, *flags, "--worst", "stays open"]) == 0
    found = manifest_in("campaign")["analysis"]
    out = capsys.readouterr().out
    angle, seed = found["values"]["angle"], found["values"]["seed"]
    least = f"{found['margin']:.6g} {found['margin_unit']} with angle = {angle:.6g} deg, seed = {seed:g}"
    assert f"smallest margin of “stays open”: {least}\n" in out
    assert "as a scenario for other ECUs: campaign/worst.toml" in out
    (line,) = [each for each in out.splitlines() if each.startswith("to run it again: liftgate-hil ")]
    assert main(line.partition("liftgate-hil ")[2].split()) == 0
    page = Path("campaign/report.html").read_text()
    assert "chosen by the search, not a probability" in page
    assert "95 % interval" not in page
    assert found["evaluations"] == 30
    assert found["random"]["evaluations"] == 30
    assert found["margin"] == min(row["margin.stays open"] for row in rows_in("campaign"))
    assert main(["test", "campaign/worst.toml", "--json", "verdicts.json"]) == 1
    (verdict,) = json.loads(Path("verdicts.json").read_text())["scenarios"][0]["expectations"]
    assert verdict["margin"] == found["margin"]


def test_a_campaign_without_its_optional_packages_is_refused(
    scenario: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["campaign", scenario, "--vary", "angle=60"]) == 2
    assert "campaigns need pyarrow; allowed: with liftgate-hil[campaign] installed" in capsys.readouterr().err
    assert not Path("campaign").exists()


def test_a_failure_probability_has_an_interval_and_a_report(scenario: str) -> None:
    flags = ["--vary", "angle~normal(74,0.5)", "--evaluations", "1200", "--duration", "0.7", "--jobs", "1"]
    assert main(["campaign", scenario, *flags, "--quiet", "--probability", "stays open"]) == 0
    found = manifest_in("campaign")["analysis"]
    assert 0.0 <= found["low"] <= found["probability"] <= found["high"] <= 1.0
    assert found["evaluations"] <= 1200
    assert found["without_verdict"] == 0
    assert "Probability of failure" in Path("campaign/report.html").read_text()


def test_an_expectation_on_states_that_fails_with_a_margin_of_0_counts_as_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    never = "[[expect]]\nname = 'unlatched'\nnever = 'latched == 1'\n"
    slope = '[parameters]\nr = 0\n[set]\n"environment.road_slope_deg" = "$r"\n'
    Path("s.toml").write_text(f"duration = 0.2\n{slope}{never}")
    flags = ["--vary", "r~uniform(0,2)", "--evaluations", "1200", "--jobs", "1", "--quiet"]
    assert main(["campaign", "s.toml", *flags, "--probability", "unlatched"]) in (0, 1)
    assert manifest_in("campaign")["analysis"]["probability"] == pytest.approx(1.0)


def test_the_message_for_an_incomplete_campaign_name_has_the_full_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["campaign", "trap-matrix"]) == 2
    assert capsys.readouterr().err == "liftgate-hil: SCENARIO trap-matrix: allowed: pack:trap-matrix\n"


def test_a_damaged_batch_is_evaluated_again(scenario: str) -> None:
    flags = ["--vary", "angle=60:79:8", "--jobs", "1", "--quiet"]
    assert main(["campaign", scenario, *flags]) == 0
    before = rows_in("campaign")
    batches = sorted(Path("campaign/batches").glob("*.parquet"))
    batches[0].write_bytes(batches[0].read_bytes()[:100])
    batches[1].write_bytes(b"")
    assert main(["campaign", scenario, *flags, "--resume"]) == 0
    assert rows_in("campaign") == before


def test_two_ecus_are_compared_variant_by_variant(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--vary", "angle=60,75", "--jobs", "1", "--duration", "3"]
    assert main(["campaign", scenario, *flags, "--against", "mutant:closing_unwatched"]) == 0
    manifest = manifest_in("campaign")
    assert (manifest["variants"], manifest["unfinished"]) == (2, 0)
    found = manifest["analysis"]["against"]
    assert found["variants"] == 2
    assert found["differing"] >= 1
    last = capsys.readouterr().out.splitlines()[-2:]
    ecus = "reference / mutant:closing_unwatched"
    assert last[0].startswith(f"{ecus}: {found['differing']} of 2 variants differ; verdicts: ")
    assert last[1].endswith("campaign.json, against.parquet, differences.parquet")
    table = pq.read_table("campaign/differences.parquet")
    assert table.num_rows == found["differing"]
    assert table["largest_difference"].to_pylist() == sorted(table["largest_difference"].to_pylist(), reverse=True)
    assert "Two ECUs" in Path("campaign/report.html").read_text()


def started(*flags: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "liftgate_hil", "campaign", "short.toml", *flags]
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )


MANY = ("--vary", "angle=60:79:40", "--vary", "supply.voltage=9.5,12,15", "--jobs", "2")


def wait_for_batches(count: int) -> None:
    deadline = time.monotonic() + PATIENCE
    while len(list(Path("campaign/batches").glob("*.parquet"))) < count:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_killed_campaign_is_resumed_to_the_same_results(scenario: str) -> None:
    """Four campaigns of 120 variants in processes, two of them killed on the way."""
    assert main(["campaign", scenario, *MANY, "--output", "whole", "--quiet"]) == 0
    random.seed(5)
    for _ in range(2):
        process = started(*MANY, *(["--resume"] if Path("campaign/campaign.json").exists() else []))
        wait_for_batches(len(list(Path("campaign/batches").glob("*.parquet"))) + random.randrange(1, 12))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    for name in ("campaign/batches/ab.parquet", "campaign/report.html"):  # of one that was killed while it wrote
        Path(name).with_name(name_beside(Path(name).name)).write_text("half")
    assert main(["campaign", scenario, *MANY, "--resume", "--quiet"]) == 0
    assert manifest_in("campaign")["is_complete"] is True
    assert rows_in("campaign") == rows_in("whole")
    assert {each.name for each in Path("campaign").rglob(".*")} == {LOCK}


def test_error_counts_of_a_stopped_campaign_omit_unevaluated_variants(capsys: pytest.CaptureFixture[str]) -> None:
    outcome: Any = SimpleNamespace(
        progress=SimpleNamespace(count=10, done=5),
        counts={"pass": 3, "error": 7},  # the five that were not evaluated are among these
        is_complete=False,
        prepared=SimpleNamespace(against=None),
        seconds=1.0,
        folder=SimpleNamespace(path=Path("campaign")),
        analysis=SimpleNamespace(content={}),
    )
    assert next(outcome_lines(outcome)) == "5 of 10 variants: 2 error, 3 pass; 1.0 s"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_campaign_keeps_its_results_and_says_that_it_is_incomplete(
    scenario: str, number: int, code: int
) -> None:
    """120 variants in three processes stopped by a signal, then resumed."""
    process = started(*MANY)
    wait_for_batches(2)
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == code
    assert b"Traceback" not in err
    rows, found = rows_in("campaign"), manifest_in("campaign")
    unfinished = [row for row in rows if row["error"] == "stopped before it was evaluated"]
    (line,) = [each for each in out.decode().splitlines() if " variants: " in each]
    assert line.startswith(f"{120 - len(unfinished)} of 120 variants: ")
    assert "error" not in line
    assert len(rows) == 120
    assert 0 < len(unfinished) < 120
    assert {row["verdict"] for row in unfinished} == {"error"}
    assert found["is_complete"] is False
    assert "Incomplete" in Path("campaign/report.html").read_text()
    assert main(["campaign", scenario, *MANY, "--resume", "--quiet"]) == 0
    assert not any(row["error"] for row in rows_in("campaign"))


def test_a_store_that_vanishes_is_reported_and_the_campaign_can_be_resumed(scenario: str) -> None:
    """120 variants in three processes that lose their store, then resumed."""
    process = started(*MANY, "--store", "elsewhere")
    deadline = time.monotonic() + PATIENCE
    while len(list(Path("elsewhere").glob("*.parquet"))) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    Path("elsewhere").rename("aside")
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert b"elsewhere" in err
    assert b"Traceback" not in err
    if Path("elsewhere").exists():
        Path("elsewhere").rmdir()
    Path("aside").rename("elsewhere")
    assert main(["campaign", scenario, *MANY, "--store", "elsewhere", "--resume", "--quiet"]) == 0
    assert manifest_in("campaign")["evaluated_now"] < 120


def test_a_campaign_is_complete_only_once_all_its_files_are_written(
    scenario: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write, flags = Folder.write, ["--vary", "angle=60,79", "--jobs", "1", "--quiet"]

    def full(folder: Folder, name: str, content: bytes) -> None:
        if name == DATA:
            raise StoreError(f"{folder.path / name}: full")
        write(folder, name, content)

    with monkeypatch.context() as patch:
        patch.setattr(Folder, "write", full)
        assert main(["campaign", scenario, *flags]) == 1
    assert capsys.readouterr().err == (
        "liftgate-hil: campaign/DATA.md: full; what is in the store is kept: go on with --resume\n"
    )
    assert not manifest_in("campaign")["is_complete"]
    assert main(["campaign", scenario, *flags, "--resume"]) == 0
    assert manifest_in("campaign")["is_complete"]
    assert (Path("campaign") / DATA).exists()


def test_a_shipped_campaign_runs_in_parts_with_one_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ["--vary", "rod=10000", "--vary", "angle=60,70", "--vary", "seed=1", "--samples", "2"]
    flags += ["--vary", "environment.ambient_temperature_degc=20", "--vary", "environment.road_slope_deg=0"]
    flags += ["--jobs", "1", "--quiet"]
    assert (
        main(["campaign", "pack:trap-matrix", *flags, "--vary", "supply.voltage=12", "--jobs", "1", "--quiet"])
        == 0
    )
    assert len(rows_in("campaign/rods")) == 2
    assert len(rows_in("campaign/undisturbed")) == 2
    page = Path("campaign/report.html").read_text()
    assert page.index("Closing onto a rod") < page.index("Nothing in its way") < page.index("worst variants")
    assert main(["campaign", "pack:nothing"]) == 2
