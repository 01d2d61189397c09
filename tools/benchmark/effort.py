"""How much a benchmark does: as its page wants it, or shortened, so that each line of it still runs."""

from __future__ import annotations

from typing import NamedTuple


class Effort(NamedTuple):
    """Rounds, lengths and counts of all sections. The defaults are those of the page."""

    rounds: int = 0  # of a figure; 0: as many as each section takes by itself
    ticks: int | None = None  # of an episode; None: the demo's whole length
    steps: int = (
        200_000  # plant steps between two looks at the clock; ticks are fewer in proportion
    )
    demos: int = 11  # one after the other, against one, for the marginal pace
    cold_rounds: int = 3  # starts with an empty cache of machine code; 0: none, which costs nothing
    table_seconds: float = 3600.0  # of `simulate`
    identify_rows: tuple[tuple[int, int], ...] = ((10_000, 3), (100_000, 1), (1_000_000, 1))
    replay_seconds: float = 10.0  # of the log
    lateness_seconds: float = 0.0  # of each run; 0: as the flag says
    conditions: int | None = None  # of the lateness; None: all
    builds: int | None = None  # of the C translation; None: all

    def of(self, usual: int) -> int:
        """The rounds of a section that takes so many by itself."""
        return self.rounds or usual


WHOLE = Effort()
SHORT = Effort(
    rounds=1,
    ticks=300,
    steps=2000,
    demos=2,
    cold_rounds=0,
    table_seconds=1.0,
    identify_rows=((1000, 1),),
    replay_seconds=0.3,
    lateness_seconds=0.2,
    conditions=2,
    builds=1,
)
