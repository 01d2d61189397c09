"""Coverage of the truth by intervals of identifications: many seeds, all kinds of data and initial states.

The suite has a few of each (`tests/hil/identification`).
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.hil.identification import many_seeds, pauses
from tests.hil.identification.many_seeds import QUANTUM, THINNED
from tests.study.shortened import SHORT, seeds


def rms(z: np.ndarray) -> float:
    return math.sqrt(np.mean(z**2))


@pytest.mark.parametrize("model", ["full", "third-order", "second-order"])
def test_errors_of_identified_parameters_match_their_standard_deviations(model: str) -> None:
    z = many_seeds.of_white_noise(model, seeds(25))
    assert np.abs(z).max() < 3.5
    if SHORT:
        return
    # 125 values: their mean has a standard deviation of about 0.1, their spread of 0.07.
    assert abs(np.mean(z)) < 0.25
    assert 0.85 < np.std(z) < 1.15
    # Of one parameter 0.2 and 0.14.
    assert np.abs(np.mean(z, axis=0)).max() < 0.6
    assert np.std(z, axis=0).min() > 0.6
    assert np.std(z, axis=0).max() < 1.4


def test_comparing_hall_counts_at_their_edges_gives_unbiased_parameters() -> None:
    edges, naive = many_seeds.of_hall_counts(seeds(15))
    assert np.abs(edges).max() < 3.0
    if SHORT:
        return
    assert np.abs(np.mean(edges, axis=0)).max() < 0.8
    assert 0.6 < np.std(edges) < 1.3
    assert np.abs(naive[:, 2]).max() > 5.0  # measured 8.2; 48 without the rounding's share


def test_correlated_residuals_widen_the_standard_deviations_to_the_size_of_the_errors() -> None:
    robust, classic = many_seeds.of_coloured_noise(seeds(25))
    assert np.all(np.abs(robust) < np.abs(classic))
    if SHORT:
        return
    assert 0.7 < np.std(robust) < 1.4
    assert np.std(classic) > 2.0


def test_errors_of_identified_parameters_match_their_deviations_when_timestamps_scatter() -> None:
    std = 0.0015
    found = many_seeds.of_scattered_stamps(std, seeds(16))
    assert np.mean(found.jitter) == pytest.approx(std, rel=0.2)
    assert np.abs(found.known).max() < 4.3  # 99.9 % of the largest of 48 normal errors; measured 3.7
    if SHORT:
        return
    assert 0.75 < rms(found.known) < 1.2  # measured 0.99
    assert rms(found.blind) > 2.0  # measured 3.2


@pytest.mark.parametrize("quantum", [0.0, QUANTUM])
@pytest.mark.parametrize(("rate", "factor"), THINNED)
def test_estimates_from_thinned_data_agree_with_the_truth(rate: float | None, factor: int, quantum: float) -> None:
    z = many_seeds.of_thinned_data(rate, factor, quantum, seeds(4))
    assert np.max(np.abs(z)) < 3.0


@pytest.mark.parametrize("outputs", [*pauses.NOISE])
@pytest.mark.parametrize("case", [*pauses.CASES])
def test_a_measurement_that_begins_in_a_pause_gives_the_true_parameters(case: str, outputs: str) -> None:
    pauses.check_that_the_truth_is_found(case, outputs)


@pytest.mark.parametrize("seed", [3, 7])
def test_a_search_ends_at_the_same_minimum_as_one_from_the_truth(seed: int) -> None:
    pauses.check_where_a_search_ends(seed)


@pytest.mark.parametrize("seed", [1, 0, 2])
def test_the_deepest_of_neighbouring_minima_is_found(seed: int) -> None:
    z = many_seeds.of_neighbouring_minima(seed)
    assert np.abs(z).max() < 4.0  # 14 to 24 in a minimum beside it
