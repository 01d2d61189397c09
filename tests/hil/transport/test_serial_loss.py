"""Serial ports that vanish and return: losses counted, ports reopened, no leaks."""

from __future__ import annotations

import threading

import pytest
from hil_support import frames_of, rows_of, wait_for
from serial_lines import ROWS, line_of
from serial_peers import Server, Terminal, descriptors, opened

from liftgate_hil.transport import serial_open
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.cobs import CobsDecoder, encode
from liftgate_hil.transport.serial_port import SerialTransport


def test_a_port_that_vanishes_and_returns_a_hundred_times_leaks_nothing(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(serial_open, "_REOPEN_S", 0.005)
    with opened(str(terminal.link)) as line:
        files, threads = descriptors(), threading.active_count()
        for cycle in range(100):
            terminal.unplug()
            wait_for(lambda: not (line.receive(), line.is_up)[1], "the loss was not noticed")
            assert line.counts().losses == cycle + 1
            line.send(frames_of(ROWS))
            assert line.counts().send_failures == (cycle + 1) * len(ROWS)
            terminal.plug()
            wait_for(lambda: (line.receive(), line.is_up)[1], "the port did not come back")
            line.send(frames_of(ROWS))
            assert CobsDecoder().feed(terminal.read()) == ROWS
            terminal.write(line_of(ROWS))
            assert rows_of(line.receive(timeout=5.0)) == ROWS
            assert (descriptors(), threading.active_count()) == (files, threads)


def test_a_loss_within_a_frame_does_not_corrupt_the_next_frame(terminal: Terminal):
    with opened(str(terminal.link)) as line:
        terminal.write(encode(1, b"12345678")[:6])
        line.receive(timeout=0.02)
        terminal.unplug()
        wait_for(lambda: not (line.receive(), line.is_up)[1], "the loss was not noticed")
        terminal.plug()
        wait_for(lambda: (line.receive(), line.is_up)[1], "the port did not come back")
        terminal.write(line_of(ROWS))
        assert rows_of(line.receive(timeout=5.0)) == ROWS
        assert line.counts() == LinkCounts(losses=1)


def test_a_lost_port_is_noticed_while_sending_too(terminal: Terminal, line: SerialTransport):
    terminal.unplug()
    line.send(frames_of(ROWS))
    assert line.counts() == LinkCounts(send_failures=len(ROWS), losses=1)
    assert not line.is_up


def test_closing_a_lost_port_ends_its_thread(terminal: Terminal):
    files, threads = descriptors(), threading.active_count()
    transport = SerialTransport(str(terminal.link))
    terminal.unplug()
    wait_for(lambda: not (transport.receive(), transport.is_up)[1], "the loss was not noticed")
    transport.close()
    transport.close()
    assert (descriptors(), threading.active_count()) == (files - 1, threads)  # and the master's


def test_a_socket_that_was_closed_is_reconnected(server: Server):
    files = descriptors()
    with opened(f"socket://127.0.0.1:{server.port}") as line:
        threads = threading.active_count()
        for cycle in range(3):
            server.accept()
            assert server.client is not None
            server.client.sendall(line_of(ROWS))
            assert rows_of(line.receive(timeout=5.0)) == ROWS
            wait_for(lambda: (line.receive(), line.is_up)[1], "the socket did not come back")
            line.send(frames_of(ROWS))
            server.client.settimeout(5.0)
            assert CobsDecoder().feed(server.client.recv(4096)) == ROWS
            server.drop()
            wait_for(lambda: not (line.receive(), line.is_up)[1], "the loss was not noticed")
            assert line.counts().losses == cycle + 1
            server.listen()
            wait_for(lambda: (line.receive(), line.is_up)[1], "the socket did not come back")
            assert threading.active_count() == threads
    server.accept()
    server.drop()
    assert descriptors() == files - 1  # and the listener's
