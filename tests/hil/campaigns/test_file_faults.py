"""Campaigns in which a file operation fails or the process is killed at one: no data is lost, and they resume."""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from c_library import needs_compiler
from faulty_commands import READING, WRITING, Fault, FaultyCommands

pytestmark = needs_compiler

PLACES = 8  # operations of which each fails, spread over all of a campaign
SIGKILL = -9
HASH = "0123456789abcdef" * 2
# Without an expectation, and nothing in its way, a campaign draws no figures, which would take most of its time.
SCENARIO = """
duration = 0.3
initial = "open"

[[request]]
time = 0.1
action = "close"
"""
# Files of a user in the folders of a campaign: with names of its own files, and with others.
NAMED_LIKE_OURS = {"results.parquet": b"mine", "report.html": b"<p>mine</p>", "DATA.md": b"# mine"}
FOREIGN = {
    ".lock": b"4711\n", "notes.txt": b"x", "table.parquet": b"PAR1", f".{HASH}.parquet": b"x",
    f"{HASH}.parquet.liftgate-{HASH}": b"x", f".x.liftgate-{HASH[1:]}": b"x", f".ab.{HASH}.{HASH}": b"x",
}  # fmt: skip


class Campaign(NamedTuple):
    """A campaign's folder and the folder of its batches."""

    output: Path
    store: Path
    voltages: str = "10:15:6"

    def arguments(self, *flags: str) -> list[str]:
        """The arguments of the command that runs the campaign."""
        return [
            "campaign", str(self.output.parent / "s.toml"), "--vary", f"supply.voltage={self.voltages}",
            "--jobs", "1", "--output", str(self.output), "--store", str(self.store), *flags,
        ]  # fmt: skip

    def batches(self) -> dict[str, bytes]:
        """The contents of the stored batches, by file name."""
        found = {each.name: each for each in self.store.glob("*.parquet")}
        return {name: each.read_bytes() for name, each in found.items() if re.fullmatch("[0-9a-f]{32}", each.stem)}

    def is_complete(self) -> bool:
        """Whether campaign.json says that the campaign is complete."""
        path = self.output / "campaign.json"
        return path.exists() and json.loads(path.read_bytes())["is_complete"]

    def results(self) -> tuple[pa.Table, dict[str, Any], bytes]:
        """Result rows, verdicts and data text, without values that differ from run to run."""
        manifest = json.loads((self.output / "campaign.json").read_bytes())
        assert (self.output / "report.html").read_text().rstrip().endswith("</html>")
        return (
            pq.read_table(self.output / "results.parquet").drop_columns(["wall_s"]),
            {key: manifest[key] for key in ("is_complete", "variants", "unfinished", "verdicts", "identity")},
            (self.output / "DATA.md").read_bytes(),
        )


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FaultyCommands]:
    found = FaultyCommands(tmp_path_factory.mktemp("commands"))
    yield found
    found.close()


def campaign_in(folder: Path, name: str = "out", voltages: str = "10:15:6") -> Campaign:
    folder.mkdir(exist_ok=True)
    (folder / "s.toml").write_text(SCENARIO)
    return Campaign(folder / name, folder / "store", voltages)


def with_foreign_files(campaign: Campaign) -> Campaign:
    for folder, files in ((campaign.output, FOREIGN | NAMED_LIKE_OURS), (campaign.store, FOREIGN)):
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
    return campaign


def assert_foreign_files_are_there(campaign: Campaign) -> None:
    """Assert that foreign files are unchanged; those in the place of a campaign's own files, under any name."""
    for folder in (campaign.output, campaign.store):
        assert {name: (folder / name).read_bytes() for name in FOREIGN} == FOREIGN
    assert {*NAMED_LIKE_OURS.values()} <= {each.read_bytes() for each in campaign.output.iterdir()}


def names_in(campaign: Campaign) -> set[str]:
    """The names of all files, without those under which foreign files were set aside."""
    found = [each.name for folder in (campaign.output, campaign.store) for each in folder.iterdir()]
    return {each for each in found if ".previous" not in each}


class Expected(NamedTuple):
    """Results and file names of a campaign that nothing disturbed."""

    results: tuple[pa.Table, dict[str, Any], bytes]
    names: set[str]
    operations: dict[int, int]  # by their kinds


@pytest.fixture(scope="module")
def expected(commands: FaultyCommands, tmp_path_factory: pytest.TempPathFactory) -> Expected:
    counts = {}
    for kinds in (READING | WRITING, WRITING):
        campaign = with_foreign_files(campaign_in(tmp_path_factory.mktemp("expected")))
        (ended,) = commands.run((campaign.arguments(), Fault(str(campaign.output.parent), kinds=kinds)))
        assert ended.code == 0
        counts[kinds] = ended.operations
    assert len(campaign.batches()) == 6
    assert counts[WRITING] > 40
    return Expected(campaign.results(), names_in(campaign), counts)


def assert_told(said: list[str], folder: Path, fault: Fault) -> None:
    """Assert that one line names a file and the cause, beside a line for each file that was set aside."""
    (line,) = [each for each in said if "the file that was there is now" not in each]
    assert re.search(f"{folder}/.*: {os.strerror(fault.number)}", line)


@pytest.mark.parametrize(
    ("number", "is_lasting", "kinds"),
    [(errno.EIO, False, READING | WRITING), (errno.ENOSPC, True, WRITING), (0, False, READING | WRITING)],
    ids=["one error", "a full disk", "killed"],
)
def test_a_failed_file_operation_or_a_kill_loses_no_batch_and_the_campaign_resumes(
    tmp_path: Path, commands: FaultyCommands, expected: Expected, number: int, is_lasting: bool, kinds: int
) -> None:
    failed = 0
    for place in range(PLACES):
        folder = tmp_path / str(place)
        campaign = with_foreign_files(campaign_in(folder))
        at = 1 + place * (expected.operations[kinds] - 1) // (PLACES - 1)
        fault = Fault(str(folder), at, number, is_lasting, kinds)
        (ended,) = commands.run((campaign.arguments(), fault))
        kept = campaign.batches()
        if ended.code == 0 or campaign.is_complete():
            assert campaign.results() == expected.results
        if number == 0:
            assert ended.code == SIGKILL
        elif ended.code != 0:
            assert_told(ended.said, folder, fault)
        failed += ended.code != 0
        assert_foreign_files_are_there(campaign)
        (resumed,) = commands.run((campaign.arguments("--resume"), None))
        assert resumed.code == 0, resumed.said
        assert campaign.results() == expected.results
        assert kept.items() <= campaign.batches().items()
        assert_foreign_files_are_there(campaign)
        assert names_in(campaign) == expected.names
    assert failed >= PLACES // 2  # others are of no harm, as of closing what was read


@pytest.mark.parametrize("number", [errno.EDQUOT, 0], ids=["quota", "killed"])
def test_a_failing_campaign_does_not_harm_another_one_that_shares_its_store(
    tmp_path: Path, commands: FaultyCommands, expected: Expected, number: int
) -> None:
    for place in range(2, 5):
        folder = tmp_path / str(place)
        first, second = with_foreign_files(campaign_in(folder)), campaign_in(folder, "second", "8:9:6")
        at = place * expected.operations[WRITING] // 6
        fault = Fault(str(folder), at, number, is_lasting=True, kinds=WRITING)
        ended, other = commands.run((first.arguments(), fault), (second.arguments(), None))
        assert ended.code == (1 if number else SIGKILL)
        assert other.code == 0, other.said
        others = second.results()
        assert others[1]["variants"] == others[0].num_rows == 6
        (resumed,) = commands.run((first.arguments("--resume"), None))
        assert resumed.code == 0, resumed.said
        assert first.results() == expected.results
        assert second.results() == others
        assert_foreign_files_are_there(first)
        assert names_in(first) == expected.names | {*first.batches()}
