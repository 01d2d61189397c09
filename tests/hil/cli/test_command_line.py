"""The command line: exit codes, one line per issue, and no heavy imports where they are not needed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import uuid
from importlib import metadata
from pathlib import Path

import can
import pytest

import liftgate_hil
import liftgate_hil as lh
from liftgate_hil.cli.commands import COMMANDS
from liftgate_hil.cli.main import main
from liftgate_hil.drive.realtime_driver import RealtimeDriver
from liftgate_hil.errors import OverrunError
from liftgate_hil.plan import plan
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.version import version

ROOT = Path(__file__).parents[3]


@pytest.fixture
def bus() -> str:
    return f"virtual:{uuid.uuid4()}"


def call(*arguments: str) -> int:
    """Call the command line, and return its exit code, returned or raised."""
    try:
        return main(list(arguments))
    except SystemExit as leaving:
        return int(leaving.code or 0)


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """Return the lines on stderr of a call that must be refused as wrong usage or configuration."""
    assert call(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    return captured.err.splitlines()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rate", "0"], "200 to 10000"),
        (["--nosuch"], "unrecognized arguments: --nosuch; allowed: "),
        (["--dur", "1"], "; allowed: --duration, "),
        (["rig", "check", "liftgate", "--vehicel", "suv"], "--vehicle, "),
        (["rig", "draft", "their.dbc", "--out", "x"], "--output"),
        (["identfy"], "no subcommand 'identfy'; allowed: identify, "),
        (["--vehicle", "nosuch"], "nosuch"),
        (["--set", "motor.volts=3"], "motor.volts"),
        (["--cpu", "0", "--no-realtime"], "--cpu 0: allowed: together with --realtime"),
        (["--realtime", "--cpu", "1023"], "cpu 1023: allowed here: "),
        (["--record", "x.pcap"], ".csv"),
        (["--record", "/nosuch/x.csv"], "/nosuch"),
    ],
    ids=" ".join,
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], bus: str, arguments: list[str], said: str
):
    first = arguments if not arguments[0].startswith("--") else []
    rest = [] if first else arguments
    lines = complaint(capsys, *first, "--bus", bus, "--clock", "free", "--duration", "0.01", *rest)
    assert len(lines) == 1
    assert said in lines[0]
    assert lines[0].startswith("liftgate-hil")


def test_real_time_is_refused_on_a_system_that_cannot_run_its_loop(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "POSSIBLE", False)
    for command in (["--ecu", "reference"], ["demo", "--no-record"]):
        assert complaint(capsys, *command, "--duration", "0.01") == [
            "liftgate-hil: --clock realtime: not possible on this platform; allowed: 64-bit little-endian Linux; "
            "free and lockstep run everywhere"
        ]
    for clock in ("free", "lockstep"):
        assert call("--ecu", "reference", "--clock", clock, "--duration", "0.01", "--quiet") == 0


@pytest.mark.parametrize("clock", ["free", "lockstep", "realtime"])
def test_an_ecu_in_the_same_process_needs_no_bus(capsys: pytest.CaptureFixture[str], clock: str) -> None:
    of = ["--clock", clock, "--ecu", "reference", "--duration", "0.05", "--overrun-limit", "3600"]
    assert main(of) == 0
    told = capsys.readouterr()
    accepted = re.search(r"commands accepted (\d+),", told.out)
    assert accepted is not None
    assert int(accepted[1]) == 5 or (clock == "realtime" and accepted[1] != "0")  # others in a tick made up for
    assert "ignored" not in told.err


def test_a_bus_configured_for_python_can_is_used_without_the_bus_flag(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "configured")
    assert main(["--ecu", "reference", "--duration", "0.05", "--overrun-limit", "3600"]) == 0
    assert "suv on configured" in capsys.readouterr().err


def test_one_earlier_recording_of_a_name_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str], bus: str):
    path = tmp_path / "run.csv"
    run = ["--bus", bus, "--clock", "free", "--ecu", "reference", "--record", str(path), "--duration"]
    contents = []
    for seconds in ("0.01", "0.02", "0.03"):
        assert call(*run, seconds) == 0
        contents.append(path.read_bytes())
    aside = tmp_path / "run.previous.csv"
    assert sorted(tmp_path.iterdir()) == [path, aside]
    assert aside.read_bytes() == contents[1]
    assert capsys.readouterr().err.count(f"{path}: the recording that was there is now {aside}") == 2
    assert call(*run, "0.01", "--vehicle", "nosuch") == 2
    assert path.read_bytes() == contents[2]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--bus", "vcan0"], "INTERFACE:CHANNEL"),
        (["--bus", "pcan:x@fast"], "fast"),
        (["--bus", "nosuch:0"], "nosuch"),
        (["--bus", "virtual:x", "-i", "virtual"], "one or the other"),
        (["ecu", "--bus", "vcan0"], "INTERFACE:CHANNEL"),
        (["--bus", "socketcan:vcan0@250000"], "a bit rate on socketcan, where it is set with `ip link`"),
        (["--bus", "socketcan:vcan0", "-b", "250000"], "a bit rate on socketcan"),
        (["-i", "udp_multicast", "-c", "239.74.163.2", "-b", "250000"], "a bit rate on udp_multicast"),
        (["--serial", "loop://", "--bus", "virtual:x"], "one or the other"),
        (["--serial", "loop://", "-c", "x"], "one or the other"),
        (["--serial", "loop://", "--fd"], "one or the other"),
        (["ecu", "--serial", "loop://", "-b", "5"], "one or the other"),
        (["--serial", "nosuch://x"], "'nosuch'"),
        (["--serial", "/dev/ttyUSB0@0"], "20000000 baud"),
        (["ecu", "--serial", "socket://x"], "HOST:PORT"),
        (["demo", "--serial", "loop://"], "both ends"),
        (["demo", "--ecu-serial", "loop://"], "both ends"),
        (["ecu", "--bus", "virtual:x", "--request", "1"], "SECONDS:ACTION"),
        (["ecu", "--bus", "virtual:x", "--request", "now:open"], "SECONDS:ACTION"),
        (["ecu", "--bus", "virtual:x", "--duration", "0.1", "--request", "nan:open"], "nan:open"),
        (["ecu", "--bus", "virtual:x", "--duration", "0.1", "--request=-5:open"], "-5:open"),
        (["ecu", "--bus", "virtual:x", "--drives", "3"], "--drives"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_wrong_bus_or_request_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
):
    lines = complaint(capsys, *arguments)
    assert len(lines) == 1
    assert said in lines[0]


def test_the_message_for_a_missing_bus_says_how_to_name_one(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    (line,) = complaint(capsys, "--quiet")
    assert "--bus" in line
    assert "socketcan:vcan0" in line


def test_a_bus_that_cannot_be_opened_is_one_line_and_exit_code_1(capsys: pytest.CaptureFixture[str]):
    assert call("--bus", "socketcan:nosuch0") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "socketcan:nosuch0: cannot be opened" in line


def test_an_exception_in_the_frame_thread_ends_the_run_with_its_cause(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, bus: str
):
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("not as it was meant")

    monkeypatch.setattr("liftgate_hil.transport.can_bus.CanTransport.receive", broken)
    assert call("--bus", bus, "--duration", "600", "--quiet") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("the thread that carries its frames has ended: not as it was meant")


def test_an_ecu_process_reports_its_unreadable_and_refused_frames(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, bus: str
):
    counts = LinkCounts(unreadable_frames=3, refused_frames=2)
    monkeypatch.setattr("liftgate_hil.transport.can_bus.CanTransport.counts", lambda self: counts)
    assert call("ecu", "--bus", bus, "--duration", "0.01") == 0
    assert capsys.readouterr().err.endswith("link: 3 unreadable frames, 2 refused frames\n")


def test_all_issues_of_vehicle_settings_are_reported_one_per_line(capsys: pytest.CaptureFixture[str], bus: str):
    lines = complaint(
        capsys, "--bus", bus, "--set", "motor.resistance=-1", "--set", "gate.mass=abc",
        "--set", "supply.volts=3",
    )  # fmt: skip
    assert len(lines) == 3
    for line, key in zip(sorted(lines), ("gate.mass", "motor.resistance", "supply.volts"), strict=True):
        assert key in line
        assert "allowed" in line


def test_a_refused_run_leaves_no_recording_behind(capsys: pytest.CaptureFixture[str], bus: str, tmp_path: Path):
    complaint(capsys, "--bus", bus, "--record", str(tmp_path / "a.csv"), "--record", "b.pcap")
    assert list(tmp_path.iterdir()) == []


def test_recording_twice_to_one_file_is_refused(capsys: pytest.CaptureFixture[str], bus: str, tmp_path: Path):
    name = str(tmp_path / "a.log")
    lines = complaint(
        capsys, "--bus", bus, "--clock", "free", "--duration", "0.01",
        "--record", name, "--record", name,
    )  # fmt: skip
    assert "a.log" in lines[0]


def test_json_prints_only_the_summary(capsys: pytest.CaptureFixture[str], bus: str):
    assert call("--bus", bus, "--clock", "free", "--duration", "0.25", "--json") == 0
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert captured.err == ""
    assert summary["clock"] == "free"
    assert summary["received"]["accepted"] == 0
    assert summary["rejected_frames"] == 0
    assert summary["frames_sent"] == 6 * 50 + 2 * 25 + 2 + 2 + 10


def test_a_run_prints_the_verdicts_on_its_expectations(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    scenario = tmp_path / "s.toml"
    first, second = "name = 'a: b'\nalways = 'gate_angle_deg < 5'", "name = 'c'\nnever = 'latched == 1'"
    scenario.write_text(f"duration = 0.2\n[[expect]]\n{first}\n[[expect]]\n{second}\n")
    flags = ["run", "--ecu", "reference", "--clock", "free", "--scenario", str(scenario)]
    assert call(*flags) == 0  # of the bench alone
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3] == "expectations:"
    assert lines[-2].startswith("  a: b: pass (always gate_angle_deg < 5), margin 5 deg")
    assert lines[-1].startswith("  c: fail")
    assert call(*flags, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], [each["verdict"] for each in found["expectations"]]) == ("fail", ["pass", "fail"])


def test_a_run_without_expectations_has_no_verdict(capsys: pytest.CaptureFixture[str]):
    assert call("run", "--ecu", "reference", "--clock", "free", "--duration", "0.1") == 0
    assert "expectations" not in capsys.readouterr().out
    assert call("run", "--ecu", "reference", "--clock", "free", "--duration", "0.1", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["expectations"]) == (None, [])


def test_a_quiet_run_prints_nothing(capsys: pytest.CaptureFixture[str], bus: str):
    assert call("--bus", bus, "--clock", "free", "--duration", "0.01", "--quiet") == 0
    assert capsys.readouterr() == ("", "")


def test_the_duration_flag_overrides_the_scenarios_duration(
    capsys: pytest.CaptureFixture[str], bus: str, tmp_path: Path
):
    scenario = tmp_path / "short.toml"
    scenario.write_text("duration = 0.2\n")
    common = ["--bus", bus, "--clock", "free", "--json", "--scenario", str(scenario)]
    ticks = []
    for more in ([], ["--duration", "0.1"]):
        assert call(*common, *more) == 0
        ticks.append(json.loads(capsys.readouterr().out)["ticks"])
    assert ticks[0] - ticks[1] == 100


def test_a_rig_file_is_enough_to_run_with_another_database(capsys: pytest.CaptureFixture[str], bus: str):
    rig = ROOT / "tests/system/foreign/foreign.toml"
    assert call(
        "--bus", bus, "--rig", str(rig), "--clock", "free", "--duration", "0.1", "--json"
    ) == 0  # fmt: skip
    assert json.loads(capsys.readouterr().out)["frames_sent"] > 0


def test_a_plant_that_diverges_is_one_line_and_exit_code_1(
    capsys: pytest.CaptureFixture[str], bus: str, monkeypatch: pytest.MonkeyPatch
):
    from liftgate_hil.errors import PlantDivergedError
    from liftgate_hil.loop.python_loop import Loop

    def diverge(loop: Loop, *arguments: object, **more: object) -> None:
        raise PlantDivergedError("the plant diverged at 0.001 s")

    monkeypatch.setattr(Loop, "advance", diverge)
    assert call("--bus", bus, "--clock", "free", "--duration", "0.01", "--quiet") == 1
    assert capsys.readouterr().err.splitlines() == ["liftgate-hil: the plant diverged at 0.001 s"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_a_full_disk_is_reported_in_one_line_after_the_motors_are_switched_off(
    capsys: pytest.CaptureFixture[str], bus: str, tmp_path: Path, suffix: str
):
    path = tmp_path / f"run{suffix}"
    path.symlink_to("/dev/full")
    last = None
    with can.Bus(interface="virtual", channel=bus.partition(":")[2]) as other:
        code = call(
            "--bus", bus, "--clock", "free", "--duration", "3", "--quiet", "--record", str(path)
        )  # fmt: skip
        while (message := other.recv(0)) is not None:
            last = message if message.arbitration_id == 0x6E0 else last
    assert code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line
    assert last is not None
    assert last.data[7] & 3 == 3  # stopped


@pytest.mark.parametrize("side", [(), ("ecu",)])
def test_waiting_on_a_virtual_bus_is_noted_as_unreachable_for_other_processes(
    capsys: pytest.CaptureFixture[str], bus: str, side: tuple[str, ...]
):
    assert call(*side, "--bus", bus, "--duration", "2.6") == 0
    waits = [line for line in capsys.readouterr().err.splitlines() if "waits for" in line]
    assert "; a virtual bus is within one process, another one cannot reach it; allowed: another --bus" in waits[0]


def test_ctrl_c_before_the_bus_is_open_leaves_no_traceback(monkeypatch: pytest.MonkeyPatch, bus: str):
    def interrupted(args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("liftgate_hil.cli.run.run", interrupted)
    try:
        code = call("--bus", bus)
    except KeyboardInterrupt:  # it would end the tests, too
        pytest.fail("left the command line as KeyboardInterrupt")
    assert code in (0, 130)


# As processes.


def hil(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "liftgate_hil", *arguments],
        capture_output=True, text=True, timeout=60, check=False, cwd=ROOT,
    )  # fmt: skip


@pytest.mark.parametrize("limit", [6, 9, 12])
def test_a_low_limit_of_open_files_is_reported(tmp_path: Path, limit: int):
    command = ["-m", "liftgate_hil", "--bus", "virtual:x", "--duration", "0.1"]
    done = subprocess.run(
        ["sh", "-c", f'ulimit -n {limit}; exec "$0" "$@"', sys.executable, *command,
         "--record", str(tmp_path / "run.csv"), "--quiet"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "liftgate-hil: Too many open files; allowed: a limit of 64 or more (ulimit -n)\n"


def test_a_wrong_vehicle_file_ends_the_process_with_2_and_no_traceback(tmp_path: Path):
    path = tmp_path / "gate.toml"
    path.write_text("drives = 5\n[motor]\nresistance = 'low'\n")
    done = hil("--bus", "virtual:x", "--vehicle", str(path))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) > 5
    assert all(line.startswith(f"liftgate-hil: {path}: ") for line in lines)


def test_an_unreadable_database_ends_the_process_with_2_and_no_traceback(tmp_path: Path):
    (tmp_path / "their.dbc").write_bytes(bytes(range(256)))
    path = tmp_path / "rig.toml"
    path.write_text('dbc = "their.dbc"\n')
    done = hil("--bus", "virtual:x", "--rig", str(path))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "their.dbc" in done.stderr


HEAVY = {"numpy", "numba", "can", "cantools", "matplotlib", "scipy", "asammdf", "pandas"}


def test_help_imports_no_heavy_modules():
    code = (
        "import sys; from liftgate_hil.cli.main import main\n"
        "for name in sys.argv[1:]:\n"
        "    main([name, '--help'])\n"
        f"    print(name, 'loads', sorted({HEAVY!r} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code, *COMMANDS]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    told = [line for line in done.stdout.splitlines() if " loads [" in line]
    # In one process: what one of them loads is there for those behind it.
    assert told == [f"{name} loads []" for name in COMMANDS]


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_every_subcommand_prints_the_version(capsys: pytest.CaptureFixture[str], name: str | None):
    assert call(*([name] if name else []), "--version") == 0
    assert capsys.readouterr() == (f"liftgate-hil {liftgate_hil.__version__}\n", "")


def test_the_version_is_that_of_the_installed_package():
    assert liftgate_hil.__version__ == metadata.version("liftgate-hil")
    with pytest.raises(AttributeError, match="nosuch"):
        _ = liftgate_hil.nosuch


def test_the_version_of_uninstalled_sources_is_unknown(monkeypatch: pytest.MonkeyPatch):
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    assert version.__wrapped__() == "unknown"


def test_packages_in_the_working_folder_do_not_shadow_imported_ones(tmp_path: Path):
    for name in ("hil", "plant", "tools", "can", "numpy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('not ours')\n")
    done = subprocess.run(
        [  # -P, as the installed command does: that has no working folder among its places for modules
            sys.executable, "-P", "-m", "liftgate_hil", "--bus", "virtual:x", "--duration", "0.05",
            "--record", "run.csv", "--record", "run.blf", "--json",
        ],
        capture_output=True, text=True, timeout=300, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["ticks"] > 0
    assert (tmp_path / "run.csv").stat().st_size > 0
    assert (tmp_path / "run.blf").stat().st_size > 0


def test_a_run_that_falls_too_far_behind_real_time_is_inconclusive_with_a_message(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, bus: str
) -> None:
    def behind(self: RealtimeDriver, ticks: int | None) -> None:
        raise OverrunError("the bench was late: the loop fell more than `overrun_limit` (1 ms) behind")

    monkeypatch.setattr(RealtimeDriver, "advance", behind)
    assert call("--bus", bus, "--duration", "60", "--quiet") == 3
    told = capsys.readouterr().err
    assert told == "liftgate-hil: the bench was late: the loop fell more than --overrun-limit (1 ms) behind\n"
    assert lh.run(scenario="demo", bus=bus, clock="realtime", ecu="bus").verdict == "inconclusive"


def test_a_call_without_arguments_lists_the_first_commands_to_try(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    said = complaint(capsys)
    assert len(said) == 5
    assert said[0] == "liftgate-hil: --bus: missing; to see the gate move: liftgate-hil demo"
    assert complaint(capsys, "--quiet")[0].startswith("liftgate-hil: --bus: missing; allowed: ")


def test_help_and_version_also_work_as_subcommands(capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for words in (["version"], ["--version"], ["help"], ["--help"], ["help", "judge"], ["judge", "--help"]):
        assert call(*words) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0::2] == shown[1::2]
    assert "subcommands (each with its own --help)" in shown[2]
    assert complaint(capsys, "help", "nosuch")[0].startswith(
        "liftgate-hil: no subcommand 'nosuch'; allowed: run, "
    )
