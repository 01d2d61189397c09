"""The page's server as a process: access control, its answers, and the effect of commands."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dashboard_support import Client, bench, bench_with_page, is_going, page_beside, page_of, process, until
from hil_support import wait_for
from json_paths import written
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.dashboard.guard import Guard, hosts_of
from liftgate_hil.dashboard.live import _UNKNOWN_END
from liftgate_hil.dashboard.opening import source_of
from liftgate_hil.dashboard.page_state import AboutRecording, AboutRun, BusTrace, Curves, GateGeometry, PageState
from liftgate_hil.dashboard.request import DashboardRequest
from liftgate_hil.described_result import keys_of
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.loop import statistics
from liftgate_hil.operate.attachment.server import RunEnd, _in_full, _in_short


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("page")
    text = 'duration = 1e6\n[[request]]\ntime = 0.5\naction = "open"\n'
    text += '[[expect]]\nname = "presses little"\nalways = "pinch_force_n < 1e4"\n'
    (found / "s.toml").write_text(text, encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def run(folder: Path) -> Iterator[subprocess.Popen[str]]:
    with bench(folder, "page", "--ecu", "reference", "--scenario", "s.toml") as child:
        assert child.stderr is not None
        for line in child.stderr:
            if "suv on " in line:
                break
        yield child


@pytest.fixture(scope="module")
def client(folder: Path, run: subprocess.Popen[str]) -> Iterator[Client]:
    with page_of(folder, "--attach", str(run.pid)) as found:
        until(found, is_going)
        yield found


def wire_until_closed(wire: Any) -> Iterator[Any]:
    while True:
        yield wire.recv(timeout=30)


def states_until_closed(wire: Any) -> Iterator[Any]:
    with contextlib.suppress(ConnectionClosed):
        yield from wire_until_closed(wire)


def upgrade(client: Client) -> bytes:
    """Return the request that opens a WebSocket."""
    return (
        f"GET /api/stream?token={client.token} HTTP/1.1\r\nHost: {client.host}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    ).encode()


def streamed(client: Client, **more: Any) -> Any:
    return connect(f"ws://{client.host}/api/stream?token={client.token}", **more)


def test_the_state_has_true_and_sensed_values_the_loop_and_the_bus(client: Client) -> None:
    status, state = client.ask("/api/state")
    assert status == 200
    assert state["truth"]["time_s"] == state["time_s"]
    assert -1.0 < state["truth"]["gate_angle_deg"] < 120.0
    assert {"left_current_a", "left_hall_count", "gate_angle_deg"} <= set(state["sensed"])
    assert state["loop"]["clock"] == "realtime"
    assert state["loop"]["rate_hz"] == 1000.0
    assert state["loop"]["ticks_missed"] >= 0
    assert state["bus"]["sent"] > 0
    assert {"load_percent", "received", "rejected", "dropped"} <= set(state["bus"])


def test_the_keys_of_the_page_state_are_exactly_the_documented_ones(client: Client) -> None:
    """Keys of a live run's state, and of the records in its `end` and its `verdicts`."""
    keys = keys_of(PageState)

    def is_whole(state: Any) -> bool:
        is_timed = all(state["loop"][f"{name}_us"] for name in ("lateness", "execution", "command_delay"))
        return is_timed and bool(state["acting"].get("obstacle"))

    assert client.command(obstacle={"angle_deg": 35})[0] == 200
    state = until(client, is_whole)
    assert state["acting"]["obstacle"]["meets"] == "closing"
    assert client.command(clear="obstacle")[0] == 200
    state["in_force"] = dict.fromkeys(state["in_force"])  # what tests have commanded has the keys of commands
    found = {*written(state, keys)}
    later = {path for path in keys if path.startswith("end.")}
    assert found == {*keys} - later
    verdict, end = Verdict("moves", "pass"), {*_UNKNOWN_END}
    assert end == {*RunEnd._fields}
    assert {*state["verdicts"][0]} == {*_in_short(verdict)}
    assert later == {
        *(f"end.{name}" for name in end),
        *(f"end.expectations[].{name}" for name in _in_full(verdict)),
    }


def test_the_other_answers_have_exactly_the_documented_keys(client: Client, tmp_path: Path) -> None:
    answers = {"about": AboutRun, "geometry": GateGeometry, "plot": Curves, "trace": BusTrace}
    for path, content in answers.items():
        keys = keys_of(content)
        assert {*written(client.ask(f"/api/{path}")[1], keys)} == {*keys}
    lh.run("parts/demo_judged", record=tmp_path / "run.mf4")
    asked = DashboardRequest.of(recording=str(tmp_path / "run.mf4"))
    recording = source_of(asked, lambda text: contextlib.nullcontext()).about()
    recording["marks"] = [{"time_s": 1.0, "text": "it squeaks"}]
    keys = keys_of(AboutRecording)
    own = {path for path in keys if path not in ("number", "read_only", "starts", "ends_with_run")}
    assert {*written(recording, keys)} == own


def test_page_and_summary_have_the_same_words_for_dropped_frames() -> None:
    script = (Path(statistics.__file__).parents[1] / "dashboard" / "page" / "state.js").read_text(encoding="utf-8")
    assert statistics.DROPPED_OR_STALE in script


def test_the_stream_sends_states_repeatedly_with_the_extremes_between_them(client: Client) -> None:
    with streamed(client) as wire:
        told = [json.loads(wire.recv(timeout=30)) for _ in range(12)]
    times = [each["time_s"] for each in told]
    assert times == sorted(times)
    assert times[-1] > times[0]
    columns = client.ask("/api/about")[1]["columns"]
    place = columns.index("gate_angle_deg")
    spans = [each["span"] for each in told if each["span"]]
    assert spans
    assert all(span["low"][place] <= span["high"][place] for span in spans)
    assert any("messages" in each for each in told)


def test_commands_of_the_page_act_on_the_gate(client: Client) -> None:
    status, said = client.command(set={"road_slope_deg": 8, "supply_voltage_v": 11.0})
    assert (status, said["done"]) == (200, "set road_slope_deg 8, supply_voltage_v 11")
    status, said = client.command(fault={"kind": "angle_offset", "value": 20})
    assert status == 200
    later = said["time_s"] + 0.1
    state = until(client, lambda state: state["time_s"] > later)
    apart = state["sensed"]["gate_angle_deg"] - state["truth"]["gate_angle_deg"]
    assert apart == pytest.approx(20.0, abs=1.0)
    assert state["truth"]["terminal_voltage_v"] < 11.5
    assert state["in_force"]["set"] == {"road_slope_deg": 8.0, "supply_voltage_v": 11.0}
    assert state["in_force"]["faults"] == [{"kind": "angle_offset", "value": 20}]
    assert any("operator: set road_slope_deg 8" in text for _, _, text in state["log"])
    assert client.command(clear="all")[0] == 200
    state = until(client, lambda state: not state["in_force"]["faults"])
    assert state["in_force"]["set"] == {}


def test_rows_overwritten_before_the_page_was_attached_are_not_counted(
    folder: Path, run: subprocess.Popen[str], client: Client
) -> None:
    """The rings hold 4096 rows."""
    until(client, lambda state: state["loop"]["tick"] > 5000)
    with page_of(folder, "--attach", str(run.pid)) as other:
        assert until(other, is_going)["bus"]["overwritten"] == 0


def test_a_commanded_restbus_signal_is_sent_cyclically_and_shown(client: Client) -> None:
    before = client.ask("/api/state")[1]["messages"]
    assert not [each for each in before if each["name"] == "Body"]
    command = {"Body.VehicleSpeed": 12.5, "Body.Ignition": "on"}
    assert client.command(signal=command)[0] == 200
    found: list[Any] = []

    def has_come(state: Any) -> bool:
        found[:] = [each for each in state["messages"] if each["name"] == "Body"]
        return bool(found) and found[0]["count"] >= 3

    until(client, has_come)
    assert found[0]["direction"] == "sent"
    assert found[0]["signals"]["VehicleSpeed"] == 12.5
    assert found[0]["signals"]["Ignition"] == "on"


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b'{"set": {"road_slope_deg": 80}}', 422, "`road_slope_deg` 80: allowed: -"),
        (b'{"signal": {"Body.Gear": 9}}', 422, "9; allowed: 0 to 4"),
        (b'{"fault": {"kind": "gremlin"}}', 422, "'gremlin'; allowed: one of supply_open"),
        (b'{"obstacle": {"angle_deg": 1e400}}', 422, "allowed"),
        (b"{", 422, "not JSON"),
        (b"\xff\xfe", 422, "not JSON"),
        (b"[]", 422, "not a table of one key"),
        (b"", 422, "not JSON"),
        (b" " * 70_000, 413, "command too long; allowed: up to 65536 bytes"),
    ],
)
def test_an_invalid_command_is_refused_with_what_is_allowed(
    client: Client, body: bytes, status: int, words: str
) -> None:
    found, said = client.ask("/api/command", body)
    assert found == status
    assert words in " | ".join(said["issues"])


def test_requests_without_the_token_are_refused(client: Client) -> None:
    for path in ("/", "/api/about", "/api/state", "/api/plot"):
        assert client.ask(path, token="")[0] == 401
        assert client.ask(path, token=client.token[:-1])[0] == 401
        assert client.ask(path, token="%ff")[0] == 401
    assert client.ask("/api/command", b'{"clear": "all"}', token="")[0] == 401
    with pytest.raises(InvalidStatus) as refused, connect(f"ws://{client.host}/api/stream"):
        pass
    assert refused.value.response.status_code == 401
    bearer = {"Authorization": f"Bearer {client.token}"}
    assert client.ask("/api/state", headers=bearer, token="")[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1:1"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1"},
    ],
)
def test_a_foreign_host_or_origin_is_refused_despite_the_token(client: Client, headers: dict[str, str]) -> None:
    assert client.ask("/api/state", headers=headers)[0] == 403
    assert client.ask("/api/command", b'{"clear": "all"}', headers=headers)[0] == 403


def test_a_page_of_foreign_origin_gets_no_stream(client: Client) -> None:
    with pytest.raises(InvalidStatus) as refused, streamed(client, origin="http://evil.example"):
        pass
    assert refused.value.response.status_code == 403
    with streamed(client, origin=f"http://{client.host}") as wire:
        assert wire.recv(timeout=30)


def test_the_page_is_self_contained(client: Client) -> None:
    status, page = client.ask("/")
    assert status == 200
    assert "/*page.js*/" not in page
    assert "uPlot" in page
    assert "src=" not in page.split("<body>")[0]
    for address in ("http://", "https://"):
        found = [line for line in page.splitlines() if address in line.replace("http://www.w3.org/2000/svg", "")]
        assert all("uPlot" in line for line in found), found  # the comment that says whose it is


def deaf_to(client: Client) -> socket.socket:
    """A viewer that never reads its stream."""
    wire = socket.socket()
    wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    wire.connect(client.endpoint)
    wire.sendall(upgrade(client))
    return wire


def test_a_viewer_that_reads_nothing_does_not_delay_others(client: Client) -> None:
    with deaf_to(client), streamed(client) as other:
        came = 0
        while came < 500_000:  # more than the deaf one's connection holds
            came += len(other.recv(timeout=30))


def test_a_read_only_page_refuses_commands(folder: Path, run: subprocess.Popen[str]) -> None:
    with page_of(folder, "--attach", str(run.pid), "--read-only") as client:
        status, said = client.command(clear="all")
        assert (status, said["issues"]) == (403, ["this page is read-only; allowed without --read-only"])
        assert client.ask("/api/about")[1]["read_only"] is True


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_server_ends_cleanly_while_a_viewer_is_connected(
    folder: Path, run: subprocess.Popen[str], number: signal.Signals
) -> None:
    with page_of(folder) as client:
        with streamed(client) as wire:
            wire.recv(timeout=30)
            client.child.send_signal(number)
            assert client.child.wait(30) == 0
            with pytest.raises(ConnectionClosed):
                list(wire_until_closed(wire))
        assert client.child.stderr.read() == ""


def test_an_ended_run_stays_on_the_page_and_refuses_commands(tmp_path: Path) -> None:
    with process("--bus", "virtual:x", "--clock", "lockstep", folder=tmp_path) as run:
        assert run.stderr is not None
        run.stderr.readline()
        with page_of(tmp_path) as client:
            # Nobody commands: the run stands still.
            assert client.command(set={"road_slope_deg": 3})[0] == 202
            run.send_signal(signal.SIGINT)
            assert run.wait(30) == 0
            until(client, lambda state: state["phase"] == "ended")
            status, said = client.command(clear="all")
            assert status == 410
            assert "has ended" in said["issues"][0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("dashboard --attach 1", "--attach 1: no run of yours; allowed: the process of a run"),
        ("dashboard", "no emulator of yours is running on this machine"),
        ("dashboard --attach x", "--attach: 'x'; allowed: a whole number from 1 to"),
        ("dashboard --recording no.csv", "no.csv"),
        ("dashboard --recording no.csv --attach 1", "--attach, --recording: allowed: one of them"),
        ("dashboard --rig liftgate", "--rig liftgate: allowed with --recording"),
        ("dashboard --recording s.csv --listen nonsense", "--listen nonsense: allowed: HOST:PORT"),
        ("dashboard --recording s.csv --listen 127.0.0.1:99999", "port 0 to 65535"),
        ("dashboard --recording s.csv --listen 192.0.2.1:0", "--listen 192.0.2.1:0: "),
        ("dashboard --recording s.csv --listen no.such.host.invalid:0", "--listen no.such.host.invalid:0: "),
        ("dashboard --recording s.csv --listen 127.0.0.1:{port}", "--listen 127.0.0.1:{port}: Address already in"),
        ("--bus virtual:own --dashboard --listen 127.0.0.1:{port}", "127.0.0.1:{port}: Address already in use"),
        ("--bus virtual:own --dashboard --listen here", "--listen here: allowed: HOST:PORT"),
        ("--bus virtual:own --dashboard --clock free --duration 1", "--dashboard: a run on the free clock ends"),
        ("--bus virtual:own --listen 127.0.0.1:0", "--listen 127.0.0.1:0: allowed: together with --dashboard"),
        ("--bus virtual:own --read-only", "--read-only: allowed: together with --dashboard"),
    ],
)
def test_wrong_usage_of_the_dashboard_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], arguments: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # in which no run is to be found
    (tmp_path / "s.csv").write_text("time_s,gate_angle_deg\n0.0,1.0\n0.1,2.0\n", encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(arguments.format(port=port).split()) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert words.format(port=port) in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("listens", "port", "came_to", "host", "is_let_in"),
    [
        ("127.0.0.1", 80, "127.0.0.1", "127.0.0.1", True),
        ("127.0.0.1", 80, "127.0.0.1", "localhost:80", True),
        ("127.0.0.1", 8765, "127.0.0.1", "localhost", False),
        ("0.0.0.0", 8765, "192.168.1.7", "192.168.1.7:8765", True),
        ("0.0.0.0", 8765, "192.168.1.7", "192.168.1.8:8765", False),
        ("0.0.0.0", 8765, "192.168.1.7", "evil.example:8765", False),
        ("::", 8765, "fe80::7", "[fe80::7]:8765", True),
        ("::1", 8765, "::1", "[::1]:8765", True),
        ("192.168.1.7", 8765, "192.168.1.7", "127.0.0.1:8765", False),
    ],
)
def test_only_host_names_of_this_machine_or_the_connected_address_are_accepted(
    listens: str, port: int, came_to: str, host: str, is_let_in: bool
) -> None:
    guard = Guard(None, "token", hosts_of(listens, port))  # type: ignore[arg-type]
    scope = {
        "type": "http",
        "server": (came_to, port),
        "headers": [(b"host", host.encode()), (b"origin", f"http://{host}".encode())],
        "query_string": b"token=token",
    }
    assert (guard._refusal(scope)[0] == 0) == is_let_in


def test_a_run_with_its_own_page_ends_that_page(tmp_path: Path) -> None:
    with bench_with_page(tmp_path, "own", "--json") as client:
        until(client, is_going)
        assert client.command(set={"road_slope_deg": 3})[0] == 200
        client.child.send_signal(signal.SIGINT)
        out, _ = client.child.communicate(timeout=30)
    assert client.child.returncode == 0
    summary = json.loads(out)
    assert summary["commands"] == 1
    assert summary["commanded"][0].endswith("set road_slope_deg 3")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(client.endpoint)


def test_the_answers_have_geometry_command_labels_and_histograms(client: Client) -> None:
    about, geometry = client.ask("/api/about")[1], client.ask("/api/geometry")[1]
    assert geometry["length_m"] == 1.0
    assert {"left", "right"} == set(geometry["drives"])
    assert about["commands"]["set"]["supply_voltage_v"]["label"] == "Supply voltage"
    assert about["commands"]["fault"]["hall_a_stuck"]["label"] == "Hall A stuck"
    assert about["commands"]["fault"]["hall_a_stuck"]["group"] == "Hall sensors"
    state = until(client, lambda state: "left_duty" in state["command"])
    assert state["command"]["left_duty"]["signal"] == "DriveCommand.LeftDuty"
    assert state["command"]["left_direction"]["value"] in ("coast", "open", "close", "brake")
    ticks = state["loop"]["execution_us"]["count"]
    bars = client.ask("/api/state")[1]["histograms"]["execution_us"]
    assert sum(count for _, _, count in bars) >= ticks
    assert all(low < high for low, high, _ in bars)
    assert [high for _, high, _ in bars[:-1]] == [low for low, _, _ in bars[1:]]


def test_curves_have_the_requested_columns_and_at_most_the_requested_points(client: Client) -> None:
    plot = client.ask("/api/plot?columns=gate_angle_deg,left_current_a&points=10")[1]
    assert set(plot["low"]) == {"gate_angle_deg", "left_current_a"}
    assert 1 <= len(plot["time_s"]) <= 10
    for asked, words in (
        ("columns=no", "columns no: no such columns"),
        ("points=0", "points"),
        ("from=x", "from"),
    ):
        status, said = client.ask(f"/api/plot?{asked}")
        assert (status, words in said["issues"][0]) == (422, True)


def test_a_trace_continues_after_the_last_known_frame(client: Client) -> None:
    known = client.ask("/api/trace")[1]
    last = known["first"] + len(known["frames"]) - 1
    more = client.ask(f"/api/trace?after={last}")[1]
    assert more["first"] > last
    assert known["frames"][-1]["time_s"] <= more["frames"][0]["time_s"] if more["frames"] else True
    assert {"LeftDrive", "DriveCommand"} <= {each["name"] for each in known["frames"]}
    for wrong in ("x", "-1", "9" * 19):
        assert client.ask(f"/api/trace?after={wrong}")[0] == 422


def test_a_run_can_be_recorded_and_marked_from_the_page(client: Client, folder: Path) -> None:
    from asammdf import MDF

    assert client.command(record={"file": "../x.mf4"})[0] == 422
    assert client.command(mark="nothing is recorded")[0] == 422
    assert client.command(record={"file": "page.mf4"})[1]["done"] == "recording to page.mf4"
    state = until(client, lambda state: (state["in_force"]["record"] or {}).get("phase") == "recording")
    later = state["time_s"] + 0.3
    assert client.command(mark="it squeaks")[1]["done"] == "mark it squeaks"
    for slope in (1.0, 2.0, 3.0):  # of a slider's steps the first and the last one are marks
        client.command(set={"road_slope_deg": slope})
    client.command(obstacle={"angle_deg": 35})
    until(client, lambda state: state["time_s"] > later)
    assert client.command(record=None)[0] == 200
    until(client, lambda state: state["in_force"]["record"] is None)
    with MDF(folder / "page.mf4") as measured:
        times = measured.get("gate_angle_deg").timestamps
        assert [each.name for each in measured.events] == [
            "it squeaks",
            "command: set road_slope_deg 1",
            "command: set road_slope_deg 3",
            "command: obstacle angle_deg 35",
        ]
        assert times[0] < measured.events[0].value < times[-1]
        assert len(times) > 100


@pytest.mark.realtime
def test_the_last_value_of_a_slider_is_marked_although_the_run_ends(tmp_path: Path) -> None:
    from asammdf import MDF

    with bench_with_page(tmp_path, "slider", "--record", "own.mf4") as client:
        until(client, is_going)
        for slope in (1.0, 2.0, 3.0):
            client.command(set={"road_slope_deg": slope})
        client.child.send_signal(signal.SIGINT)
        assert client.child.wait(60) == 0
    with MDF(tmp_path / "own.mf4") as measured:
        assert measured.events[-1].name == "command: set road_slope_deg 3"


@pytest.mark.realtime
def test_the_end_of_a_run_has_verdict_reasons_and_exit_code(tmp_path: Path) -> None:
    """The run takes 5 s in real time."""
    text = 'duration = 5\n[[expect]]\nname = "opens"\neventually = "gate_angle_deg > 70"\n'
    (tmp_path / "never.toml").write_text(text, encoding="utf-8")
    with bench_with_page(tmp_path, "end", "--ecu", "reference", "--scenario", "never.toml") as client:
        with streamed(client, open_timeout=60) as wire:
            states = [json.loads(each) for each in states_until_closed(wire)]
        assert client.child.wait(60) == 0
    assert [each["phase"] for each in states[-1:]] == ["ended"]
    end = states[-1]["end"]
    assert end["exit_code"] == 0
    assert (end["ending"], end["pinch_peak_n"], end["pinch_peak_s"]) == (end["verdict"], None, None)
    verdict = end["verdict"]
    assert [each["verdict"] for each in end["expectations"]] == [verdict]
    if verdict == "fail":
        assert "opens: gate_angle_deg" in end["reason"]
    else:  # the bench stood still for more than 0.25 s
        assert verdict == "inconclusive"
        assert "late" in end["expectations"][0]["reason"]
    assert states[0]["verdicts"][0]["verdict"] == "pending"


def test_events_of_an_ecu_in_its_own_process_are_in_the_log(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('[[request]]\ntime = 0.3\naction = "open"\n', encoding="utf-8")
    bus = f"udp_multicast:239.76.{os.getpid() % 250}.{time.monotonic_ns() % 250 + 1}"
    ecu = ("--bus", bus, "--ecu", "reference", "--scenario", "s.toml")
    with bench_with_page(tmp_path, "unused", *ecu) as client:
        until(client, lambda state: any(text.startswith("ecu ") for _, _, text in state["log"]))


@pytest.mark.realtime
def test_a_command_of_a_disconnected_client_is_not_executed(tmp_path: Path) -> None:
    with bench(tmp_path, "gone") as run, page_beside(run, tmp_path) as client:
        until(client, is_going)
        client.child.send_signal(signal.SIGSTOP)
        body = b'{"set": {"road_slope_deg": 7}}'
        head = f"POST /api/command?token={client.token} HTTP/1.1\r\nHost: {client.host}\r\n"
        head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
        with socket.create_connection(client.endpoint) as wire:
            wire.sendall(head.encode() + body)
        client.child.send_signal(signal.SIGCONT)
        assert client.command(mark="after it")[0] == 422  # nothing is recorded; it came later
        assert client.ask("/api/state")[1]["in_force"]["set"] == {}


def children_of(pid: int) -> list[int]:
    found = []
    for each in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            state_and_parent = each.read_text().rpartition(")")[2].split()[:2]
            if state_and_parent[1] == str(pid):
                found.append(int(each.parent.name))
    return found


def test_a_page_that_ends_before_its_run_is_reported_with_how_to_start_it_again(tmp_path: Path) -> None:
    with bench_with_page(tmp_path, "alone", "--read-only") as client:
        run = client.child
        until(client, is_going)
        found = {pid: Path(f"/proc/{pid}/cmdline").read_bytes() for pid in children_of(run.pid)}
        (page,) = (pid for pid, command in found.items() if b"recorder_process" not in command)
        os.kill(page, signal.SIGKILL)
        said = next(line for line in run.stderr if "the page" in line)
        assert said == (
            "the page has ended (exit code -9), the run goes on; to have one again: "
            f"liftgate-hil dashboard --attach {run.pid} --listen {client.host} --read-only\n"
        )
        with page_of(tmp_path, "--attach", str(run.pid)) as again:
            assert is_going(until(again, is_going))


def test_a_killed_run_is_shown_as_ended_with_an_error(tmp_path: Path) -> None:
    with bench(tmp_path, "killed") as run, page_beside(run, tmp_path) as client:
        until(client, is_going)
        run.kill()
        run.wait(30)
        end = until(client, lambda state: state["phase"] == "ended")["end"]
    assert (end["verdict"], end["exit_code"]) == ("error", None)
    assert "without reporting a result" in end["reason"]


def test_the_next_run_on_the_same_bus_is_shown(tmp_path: Path) -> None:
    with bench(tmp_path, "again") as first, page_beside(first, tmp_path) as client:
        until(client, is_going)
        assert client.ask("/api/about")[1]["number"] == 1
        first.send_signal(signal.SIGINT)
        first.wait(30)
        until(client, lambda state: state["phase"] == "ended")
        with bench(tmp_path, "other"), bench(tmp_path, "again") as second:
            until(client, is_going)
            about = client.ask("/api/about")[1]
            assert (about["pid"], about["channel"], about["number"]) == (second.pid, "again", 2)
            assert client.command(set={"road_slope_deg": 3})[0] == 200


def test_scenarios_of_a_folder_can_be_started_and_stopped(tmp_path: Path) -> None:
    (tmp_path / "opens.toml").write_text('[[request]]\ntime = 0.1\naction = "open"\n', encoding="utf-8")
    (tmp_path / "wrong.toml").write_text("nonsense = 1\n", encoding="utf-8")
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.toml")).write_text("")
    with page_of(tmp_path, "--scenarios", ".") as client:

        def post(name: str | None) -> tuple[int, Any]:
            return client.ask("/api/run", json.dumps({"scenario": name}).encode())

        assert client.ask("/api/state")[1]["phase"] == "idle"
        idle = client.ask("/api/run")[1]
        assert [each["name"] for each in idle.pop("scenarios")] == ["opens.toml", "wrong.toml"]
        assert idle == {"is_all": True, "running": None, "exit_code": None}
        assert post("../x.toml")[0] == 422
        status, said = post("wrong.toml")
        assert (status, "nonsense" in said["issues"][0]) == (410, True)
        assert post("opens.toml")[1]["running"] == "opens.toml"
        until(client, lambda state: is_going(state) and state["started"] == "opens.toml")
        assert post("opens.toml")[0] == 422
        assert post(None)[1]["exit_code"] == 0
        assert post(None)[1]["running"] is None
        end = until(client, lambda state: state["phase"] == "ended")["end"]
        assert (end["exit_code"], end["verdict"], end["ending"]) == (0, "pass", "stopped")
        post("opens.toml")
        pid = client.ask("/api/about")[1]["pid"]
    assert not Path(f"/proc/{pid}").exists()


def test_a_dashboard_without_a_scenario_folder_refuses_to_start_runs(client: Client) -> None:
    assert client.ask("/api/run")[0] == 403
    assert client.ask("/api/run", b'{"scenario": null}')[0] == 403


def test_idle_connections_are_dropped(client: Client) -> None:
    """Silent ones, ones with an incomplete request, a WebSocket without pings, and viewers that read nothing."""
    deaf = [deaf_to(client) for _ in range(5)]
    port = client.endpoint[1]
    theirs = {wire.getsockname()[1] for wire in deaf}
    assert served(port) & theirs == theirs
    wires = [socket.create_connection(client.endpoint) for _ in range(3)]
    for wire, said in zip(wires, (b"", b"GET /api/state HTT", upgrade(client)), strict=True):
        wire.sendall(said)
    for wire in wires:
        wire.settimeout(60)
        while wire.recv(1 << 20):  # raises TimeoutError where it stays open
            pass
    wait_for(lambda: not served(port) & theirs, "a deaf one is served still")
    for wire in (*deaf, *wires):
        wire.close()


def request(client: Client, token: str) -> bytes:
    """Return a request for a connection that stays open."""
    return f"GET /api/about?token={token} HTTP/1.1\r\nHost: {client.host}\r\n\r\n".encode()


def test_any_number_of_connections_without_the_token_does_not_block_others(
    folder: Path, run: subprocess.Popen[str]
) -> None:
    """The oldest connections without a request with the token are dropped, without a message on the terminal."""
    with page_beside(run, folder) as client:
        until(client, is_going)
        with streamed(client) as viewer:
            wires = [socket.create_connection(client.endpoint, timeout=30) for _ in range(260)]
            with socket.create_connection(client.endpoint, timeout=30) as newest:
                newest.sendall(request(client, client.token))
                assert newest.recv(65_536).startswith(b"HTTP/1.1 200 OK")
            viewer.recv(timeout=30)
        wait_for(lambda: len(served(client.endpoint[1])) <= 220)
        for wire in wires:
            wire.close()
        until(client, is_going)
        client.child.send_signal(signal.SIGINT)
        assert client.child.wait(30) == 0
        assert client.child.stderr.read() == ""


def test_a_request_without_the_token_closes_its_connection(client: Client) -> None:
    with socket.create_connection(client.endpoint, timeout=30) as wire:
        wire.sendall(request(client, "wrong") * 2)
        come = b""
        while part := wire.recv(65_536):
            come += part
    assert come.count(b"HTTP/1.1 401 ") == 1


def served(port: int) -> set[int]:
    """Return the ports of the clients connected to a server on a port (proc_net_tcp(5))."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    ends = [[int(each.rpartition(":")[2], 16) for each in row[1:3]] for row in rows if row[3] == "01"]
    return {remote for local, remote in ends if local == port}


def test_a_recording_can_be_shown_whole_and_at_any_time(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    result = lh.run("demo", duration=3.0, record=path, trace=True)
    with page_of(tmp_path, "--recording", "run.csv") as client:
        about, plot = client.ask("/api/about")[1], client.ask("/api/plot")[1]
        assert about["kind"] == "recording"
        assert about["units"]["gate_angle_deg"] == "deg"
        assert about["end_s"] == pytest.approx(result.trace["time_s"][-1])
        angles = result.trace["gate_angle_deg"]
        assert max(plot["high"]["gate_angle_deg"]) == pytest.approx(angles.max())
        assert min(plot["low"]["gate_angle_deg"]) == pytest.approx(angles.min())
        state = client.ask("/api/state?time=1.5")[1]
        place = int((result.trace["time_s"] <= 1.5 + 1e-9).sum()) - 1
        assert state["time_s"] == pytest.approx(1.5)
        assert state["truth"]["gate_angle_deg"] == pytest.approx(angles[place])
        assert client.ask("/api/state")[1]["time_s"] == about["end_s"]
        assert client.ask("/api/state?time=x")[0] == 422
        assert client.ask("/api/state?time=nan")[0] == 422
        assert client.command(clear="all")[0] == 403
        assert client.ask("/api/trace")[0] == 403
        with streamed(client) as wire:
            for wrong in ('{"time_s": NaN}', '{"speed": NaN}', '{"speed": true}', '{"time_s": 1e400}', "[]", "7"):
                wire.send(wrong)
            wire.send('{"time_s": 2.9}')
            told = json.loads(wire.recv(timeout=30))
            while not told["is_over"]:
                told = json.loads(wire.recv(timeout=30))
            assert told["time_s"] == about["end_s"]
            wire.send('{"time_s": 0.5}')
            assert json.loads(wire.recv(timeout=30))["time_s"] == pytest.approx(0.5, abs=0.4)
