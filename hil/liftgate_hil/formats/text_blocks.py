"""Text files by whole lines: some MB at a time, or line by line with numbers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.errors import ConfigError

_FIRST, _BLOCK = 1 << 16, 1 << 22  # bytes; the first block is small, as often only the first frame is wanted
_LONGEST = 1 << 20  # bytes of a line


class TextBlock(NamedTuple):
    """Some lines of a text."""

    line: int  # number of the first one, from 1
    text: bytes
    is_whole: bool = True  # false: the last line of a file, without a newline at its end


def text_blocks(path: Path) -> Iterator[TextBlock]:
    """Yield the whole lines of a text, block by block, then a last line without a newline. Raises ConfigError."""
    line, rest, size = 1, b"", _FIRST
    with path.open("rb") as stream:
        while text := stream.read(size):
            lines, newline, rest = (rest + text).rpartition(b"\n")
            if newline:
                yield TextBlock(line, lines + newline)
                line += lines.count(b"\n") + 1
            if len(rest) > _LONGEST:
                raise ConfigError(
                    f"{path}: cannot be read: line {line} is longer than {_LONGEST} bytes; allowed: text"
                )
            size = _BLOCK
    if rest:
        yield TextBlock(line, rest, is_whole=False)


def lines_in(path: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield the lines of a text with their numbers, and whether each ends with a newline. Raises ConfigError."""
    for block in text_blocks(path):
        for number, line in enumerate(block.text.removesuffix(b"\n").split(b"\n"), block.line):
            yield number, line.decode("utf-8", "replace"), block.is_whole
