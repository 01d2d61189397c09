"""A newcomer's path: every command of README.md and docs, and those printed by `init`, run in a fresh folder.

Pages are gone through by test_manual_blocks.py. Here are the commands that need company: what is not here (a bus,
a serial port) is replaced by what is, in `places`; what would run for ever gets a --duration.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import can
import pytest
import readme
from c_ecu import needs_compiler, serial_line
from hil_support import wait_for
from readme import command, run, start

SHORT = "--overrun-limit 60 --duration 0.3"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Working directory of the user."""
    return readme.fresh_folder(tmp_path_factory.mktemp("newcomer"))


@pytest.fixture(scope="module")
def demo(folder: Path) -> Path:
    """The folder `out` with the demo's recordings."""
    (folder / "out").mkdir(exist_ok=True)
    run("liftgate-hil demo --clock free --output out", folder)
    return folder / "out"


@pytest.fixture
def bus() -> dict[str, str]:
    """Name of a bus for this test only, in place of README's."""
    group = f"239.77.{os.getpid() % 250}.{time.monotonic_ns() % 250 + 1}"
    return {"socketcan:can0": f"udp_multicast:{group}", "239.74.163.2": group}


@pytest.fixture
def ports() -> Iterator[dict[str, str]]:
    """The two ends of a serial line, in place of README's ports."""
    with serial_line() as (ours, theirs):
        yield {"/dev/ttyUSB0": ours, "/dev/ttyUSB1": theirs}


@contextlib.contextmanager
def served(line: str, folder: Path, places: Mapping[str, str] | None = None) -> Iterator[list[str]]:
    """Address and token of a page, whose command is ended by Ctrl-C without an error."""
    page = start(line, folder, places, "--listen 127.0.0.1:0")
    try:
        assert page.stdout is not None
        yield page.stdout.readline().strip().split("/?token=")
        page.send_signal(signal.SIGINT)
        assert page.wait(readme.PATIENCE) == 0
    finally:
        page.kill()


def test_the_readme_is_one_page() -> None:
    page = (readme.ROOT / "README.md").read_bytes()
    assert len(page.splitlines()) <= 150
    assert len(page) <= 8_000


def test_every_page_is_reachable_from_the_readme_and_every_link_resolves() -> None:
    reached = set()
    for page in readme.pages():
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            path, _, anchor = target.partition("#")
            if "://" in target:
                continue
            assert not anchor, f"{page.name}: {target}: a page is a topic, link it as a whole"
            found = (page.parent / path).resolve()
            assert found.exists(), f"{page.name}: {target}"
            reached |= {found} if page.name == "README.md" else set()
    assert reached >= {*readme.pages()[1:]}


def test_every_command_of_the_pages_is_run_or_listed_as_run_elsewhere() -> None:
    gone_through = [block for name in readme.in_order() for block in readme.blocks(readme.ROOT / "docs" / name)]
    run_there = {line for each in gone_through if each.kind == "commands" for line, _ in readme.commands_in(each)}
    assert {*readme.commands()} - run_there - readme.run_elsewhere() == set()
    listed = [command(each) for each in readme.ELSEWHERE]
    assert len({*listed}) == len(listed)
    assert {*listed} & readme.asked_for() == set()
    every_block = [each for page in readme.pages() for each in readme.blocks(page)]
    assert {*readme.NOT_IN_ORDER} <= {each.page for each in every_block if each.kind == "commands"}


# A folder to start from.


def test_the_manuals_uname_command_prints_the_kernels_build(folder: Path) -> None:
    assert run(command("uname -v"), folder).startswith("#")


def test_the_commands_printed_by_init_run_unchanged(folder: Path) -> None:
    """All steps as programs: pytest twice, a build of the ECU in C, and two runs of it in a process of its own."""
    out = run("liftgate-hil init gate", folder)
    steps = [re.split(r" {2,}#", line)[0].strip() for line in out.split("next:")[1].splitlines()]
    cd, check, demo, test, pytest_, make, *in_c, gate, ecu, port, serial = (
        step for step in steps if step and not step.startswith("#")
    )
    assert cd == "cd gate"
    inside = folder / "gate"
    assert "fits vehicle.toml" in run(check, inside)
    assert "closed and latched" in run(demo, inside)
    assert "presses softly: pass" in run(test, inside)
    assert " passed" in run(f"{pytest_} -p no:cacheprovider", inside)
    run(make, inside)
    demo, test, pytest_ = in_c
    assert "reversed" in run(demo, inside)
    assert "presses softly: fail" in run(test, inside, codes=(1,))
    for step, wire in ((ecu, "can0"), (serial, "/dev/ttyUSB1")):
        program, said = step.split()
        assert os.access(inside / program, os.X_OK)
        assert said == wire
    assert "--bus socketcan:can0" in gate  # on a vcan0: tests/vcan
    assert "--serial /dev/ttyUSB0" in port  # on a line: tests/system/test_serial_ecu.py
    # From outside of the folder, as the page has it, all the same.
    from_outside = command("python -m pytest gate --liftgate-ecu")
    assert pytest_ == from_outside.replace(" gate ", " ").replace(" gate/", " ")
    out = run(from_outside, folder, more="-p no:cacheprovider", codes=(1,))
    assert "presses softly: fail" in out
    assert "2 failed, 4 passed" in out


def test_the_doctor_command_prints_a_verdict(folder: Path) -> None:
    """The doctor waits 5 s for drivers to answer."""
    out = run(command("liftgate-hil doctor"), folder, more="--duration 0.2", codes=(0, 1))
    assert "verdict" in out


# On a bus.


@pytest.mark.realtime
@pytest.mark.parametrize(
    "line",
    [command("liftgate-hil --bus socketcan:can0"), command("liftgate-hil --bus socketcan:can0 --rate 2000")],
)
def test_the_gate_on_a_bus_prints_a_summary(folder: Path, bus: dict[str, str], line: str) -> None:
    assert run(line, folder, bus, SHORT).startswith("ticks ")


@pytest.mark.realtime
def test_a_run_on_a_bus_writes_its_recordings(folder: Path, bus: dict[str, str]) -> None:
    run(command("liftgate-hil --bus socketcan:can0 --vehicle compact"), folder, bus, SHORT)
    with can.LogReader(folder / "run.blf") as frames:
        stamps = [frame.timestamp for frame in frames]
    assert len(stamps) > 50
    assert stamps[0] > 1e9  # the computer's time
    assert len((folder / "run.csv").read_text().splitlines()) > 100


@pytest.mark.realtime
def test_gate_ecu_and_logger_communicate_on_a_bus(folder: Path, bus: dict[str, str]) -> None:
    log = folder / "run.log"
    logger = start(command("python -m can.logger"), folder, bus, " ")
    gate = start(command("liftgate-hil --bus udp_multicast"), folder, bus, "--overrun-limit 60")
    ecu = start(command("liftgate-hil ecu --bus udp_multicast"), folder, bus, " ")
    try:
        wait_for(lambda: log.is_file() and log.read_text().count(" 120#") > 20, "the ECU was not heard")
        for process in (ecu, gate, logger):
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=readme.PATIENCE)
        assert (gate.returncode, ecu.returncode) == (0, 0)
    finally:
        for process in (logger, gate, ecu):
            process.kill()
    decoded = run("cantools decode --single-line dbc/liftgate.dbc < run.log", folder)
    assert "DriveCommand(" in decoded
    assert "Unknown" not in decoded


@pytest.mark.realtime
def test_recordings_are_replayed_onto_a_bus(folder: Path, bus: dict[str, str]) -> None:
    """Two replays in real time, and the recordings for them."""
    run("liftgate-hil --bus virtual:any --clock free --duration 0.5 --record run.blf", folder)
    told = run(command("liftgate-hil replay run.blf"), folder, bus)
    assert re.match(r"frames sent \d{3} \(recorded as sent\), in 0\.", told)
    assert "\nlateness p50 " in told
    run("liftgate-hil --bus virtual:any --clock free --duration 21 --record their.asc", folder)
    once = {**bus, "--loop": "--speed 10"}
    told = run(command("liftgate-hil replay their.asc"), folder, once)
    took = re.match(r"frames sent 9\d{3} \(recorded as sent\), in (\d+\.\d+) s", told)
    # 7 s of the recording at ten times the speed: not sooner; a machine may be late.
    assert took
    assert 0.69 < float(took[1]) < 7


@pytest.mark.realtime
def test_a_run_recorded_with_a_trigger_reports_that_it_never_came(folder: Path, bus: dict[str, str]) -> None:
    told = run(command("liftgate-hil --bus socketcan:can0 --record trapped.mf4"), folder, bus, SHORT)
    assert "recorded only around the trigger, which never came" in told
    assert (folder / "trapped.mf4").is_file()


# The operator's page.


@pytest.mark.realtime
@pytest.mark.skipif(shutil.which("curl") is None, reason="no curl")
def test_curl_scripts_control_a_run_through_its_page(
    folder: Path, bus: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two programs with their web servers, and four calls of curl, in real time."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    line = command("liftgate-hil --bus socketcan:can0 --dashboard")
    gate = start(line, folder, bus, "--overrun-limit 60 --listen 127.0.0.1:0")
    try:
        assert gate.stderr is not None
        told = next(each for each in gate.stderr if each.startswith("http"))
        address, token = told.strip().split("/?token=")
        places = {"http://127.0.0.1:8765": address, "$TOKEN": token, "curl": "curl -sS"}
        asked = command('curl "').replace("$TOKEN", token).replace("http://127.0.0.1:8765", address)
        assert '"gate_angle_deg":' in run(asked, folder)
        for asked, done in (
            (command('curl -d \'{"fault"'), "fault kind spring_lost, where left"),
            (command('curl -d \'{"signal"'), "signal Body.VehicleSpeed 5, Body.Ignition on"),
            (command('curl -d \'{"clear"'), "clear all"),
        ):
            assert f'"done":"{done}"' in run(asked, folder, places)
        with served(command("liftgate-hil dashboard"), folder) as (page, _):
            assert page.startswith("http://127.0.0.1:")
        gate.send_signal(signal.SIGINT)
        gate.communicate(timeout=readme.PATIENCE)
        assert gate.returncode == 0
    finally:
        gate.kill()


@pytest.mark.realtime
@pytest.mark.usefixtures("demo")
def test_the_manuals_command_serves_the_page_of_a_recording(folder: Path) -> None:
    with served(command("liftgate-hil dashboard --recording"), folder) as (address, _):
        assert address.startswith("http://127.0.0.1:")


@pytest.mark.realtime
def test_scenarios_are_started_from_the_page(folder: Path) -> None:
    (folder / "scenarios").mkdir(exist_ok=True)
    (folder / "scenarios" / "reverses.toml").write_text(readme.block("duration = 25.0"))
    with served(command("liftgate-hil dashboard --scenarios"), folder, {"FOLDER": "scenarios"}) as (
        address,
        token,
    ):
        for scenario, said in (('"reverses.toml"', '"running":"reverses.toml"'), ("null", '"running":null')):
            body = f'{{"scenario": {scenario}}}'
            assert said in run(f"curl -sS -d '{body}' '{address}/api/run?token={token}'", folder)


# An own database.


@pytest.mark.realtime
@pytest.mark.parametrize("protection", ["simple", "e2e"])
def test_a_rig_for_the_users_database_runs(folder: Path, bus: dict[str, str], protection: str) -> None:
    page = readme.blocks(readme.ROOT / "docs" / "own-dbc.md")
    rig = next(block.text for block in page if block.file == "tailgate.toml")
    if protection == "e2e":
        rig = rig.split("[messages.TG_Cmd]")[0] + "[messages.TG_Cmd]\n" + readme.block('protection = "e2e-p01"')
    (folder / "tailgate.toml").write_text(rig)
    out = run(command("liftgate-hil --rig tailgate.toml"), folder, bus, f"--vehicle compact {SHORT}")
    assert "frames sent" in out
    run(command("liftgate-hil ecu --rig tailgate.toml"), folder, bus, "--duration 0.3")


# A serial line.


@pytest.mark.realtime
def test_the_manuals_commands_for_a_serial_line_run(folder: Path, ports: dict[str, str]) -> None:
    """Three runs in real time, each a process that begins with its imports, and the ECU's process of the demo."""
    run(command("liftgate-hil --serial /dev/ttyUSB0"), folder, ports, SHORT)
    demo = command("liftgate-hil demo --serial")
    told = run(demo, folder, ports, "--overrun-limit 60 --duration 2")
    (accepted,) = re.findall(r"commands accepted (\d+)", told)
    assert int(accepted) > 50
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()
        link: list[socket.socket] = []
        threading.Thread(target=lambda: link.append(server.accept()[0]), daemon=True).start()
        line = command("liftgate-hil --serial socket:")
        run(line, folder, {"192.168.0.7:7000": f"{host}:{port}"}, SHORT)
        assert len(link[0].recv(4096)) > 100
        link[0].close()


@needs_compiler
@pytest.mark.realtime
def test_the_manuals_ecu_in_c_runs_on_a_serial_line(folder: Path, ports: dict[str, str]) -> None:
    run(command("make -C tools/ecu"), folder)
    gate = start(command("liftgate-hil --serial /dev/ttyUSB0"), folder, ports, "--overrun-limit 60")
    ecu = start(command("tools/ecu/build/ecu-serial"), folder, ports, str(readme.PATIENCE))
    try:
        assert ecu.stderr is not None
        assert "opening" in ecu.stderr.readline()
        gate.send_signal(signal.SIGINT)
        out, complaints = gate.communicate(timeout=readme.PATIENCE)
        assert gate.returncode == 0, complaints
        assert "rejected 0" in out
    finally:
        for process in (gate, ecu):
            process.kill()


# An own ECU.


@pytest.mark.realtime
def test_an_own_ecu_in_python_runs_on_a_bus(folder: Path, bus: dict[str, str]) -> None:
    page = readme.ROOT / "docs" / "ecu-in-python.md"
    (module,) = (block for block in readme.blocks(page) if block.file == "my_ecu.py")
    (folder / module.file).write_text(module.text)
    run(command("liftgate-hil ecu --bus socketcan:can0"), folder, bus, "--duration 0.3")
