"""Where each equation of the thesis lives: `python -m tools.equations`.

A function or a module implements an equation by naming its number in its docstring. The list is that of the
model: every equation of Boberg's chapters 2 to 4 that the plant is built from.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Number: what it says. Ranges of the model's page are written out.
EQUATIONS = {
    "3.1": "L di/dt + R i + c2Φ n = u",
    "3.2": "2πJ dn/dt = c1Φ i − M_L − M_L0",
    "3.3": "M_L0 = (1 − η_M) M_0 sgn(n)",
    "3.4": "sgn, set-valued at 0",
    "3.5": "backlash b",
    "3.6": "n_G = n/r",
    "3.7": "J_G dω_G/dt + M_SL + M_GL0 = r M_L",
    "3.8": "M_GL0 = (1 − η_G) M_G0 sgn(n_G)",
    "3.9": "v_S = n_G s_rev",
    "3.10": "M_SL from the spindle's force",
    "3.11": "M_S0 from F_S0",
    "3.12": "F_F = F_F0 + k (l_max − l_S) − F",
    "3.13": "l_S from the spindle's way",
    "3.14": "end stop F",
    "3.15": "J_L φ̈ = sum of torques",
    "3.16": "F_S = M_S/r_AP",
    "3.17": "seal M_2",
    "3.18": "J_L of the plate",
    "3.19": "law of cosines",
    "3.20": "φ of l_S",
    "3.21": "α = α_0 − γ",
    "3.23": "r_GP0",
    "3.26": "M_W",
    "3.29": "r_AP0",
    "3.35": "r_AP(φ)",
    "3.39": "l(φ)",
    "3.40": "l and r_AP",
    "4.12": "all constant losses in one",
    "4.13": "total inertia",
}

_NUMBER = re.compile(r"\(?(\d)\.(\d+)\)?(?:\s*(?:–|to)\s*\(?\1\.(\d+)\)?)?")


def numbers(text: str) -> set[str]:
    """The equation numbers in a text; (3.1–3.4) stands for all four."""
    found = set()
    for match in _NUMBER.finditer(text):
        chapter, first, last = match[1], int(match[2]), int(match[3] or match[2])
        found |= {f"{chapter}.{number}" for number in range(first, last + 1)}
    return found & EQUATIONS.keys()


def docstrings(path: Path) -> Iterator[tuple[str, str]]:
    """(name, docstring) of a module and of what it defines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    module = ".".join(path.relative_to(ROOT / "plant").with_suffix("").parts)
    yield module, ast.get_docstring(tree) or ""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield f"{module}.{node.name}", ast.get_docstring(node) or ""


def implementations() -> dict[str, list[str]]:
    """Equation: the functions, classes and modules of the plant that name it."""
    index: dict[str, list[str]] = {number: [] for number in EQUATIONS}
    for path in sorted((ROOT / "plant/liftgate_plant").glob("*.py")):
        for name, text in docstrings(path):
            for number in numbers(text):
                index[number].append(name)
    return index


def imported(path: Path) -> set[str]:
    """The modules that a file imports, by either form of import."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def tests() -> dict[str, list[str]]:
    """Module: the test files that import it."""
    index: dict[str, list[str]] = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for module in imported(path):
            index.setdefault(module, []).append(str(path.relative_to(ROOT / "tests")))
    return index


def main() -> int:
    """Print the index; exit code 1 where an equation is missing."""
    used_by = tests()
    missing = 0
    for number, names in implementations().items():
        missing += not names
        modules = {".".join(name.split(".")[:2]) for name in names}
        files = sorted({file for module in modules for file in used_by.get(module, [])})
        print(f"({number})  {EQUATIONS[number]}")
        print(f"    {', '.join(names) or 'MISSING'}")
        print(f"    tested in {', '.join(files) or 'nothing'}")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
