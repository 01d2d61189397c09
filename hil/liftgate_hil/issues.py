"""What is wrong with a file, collected so that all of it comes out at once."""

from __future__ import annotations

from liftgate_hil.errors import ConfigError


class ConfigIssues:
    """The faults of one source, collected."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.lines: list[str] = []

    def add(self, key: str, message: str) -> None:
        """Note a fault of a key."""
        line = f"{self.source}: {key}: {message}"
        if line not in self.lines:
            self.lines.append(line)

    def raise_if_any(self) -> None:
        """Raise ConfigError with all that was noted."""
        if self.lines:
            raise ConfigError(self.lines)
