"""The bench's tester: what it asks when, and what it takes for an answer; tick by tick, without a bus."""

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
    """What it asks and when [ms], in ticks of 1 ms; `answers` are single frames' data by the tick they come in."""
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


def test_a_reset_waits_for_the_answer_to_what_was_asked_before() -> None:
    tester = bench.tester_of(OWN, CLEAR, READ, RESET)
    assert asked(tester, range(3), {2: "54"}) == [(0, "14ffffff"), (2, "190209")]
    wants_reset(tester)
    assert asked(tester, range(3, 20), {9: "59027f"}) == [(9, "1101")]
    assert is_asking_once(tester)
    # The readings go on in their cycle, which begins with the first one.
    assert asked(tester, range(20, 300), {21: "5101", 110: "59027f"}) == [(102, "190209"), (202, "190209")]
    assert not is_asking_once(tester)
    assert failure_of(tester) == NO_FAILURE


def test_a_reset_alone_asks_for_nothing_else_and_can_be_wanted_again() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    assert asked(tester, range(500), {}) == []
    for start in (500, 1000):
        wants_reset(tester)
        span = range(start, start + 500)
        assert asked(tester, span, {start + 3: "5101"}) == [(start, "1101")]
    assert failure_of(tester) == NO_FAILURE


def test_without_a_response_a_reset_is_not_asked_for_again() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    wants_reset(tester)
    assert asked(tester, range(250), {}) == [(0, "1101")]
    assert is_asking_once(tester)
    assert asked(tester, range(250, 2000), {}) == []
    assert not is_asking_once(tester)
    assert failure_of(tester) == NO_RESPONSE


def test_a_reset_that_failed_is_not_forgotten_when_the_next_one_is_made() -> None:
    tester = bench.tester_of(OWN, b"", b"", RESET)
    wants_reset(tester)
    asked(tester, range(10), {5: "7f1122"})
    wants_reset(tester)
    assert asked(tester, range(10, 20), {15: "5101"}) == [(10, "1101")]
    assert failure_of(tester) == 0x22


def test_what_is_asked_once_is_asked_again_where_that_is_wanted() -> None:
    tester = asking_once(OWN, RESET, is_repeated=True)
    assert asked(tester, range(600), {}) == [(0, "1101"), (251, "1101"), (502, "1101")]
    assert asked(tester, range(600, 1500), {600: "5101"}) == []
    assert (is_asking_once(tester), failure_of(tester)) == (False, NO_FAILURE)


@pytest.mark.parametrize("make", [asking_once, lambda own, request: asking_once(own, request, True)])
def test_response_pending_prolongs_the_wait_each_time(make: Callable[[Diagnostics, bytes], bench.Tester]) -> None:
    tester = make(OWN, RESET)
    pending = dict.fromkeys((200, 5100, 10_000), "7f1178")
    assert asked(tester, range(14_000), pending) == [(0, "1101")]
    assert is_asking_once(tester)
    assert asked(tester, range(14_000, 14_500), {14_000: "5101"}) == []
    assert (is_asking_once(tester), failure_of(tester)) == (False, NO_FAILURE)


def test_a_busy_ecu_is_asked_again_a_period_later() -> None:
    tester = asking_once(OWN, RESET)
    assert asked(tester, range(200), {5: "7f1121"}) == [(0, "1101"), (105, "1101")]


@pytest.mark.parametrize("other", ["5102", "51", "5001", "7f1022", "7f11", "54", "59027f", "1101"])
def test_other_messages_are_no_answers(other: str) -> None:
    tester = asking_once(OWN, RESET)
    asked(tester, range(10), {5: other})
    assert is_asking_once(tester)
    asked(tester, range(10, 20), {15: "5101"})
    assert not is_asking_once(tester)


def test_the_answer_stays_as_it_came() -> None:
    tester = asking_once(OWN, READ)
    asked(tester, range(10), {5: "59027f9a0162"})
    asked(tester, range(10, 20), {15: "59027f"})
    assert answer_in(tester) == bytes.fromhex("59027f9a0162")
    both = asking_once(OWN, CLEAR)
    asked(both, range(3), {})
    frames = frames_of([(RESPONSE, bytes.fromhex("0154")), (RESPONSE, bytes.fromhex("027f14"))])
    bench.tester_hears(both, frames, 4 * MS)
    assert answer_in(both) == bytes.fromhex("54")
