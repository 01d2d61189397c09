"""Every tool runs, shortened, to its end."""

from __future__ import annotations

import hashlib
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.testing import mutation, scenario_files
from tools.anti_trap import page as anti_trap_page
from tools.anti_trap import picture as anti_trap_picture
from tools.anti_trap import study as anti_trap_study
from tools.anti_trap.__main__ import main as anti_trap
from tools.docs import PAGES
from tools.docs import __main__ as docs
from tools.identification import __main__ as identification
from tools.identification import dc_motor, versus
from tools.pack import page as pack_page
from tools.pack.__main__ import main as pack
from tools.scheduling import page as scheduling_page
from tools.scheduling.__main__ import main as scheduling
from tools.scheduling.model import Case

ROOT = Path(__file__).parents[2]

# As a process of its own: arguments, and what it writes.
RUNS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "tools.accuracy": (["--cases", "2", "--jobs", "1", "--output", "{out}"], ("accuracy.md",)),
    "tools.c_translator": ([], ()),
    "tools.equations": (["--mutate", "3.26"], ()),
    "tools.benchmark.campaigns": (["--json", "--rounds", "1"], ()),
    "tools.page": (["memory", "--minutes", "0.05", "--every", "0.2", "--output", "{out}/page.csv"], ("page.csv",)),
}
# What runs the others, all of it in CI.
ELSEWHERE = {
    "tools.anti_trap": "below",
    "tools.docs": "below",
    "tools.identification": "below",
    "tools.pack": "below",
    "tools.scheduling": "below",
    "tools.campaign_study": "tests/tools/test_campaign_study.py",
    "tools.benchmark": "tests/tools/test_benchmark.py",
    "tools.benchmark.peer": "tests/tools/test_benchmark.py, as a process of the benchmark's",
    "tools.benchmark.replays": "tests/tools/test_benchmark.py, as a section",
    "tools.benchmark.page_clients": "tests/tools/test_benchmark.py, as a section",
    "tools.hostile": "tests/tools/test_hostile.py",
    "tools.vcan": "make test-vcan",
    "tools.vcan.guest": "make test-vcan, within the machine",
    "tools.vcan.probe": "make test-vcan",
    "tools.check_package": "make test-package",
    "tools.make_venv": "make setup",
    "tools.pythons": ".ci/run",
    "tools.stages": "make test",
}


def programs() -> set[str]:
    """Names of the modules of all tools that can be started."""
    found = set()
    for path in (ROOT / "tools").rglob("*.py"):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            found.add(".".join(path.relative_to(ROOT).with_suffix("").parts))
    return {name.removesuffix(".__main__") for name in found}


def test_each_tool_is_run_by_some_test() -> None:
    """A new tool gets its line in RUNS, or a test of its own and a line in ELSEWHERE."""
    assert programs() == RUNS.keys() | ELSEWHERE.keys()
    assert not RUNS.keys() & ELSEWHERE.keys()


def test_each_makefile_target_starts_a_tool_tested_here() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    used = set(re.findall(r"-m (tools\.[\w.]+)", text))
    assert used
    assert used <= RUNS.keys() | ELSEWHERE.keys()
    folders = set(re.findall(r"pytest.* (tests/[\w/]+)$", text, re.MULTILINE))
    assert all((ROOT / each).exists() for each in folders)
    targets = set(re.findall(r"^([\w-]+):", text, re.MULTILINE)) - {"setup"}
    (phony,) = re.findall(r"^\.PHONY: (.*)$", text, re.MULTILINE)
    assert targets - set(phony.split()) == set()


@pytest.mark.parametrize("name", RUNS)
def test_a_tool_runs_to_its_end(name: str, tmp_path: Path) -> None:
    """Each a process, with processes of its own."""
    arguments, files = RUNS[name]
    command = [sys.executable, "-m", name, *(each.format(out=tmp_path) for each in arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert files or done.stdout
    for each in files:
        assert (tmp_path / each).stat().st_size > 500, each


def test_make_docs_writes_the_reference_pages_and_the_demo_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two pages only: test_docs.py generates each page."""
    monkeypatch.setattr(docs, "PAGES", {name: PAGES[name] for name in ("scenario.md", "signals.md")})
    monkeypatch.setattr(sys, "argv", ["tools.docs", "--output", str(tmp_path)])
    assert docs.main() == 0
    assert {each.name for each in tmp_path.iterdir()} == {"scenario.md", "signals.md", "demo.png"}
    assert all(each.stat().st_size > 500 for each in tmp_path.iterdir())


def test_the_study_of_scheduling_runs_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small campaigns; scheduler, workers and measured programs are processes, which takes over 5 s."""
    monkeypatch.setattr(scheduling_page, "VARIANTS", (10**3, 10**4))
    monkeypatch.setattr(scheduling_page, "WORKERS", (2, 100))
    monkeypatch.setattr(scheduling_page, "LARGEST", Case(10**4, 100))
    assert scheduling(["--short", "--output", str(tmp_path)]) == 0
    page = (tmp_path / "campaigns-at-scale.md").read_text(encoding="utf-8")
    assert len(page) > 500
    assert page.count("| 10,000 | 100 | ") == 1


def test_the_study_of_the_anti_trap_runs_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The study is of three cars, which takes 5 s of CPU time."""
    conditions = dict(list(anti_trap_study.CONDITIONS.items())[:2])
    values = {"GAPS": (1.0, 30.0), "CONDITIONS": conditions, "FREE": 1, "FACTORS": (0.4, 1.0)}
    for module in (anti_trap_study, anti_trap_page, anti_trap_picture):
        for name in values.keys() & vars(module).keys():
            monkeypatch.setattr(module, name, values[name])
    monkeypatch.setattr(anti_trap_study, "PACES", (1.0, 0.5))
    assert anti_trap(["--cars", "3", "--trade-cars", "3", "--output", str(tmp_path)]) == 0
    page = (tmp_path / "anti-trap.md").read_text(encoding="utf-8")
    assert "| suv |" in page
    assert (tmp_path / "anti-trap.png").stat().st_size > 10_000
    again = tmp_path / "again"
    again.mkdir()
    assert anti_trap(["--drawn-again", str(tmp_path / "anti-trap.json"), "--output", str(again)]) == 0
    assert (again / "anti-trap.md").read_text(encoding="utf-8") == page
    assert (again / "anti-trap.png").read_bytes() == (tmp_path / "anti-trap.png").read_bytes()


GAIN, TIME, DEAD, DELAY = (0.4457, 0.0375, 0.222, 0.0084)  # as docs/identification.md has the public motor


def motor_run(path: Path, volts: np.ndarray) -> None:
    """Columns as in the public data, of a motor with known truth: a voltage and the integer counts each 20 ms."""
    fine, period, counts = 2e-4, 0.02, 2800
    times = np.arange(len(volts) * round(period / fine)) * fine
    held = volts[np.clip(((times - DELAY) / period).astype(int), 0, None)] * (times >= DELAY)
    speed, turned, place = 0.0, np.zeros(len(times) + 1), 0.0
    for k, volt in enumerate(held):
        target = GAIN * max(float(volt) - DEAD, 0.0)
        speed = target + (speed - target) * math.exp(-fine / TIME)
        place += speed * fine
        turned[k + 1] = place
    seen = np.floor(turned[:: round(period / fine)] * counts)
    shown = np.diff(seen, prepend=0.0)[: len(volts)] / counts / period * 360.0
    rows = np.column_stack([np.arange(len(volts)) * period, volts, shown])
    np.savetxt(path, rows, delimiter=",", header="t,u,y", comments="", fmt="%.6f")


@pytest.fixture
def motor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in place of the public data: a two-level sequence, and steps."""
    folder = tmp_path / "data"
    folder.mkdir()
    chance = np.random.default_rng(1)
    levels = np.repeat(chance.choice([1.5, 4.0], 120), chance.integers(5, 15, 120))
    steps = np.repeat([2.0, 4.5, 1.5, 3.0], 60)
    for name, volts in zip(dc_motor.FILES, (levels, steps), strict=True):
        motor_run(folder / name, volts)
        digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        monkeypatch.setitem(dc_motor.FILES, name, digest)
    return folder


def test_the_study_of_a_public_motor_finds_the_parameters_of_a_simulated_one(motor: Path, tmp_path: Path) -> None:
    """With the vehicle file that stands for a motor alone."""
    found = dc_motor.measure(motor, tmp_path)
    assert found.gain[0] == pytest.approx(GAIN, rel=0.005)
    assert found.time_constant[0] == pytest.approx(TIME, rel=0.03)
    assert found.dead_voltage[0] == pytest.approx(DEAD, abs=0.02)
    assert found.delay[0] == pytest.approx(DELAY, abs=0.001)
    assert min(found.fit, found.fit_other) > 90.0


def test_the_study_of_identification_runs_to_its_end(
    motor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The study has all of its sections, of one seed; the identifications take 10 s of CPU time."""
    make_data, ours = versus.make_data, versus.ours
    monkeypatch.setattr(versus, "make_data", lambda path, ripple, _: make_data(path, ripple, 1.0))
    monkeypatch.setattr(versus, "ours", lambda path, result: ours(path, result, 1))
    flags = ["--short", "--seeds", "1", "--dc-motor", str(motor), "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["tools.identification", *flags])
    assert identification.main() == 0
    page = (tmp_path / "identification.md").read_text(encoding="utf-8")
    headings = [line[3:] for line in page.splitlines() if line.startswith("## ")]
    assert headings == [
        "The three runs of the thesis",
        "Do the intervals cover? 1 seeds each",
        "Speed: run 1 at 1 kHz",
        "A motor measured by others",
    ]
    assert (tmp_path / "identification.png").stat().st_size > 10_000
    monkeypatch.setattr(sys, "argv", ["tools.identification", "--data", str(tmp_path)])
    assert identification.main() == 0
    assert (tmp_path / "closing.csv").exists()
    drawn = (tmp_path / "identification.png").read_bytes()
    (tmp_path / "identification.png").unlink()
    monkeypatch.setattr(sys, "argv", ["tools.identification", "--picture", "--output", str(tmp_path)])
    assert identification.main() == 0
    assert (tmp_path / "identification.png").read_bytes() == drawn


def test_the_shortened_studies_run_to_their_ends() -> None:
    """The first case of each, with two seeds; `make study` judges the results."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/study"]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "STUDY": "short"}, capture_output=True, text=True,
        check=False, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    (count,) = re.findall(r"^(\d+) passed", done.stdout, re.MULTILINE)
    texts = [each.read_text() for each in (ROOT / "tests/study").glob("test_*.py")]
    assert int(count) == sum(text.count("\ndef test_") for text in texts)


@pytest.mark.realtime
def test_the_pack_in_real_time_runs_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The pack is one scenario of 1 s here."""
    path = tmp_path / "rests.toml"
    path.write_text('duration = 1.0\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n')
    monkeypatch.setattr(scenario_files, "scenario_files", lambda _: [path])
    assert pack(["--realtime", "rests"]) == 0
    told = capsys.readouterr().out
    assert told.count("realtime: ") == 2
    assert "Beside two busy processes: " in told


def test_the_tool_for_the_packs_page_runs_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With one scenario and two of the mutants."""
    files = scenario_files.scenario_files(["pack"])
    chosen = [each for each in files if each.stem == "motor_short"]
    few = dict(list(mutation.MUTANTS.items())[:2])
    monkeypatch.setattr(scenario_files, "scenario_files", lambda _: chosen)
    for module in (mutation, pack_page):
        monkeypatch.setattr(module, "MUTANTS", few)
    assert pack(["--output", str(tmp_path)]) == 0
    text = (tmp_path / "pack.md").read_text(encoding="utf-8")
    assert "| `motor_short` | pass |" in text
    assert "of 2 are found" in text
