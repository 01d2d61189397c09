"""Comparison of two ECUs that went through the same variants: where verdicts or margins differ, by how much."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from liftgate_hil.campaigns.reporting.heat_map import breakable, label_of
from liftgate_hil.campaigns.results import JUDGED, MARGIN, VARIANT, VERDICT, arrow, numbers_in, reading
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.report.numbers import plain, significant
from liftgate_hil.report.page import Markup, section, table, text

AGAINST = "against."  # prefix of the other ECU's columns
DIFFERENCE = "largest_difference"
_SHOWN = 20


# fmt: off
@dataclass(frozen=True)
class ResultsComparison(DescribedResult):
    """Comparison of the results of two ECUs in the same variants: pairs of verdicts, rows that differ."""

    names: Annotated[tuple[str, str], Shown("names of the ECUs: [first, second]", key="ecus")]
    variants: Annotated[int, Shown("variants that both have gone through")]
    pairs: Mapping[tuple[str, str], int]  # variants by verdict of the one and of the other
    differing: Any  # pa.Table of the variants whose verdict or margins differ, the most different first

    @property
    def count(self) -> Annotated[int, Shown("variants whose verdict or margins differ, see "
            "`differences.parquet`", key="differing")]:
        """Number of variants whose verdict or margins differ."""
        return int(self.differing.num_rows)

    @property
    def verdicts(self) -> Annotated[Mapping[str, int], Shown("variants by the two verdicts", keys={
            "PAIR": "number of variants; the key is e.g. `pass / fail`"})]:
        """Number of variants by the pair of verdicts, e.g. `pass / fail`."""
        return {f"{one} / {other}": number for (one, other), number in sorted(self.pairs.items())}


# fmt: on
def comparison_of(
    own: Path, other: Path, varied: Sequence[str], expectations: Sequence[str], names: tuple[str, str]
) -> ResultsComparison:
    """Compare the result files of two ECUs, which must have the same variants in the same order (not checked).

    Verdicts that differ come first, then margins, by their largest difference in an expectation's unit.
    Raises StoreError.
    """
    import pyarrow.parquet as pq

    pa = arrow()
    margins = [f"{MARGIN}{each}" for each in expectations]
    judged = [f"{JUDGED}{each}" for each in expectations]
    with reading(own) as stream:
        one = pq.read_table(stream, columns=[VARIANT, *varied, VERDICT, *judged, *margins])
    with reading(other) as stream:
        two = pq.read_table(stream, columns=[VARIANT, VERDICT, *judged, *margins])
    verdicts = one[VERDICT].to_numpy(zero_copy_only=False), two[VERDICT].to_numpy(zero_copy_only=False)
    largest = np.zeros(one.num_rows)
    for name in margins:
        a, b = numbers_in(one, name), numbers_in(two, name)
        apart = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(a - b))
        largest = np.fmax(largest, np.where(np.isnan(apart), np.inf, apart))  # only one of them has a margin
    is_other = verdicts[0] != verdicts[1]
    for name in judged:
        is_other = is_other | (
            one[name].to_numpy(zero_copy_only=False) != two[name].to_numpy(zero_copy_only=False)
        )
    order = np.lexsort((np.arange(len(largest)), -largest, ~is_other))
    kept = order[(is_other | (largest > 0.0))[order]]
    found = one.take(kept).append_column(DIFFERENCE, pa.array(largest[kept]))
    for name in (VARIANT, VERDICT, *judged, *margins):
        found = found.append_column(f"{AGAINST}{name}", two[name].take(kept))
    pairs = Counter(zip(verdicts[0].tolist(), verdicts[1].tolist(), strict=True))
    return ResultsComparison(names, one.num_rows, pairs, found)


def comparison_section(found: ResultsComparison, units: Mapping[str, str]) -> str:
    """Return the report's HTML section that compares two ECUs; `units` are those of varied names, in order."""
    one, other = found.names
    if not found.count:
        story = f"{one} and {other} have the same verdicts and margins in all {found.variants:,} variants."
        return section("Two ECUs", f"<p>{text(story)}</p>")
    changed = sum(number for (a, b), number in found.pairs.items() if a != b)
    story = f"Of {found.variants:,} variants {found.count:,} differ, {changed:,} in the verdict."
    pairs = [
        (a, b, f"{number:,}" if a == b else Markup(f"<b>{number:,}</b>"))
        for (a, b), number in sorted(found.pairs.items())
    ]
    rows = [_row(each, list(units)) for each in found.differing.slice(0, _SHOWN).to_pylist()]
    names = [breakable(label_of(each, units)) for each in units]
    return section(
        "Two ECUs",
        f"<p>{text(story)}</p>",
        table((one, other, "variants"), pairs, ("", "", "r")),
        "<h3>The most different</h3>",
        table(
            ("variant", *names, one, other, "largest difference"), rows, ("", *("r" for _ in names), "", "", "r")
        ),
    )


def _row(row: dict[str, Any], varied: Sequence[str]) -> tuple[str, ...]:
    difference = row[DIFFERENCE]
    return (
        Markup(f"<code>{text(row[VARIANT][:12])}</code>"),
        *(plain(float(row[name])) for name in varied),
        row[VERDICT],
        row[f"{AGAINST}{VERDICT}"],
        significant(math.nan if difference is None else float(difference), 4),
    )
