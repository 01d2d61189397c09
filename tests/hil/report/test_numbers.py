import math

import pytest

from liftgate_hil.report.numbers import (
    axis_label,
    clean,
    known_digits,
    percent,
    plain,
    relative_change,
    relative_error,
    significant,
)


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (2.12797, 0.0217914, "2.128"),
        (1.47e-5, 2.81633e-7, "1.470e-05"),
        (4.20318e-5, 61.14862e-5, "4.2e-05"),
        (0.0776828, 0.000627679, "0.07768"),
        (29.0, 0.1, "29.00"),
        (900.0, 400.0, "900"),
        (-0.5, 0.0996, "-0.50"),
        (9.999, 0.5, "10.0"),
        (3.0, math.inf, "3.00"),
        (3.0, 0.0, "3.00000"),
        (0.0, 1.0, "0"),
        (math.nan, 1.0, "—"),
    ],
)
def test_a_value_is_shown_to_the_digits_that_its_deviation_supports(value, std, shown):
    assert known_digits(value, std) == shown


def test_numbers_keep_significant_trailing_zeros():
    assert significant(0.5, 3) == "0.500"
    assert significant(123456.7, 3) == "123457"
    assert significant(1e7, 3) == "1.00e+07"
    assert significant(0.99996, 3) == "1.00"
    assert significant(-math.inf) == "-∞"
    assert plain(4.37e-5) == "4.37e-05"
    assert plain(math.nan) == "—"


def test_percentages_have_no_false_digits_and_are_nan_relative_to_zero():
    assert [percent(each) for each in (0.123, 12.34, 1455.2, 3e7, math.inf)] == [
        "0.12",
        "12.3",
        "1455",
        "3e+07",
        "—",
    ]
    assert percent(200.6, "+") == "+201"
    assert math.isnan(relative_error(0.0, 1.0))
    assert math.isnan(relative_change(1.0, 0.0))
    assert relative_change(-1.0, -2.0) == 50.0


def test_axis_labels_are_words_with_units():
    assert axis_label("left_current_a") == "left current [A]"
    assert axis_label("right_hall_count") == "right Hall count [counts]"
    assert axis_label("gate_rate_degps") == "gate rate [deg/s]"
    assert axis_label("something") == "something"


def test_names_lose_terminal_control_characters_and_long_ones_are_shortened():
    assert clean("a\x1b[2J\n\u202eb\udcff") == "a�[2J��b�"
    assert clean("x" * 50 + "end", 21) == "x" * 10 + "…" + "x" * 7 + "end"
