"""Texts about refused and foreign frames, from the codec's note on the first such frame."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hil_support import frames_of

from liftgate_hil.codec.frames import BRS, EXTENDED, FD
from liftgate_hil.codec.receive import NO_COUNTS, receive
from liftgate_hil.codec.refusals import (
    BAD_CHECKSUM,
    FOREIGN,
    REMOTE_FRAME,
    no_refusals,
    note_checksums,
    note_evidence,
    note_outcome,
)
from liftgate_hil.config.rig import Rig
from liftgate_hil.loop.refusal_texts import RefusalTexts
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.plan.plan import loop_config_of, start_of
from tests.plant.runs import suv


def texts(rig: Rig, began_s: float = 0.0) -> RefusalTexts:
    return RefusalTexts(rig, loop_config_of(suv(), rig, 1000.0, 0), began_s)


def test_with_a_correct_checksum_the_counter_or_the_data_id_is_named_as_wrong(rig: Rig) -> None:
    for counter, said in (
        (15.0, "AliveCounter is 15; expected one of its values"),
        (None, "data ID does not belong to this message (Checksum is correct)"),
    ):
        refusals = no_refusals()
        note_checksums(refusals, 0x51, 0x51)
        if counter is not None:
            note_evidence(refusals, BAD_CHECKSUM, -1, counter, np.nan)
        note_outcome(refusals, BAD_CHECKSUM, 0, 2_500_000_000)
        assert texts(rig).of_first(refusals, BAD_CHECKSUM) == f"2.500 s: DriveCommand refused: {said}"


def test_times_in_refusal_texts_count_from_time_0_of_the_scenario(rig: Rig) -> None:
    refusals = no_refusals()
    note_outcome(refusals, REMOTE_FRAME, 0, 2_500_000_000)
    said = "DriveCommand refused: a remote frame; allowed: a data frame"
    assert texts(rig, 2.0).of_first(refusals, REMOTE_FRAME) == f"0.500 s: {said}"
    assert texts(rig, 3.0).of_first(refusals, REMOTE_FRAME) == f"precondition: {said}"


def test_a_refused_message_is_not_taken_for_an_extended_one_of_the_same_number(rig: Rig) -> None:
    other = SimpleNamespace(frame_id=0x120, is_extended_frame=True)
    refusals = no_refusals()
    note_outcome(refusals, REMOTE_FRAME, 0, 0)
    known = RefusalTexts(
        replace(rig, messages={"Other": other, **rig.messages}), loop_config_of(suv(), rig, 1000.0, 0)
    )
    assert "DriveCommand refused" in known.of_first(refusals, REMOTE_FRAME)


def test_a_summary_names_the_first_foreign_identifier_with_its_length_and_what_is_awaited(rig: Rig) -> None:
    reception = start_of(loop_config_of(suv(), rig, 1000.0, 0)).reception
    refusals = reception.refusals
    note_evidence(refusals, FOREIGN, -1, float(0x120 | EXTENDED), np.nan)
    note_outcome(refusals, FOREIGN, -1, 0)
    summary = Summary()
    summary.received = summary.received._replace(foreign=3)
    texts(rig).tell(summary, reception)
    assert summary.first_refused == []
    assert summary.silence_reported() == (
        "no command was accepted, 3 frames have identifiers that the rig does not receive, the first 0x120 "
        "(extended, 29 bits); awaited: DriveCommand (0x120)"
    )


def test_a_summary_says_if_the_first_foreign_identifier_is_that_of_another_gate(rig: Rig) -> None:
    refusals = no_refusals()
    note_evidence(refusals, FOREIGN, -1, float(0x210), np.nan)
    note_outcome(refusals, FOREIGN, -1, 0)
    assert (
        texts(rig).first_foreign(refusals)
        == "0x210, which this gate sends: another bench or a replay is on this bus"
    )
    without = RefusalTexts(rig, texts(rig)._config, is_bus=False)
    assert without.first_foreign(refusals) == "0x210, which this gate sends: it must not come from the ECU"


@pytest.mark.parametrize(
    ("identifier", "began_s", "said"),
    [
        (0x120, 0.0, "DriveCommand (0x120) at 2.500 s"),
        (0x120, 3.0, "DriveCommand (0x120) in the precondition"),
        (0x120 | EXTENDED, 0.0, "0x120 (extended, 29 bits) at 2.500 s"),
        (0x55, 0.0, "0x55 at 2.500 s"),
    ],
)
def test_a_summary_names_the_first_can_fd_frame(rig: Rig, identifier: int, began_s: float, said: str) -> None:
    config = loop_config_of(suv(), rig, 1000.0, 0)
    reception = start_of(config).reception
    summary = Summary()
    texts(rig, began_s).tell(summary, reception)
    assert (summary.fd_frames, summary.first_fd_frame) == (0, "")
    rows = [(0x44, b""), (identifier | FD, bytes(8)), (0x33 | FD | BRS, bytes(8))]
    receive(config.inputs, reception, NO_COUNTS, frames_of(rows), 2_500_000_000)
    texts(rig, began_s).tell(summary, reception)
    assert (summary.fd_frames, summary.first_fd_frame) == (2, said)
