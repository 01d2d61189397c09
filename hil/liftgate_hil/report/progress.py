"""Progress line of a long computation."""

from __future__ import annotations

from typing import TextIO

from liftgate_hil.report.numbers import significant


class Progress:
    """A progress line, rewritten in place; nothing where the stream is no terminal or with `quiet`."""

    def __init__(self, stream: TextIO | None, quiet: bool = False) -> None:
        self._stream = None if quiet or stream is None or not stream.isatty() else stream
        self._shown = 0

    def update(self, iteration: int, loss: float, step: float) -> None:
        """Show an iteration: its loss and the size of the step that led there."""
        self._show(f"iteration {iteration}  loss {significant(loss, 6)}  step {significant(step, 3)}")

    def close(self) -> None:
        """Clear the line for what is printed next."""
        if self._shown:
            self._show("")
            self._show("")

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _show(self, line: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write("\r" + line.ljust(self._shown))
            self._stream.flush()
        except OSError:  # the terminal is gone, but the computation goes on
            self._stream = None
        self._shown = len(line)
