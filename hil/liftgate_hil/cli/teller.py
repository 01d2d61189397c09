"""Where progress, and what happens to the link, is told: stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from liftgate_hil.cli.options import as_flags
from liftgate_hil.listener import Listener


@dataclass(frozen=True)
class Teller(Listener):
    """Unless it is to be quiet. With the summary as JSON only what goes wrong is told beside it."""

    is_quiet: bool
    is_json: bool
    how: str  # rate and clock

    def say(self, text: str) -> None:
        """See Listener."""
        if not self.is_quiet:
            print(as_flags(text), file=sys.stderr, flush=True)

    def starts(self, entry: Callable[..., Any], what: str) -> None:
        """See Listener."""
        from liftgate_plant import compiler

        if self.is_json:
            return
        if not compiler.is_cached(entry):
            self.say("compiling the model (once for this version and machine) …")
        self.say(f"{what}, {self.how}")
