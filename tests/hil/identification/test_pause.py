"""Data that begin in a pause: the drives stopped at places of their own, and their windings are warm."""

from __future__ import annotations

import pytest

from tests.hil.identification import pauses


@pytest.mark.parametrize(
    ("case", "outputs"),
    [
        ("suv half-way", "all"),
        ("heavy-suv half-way", "angle"),
        ("heavy-suv open", "positions"),
        ("suv closed", "positions"),
        ("heavy-suv closed", "angle"),
    ],
)
def test_a_measurement_that_begins_in_a_pause_tells_the_same(case: str, outputs: str) -> None:
    pauses.check_that_the_truth_is_found(case, outputs)  # each with each: tests/study


def test_a_search_ends_where_one_from_the_truth_does() -> None:
    """Here the gate floats through the play: minima lie beside each other, and a search by slopes at the point
    alone ends in another one. More seeds: tests/study.
    """
    pauses.check_where_a_search_ends(7)
