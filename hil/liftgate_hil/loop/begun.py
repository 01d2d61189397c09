"""The beginning of a run, kept so that its gate can be stepped again."""

from __future__ import annotations

from dataclasses import dataclass

from liftgate_hil.loop.tick import LoopConfig, LoopState, copied
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


@dataclass(frozen=True)
class Begun:
    """Constants, loop state and stimuli at the scenario's time 0; they are never changed."""

    config: LoopConfig
    state: LoopState
    stimuli: StimulusPlan

    @classmethod
    def at(cls, config: LoopConfig, state: LoopState, stimuli: StimulusPlan) -> Begun:
        """Return a copy of what a loop is about to advance."""
        return cls(config, copied(state), copied(stimuli))
