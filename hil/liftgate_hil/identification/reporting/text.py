"""Text output of `identify`, its plan and `validate`: aligned tables, at most 110 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence

import numpy as np

from liftgate_hil.described_result import Column, columns_in
from liftgate_hil.identification.design import ExperimentPlan, Ranked
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
from liftgate_hil.report.numbers import clean, deviation, fit, known_digits, percent, plain, significant

WIDTH = 110
_ACROSS = 6  # columns of a matrix side by side


def identification_text(result: Identification) -> str:
    """Return the whole result of an identification as text."""
    search = (
        f"{clean(result.stop_reason)}; {result.iterations} iterations, {result.evaluations} "
        f"simulations, {significant(result.seconds, 3)} s"
    )
    pairs = [f"{clean(one)} and {clean(other)}: {r:+.3f}" for one, other, r in strong_correlations(result)[:10]]
    sections = [
        [f"model {clean(result.model)}, vehicle {clean(result.vehicle)}"],
        _titled("Attention", _bullets(result.warnings)),
        _titled("Parameters", _parameters(result.parameters)),
        _titled("Strongly correlated", pairs),
        _titled("If a fixed parameter were 10 % larger (not visible in the residuals)", _dependences(result)),
        _titled("Initial states", _states(result.initial_states)),
        _titled("95 % intervals by profile likelihood", _profiles(result)),
        _titled("Noise variance (NoiseVar)", _noise(result)),
        _titled("Criteria", _criteria(result)),
        _titled("Fit", _fits(result.experiments, before=True)),
        _titled("Errors by phase", _phases(result.experiments)),
        _titled("Search", _wrapped(search, "")),
        _titled("Notes", _bullets(result.notes)),
    ]
    return _joined(sections)


def validation_text(result: Validation) -> str:
    """Return a validation as text: warnings, initial states, fits with residuals, errors by phase, notes."""
    sections = [
        [f"model {clean(result.model)}, vehicle {clean(result.vehicle)}"],
        _titled("Attention", _bullets(result.warnings)),
        _titled("Initial states", _states(result.initial_states)),
        _titled("Fit", _fits(result.experiments, before=False)),
        _titled("Errors by phase", _phases(result.experiments)),
        _titled("Notes", _bullets(result.notes)),
    ]
    return _joined(sections)


def plan_text(plan: ExperimentPlan) -> str:
    """Return the candidates, best first, and the order in which to combine them, as text."""
    heads = ["experiment", "log10 det", *(f"{name} ±" for name in plan.names)]
    align = "l" + "r" * (len(heads) - 1)
    lines = ["Experiments, the most informative first (expected standard deviations)", ""]
    lines += table(heads, [_ranked(each) for each in plan.ranked], align)
    lines += ["", "Best sequence, each experiment together with all before it", ""]
    lines += table(heads, [_ranked(each) for each in plan.order], align)
    return "\n".join(lines)


def _ranked(each: Ranked) -> list[str]:
    criterion = significant(each.log_det) if math.isfinite(each.log_det) else "not all identifiable"
    stds = [
        "not identifiable" if math.isinf(std) else f"{significant(100.0 * float(std), 2)} %"
        for std in each.relative_std
    ]
    return [each.candidate.name, criterion, *stds]


def text_table(columns: Sequence[Column], results: Sequence[object]) -> list[str]:
    """Return the lines of a table of results: their columns, numbers at the right."""
    rows = [[clean(column.cell(each), column.longest) for column in columns] for each in results]
    align = "".join("r" if each.look == "r" else "l" for each in columns)
    return table([each.head for each in columns], rows, align)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], align: str) -> list[str]:
    """Return the lines of a text table; `align` has l (left) or r (right) for each column."""
    body = [list(heads), *[list(row) for row in rows]]
    widths = [max(len(row[i]) for row in body) for i in range(len(heads))]
    return [
        "  ".join(
            cell.ljust(width) if side == "l" else cell.rjust(width)
            for cell, width, side in zip(row, widths, align, strict=True)
        ).rstrip()
        for row in body
    ]


def _titled(title: str, lines: list[str]) -> list[str]:
    return [title, *[f"  {line}" if line else "" for line in lines]] if lines else []


def _joined(sections: Iterable[list[str]]) -> str:
    return "\n\n".join("\n".join(lines) for lines in sections if lines) + "\n"


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, WIDTH - 2, initial_indent=indent, subsequent_indent=" " * len(indent))


def _bullets(texts: Iterable[str]) -> list[str]:
    return [line for text in texts for line in _wrapped(clean(text), "- ")]


def _parameters(estimates: Sequence[Estimate]) -> list[str]:
    if not estimates:
        return []
    columns = columns_in(Estimate, "name", *VALUES, "identifiable")
    lines = text_table([columns[0]._replace(head=""), *columns[1:]], estimates)
    output = lines[:1]
    for line, each in zip(lines[1:], estimates, strict=True):
        output.append(line)
        output += _wrapped(clean(each.remark), "    ") if each.remark else []
    return output


def _states(estimates: Sequence[Estimate]) -> list[str]:
    """Return one line of text for each estimated initial state."""
    rows = [
        (
            clean(each.name, 50),
            known_digits(each.value, each.shown_std),
            f"± {deviation(each.shown_std)}",
            clean(each.unit, 12),
            f"initial {plain(each.initial)}",
            "" if each.identifiable else "not identifiable",
        )
        for each in estimates
    ]
    return table(("",) * 6, rows, "lrllll")[1:] if rows else []


def _dependences(result: Identification) -> list[str]:
    rows = [
        (
            clean(each.estimate.name, 30) if is_first else "",
            clean(each.fixed.name, 40),
            f"{plain(each.fixed.value)} {clean(each.fixed.unit, 12)}".rstrip(),
            percent(100.0 * each.share, "+"),
            significant(each.shift / each.estimate.std, 2),
        )
        for each, is_first in firsts(dependences(result))
    ]
    return table(("estimate", "fixed parameter", "its value", "change %", "in std"), rows, "lllrr") if rows else []


def _profiles(result: Identification) -> list[str]:
    rows = [(clean(each.name, 30), f"{_limit(each.low)} … {_limit(each.high)}") for each in result.profiles]
    return table(("", ""), rows, "ll")[1:] if rows else []


def _limit(value: float) -> str:
    text = significant(value, 4)
    return "no limit" if text == "—" else text


def _noise(result: Identification) -> list[str]:
    names = [clean(each, 24) for each in result.outputs]
    lines: list[str] = []
    for start in range(0, len(names), _ACROSS):
        across = range(start, min(start + _ACROSS, len(names)))
        rows = [
            (str(i + 1), names[i], *(significant(result.noise_variance[i, k]) for k in across))
            for i in range(len(names))
        ]
        heads = ("", "", *(str(k + 1) for k in across))
        lines += [""] * bool(lines) + table(heads, rows, "rl" + "r" * len(across))
    return lines


def _criteria(result: Identification) -> list[str]:
    rows = [
        ("loss", plain(result.loss), f"initially {plain(result.loss_initial)}"),
        ("FPE", plain(result.fpe), ""),
        ("AIC", plain(result.aic), ""),
        ("AICc", plain(result.aicc), ""),
        ("BIC", plain(result.bic), ""),
        ("condition number", significant(result.condition_number, 3), ""),
    ]
    kind = f"{'covariance':<16}  {clean(result.covariance_kind)}"
    return [*table(("", "", ""), rows, "lll")[1:], kind]


def _residual(series: Series) -> str:
    if words := residual_words(series):
        return words
    lag = 1 + int(np.argmax(np.nan_to_num(np.abs(series.autocorrelation[1:]))))
    return f"not white: {series.autocorrelation[lag]:+.2f} at lag {lag}, band ±{series.band:.3f}"


def _fits(experiments: Sequence[Experiment], *, before: bool) -> list[str]:
    lines: list[str] = []
    heads = ("", "fit %", *(each.head for each in columns_in(Series, *ERRORS)), "residual")
    for experiment in experiments:
        rows = [
            (
                clean(each.output, 24),
                f"{fit(each.fit_before)} -> {fit(each.fit_percent)}" if before else fit(each.fit_percent),
                *(column.cell(each) for column in columns_in(Series, *ERRORS)),
                _residual(each),
            )
            for each in experiment.series
        ]
        lines += [""] * bool(lines) + [clean(experiment.name, WIDTH - 4)]
        lines += table(heads, rows, "lrrrrl")
    return lines


def _phases(experiments: Sequence[Experiment]) -> list[str]:
    lines: list[str] = []
    for experiment in experiments:
        rows = [
            (
                clean(each.output, 30) if i == 0 else "",
                clean(phase, 30),
                *(column.cell(errors) for column in PHASE),
            )
            for each in experiment.series
            for i, (phase, errors) in enumerate(each.phases.items())
        ]
        if rows:
            lines += [""] * bool(lines) + [clean(experiment.name, WIDTH - 4)]
            lines += table(("", "phase", *(each.head for each in PHASE)), rows, "llrrr")
    return lines
