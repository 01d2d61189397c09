"""`SerialTransport`: frames arrive complete, nothing blocks, a lost port is reopened."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path

import pytest
import serial.rfc2217
from hil_support import EXTENDED, database_of, frames_of, issues_of, rig_of, rows_of, wait_for
from serial_lines import ROWS, line_of
from serial_peers import Server, Terminal, descriptors, opened

from liftgate_hil.codec.frames import ERROR, FD, REMOTE, empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError, TransportError
from liftgate_hil.transport import serial_port
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.cobs import CobsDecoder, encode
from liftgate_hil.transport.find import WireChoice, check_serial, find_way, open_transport
from liftgate_hil.transport.serial_open import parse_serial
from liftgate_hil.transport.serial_port import CAPACITY, SerialTransport

# --serial.


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/dev/ttyUSB0", ("/dev/ttyUSB0", 921_600)),
        ("/dev/ttyUSB0@115200", ("/dev/ttyUSB0", 115_200)),
        ("/dev/a@b", ("/dev/a@b", 921_600)),
        ("/dev/a@b@9600", ("/dev/a@b", 9600)),
        ("/dev/a@", ("/dev/a@", 921_600)),
        ("/dev/by-id/usb@1.2", ("/dev/by-id/usb@1.2", 921_600)),
        ("COM3@250000", ("COM3", 250_000)),
        ("loop://", ("loop://", 921_600)),
        ("socket://localhost:7000@9600", ("socket://localhost:7000", 9600)),
        ("socket://[::1]:7000", ("socket://[::1]:7000", 921_600)),
        ("spy:///dev/ttyS0?file=x@57600", ("spy:///dev/ttyS0?file=x", 57_600)),
    ],
)
def test_a_serial_line_is_specified_by_port_and_baud_rate(text: str, expected: tuple[str, int]):
    assert parse_serial(text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "@9600", "x@0", "x@12", "x@1199", "x@99999999", "loop://@abc",
     "x@" + "9" * 5000, "socket://", "socket://h", "socket://:1",
     "socket://h:0", "socket://h:70000", "socket://h:x", "rfc2217://h", "socket://["],
)  # fmt: skip
def test_an_invalid_value_of_the_option_serial_is_reported_as_one_issue(text: str):
    (issue,) = issues_of(parse_serial, text)
    assert "`serial`" in issue
    assert "allowed" in issue


@pytest.mark.parametrize("url", ["/dev/nosuch", "/dev/null", "hwgrep://nosuch", "spy:///dev/nosuch"])
def test_a_serial_port_that_cannot_be_opened_is_reported_on_one_line(url: str):
    before = descriptors()
    with pytest.raises(TransportError) as caught:
        SerialTransport(url)
    assert str(caught.value).startswith(f"`serial` {url}: cannot be opened: ")
    assert "\n" not in str(caught.value)
    assert descriptors() == before


def test_a_path_that_is_no_serial_device_is_reported_with_what_it_is(tmp_path: Path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "file").write_text("")
    for name, what in (("fifo", "a FIFO"), ("file", "a file"), (".", "a folder")):
        with pytest.raises(ConfigError, match=rf"{what}, not a serial device; allowed: a device"):
            SerialTransport(str(tmp_path / name))
    with pytest.raises(TransportError, match=r"/dev/null: cannot be opened: not a serial device$"):
        SerialTransport("/dev/null")
    with pytest.raises(TransportError, match=r"cannot be opened: no such device$"):
        SerialTransport(str(tmp_path / "tty"))


def test_an_invalid_baud_rate_is_reported_if_the_device_exists(terminal: Terminal):
    with pytest.raises(TransportError, match=r"no such device; 'fast' is not a baud rate for /"):
        SerialTransport(f"{terminal.link}@fast")


@pytest.mark.parametrize("error", [TypeError(), RuntimeError("gone"), OSError(5, "I/O error")])
@pytest.mark.parametrize("name", ["read", "write"])
def test_any_exception_for_a_removed_device_means_a_lost_line(
    line: SerialTransport, monkeypatch: pytest.MonkeyPatch, name: str, error: Exception
):
    def gone(*_: object) -> None:
        raise error

    monkeypatch.setattr(line._port, name, gone)
    line.send(frames_of(ROWS))
    line.receive()
    assert line.counts().losses == 1


def test_an_unknown_pyserial_protocol_is_reported():
    with pytest.raises(ConfigError, match=r"nosuch.*allowed"):
        SerialTransport("nosuch://x")


def test_a_serial_port_in_use_is_refused(terminal: Terminal, line: SerialTransport):
    with pytest.raises(TransportError, match="lock"):
        SerialTransport(str(terminal.link))


EXTENDED_BUS = database_of("""BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
BO_ 2566844672 Long: 8 Gate
 SG_ Current : 7|16@0- (0.01,0) [0|0] "A" ECU
""")
EXTENDED_RIG = """dbc = "their.dbc"
[inputs]
left_duty = "Cmd.Duty"
[outputs]
left_current = "Long.Current"
"""


def test_a_rig_with_29_bit_identifiers_is_refused_on_a_serial_line(tmp_path: Path, rig: Rig):
    their = rig_of(tmp_path, EXTENDED_BUS, EXTENDED_RIG)
    with pytest.raises(ConfigError, match=r"their.toml: Long has the 29-bit .*0x18fef100.*11-bit"):
        find_way(WireChoice(serial="loop://"), their)
    check_serial(rig)


def test_open_transport_opens_a_bus_or_a_serial_line(rig: Rig):
    for given in ({"serial": "loop://"}, {"bus": "virtual:flags"}):
        transport = open_transport(find_way(WireChoice(**given), rig))
        assert isinstance(transport, SerialTransport) == ("serial" in given)
        transport.close()
    with pytest.raises(ConfigError, match="one or the other"):
        find_way(WireChoice(serial="loop://", bus="virtual:flags"), rig)


# Frames.


def test_frames_are_sent_and_received_complete_over_a_serial_line(terminal: Terminal, line: SerialTransport):
    terminal.write(line_of(ROWS))
    assert rows_of(line.receive(timeout=5.0)) == ROWS
    assert line.receive().count == 0
    line.send(frames_of(ROWS))
    sent = terminal.read()
    # The first byte ends whatever the other end has heard before.
    assert sent == b"\0" + line_of(ROWS)
    line.send(frames_of(ROWS))
    assert terminal.read() == line_of(ROWS)
    line.send(empty_frames(3))
    assert terminal.read() == b""
    assert line.counts() == LinkCounts()
    assert line.name == str(terminal.link)


@pytest.mark.parametrize("url", ["loop://", "spy://{link}?file={folder}/spied"])
def test_pyserial_url_ports_work(terminal: Terminal, tmp_path: Path, url: str):
    with opened(url.format(link=terminal.link, folder=tmp_path)) as transport:
        transport.send(frames_of(ROWS))
        if not url.startswith("loop"):
            terminal.write(terminal.read())
        assert rows_of(transport.receive(timeout=5.0)) == ROWS
        assert transport.counts() == LinkCounts()


def test_a_long_payload_is_marked_as_can_fd(terminal: Terminal, line: SerialTransport):
    terminal.write(line_of([(0x100, bytes(9)), (0x101, bytes(64)), (0x102, bytes(8))]))
    got = rows_of(line.receive(timeout=5.0))
    assert got == [(0x100 | FD, bytes(9)), (0x101 | FD, bytes(64)), (0x102, bytes(8))]
    line.send(frames_of([(0x101 | FD, bytes(64))]))
    assert CobsDecoder().feed(terminal.read()) == [(0x101, bytes(64))]


@pytest.mark.parametrize("identifier", [0x123 | EXTENDED, 0x123 | REMOTE, 0x123 | ERROR, 0x800])
def test_frames_that_the_line_cannot_carry_are_counted_and_others_sent(
    terminal: Terminal, line: SerialTransport, identifier: int
):
    line.send(frames_of([(1, b"a"), (identifier, b""), (2, b"b")]))
    assert CobsDecoder().feed(terminal.read()) == [(1, b"a"), (2, b"b")]
    assert line.counts() == LinkCounts(send_failures=1)


def test_an_incomplete_frame_waits_for_its_remaining_bytes(terminal: Terminal, line: SerialTransport):
    whole = encode(0x120, b"12345678")
    terminal.write(whole[:5])
    assert line.receive(timeout=0.02).count == 0
    terminal.write(whole[5:])
    assert rows_of(line.receive(timeout=5.0)) == [(0x120, b"12345678")]


def test_bad_frames_are_counted_by_cause(terminal: Terminal, line: SerialTransport):
    bad = bytearray(encode(5, b"abc"))
    bad[4] ^= 1
    terminal.write(b"\x09abc\0" + b"\xff" * 99 + b"\0" + b"\x01\0" + bytes(bad) + encode(6, b""))
    assert rows_of(line.receive(timeout=5.0)) == [(6, b"")]
    assert line.counts() == LinkCounts(cut_frames=1, long_frames=1, short_frames=1, bad_crcs=1)


def test_a_read_returns_at_most_its_capacity_and_the_next_continues(line: SerialTransport):
    with opened("loop://") as loop:
        rows = [(number, b"") for number in range(CAPACITY + 7)]
        loop.send(frames_of(rows))
        first, second = loop.receive(), loop.receive()
        assert (first.count, second.count) == (CAPACITY, 7)
        assert rows_of(first) + rows_of(second) == rows


# A reader that does not read.


def test_frames_for_a_stalled_reader_are_dropped_entirely_and_counted(terminal: Terminal, line: SerialTransport):
    rows = [(number % 0x800, number.to_bytes(8, "big")) for number in range(10_000)]
    for start in range(0, len(rows), 10):
        line.send(frames_of(rows[start : start + 10]))
    failed = line.counts().send_failures
    assert 0 < failed < len(rows)
    decoder = CobsDecoder()
    got = decoder.feed(terminal.read())
    line.send(frames_of(ROWS))
    got += decoder.feed(terminal.read())
    # At most the one frame that was cut when the line was full; what follows it is whole.
    assert sum(decoder.counts) <= 1
    assert got[-len(ROWS) :] == ROWS
    # The kernel may make room again in between, when it gets to it.
    taken = [int.from_bytes(payload, "big") for _, payload in got[: -len(ROWS)]]
    assert got[: -len(ROWS)] == [rows[number] for number in taken]
    assert taken == sorted(set(taken))
    assert len(taken) == len(rows) - failed
    assert line.counts() == LinkCounts(send_failures=failed, send_queue_full=failed)


class Narrow:
    """A port whose first writes accept these numbers of bytes, and later ones all."""

    def __init__(self, takes: list[int]) -> None:
        self.takes = takes
        self.line = b""
        self.buffer_size = 1 << 20
        self.out_waiting = 0

    def fileno(self) -> int:
        return 1  # always has room, as standard output does

    def write(self, data: bytes) -> int:
        taken = data[: self.takes.pop(0)] if self.takes else data
        self.line += taken
        return len(taken)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("first", range(45))
@pytest.mark.parametrize("second", [0, 1, 7, 13, 14, 99])
def test_after_a_partial_write_the_next_frame_is_complete(first: int, second: int):
    with opened("loop://") as transport, Path(os.devnull).open("wb") as sink:
        narrow = Narrow([first, second])
        narrow.fileno = sink.fileno  # type: ignore[method-assign]
        transport._port = narrow
        rows = [(number, bytes([number]) * 8) for number in range(1, 10)]
        for start in (0, 3, 6):
            transport.send(frames_of(rows[start : start + 3]))
        decoder = CobsDecoder()
        got = decoder.feed(narrow.line)
        assert got[-3:] == rows[6:]
        assert all(row in rows for row in got)
        # What was counted as failed did not arrive, and the other way round.
        assert len(got) == len(rows) - transport.counts().send_failures


# Networks.


def test_a_stalled_socket_does_not_block(server: Server):
    with opened(f"socket://127.0.0.1:{server.port}") as line:
        server.accept()
        rows = frames_of([(number, bytes(64)) for number in range(200)])
        for _ in range(20_000):
            line.send(rows)
            if line.counts().send_failures:
                break
        assert line.counts().send_failures > 0
        assert line.is_up


def test_an_rfc_2217_port_sends_and_receives():
    """Tested with pyserial's own server, whose port echoes what it receives."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(30.0)
    stop = threading.Event()
    remote = threading.Thread(target=_serve_rfc2217, args=(listener, stop))
    remote.start()
    try:
        # pyserial 3.5 uses a deprecated method of threads.
        with pytest.warns(DeprecationWarning, match="set"):
            line = SerialTransport(f"rfc2217://127.0.0.1:{listener.getsockname()[1]}")
        line.send(frames_of(ROWS))
        back: list[tuple[int, bytes]] = []
        wait_for(lambda: back.extend(rows_of(line.receive(0.1))) or back == ROWS, "no answer")
        stop.set()
        wait_for(lambda: not (line.receive(), line.is_up)[1], "the loss was not noticed")
        line.close()
    finally:
        stop.set()
        remote.join()
        listener.close()


def _serve_rfc2217(listener: socket.socket, stop: threading.Event) -> None:
    """Echo what one client sends, by pyserial's RFC 2217 server, until `stop` is set."""
    client, _ = listener.accept()
    client.settimeout(0.005)
    device = serial.serial_for_url("loop://", timeout=0)

    class Writer:
        def write(self, data: bytes) -> None:
            client.sendall(data)

    manager = serial.rfc2217.PortManager(device, Writer())
    while not stop.is_set():
        echo = device.read(4096)
        if echo:
            client.sendall(b"".join(manager.escape(echo)))
        try:
            data = client.recv(4096)
        except TimeoutError:
            continue
        device.write(b"".join(manager.filter(data)))
    client.close()


class _Clock:
    """Clock that advances when somebody waits or reads."""

    def __init__(self) -> None:
        self.now_ns = 10**12

    def monotonic(self) -> float:
        return 1e-9 * self.now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(1e9 * seconds)


class _Port:
    """A port whose reads give `reads` one after the other, then nothing, and take `look_s` [s] each."""

    def __init__(self, clock: _Clock, look_s: float) -> None:
        self._clock, self._look_s = clock, look_s
        self.reads: list[bytes] = []

    def read(self, size: int) -> bytes:
        self._clock.sleep(self._look_s)
        return self.reads.pop(0) if self.reads else b""

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("look_s", "age_s"), [(0.004, 0.0), (0.030, 0.060)])
def test_a_serial_frame_is_at_most_as_old_as_the_last_empty_read(
    monkeypatch: pytest.MonkeyPatch, look_s: float, age_s: float
):
    """Commands that keep arriving during a wait are not old, however long the wait lasts."""
    clock = _Clock()
    port = _Port(clock, look_s)
    monkeypatch.setattr(serial_port, "time", clock)
    monkeypatch.setattr(serial_port, "check_device", lambda url: None)
    monkeypatch.setattr(serial_port, "open_port", lambda url, rate: port)
    monkeypatch.setattr(serial_port, "is_selectable", lambda port: False)
    transport = SerialTransport("a line")
    for _ in range(20):
        port.reads = [b"", b"", b"\0" + encode(0x120, b"\1")]
        frames = transport.receive(timeout=1.0)
        assert frames.count == 1
        age_ns = clock.monotonic_ns() - transport.came_ns[0]
        assert age_ns == pytest.approx(1e9 * age_s, abs=1e7 * (age_s > 0.0))
