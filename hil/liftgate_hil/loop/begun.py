"""Where a run began, kept for those who step its gate again."""

from __future__ import annotations

from dataclasses import dataclass

from liftgate_hil.loop.tick import LoopConfig, LoopState, copied
from liftgate_hil.stimuli.scene import Scene


@dataclass(frozen=True)
class Begun:
    """Where a scenario's time 0 is: constants, the loop's state and the stimuli there, which stay as they are."""

    config: LoopConfig
    state: LoopState
    scene: Scene

    @classmethod
    def at(cls, config: LoopConfig, state: LoopState, scene: Scene) -> Begun:
        """A copy of what a loop is about to move on."""
        return cls(config, copied(state), copied(scene))
