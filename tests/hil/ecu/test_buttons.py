"""Driver's buttons of the reference ECU on its bus: each press is one request, and invalid frames are ignored."""

from __future__ import annotations

from typing import Any

import pytest
from hil_support import shipped_rig, text_file

import liftgate_hil as lh
from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.transmit import encode
from liftgate_hil.ecu.buttons import buttons_of, nothing_pressed, pressed_in
from liftgate_hil.ecu.memory import NO_REQUEST
from liftgate_hil.stimuli.moments import NEVER, Sheet
from liftgate_hil.stimuli.requests import ACTIONS
from liftgate_hil.stimuli.restbus import SignalChange, restbus_of

RIG = shipped_rig()
NAME = "DriverRequest.Button"
NONE, OPEN, CLOSE, STOP = range(4)


class Panel:
    """A sender of button messages; `press` returns the action that the reference ECU decodes, or NO_REQUEST."""

    def __init__(self) -> None:
        self._bus = restbus_of([SignalChange(NEVER, NAME, 0.0)], Sheet(), RIG.tables)
        self._buttons = buttons_of(RIG)
        self._state = nothing_pressed(self._buttons)
        self._turn = 0

    def press(self, button: int, bend: int = 0, turn: int = 1) -> int:
        self._turn += turn
        room = self._bus.room
        self._bus.transmission.values[0] = button
        encode(self._bus.bus, 0, self._bus.transmission.values, self._turn, room, 0)
        room.data[0, 0] ^= bend
        frames = Frames(1, room.identifiers, room.lengths, room.data)
        return int(pressed_in(self._buttons, self._state, frames, self._turn * 20_000_000))


def test_a_button_press_is_one_request_however_long_it_lasts() -> None:
    panel = Panel()
    assert panel.press(NONE) == NO_REQUEST
    assert [panel.press(OPEN) for _ in range(3)] == [ACTIONS.index("open"), NO_REQUEST, NO_REQUEST]
    assert panel.press(STOP) == ACTIONS.index("stop")
    assert panel.press(NONE) == NO_REQUEST
    assert panel.press(CLOSE) == ACTIONS.index("close")


@pytest.mark.parametrize("wrong", [{"bend": 1}, {"turn": 0}], ids=["checksum", "counter"])
def test_a_button_frame_with_a_wrong_checksum_or_counter_is_ignored(wrong: dict[str, Any]) -> None:
    panel = Panel()
    panel.press(NONE)
    assert panel.press(OPEN, **wrong) == NO_REQUEST
    assert panel.press(OPEN) == ACTIONS.index("open")


def test_a_button_press_on_the_bus_opens_the_gate(tmp_path: Any) -> None:
    path = text_file(
        tmp_path / "s.toml", f'duration = 1.5\n[[signal]]\nsignal = "{NAME}"\ntime = 0.3\nvalue = "open"\n'
    )
    result = lh.run(path)
    assert [each.text for each in result.events] == ["opening"]
    assert result.maxima["gate_angle_deg"] > 0.1
