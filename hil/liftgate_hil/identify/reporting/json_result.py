"""Results as JSON for programs; the keys are public, and a number that is not finite is null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.identify.reporting.findings import (
    columns_of,
    mean_over,
    series_of,
    validation_warnings,
    warnings_of,
    whiteness,
)
from liftgate_hil.identify.result import Estimate, Experiment, Identification, Series, Validation
from liftgate_hil.report.files import write_report
from liftgate_hil.report.numbers import relative_error


def identification_json(result: Identification) -> dict[str, Any]:
    """Return everything about an identification except the time series."""
    parameters = result.parameters
    return {
        "model": result.model,
        "vehicle": result.vehicle,
        "parameters": {each.name: _estimate(each) for each in parameters},
        "identifiable": {each.name: bool(each.identifiable) for each in parameters},
        "inseparable": list(result.inseparable),
        "initial_states": _states(result),
        "parameter_names": [each.name for each in parameters],
        "covariance": _numbers(result.covariance),
        "covariance_kind": result.covariance_kind,
        "input_jitter": _number(result.input_jitter),
        "correlation": _numbers(result.correlation),
        "noise_variance": _numbers(result.noise_variance),
        "noise_outputs": list(result.outputs),
        "fit_percent": _map(mean_over(result.experiments, lambda each: each.fit_percent)),
        "fit_percent_initial": _map(mean_over(result.experiments, lambda each: each.fit_before)),
        "loss": _number(result.loss),
        "loss_initial": _number(result.loss_initial),
        "loss_history": _numbers(result.history),
        "fpe": _number(result.fpe),
        "aic": _number(result.aic),
        "aicc": _number(result.aicc),
        "bic": _number(result.bic),
        "condition_number": _number(result.condition_number),
        "stop_reason": result.stop_reason,
        "iterations": int(result.iterations),
        "evaluations": int(result.evaluations),
        "seconds": _number(result.seconds),
        "fixed_parameters": {
            each.name: {
                "value": _number(each.value),
                "unit": each.unit,
                "shifts": _map({one.name: float(by) for one, by in zip(parameters, each.shifts, strict=True)}),
                "is_seen": each.is_seen,
                "change": _number(each.change),
                "explains": _number(each.explains),
            }
            for each in result.fixed
        },
        "profiles": {
            each.name: {
                "values": _numbers(each.values),
                "deviance": _numbers(each.deviance),
                "low": _number(each.low),
                "high": _number(each.high),
            }
            for each in result.profiles
        },
        "experiments": [_experiment(each, before=True) for each in result.experiments],
        "warnings": warnings_of(result),
        "notes": list(result.notes),
    }


def validation_json(result: Validation) -> dict[str, Any]:
    """Return each statistic over all experiments by column, then for each experiment."""
    experiments = result.experiments
    columns = {each: series_of(experiments, each) for each in columns_of(experiments)}
    return {
        "model": result.model,
        "vehicle": result.vehicle,
        "fit_percent": _map(mean_over(experiments, lambda each: each.fit_percent)),
        "mean": {name: _number(_mean(rows)) for name, rows in columns.items()},
        "rms": {
            name: _number(_rms([(each.rms, len(each.times)) for each in rows])) for name, rows in columns.items()
        },
        "maximum": {name: _largest([each.maximum for each in rows]) for name, rows in columns.items()},
        "phases": {name: _pooled(rows) for name, rows in columns.items()},
        "initial_states": _states(result),
        "whiteness": {name: all(each.is_white for each in rows) for name, rows in columns.items()},
        "experiments": [_experiment(each, before=False) for each in experiments],
        "warnings": validation_warnings(result),
        "notes": list(result.notes),
    }


def write_json(path: str, flag: str, content: Mapping[str, Any], say: Say = silent) -> None:
    """Write the content as JSON, as `write_report` does; raise ConfigError where that fails."""
    write_report(path, flag, json.dumps(content, indent=2, allow_nan=False) + "\n", say)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: ArrayLike) -> list[Any]:
    """Return an array as nested lists."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1:
        return [_numbers(row) for row in array]
    return [_number(value) for value in array.tolist()]


def _map(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in values.items()}


def _estimate(each: Estimate) -> dict[str, Any]:
    return {
        "value": _number(each.value),
        "std": _number(each.std),
        "initial": _number(each.initial),
        "unit": each.unit,
        "symbol": each.symbol,
        "low": _number(each.low),
        "high": _number(each.high),
        "relative_error": _number(relative_error(each.value, each.std) / 100.0),
        "is_at_bound": each.is_at_bound,
        "is_held": each.is_held,
        "remark": each.remark,
    }


def _states(result: Identification | Validation) -> dict[str, Any]:
    return {
        each.name: {**_estimate(each), "identifiable": bool(each.identifiable)} for each in result.initial_states
    }


def _experiment(experiment: Experiment, *, before: bool) -> dict[str, Any]:
    return {
        "name": experiment.name,
        "fit_percent": {each.output: _number(each.fit_percent) for each in experiment.series},
        **(
            {"fit_percent_initial": {each.output: _number(each.fit_before) for each in experiment.series}}
            if before
            else {}
        ),
        "mean": {each.output: _number(each.mean) for each in experiment.series},
        "mean_std": {each.output: _number(each.mean_std) for each in experiment.series},
        "rms": {each.output: _number(each.rms) for each in experiment.series},
        "maximum": {each.output: _number(each.maximum) for each in experiment.series},
        "samples": {each.output: len(each.times) for each in experiment.series},
        "phases": {each.output: _pooled([each]) for each in experiment.series},
        "whiteness": {each.output: _whiteness(each) for each in experiment.series},
    }


def _whiteness(series: Series) -> dict[str, Any]:
    counts = whiteness(series)
    return {
        "is_white": bool(series.is_white),
        "excuse": series.excuse,
        "band": _number(series.band),
        "autocorrelation": _numbers(series.autocorrelation),
        "crosscorrelation": _numbers(series.crosscorrelation),
        "lags_outside": counts.own,
        "input_lags_outside": counts.input,
    }


def _mean(rows: Sequence[Series]) -> float:
    """Return the mean error over the samples of all experiments."""
    samples = sum(len(each.times) for each in rows)
    return sum(len(each.times) * each.mean for each in rows) / samples if samples else math.nan


def _rms(parts: Sequence[tuple[float, int]]) -> float:
    """Return the root mean square of all parts (rms, samples) together."""
    samples = sum(count for _, count in parts)
    if not samples:
        return math.nan
    return math.sqrt(sum(count * rms**2 for rms, count in parts if count) / samples)


def _largest(values: Sequence[float]) -> float | None:
    """Return the largest value; None where one of them is not finite."""
    return _number(float(np.max(values)))


def _pooled(rows: Sequence[Series]) -> dict[str, Any]:
    """Return the errors by phase of one output, pooled over experiments."""
    names = dict.fromkeys(name for each in rows for name in each.phases)
    pooled = {}
    for name in names:
        parts = [each.phases[name] for each in rows if name in each.phases]
        pooled[name] = {
            "rms": _number(_rms([(rms, samples) for rms, _, samples in parts])),
            "maximum": _largest([largest for _, largest, _ in parts]),
            "samples": sum(int(samples) for _, _, samples in parts),
        }
    return pooled
