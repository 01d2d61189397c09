from dataclasses import replace

import numpy as np
import pytest

from liftgate_hil.identification.reporting.findings import has_offset, validation_warnings, warnings_of
from liftgate_hil.identification.reporting.html import validation_html
from liftgate_hil.identification.residuals import Frame, series_of, speed_series

TIMES = np.arange(1000) * 1e-3
FRAME = Frame(TIMES, np.ones(1000), np.zeros(1000, dtype=np.int64))


def course(errors, output="left_current_a"):
    """Series of 1 s at 1 kHz with these residuals."""
    simulated = 10.0 * np.sin(5.0 * TIMES)
    return series_of(output, FRAME, simulated + errors, simulated, None)


def test_warnings_shorten_long_names_from_files_and_nothing_else(judged):
    first = judged.experiments[0]
    errors = np.convolve(noise(1), 0.98 ** np.arange(400))[:1000]
    phases = {"end stop": (0.916, 1.0, 500), "travel": (0.1, 0.2, 500)}
    for name, shown in (("right_position_rev", "right_position_rev"), ("n" * 70, f"{'n' * 29}…{'n' * 30}")):
        series = replace(course(errors, name), phases=phases)
        warnings = validation_warnings(replace(judged, experiments=(replace(first, series=(series,)),)))
        (warning,) = [each for each in warnings if "not white" in each]
        assert f"not white: {shown} (mostly in the phase “end stop”, rms 0.92). Model" in warning


def noise(seed):
    """White noise of standard deviation 0.1, for 1 s at 1 kHz."""
    return 0.1 * np.random.default_rng(seed).standard_normal(1000)


def test_offsets_of_opposite_sign_in_two_experiments_are_not_called_sensor_offsets(judged):
    first = judged.experiments[0]
    both = [
        replace(first, name=name, series=(course(noise(1) - noise(1).mean() + offset),))
        for name, offset in (("open.csv", 0.5), ("close.csv", -0.5))
    ]
    warnings = validation_warnings(replace(judged, experiments=tuple(both)))
    assert [each for each in warnings if each.startswith("left_current_a: above the simulation in one")]
    assert not [each for each in warnings if "has its sensor an offset" in each]


def test_identify_and_validate_warn_of_an_offset_with_its_size_and_sign(found, judged):
    for offset, said in ((1.0, "1.0 A above"), (-0.25, "0.25 A below")):
        (first, *rest) = judged.experiments
        shifted = replace(first, series=(course(noise(1) - noise(1).mean() + offset), *first.series[1:]))
        for warnings in (
            validation_warnings(replace(judged, experiments=(shifted, *rest))),
            warnings_of(replace(found, experiments=(shifted, *rest))),
        ):
            line = f"open.csv: left_current_a is {said} the simulation on average: has its sensor an offset?"
            assert [each for each in warnings if "left_current_a" in each and "on average" in each] == [line]


@pytest.mark.parametrize("seed", range(20))
def test_correlated_noise_is_not_taken_for_an_offset(seed):
    assert not has_offset(course(noise(seed)))
    slow = np.convolve(noise(seed), 0.98 ** np.arange(400))[:1000]
    assert not has_offset(course(slow))
    assert not has_offset(course(TIMES**2 + noise(seed)))  # grows as that of a wrong model


def test_a_mean_residual_counts_as_an_offset_only_with_many_samples():
    errors = noise(1) + 0.12
    assert has_offset(course(errors))
    few = np.where(np.arange(1000) < 6, errors, np.nan)
    assert not has_offset(series_of("left_current_a", FRAME, few, np.zeros(1000), None))


def test_rounded_positions_and_speeds_derived_from_them_have_no_offset():
    position = 30.0 * TIMES
    assert not has_offset(series_of("left_position_rev", FRAME, np.floor(4.0 * position) / 4.0, position, None))
    assert not has_offset(speed_series("left_speed_rps", FRAME, 1.1 * position, position, None))
    exact = course(np.full(1000, 1e-12))
    assert not has_offset(exact)


def test_residuals_with_an_offset_are_called_white_about_their_mean(judged):
    first = judged.experiments[0]
    one = replace(judged, experiments=(replace(first, series=(course(noise(1) + 1.0),)),))
    assert "white about its mean" in validation_html(one)
