"""Results of an identification and of a validation.

Parameters are in the units of the vehicle file, initial states in rad, rad/s, rev, rev/s, K and s.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeVar

import numpy as np

from liftgate_hil.described_result import Column, DescribedResult, Shown
from liftgate_hil.identification.data import Floats
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.numbers import (
    deviation,
    fit,
    known_digits,
    percent,
    plain,
    relative_change,
    relative_error,
    significant,
)

Figure = TypeVar("Figure")

RMS = Column("rms", lambda own: significant(own.rms, 3))
LARGEST = Column("largest", lambda own: significant(own.maximum, 3))

# fmt: off
# A field with its description is a row of a table.


@dataclass(frozen=True)
class Estimate(DescribedResult):
    """Estimate of one parameter or initial state."""

    name: Annotated[str, Column("parameter", lambda own: own.name, "name", 30)]  # as in the vehicle file
    symbol: Annotated[str, Shown("symbol in the equations"), Column("", lambda own: own.symbol, "soft")]
    unit: Annotated[str, Shown("unit of these values; empty: none"), Column("unit", lambda own: own.unit, "n", 12)]
    value: Annotated[float, Shown("the estimate, in `unit`; null: not a finite number"),
        Column("value", lambda own: known_digits(own.value, own.shown_std))]
    std: Annotated[float, Shown("standard deviation, in `unit`; null: not identifiable"),  # inf
        Column("std", lambda own: deviation(own.shown_std))]
    initial: Annotated[float, Shown("value at the start of the search, in `unit`"),
        Column("initial", lambda own: plain(own.initial))]
    low: Annotated[float, Shown("lower bound of the search, in `unit`; null: none")]
    high: Annotated[float, Shown("upper bound of the search, in `unit`; null: none")]
    identifiable: Annotated[bool, Shown("whether it is identifiable"),
        Column("identifiable", lambda own: "yes" if own.identifiable else "NO", "")]
    remark: Annotated[str, Shown("why it is not identifiable, or at a bound; else empty"),
        Column("", lambda own: own.remark, "soft")] = ""
    is_at_bound: Annotated[bool, Shown("whether it is at a bound of the search, where `std` means "
        "nothing")] = False
    is_held: Annotated[bool, Shown("whether that bound was given, e.g. by `--bounds`: the others are estimated "
        "with that value")] = False

    @property
    def shown_std(self) -> float:
        """Standard deviation to be displayed; NaN at a bound of the search, where it has no meaning."""
        return math.nan if self.is_at_bound else self.std

    @property
    def relative_error(self) -> Annotated[float, Shown("`std` divided by the size of `value`: 0.01 is 1 %; null: "
            "unknown"), Column("std %", lambda own: percent(relative_error(own.value, own.shown_std)))]:
        """Standard deviation relative to the value; NaN: unknown."""
        return relative_error(self.value, self.std) / 100.0

    @property
    def change_percent(self) -> Annotated[float, Column("change %", lambda own: percent(own.change_percent, "+"))]:
        """Change of the value from the start of the search, in per cent of the initial value."""
        return relative_change(self.value, self.initial)


class PhaseErrors(NamedTuple):
    """Errors of an output in one phase of the motion."""

    rms: Annotated[float, Shown("root mean square of the errors, in the column's unit"), RMS]
    maximum: Annotated[float, Shown("largest error, in the column's unit"), LARGEST]
    samples: Annotated[int, Shown("number of samples"), Column("samples", lambda own: str(own.samples))]


@dataclass(frozen=True)
class Series(DescribedResult):
    """Output of an experiment, measured and simulated."""

    output: str  # column name with its unit: "left_current_a"
    times: Floats  # (n,) s, only where there is a sample
    measured: Floats  # (n,)
    simulated: Floats  # (n,), of the final model
    before: Floats  # (n,), of the initial model; empty in a validation
    fit_percent: Annotated[float, Column("fit %", lambda own: fit(own.fit_percent))]  # NRMSE fit
    fit_before: Annotated[float, Column("before %", lambda own: fit(own.fit_before))]  # nan in a validation
    mean: Annotated[float, Column("mean", lambda own: significant(own.mean, 2))]  # error: measured less simulated
    mean_std: float  # its standard deviation, as the errors scatter about it
    rms: Annotated[float, RMS]
    maximum: Annotated[float, LARGEST]  # absolute error
    phases: Mapping[str, PhaseErrors]
    autocorrelation: Annotated[Floats, Shown("list: autocorrelation of the residual by lag, 1 at lag 0")]
    crosscorrelation: Annotated[Floats, Shown("list: correlation with the input, lags -n to n")]
    band: Annotated[float, Shown("99 % band of both correlations")]  # for white residuals independent of the input
    is_white: Annotated[bool, Shown("whether the residual is white")]
    # "rounding" of the measured values causes as much; "slopes" are over intervals that overlap.
    excuse: Annotated[str, Shown("why a residual that is not white does not contradict the model: `rounding`, "
        "`slopes`; else empty")] = ""

    @property
    def lags_outside(self) -> Annotated[int, Shown("lags at which the autocorrelation is outside the band")]:
        """Number of lags but 0 with the autocorrelation outside the band; about 1 in 100 is so by chance."""
        return int(np.sum(np.nan_to_num(np.abs(self.autocorrelation[1:])) > self.band))

    @property
    def input_lags_outside(self) -> Annotated[int, Shown("lags at which the correlation with the input is outside "
            "the band")]:
        """Number of lags of the correlation with the input outside the band."""
        return int(np.sum(np.abs(self.crosscorrelation) > self.band))


@dataclass(frozen=True)
class Experiment(DescribedResult):
    """Measurement and its simulation by the identified model."""

    name: Annotated[str, Shown("name of the experiment")]
    times: Floats  # (m,) s, timestamps of the samples; inputs are held from each
    voltage: Floats  # (m,) V, motor voltage of the left drive
    series: tuple[Series, ...]

    @property
    def fit_percent(self) -> Annotated[Mapping[str, float], Shown("NRMSE fit: 100 (1 - |y - ŷ| / |y - mean of "
            "y|), by output", keys={"COLUMN": "fit [%]; null: not defined"})]:
        """NRMSE fit by output [%]."""
        return {each.output: each.fit_percent for each in self.series}

    @property
    def fit_percent_initial(self) -> Annotated[Mapping[str, float], Shown("the same with the initial values; of a "
            "validation each is null", keys={"COLUMN": "fit [%]; null: not defined"})]:
        """NRMSE fit of the initial model by output [%]; NaN in a validation."""
        return {each.output: each.fit_before for each in self.series}

    @property
    def mean(self) -> Annotated[Mapping[str, float], Shown("mean error, measured less simulated, by output", keys={
            "COLUMN": "in the column's unit"})]:
        """Mean error, measured minus simulated, by output."""
        return {each.output: each.mean for each in self.series}

    @property
    def mean_std(self) -> Annotated[Mapping[str, float], Shown("standard deviation of the mean error, by output",
            keys={"COLUMN": "in the column's unit"})]:
        """Standard deviation of the mean error by output."""
        return {each.output: each.mean_std for each in self.series}

    @property
    def rms(self) -> Annotated[Mapping[str, float], Shown("root mean square of the errors, by output", keys={
            "COLUMN": "in the column's unit"})]:
        """Root mean square of the errors by output."""
        return {each.output: each.rms for each in self.series}

    @property
    def maximum(self) -> Annotated[Mapping[str, float], Shown("largest error, by output", keys={"COLUMN": "in the "
            "column's unit"})]:
        """Largest absolute error by output."""
        return {each.output: each.maximum for each in self.series}

    @property
    def samples(self) -> Annotated[Mapping[str, int], Shown("number of samples, by output", keys={
            "COLUMN": "number of samples"})]:
        """Number of samples by output."""
        return {each.output: len(each.times) for each in self.series}

    @property
    def phases(self) -> Annotated[Mapping[str, Mapping[str, PhaseErrors]], Shown("errors by phase of the motion, "
            "by output", keys={"COLUMN": "phases of an output", "PHASE": "errors in a phase"})]:
        """Errors by output and phase."""
        return {each.output: each.phases for each in self.series}

    @property
    def whiteness(self) -> Annotated[Mapping[str, Series], Shown("whether the residuals are noise, by output",
            keys={"COLUMN": "residual of an output"})]:
        """Series of measured and simulated samples with residual tests, by output."""
        return {each.output: each for each in self.series}


@dataclass(frozen=True)
class LikelihoodProfile(DescribedResult):
    """Profile likelihood of one parameter."""

    name: str
    values: Annotated[Floats, Shown("list: values of the parameter")]
    # 2 (log L_max - log L_profile) over the ratio of the robust to the white variance
    deviance: Annotated[Floats, Shown("list: twice the drop of the log-likelihood there, divided by the ratio of "
        "the robust to the white variance; 3.84 is the 95 % limit")]
    low: Annotated[float, Shown("begin of the 95 % interval; null: the profile does not reach it")]
    high: Annotated[float, Shown("end of the 95 % interval; null: the profile does not reach it")]
    ends: tuple[str, str] = ("", "")  # why the range ends, below and above; "": after 3 standard deviations


@dataclass(frozen=True)
class FixedParameter(DescribedResult):
    """Parameter of the vehicle that is not estimated, and its effect on the estimates, by linear theory."""

    name: str
    value: Annotated[float, Shown("its value")]
    unit: Annotated[str, Shown("unit of the value")]
    shifts: Annotated[Mapping[str, float], Shown("change of each estimate if the value were 10 % larger, by "
        "linear theory; where `is_seen`, it holds for small changes only", keys={"NAME": "change in the "
        "estimate's unit"})]
    is_seen: Annotated[bool, Shown("whether the residuals would then show it")]
    change: Annotated[float, Shown("relative change of the value with the best fit; null: estimates take up any "
        "value")]
    explains: Annotated[float, Shown("share of the weighted squared errors that this would explain")]


@dataclass(frozen=True, kw_only=True)
class ModelResult(DescribedResult):
    """Base class of the results of an identification and of a validation: a model and its measurements."""

    model: Annotated[str, Shown("`full`, `third-order` or `second-order`")]
    vehicle: Annotated[str, Shown("name of the vehicle")]
    experiments: Annotated[tuple[Experiment, ...], Shown("the measurements, see Experiment")]
    initial_states: Annotated[tuple[Estimate, ...], Shown("estimated initial states", by="name", keys={
        "NAME": "an initial state of an experiment"})]
    warnings: Annotated[tuple[str, ...], Shown("sentences: what limits the use of the result, the worst "
        "first")] = ()
    notes: Annotated[tuple[str, ...], Shown("sentences: what was done to the data")] = ()
    provenance: Annotated[Provenance | None, Shown("see Provenance")] = None
    data_warnings: tuple[str, ...] = ()  # what in the data limits the result

    @property
    def fit_percent(self) -> Annotated[Mapping[str, float], Shown("NRMSE fit, mean over the experiments, by "
            "output", keys={"COLUMN": "fit [%]; null: not defined"})]:
        """NRMSE fit by output [%], mean over the experiments; NaN: not defined."""
        return mean_over(self.experiments, lambda each: each.fit_percent)


@dataclass(frozen=True, kw_only=True)
class Validation(ModelResult):
    """The result of a comparison of a model with measurements; each statistic over all experiments by output."""

    @property
    def mean(self) -> Annotated[Mapping[str, float], Shown("mean error, measured less simulated, by output", keys={
            "COLUMN": "in the column's unit"})]:
        """Mean error, measured minus simulated, over the samples of all experiments by output."""
        return _over_all(self.experiments, _mean)

    @property
    def rms(self) -> Annotated[Mapping[str, float], Shown("root mean square of the errors, by output", keys={
            "COLUMN": "in the column's unit"})]:
        """Root mean square of the errors over the samples of all experiments by output."""
        return _over_all(self.experiments, lambda rows: _rms([(each.rms, len(each.times)) for each in rows]))

    @property
    def maximum(self) -> Annotated[Mapping[str, float], Shown("largest error, by output", keys={"COLUMN": "in the "
            "column's unit; null: unknown"})]:
        """Largest absolute error by output; NaN where that of any experiment is."""
        return _over_all(self.experiments, lambda rows: float(np.max([each.maximum for each in rows])))

    @property
    def phases(self) -> Annotated[Mapping[str, Mapping[str, PhaseErrors]], Shown("errors by phase of the motion, "
            "by output", keys={"COLUMN": "phases of an output", "PHASE": "errors in a phase"})]:
        """Errors by output and phase, over all experiments."""
        return _over_all(self.experiments, _pooled)

    @property
    def whiteness(self) -> Annotated[Mapping[str, bool], Shown("whether the residuals of all experiments are "
            "white, by output", keys={"COLUMN": "true: white"})]:
        """Whether the residuals of all experiments are white, by output."""
        return _over_all(self.experiments, lambda rows: all(each.is_white for each in rows))


@dataclass(frozen=True, kw_only=True)
class Identification(ModelResult):
    """The result of an identification. Values are in the units of the vehicle file."""

    outputs: Annotated[tuple[str, ...], Shown("names of the output columns", key="noise_outputs")]
    parameters: Annotated[tuple[Estimate, ...], Shown("the estimated parameters", by="name", keys={"NAME": "a "
        "parameter by its key in the vehicle file, e.g. `motor.resistance`"})]
    covariance: Annotated[Floats, Shown("covariance of the parameters, matrix as rows, in products of their "
        "units; null: not finite")]  # (p, p)
    correlation: Annotated[Floats, Shown("correlation matrix of the parameters, as rows")]  # (p, p)
    noise_variance: Annotated[Floats, Shown("covariance matrix of the outputs' noise, as rows, in the order of "
        "`noise_outputs`")]  # (outputs, outputs)
    # of its diagonal, where the outputs are not sampled together
    loss: Annotated[float, Shown("determinant of the noise variance, which is minimised")]
    loss_initial: Annotated[float, Shown("the same with the initial values")]
    fpe: Annotated[float, Shown("final prediction error (Akaike)")]
    aic: Annotated[float, Shown("Akaike information criterion")]
    aicc: Annotated[float, Shown("the same with the correction for few samples")]
    bic: Annotated[float, Shown("Bayesian information criterion")]
    condition_number: Annotated[float, Shown("condition number of the information matrix")]
    inseparable: Annotated[tuple[str, ...], Shown("sentences: parameters that cannot be separated from each "
        "other")]
    stop_reason: Annotated[str, Shown("why the search ended, in words")]
    iterations: Annotated[int, Shown("iterations of the search")]
    evaluations: Annotated[int, Shown("evaluations of the loss")]
    seconds: Annotated[float, Shown("elapsed time [s]")]
    covariance_kind: Annotated[str, Shown("a sentence: what the covariance takes into account")]
    history: Annotated[Floats, Shown("list: the loss after each iteration, the initial one first",
        key="loss_history")]  # (iterations + 1,)
    profiles: Annotated[tuple[LikelihoodProfile, ...], Shown("profile likelihoods; empty without `--profile`",
        by="name", keys={"NAME": "profile of a parameter"})] = ()
    fixed: Annotated[tuple[FixedParameter, ...], Shown("parameters that are not estimated and have an effect, by "
        "linear theory", key="fixed_parameters", by="name", keys={"NAME": "fixed parameter"})] = ()
    input_jitter: Annotated[float, Shown("standard deviation of the inputs' time stamps about the time of their "
        "effect [s]")] = 0.0

    @property
    def parameter_names(self) -> Annotated[tuple[str, ...], Shown("names of the parameters in the order of the "
            "matrices")]:
        """Names of the parameters."""
        return tuple(each.name for each in self.parameters)

    @property
    def identifiable(self) -> Annotated[Mapping[str, bool], Shown("which parameters are identifiable", keys={
            "NAME": "true: identifiable"})]:
        """Whether each parameter is identifiable, by its name."""
        return {each.name: each.identifiable for each in self.parameters}

    @property
    def fit_percent_initial(self) -> Annotated[Mapping[str, float], Shown("the same with the initial values",
            keys={"COLUMN": "fit [%]; null: not defined"})]:
        """NRMSE fit of the initial model by output [%], mean over the experiments; NaN: not defined."""
        return mean_over(self.experiments, lambda each: each.fit_before)


# fmt: on
def columns_of(experiments: Sequence[Experiment]) -> list[str]:
    """Return the names of all experiments' outputs, each once, in order of appearance."""
    return list(dict.fromkeys(each.output for one in experiments for each in one.series))


def series_of(experiments: Sequence[Experiment], column: str) -> list[Series]:
    """Return the series of one output from all experiments that have it."""
    return [each for one in experiments for each in one.series if each.output == column]


def mean_over(experiments: Sequence[Experiment], figure: Callable[[Series], float]) -> dict[str, float]:
    """Return by output the mean over experiments of `figure`, a function of a series; NaN does not count."""
    means = {}
    for column in columns_of(experiments):
        values = [figure(each) for each in series_of(experiments, column)]
        known = [value for value in values if not math.isnan(value)]
        means[column] = sum(known) / len(known) if known else math.nan
    return means


def _over_all(
    experiments: Sequence[Experiment], figure: Callable[[Sequence[Series]], Figure]
) -> dict[str, Figure]:
    """Return by output the value of `figure`, a function of the output's series from all experiments."""
    return {each: figure(series_of(experiments, each)) for each in columns_of(experiments)}


def _mean(rows: Sequence[Series]) -> float:
    """Return the mean error, measured minus simulated, over the samples of all experiments."""
    samples = sum(len(each.times) for each in rows)
    return sum(len(each.times) * each.mean for each in rows) / samples if samples else math.nan


def _rms(parts: Sequence[tuple[float, int]]) -> float:
    """Return the root mean square of several series together, from (rms, number of samples) of each."""
    samples = sum(count for _, count in parts)
    if not samples:
        return math.nan
    return math.sqrt(sum(count * rms**2 for rms, count in parts if count) / samples)


def _pooled(rows: Sequence[Series]) -> dict[str, PhaseErrors]:
    """Return the errors by phase of one output, pooled over experiments."""
    pooled = {}
    for name in dict.fromkeys(name for each in rows for name in each.phases):
        parts = [each.phases[name] for each in rows if name in each.phases]
        pooled[name] = PhaseErrors(
            _rms([(rms, samples) for rms, _, samples in parts]),
            float(np.max([each.maximum for each in parts])),
            sum(each.samples for each in parts),
        )
    return pooled
