"""Functions that the compiler package adds to numba: tuples and texts in arrays, caches of machine code."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import liftgate_compiler
import liftgate_hil
import liftgate_plant
from liftgate_compiler import all_finite, compilable, compiled, enabled, fill, overlay, picked, put_text, with_item


class Numbers(NamedTuple):
    a: float
    b: float
    c: float


@compilable
def filled(target: NDArray[np.float64], numbers: Numbers) -> bool:
    fill(target, 1, numbers)
    return all_finite(numbers)


@pytest.mark.parametrize(
    ("numbers", "finite"),
    [
        (Numbers(1.0, -2.0, 3.0), True),
        (Numbers(np.nan, 0.0, 0.0), False),
        (Numbers(0.0, 0.0, np.nan), False),
        (Numbers(0.0, np.inf, 0.0), False),
        (Numbers(-np.inf, np.inf, 0.0), False),
        (Numbers(1e308, 1e308, 0.0), True),
    ],
)
def test_a_tuple_is_written_to_a_row_and_a_number_that_is_not_finite_is_reported(numbers, finite):
    for run in (filled, compiled(filled)):
        rows = np.zeros((5, 2))
        assert run(rows[:, 1], numbers) == finite
        np.testing.assert_array_equal(rows, [[0.0, each] for each in (0.0, *numbers, 0.0)])


PLACES = Numbers(a=4, b=0, c=2)


@compilable
def read(source: NDArray[np.float64]) -> Numbers:
    return picked(source, PLACES)


@pytest.mark.parametrize("step", [1, 2, -1])
def test_picked_reads_each_field_from_its_given_index(step: int):
    source = np.arange(10.0, 20.0)[::step][:5]
    expected = Numbers(source[4], source[0], source[2])
    for run in (read, compiled(read)):
        found = run(source)
        assert isinstance(found, Numbers)
        assert found == expected


@compilable
def replaced(numbers: Numbers, places: NDArray[np.int64]) -> Numbers:
    for place in places:
        numbers = with_item(numbers, place, 10.0 * place)
    return numbers


@compilable
def laid_over(upper: Numbers, lower: Numbers) -> Numbers:
    return overlay(upper, lower)


def test_the_fields_of_a_tuple_at_given_indices_are_replaced():
    numbers = Numbers(1.0, 2.0, 3.0)
    for run in (replaced, compiled(replaced)):
        assert run(numbers, np.array([1])) == Numbers(1.0, 10.0, 3.0)
        assert run(numbers, np.array([2, 0])) == Numbers(0.0, 2.0, 20.0)
        assert run(numbers, np.zeros(0, dtype=np.int64)) == numbers


def test_an_overlay_takes_nan_fields_from_the_tuple_below():
    nan = np.nan
    for run in (laid_over, compiled(laid_over)):
        assert run(Numbers(nan, 2.0, nan), Numbers(4.0, 5.0, 6.0)) == Numbers(4.0, 2.0, 6.0)
        assert run(Numbers(-np.inf, nan, 0.0), Numbers(1.0, np.inf, 1.0)) == (-np.inf, np.inf, 0.0)
        assert np.isnan(run(Numbers(nan, nan, nan), Numbers(nan, 1.0, 2.0)).a)


@compilable
def copied(target: NDArray[np.uint8], at: int, source: NDArray[np.uint8], start: int, length: int) -> None:
    put_text(target, at, source, start, length)


@pytest.mark.parametrize("length", [0, 1, 31, 32, 33, 40])
@pytest.mark.parametrize(("at", "start"), [(0, 0), (3, 60), (60, 3), (59, 59)])
def test_a_copied_text_changes_only_its_own_place_or_the_32_bytes_from_its_start(length: int, at: int, start: int):
    """Up to 32 bytes after the text may hold anything, as the next text is written there."""
    source = np.arange(1, 101, dtype=np.uint8)
    for run in (copied, compiled(copied)):
        memory = np.zeros(140, dtype=np.uint8)
        target = memory[20:120]  # what is around it is another's
        run(target, at, source, start, length)
        assert not target[:at].any()
        np.testing.assert_array_equal(target[at : at + length], source[start : start + length])
        assert not target[at + max(length, 32) :].any()
        assert not memory[:20].any()
        assert not memory[120:].any()


@pytest.mark.parametrize("gap", [0, 5, 40])
def test_a_text_can_be_copied_within_one_buffer(gap: int):
    for run in (copied, compiled(copied)):
        text = np.arange(1, 101, dtype=np.uint8)
        run(text, 20 + gap, text, 0, 20)
        np.testing.assert_array_equal(text[: 20 + gap], np.arange(1, 21 + gap))
        np.testing.assert_array_equal(text[20 + gap : 40 + gap], np.arange(1, 21))


def python(code: str, *folders: Path, cache: Path | None = None) -> str:
    """Output of a new Python process, without bytecode files, which could miss an edit within a second."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    if cache is not None:
        env["XDG_CACHE_HOME"] = str(cache)
    done = subprocess.run([sys.executable, "-B", "-c", code], env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


SOURCES = [Path(package.__file__).parent for package in (liftgate_compiler, liftgate_hil, liftgate_plant)]
FOLDERS = [source.parent for source in SOURCES]


def cache_of(*folders: Path) -> str:
    """Name of the cache folder for the tick's machine code if the packages are in these folders."""
    return python(
        "from liftgate_hil.loop.tick import tick; import liftgate_compiler as compiler;"
        "print(compiler.cache_folder(tick).name)",
        *folders,
    )


def test_machine_code_depends_on_edits_of_either_package_but_not_on_where_it_is_installed(tmp_path: Path):
    for source in SOURCES:  # beside each other, as a wheel puts them
        shutil.copytree(source, tmp_path / source.name)
    found = [cache_of(tmp_path)]
    assert found[0] == cache_of(*FOLDERS)
    for edited in ("liftgate_plant/friction.py", "liftgate_hil/loop/tick.py"):
        with (tmp_path / edited).open("a") as stream:
            stream.write("# edited\n")
        found.append(cache_of(tmp_path))
    assert len(set(found)) == 3


# A package with two entry points, of which only one uses all of it.
PACKAGE = {
    "__init__.py": "",
    "constants.py": "GAIN = 2.0\nOTHER = 1.0\nTABLE = (1.0, 2.0)\n",
    "kinds.py": """
from typing import NamedTuple
import numpy as np
from gatelike.parts import Part
ROW = np.dtype([("a", "f8"), ("b", "f8")])
class Kind(NamedTuple):
    part: Part
    low: float
    high: float
""",
    "parts.py": """
from typing import NamedTuple
class Part(NamedTuple):
    first: float
    second: float
""",
    "deep.py": """
from liftgate_compiler import compilable
@compilable
def half(x: float) -> float:
    return 0.5 * x
""",
    "helpers.py": """
from __future__ import annotations
from gatelike import constants, deep
from gatelike.constants import GAIN
from gatelike.kinds import Kind
from liftgate_compiler import compilable
@compilable
def width(kind: Kind) -> float:
    return GAIN * deep.half(kind.high - kind.low) * constants.TABLE[1] + kind.part.first
""",
    "entries.py": """
from __future__ import annotations
import numpy as np
from gatelike import helpers
from gatelike.kinds import Kind, ROW
from gatelike.parts import Part
from gatelike.deep import half
from liftgate_compiler import compilable
KIND = Kind(Part(10.0, 20.0), 1.0, 4.0)
@compilable
def large(kind: Kind, rows: np.ndarray) -> float:
    return helpers.width(kind) + rows[0].a
@compilable
def small(x: float) -> float:
    return half(x)
def rows():
    made = np.zeros(1, ROW).view(np.recarray)
    made.a, made.b = 100.0, 200.0
    return made
""",
}


def package_in(place: Path) -> Path:
    """A folder with the test package `gatelike`."""
    folder = place / "gatelike"
    folder.mkdir()
    for name, text in PACKAGE.items():
        (folder / name).write_text(text)
    return place


@pytest.fixture
def package(tmp_path: Path) -> Path:
    return package_in(tmp_path)


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def caches_of(package: Path) -> tuple[str, str]:
    """Names of the cache folders of the entry points `large` and `small`."""
    large, small = python(
        "from gatelike import entries; from liftgate_compiler import cache_folder;"
        "print(cache_folder(entries.large).name, cache_folder(entries.small).name)",
        package,
        *FOLDERS,
    ).split()
    return large, small


@pytest.fixture(scope="module")
def caches_before(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Names of the cache folders of an unedited package in another folder."""
    return caches_of(package_in(tmp_path_factory.mktemp("before")))


def test_an_unedited_package_uses_the_same_machine_code(package: Path, caches_before: tuple[str, str]):
    assert caches_of(package) == caches_before


@pytest.mark.parametrize(
    ("file", "old", "new", "changes"),
    [
        ("helpers.py", "kind.high - kind.low", "kind.low - kind.high", (True, False)),
        ("deep.py", "0.5", "0.25", (True, True)),
        ("kinds.py", "low: float\n    high: float", "high: float\n    low: float", (True, False)),
        ("parts.py", "first: float\n    second", "second: float\n    first", (True, False)),
        ("kinds.py", '("a", "f8"), ("b", "f8")', '("b", "f8"), ("a", "f8")', (True, False)),
        ("constants.py", "GAIN = 2.0", "GAIN = 3.0", (True, False)),
        ("constants.py", "(1.0, 2.0)", "(1.0, 3.0)", (True, False)),
        ("constants.py", "OTHER = 1.0", "OTHER = 3.0", (False, False)),
    ],
)
def test_an_edit_needs_new_machine_code_only_of_the_functions_that_use_it(
    package: Path, caches_before: tuple[str, str], file: str, old: str, new: str, changes: tuple[bool, bool]
):
    replace(package / "gatelike" / file, old, new)
    after = caches_of(package)
    assert tuple(a != b for a, b in zip(after, caches_before, strict=True)) == changes


USE = """
import sys
{first}
from gatelike.entries import KIND, large, rows
from liftgate_compiler import cache_folder, compiled, is_cached
known = is_cached(large)
answer = compiled(large)(KIND, rows())
assert answer == large(KIND, rows())
print(known, is_cached(large), answer, "numba" in sys.modules, "scipy.linalg" in sys.modules)
{last}
"""


@pytest.mark.skipif(not enabled(), reason="needs the compiler")
def test_machine_code_is_kept_until_its_sources_change(package: Path, tmp_path: Path):
    home = tmp_path / "cache"
    first = USE.format(first="", last="")
    fresh, again = (
        [known, "True", "116.0", "False", "False"] for known in ("False", "True")
    )  # numba is in the process that compiles
    assert python(first, package, *FOLDERS, cache=home).split() == fresh
    assert python(first, package, *FOLDERS, cache=home).split() == again
    # With numba there before.
    second = USE.format(first="import numba", last="")
    assert python(second, package, *FOLDERS, cache=home).split()[:3] == again[:3]
    replace(package / "gatelike" / "kinds.py", "low: float\n    high: float", "high: float\n    low: float")
    replace(package / "gatelike" / "entries.py", "1.0, 4.0", "4.0, 1.0")
    assert python(first, package, *FOLDERS, cache=home).split() == fresh


SMALL = """
import sys, threading
from liftgate_compiler import compiled
def entry(x: float) -> float:
    return 2.0 * x
def again(x: float) -> float:
    return 3.0 * x
found = []
def run():
    found.append((compiled(entry)(1.0), compiled(again)(1.0)))
threads = [threading.Thread(target=run) for _ in range(6)]
for each in threads: each.start()
for each in threads: each.join()
print(set(found))
"""


def in_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


SPOILS: list[Callable[[Path], object]] = [
    lambda path: path.write_bytes(b""),
    lambda path: path.write_bytes(path.read_bytes()[:40]),
    lambda path: path.write_bytes(path.read_bytes()[:-1]),
    lambda path: path.write_bytes(path.read_bytes()[:2000] + bytes(100) + path.read_bytes()[2100:]),
    in_a_folder,
]

SEVERAL = """
from liftgate_compiler import compiled
{functions}
print([{calls}])
""".format(
    functions="\n".join(
        f"def entry_{place}(x: float) -> float:\n    return {place}.0 * x" for place in range(len(SPOILS))
    ),
    calls=", ".join(f"compiled(entry_{place})(1.0)" for place in range(len(SPOILS))),
)


@pytest.mark.skipif(not enabled(), reason="needs the compiler")
def test_corrupted_machine_code_is_compiled_again(tmp_path: Path):
    """The file of each entry point is corrupted in another way; all are compiled twice, which takes a while."""
    expected = f"{[float(place) for place in range(len(SPOILS))]}\n"
    assert python(SEVERAL, *FOLDERS, cache=tmp_path) == expected
    files = sorted(tmp_path.rglob("*.code"))
    assert len(files) == len(SPOILS)
    whole = [path.read_bytes() for path in files]
    for path, spoil in zip(files, SPOILS, strict=True):
        spoil(path)
    assert python(SEVERAL, *FOLDERS, cache=tmp_path) == expected
    for path, before in zip(files, whole, strict=True):
        assert path.is_dir() or len(path.read_bytes()) == len(before)
    assert [path.is_dir() for path in files] == [spoil is in_a_folder for spoil in SPOILS]
    assert sorted(tmp_path.rglob("*.code")) == files


@pytest.mark.skipif(not enabled(), reason="needs the compiler")
def test_without_a_writable_cache_functions_are_still_compiled(tmp_path: Path):
    file = tmp_path / "file"
    file.touch()
    assert python(SMALL, *FOLDERS, cache=file) == "{(2.0, 3.0)}\n"
    homeless = "import os, pathlib\nos.environ.pop('XDG_CACHE_HOME', None)\n"
    homeless += "def nowhere(*_): raise RuntimeError('no home')\npathlib.Path.home = nowhere\n"
    assert python(homeless + SMALL, *FOLDERS) == "{(2.0, 3.0)}\n"


@pytest.mark.skipif(not enabled(), reason="needs the compiler")
def test_other_packages_can_still_multiply_matrices_with_numba(tmp_path: Path):
    code = """
from liftgate_compiler import compiled
def entry(x: float) -> float:
    return x
assert compiled(entry)(1.0) == 1.0
import scipy.linalg.cython_blas
from numba.np import arraymath, linalg
linalg.ensure_blas()
assert arraymath._HAVE_BLAS
"""
    python(code, *FOLDERS, cache=tmp_path)


_LONG = """
import sys
from liftgate_compiler import Watcher, compiled, watch

class Seen(Watcher):
    compiled = 0
    def compiles(self, name, seconds):
        self.compiled = 1

seen = Seen()
watch(seen)

def long(x: float) -> float:
    %s
    return x

def main() -> None:
    function = compiled(long)
    print("ready", flush=True)
    sys.stdin.readline()
    assert function(1.0) == 41.0
    print(seen.compiled)

if __name__ == "__main__":
    main()
"""


def test_processes_started_together_compile_once(tmp_path: Path):
    program = tmp_path / "long.py"
    program.write_text(_LONG % "\n    ".join(40 * ["x = x + 1.0 if x > 0.0 else x * 2.0"]))
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    children = [
        subprocess.Popen(
            [sys.executable, str(program)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        )
        for _ in range(2)
    ]  # fmt: skip
    for child in children:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
    answers = []
    for child in children:
        assert child.stdin is not None
        child.stdin.write("go\n")
        child.stdin.flush()
    for child in children:
        out, complaints = child.communicate(timeout=120)
        assert child.returncode == 0, complaints
        answers.append(int(out))
    assert sorted(answers) == [0, 1]
