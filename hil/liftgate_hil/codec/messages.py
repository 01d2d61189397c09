"""Messages of a database by name, with reasons for those left out because of errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cantools.database.can import Message


class Messages(dict[str, "Message"]):
    """Messages of a database by name, with notes on those left out.

    `left_out` says by name why others cannot be used; `notes` has a line for all that was left out of the file.
    """

    def __init__(
        self,
        messages: Iterable[Message] = (),
        left_out: Mapping[str, str] | None = None,
        notes: Iterable[str] = (),
    ) -> None:
        super().__init__((each.name, each) for each in messages)
        self.left_out = dict(left_out or {})
        self.notes = tuple(notes)

    def why_not(self, name: str) -> str:
        """Return as an issue's text why a message cannot be used; "": it can, or the database has none."""
        if name not in self.left_out:
            return ""
        return f"{name} cannot be used: {self.left_out[name]}; allowed: a message without a fault"

    def __reduce__(self) -> tuple[type[Messages], tuple[list[Message], dict[str, str], tuple[str, ...]]]:
        return Messages, (list(self.values()), self.left_out, self.notes)
