"""The product's own campaigns: variants that run, in this process."""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.adaptive import Evaluations, Probability, drive, estimate_probability
from liftgate_hil.campaigns.campaign import Campaign, CampaignProgress
from liftgate_hil.campaigns.executors.local import Serial
from liftgate_hil.campaigns.prepared import Prepared, prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.space import shares_of
from liftgate_hil.campaigns.store import Store
from liftgate_hil.ecu.names import REFERENCE
from tools.campaign_study.algorithms import ALGORITHMS, Floats, until_failure

EXPECTATION = "presses less than the limit"
_FOLDER = Path(__file__).parent
_MEMORY = Path("/dev/shm")  # a batch is synchronized to the disk, which may take as long as its runs
_TOGETHER = 250  # random variants that are evaluated together
_DRAWS = 10_000  # first seed of random variants: none of the searches has it


class Case(NamedTuple):
    """A scenario of this folder, with its ECU and what varies."""

    file: str
    meaning: str
    ecu: str
    vary: tuple[str, ...]

    @property
    def command(self) -> str:
        """The varied names, as the command line has them."""
        return " ".join(f"--vary '{each}'" for each in self.vary)


_FOUR = ("rod=4000:8000:5", "angle~uniform(46,66)", "supply~uniform(10,15)", "slope~uniform(-8,8)")
WEAKNESSES: Mapping[str, Case] = {
    "frozen": Case(
        "frozen.toml", "frozen messages, in a box", "mutant:counter_unchecked", _FOUR
    ),
    "zone": Case("zone.toml", "low currents, in a zone of the travel", REFERENCE, _FOUR),
    "late": Case(
        "late.toml", "low currents, up to a force", REFERENCE, (*_FOUR, "temperature~uniform(-20,60)")
    ),
}  # fmt: skip
FAILURES = Case(
    "failures.toml", "a rod of random stiffness", REFERENCE,
    ("rod~lognormal(6000,0.25)", "angle~uniform(46,66)", "supply~normal(12.5,0.7)", "slope~normal(0,3)"),
)  # fmt: skip


class Counts(NamedTuple):
    """Random variants: how many, how many with a negative margin, and how many without one."""

    count: int
    failing: int
    unjudged: int


@functools.cache
def _kept(case: Case) -> tuple[Prepared, Serial]:
    """Return a case's files, and the executor in this process, which keeps what variants have in common."""
    path = str(_FOLDER / case.file)
    found = prepared(CampaignRequest(path, case.vary, ecu=case.ecu, worst=EXPECTATION))
    return found, Serial(found.base)


@contextlib.contextmanager
def _campaign(case: Case) -> Iterator[tuple[Campaign, Prepared]]:
    found, executor = _kept(case)
    with tempfile.TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None) as folder:
        store = Store(folder)
        yield Campaign(found.base, executor, store, lambda: False, CampaignProgress(0), lambda _: None), found


def evaluations_to(task: tuple[str, str, int, int]) -> int:
    """Return the evaluations to the first failing variant of (weakness, algorithm, seed, budget); 0: none."""
    name, algorithm, seed, budget = task
    with _campaign(WEAKNESSES[name]) as (campaign, found):
        steps = until_failure(ALGORITHMS[algorithm](found.space.levels, budget, seed))
        return drive(steps, found.space.values, Evaluations(campaign, EXPECTATION)).found


def counts_of(task: tuple[Case, int, int]) -> Counts:
    """Return the counts of random variants of (case, number of the part, variants)."""
    case, part, count = task
    with _campaign(case) as (campaign, found):
        shares = shares_of(len(found.space.targets), count, "random", _DRAWS + part)
        margins: Floats = Evaluations(campaign, EXPECTATION).margins(found.space.values(shares))
    return Counts(count, int(np.sum(margins < 0.0)), int(np.sum(np.isnan(margins))))


def parts_of(case: Case, count: int) -> list[tuple[Case, int, int]]:
    """Return the tasks of `counts_of` for so many variants."""
    sizes = [min(_TOGETHER, count - first) for first in range(0, count, _TOGETHER)]
    return [(case, part, size) for part, size in enumerate(sizes)]


def added(counts: list[Counts]) -> Counts:
    """Return the sum of counts."""
    return Counts(*(sum(each) for each in zip(*counts, strict=True)))


def probability_of(task: tuple[Case, int, int]) -> Probability:
    """Return what the product says of (case, seed, evaluations)."""
    case, seed, budget = task
    with _campaign(case) as (campaign, found):
        return estimate_probability(campaign, found.space, EXPECTATION, budget, seed)
