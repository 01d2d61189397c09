"""Replay of one variant of a campaign, compared bit by bit with the campaign's result."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from liftgate_hil.campaigns.folder import OWN, Folder
from liftgate_hil.campaigns.prepared import differences, prepared
from liftgate_hil.campaigns.results import JUDGED, MARGIN, VARIANT, VERDICT
from liftgate_hil.drive.result import Result
from liftgate_hil.drive.run import execute
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.target import is_one_of
from liftgate_hil.judging.verdict import ERROR, INCONCLUSIVE, line_of
from liftgate_hil.loop.listener import Listener
from liftgate_hil.plan.plan import plan_of


@dataclass(frozen=True)
class Replayed:
    """Outcome of a variant that was run again: whether it equals the campaign's result, and a text."""

    is_equal: bool  # to the bit with what the campaign saw
    lines: Sequence[str]  # in words


def replayed(
    path: Path,
    variant: str,
    record: Sequence[Path] = (),
    listener: Listener = Listener(),  # noqa: B008  # it holds nothing
) -> Replayed:
    """Run a variant of the campaign in `path` again, record it in files `record`, compare. Raises ConfigError."""
    folder = Folder(path)
    found = prepared(folder.request())
    if wrong := differences(folder.manifest(), found):
        raise ConfigError(f"{path}: {', '.join(wrong)}: not as in the campaign; allowed: the same as there")
    row = folder.find(variant)
    varied = [row.get(each.name) for each in found.base.targets]
    if not all(isinstance(each, float) for each in varied):
        raise ConfigError(f"{path}: variant {row[VARIANT]}: its values were changed")
    values = [float(each) for each in varied if each is not None]
    if found.base.variant(values) != row[VARIANT]:
        raise ConfigError(f"{path}: variant {row[VARIANT]}: its values were changed")
    job = found.base.job_of(values)
    for target in record:
        if is_one_of(target, [path / name for name in OWN]):
            raise ConfigError(f"`record` {target}: belongs to the campaign; allowed: another file")
    result = execute(plan_of(job.asking(record=tuple(record))._replace(trace=1, listener=listener)))
    seen = _columns_of(result, found.base.expectations)
    wrong = [
        f"{name}: {_shown(each)}, the campaign saw {_shown(row.get(name))}"
        for name, each in seen.items()
        if (None if isinstance(each, float) and math.isnan(each) else each) != row.get(name)
    ]
    values_text = ", ".join(
        f"{each.name} = {value:.12g}" for each, value in zip(found.base.targets, values, strict=True)
    )
    lines = [
        f"variant {row[VARIANT]}: {values_text}",
        f"{result.verdict}{': ' + result.reason if result.reason else ''}",
        *(f"  {name}: {line_of(each)}" for name, each in result.expectations.items()),
    ]
    lines += [f"recorded: {os.fspath(each)}" for each in result.recording]
    if not wrong:
        return Replayed(True, [*lines, "bit-identical to the campaign's result"])
    return Replayed(False, [*lines, "not as in the campaign:", *wrong])


def _columns_of(result: Result, expectations: Sequence[str]) -> dict[str, Any]:
    """Return the verdicts, margins and figures of a single run, by column of a campaign's results."""
    from liftgate_hil.campaigns.figures import figures_of

    margins: dict[str, Any] = {}
    none = ERROR if result.verdict == ERROR else INCONCLUSIVE
    for name in expectations:
        each = result.expectations.get(name)
        margins[f"{JUDGED}{name}"] = none if each is None else each.verdict
        is_known = each is not None and each.margin is not None and each.verdict != INCONCLUSIVE
        margins[f"{MARGIN}{name}"] = each.margin if is_known and each is not None else None
    figures = figures_of(result.trace)._asdict() if result.verdict != ERROR else {}
    return {VERDICT: result.verdict, **margins, **figures}


def _shown(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value)
