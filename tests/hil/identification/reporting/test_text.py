from dataclasses import replace

import numpy as np
import report_support

from liftgate_hil.identification.reporting.findings import with_warnings
from liftgate_hil.identification.reporting.text import WIDTH, identification_text, validation_text


def test_the_tables_fit_a_terminal(found, judged, hostile):
    for text in (identification_text(found), validation_text(judged), identification_text(hostile)):
        assert max(map(len, text.splitlines())) <= WIDTH
        assert all(line == line.rstrip() for line in text.splitlines())


def test_a_parameter_is_reported_in_a_line(found):
    line = next(each for each in identification_text(found).splitlines() if "0.708" in each)
    assert line.split() == [
        "motor.resistance", "2.128", "0.022", "1.0", "0.708", "+201", "ohm", "yes",
    ]  # fmt: skip


def test_what_cannot_be_identified_comes_first(found):
    text = identification_text(found)
    start = text.index("Parameters")
    assert 0 < text.index("motor.inductance is not identifiable: its standard") < start
    assert 0 < text.index("only their product is told") < start
    assert 0 < text.index("motor.load_torque: at its lower bound") < start
    assert 0 < text.index("residuals are not white") < start


def test_everything_asked_for_is_there(found):
    text = identification_text(found)
    for part in (
        "NoiseVar", "0.04910", "FPE", "AIC ", "AICc", "BIC", "condition number  3.20e+07", "10.40 -> 53.66",
        "not white", "the step became shorter", "9 iterations", "61 simulations", "12.3 s", "decimated from",
        "-0.950", "2.085 … 2.171", "no limit … no limit", "open.csv: left_position", "robust",
    ):  # fmt: skip
        assert part in text, part


def test_a_validation_shows_fit_and_phases(judged):
    text = validation_text(judged)
    assert "->" not in text
    for part in ("fit %", "running", "99.67", "667", "decimated", "close.csv"):
        assert part in text, part


def test_hostile_names_do_not_reach_the_terminal(hostile):
    text = identification_text(hostile)
    assert text.isascii() or text.encode("utf-8")
    assert all(each.isprintable() or each == "\n" for each in text)


def test_nothing_found_is_still_a_text():
    text = identification_text(report_support.nothing())
    assert "Criteria" in text
    assert "Attention" not in text


def test_wide_noise_matrices_are_broken_into_blocks(found):
    names = tuple(f"output_number_{i}_of_many_a" for i in range(12))
    wide = replace(found, outputs=names, noise_variance=-1.23456e-7 * np.ones((12, 12)))
    assert max(map(len, identification_text(wide).splitlines())) <= WIDTH
    assert identification_text(wide).count("-1.235e-07") == 144


def test_a_fit_below_zero_is_pointed_out(judged):
    first = judged.experiments[0]
    worse = replace(first, series=(replace(first.series[0], fit_percent=-3.0), *first.series[1:]))
    assert "worse than the mean value: left_current_a" in validation_text(
        with_warnings(replace(judged, experiments=(worse,)))
    )
