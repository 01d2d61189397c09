"""Printing of the C translation of the plant's step: python -m tools.c_translator.

A section of the benchmark compares its speed with that of the compiled step.
"""

from __future__ import annotations

from tools.c_translator.build import source

if __name__ == "__main__":
    print(source(), end="")
