"""What is wrong with a file, collected so that all of it comes out at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from liftgate_hil.errors import ConfigError

MOST = 100  # lines that are told; the others are counted


class ConfigIssues:
    """The faults of one source, collected. `origins`: keys that are not from that source, and what messages call
    each of them.
    """

    def __init__(self, source: str, origins: Mapping[str, str] | None = None) -> None:
        self.source = source
        self.lines: list[str] = []
        self.untold = 0  # faults beyond MOST
        self._origins = dict(origins or {})
        self._settled: set[str] = set()

    def add(self, key: str, message: str) -> None:
        """Note a fault of a key."""
        if key not in self._settled:
            self.take([f"{self.called(key)}: {message}"])

    def add_of(self, source: str, key: str, message: str) -> None:
        """Note a fault of a key of another source; "": of this one."""
        if source in ("", self.source):
            self.add(key, message)
        else:
            self.take([f"{source}: {key}: {message}"])

    def take(self, lines: Iterable[str]) -> None:
        """Note faults that are whole lines already."""
        for line in lines:
            if line in self.lines:
                continue
            if len(self.lines) >= MOST:
                self.untold += 1
            else:
                self.lines.append(line)

    def settle(self, key: str) -> None:
        """Nothing more is told of a key: what is wrong with its value is told elsewhere."""
        self._settled.add(key)

    def originate(self, key: str, called: str) -> None:
        """Have messages call a key so from now on: its value is not from this source."""
        self._origins[key] = called

    def unsettled(self, lines: Iterable[str]) -> list[str]:
        """Those of whole lines of the same source that are not about a key that is settled."""
        settled = tuple(f"{self.called(key)}: " for key in self._settled)
        return [line for line in lines if not line.startswith(settled)]

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

    def called(self, key: str) -> str:
        """What messages call a key: with its source, or where its value is from."""
        for place, called in self._origins.items():
            if key == place or key.startswith((f"{place}.", f"{place}[")):
                return called + key[len(place) :]
        within = [called for place, called in self._origins.items() if place.startswith(f"{key}.")]
        also = f" (with {', '.join(within)})" if within else ""
        return f"{self.source}: {key}{also}"
