"""Random damage to the lines of a text."""

from __future__ import annotations

import random
import re

NUMBERS = ("0", "1", "7", "8", "64", "65", "-1", "1e9", "1e400", "nan")
SIGNS = '0123456789-+|@()[]",. MmZ:;xé%°_'


def mangled(chance: random.Random, lines: list[str], words: list[str]) -> list[str]:
    """Return the lines with up to three random mistakes: lost or doubled lines, changed characters or words."""
    lines = list(lines)
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(lines))
        line = lines[at]
        kind = chance.randrange(5)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, chance.choice(lines))
        elif kind == 2 and line:
            place = chance.randrange(len(line))
            lines[at] = line[:place] + chance.choice(SIGNS) + line[place + 1 :]
        elif kind == 3 and (digits := re.findall(r"\d+", line)):
            lines[at] = line.replace(chance.choice(digits), chance.choice(NUMBERS), 1)
        elif kind == 4 and (names := re.findall(r"\w+", line)):
            lines[at] = line.replace(chance.choice(names), chance.choice(words), 1)
    return lines
