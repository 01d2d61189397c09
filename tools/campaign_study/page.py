"""Page docs/campaign-study.md, from the results of the study."""

from __future__ import annotations

import os
import textwrap

from liftgate_hil.version import version, versions
from tools.benchmark.machine import machine
from tools.campaign_study import product
from tools.campaign_study.algorithms import SIGMA
from tools.campaign_study.estimates import BUDGET, P
from tools.campaign_study.pockets import HARDEST
from tools.campaign_study.study import FIRST, Data, Size
from tools.campaign_study.tables import (
    check_table,
    interval,
    minima_table,
    not_least,
    probability_table,
    search_table,
    total,
    worse,
)
from tools.docs.markdown import MADE, page, table

WIDTH = 113
COMMAND = "python -m tools.campaign_study"


def page_of(parts: dict[str, Data], size: Size, jobs: int, short: bool) -> str:
    """Return the page of all parts, each with its results and seconds."""
    found = {name: each["found"] for name, each in parts.items()}
    made = page(
        "Study of campaigns",
        *_introduction({name: each["seconds"] for name, each in parts.items()}, jobs, short),
        *_weaknesses(found["weaknesses"], size),
        *_pockets(found["pockets"], size),
        *_tests(found["tests"], size),
        *_probabilities(found["probabilities"], size),
        *_check(found["check"], size),
    )
    return made.replace(MADE, MADE.replace("make docs", COMMAND), 1)


def text(content: str) -> str:
    """Return a paragraph in lines."""
    return textwrap.fill(" ".join(content.split()), WIDTH, break_long_words=False, break_on_hyphens=False)


def _introduction(seconds: dict[str, float], jobs: int, short: bool) -> list[str]:
    known = {**versions(), "cma": version("cma")}
    names = ("liftgate-hil", "python", "numpy", "scipy", "numba", "cma")
    lines = [
        f"Made by `{COMMAND} --output docs`",
        *machine()[:2],
        ", ".join(f"{name} {known[name]}" for name in names),
        f"{jobs} processes for each part: {', '.join(f'{name} {each:.0f} s' for name, each in seconds.items())}",
        f"load average over 15 minutes at the end: {os.getloadavg()[2]:.1f}",
    ]
    return [
        "**A short run, for tests of the tool: its figures say nothing.**" if short else "",
        text(
            """How soon does the [search for the worst](campaigns.md) find a narrow pocket of
            failures, and how good is the [probability](campaigns.md)? First
            with real runs of the product, then with analytic functions, of which there are more. All seeds
            are stated; other seeds give other figures."""
        ),
        "\n".join(f"- {each}" for each in lines),
        text(
            f"""The search is compared with plain `cma` (from the centre of the space, a first step of
            {SIGMA:g}, bounds, again from the centre with another seed when it has ended), and with random
            draws. `found, mean` is how many of the seeds had a failing variant, and the mean number of
            evaluations to the first one; where none was found, the number is the whole budget. Seeds are
            paired: `sooner` counts the seeds with which the search needed fewer evaluations."""
        ),
    ]


def _weaknesses(found: Data, size: Size) -> list[str]:
    rows = []
    for name, each in found.items():
        case, volume = product.WEAKNESSES[name], each["volume"]
        low, high = interval(volume["failing"], volume["count"])
        share = 100.0 * volume["failing"] / volume["count"]
        rows.append(
            (
                f"{name}: {case.meaning}",
                str(len(case.vary)),
                f"{share:.2f} % ({100.0 * low:.2f} to {100.0 * high:.2f} %)",
                str(volume["unjudged"]),
            )
        )
    evaluations = {name: each["evaluations"] for name, each in found.items()}
    runs = [
        f"- {name}: `{case.file}`, `--ecu {case.ecu}`, varied `{'`, `'.join(case.vary)}`"
        for name, case in product.WEAKNESSES.items()
    ]
    return [
        "## Three planted weaknesses",
        text(
            """Each is a scenario of [`tools/campaign_study`](../tools/campaign_study): the gate closes
            from open onto a rod, and a fault keeps the ECU from detecting it in a pocket of the varied
            values only. *frozen* is a needle: outside its box nothing leads to it. *zone* is within a zone
            of the travel, from whose lower end the force rises. *late* has a shoulder: the nearer its
            middle, the later the ECU reverses. A variant is a run of the product; the margin is that of
            "presses less than the limit". One dimension, the rod, has five values."""
        ),
        "\n".join("\n".join(textwrap.wrap(each, WIDTH, subsequent_indent="  ")) for each in runs),
        text(
            f"""The volume of each pocket is the share of failures among {size.volume} random variants,
            with the interval of Clopper and Pearson:"""
        ),
        table(("weakness", "dimensions", "volume (95 %)", "without a margin"), rows),
        text(
            f"""Evaluations to the first failing variant, with a budget of {size.budget} and the sampling
            seeds 0 to {size.seeds - 1} (found, mean):"""
        ),
        search_table("weakness", evaluations, size.budget),
        text(f"All together: {total(evaluations, size.budget)}."),
        text(f"Better than the search, by the number found or by the mean: {worse(evaluations, size.budget)}."),
        text(
            f"""With {size.seeds} seeds, a difference of few seeds or of a third of the mean is chance; the
            next table has more."""
        ),
    ]


def _pockets(found: Data, size: Size) -> list[str]:
    others = {name: each for name, each in found.items() if name != HARDEST}
    return [
        "## Analytic pockets",
        text(
            f"""Margins with a narrow pocket at a place of each seed's own
            (`tools/campaign_study/pockets.py`), narrow in 3 of 5 dimensions for example, and its share of
            the space. Seeds {FIRST} to {FIRST + size.pocket_seeds - 1}; the constants of the search were
            chosen with other seeds, but with the same kinds of pockets. A budget of {size.budget} (found,
            mean):"""
        ),
        search_table("pocket", found, size.budget),
        text(f"All but the last: {total(others, size.budget)}.") if HARDEST in found else "",
        text(f"Better than the search, by the number found or by the mean: {worse(found, size.budget)}."),
        text(
            """Of a needle of the share q no search can know more than what it has covered: random draws
            find it within n evaluations with the probability 1 - (1 - q)ⁿ, and well-spread points a little
            sooner."""
        ),
    ]


def _tests(found: Data, size: Size) -> list[str]:
    return [
        "## Test functions",
        text(
            f"""The smallest value after {size.budget} evaluations, median and mean of the seeds {FIRST} to
            {FIRST + size.test_seeds - 1}. The number is that of the dimensions. Minima: Branin 0.398,
            Hartmann -3.32, all others 0, `mixed` about 0."""
        ),
        minima_table(found),
        text(f"Smaller median than the search: {not_least(found)}."),
    ]


def _probabilities(found: Data, size: Size) -> list[str]:
    return [
        "## Probabilities that are known",
        text(
            f"""Analytic failures of p = {P:g} (`tools/campaign_study/estimates.py`), {size.repeats}
            estimates each with {BUDGET} evaluations and the seeds 0 to {size.repeats - 1}. `covered`: how
            many of the 95 % intervals contain p; from 91 to 99 of 100 agree with 95 %. `spread`: root mean
            square of the relative error. `high / low`: median ratio of the interval's ends. `fewer`:
            evaluations that Monte Carlo needs for the same spread, over those used. Methods: IS importance
            sampling, SuS subset simulation. Of two pockets the places are given, half a standard deviation
            off, as a search would find them:"""
        ),
        probability_table(found["given"]),
        text(
            f"""The same with the product's search for the pockets, a tenth of the {BUDGET} evaluations
            ({size.searched_repeats} estimates each):"""
        ),
        probability_table(found["searched"]),
    ]


def _check(found: Data, size: Size) -> list[str]:
    case, crude = product.FAILURES, found["crude"]
    without = crude["unjudged"] + sum(each["unknown"] for each in found["estimates"])
    pockets = ", ".join(str(each["pockets"]) for each in found["estimates"])
    return [
        "## A probability of real runs",
        text(
            f"""`{case.file}` with the reference ECU, varied `{"`, `".join(case.vary)}`: the probability
            that the rod is pressed with 90 N or more. {crude["count"]} random variants, {crude["failing"]}
            of which failed, and the product's estimate with {size.evaluations} evaluations and the sampling
            seeds 0 to {size.checks - 1}. `overlaps`: whether its interval overlaps that of the random
            variants. {without} variants had no margin. The searches before the estimates found places of
            {pockets} pockets."""
        ),
        check_table(found),
    ]
