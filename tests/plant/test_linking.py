"""How compiled code is put together: entry points with all that they call, helpers in nothing else."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from liftgate_plant.compiler import borrowed, compilable, compiled, enabled

pytestmark = pytest.mark.skipif(not enabled(), reason="needs the compiler")


@pytest.fixture(scope="module", autouse=True)
def empty_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """So that everything here is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


class Box(NamedTuple):
    numbers: NDArray[np.float64]
    scale: float


@compilable
def deepest(x: float) -> float:
    if x > 1000.0:
        raise ValueError("too large", x)
    return x + 1.0


@compilable
def left(x: float) -> float:
    return deepest(2.0 * x)


@compilable
def right(x: float) -> float:
    return deepest(x) * left(x)


@compilable
def diamond(x: float) -> float:
    return left(x) + right(x)


@compilable
def other_entry(x: float) -> float:
    return right(x) - deepest(x)


@compilable
def filled(box: Box, count: int) -> NDArray[np.float64]:
    """New arrays, views, and what only sometimes is the one or the other."""
    new = np.zeros(count)
    for k in range(count):
        new[k] = box.scale * box.numbers[k]
    return new if count > 2 else box.numbers[:count]


@compilable
def with_arrays(box: Box, count: int) -> tuple[Box, float]:
    total = 0.0
    for _ in range(100):
        total += filled(box, count)[count - 1]
    return Box(filled(box, count), box.scale), total


def entry_library(function: Any) -> Any:
    (result,) = function.overloads.values()
    return result.library


def test_the_installed_numba_is_one_of_those_whose_inside_is_known():
    from liftgate_plant.compiler import linking

    assert linking.is_possible()
    code = compiled(diamond)
    assert code(3.0) == diamond(3.0) == 35.0
    library = entry_library(code)
    assert type(library).__name__ == "EntryLibrary"
    assert not [f.name for f in library.get_defined_functions() if "deepest" in f.name]


def test_entry_points_share_helpers():
    assert compiled(diamond)(3.0) == diamond(3.0)
    assert compiled(other_entry)(3.0) == other_entry(3.0)


@pytest.mark.parametrize("count", [2, 5])
def test_references_are_counted_where_arrays_are_not_borrowed(count: int):
    numbers = np.arange(10.0)
    before = sys.getrefcount(numbers)
    box, total = compiled(with_arrays)(Box(numbers, 3.0), count)
    scale = 3.0 if count > 2 else 1.0
    assert list(box.numbers) == [scale * k for k in range(count)]
    assert total == 100 * scale * (count - 1)
    del box
    assert sys.getrefcount(numbers) == before


def test_errors_of_helpers_reach_python_with_their_values():
    with pytest.raises(ValueError, match=r"too large.*2000") as error:
        compiled(diamond)(1000.0)
    assert error.value.args == ("too large", 2000.0)


def test_others_may_call_helpers_too():
    import numba

    compiled(diamond)(3.0)  # numba knows the helpers from now on
    theirs = numba.njit(lambda x: right(x) + 1.0)
    assert theirs(3.0) == right(3.0) + 1.0


@compilable
def returns_borrowed(box: Box) -> NDArray[np.float64]:
    return borrowed(box).numbers


@compilable
def mixes(box: Box, flag: bool) -> float:
    mine = borrowed(box)
    if flag:
        mine = box
    return mine.scale


@pytest.mark.parametrize(
    ("function", "arguments", "complaint"),
    [(returns_borrowed, (), "returns borrowed arrays"), (mixes, (True,), "Cannot unify")],
)
def test_borrowed_arrays_stay_apart_from_counted_ones(
    function: Any, arguments: tuple[Any, ...], complaint: str
):
    from numba.core.errors import TypingError

    with pytest.raises(TypingError, match=complaint):
        compiled(function)(Box(np.zeros(3), 1.0), *arguments)
    assert gc.isenabled()


def test_without_the_inside_of_numba_it_compiles_as_numba_does(tmp_path: Path):
    code = (
        "from liftgate_plant.compiler import compiled, linking\n"
        "from tests.plant import test_linking as t\n"
        "linking.is_possible = lambda: False\n"
        "code = compiled(t.diamond)\n"
        "assert code(3.0) == 35.0\n"
        "assert type(t.entry_library(code)).__name__ == 'JITCodeLibrary'\n"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
