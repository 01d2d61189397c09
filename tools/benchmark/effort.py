"""Effort of the benchmarks: full, as their page needs it, or shortened so that each of their lines still runs."""

from __future__ import annotations

from typing import NamedTuple


class Effort(NamedTuple):
    """Rounds, lengths and counts of all sections; the defaults are those of the page."""

    rounds: int = 0  # rounds of a figure; 0: each section's own number
    is_warmed: bool = True  # whether commands run once before they are measured, which fills caches
    ticks: int | None = None  # ticks of an episode; None: the demo's whole length
    steps: int = 200_000  # plant steps between two readings of the clock; ticks are fewer in proportion
    demos: int = 11  # demos in a row, compared with one, for the marginal pace
    paces: int | None = None  # number of demos whose pace is measured; None: all
    cold_rounds: int = 3  # starts with an empty cache of machine code; 0: none, which costs nothing
    table_seconds: float = 3600.0  # s, model time of `simulate`
    motions: int | None = None  # number of its motions; None: all
    identify_rows: tuple[tuple[int, int], ...] = ((10_000, 3), (100_000, 1), (1_000_000, 1))
    variants: int = 10_000  # of a campaign
    many_variants: int = 100_000  # of the one whose memory is watched
    replay_seconds: float = 10.0  # s, length of the log
    is_on_vcan: bool = True  # whether the log is played on a vcan0 too, if there is one
    lateness_seconds: float = 0.0  # s, length of each run; 0: that of the flag --seconds
    page_seconds: float = 5.0  # s, length of each run with a page
    policies: int | None = None  # number of kinds of scheduling of these runs; None: all
    conditions: int | None = None  # number of conditions of the lateness; None: all
    builds: int | None = None  # number of builds of the C translation; None: all

    def of(self, usual: int) -> int:
        """Return the rounds of a section whose own number is `usual`."""
        return self.rounds or usual


WHOLE = Effort()
SHORT = Effort(
    rounds=1,
    is_warmed=False,
    ticks=300,
    steps=2000,
    demos=2,
    paces=2,
    cold_rounds=0,
    table_seconds=1.0,
    motions=1,
    identify_rows=((1000, 1),),
    variants=40,
    many_variants=40,
    replay_seconds=0.3,
    is_on_vcan=False,
    lateness_seconds=0.2,
    page_seconds=0.5,
    policies=1,
    conditions=2,
    builds=1,
)
