"""Designs of experiments of a campaign: which points they have, and in which order."""

from __future__ import annotations

import itertools
import re
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.campaigns import space as space_module
from liftgate_hil.campaigns.request import METHODS
from liftgate_hil.campaigns.space import Design, Space, shares_of, space_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=60)

PARAMETERS = {"rod": "N/m", "angle": "deg", "limit": "N"}


@cache
def suv() -> Vehicle:
    return vehicle_from("suv")


def space(*texts: str) -> Space:
    own = {
        "parameters": ["gate.mass", "motor.resistance"],
        "values": [30.0, 0.3],
        "covariance": [[1, 0.01], [0.01, 1e-3]],
    }
    return space_of(texts, PARAMETERS, suv(), {"identification": own})  # fmt: skip


def design(*texts: str, samples: int = 0, method: str = "sobol", seed: int = 0) -> Design:
    return Design(space(*texts), samples, method, seed)


def whole(made: Design) -> np.ndarray:
    return made.values(0, made.count)


def test_a_full_grid_has_each_combination_exactly_once() -> None:
    made = design("rod=1,2,3", "supply.voltage=9,12", "angle=10:50:5", "seed=4,7")
    expected = set(itertools.product((1.0, 2.0, 3.0), (9.0, 12.0), (10.0, 20.0, 30.0, 40.0, 50.0), (4.0, 7.0)))
    assert made.count == 60
    assert sorted(map(tuple, whole(made).tolist())) == sorted(expected)


@pytest.mark.parametrize(
    ("vary", "samples", "is_sampled"),
    [
        (["rod=1,2", "seed=1,2"], 0, False),
        (["rod~uniform(1,2)", "angle=1,2"], 3, True),
        (["draw=1:20:20"], 0, True),
        (["seed=1,2", "draw=1,2"], 0, True),
        ([], 0, False),
    ],
)
def test_a_design_with_samples_or_of_seeds_and_drawn_cars_alone_counts_as_sampled(
    vary: list[str], samples: int, is_sampled: bool
) -> None:
    assert design(*vary, samples=samples).is_sampled == is_sampled


def test_factors_that_the_precondition_depends_on_change_slowest() -> None:
    made = design("rod=1,2,3", "supply.voltage=9,12", "angle=10,20", "seed=4,7", "draw=1,2", "gate.mass=30,31")
    slow = whole(made)[:, [1, 3, 4, 5]]
    changes = (np.diff(slow, axis=0) != 0.0).any(axis=1).sum()
    assert changes == 2**4 - 1


def test_a_design_of_parameters_alone_has_the_last_one_changing_fastest() -> None:
    assert whole(design("rod=1,2", "angle=5,6")).tolist() == [[1.0, 5.0], [1.0, 6.0], [2.0, 5.0], [2.0, 6.0]]
    assert design().count == 1  # without a vary there is one variant
    assert whole(design()).shape == (1, 0)


MIXED = ("rod=1,2,3", "supply.voltage=9,12", "angle~uniform(0,1)", "vehicle")


@CALM
@given(st.integers(0, 80), st.integers(0, 90))
def test_any_slice_of_a_design_equals_that_of_the_whole_design(first: int, count: int) -> None:
    made = mixed()
    np.testing.assert_array_equal(made.values(first, count), whole(made)[first : first + count])


@cache
def mixed() -> Design:
    return design(*MIXED, samples=11)


def test_each_combination_of_grid_values_gets_the_same_samples() -> None:
    found = whole(mixed())
    assert len(found) == 3 * 2 * 11
    groups = {
        key: found[(found[:, :2] == key).all(axis=1)] for key in itertools.product((1.0, 2.0, 3.0), (9.0, 12.0))
    }
    samples = [each[np.argsort(each[:, 2])][:, 2:] for each in groups.values()]
    for each in samples:
        np.testing.assert_array_equal(each, samples[0])
    assert len(np.unique(samples[0][:, 0])) == 11


def test_samples_do_not_depend_on_the_grids_beside_them() -> None:
    alone = whole(design("angle~uniform(0,1)", samples=16))[:, 0]
    beside = whole(design("rod=1,2", "angle~uniform(0,1)", samples=16))
    np.testing.assert_array_equal(np.sort(np.unique(beside[:, 1])), np.sort(alone))


@pytest.mark.parametrize(
    ("method", "dimensions", "count"),
    [*(("lhs", 4, count) for count in (1, 7, 64, 100)), ("sobol", 1, 64), ("sobol", 3, 64)],
)
def test_lhs_and_sobol_samples_have_one_point_in_each_stratum(method: str, dimensions: int, count: int) -> None:
    """Holds for Sobol samples only if their number is a power of two."""
    for each in shares_of(dimensions, count, method, 3).T:
        assert sorted(np.floor(each * count).astype(int).tolist()) == list(range(count))


@pytest.mark.parametrize("method", METHODS)
def test_samples_are_reproducible_by_seed(method: str) -> None:
    first, again, other = (shares_of(3, 20, method, seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert not (first == other).any()


@pytest.mark.parametrize("method", METHODS)
def test_samples_are_in_the_unit_cube(method: str) -> None:
    shares = shares_of(5, 33, method, 0)
    assert shares.shape == (33, 5)
    assert ((shares >= 0.0) & (shares < 1.0)).all()


def test_sampling_leaves_numpys_global_generator_unchanged() -> None:
    np.random.seed(1)
    expected = np.random.random()
    np.random.seed(1)
    for method in METHODS:
        shares_of(2, 8, method, 0)
    assert np.random.random() == expected


@pytest.mark.parametrize(
    ("vary", "samples", "message"),
    [
        (["rod~uniform(0,1)"], 0, "`samples`: missing; allowed: a number, as rod~uniform(0, 1) is a distribution"),
        (["vehicle"], 0, "`samples`: missing; allowed: a number, as vehicle is a distribution"),
        (["rod=1,2"], 20, "`samples` 20: allowed: with a distribution, or vehicle, in `vary`"),
        (["rod=1:2:100000", "angle=1:2:100000"], 0, "`vary`: 1e+10 variants; allowed: up to 1e+09"),
    ],
)
def test_an_impossible_number_or_method_of_samples_is_refused(vary: list[str], samples: int, message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        design(*vary, samples=samples)


def test_a_billion_variants_are_not_held_in_memory() -> None:
    made = design("rod=1:2:100000", "angle=1:2:10000")
    assert made.count == 10**9
    assert made.values(10**9 - 2, 10).tolist() == [[2.0, made.values(10**9 - 2, 1)[0, 1]], [2.0, 2.0]]


def test_too_many_variants_are_refused_before_their_samples_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[object] = []
    monkeypatch.setattr(space_module, "shares_of", lambda *given: drawn.append(given))
    with pytest.raises(ConfigError):
        design("rod~uniform(0,1)", "angle=1:2:100", samples=10**9, method="random")
    assert drawn == []
