"""The simulation of the scheduling of campaigns, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from liftgate_hil.campaigns.campaign import batch_size
from tools.scheduling import remedy
from tools.scheduling.check import Run, work_of
from tools.scheduling.figures import CODE, Figures, Rules, rows_of
from tools.scheduling.model import Case, simulate

# Everything takes no time but what a test is about.
NOTHING = replace(
    Figures(),
    batch_scatter=0.0, start_s=0.0, task_s=0.0, row_s=0.0, slow_share=0.0, deaths=0.0, put_s=0.0, put_row_s=0.0,
    latency_s=0.0, store_rate=1e12, list_s=0.0, hash_s=0.0, submit_s=0.0, result_s=0.0, poll_s=0.0, sleep_s=0.0,
    scheduler_s=0.0, merge_s=0.0, merge_row_s=0.0, summary_row_s=0.0,
)  # fmt: skip
VARIANT = NOTHING.variant_s


@pytest.mark.parametrize(("batches", "workers"), [(1, 1), (7, 3), (12, 4), (3, 8)])
def test_without_noise_the_simulated_time_is_that_of_the_rounds(batches: int, workers: int) -> None:
    figures = replace(NOTHING, start_s=2.0, summary_row_s=1e-3)
    found = simulate(Case(10 * batches, workers, size=10), figures)
    expected = 2.0 + math.ceil(batches / workers) * 10 * VARIANT + 10 * batches * 1e-3
    assert found.seconds == pytest.approx(expected)
    assert found.files == batches
    assert found.busy_s == pytest.approx(10 * batches * VARIANT)


@pytest.mark.parametrize(("jobs", "cores"), [(1, 2), (2, 2), (4, 2), (8, 2), (3, 1.5)])
def test_more_workers_than_cores_share_the_cores(jobs: int, cores: float) -> None:
    found = simulate(Case(240, jobs, cores, size=10), replace(NOTHING, start_s=1.0))
    work = jobs * 1.0 + 240 * VARIANT
    assert found.seconds == pytest.approx(work / min(jobs, cores))


@pytest.mark.parametrize("deaths", [0.0, 20.0, 200.0])
@pytest.mark.parametrize("is_cluster", [True, False])
def test_each_variant_is_counted_once_and_each_second_is_attributed(deaths: float, is_cluster: bool) -> None:
    figures = replace(Figures(), deaths=deaths, slow_share=0.1)
    case = Case(10_007, 13, 4.0, is_cluster)
    found = simulate(case, figures)
    assert found.evaluated == case.variants
    assert (found.deaths > 0) == (deaths > 0.0)
    assert found.busy_s + sum(found.lost.values()) == pytest.approx(case.workers * found.seconds)
    assert min(found.lost.values()) >= -1e-6


@pytest.mark.parametrize("cost", [0.001, 0.01, 0.05, 0.2, 1.0])
def test_throughput_saturates_at_the_schedulers_rate(cost: float) -> None:
    """A server with a fixed time per variant: its rate is the lesser of the workers' rate and 1 / cost."""
    workers, size, batches = 20, 100, 4000
    figures = replace(NOTHING, scheduler_s=cost)
    found = simulate(Case(size * batches, workers, size=size), figures)
    rate = min(workers / (size * VARIANT), 1.0 / cost)
    assert batches / found.seconds == pytest.approx(rate, rel=0.03)
    assert found.bottleneck == ("scheduler" if 1.0 / cost < workers / (size * VARIANT) else found.bottleneck)


def test_efficiency_falls_with_the_clients_cost() -> None:
    found = [
        simulate(Case(400_000, 20, size=100), replace(NOTHING, submit_s=cost, result_s=cost))
        for cost in (0.0, 0.01, 0.1, 0.3)
    ]
    efficiencies = [each.efficiency for each in found]
    assert efficiencies == sorted(efficiencies, reverse=True)
    assert 4000 / found[-1].seconds == pytest.approx(1.0 / 0.6, rel=0.02)
    assert found[-1].bottleneck == "client"


def test_a_workers_death_costs_its_batch_and_a_new_start() -> None:
    """For a batch of work W, deaths at rate λ cost (exp(λW) − 1)/λ − W on average."""
    rate, size = 100.0, 1000
    found = simulate(Case(size * 20_000, 10, size=size), replace(NOTHING, deaths=rate, seen_s=0.0))
    per_s, work = rate / 3600.0, size * VARIANT
    lost = (math.exp(per_s * work) - 1.0) / per_s - work
    assert found.lost["deaths"] / 20_000 == pytest.approx(lost, rel=0.05)


def test_the_simulation_is_repeatable_and_depends_on_the_seed() -> None:
    figures, case = replace(Figures(), deaths=5.0), Case(20_000, 7)
    assert simulate(case, figures, seed=3) == simulate(case, figures, seed=3)
    assert simulate(case, figures, seed=3) != simulate(case, figures, seed=4)


def test_merging_results_during_the_campaign_costs_no_time_if_the_client_is_idle() -> None:
    figures = replace(NOTHING, merge_s=0.01)
    case = Case(100_000, 10, size=100)
    after = simulate(case, figures, replace(CODE, is_merged_meanwhile=False))
    meanwhile = simulate(case, figures)
    assert after.seconds - meanwhile.seconds == pytest.approx(1000 * 0.01, rel=0.2)


def test_the_simulations_batch_sizes_are_those_of_campaigns() -> None:
    for variants in (1, 1000, 10**6, 10**8):
        for workers in (1, 100, 2000):
            assert CODE.size(variants, workers, VARIANT) == batch_size(variants, workers, VARIANT)
            own = Rules(CODE.passing_s, CODE.most_files + 1)
            assert own.size(variants, workers, VARIANT) in {
                batch_size(variants, workers, VARIANT), -(-variants // (CODE.most_files + 1))
            }  # fmt: skip


def test_start_and_variant_times_follow_from_two_runs() -> None:
    few, many = (Run(1, n, 10, 0.0, 0.8 + n * 0.012, 2.0) for n in (60, 600))
    assert work_of(few, [many]) == (pytest.approx(0.8), pytest.approx(0.012))


def test_each_figure_has_a_meaning_and_a_source() -> None:
    rows = rows_of(Figures())
    assert all(meaning and source for meaning, _, _, source in rows)
    assert len({meaning for meaning, *_ in rows}) >= len(rows) - 3


def test_no_remedy_makes_a_campaign_slower() -> None:
    steps = remedy.steps(Case(10**6, 500), Figures())
    times = [each.result.seconds for each in steps]
    assert times[-1] < times[0]
    assert all(after <= before * 1.02 for before, after in pairwise(times))
