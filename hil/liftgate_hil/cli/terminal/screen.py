"""Live display at the bottom of the terminal, with messages that scroll above it."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from liftgate_hil.cli.terminal.streams import put_line

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    # Returns what is to be seen in so many columns; called at each drawing.
    Picture = Callable[[int], RenderableType]

_USUAL = os.terminal_size((80, 24))  # size of a terminal that does not know its own
_WIDEST = 110  # columns of a picture
_ERASE = "\r\x1b[J"  # from the cursor's line to the bottom
_DUMB = ("", "dumb", "unknown")  # terminals on which the cursor cannot be moved


class Screen:
    """Live pictures at the bottom of the terminal on stderr, and messages above; only the latest picture is seen.

    The cursor rests on an empty line above the picture. What others write there, such as an echoed Ctrl-C or a
    line of another process, does not mix with the picture, and the next drawing begins below it. A terminal that
    wraps its lines anew when it is resized takes the cursor along. Without a terminal, with one whose cursor
    cannot be moved, and where it `is_off`, there is no picture, and messages are plain lines.
    """

    def __init__(self, is_off: bool = False) -> None:
        self._is_off = is_off
        self._is_gone = False  # the terminal
        self._is_dirty = False  # a picture may be on the terminal
        self._pictures: dict[object, Picture] = {}  # by who shows them
        self._console: Console | None = None
        self.lock = threading.RLock()  # reports of other processes arrive in threads

    @property
    def is_there(self) -> bool:
        """Whether a picture can be drawn."""
        stream: Any = sys.stderr  # None where it is closed
        is_able = not self._is_off and not self._is_gone and os.environ.get("TERM", "") not in _DUMB
        return bool(is_able and stream is not None and stream.isatty())

    def prepare(self) -> None:
        """Import the modules needed for drawing, which takes a while, if a picture can be drawn."""
        if self._console is None and self.is_there:
            from rich.console import Console

            # Not stderr itself: rich ends the program where that is gone. Its encoding says which bars there are.
            file = io.TextIOWrapper(io.BytesIO(), encoding=getattr(sys.stderr, "encoding", None) or "utf-8")
            self._console = Console(file=file, force_terminal=True, markup=False, highlight=False)

    def show(self, owner: object, picture: Picture) -> None:
        """Add or replace `owner`'s picture, a function of the width, and draw the picture that was added last."""
        if not self.is_there:
            return
        self.prepare()
        with self.lock:
            self._pictures[owner] = picture
            self._write(self._drawn())

    def take(self, owner: object) -> None:
        """Remove the picture of `owner`, and draw the picture that was added before it, if any."""
        with self.lock:
            if self._pictures.pop(owner, None) is not None or self._is_dirty:
                self._write(self._drawn())

    def say(self, text: str) -> None:
        """Print a message above the picture, as one write, so that no other process can write into it."""
        with self.lock:
            if self._is_dirty and self.is_there:
                self._write(f"{_ERASE}{text}\n{self._drawn(is_erased=True)}")
                return
            with contextlib.suppress(OSError, AttributeError):  # stderr is closed, or None
                put_line(text, sys.stderr)

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Context for printing by other means: the picture is removed, and no other thread draws meanwhile."""
        with self.lock:
            if self._is_dirty:
                self._write(_ERASE)
            yield
            if self._pictures and self.is_there:
                with contextlib.suppress(OSError, ValueError, AttributeError):
                    sys.stdout.flush()  # else it would come into the picture
                self._write(self._drawn())

    def lend(self) -> None:
        """Have the next output erase what is below it, as a child process may have left its own picture here."""
        self._is_dirty = True

    def _drawn(self, is_erased: bool = False) -> str:
        """Return the text that erases the last picture and draws the present one; the cursor ends above it."""
        erasing = "" if is_erased or not self._is_dirty else _ERASE
        columns, rows = _size()
        lines = self._lines(min(columns - 1, _WIDEST))[: max(rows - 2, 0)]  # a wrapped line cannot be counted
        self._is_dirty = bool(lines)
        if not lines:
            return erasing
        return "".join([erasing or "\r", *(f"\n{line}" for line in lines), f"\x1b[{len(lines)}A\r"])

    def _lines(self, width: int) -> list[str]:
        """Return the lines of the picture that was added last, with escape sequences for their styles."""
        if not self._pictures or self._console is None or width < 1:
            return []
        picture = next(reversed(self._pictures.values()))
        with self._console.capture() as capture:
            self._console.print(picture(width), width=width, no_wrap=True, overflow="ellipsis", crop=True)
        return capture.get().splitlines()

    def _write(self, text: str) -> None:
        """Write to the terminal; if it no longer exists, the program continues without it."""
        if not text or not self.is_there:
            return
        try:
            sys.stderr.write(text)
            sys.stderr.flush()
        except OSError:
            self._is_gone = True


def _size() -> os.terminal_size:
    """Return the number of columns and rows of the terminal."""
    with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or None
        size = os.get_terminal_size(sys.stderr.fileno())
        return os.terminal_size(each or usual for each, usual in zip(size, _USUAL, strict=True))
    return _USUAL
