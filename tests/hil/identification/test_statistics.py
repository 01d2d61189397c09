"""Uncertainties and criteria agree with closed forms, numpy and many random draws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from liftgate_hil.identification.statistics import (
    autocorrelation,
    correlation_of,
    criteria,
    crosscorrelation,
    factor_between,
    fit_percent,
    information,
    is_white,
    named,
    pseudo_inverse,
    robust_covariance,
    rounding_information,
    score_series,
    uncertainty,
)


def autoregressive(rng: np.random.Generator, count: int, share: float) -> np.ndarray:
    """First-order autoregressive noise of variance one and lag-one correlation `share`."""
    white = math.sqrt(1.0 - share**2) * rng.standard_normal(count)
    noise = np.empty(count)
    noise[0] = rng.standard_normal()
    for k in range(1, count):
        noise[k] = share * noise[k - 1] + white[k]
    return noise


def test_the_information_is_that_of_weighted_least_squares() -> None:
    rng = np.random.default_rng(1)
    slopes = rng.standard_normal((50, 2, 3))
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    root = np.linalg.cholesky(np.linalg.inv(covariance))
    expected = np.diag([0.0, 0.0, 4.0])
    for row in slopes:
        expected = expected + row.T @ np.linalg.inv(covariance) @ row
    assert information(slopes, root, np.array([0.0, 0.0, 2.0])) == pytest.approx(expected)


def test_the_covariance_is_the_inverse_of_a_regular_information_matrix() -> None:
    rng = np.random.default_rng(2)
    slopes = rng.standard_normal((40, 3)) * np.array([1.0, 1e6, 1e-6])
    matrix = slopes.T @ slopes
    known = uncertainty(matrix)
    assert known.covariance == pytest.approx(np.linalg.inv(matrix), rel=1e-6)
    assert known.silent == ()
    assert known.apart == ()
    # Units do not count: the condition is that of sensitivities of length one.
    unit = slopes / np.linalg.norm(slopes, axis=0)
    assert known.condition == pytest.approx(np.linalg.cond(unit))


def test_an_unknown_without_information_is_reported_as_without_effect() -> None:
    known = uncertainty(np.diag([4.0, 0.0, 1.0]))
    assert known.silent == (1,)
    assert np.diag(known.covariance) == pytest.approx([0.25, math.inf, 1.0])
    assert known.condition == math.inf
    assert known.apart == ()
    nothing = uncertainty(np.zeros((2, 2)))
    assert nothing.silent == (0, 1)
    assert np.all(np.isinf(np.diag(nothing.covariance)))
    assert nothing.condition == math.inf


def test_a_scale_between_two_signals_is_found_and_an_offset_is_not_taken_for_one() -> None:
    rest = 60.0 + np.sin(np.linspace(0.0, 6.0, 500))
    for factor in (2.5, -0.4):
        assert factor_between(factor * rest, rest, 0.98) == pytest.approx(factor)
    assert factor_between(rest + 20.0, rest, 0.98) is None
    assert factor_between(rest[::-1] ** 2, rest, 0.98) is None
    assert factor_between(rest, np.full(500, 60.0), 0.98) is None
    assert factor_between(rest, np.zeros(500), 0.98) is None


def test_an_exactly_collinear_pair_is_named_and_other_unknowns_stay_identifiable() -> None:
    rng = np.random.default_rng(3)
    slopes = rng.standard_normal((40, 4))
    slopes[:, 3] = -7e5 * slopes[:, 1] * (1.0 + 1e-9 * rng.standard_normal(40))
    known = uncertainty(slopes.T @ slopes)
    assert known.apart == ((1, 3),)
    assert known.condition > 1e7
    alone = uncertainty(slopes[:, :3].T @ slopes[:, :3])
    for k in (0, 2):
        assert known.covariance[k, k] == pytest.approx(alone.covariance[k, k], rel=1e-3)


@pytest.mark.parametrize(
    ("columns", "apart"),  # each column is a sum of independent ones, with these weights
    [
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]], ((0, 1, 2),)),
        ([[1, 0], [0, 1], [2, 0], [-3, 0]], ((0, 2, 3),)),
        # Both directions have the eigenvalue zero, so that eigenvectors may be any mixture of them.
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]], ((0, 3), (1, 4))),
        ([*np.eye(30).tolist(), [1] * 20 + [0] * 10], ((*range(20), 30),)),
    ],
)
def test_all_unknowns_of_a_sum_are_named_together_and_once(columns: list[list[float]], apart: tuple) -> None:
    weights = np.array(columns, dtype=float)
    slopes = np.random.default_rng(4).standard_normal((90, weights.shape[1])) @ weights.T
    assert uncertainty(slopes.T @ slopes).apart == apart
    assert named(((0, 1, 2),), "abcd") == ["a, b and c cannot be separated"]


def test_a_nearly_collinear_pair_counts_as_separable() -> None:
    rng = np.random.default_rng(5)
    slopes = rng.standard_normal((4000, 2))
    slopes[:, 1] = slopes[:, 0] + 1e-3 * slopes[:, 1]
    known = uncertainty(slopes.T @ slopes)
    assert known.apart == ()
    assert known.condition == pytest.approx(2e3, rel=0.1)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_the_robust_covariance_agrees_with_many_random_draws(share: float) -> None:
    # A trend and a slow wave under autoregressive noise, fitted by least squares as if it were white.
    rng = np.random.default_rng(6)
    count, drawings = 1000, 400
    t = np.linspace(-1.0, 1.0, count)
    slopes = np.column_stack([np.ones(count), np.sin(6.0 * t)])
    inverse = np.linalg.inv(slopes.T @ slopes)
    found, said = [], []
    for _ in range(drawings):
        noise = autoregressive(rng, count, share)
        estimate = inverse @ slopes.T @ noise
        errors = (noise - slopes @ estimate)[:, None]
        found.append(estimate)
        said.append(np.diag(robust_covariance([slopes * errors], inverse, np.zeros(slopes.shape[1]))))
    std = np.std(found, axis=0)
    robust = np.sqrt(np.mean(said, axis=0))
    # Bartlett's kernel leaves a part of the correlation out: too small by some per cent, never too large.
    assert np.all(robust > 0.8 * std)
    assert np.all(robust < 1.1 * std)
    if share == 0.9:
        assert np.all(np.sqrt(np.diag(inverse)) < 0.3 * std)


def test_the_robust_covariance_does_not_depend_on_units() -> None:
    rng = np.random.default_rng(7)
    slopes = rng.standard_normal((500, 2))
    errors = autoregressive(rng, 500, 0.8)[:, None]
    units = np.array([1e-5, 1e3])
    inverse = np.linalg.inv(slopes.T @ slopes)
    plain = robust_covariance([slopes * errors], inverse, np.zeros(2))
    scaled = robust_covariance([slopes * errors * units], inverse / np.outer(units, units), np.zeros(2))
    assert scaled * np.outer(units, units) == pytest.approx(plain)


def test_correlation_is_found_despite_rows_without_samples_and_alternating_outputs() -> None:
    rng = np.random.default_rng(8)
    scores = np.column_stack([autoregressive(rng, 1000, 0.9) for _ in range(2)])
    times = np.arange(1000) / 200.0
    inverse, weak = np.eye(2), np.zeros(2)
    plain = robust_covariance([score_series(times, scores, scores)], inverse, weak)
    assert np.all(np.diag(plain) > 5.0 * np.diag(scores.T @ scores))
    # Four rows of inputs after each sample.
    thin = np.full((5000, 2), np.nan)
    thin[::5] = scores
    series = score_series(np.arange(5000) / 1000.0, thin, np.nan_to_num(thin))
    assert robust_covariance([series], inverse, weak) == pytest.approx(plain, rel=1e-9)
    short = score_series(times[:50], scores[:50], scores[:50])
    assert np.array_equal(short, scores[:50])
    # One output in even rows, the other in odd ones, and each tells one unknown.
    turns = np.full((2000, 2), np.nan)
    turns[::2, 0], turns[1::2, 1] = scores.T
    series = score_series(np.arange(2000) / 400.0, turns, np.nan_to_num(turns))
    found = np.diag(robust_covariance([series], inverse, weak))
    assert found == pytest.approx(np.diag(plain), rel=0.1)


def test_no_correlation_is_assumed_between_experiments() -> None:
    rng = np.random.default_rng(9)
    one, other = (autoregressive(rng, 500, 0.9)[:, None] for _ in range(2))
    apart = [robust_covariance([each], np.eye(1), np.zeros(1)) for each in (one, other)]
    both = robust_covariance([one, other], np.eye(1), np.zeros(1))
    assert both == pytest.approx(apart[0] + apart[1], rel=0.1)
    turned = robust_covariance([other, one], np.eye(1), np.zeros(1))
    assert turned == pytest.approx(both, rel=1e-9)


def test_the_pseudo_inverse_leaves_out_unidentifiable_directions() -> None:
    rng = np.random.default_rng(11)
    slopes = rng.standard_normal((40, 3))
    twin = np.column_stack([slopes, slopes[:, 0], np.zeros(40)])
    found = pseudo_inverse(twin.T @ twin)
    alone = np.linalg.inv(slopes.T @ slopes)
    assert found[1:3, 1:3] == pytest.approx(alone[1:, 1:])
    assert np.max(np.abs(found)) < 10.0 * np.max(alone)


def test_white_noise_rarely_fails_the_whiteness_test() -> None:
    rng = np.random.default_rng(8)
    alarms = sum(not is_white(rng.standard_normal(500)) for _ in range(2000))
    # One in a thousand, a little more because the statistic's tail is heavier than that of χ².
    assert alarms <= 10


@pytest.mark.parametrize("lags", [5, 25])
def test_the_whiteness_test_agrees_with_ljung_and_box(lags: int) -> None:
    rng = np.random.default_rng(9)
    seen = set()
    for share in np.linspace(0.0, 0.3, 31):
        errors = autoregressive(rng, 400, float(share))
        rho = autocorrelation(errors, lags)[1:]
        statistic = 400 * 402 * sum(rho[k - 1] ** 2 / (400 - k) for k in range(1, lags + 1))
        expected = chi2.sf(statistic, lags) > 1e-3
        assert is_white(errors, lags) == expected
        seen.add(expected)
    assert seen == {True, False}


def test_coloured_noise_is_not_white_and_too_few_residuals_count_as_white() -> None:
    rng = np.random.default_rng(10)
    assert not any(is_white(autoregressive(rng, 500, 0.4)) for _ in range(50))
    assert is_white(np.array([1.0, -1.0, 2.0]))


def test_the_autocorrelation_agrees_with_numpy() -> None:
    errors = autoregressive(np.random.default_rng(11), 300, 0.5) + 3.0
    centred = errors - errors.mean()
    whole = np.correlate(centred, centred, "full")[299:]
    assert autocorrelation(errors, 30) == pytest.approx(whole[:31] / whole[0])


def test_the_crosscorrelation_agrees_with_numpy() -> None:
    rng = np.random.default_rng(12)
    errors, inputs = rng.standard_normal(300), rng.standard_normal(300) + 5.0
    e, u = errors - errors.mean(), inputs - inputs.mean()
    whole = np.correlate(e, u, "full") / math.sqrt(float(e @ e) * float(u @ u))
    assert crosscorrelation(errors, inputs, 20) == pytest.approx(whole[279:320])
    # An error that follows the input shows at a positive lag.
    assert int(np.argmax(crosscorrelation(np.roll(inputs, 3), inputs, 10))) - 10 == 3


def test_correlations_of_constant_signals_and_beyond_the_last_sample_are_zero() -> None:
    assert np.all(autocorrelation(np.zeros(5)) == 0.0)
    assert np.all(crosscorrelation(np.ones(50), np.arange(50.0)) == 0.0)
    short = autocorrelation(np.array([1.0, -1.0]), 5)
    assert short == pytest.approx([1.0, -0.5, 0.0, 0.0, 0.0, 0.0])
    assert len(crosscorrelation(np.array([1.0, -1.0]), np.array([1.0, -1.0]), 5)) == 11


def test_fpe_aic_and_bic_agree_with_their_textbook_formulas() -> None:
    # Two outputs, 100 sample times, 4 unknowns.
    loss, rows, samples, unknowns = 0.02, 100, 200, 4
    deviance = rows * math.log(loss)
    found = criteria(loss, deviance, samples, rows, unknowns)
    likelihood = -0.5 * (deviance + samples * (math.log(2.0 * math.pi) + 1.0))
    assert found.fpe == pytest.approx(loss * (1.0 + 0.04) / (1.0 - 0.04))
    assert found.aic == pytest.approx(-2.0 * likelihood + 8.0)
    assert found.aicc == pytest.approx(found.aic + 2.0 * 4.0 * 5.0 / 95.0)
    assert found.bic == pytest.approx(-2.0 * likelihood + 4.0 * math.log(100.0))
    many = criteria(1.0, 0.0, 3, 3, 3)  # more unknowns than samples
    assert math.isnan(many.fpe)
    assert math.isnan(many.aicc)


def test_the_fit_is_100_for_the_data_themselves_and_0_for_their_mean() -> None:
    values = np.array([1.0, 2.0, 3.0, 6.0])
    assert fit_percent(values, values) == 100.0
    assert fit_percent(values, np.full(4, 3.0)) == pytest.approx(0.0)
    half = 3.0 + 0.5 * (values - 3.0)
    assert fit_percent(values, half) == pytest.approx(50.0)
    assert fit_percent(values, 3.0 - (values - 3.0)) == pytest.approx(-100.0)
    assert math.isnan(fit_percent(np.ones(3), values[:3]))


def test_correlations_with_an_infinite_variance_are_nan() -> None:
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.inf]])
    found = correlation_of(covariance)
    assert found[:2, :2] == pytest.approx(np.array([[1.0, 0.5], [0.5, 1.0]]))
    assert np.all(np.isnan(found[2]))


def test_samples_rounded_to_one_level_count_as_one_error() -> None:
    step = 0.1
    ramp = np.linspace(0.0, 1.0, 1100)
    rounded = np.round(ramp / step) * step
    slopes = np.ones((1100, 1, 1))
    found = rounding_information(rounded[:, None], slopes, np.eye(1))
    lengths = np.array([55.0, *[110.0] * 9, 55.0])
    assert found[0, 0] == pytest.approx(step**2 / 12.0 * np.sum(lengths**2), rel=0.02)


def test_data_without_rounding_or_rests_add_no_rounding_error() -> None:
    rng = np.random.default_rng(3)
    slopes = np.ones((500, 2, 1))
    noise = rng.standard_normal((500, 2))
    assert np.all(rounding_information(noise, slopes, np.eye(2)) == 0.0)
    restless = np.round(5.0 * noise)
    assert np.all(rounding_information(restless, slopes, np.eye(2)) == 0.0)


def test_a_finely_rounded_output_has_a_rounding_error_only_where_it_rests() -> None:
    # An angle in 0.01 degrees: another one at each sample of the travel, the same at the end stop.
    angle = np.round(np.concatenate([np.linspace(0.0, 90.0, 700), np.full(300, 90.004)]), 2)
    slopes = np.ones((1000, 1, 1))
    found = rounding_information(angle[:, None], slopes, np.eye(1))
    assert found[0, 0] == pytest.approx(1e-4 / 12.0 * 301.0**2, rel=0.02)


def test_the_robust_covariance_agrees_with_bartletts_sum_over_lags() -> None:
    rng = np.random.default_rng(3)
    scores = np.column_stack([autoregressive(rng, 500, share) for share in (0.9, 0.5)])
    inverse = np.array([[0.02, 0.003], [0.003, 0.01]])
    own_inverse_std = np.array([0.5, 0.0])
    found = robust_covariance([scores], inverse, own_inverse_std)
    sums = [scores[lag:].T @ scores[: len(scores) - lag] for lag in range(200)]

    def by_lags(width: int) -> np.ndarray:
        total = np.diag(own_inverse_std**2) + sums[0]
        for lag in range(1, width + 1):
            total = total + (1.0 - lag / (width + 1.0)) * (sums[lag] + sums[lag].T)
        return inverse @ total @ inverse

    assert any(np.allclose(found, by_lags(width), rtol=1e-9, atol=0.0) for width in range(5, 100))
