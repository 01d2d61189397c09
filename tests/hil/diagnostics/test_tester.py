"""The bench's diagnostic tester: when it sends requests, and what it accepts as responses; without a bus."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hil_support import frames_of

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.diagnostics import tester as bench
from liftgate_hil.diagnostics.tester import (
    NO_FAILURE,
    NO_RESPONSE,
    Diagnostics,
    answer_in,
    asking_once,
    failure_of,
    is_asking_once,
    wants_reset,
    with_requests,
)

REQUEST, RESPONSE = 0x7A0, 0x7A8
OWN = Diagnostics(REQUEST, RESPONSE, period=0.1, patience=0.25)
MS = 1_000_000
CLEAR, READ, RESET = (bytes.fromhex(each) for each in ("14ffffff", "190209", "1101"))


def asked(tester: bench.Tester, milliseconds: range, answers: dict[int, str]) -> list[tuple[int, str]]:
    """Return the requests and their times [ms], in ticks of 1 ms; `answers` are single frames' data by tick."""
    found = []
    for now in milliseconds:
        if now in answers:
            data = bytes.fromhex(answers[now])
            bench.tester_hears(tester, frames_of([(RESPONSE, bytes([len(data)]) + data)]), now * MS)
        frames = with_requests(tester, empty_frames(0), now * MS)
        for place in range(frames.count):
            size = int(frames.data[place, 0])
            found.append((now, frames.data[place, 1 : 1 + size].tobytes().hex()))
    return found


def test_a_reset_waits_for_the_response_to_the_previous_request() -> None:
    tester = bench.tester_of(OWN, CLEAR, READ, RESET)
    assert asked(tester, range(3), {2: "54"}) == [(0, "14ffffff"), (2, "190209")]
    wants_reset(tester)
    assert asked(tester, range(3, 20), {9: "59027f"}) == [(9, "1101")]
    assert is_asking_once(tester)
    # The readings go on in their cycle, which begins with the first one.
    assert asked(tester, range(20, 300), {21: "5101", 110: "59027f"}) == [(102, "190209"), (202, "190209")]
    assert not is_asking_once(tester)
    assert failure_of(tester) == NO_FAILURE


def test_a_tester_for_resets_alone_sends_nothing_else_and_can_reset_again() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    assert asked(tester, range(500), {}) == []
    for start in (500, 1000):
        wants_reset(tester)
        span = range(start, start + 500)
        assert asked(tester, span, {start + 3: "5101"}) == [(start, "1101")]
    assert failure_of(tester) == NO_FAILURE


def test_a_reset_without_a_response_is_not_sent_again() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    wants_reset(tester)
    assert asked(tester, range(250), {}) == [(0, "1101")]
    assert is_asking_once(tester)
    assert asked(tester, range(250, 2000), {}) == []
    assert not is_asking_once(tester)
    assert failure_of(tester) == NO_RESPONSE


def test_a_failed_reset_is_still_reported_after_a_successful_one() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    wants_reset(tester)
    asked(tester, range(10), {5: "7f1122"})
    wants_reset(tester)
    assert asked(tester, range(10, 20), {15: "5101"}) == [(10, "1101")]
    assert failure_of(tester) == 0x22


def test_a_request_with_repetition_is_sent_again_until_the_response() -> None:
    tester = asking_once(OWN, RESET, is_repeated=True)
    assert asked(tester, range(600), {}) == [(0, "1101"), (251, "1101"), (502, "1101")]
    assert asked(tester, range(600, 1500), {600: "5101"}) == []
    assert (is_asking_once(tester), failure_of(tester)) == (False, NO_FAILURE)


@pytest.mark.parametrize("make", [asking_once, lambda own, request: asking_once(own, request, True)])
def test_each_response_pending_prolongs_the_wait(make: Callable[[Diagnostics, bytes], bench.Tester]) -> None:
    tester = make(OWN, RESET)
    pending = dict.fromkeys((200, 5100, 10_000), "7f1178")
    assert asked(tester, range(14_000), pending) == [(0, "1101")]
    assert is_asking_once(tester)
    assert asked(tester, range(14_000, 14_500), {14_000: "5101"}) == []
    assert (is_asking_once(tester), failure_of(tester)) == (False, NO_FAILURE)


def test_a_request_refused_as_busy_is_sent_again_a_period_later() -> None:
    tester = asking_once(OWN, RESET)
    assert asked(tester, range(200), {5: "7f1121"}) == [(0, "1101"), (105, "1101")]


@pytest.mark.parametrize("other", ["5102", "51", "5001", "7f1022", "7f11", "54", "59027f", "1101"])
def test_responses_to_other_requests_are_ignored(other: str) -> None:
    tester = asking_once(OWN, RESET)
    asked(tester, range(10), {5: other})
    assert is_asking_once(tester)
    asked(tester, range(10, 20), {15: "5101"})
    assert not is_asking_once(tester)


def test_only_the_first_response_is_kept() -> None:
    tester = asking_once(OWN, READ)
    asked(tester, range(10), {5: "59027f9a0162"})
    asked(tester, range(10, 20), {15: "59027f"})
    assert answer_in(tester) == bytes.fromhex("59027f9a0162")
    both = asking_once(OWN, CLEAR)
    asked(both, range(3), {})
    frames = frames_of([(RESPONSE, bytes.fromhex("0154")), (RESPONSE, bytes.fromhex("027f14"))])
    bench.tester_hears(both, frames, 4 * MS)
    assert answer_in(both) == bytes.fromhex("54")
