"""Report of an identification or a validation as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence

from liftgate_hil.described_result import columns_in
from liftgate_hil.identification.reporting import figures
from liftgate_hil.identification.reporting.findings import (
    ERRORS,
    PHASE,
    VALUES,
    dependences,
    firsts,
    residual_words,
    strong_correlations,
)
from liftgate_hil.identification.result import Estimate, Experiment, Identification, Series, Validation
from liftgate_hil.plan.provenance import Provenance
from liftgate_hil.report.drawing import svg
from liftgate_hil.report.numbers import column_label, percent, plain, significant
from liftgate_hil.report.page import alert, bullets, figure, page, section, subheading, table, table_of

_FIT = (
    "Fit: 100 (1 − ‖measured − simulated‖ / ‖measured − its mean‖), the NRMSE; 0 is as good as the mean value. "
    "Residual: white is noise; white about its mean, noise beside a constant; not white has a pattern."
)
_MOST = 8  # experiments with figures of their own, as a page with more is too large to open


def identification_html(result: Identification) -> str:
    """Return an identification's HTML page: warnings, parameters, fits, figures, residual tests, notes."""
    experiments = result.experiments
    return page(
        f"Identification of {result.vehicle}",
        f"Model {result.model}; {result.iterations} iterations, {result.evaluations} simulations, "
        f"{significant(result.seconds, 3)} s; stopped: {result.stop_reason}",
        [
            alert(result.warnings),
            section("Parameters", _parameters(result.parameters), _estimates(result)),
            section("Correlation", _correlation(result)),
            section("Fixed parameters", _dependences(result)),
            section("Profile likelihood", _profiles(result)),
            section("Initial states", _states(result.initial_states)),
            section("Fit", _fits(experiments, before=True)),
            section("Measured and simulated", *_traces(experiments)),
            section("Prediction errors and residual tests", *_residuals(experiments)),
            section("Loss and noise", _criteria(result), _noise(result), _history(result)),
            section("Notes", bullets([*result.notes, *_left_out(experiments)])),
            _origin(result.provenance),
        ],
    )


def validation_html(result: Validation) -> str:
    """Return a validation's HTML page: warnings, fits, figures, errors by phase, residual tests, notes."""
    experiments = result.experiments
    return page(
        f"Validation of {result.vehicle}",
        f"Model {result.model}; {len(experiments)} experiment{'s' * (len(experiments) != 1)}",
        [
            alert(result.warnings),
            section("Initial states", _states(result.initial_states)),
            section("Fit", _fits(experiments, before=False)),
            section("Measured and simulated", *_traces(experiments)),
            section("Errors by phase", _phases(experiments)),
            section("Prediction errors and residual tests", *_residuals(experiments)),
            section("Notes", bullets([*result.notes, *_left_out(experiments)])),
            _origin(result.provenance),
        ],
    )


def _origin(provenance: Provenance | None) -> str:
    if provenance is None:
        return ""
    return section("Provenance", table(("", ""), provenance.rows(), ("", "name")))


def _parameters(estimates: Sequence[Estimate]) -> str:
    """Return the HTML table of the parameters, without their remarks: the page's warnings contain these."""
    return table_of(columns_in(Estimate, "name", "symbol", *VALUES, "identifiable"), estimates)


def _estimates(result: Identification) -> str:
    if not any(each.initial != 0.0 for each in result.parameters):
        return ""
    title = "Estimates relative to their initial values"
    return figure(
        svg(figures.parameter_figure(result), "estimates", title),
        f"{title}; bars are two standard deviations to either side, cut off at the edge; many are narrower than "
        f"the dot. Covariance: {result.covariance_kind}. Parameters that start from zero are not shown.",
    )


def _correlation(result: Identification) -> str:
    if len(result.parameters) < 2:
        return ""
    pairs = [
        f"{one} and {other}: {r:+.3f}: hard to separate" for one, other, r in strong_correlations(result)[:10]
    ]
    drawing = svg(figures.correlation_figure(result), "correlation", "Correlation")
    caption = f"Correlation of the estimates. Condition number: {significant(result.condition_number, 3)}."
    return figure(drawing, caption, small=len(result.parameters) < 8) + bullets(pairs)


def _dependences(result: Identification) -> str:
    rows = [
        (
            each.estimate.name if is_first else "",
            each.fixed.name,
            plain(each.fixed.value),
            each.fixed.unit,
            percent(100.0 * each.share, "+"),
            significant(each.shift / each.estimate.std, 2),
        )
        for each, is_first in firsts(dependences(result))
    ]
    if not rows:
        return ""
    heads = ("estimate", "fixed parameter", "its value", "", "change %", "in std")
    lead = "<p>Change of the estimates if a fixed parameter were 10 % larger (not visible in the residuals).</p>"
    return lead + table(heads, rows, ("name", "name", "r", "n", "r", "r"))


def _profiles(result: Identification) -> str:
    if not result.profiles:
        return ""
    rows = [(each.name, significant(each.low), significant(each.high)) for each in result.profiles]
    drawing = svg(figures.profile_figure(result), "profiles", "Profile likelihood")
    caption = (
        "Twice the loss in log-likelihood when a parameter is fixed and the others are estimated again; "
        "shaded: the 95 % interval. A flat curve means a parameter that is not identifiable."
    )
    return figure(drawing, caption) + table(("95 % interval", "from", "to"), rows, ("name", "r", "r"))


def _states(estimates: Sequence[Estimate]) -> str:
    columns = columns_in(Estimate, "name", "value", "std", "initial", "unit", "identifiable", "remark")
    return table_of([columns[0]._replace(head="state"), *columns[1:]], estimates)


def _fits(experiments: Sequence[Experiment], *, before: bool) -> str:
    columns = columns_in(Series, *(["fit_before"] if before else []), "fit_percent", *ERRORS)
    heads = ["experiment", "output", *(each.head for each in columns), "unit", "residual"]
    classes = ["name", "n", *(each.look for each in columns), "n", "soft"]
    rows = []
    for experiment in experiments:
        for i, each in enumerate(experiment.series):
            label, unit = column_label(each.output)
            cells = [experiment.name if i == 0 else "", label, *(column.cell(each) for column in columns)]
            cells += [unit, _residual(each)]
            rows.append(cells)
    return table(heads, rows, classes) + (f'<p class="soft">{_FIT}</p>' if rows else "")


def _residual(series: Series) -> str:
    if words := residual_words(series):
        return words
    return (
        f"not white: {series.lags_outside} of {len(series.autocorrelation) - 1} lags outside, "
        f"{series.input_lags_outside} of {len(series.crosscorrelation)} with the voltage"
    )


def _traces(experiments: Sequence[Experiment]) -> list[str]:
    parts = []
    for number, each in enumerate(experiments[:_MOST]):
        drawing = svg(figures.trace_figure(each), f"traces{number}", f"Traces of {each.name}")
        parts += [
            subheading(each.name),
            figure(drawing, "Every output as measured and as the model simulates it."),
        ]
    return parts


def _residuals(experiments: Sequence[Experiment]) -> list[str]:
    parts = []
    for number, each in enumerate(experiments[:_MOST]):
        errors = svg(figures.error_figure(each), f"errors{number}", f"Errors of {each.name}")
        tests = svg(figures.residual_figure(each), f"tests{number}", f"Residuals of {each.name}")
        parts += [
            subheading(each.name),
            figure(errors, "Prediction errors: ideally white noise around zero."),
            figure(
                tests,
                "Autocorrelation of the residuals, and their correlation with the voltage. The band holds 99 % "
                "of the lags if the residuals are white and independent of the input. Lags outside the band are "
                "coloured; one in a hundred is there by chance.",
            ),
        ]
    return parts


def _phases(experiments: Sequence[Experiment]) -> str:
    rows = [
        (
            experiment.name,
            column_label(each.output)[0],
            phase,
            *(column.cell(errors) for column in PHASE),
            column_label(each.output)[1],
        )
        for experiment in experiments
        for each in experiment.series
        for phase, errors in each.phases.items()
    ]
    heads = ("experiment", "output", "phase", *(each.head for each in PHASE), "unit")
    return table(heads, rows, ("name", "n", "", "r", "r", "r", "n"))


def _criteria(result: Identification) -> str:
    heads = ("loss", "initial loss", "FPE", "AIC", "AICc", "BIC")
    values = (
        result.loss, result.loss_initial, result.fpe, result.aic, result.aicc, result.bic,
    )  # fmt: skip
    return table(heads, [[plain(value) for value in values]], ("r",) * len(heads))


def _noise(result: Identification) -> str:
    rows = [
        (name, *(significant(value) for value in row))
        for name, row in zip(result.outputs, result.noise_variance.tolist(), strict=True)
    ]
    heads = ("noise variance", *result.outputs)
    return table(heads, rows, ("name", *("r",) * len(result.outputs)))


def _history(result: Identification) -> str:
    if len(result.history) < 2:
        return ""
    drawing = svg(figures.loss_figure(result), "loss", "Loss over iterations")
    return figure(drawing, "Loss after each iteration.")


def _left_out(experiments: Sequence[Experiment]) -> list[str]:
    rest = [each.name for each in experiments[_MOST:]]
    return [f"no figures, to keep the page small: {', '.join(rest)}"] if rest else []
