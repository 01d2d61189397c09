"""Who is told that something is being compiled, which takes seconds."""

from __future__ import annotations


class GivenUpError(Exception):
    """Nobody waits for the machine code any more."""


class Watcher:
    """Is told; this one keeps it to itself. What its methods raise (GivenUpError) ends the waiting, and the
    compilation.
    """

    def compiles(self, name: str, seconds: float) -> None:
        """Every tenth of a second, from 0 on: `name` is being compiled, for so long already."""

    def waits(self, name: str, seconds: float) -> None:
        """The same: another process is compiling it, and this one waits for that."""

    def ready(self, name: str, seconds: float) -> None:
        """That is over."""

    def not_kept(self, why: str) -> None:
        """Machine code is neither read from the disk nor kept there, for this reason."""


_told = [Watcher()]


def watch(watcher: Watcher) -> None:
    """Have it told from now on."""
    _told.append(watcher)


def unwatch(watcher: Watcher) -> None:
    """Have it told no more; threads that watch need not end in the order in which they began."""
    _told.remove(watcher)


def watcher() -> Watcher:
    """Who is told: the last one that watches."""
    return _told[-1]
