"""Clients attached to a run: access, malformed messages, and clean-up at the end."""

from __future__ import annotations

import gc
import math
import os
import re
import socket
import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hil_support import shipped_rig

from liftgate_hil.codec.frames import no_logged
from liftgate_hil.errors import ConfigError, RunGoneError
from liftgate_hil.loop.listener import Listener
from liftgate_hil.loop.rings import Memory
from liftgate_hil.operate.attachment import endpoint
from liftgate_hil.operate.attachment.client import Client
from liftgate_hil.operate.attachment.description import Description
from liftgate_hil.operate.attachment.server import Server
from liftgate_hil.operate.operator import Operator
from liftgate_hil.plan.request import RunRequest
from liftgate_hil.plan.setup import setup_of

RIG = shipped_rig()

GONE = 2**22 + 1  # an id that no process can have: PID_MAX_LIMIT of linux/threads.h is 2²²


class Nobody:
    """Target of commands (see Target) that ignores them."""

    def hold(self, values: Any) -> None:
        pass

    def inject(self, faults: Any) -> None:
        pass

    def set_signals(self, values: Any, instead_of: float = math.nan, rest: float = math.nan) -> None:
        pass

    def reset(self) -> None:
        pass


class Heard(Listener):
    """Listener that keeps the messages."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "liftgate-hil"


@pytest.fixture
def server(folder: Path) -> Iterator[tuple[Server, Memory]]:
    """A server of this process, open for clients, and the memory of its run."""
    memory = Memory(64, 64)
    found = Server(Heard(), os.getpid())
    operator = Operator(RIG, Nobody(), 1.0, lambda values: True)
    about = Description(setup_of(None), RIG, RunRequest(clock="realtime"), "virtual", 5e5)
    found.open(about, memory, operator)
    yield found, memory
    found.close()
    memory.close()


def test_a_client_reads_the_shared_memory_of_the_run(server: tuple[Server, Memory]) -> None:
    client = Client(os.getpid())
    server[1].shared.control.tick += 42
    server[1].shared.rows[3, 5] = 2.5
    assert client.memory.shared.control["tick"][0] == 42
    assert client.memory.shared.rows[3, 5] == 2.5
    assert client.description["channel"] == "virtual"
    assert set(client.description["commands"]) == {"obstacle", "set", "fault", "signal", "request", "record"}
    assert "Body.VehicleSpeed" in client.description["commands"]["signal"]
    assert not [each for each in client.description["commands"]["signal"] if each.startswith("Gate.")]
    client.close()


def test_a_stalled_run_obeys_commands_late(server: tuple[Server, Memory], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("liftgate_hil.operate.attachment.client._PATIENCE_S", 0.01)
    client = Client(os.getpid())
    client._wire.settimeout(0.01)
    assert client.command({"set": {"road_slope_deg": 3}}) == {}
    server[0].look(no_logged(), 1.5)
    client._wire.settimeout(10.0)
    monkeypatch.setattr("liftgate_hil.operate.attachment.client._PATIENCE_S", 10.0)
    news = client.news(0)  # the late answer is left out
    assert news["in_force"]["set"] == {"road_slope_deg": 3.0}
    client.close()


def framed(text: bytes) -> bytes:
    """Return a message as it is on the socket: its length, then its text."""
    return struct.pack("<I", len(text)) + text


RUBBISH = [
    b"\xff" * 8, framed(b""), framed(b"\x00\xff"), framed(b"["), framed(b"7"), framed(b"null"), framed(b'"lines"'),
    framed(b"{}"), framed(b'{"lines": "x"}'),
    framed(b'{"command": 1, "id": ' + b"[" * 300 + b"]" * 300 + b"}"),
    framed(b'{"lines": [], "id": {}}'), framed(b"x" * 70_000),
    struct.pack("<I", 2**31) + b"x" * 100,
]  # fmt: skip


@pytest.mark.parametrize("said", RUBBISH)
def test_malformed_messages_end_at_most_their_own_connection(server: tuple[Server, Memory], said: bytes) -> None:
    wire = endpoint.connected(os.getpid())
    wire.settimeout(10.0)
    wire.recv(64)
    wire.send(said)
    wire.recv(65_536)  # an answer, or that it is over
    wire.close()
    client = Client(os.getpid())
    assert client.news(0)["phase"] == "compiling"
    client.close()


def test_a_deeply_nested_command_is_refused_and_the_run_goes_on(server: tuple[Server, Memory]) -> None:
    wire = endpoint.connected(os.getpid())
    wire.settimeout(10.0)
    wire.recv(1)
    for command in (b"%s", b'{"clear": {"fault": {"kind": %s}}}', b'{"set": {"x": %s}}', b'{"request": %s}'):
        deep = command % (b"[" * 900 + b"]" * 900)
        wire.sendall(framed(b'{"id": 1, "command": ' + deep + b"}") + framed(b"{}"))
        arrivals, answers = endpoint.Arrivals(), []
        while not answers:
            answers = arrivals.take(wire.recv(65_536))  # to the question behind it
        server[0].look(no_logged(), 0.0)
        answers = []
        while not answers:
            answers = arrivals.take(wire.recv(65_536))
        assert answers[0]["issues"]
    wire.close()


def test_a_message_received_in_pieces_is_assembled(server: tuple[Server, Memory]) -> None:
    wire = endpoint.connected(os.getpid())
    wire.settimeout(10.0)
    wire.recv(1)
    text = framed(b'{"id": 3, "lines": 0}') * 2
    wire.sendall(text[:7])
    client = Client(os.getpid())  # others are answered meanwhile
    assert client.news(0)["phase"] == "compiling"
    client.close()
    wire.sendall(text[7:])
    arrivals, answers = endpoint.Arrivals(), []
    while len(answers) < 2:
        answers += arrivals.take(wire.recv(11))
    assert [each["id"] for each in answers] == [3, 3]
    wire.close()


def test_long_status_messages_arrive_complete(server: tuple[Server, Memory]) -> None:
    for number in range(200):
        server[0].say(f"{number} " + "x" * 5000)
    client = Client(os.getpid())
    lines = client.news(0)["lines"]
    assert [int(text.split()[0]) for _, _, text in lines] == list(range(200))
    client.close()


def test_too_long_or_too_deep_commands_are_refused_and_the_connection_stays(server: tuple[Server, Memory]) -> None:
    client = Client(os.getpid())
    with pytest.raises(ConfigError, match="bytes; allowed: up to 1000000"):
        client.command({"set": {"x": [1.0] * 400_000}})
    deep: Any = []
    for _ in range(300):
        deep = [deep]
    with pytest.raises(ConfigError, match="allowed: values that JSON can represent"):
        client.command(deep)
    deep = []
    for _ in range(200):
        deep = [deep]
    number = client.post({"clear": deep})
    client.news(0)
    server[0].look(no_logged(), 0.0)
    with pytest.raises(ConfigError, match="allowed: "):
        client.done(number)
    number = client.post({"set": {"road_slope_deg": 3}})
    client.news(0)
    server[0].look(no_logged(), 0.5)
    assert client.done(number)["done"] == "set road_slope_deg 3"
    client.close()


def test_a_run_that_does_not_answer_is_not_taken_for_ended(
    server: tuple[Server, Memory], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = Client(os.getpid())
    client._wire.settimeout(0.05)
    with server[0]._lock:  # it tells nothing
        assert client.news(0) == {}
    client._wire.settimeout(10.0)
    assert client.news(0)["phase"] == "compiling"
    client.close()


def test_a_client_that_never_reads_delays_no_other(server: tuple[Server, Memory]) -> None:
    deaf = endpoint.connected(os.getpid())
    deaf.setblocking(False)
    sent = 0
    try:
        while sent < 500_000:
            sent += deaf.send(framed(b'{"lines": 0}') * 100) // 16
    except OSError:
        pass
    client = Client(os.getpid())
    assert client.news(0)["phase"] == "compiling"
    server[0].look(no_logged(), 0.0)
    deaf.close()
    client.close()


def test_at_most_eight_clients_are_accepted_and_one_that_leaves_makes_room(server: tuple[Server, Memory]) -> None:
    clients = [Client(os.getpid()) for _ in range(8)]
    with pytest.raises(ConfigError, match=r"does not answer|no memory"):
        Client(os.getpid())
    clients.pop().close()
    for each in clients:
        each.news(0)
    Client(os.getpid(), 10.0).close()
    for each in clients:
        each.close()


def test_the_end_of_a_run_is_reported_to_clients_and_its_socket_removed(folder: Path) -> None:
    memory = Memory(64, 64)
    before = len(list(Path("/proc/self/fd").iterdir()))
    found = Server(Heard(), os.getpid())
    found.open(
        Description(setup_of(None), RIG, RunRequest(clock="realtime"), "virtual", 5e5),
        memory,
        Operator(RIG, Nobody(), 1.0),
    )
    client = Client(os.getpid())
    assert endpoint.runs() == [os.getpid()]
    found.close()
    with pytest.raises(RunGoneError, match="has ended"):
        client.news(0)
    client.close()
    memory.close()
    del client  # with its view of the memory
    assert not list(folder.iterdir())
    assert endpoint.runs() == []
    assert len(list(Path("/proc/self/fd").iterdir())) == before - 1


def test_an_internal_error_in_a_command_does_not_end_the_run(
    server: tuple[Server, Memory], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(self: Operator, command: object, now: float) -> str:
        raise TypeError("unhashable")

    monkeypatch.setattr(Operator, "obey", fails)
    client = Client(os.getpid())
    number = client.post({"clear": "all"})
    client.news(0)  # the command has come
    server[0].look(None, 1.5)
    with pytest.raises(ConfigError, match="not executed, because of an internal error: TypeError"):
        client.done(number)
    client.close()


def test_paths_in_the_description_of_a_run_are_absolute(server: tuple[Server, Memory]) -> None:
    client = Client(os.getpid())
    assert Path(client.description["rig"]).is_absolute()
    assert Path(client.description["database"]).is_absolute()
    assert client.description["scenario"] == ""
    client.close()


def test_a_stale_socket_is_not_taken_for_a_run(folder: Path) -> None:
    path = endpoint.path_of(GONE)
    with socket.socket(socket.AF_UNIX) as left:  # by a process that was killed
        left.bind(str(path))
    assert endpoint.runs() == []
    with pytest.raises(ConfigError, match=f"`attach` {GONE}: no run of yours; allowed: the process"):
        Client(GONE)
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with endpoint.listening(GONE):  # and is no obstacle to another
        assert endpoint.runs() == [GONE]
    assert not path.exists()


def test_attaching_to_an_ended_run_searches_no_others(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page looks for the next run several times a second, past all sockets left by killed runs."""

    def looked() -> list[int]:
        raise AssertionError("other runs are looked at")

    monkeypatch.setattr(endpoint, "runs", looked)
    with pytest.raises(ConfigError, match="no run of yours"):
        Client(GONE)


def test_other_files_in_the_socket_folder_are_ignored(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with endpoint.listening(GONE):
        for name in ("4712", "x.socket", "4713.socket.old", ".socket"):
            (folder / name).touch()
        assert list(endpoint.sockets()) == [GONE]


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temp folder on a machine on which no other folder can hold sockets."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(endpoint, "_RUNTIME", str(tmp_path / "none" / "{}"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / f"liftgate-hil-{os.getuid()}"


def belonging_to_another(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """Let `lstat` and `stat` report another user as owner of folders, which only root could set."""
    for name in ("lstat", "stat"):
        real = getattr(Path, name)

        def told(path: Path, *, real: Any = real, **more: Any) -> Any:
            found = real(path, **more)
            return os.stat_result([*found[:4], os.getuid() + 1000, *found[5:]]) if path in folders else found

        monkeypatch.setattr(Path, name, told)


@pytest.mark.parametrize("is_foreign", [True, False])
def test_a_socket_folder_that_is_not_private_is_reported_with_a_remedy_and_the_run_goes_on(
    nowhere: Path, monkeypatch: pytest.MonkeyPatch, is_foreign: bool
) -> None:
    nowhere.mkdir(mode=0o700 if is_foreign else 0o755)
    belonging_to_another(monkeypatch, *([nowhere] if is_foreign else []))
    heard, memory = Heard(), Memory(64, 64)
    found = Server(heard, os.getpid())
    about: Any = Description(setup_of(None), RIG, RunRequest(clock="realtime"), "virtual", 5e5)
    found.open(about, memory, Operator(RIG, Nobody(), 1.0))
    found.close()
    memory.close()
    (said,) = heard.said
    why = f"not yours, it belongs to user {os.getuid() + 1000}; allowed: with XDG_RUNTIME_DIR, a folder of yours"
    if not is_foreign:
        why = f"not private (mode 755); allowed after: chmod 700 {nowhere}"
    assert said.startswith(f"nobody can attach to this run: {nowhere}: {why}")
    assert "\n" not in said
    # What would attach is told why it finds nothing.
    with pytest.raises(ConfigError, match=f"no run of yours \\({re.escape(f'{nowhere}: {why}')}"):
        Client(GONE)


def test_another_users_folder_in_the_temp_folder_does_not_prevent_attaching(
    nowhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere.mkdir(mode=0o700)
    runtime = tmp_path / str(os.getuid())
    runtime.mkdir(mode=0o700)
    monkeypatch.setattr(endpoint, "_RUNTIME", str(tmp_path / "{}"))
    belonging_to_another(monkeypatch, nowhere)
    with endpoint.listening(GONE):
        assert endpoint.path_of(GONE).parent == runtime / "liftgate-hil"
        assert endpoint.runs() == [GONE]


def test_a_client_searches_every_folder_in_which_a_run_may_listen(
    nowhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run and its page may be started from shells with and without XDG_RUNTIME_DIR."""
    given = tmp_path / "given"
    with endpoint.listening(GONE):
        assert endpoint.path_of(GONE).parent == nowhere
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(given))
        with endpoint.listening(GONE + 1):
            assert endpoint.path_of(GONE + 1).parent == given / "liftgate-hil"
            assert endpoint.runs() == [GONE, GONE + 1]
            endpoint.connected(GONE).close()
            monkeypatch.delenv("XDG_RUNTIME_DIR")
            assert endpoint.runs() == [GONE]  # the other one's folder cannot be known
    assert not list(tmp_path.rglob("*.socket"))


def test_a_stale_socket_in_one_folder_does_not_hide_a_run_in_another(
    nowhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "given"))
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(endpoint.path_of(GONE)))
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    with endpoint.listening(GONE):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "given"))
        assert endpoint.runs() == [GONE]


def test_the_runtime_folder_of_another_user_is_not_used(
    nowhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as `sudo` leaves in XDG_RUNTIME_DIR."""
    theirs = tmp_path / "theirs"
    theirs.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(theirs))
    belonging_to_another(monkeypatch, theirs)
    assert endpoint.folder() == nowhere
    assert list(theirs.iterdir()) == []


def test_each_log_line_is_sent_once_and_the_last_200_are_kept(server: tuple[Server, Memory]) -> None:
    client = Client(os.getpid())
    for number in range(300):
        server[0].say(f"line {number}")
    first = client.news(0)["lines"]
    assert [text for _, _, text in first] == [f"line {number}" for number in range(100, 300)]
    assert client.news(first[-1][0])["lines"] == []
    server[0].happened(1.5, "opening")
    assert [text for _, _, text in client.news(first[-1][0])["lines"]] == ["ecu 1.500 s: opening"]
    client.close()


def test_an_alarm_is_logged_and_contained_in_each_later_answer_to_a_client(server: tuple[Server, Memory]) -> None:
    client = Client(os.getpid())
    server[0].say("before")
    server[0].alarm("1.000 s: can0 is bus-off")
    news = client.news(0)
    assert news["alarms"] == news["lines"][1:]
    assert news["alarms"][0][2] == "1.000 s: can0 is bus-off"
    assert client.news(news["lines"][-1][0])["alarms"] == news["alarms"]
    client.close()


def test_a_client_of_another_version_is_refused(
    server: tuple[Server, Memory], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.operate.attachment.client.version", lambda: "9.9")
    gc.collect()  # what other tests have left
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(ConfigError, match=r"runs liftgate-hil .*, this is 9\.9"):
        Client(os.getpid())
    for _ in range(500):
        time.sleep(0.01)
        if len(list(Path("/proc/self/fd").iterdir())) <= before:
            return
    raise AssertionError("something is still open")
