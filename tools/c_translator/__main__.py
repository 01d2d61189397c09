"""The C translation of the plant's compiled step, printed: python -m tools.c_translator.

How fast it is beside ours is a section of the benchmark.
"""

from __future__ import annotations

from tools.c_translator.build import source

if __name__ == "__main__":
    print(source(), end="")
