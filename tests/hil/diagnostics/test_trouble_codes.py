"""Trouble codes as text and number, and their decoding from responses."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hil_support import logged

from liftgate_hil.codec.frames import LOGGED
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.answers import NO_ANSWER, Answers
from liftgate_hil.diagnostics.services import DecodedResponse, answer_of
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.diagnostics.trouble_code import number_of, text_of

RESPONSE = 0x7A8


@pytest.mark.parametrize(
    ("text", "number", "mask"),
    [
        ("P0143", 0x014300, 0xFFFF00), ("P0143-1C", 0x01431C, 0xFFFFFF), ("C1234", 0x523400, 0xFFFF00),
        ("B1A01-62", 0x9A0162, 0xFFFFFF), ("B3FFF-FF", 0xBFFFFF, 0xFFFFFF), ("U0100-87", 0xC10087, 0xFFFFFF),
    ],
)  # fmt: skip
def test_the_text_of_a_code_is_converted_to_a_number_and_back(text: str, number: int, mask: int) -> None:
    assert number_of(text) == (number, mask)
    assert text_of(number).startswith(text)


@pytest.mark.parametrize(
    "text", ["", "B1A0", "B1A011", "X1A01", "B4A01", "b1a01", "B1A01-6", "B1A01-621", "B1A0G", "B1A01 ", "0x9A01"]
)
def test_an_invalid_code_is_reported(text: str) -> None:
    with pytest.raises(ValueError, match="allowed: five characters such as B1A01"):
        number_of(text)


def frames_of_answers(*answers: str, identifier: int = RESPONSE) -> np.ndarray:
    """Return frames with these payloads, in hexadecimal, at intervals of a millisecond."""
    return logged([(k * 1_000_000, identifier, bytes.fromhex(answer)) for k, answer in enumerate(answers)])


def answers(*codes: str, mask: int = 0x09) -> Answers:
    return Answers(Diagnostics(0x7A0, RESPONSE, status_mask=mask), codes)


def test_the_last_frame_of_a_response_is_marked_with_the_reported_codes() -> None:
    """Two codes, one for any failure type, in single frames and in several frames."""
    own = answers("B1A01-62", "U1A01")
    none, one = "0359027FCCCCCCCC", "0759027F9A016209"
    both = ("100B59027F9A0162", "2108DA01870100CC")
    found = own.marks(frames_of_answers(none, one, *both, none))
    assert found.tolist() == [0, 0b01, NO_ANSWER, 0b11, 0]
    other = own.marks(frames_of_answers("0759027F9A016309", "0759027FDA010109"))
    assert other.tolist() == [0, 0b10]  # another failure type of the first
    assert own.marks(frames_of_answers(one, identifier=RESPONSE + 1)).tolist() == [NO_ANSWER]


def test_a_response_may_continue_in_the_next_block_of_frames() -> None:
    own = answers("U1A01-87")
    assert own.marks(frames_of_answers("100B59027F9A0162")).tolist() == [NO_ANSWER]
    assert own.marks(frames_of_answers("2108DA01870100CC")).tolist() == [1]


def test_the_status_mask_decides_which_codes_count_as_reported() -> None:
    pending = frames_of_answers("0759027F9A016204")
    assert answers("B1A01").marks(pending).tolist() == [0]
    assert answers("B1A01", mask=0x04).marks(pending).tolist() == [1]


def test_other_services_and_negative_responses_do_not_count_as_a_reading_of_trouble_codes() -> None:
    own = answers("B1A01")
    others = [
        "0154",
        "037F1978",
        "037F3E11",
        "047F191100",
        "0659017F00000A",
        "0259",
        "0859027F9A016209",
        "0362F190",
    ]
    assert own.marks(frames_of_answers(*others)).tolist() == [NO_ANSWER] * len(others)
    assert own.refused == "ReadDTCInformation: ServiceNotSupported (0x11)"
    assert answer_of(bytes.fromhex("59027F9A0162")) is None  # a code without its status
    assert answer_of(bytes.fromhex("7F1431")) == DecodedResponse(
        None, "ClearDiagnosticInformation: RequestOutOfRange (0x31)"
    )


def test_random_responses_raise_no_error() -> None:
    rng = np.random.default_rng(2)
    rows = np.zeros(4000, dtype=LOGGED)
    rows["identifier"], rows["length"] = RESPONSE, rng.integers(0, 9, len(rows))
    rows["payload"][:, :8] = rng.integers(0, 256, (len(rows), 8))
    rows["payload"][:, 0] = rng.choice([2, 3, 7, 0x10, 0x21, 0x22], len(rows))
    rows["payload"][:2000, 1:3] = 0x59, 2
    found = answers("B1A01").marks(rows)
    assert set(found.tolist()) <= {NO_ANSWER, 0, 1}
    assert (found == 0).any()


def test_requests_have_the_bytes_of_the_standard() -> None:
    assert services.read_request(0x09) == bytes.fromhex("190209")
    assert services.clear_request() == bytes.fromhex("14FFFFFF")


def test_a_missing_udsoncan_package_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    assert services.is_there()
    monkeypatch.setitem(sys.modules, "udsoncan", None)
    assert not services.is_there()
