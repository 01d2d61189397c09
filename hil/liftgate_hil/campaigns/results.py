"""Results of a campaign as Arrow tables, one row per variant, and their Parquet files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.evaluation import Row
from liftgate_hil.campaigns.figures import Figures
from liftgate_hil.campaigns.space import DRAW, KEY, PARAMETER, SEED_OF_RUN
from liftgate_hil.campaigns.store import StoreError, reason_of
from liftgate_hil.described_result import keys_of
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    import pyarrow as pa

    from liftgate_hil.campaigns.distributions import Floats

VARIANT, VERDICT, WALL, ERROR = "variant", "verdict", "wall_s", "error"
MARGIN = "margin."  # prefix of the columns of margins
JUDGED = "verdict."  # the same of the expectations' verdicts


def columns_of(base: Base) -> tuple[str, ...]:
    """Return the names of all columns of a campaign's results, in order."""
    varied = tuple(each.name for each in base.targets)
    margins = tuple(f"{prefix}{name}" for prefix in (JUDGED, MARGIN) for name in base.expectations)
    return VARIANT, *varied, VERDICT, *margins, *Figures._fields, WALL, ERROR


def check_columns(base: Base) -> None:
    """Raise ConfigError where a varied name is also the name of another result column."""
    names = columns_of(base)
    again = sorted({name for name in names if names.count(name) > 1})
    if again:
        raise ConfigError(f"`vary` {', '.join(again)}: allowed: names that no column of the results has")


def arrow() -> Any:
    """Return the module pyarrow, imported on first use. Raises ConfigError where it is not installed."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as _  # noqa: F401
    except ImportError:
        raise ConfigError("campaigns need pyarrow; allowed: with liftgate-hil[campaign] installed") from None
    return pa


@contextlib.contextmanager
def reading(path: Path) -> Iterator[BinaryIO]:
    """Context with a binary stream of a result file. Raises StoreError, which names the file."""
    try:
        with path.open("rb") as stream:
            yield stream
    except OSError as error:
        raise StoreError(f"{path}: {reason_of(error)}") from error


def table_of(base: Base, values: Floats, rows: Sequence[Row]) -> pa.Table:
    """Return the Arrow table of variants with values (n, d) and result rows (n,)."""
    pa = arrow()
    margins = np.array([each.margins for each in rows], dtype=np.float64).reshape(
        len(rows), len(base.expectations)
    )
    figures = np.array([each.figures for each in rows], dtype=np.float64).reshape(len(rows), len(Figures._fields))
    found = _variants(base, values)
    found[VERDICT] = pa.array([each.verdict for each in rows], pa.string())
    for k, name in enumerate(base.expectations):
        found[f"{JUDGED}{name}"] = pa.array([each.verdicts[k] for each in rows], pa.string())
    found |= {f"{MARGIN}{name}": _numbers(margins[:, k]) for k, name in enumerate(base.expectations)}
    found |= {name: _numbers(figures[:, k]) for k, name in enumerate(Figures._fields)}
    found[WALL] = _numbers(np.array([each.wall_s for each in rows], dtype=np.float64))
    found[ERROR] = pa.array([each.error or None for each in rows], pa.string())
    return pa.table(found)


def _variants(base: Base, values: Floats) -> dict[str, pa.Array]:
    """Return the columns that identify variants (n, d): their names and their varied values."""
    names = arrow().array([base.variant(each) for each in values.tolist()], arrow().string())
    return {VARIANT: names} | {each.name: _numbers(values[:, k]) for k, each in enumerate(base.targets)}


def without_results(base: Base, values: Floats, error: str) -> pa.Table:
    """Return the table of variants with values (n, d) that were not evaluated, with this error in each row."""
    pa = arrow()
    none = table_of(base, values[:0], [])
    count = len(values)
    known: dict[str, Any] = {
        **_variants(base, values),
        VERDICT: pa.repeat(pa.scalar("error"), count),
        ERROR: pa.repeat(pa.scalar(error), count),
    }
    known |= {f"{JUDGED}{name}": known[VERDICT] for name in base.expectations}
    return pa.table({field.name: known.get(field.name, pa.nulls(count, field.type)) for field in none.schema})


def _numbers(values: Floats) -> Any:
    """Return numbers (n,) as an Arrow array in which NaN is null."""
    return arrow().array(np.ascontiguousarray(values), from_pandas=True)


def numbers_in(table: pa.Table, name: str) -> Floats:
    """Return a numeric column (n,) of an Arrow table, NaN for null."""
    found: Floats = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
    return found


_KINDS = {
    PARAMETER: "a parameter of the scenario", KEY: "a key of the vehicle file", SEED_OF_RUN: "the seed of the run",
    DRAW: "the number of the car that is drawn",
}  # fmt: skip


def description_of(base: Base) -> Mapping[str, str]:
    """Return the description of each result column, by name."""
    varied = {
        each.name: f"{each.unit}{', ' if each.unit else ''}varied: {_KINDS[each.kind]}" for each in base.targets
    }
    judged = {f"{JUDGED}{name}": f"verdict on the expectation {name!r}" for name in base.expectations}
    margins = {
        f"{MARGIN}{name}": f"margin of the expectation {name!r}, 0 or negative where it failed; null: it has none"
        for name in base.expectations
    }
    return {
        VARIANT: "hash of everything that goes into the result",
        **varied,
        VERDICT: "pass, inconclusive, fail or error: the worst of the expectations",
        **judged,
        **margins,
        **keys_of(Figures),
        WALL: "s, time that the variant took; differs from run to run",
        ERROR: "why there is no result; null: there is one",
    }
