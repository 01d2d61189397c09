"""Channel for a child process's answer: messages of other processes are ignored and delay nothing."""

from __future__ import annotations

import socket
import threading
import time

import pytest

from liftgate_hil.isolate import answers
from liftgate_hil.isolate.answers import AnswerChannel, BadAnswerError, send_answer


def connected(channel: AnswerChannel) -> socket.socket:
    other = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    other.connect("\0" + channel.address[0])
    return other


def test_an_answer_of_a_child_arrives_complete() -> None:
    payload = bytes(range(256)) * 10_000
    with AnswerChannel() as channel:
        child = threading.Thread(target=send_answer, args=(channel.address, payload))
        child.start()
        assert channel.take(60.0) == payload
        child.join()
        assert channel.take(0.0) is None


@pytest.mark.parametrize("said", [b"", b"LGHA", b"x" * 100])
def test_another_process_that_keeps_a_connection_open_is_soon_disconnected(
    monkeypatch: pytest.MonkeyPatch, said: bytes
) -> None:
    monkeypatch.setattr(answers, "_HEAD_S", 0.05)
    monkeypatch.setattr(answers, "_STALL_S", 3600.0)
    with AnswerChannel() as channel, connected(channel) as stranger:
        stranger.sendall(said)
        assert channel.take(60.0) is None
        child = threading.Thread(target=send_answer, args=(channel.address, b"ours"))
        child.start()
        assert channel.take(60.0) == b"ours"
        child.join()


@pytest.mark.parametrize(("change", "reason"), [(0, "ended"), (1, "checksum")])
def test_a_truncated_or_corrupted_answer_is_reported(change: int, reason: str) -> None:
    with AnswerChannel() as channel, connected(channel) as child:
        head = answers._HEAD.pack(b"LGHA", channel.address[1], 4, 0)
        child.sendall(head + b"abcd"[: 3 + change])
        child.shutdown(socket.SHUT_WR)
        with pytest.raises(BadAnswerError, match=reason):
            channel.take(60.0)


def test_waiting_for_an_answer_ends_at_its_timeout() -> None:
    begun = time.monotonic()
    with AnswerChannel() as channel:
        assert channel.take(0.01) is None
    assert time.monotonic() - begun < 60.0
