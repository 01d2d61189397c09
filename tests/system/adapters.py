"""Stand-ins for the far ends of python-can's interfaces: slcan adapter, socketcand server, driver."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator

FRAMES = b"tTrR"  # how lines of slcan begin that are frames; all others are commands to the adapter

# A driver who asks again: an ECU that hears nothing for a while, on a busy machine, stops and forgets the request.
DRIVER = [flag for second in range(0, 90, 3) for flag in ("--request", f"{second + 0.2}:open")]


@contextlib.contextmanager
def running(step: Callable[[], None]) -> Iterator[None]:
    """Call `step` repeatedly in a thread until the context ends."""
    ended = threading.Event()

    def go() -> None:
        while not ended.is_set():
            step()

    thread = threading.Thread(target=go, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextlib.contextmanager
def slcan_adapters() -> Iterator[tuple[str, str]]:
    """Ports of two slcan adapters that are on one bus."""
    pairs = [pty.openpty() for _ in range(2)]
    for master, slave in pairs:
        tty.setraw(slave)
        os.set_blocking(master, False)
    masters = [master for master, _ in pairs]
    rest = dict.fromkeys(masters, b"")
    commands: set[bytes] = set()

    def step() -> None:
        for master in select.select(masters, [], [], 0.05)[0]:
            *lines, rest[master] = (rest[master] + os.read(master, 65536)).split(b"\r")
            frames = [line for line in lines if line[:1] in FRAMES and line]
            commands.update(line for line in lines if line not in frames)
            (other,) = (each for each in masters if each != master)
            with contextlib.suppress(BlockingIOError):  # nobody reads there: frames are lost, as on a bus
                os.write(other, b"".join(line + b"\r" for line in frames))

    try:
        with running(step):
            yield os.ttyname(pairs[0][1]), os.ttyname(pairs[1][1])
    finally:
        for pair in pairs:
            for end in pair:
                os.close(end)
    assert {b"S6", b"O"} <= commands  # opened, at 500 kbit/s


class Client:
    """Connection of one client to the socketcand server."""

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.rest = ""
        self.hears = False
        link.sendall(b"< hi >")

    def messages(self) -> list[list[str]]:
        """Messages received since the last call, each split into words; [] if there are none."""
        try:
            *said, self.rest = (self.rest + self.link.recv(65536).decode()).split(">")
        except OSError:
            return []
        return [each.strip(" <").split() for each in said]


@contextlib.contextmanager
def socketcand_server() -> Iterator[int]:
    """Port of a server with one bus, which passes each client's frames on to the others."""
    clients: list[Client] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def step() -> None:
            ready = select.select([server, *(each.link for each in clients)], [], [], 0.05)[0]
            if server in ready:
                clients.append(Client(server.accept()[0]))
            for client in [each for each in clients if each.link in ready]:
                said = client.messages()
                if not said:
                    clients.remove(client)
                for words in said:
                    if words[0] != "send":
                        client.link.sendall(b"< ok >")
                        client.hears |= words[0] == "rawmode"
                        continue
                    payload = "".join(word.zfill(2) for word in words[3:])
                    frame = f"< frame {words[1]} 1.000000 {payload} >".encode()
                    for other in clients:
                        if other is not client and other.hears:
                            other.link.sendall(frame)

        with running(step):
            yield server.getsockname()[1]
        for client in clients:
            client.link.close()
