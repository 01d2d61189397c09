"""The blocks of the manual's pages as they stand there: Python runs, TOML loads, files serve the page's commands.

A block whose first line is `# NAME.toml` (`.py`, `.c`) is that file. The pages of `readme.in_order` are gone
through from top to bottom: each file is written, each command is run and writes what its flags say, and each line
of the fenced block of text behind a command is in what it printed.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import readme
from readme import Block

from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.vehicle import vehicle_of
from liftgate_hil.measurement.mapping import parse_maps

DOCS = readme.ROOT / "docs"
PAGES = [path for path in readme.pages() if path.name != "python-api.md"]
BLOCKS = {path.name: readme.blocks(path) for path in PAGES}
SUV = tomllib.loads((data_root() / "configs/vehicles/suv.toml").read_text(encoding="utf-8"))
IN_A_RIG = {"dbc", "inputs", "outputs", "messages", "requests", "reset", "inject", "diagnostics", "bitrate"}
# Loaded elsewhere: together with what their page says around them.
LOADED_ELSEWHERE = {
    "own-dbc.md": "tests/system/test_newcomer.py: with and without end-to-end protection",
    "rig.md": "tests/tools/test_docs.py: with somebody else's message",
}

# What a page says in words, for its tests: `Ecu` stands for an ECU that answers UDS, as the reference ECU does.
ECU_WITH_UDS = f"""\
import sys

import liftgate_hil.config.can_libraries  # before can, which with all of its formats takes 4 s of CPU
import can

sys.path += [{str(readme.ROOT / "tests/hil")!r}]
from hil_support import Wire, shipped_rig
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.peer import Peer


class Ecu:
    def __init__(self):
        self.wire = Wire()
        self.peer = Peer(adapter_for("reference", shipped_rig(), 2), self.wire)

    def request(self, action):
        assert self.peer.request(action)

    def step(self, now_s, frames):
        self.wire.inbox = [(each.arbitration_id, bytes(each.data)) for each in frames]
        self.peer.poll(round(now_s * 1e9))
        sent, self.wire.sent = self.wire.sent, []
        return [can.Message(arbitration_id=one, data=data, is_extended_id=False) for one, data in sent]


"""
TOLD = {"pytest.md": ECU_WITH_UDS}


def of_kind(kind: str) -> list[Block]:
    return [block for blocks in BLOCKS.values() for block in blocks if block.kind == kind]


def is_test(block: Block) -> bool:
    return re.search(r"^def test_", block.text, re.MULTILINE) is not None


def work(folder: Path, page: str) -> Path:
    """Make a folder with the files of a checkout that the page's commands use, and the page's own files."""
    made = readme.fresh_folder(folder)
    for block in BLOCKS[page]:
        if block.file:
            (made / block.file).parent.mkdir(parents=True, exist_ok=True)
            (made / block.file).write_text(block.text, encoding="utf-8")
    return made


def words(text: str) -> str:
    return " ".join(text.split())


def execute(text: str, names: dict[str, Any], folder: Path) -> str:
    """Output of Python code that continues with the names left by the previous block of its page."""

    def execution() -> int:
        sys.path.insert(0, str(folder))
        exec(compile(text, "page.py", "exec"), names)
        return 0

    _, out, complaints = readme.called(execution, folder)
    assert not complaints
    return out


def blocks_with_tests() -> list[Block]:
    return [block for block in of_kind("python") if is_test(block) and not block.file]


@pytest.mark.parametrize("number", range(len(blocks_with_tests())))
def test_the_tests_shown_on_a_page_pass(number: int, tmp_path: Path) -> None:
    block = blocks_with_tests()[number]
    folder = work(tmp_path, block.page)
    (folder / "test_of_the_page.py").write_text(TOLD.get(block.page, "") + block.text)
    out = readme.run("python -m pytest -q -p no:cacheprovider test_of_the_page.py", folder)
    assert re.search(r"\d+ passed", out), out
    assert "failed" not in out


@pytest.mark.parametrize("number", range(len(of_kind("toml"))))
def test_every_toml_block_of_the_manual_loads(number: int, tmp_path: Path) -> None:
    block = of_kind("toml")[number]
    content = tomllib.loads(block.text)
    path = tmp_path / "file.toml"
    if block.page in LOADED_ELSEWHERE:
        return
    if content.keys() & IN_A_RIG:
        shipped = (data_root() / "configs/rigs/liftgate.toml").read_text(encoding="utf-8")
        for table in content:
            shipped = re.sub(rf"^\[{table}\b[^\[]*", "", shipped, flags=re.MULTILINE)
        (tmp_path / "liftgate.dbc").write_bytes((data_root() / "dbc/liftgate.dbc").read_bytes())
        path.write_text(shipped + block.text)
        assert load_rig(path)
    elif content.keys() == {"columns"}:
        path.write_text(block.text)
        assert parse_maps([str(path)])
    elif content.keys() <= SUV.keys() | {"left", "right", "thermal", "clutch", "cutout", "bridge", "friction"}:
        assert vehicle_of({**SUV, **content}, str(path))
    else:
        path.write_text(block.text)
        assert load_scenario(path)


def test_each_shown_part_of_the_github_workflow_is_in_the_shipped_one() -> None:
    workflow = (data_root() / "configs/starter/workflow.yml").read_text(encoding="utf-8").splitlines()
    page = BLOCKS["first-ci-test.md"]
    blocks = [each for each in page if each.kind == "yaml" and not each.text.startswith("# In .gitlab-ci.yml")]
    shown = [line for block in blocks for line in block.text.splitlines()]
    assert shown
    assert [line for line in shown if line not in workflow] == []


def test_commands_shown_for_other_ci_systems_run(tmp_path: Path) -> None:
    files = [*of_kind("yaml"), *of_kind("groovy")]
    commands = {found for block in files for found in re.findall(r"(liftgate-hil test [^'\n]+)", block.text)}
    assert commands
    readme.run("liftgate-hil init gate", tmp_path)
    for command in commands:
        assert "4 pass" in readme.run(command, tmp_path)
        names = sorted(each.name for each in (tmp_path / "results").iterdir())
        assert names == ["junit.xml", "report.html", "verdicts.json"]


def test_commands_in_the_manual_are_only_in_blocks_that_the_tests_run() -> None:
    """Lines that begin with a program of this machine are commands, but in a script, which a test runs."""
    others = [
        block
        for blocks in BLOCKS.values()
        for block in blocks
        if block.kind in ("plain", "sh", "bash") and not block.text.startswith("#!")
    ]
    starts = {line.split()[0]: block.page for block in others for line in block.text.splitlines() if line.strip()}
    shells = ("$", "#!", "cd", "docker", "export", "pip", "podman", "source")
    found = {word: page for word, page in starts.items() if word in shells or shutil.which(word)}
    assert found.keys() <= {"time", "kubectl"}, found  # a row of the panel; what needs a cluster


def test_no_plain_or_text_block_of_the_manual_contains_python() -> None:
    known = {"commands", "python", "toml", "text", "plain", "c", "yaml", "groovy", "dockerfile", "sh", "{toctree}"}
    for blocks in BLOCKS.values():
        for block in blocks:
            assert block.kind in known, (block.page, block.kind)
            is_code = re.search(r"^(import|from|def|class|with|for) .*[\w:]$", block.text, re.MULTILINE)
            assert block.kind not in ("plain", "text") or not is_code, (block.page, block.text)


def test_every_file_shown_on_a_page_is_used_on_it() -> None:
    for name, blocks in BLOCKS.items():
        for block in blocks:
            others = [each.text for each in blocks if each is not block]
            path = Path(block.file)
            used = {path.parent.name or path.name, path.stem if path.suffix == ".py" else path.name} - {""}
            assert not block.file or any(each in text for text in others for each in used), (name, block.file)


@pytest.mark.parametrize("page", readme.in_order())
def test_a_page_run_from_top_to_bottom_writes_and_prints_what_it_shows(page: str, tmp_path: Path) -> None:
    """Every command of the page: each run of an ECU in C or Python has its own process, and so has pytest. Those
    on campaigns, measurements and recordings need some 50 runs, four fits and five pictures.
    """
    if shutil.which("cc") is None and any(re.search(r"^(cc|make -C) ", each.text, re.M) for each in BLOCKS[page]):
        pytest.skip("no C compiler")
    folder = readme.fresh_folder(tmp_path)
    before, places = readme.AROUND.get(page, readme.Around())
    for line in before:
        readme.run(line, folder)
    told = ""
    is_shown = False
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in BLOCKS[page]:
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.kind == "commands":
            told = ""
            for line, code in readme.commands_in(block):
                if line in readme.run_elsewhere():
                    continue
                found, out, complaints = readme.outcome(line, folder, places)
                assert found == code, (line, out, complaints)
                assert "Traceback" not in complaints
                assert [each for each in readme.written_by(line) if not (folder / each).exists()] == []
                told += out + complaints
            is_shown = True
        elif block.kind == "python" and not is_test(block):
            told = execute(block.text, names, folder)
            is_shown = True
        elif block.kind == "text" and is_shown:
            for line in block.text.splitlines():
                assert line.strip() in ("", "…") or words(line) in words(told), (line, told)
            is_shown = False


def test_dockerfile_lines_in_the_manual_are_those_of_the_example() -> None:
    lines = (DOCS / "examples" / "Dockerfile").read_text(encoding="utf-8").splitlines()
    shown = [line for block in of_kind("dockerfile") for line in block.text.splitlines()]
    assert shown
    assert [line for line in shown if line not in lines] == []


@pytest.mark.realtime
@pytest.mark.skipif(shutil.which("taskset") is None, reason="no taskset")
def test_the_manuals_taskset_commands_bind_the_loop_to_a_cpu(tmp_path: Path) -> None:
    """The doctor waits 5 s for drivers to answer."""
    doctor = readme.command("taskset -c 0-3 liftgate-hil doctor")
    gate = readme.command("taskset -c 0-3 liftgate-hil --bus")
    cpu = max(os.sched_getaffinity(0))
    here = {"-c 0-3": f"-c {cpu}", "--cpu 3": f"--cpu {cpu}", "--duration 60": "--duration 0.2"}
    out = readme.run(doctor, tmp_path, here, codes=(0, 1))
    assert f"--realtime takes CPU {cpu}" in out
    here["socketcan:can0"] = f"udp_multicast:239.78.{os.getpid() % 250}.{cpu + 1}"
    out = readme.run(gate, tmp_path, here, "--overrun-limit 60 --duration 0.3")
    assert out.startswith("ticks ")


@pytest.mark.realtime
@pytest.mark.parametrize("is_recording", [False, True])
def test_the_manuals_example_forwards_the_live_stream_as_datagrams(
    is_recording: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = work(tmp_path, "live-data.md")
    source = "liftgate-hil --bus virtual:any --ecu reference --scenario demo --dashboard --overrun-limit 60"
    if is_recording:
        readme.run("liftgate-hil demo --clock free --no-record --record live.csv --duration 3", folder)
        source = "liftgate-hil dashboard --recording live.csv"
    gate = readme.start(source, folder, more="--listen 127.0.0.1:0")
    processes = [gate]
    try:
        told = gate.stdout if is_recording else gate.stderr
        assert told is not None
        address, token = next(each for each in told if each.startswith("http")).strip().split("/?token=")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.bind(("127.0.0.1", 0))
            udp.settimeout(readme.PATIENCE)
            places = {"http://127.0.0.1:8765": address, "$TOKEN": token, "9870": str(udp.getsockname()[1])}
            processes.append(readme.start(readme.command("python live_udp.py"), folder, places, " "))
            samples = [json.loads(udp.recv(65536)) for _ in range(10)]
        assert samples[-1]["timestamp"] > samples[0]["timestamp"]
        assert samples[-1]["truth"]["gate_angle_deg"] >= 0.0
        assert "left_current_a" in samples[-1]["sensed"]
        gate.send_signal(signal.SIGINT)
        assert gate.wait(readme.PATIENCE) == 0
        out, complaints = processes[1].communicate(timeout=readme.PATIENCE)
        assert (processes[1].returncode, complaints) == (0, ""), out
    finally:
        for process in processes:
            process.kill()
