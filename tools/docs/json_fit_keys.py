"""Keys of the JSON of `identify`, of its plan, and of `validate`."""

from __future__ import annotations

from tools.docs.json_keys import PROVENANCE, Document, Shared

_ESTIMATE = {
    "value": "the estimate, in `unit`; null: not a finite number",
    "std": "standard deviation, in `unit`; null: not identifiable",
    "initial": "value at the start of the search, in `unit`",
    "unit": "unit of these values; empty: none",
    "symbol": "symbol in the equations",
    "low": "lower bound of the search, in `unit`; null: none",
    "high": "upper bound of the search, in `unit`; null: none",
    "relative_error": "`std` divided by the size of `value`: 0.01 is 1 %; null: unknown",
    "is_at_bound": "whether it is at a bound of the search, where `std` means nothing",
    "is_held": "whether that bound was given, e.g. by `--bounds`: the others are estimated with that value",
    "remark": "why it is not identifiable, or at a bound; else empty",
}
_PHASE = {
    "rms": "root mean square of the errors, in the column's unit",
    "maximum": "largest error, in the column's unit",
    "samples": "number of samples",
}


def _experiment(before: bool) -> dict[str, str]:
    """Return the keys of an experiment; `before`: with the fit before the search."""
    fit_before = {
        "fit_percent_initial": "the same with the initial values, by output",
        "fit_percent_initial.COLUMN": "fit [%]",
    }
    return {
        "name": "name of the experiment",
        "fit_percent": "NRMSE fit: 100 (1 - |y - ŷ| / |y - mean of y|), by output",
        "fit_percent.COLUMN": "fit [%]; null: not defined",
        **(fit_before if before else {}),
        "mean": "mean error, measured less simulated, by output",
        "mean.COLUMN": "in the column's unit",
        "mean_std": "standard deviation of the mean error, by output",
        "mean_std.COLUMN": "in the column's unit",
        "rms": "root mean square of the errors, by output",
        "rms.COLUMN": "in the column's unit",
        "maximum": "largest error, by output",
        "maximum.COLUMN": "in the column's unit",
        "samples": "number of samples, by output",
        "samples.COLUMN": "number of samples",
        "phases": "errors by phase of the motion, by output",
        "phases.COLUMN": "phases of an output",
        "phases.COLUMN.PHASE": "errors in a phase",
        **{f"phases.COLUMN.PHASE.{name}": meaning for name, meaning in _PHASE.items()},
        "whiteness": "whether the residuals are noise, by output",
        "whiteness.COLUMN": "residual of an output",
        "whiteness.COLUMN.is_white": "whether the residual is white",
        "whiteness.COLUMN.excuse": "why a residual that is not white does not contradict the model: `rounding`, "
        "`slopes`; else empty",
        "whiteness.COLUMN.band": "99 % band of both correlations",
        "whiteness.COLUMN.autocorrelation": "list: autocorrelation of the residual by lag, 1 at lag 0",
        "whiteness.COLUMN.crosscorrelation": "list: correlation with the input, lags -n to n",
        "whiteness.COLUMN.lags_outside": "lags at which the autocorrelation is outside the band",
        "whiteness.COLUMN.input_lags_outside": "lags at which the correlation with the input is outside the band",
    }


_STATES = {
    "initial_states": "estimated initial states",
    "initial_states.NAME": "an initial state of an experiment",
    **{f"initial_states.NAME.{name}": meaning for name, meaning in _ESTIMATE.items()},
    "initial_states.NAME.identifiable": "true: identifiable",
}

EXPERIMENT = Shared(
    "Experiment", "`experiments[]` of `identify`: a measurement and its simulation.", _experiment(True)
)
VALIDATED = Shared(
    "Validated experiment", "`experiments[]` of `validate`: a measurement and its simulation.", _experiment(False)
)

IDENTIFY = Document(
    "`identify --json`, `identify --result FILE.json`",
    "The result of an identification. Values are in the units of the [vehicle file](vehicle.md).",
    {
        "model": "`full`, `third-order` or `second-order`",
        "vehicle": "name of the vehicle",
        "parameters": "the estimated parameters",
        "parameters.NAME": "a parameter by its key in the vehicle file, e.g. `motor.resistance`",
        **{f"parameters.NAME.{name}": meaning for name, meaning in _ESTIMATE.items()},
        "identifiable": "which parameters are identifiable",
        "identifiable.NAME": "true: identifiable",
        "inseparable": "sentences: parameters that cannot be separated from each other",
        **_STATES,
        "parameter_names": "names of the parameters in the order of the matrices",
        "covariance": "covariance of the parameters, matrix as rows, in products of their units; null: not finite",
        "covariance_kind": "a sentence: what the covariance takes into account",
        "input_jitter": "standard deviation of the inputs' time stamps about the time of their effect [s]",
        "correlation": "correlation matrix of the parameters, as rows",
        "noise_variance": "covariance matrix of the outputs' noise, as rows, in the order of `noise_outputs`",
        "noise_outputs": "names of the output columns",
        "fit_percent": "NRMSE fit, mean over the experiments, by output",
        "fit_percent.COLUMN": "fit [%]; null: not defined",
        "fit_percent_initial": "the same with the initial values",
        "fit_percent_initial.COLUMN": "fit [%]; null: not defined",
        "loss": "determinant of the noise variance, which is minimised",
        "loss_initial": "the same with the initial values",
        "loss_history": "list: the loss after each iteration, the initial one first",
        "fpe": "final prediction error (Akaike)",
        "aic": "Akaike information criterion",
        "aicc": "the same with the correction for few samples",
        "bic": "Bayesian information criterion",
        "condition_number": "condition number of the information matrix",
        "stop_reason": "why the search ended, in words",
        "iterations": "iterations of the search",
        "evaluations": "evaluations of the loss",
        "seconds": "elapsed time [s]",
        "fixed_parameters": "parameters that are not estimated and have an effect, by linear theory",
        "fixed_parameters.NAME": "fixed parameter",
        "fixed_parameters.NAME.value": "its value",
        "fixed_parameters.NAME.unit": "unit of the value",
        "fixed_parameters.NAME.shifts": "change of each estimate if the value were 10 % larger, by linear theory; "
        "where `is_seen`, it holds for small changes only",
        "fixed_parameters.NAME.shifts.NAME": "change in the estimate's unit",
        "fixed_parameters.NAME.is_seen": "whether the residuals would then show it",
        "fixed_parameters.NAME.change": "relative change of the value with the best fit; null: estimates take up "
        "any value",
        "fixed_parameters.NAME.explains": "share of the weighted squared errors that this would explain",
        "profiles": "profile likelihoods; empty without `--profile`",
        "profiles.NAME": "profile of a parameter",
        "profiles.NAME.values": "list: values of the parameter",
        "profiles.NAME.deviance": "list: twice the drop of the log-likelihood there, divided by the ratio of the "
        "robust to the white variance; 3.84 is the 95 % limit",
        "profiles.NAME.low": "begin of the 95 % interval; null: the profile does not reach it",
        "profiles.NAME.high": "end of the 95 % interval; null: the profile does not reach it",
        "experiments": "the measurements, see Experiment",
        "warnings": "sentences: what limits the use of the result, the worst first",
        "notes": "sentences: what was done to the data",
        "provenance": "see Provenance",
    },
    {"experiments[]": EXPERIMENT, "provenance": PROVENANCE},
)

PLAN = Document(
    "`identify --plan --json`",
    "Experiments by the information that they give.",
    {
        "parameters": "names of the parameters to be estimated",
        **{
            f"{part}{key}": meaning
            for part, what in (
                ("ranked", "single experiments, the most informative first"),
                ("order", "the best sequence; each row counts together with all before it"),
            )
            for key, meaning in {
                "": what,
                "[].experiment": "name of the experiment",
                "[].initial_angle_deg": "gate angle at its begin [deg]",
                "[].road_slope_deg": "slope of the road [deg]",
                "[].log10_det": "decimal logarithm of the information matrix's determinant; null: not all "
                "parameters are identifiable",
                "[].relative_std": "expected standard deviations",
                "[].relative_std.NAME": "of a parameter, divided by its value: 0.01 is 1 %; null: unknown",
            }.items()
        },
        "provenance": "see Provenance",
    },
    {"provenance": PROVENANCE},
)

VALIDATE = Document(
    "`validate --json`, `validate --result FILE.json`",
    "The comparison of a vehicle with measurements; each statistic over all experiments by output column.",
    {
        "model": "`full`, `third-order` or `second-order`",
        "vehicle": "name of the vehicle",
        "fit_percent": "NRMSE fit, mean over the experiments, by output",
        "fit_percent.COLUMN": "fit [%]; null: not defined",
        "mean": "mean error, measured less simulated, by output",
        "mean.COLUMN": "in the column's unit",
        "rms": "root mean square of the errors, by output",
        "rms.COLUMN": "in the column's unit",
        "maximum": "largest error, by output",
        "maximum.COLUMN": "in the column's unit; null: unknown",
        "phases": "errors by phase of the motion, by output",
        "phases.COLUMN": "phases of an output",
        "phases.COLUMN.PHASE": "errors in a phase",
        **{f"phases.COLUMN.PHASE.{name}": meaning for name, meaning in _PHASE.items()},
        **_STATES,
        "whiteness": "whether the residuals of all experiments are white, by output",
        "whiteness.COLUMN": "true: white",
        "experiments": "the measurements, see Validated experiment",
        "warnings": "sentences: what limits the use of the result",
        "notes": "sentences: what was done to the data",
        "provenance": "see Provenance",
    },
    {"experiments[]": VALIDATED, "provenance": PROVENANCE},
)
