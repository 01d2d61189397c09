"""Results of an identification and of a validation.

Parameters are in the units of the vehicle file, initial states in rad, rad/s, rev, rev/s, K and s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """The estimate of one parameter or initial state."""

    name: str  # as in the vehicle file: "motor.resistance"
    symbol: str
    unit: str
    value: float
    std: float  # inf: not identifiable
    initial: float
    low: float  # bounds of the search
    high: float
    identifiable: bool
    remark: str = ""  # why not identifiable, or at a bound
    is_at_bound: bool = False  # of the search
    is_held: bool = False  # by a bound that was given, narrower than the range of the quantity

    @property
    def shown_std(self) -> float:
        """The standard deviation, for people; NaN at a bound of the search, where it means nothing."""
        return math.nan if self.is_at_bound else self.std


@dataclass(frozen=True)
class Series:
    """Output of an experiment, measured and simulated."""

    output: str  # column name with its unit: "left_current_a"
    times: Floats  # (n,) s, only where there is a sample
    measured: Floats  # (n,)
    simulated: Floats  # (n,), of the final model
    before: Floats  # (n,), of the initial model; empty in a validation
    fit_percent: float  # NRMSE fit: 100 (1 - |y - ys| / |y - mean y|)
    fit_before: float  # nan in a validation
    mean: float  # mean error: measured less simulated
    mean_std: float  # its standard deviation, as the errors scatter about it
    rms: float
    maximum: float  # largest absolute error
    phases: Mapping[str, tuple[float, float, int]]  # phase: rms, largest error, samples
    autocorrelation: Floats  # (lags + 1,) of the residual, 1 at lag 0
    crosscorrelation: Floats  # (2 lags + 1,) with the input, lags -n..n
    band: float  # 99 % band of both, for white residuals independent of the input
    is_white: bool
    # Why a residual that is not white does not contradict the model: "rounding" of the measured values, which
    # causes as much; "slopes" over intervals that overlap. Otherwise empty.
    excuse: str = ""


@dataclass(frozen=True)
class Experiment:
    """Measurement and its simulation by the identified model."""

    name: str
    times: Floats  # (m,) s, timestamps of the samples; inputs are held from each
    voltage: Floats  # (m,) V, motor voltage of the left drive
    series: tuple[Series, ...]


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one parameter."""

    name: str
    values: Floats
    # 2 (log L_max - log L_profile) over the ratio of the robust to the white variance; 3.84 is the 95 % limit.
    deviance: Floats
    low: float  # 95 % interval; nan where the range shown doesn't reach it
    high: float
    ends: tuple[str, str] = ("", "")  # why the range ends, below and above; "": after 3 standard deviations


@dataclass(frozen=True)
class FixedParameter:
    """A parameter of the vehicle that is not estimated, and what depends on its value, by linear theory."""

    name: str
    value: float
    unit: str
    shifts: Floats  # (p,) change of each estimate, in its unit, if the value were 10 % larger
    is_seen: bool  # whether the residuals would then show it
    change: float  # share by which another value would fit best; nan: the estimates take up any value
    explains: float  # share of the weighted squared errors that this would explain


@dataclass(frozen=True)
class Identification:
    """The whole result of an identification."""

    model: str  # full, third-order, second-order
    vehicle: str
    outputs: tuple[str, ...]  # names of the outputs, in the order of noise_variance
    parameters: tuple[Estimate, ...]
    initial_states: tuple[Estimate, ...]
    covariance: Floats  # (p, p) of the parameters
    correlation: Floats  # (p, p)
    noise_variance: Floats  # (outputs, outputs)
    loss: float  # det of the noise variance (of its diagonal, where the outputs are not sampled together)
    loss_initial: float
    fpe: float
    aic: float
    aicc: float
    bic: float
    condition_number: float
    inseparable: tuple[str, ...]  # sentences: parameters that cannot be separated
    stop_reason: str
    iterations: int
    evaluations: int
    seconds: float
    covariance_kind: str  # a sentence: what the covariance takes into account
    history: Floats  # (iterations + 1,), loss after each iteration, the initial loss first
    experiments: tuple[Experiment, ...]
    profiles: tuple[Profile, ...] = ()
    fixed: tuple[FixedParameter, ...] = ()
    input_jitter: float = 0.0  # s, standard deviation of the inputs' timestamps about the time of their effect
    data_warnings: tuple[str, ...] = ()  # what in the data limits the result
    notes: tuple[str, ...] = field(default_factory=tuple)  # what was done to the data


@dataclass(frozen=True)
class Validation:
    """The result of a comparison of a model with measurements."""

    model: str
    vehicle: str
    experiments: tuple[Experiment, ...]
    initial_states: tuple[Estimate, ...] = ()
    notes: tuple[str, ...] = ()
    data_warnings: tuple[str, ...] = ()
