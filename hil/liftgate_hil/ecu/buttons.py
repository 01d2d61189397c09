"""Driver's buttons received on the bus: the ECU's side of the rig's table [requests]."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined
from liftgate_hil.codec.bus_config import tables_named
from liftgate_hil.codec.frames import FD_FLAGS, Frames
from liftgate_hil.codec.receive import NO_COUNTS, Reception, find_message, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.ecu.memory import NO_REQUEST
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.requests import ACTIONS, BUTTONS

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


class Buttons(NamedTuple):
    """Bus signals of the driver's buttons, and how to decode them."""

    bus: BusConfig
    place: NDArray[np.int64]  # (buttons,) row of the button's signal
    value: NDArray[np.float64]  # (buttons,) value of the signal while the button is pressed
    action: NDArray[np.int64]  # (buttons,) index into stimuli.requests.ACTIONS


class ButtonState(NamedTuple):
    """The last received state of the buttons; written in place."""

    reception: Reception
    is_pressed: NDArray[np.int64]  # (buttons,) 1: pressed


def buttons_of(rig: Rig) -> Buttons:
    """Return the bus signals of the driver's buttons in a rig. Raises ConfigError."""
    own = {action: rig.driver.buttons[action] for action in BUTTONS if action in rig.driver.buttons}
    names = list(dict.fromkeys(each.signal for each in own.values()))
    issues = ConfigIssues(rig.source)
    bus = tables_named(rig.messages, names, rig.options, issues, False)
    issues.raise_if_any()
    return Buttons(
        bus,
        np.array([names.index(each.signal) for each in own.values()], dtype=np.int64),
        np.array([each.value for each in own.values()]),
        np.array([ACTIONS.index(action) for action in own], dtype=np.int64),
    )


def nothing_pressed(buttons: Buttons) -> ButtonState:
    """Return the buttons' state before the first frame, in which no button is pressed."""
    return ButtonState(
        nothing_received(buttons.bus, len(buttons.bus.signals)), np.zeros(len(buttons.action), dtype=np.int64)
    )


@compilable
def pressed_in(buttons: Buttons, state: ButtonState, frames: Frames, now_ns: int) -> int:
    """Store which buttons these frames press, and return the request of a newly pressed one, or NO_REQUEST."""
    if len(buttons.bus.messages) > 0:
        for row in range(frames.count):
            if find_message(buttons.bus, int(frames.identifiers[row]) & ~FD_FLAGS) >= 0:
                return hear(buttons, state, frames, now_ns)
    return NO_REQUEST


@outlined
def hear(buttons: Buttons, state: ButtonState, frames: Frames, now_ns: int) -> int:
    """Decode the frames, store which buttons are pressed; return a newly pressed one's request, or NO_REQUEST."""
    receive(buttons.bus, state.reception, NO_COUNTS, frames, now_ns)
    asked = NO_REQUEST
    for button in range(len(buttons.action)):
        is_pressed = state.reception.values[buttons.place[button]] == buttons.value[button]
        if is_pressed and state.is_pressed[button] == 0:
            asked = buttons.action[button]
        state.is_pressed[button] = int(is_pressed)
    return asked
