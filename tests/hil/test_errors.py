"""Messages about unknown names."""

from __future__ import annotations

from liftgate_hil.errors import allowed_names


def test_few_names_are_all_listed_in_their_own_order() -> None:
    assert allowed_names("beta", ["gamma", "alpha", "bta"]) == "gamma, alpha, bta"


def test_of_many_names_the_most_similar_are_listed_with_the_total() -> None:
    known = [f"name_{i}" for i in range(40)] + ["left_current"]
    assert allowed_names("left_curent", known) == "left_current, … (41 in all)"


def test_of_many_names_without_a_similar_one_the_first_are_listed() -> None:
    text = allowed_names("xyz", [f"name_{i}" for i in range(40)])
    assert text.startswith("name_0, name_1, ")
    assert text.endswith("name_11, … (40 in all)")
