"""What is wrong with a file, collected so that all of it comes out at once."""

from __future__ import annotations

from collections.abc import Iterable

from liftgate_hil.errors import ConfigError

MOST = 100  # lines that are told; the others are counted


class ConfigIssues:
    """The faults of one source, collected."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[str] = []
        self.untold = 0  # faults beyond MOST

    def add(self, key: str, message: str) -> None:
        """Note a fault of a key."""
        self.take([f"{self.source}: {key}: {message}"])

    def take(self, lines: Iterable[str]) -> None:
        """Note faults that are whole lines already."""
        for line in lines:
            if len(self.lines) >= MOST:
                self.untold += 1
            elif line not in self.lines:
                self.lines.append(line)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.lines) + self.untold

    def raise_if_any(self) -> None:
        """Raise ConfigError with all that was noted."""
        if self.untold:
            raise ConfigError([*self.lines, f"{self.source}: and {self.untold} faults more"])
        if self.lines:
            raise ConfigError(self.lines)
