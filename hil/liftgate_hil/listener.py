"""Who is told how a run goes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Listener:
    """Is told how a run goes; this one keeps it to itself. It is pickled where a worker process runs."""

    def say(self, text: str) -> None:
        """What happens to the link, and what the machine does not give."""

    def starts(self, entry: Callable[..., Any], what: str) -> None:
        """What is about to run, and its entry point, which may have to be compiled first."""
