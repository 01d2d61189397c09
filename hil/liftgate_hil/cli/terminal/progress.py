"""Display of a task's progress on the terminal: its name, how much is done, and the remaining time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import RenderableType

    from liftgate_hil.cli.terminal.screen import Screen

AFTER_S = 2.0  # what ends earlier is not shown
EVERY_S = 0.25  # between two drawings
PLAIN_S = 30.0  # between two lines where there is no terminal
_TURN_S = 0.25  # of the thread that draws while nothing is reported
_ROOMY = 50  # columns from which there is room for a bar beside everything else


class ProgressDisplay:
    """Progress of one task: a live display on a terminal, else a line to `plain`, if given, every PLAIN_S.

    As a context the picture is drawn a few times a second, also while nothing is reported; else only with its
    updates, as the lines are. A picture leaves nothing behind.
    """

    def __init__(
        self,
        screen: Screen,
        what: str,
        total: float = 0.0,
        after_s: float | None = None,
        every_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        plain: Callable[[str], None] | None = None,
    ) -> None:
        self._screen = screen
        self._plain = plain
        self._what = what
        self._done, self._before, self._total = 0.0, 0.0, total  # total 0: nobody knows
        self._text = ""
        self._known: tuple[float, float] | None = None  # of what takes a known time: its beginning and length [s]
        self._clock = clock
        self._every_s = EVERY_S if every_s is None else every_s
        self._began = clock()
        self._next = self._began + (AFTER_S if after_s is None else after_s)
        self._next_plain = self._began + PLAIN_S
        self._has_ended = threading.Event()
        self._thread: threading.Thread | None = None

    def update(
        self, done: float = 0.0, total: float | None = None, text: str = "", what: str = "", before: float = 0.0
    ) -> None:
        """Set the progress: `done` of `total`, `text` on a line of its own, and `what` as the task's new name.

        `before` is what of `done` had been done when it began.
        """
        self._done, self._before, self._text = done, before, text
        self._known = None
        self._total = self._total if total is None else total
        self._what = what or self._what
        self.draw()

    def lasts(self, seconds: float, what: str) -> None:
        """Begin a task named `what` with an expected duration of `seconds`."""
        self._what, self._text, self._known = what, "", (self._clock(), seconds)
        self.draw()

    def draw(self) -> None:
        """Draw the display, if the time for the next update has come."""
        now = self._clock()
        if not self._screen.is_there:
            self._say_plainly(now)
            return
        if now < self._next:
            return
        self._next = now + self._every_s
        with self._screen.lock:  # it is not drawn again once it has ended
            if not self._has_ended.is_set():
                self._screen.show(self, self._picture)

    def _say_plainly(self, now: float) -> None:
        """Print the progress as a line, if PLAIN_S have passed since the last one, unless the task is complete."""
        if self._plain is None or now < self._next_plain or self._has_ended.is_set():
            return
        self._next_plain = now + PLAIN_S
        taken, done, total, _ = self._extent()
        if done >= total > 0.0:  # its result comes next
            return
        parts = [duration_of(taken), f"{done / total:.0%}" if total > 0.0 else "", self._text]
        self._plain(f"{self._what}: {', '.join(filter(None, parts))}")

    def close(self) -> None:
        """Remove the display."""
        with self._screen.lock:
            self._has_ended.set()
            self._screen.take(self)
        if self._thread is not None:
            self._thread.join(_TURN_S)  # a process that is started next is forked without it

    def __enter__(self) -> ProgressDisplay:
        if self._screen.is_there:
            self._thread = threading.Thread(target=self._draw_now_and_then, name="progress", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _draw_now_and_then(self) -> None:
        while not self._has_ended.wait(_TURN_S):
            self.draw()

    def _picture(self, width: int) -> RenderableType:
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        taken, done, total, before = self._extent()
        has_bar = total > 0.0 and width >= _ROOMY
        line = Table.grid(padding=(0, 2, 0, 0), expand=has_bar)
        line.add_column()
        cells: list[RenderableType] = [Text(self._what, no_wrap=True, overflow="ellipsis")]
        if has_bar:
            line.add_column(ratio=1, min_width=8)
            cells.append(ProgressBar(total, min(done, total), complete_style="cyan", finished_style="cyan"))
        times = duration_of(taken)
        if before < done < total:
            times += f", {duration_of(taken * (total - done) / (done - before))} left"
        line.add_column(no_wrap=True, style="dim", min_width=len(times))
        line.add_row(*cells, times)
        return Group(line, Text(self._text, no_wrap=True, overflow="ellipsis")) if self._text else line

    def _extent(self) -> tuple[float, float, float, float]:
        """Return the elapsed time [s], the work done, the total work, and the work done before the start."""
        now = self._clock()
        if self._known is not None:
            began, length = self._known
            return now - began, now - began, length, 0.0
        return now - self._began, self._done, self._total, self._before


def duration_of(seconds: float) -> str:
    """Return a duration [s] as text."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
