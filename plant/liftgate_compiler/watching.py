"""Watchers that are informed while something is being compiled, which takes seconds."""

from __future__ import annotations


class GivenUpError(Exception):
    """Raised when nobody waits for the machine code any more."""


class Watcher:
    """Watcher of compilations; this one does nothing.

    An exception of its methods (GivenUpError) ends the waiting and the compilation.
    """

    def compiles(self, name: str, seconds: float) -> None:
        """Called every tenth of a second, from 0 on: `name` has been compiling for `seconds`."""

    def waits(self, name: str, seconds: float) -> None:
        """Called likewise while `name` has waited `seconds` for another process or thread to compile."""

    def ready(self, name: str, seconds: float) -> None:
        """Called when compilation, or the wait for another process's, has ended after `seconds`."""

    def not_kept(self, why: str) -> None:
        """Called with the reason why machine code is neither read from the disk nor stored there."""


_watchers = [Watcher()]


def watch(watcher: Watcher) -> None:
    """Inform this watcher of compilations from now on, instead of the one before.

    Only the watcher added last is informed; `unwatch` removes it.
    """
    _watchers.append(watcher)


def unwatch(watcher: Watcher) -> None:
    """Remove a watcher; threads that watch need not end in the order in which they began."""
    _watchers.remove(watcher)


def watcher() -> Watcher:
    """Return the watcher that is informed: the last one added."""
    return _watchers[-1]
