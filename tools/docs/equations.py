"""Page docs/equations.md: every equation of the plant, from the index of equations, docstrings and tests."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tools.docs.markdown import code, page, table
from tools.equations import PLANT, ROOT, definition, numbers, source_of
from tools.equations.table import TABLE, Row

_INTRO = """\
The plant implements the model of F. Boberg, *Simulation of dynamic and static behavior of an electrically powered
lift gate*, Linköping 2008, and adds to it. Numbers in parentheses are those of the thesis.

- The functions are those of [`plant/liftgate_plant`](../plant/liftgate_plant/dynamics.py): `gate.lever` is the
  function `lever` in `gate.py`. Its docstring names the equation.
- The tests are those in `tests/`. Each one fails if its equation is changed: `python -m tools.equations --mutate`
  changes every equation once, in a copy, and runs its test.
- [The plant](plant.md) is the overview, [the solver](solver.md) explains the step, and
  [vehicle files](vehicle.md) list the parameters with their symbols."""

_THESIS = """\
`n` is in rev/s, `i` and `r` are the gear ratio, angles are in radians. A note states where the plant departs from
the printed equation."""

_OTHER = """\
Docstrings of further functions and classes name these equations too, because they use or explain them."""

_BEYOND = """\
Modules of the plant that hold no row of the first table. Each module's docstring states its equations and their
source. The tests are those that import the module; the two modules of switching bridges are tested through the
whole plant."""

# Data, catalogues and glue: what they hold is described on other pages.
_WITHOUT_EQUATIONS = {"__init__", "coding", "constants", "quantity", "rows", "signals", "initial", "faults"}
# Modules that no test imports: the tests that reach them through the whole plant.
_BRIDGES = ["tests/plant/test_pwm.py", "tests/tools/test_accuracy_study.py"]
_THROUGH_OTHERS = {"switching": _BRIDGES, "shared_source": _BRIDGES}
_IN_PARENTHESES = re.compile(r"\([\d., –]+\)")

_HEADS = ("number", "equation", "function", "what it does", "note", "test")


def equations_page() -> str:
    """Return the text of the page."""
    return page(
        "Equations",
        _INTRO,
        "## Of the thesis",
        _THESIS,
        table(_HEADS, map(_row, TABLE)),
        "## Named elsewhere",
        _OTHER,
        table(("place", "names", "what it is"), _elsewhere()),
        "## Beyond the thesis",
        _BEYOND,
        table(("module", "what it describes", "tests"), _beyond()),
    )


def _row(row: Row) -> tuple[str, ...]:
    """Return the table row of an equation."""
    file, _, test = row.test.partition("::")
    says = f"`tests/{file}` `{test}`"
    node = definition((ROOT / source_of(row)).read_text(encoding="utf-8"), row.where.split(".")[-1])
    assert node is not None, row.where
    return f"({row.number})", row.says, _linked(row.where), _first_line(node), row.note, says


def _linked(where: str) -> str:
    """Return a function's or a module's name as code, with a link to its file."""
    return f"[`{where}`](../plant/liftgate_plant/{where.split('.', maxsplit=1)[0]}.py)"


def _first_line(node: ast.AST) -> str:
    """Return the first paragraph of a docstring, in one line."""
    assert isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
    return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())


def _elsewhere() -> Iterator[tuple[str, ...]]:
    """Yield the functions and classes whose docstrings name an equation that the table has at another place."""
    known = {(row.where, row.number) for row in TABLE}
    for path in _modules():
        for node in _tree(path).body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            name = f"{path.stem}.{node.name}"
            found = numbers(" ".join(_IN_PARENTHESES.findall(ast.get_docstring(node) or "")))
            new = [row.number for row in TABLE if row.number in found and (name, row.number) not in known]
            if new:
                yield _linked(name), ", ".join(f"({each})" for each in new), _first_line(node)


def _beyond() -> Iterator[tuple[str, ...]]:
    """Yield the modules without an equation of the thesis, with the tests that import them."""
    with_a_row = {row.where.split(".")[0] for row in TABLE}
    for path in _modules():
        if path.stem in with_a_row or path.stem in _WITHOUT_EQUATIONS:
            continue
        yield _linked(path.stem), _first_line(_tree(path)), ", ".join(map(code, _tests_of(path.stem)))


def _tests_of(module: str) -> list[str]:
    """Return the test files of a module: those of the plant, or else any other."""
    names = [_name(each) for each in _importers(module, ROOT / "tests") if each.name.startswith("test_")]
    of_the_plant = [each for each in names if each.startswith(("tests/plant/", "tests/reference/"))]
    return of_the_plant or names or _THROUGH_OTHERS[module]


def _modules() -> list[Path]:
    return sorted((ROOT / PLANT).glob("*.py"))


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _importers(module: str, folder: Path) -> list[Path]:
    """Return the files of a folder that import a module of the plant."""
    return [path for path in sorted(folder.rglob("*.py")) if f"liftgate_plant.{module}" in _imports(path)]


@cache
def _imports(path: Path) -> frozenset[str]:
    """Return what a file imports from packages, as dotted names."""
    found = set()
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return frozenset(found)
