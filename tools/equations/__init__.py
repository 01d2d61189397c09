"""Index of the thesis's equations: the place of each in the code, and its test: `python -m tools.equations`.

`table` lists every equation of the thesis's model, (3.1) to (3.44) and (4.1) to (4.13). `problems` returns the
entries of the table that are not true of the sources. `mutants` changes each equation once, in a copy, and runs
its test, which must fail.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tools.equations.table import Row

ROOT = Path(__file__).resolve().parents[2]
PLANT = Path("plant", "liftgate_plant")
NUMBERS = (*(f"3.{k}" for k in range(1, 45)), *(f"4.{k}" for k in range(1, 14)))

_NUMBER = re.compile(r"(?<![\d.])(\d)\.(\d+)(?:\)?\s*(?:–|to)\s*\(?\1\.(\d+))?")


def numbers(text: str) -> set[str]:
    """Return the equation numbers in a text; (3.1–3.4) stands for all four."""
    found = set()
    for match in _NUMBER.finditer(text):
        chapter, first, last = match[1], int(match[2]), int(match[3] or match[2])
        found |= {f"{chapter}.{number}" for number in range(first, last + 1)}
    return found & set(NUMBERS)


def source_of(row: Row) -> Path:
    """Return the file that contains the equation, relative to the checkout's root."""
    return PLANT / f"{row.where.split('.')[0]}.py"


def definition(text: str, name: str) -> ast.FunctionDef | ast.ClassDef | None:
    """Return the node of a top-level function or class in a module's text, None if there is none."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return node
    return None


def problems(row: Row, root: Path = ROOT) -> list[str]:
    """Return the entries of the row that are not true of the sources, as texts."""
    source = source_of(row)
    if not (root / source).is_file():
        return [f"no file {source}"]
    text = (root / source).read_text(encoding="utf-8")
    node = definition(text, row.where.split(".")[-1])
    if node is None:
        return [f"no {row.where}"]
    found = []
    if row.number not in numbers(ast.get_docstring(node) or ""):
        found.append(f"the docstring of {row.where} does not name it")
    if text.count(row.text) != 1:
        found.append(f"{text.count(row.text)} times in {source}: {row.text}")
    elif row.text not in (ast.get_source_segment(text, node) or ""):
        found.append(f"not in {row.where}: {row.text}")
    file, _, name = row.test.partition("::")
    path = root / "tests" / file
    if not path.is_file() or definition(path.read_text(encoding="utf-8"), name) is None:
        found.append(f"no test {row.test}")
    return found
