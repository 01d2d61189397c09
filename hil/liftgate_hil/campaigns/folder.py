"""Folder of a campaign: campaign.json, the store of batches, results.parquet, report.html."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import shlex
import uuid
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_compiler.files import close, lock, remove_leftovers, whole_file, write_whole
from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import VARIANT, description_of
from liftgate_hil.campaigns.store import StoreError, reason_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.target import is_one_of
from liftgate_hil.report.files import make_way

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST, RESULTS, REPORT, BATCHES = "campaign.json", "results.parquet", "report.html", "batches"
AGAINST, DIFFERENCES = "against.parquet", "differences.parquet"  # of another ECU
WORST_FILE, DATA = "worst.toml", "DATA.md"
OWN = (MANIFEST, RESULTS, REPORT, BATCHES, AGAINST, DIFFERENCES, WORST_FILE, DATA)  # names in the folder
LOCK = ".lock"  # held by the process whose campaign runs in the folder; has the tokens of all that did
FORMAT = 2  # of campaign.json and of the results
# LOCK: a line break and a token for each campaign; where the disk was full, a part of that. Nothing else: a file
# with a process's number is another program's.
_TOKENS = re.compile(r"(\n[0-9a-f]{0,32})*")
_MOST_BYTES = 1 << 20  # of LOCK: the tokens of 30,000 campaigns
_SHOWN = 12  # characters of a variant's name that tell it from others
_GROUP = 16_384  # rows of a row group at least


def replay_line(folder: Path | str, variant: str) -> str:
    """Return the command line that runs a variant of a campaign's folder again, with the same ECU and rate."""
    return f"liftgate-hil campaign {shlex.quote(str(folder))} --replay {variant[:_SHOWN]}"


class Folder:
    """Output folder of a campaign: its manifest, store, results and reports.

    `token` is in the names of temporary files in the store, so that they tell whose they are.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.token = path, uuid.uuid4().hex
        self._before: list[str] = []  # tokens of campaigns that ran here, and have ended

    def create(self) -> None:
        """Create the folder, if it is not there. Raises ConfigError where that fails."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"`output` {self.path}: {error.strerror}; allowed: a folder to write to") from error

    @contextlib.contextmanager
    def claimed(self) -> Iterator[bool]:
        """Context that locks the folder; yields whether it can. Raises ConfigError if another campaign has it.

        Yields False where the file system has no locks. The kernel releases the lock when the process that took it
        ends, however it ends: a campaign with the lock knows that those that held it before have ended.
        """
        try:
            descriptor = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise ConfigError(f"`output` {self.path}: {error.strerror}; allowed: a folder to write to") from error
        try:
            try:
                is_claimed = lock(descriptor)
            except BlockingIOError:
                raise ConfigError(
                    f"`output` {self.path}: another campaign is running there; allowed: another folder"
                ) from None
            if is_claimed:
                self._enter(descriptor)
            yield is_claimed
        finally:
            close(descriptor)

    def _enter(self, descriptor: int) -> None:
        """Read the tokens of earlier campaigns from the lock file, and append this campaign's token."""
        with contextlib.suppress(OSError):  # what is not known as a campaign's stays
            content = os.pread(descriptor, _MOST_BYTES, 0).decode("ascii", errors="replace")
            if _TOKENS.fullmatch(content):
                self._before = [each for each in content.split() if len(each) == len(self.token)]
                os.write(descriptor, f"\n{self.token}".encode())

    @property
    def ended(self) -> list[str]:
        """Tokens of this and earlier campaigns of the folder, whose temporary files may be removed."""
        return [*self._before, self.token]

    def tidy(self) -> None:
        """Remove temporary files that killed processes have left in the folder."""
        remove_leftovers(self.path)

    @property
    def has_campaign(self) -> bool:
        """Whether the folder holds a campaign, that is a campaign.json."""
        return (self.path / MANIFEST).is_file()

    def manifest(self) -> dict[str, Any]:
        """Return the content of campaign.json. Raises ConfigError."""
        path = self.path / MANIFEST
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}; allowed: the folder of a campaign") from error
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{path}: not JSON: {error}; allowed: as a campaign has written it") from error
        if not isinstance(found, dict) or found.get("format") != FORMAT:
            raise ConfigError(
                f"{path}: format: not of this version; allowed: {FORMAT}; run the campaign again in a new folder"
            )
        return found

    def request(self) -> CampaignRequest:
        """Return the request in campaign.json. Raises ConfigError."""
        return CampaignRequest.of_kept(self.manifest().get("request"))

    def make_way(self, names: Iterable[str], inputs: Iterable[Path], say: Say = silent) -> None:
        """Rename files of other programs in the place of output files `names`; `say` gets a note on each.

        Raises ConfigError, also for one of the `inputs`.
        """
        inputs = list(inputs)
        paths = [self.path / name for name in names]
        issues = [
            f"`output` {each}: is an input file; allowed: another folder"
            for each in paths
            if is_one_of(each, inputs)
        ]
        if issues:
            raise ConfigError(issues)
        for each in paths:
            make_way(each, say)

    def write_manifest(self, content: dict[str, Any]) -> None:
        """Write campaign.json. Raises StoreError."""
        text = json.dumps({"format": FORMAT, **content}, indent=2, ensure_ascii=False, allow_nan=False)
        self.write(MANIFEST, text.encode())

    def write(self, name: str, content: bytes) -> None:
        """Write a file of the folder atomically: a temporary file, then renamed. Raises StoreError."""
        try:
            write_whole(self.path / name, content)
        except OSError as error:
            raise StoreError(f"{self.path / name}: {reason_of(error)}") from error

    def write_results(self, tables: Iterable[pa.Table], name: str = RESULTS) -> int:
        """Write result tables (none: no file) as one Parquet file; return the row count. Raises StoreError."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        coming, rows = iter(tables), 0
        kept: list[pa.Table] = []
        try:
            first = next(coming, None)
            if first is None:
                return 0
            with (
                whole_file(self.path / name) as stream,
                pq.ParquetWriter(stream, first.schema, compression="zstd") as writer,
            ):
                for table in itertools.chain([first], coming):
                    kept.append(table)
                    rows += table.num_rows
                    if sum(each.num_rows for each in kept) >= _GROUP:
                        writer.write_table(pa.concat_tables(kept))
                        kept.clear()
                if kept:
                    writer.write_table(pa.concat_tables(kept))
        except OSError as error:
            raise StoreError(f"{self.path / name}: {reason_of(error)}") from error
        return rows

    def find(self, variant: str) -> dict[str, Any]:
        """Return the result row of the variant whose name begins with a given text. Raises ConfigError."""
        import pyarrow.parquet as pq

        path = self.path / RESULTS
        try:
            found_names = pq.read_table(path, columns=[VARIANT])[VARIANT].to_pylist()
            names = [str(each) for each in found_names]
        except FileNotFoundError:
            raise ConfigError(f"{path}: no such file; allowed: results of a campaign") from None
        except (OSError, ValueError, KeyError) as error:
            raise ConfigError(f"{path}: {reason_of(error)}; allowed: results of a campaign") from None
        places = [k for k, each in enumerate(names) if each.startswith(variant)]
        if not places or len({names[k] for k in places}) > 1:
            what = "no such variant" if not places else f"{len(places)} variants begin like that"
            raise ConfigError(f"`replay` {variant}: {what}; allowed: one of the results, or its first digits")
        found: dict[str, Any] = pq.read_table(path).slice(places[0], 1).to_pylist()[0]
        return found


def data_text(base: Base, counts: Mapping[str, int]) -> str:
    """Return a Markdown description of the results file: its columns, and the `counts` of variants by verdict."""
    rows = "\n".join(f"| `{name}` | {meaning} |" for name, meaning in description_of(base).items())
    number = sum(counts.values())
    verdicts = ", ".join(f"{count:,} {name}" for name, count in sorted(counts.items()))
    return f"""# Data of a campaign

`{RESULTS}`: Apache Parquet, a row for each of {number:,} variants ({verdicts}), made by liftgate-hil
{base.versions["liftgate-hil"]}. `{MANIFEST}` has the request, the files with their SHA-256, versions and machine.
Forces are those of the model, not of a car.

| column | meaning |
|---|---|
{rows}
"""
