"""What the compiler's module adds to numba."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import liftgate_hil
import liftgate_plant
from liftgate_plant.compiler import all_finite, borrowed, compilable, compiled, fill


class Inner(NamedTuple):
    numbers: NDArray[np.float64]
    scale: float


class Outer(NamedTuple):
    inner: Inner
    counts: NDArray[np.int64]


@compilable
def scaled_sum(outer: Outer) -> float:
    total = 0.0
    for number in outer.inner.numbers:
        total += outer.inner.scale * number
    outer.counts[0] += 1
    return total


@compilable
def borrowing(outer: Outer, times: int) -> float:
    (mine,) = borrowed((outer,))
    total = 0.0
    for _ in range(times):
        total += scaled_sum(mine)
    return total


def test_borrowed_arrays_are_the_same_and_stay_their_owners():
    numbers, counts = np.arange(5.0), np.zeros(1, dtype=np.int64)
    outer = Outer(Inner(numbers, 0.5), counts)
    before = sys.getrefcount(numbers)
    assert compiled(borrowing)(outer, 1000) == borrowing(outer, 1000) == 5000.0
    assert counts[0] == 2000
    assert sys.getrefcount(numbers) == before
    del outer
    assert list(numbers) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_in_plain_python_it_is_the_value_itself():
    value = Inner(np.zeros(1), 1.0)
    assert borrowed(value) is value


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
def test_a_tuple_goes_whole_into_a_row_and_one_bad_number_is_seen(numbers, finite):
    for run in (filled, compiled(filled)):
        rows = np.zeros((5, 2))
        assert run(rows[:, 1], numbers) == finite
        np.testing.assert_array_equal(rows, [[0.0, each] for each in (0.0, *numbers, 0.0)])


def cache_of(*folders: Path) -> str:
    """The name of the cache of the loop's machine code where the packages are found in these folders."""
    code = (
        "import liftgate_hil.loop.tick; from liftgate_plant import compiler;"
        "print(compiler.cache_folder().name)"
    )
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.parametrize("edited", ["liftgate_plant/friction.py", "liftgate_hil/loop/tick.py"])
def test_an_edit_of_either_package_asks_for_new_machine_code_wherever_they_are_installed(
    tmp_path: Path, edited: str
):
    sources = [Path(package.__file__).parent for package in (liftgate_hil, liftgate_plant)]
    for source in sources:  # beside each other, as a wheel puts them
        shutil.copytree(source, tmp_path / source.name)
    before = cache_of(tmp_path)
    assert before == cache_of(*(source.parent for source in sources))
    with (tmp_path / edited).open("a") as stream:
        stream.write("# edited\n")
    assert cache_of(tmp_path) != before


_LONG = """
import sys
from liftgate_plant.compiler import compiled

def long(x: float) -> float:
    %s
    return x

def main() -> None:
    function = compiled(long)
    print("ready", flush=True)
    sys.stdin.readline()
    assert function(1.0) == 41.0
    print(function.stats.cache_misses[(function.signatures[0])] if function.stats.cache_misses else 0)

if __name__ == "__main__":
    main()
"""


def test_processes_that_begin_together_compile_once(tmp_path: Path):
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
