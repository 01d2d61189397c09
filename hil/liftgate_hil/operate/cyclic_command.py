"""Cyclic drive command that is sent in place of an ECU's, with given quantities, until it is changed."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.transmit import encode
from liftgate_hil.config.described import number_of
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.signal_mapping import missing_values
from liftgate_hil.config.toml import show
from liftgate_hil.ecu.reference import EcuConfig, message_rows
from liftgate_hil.errors import ConfigError
from liftgate_hil.loop.tick import LoopConfig
from liftgate_hil.signals import BUS_INPUTS, DIRECTIONS, IN, INPUT_COUNT

_LATCH = ("latch_release", "latch_cinch")
_KNOWN = ("left_duty", "right_duty", "left_direction", "right_direction", *_LATCH)


class CyclicCommand:
    """Cyclic drive command: its quantities, encoded by rig and codec, with counter and checksum.

    Nothing is sent before the first command. `bus` is what an ECU on this rig sends.
    """

    def __init__(self, rig: Rig, config: LoopConfig, bus: EcuConfig) -> None:
        self.cycle = max(1, round(rig.command_cycle_ms() * 1e6 / config.step_ns))  # ticks
        self._is_signed = {"left": config.signed_left, "right": config.signed_right}
        self._without_values = {each.quantity: missing_values(each) for each in rig.inputs}
        self._bus = bus
        self._cinching = message_rows(rig, ["latch_cinch"])
        self._sent = np.zeros(len(config.inputs.messages), dtype=np.int64)
        self._values: NDArray[np.float64] | None = None  # of the command; None: nothing is sent

    @property
    def is_on(self) -> bool:
        """Whether the command is being sent."""
        return self._values is not None

    def silence(self) -> None:
        """Stop sending the command until the next `change`."""
        self._values = None

    def change(self, quantities: Mapping[str, float | str | bool]) -> None:
        """Send these quantities from the next cycle on, see `Gate.command`. Raises ConfigError, with no change."""
        values = np.full(INPUT_COUNT, np.nan)
        both = quantities.get("direction")
        for name in quantities:
            if name not in (*_KNOWN, "direction"):
                raise ConfigError(f"`command` {name}: allowed: {', '.join((*_KNOWN, 'direction'))}")
        for side in ("left", "right"):
            direction = quantities.get(f"{side}_direction", both)
            given = quantities.get(f"{side}_duty", 0.0)
            duty = number_of(f"{side}_duty", given, -100.0, 100.0, "%")
            if self._is_signed[side]:
                duty = _signed(duty, direction)
            direction = "coast" if direction is None else direction
            if not isinstance(direction, str) or direction not in DIRECTIONS:
                allowed = ", ".join(DIRECTIONS)
                raise ConfigError(f"`{side}_direction` {show(direction)}: allowed: {allowed}")
            values[getattr(IN, f"{side}_duty")] = duty
            values[getattr(IN, f"{side}_direction")] = DIRECTIONS.index(direction)
        for name in _LATCH:
            on = quantities.get(name, False)
            if not isinstance(on, Real | np.bool_) or on not in (0, 1):
                raise ConfigError(f"`{name}` {show(on)}: allowed: True, False")
            if name == "latch_release" or name in quantities:
                values[getattr(IN, name)] = float(on)
        self._check_values(values)
        self._values = values

    def _check_values(self, values: NDArray[np.float64]) -> None:
        """Raise ConfigError if the rig has no value for one of the labels that the command's values stand for."""
        for name, missing in self._without_values.items():
            number, labels = values[getattr(IN, name)], BUS_INPUTS[name].values
            if not np.isnan(number) and labels and labels[int(number)] in missing:
                allowed = ", ".join(each for each in labels if each not in missing)
                given = labels[int(number)]
                raise ConfigError(f"`{name}` {given}: the rig has no value for it; allowed: {allowed}")

    def frames_at(self, tick: int) -> list[tuple[int, int, bytes]]:
        """Return the frames that are due before a tick: identifier, length and data of each."""
        values = self._values
        if values is None or tick % self.cycle:
            return []
        rows = [int(row) for row in self._bus.commands]
        if not np.isnan(values[IN.latch_cinch]):
            rows += [row for row in self._cinching if row not in rows]
        frames = empty_frames(len(rows))
        found = []
        for place, row in enumerate(rows):
            encode(self._bus.outputs, row, values, int(self._sent[row]), frames, place)
            self._sent[row] += 1
            length = int(frames.lengths[place])
            data = frames.data[place, :length].tobytes()
            found.append((int(frames.identifiers[place]), length, data))
        return found


def _signed(duty: float, direction: Any) -> float:
    """Return a duty [%] with the sign of the direction, if given; 0 for brake. Raises ConfigError for coast."""
    if isinstance(direction, str) and direction == "coast":
        allowed = "allowed: open, close, brake, or silence"
        raise ConfigError(f"`direction` coast: it has no signal in this rig; {allowed}")
    turned = {"open": abs(duty), "close": -abs(duty), "brake": 0.0}
    return turned.get(direction, duty) if isinstance(direction, str) else duty
