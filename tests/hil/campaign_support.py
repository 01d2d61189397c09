"""Shared helpers of campaign tests: a scenario of one second, its variants, and an ECU in C that sends nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.campaign import Campaign, CampaignProgress, batches_of
from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.executors.executor import Batch, Executor
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.store import Store

VALUES = np.column_stack([np.linspace(60.0, 80.0, 24), np.linspace(9.5, 15.0, 24)])  # of `base_in`

SHORT = """
duration = 1.0
initial = "open"

[parameters]
angle = 75
rod = 10_000

[[request]]
time = 0.1
action = "close"

[[obstacle]]
angle_deg = "$angle"
stiffness = "$rod"

[[expect]]
name = "stays open"
always = "gate_angle_deg > $angle"
"""
_SILENT_ECU = """
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>
#include "liftgate_ecu.h"
static int steps;
void *liftgate_ecu_create(void) { return &steps; }
void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    (void)ecu; (void)now_ns; (void)in; (void)count; (void)out; (void)capacity;
    ++steps;
    EACH_STEP
    return 0;
}
"""


def silent_ecu(each_step: str = "") -> str:
    """Return the source of an ECU that sends nothing; `each_step` is C code run in each of its `steps`."""
    return _SILENT_ECU.replace("EACH_STEP", each_step)


def base_in(folder: Path, ecu: str = "reference") -> Base:
    """Return the base of the scenario of one second, whose file is made in a folder."""
    path = folder / "short.toml"
    path.write_text(SHORT)
    return prepared(CampaignRequest(str(path), ("angle=60,80", "supply.voltage=9.5,15"), ecu=ecu)).base


def campaign_in(
    folder: Path, base: Base, executor: Executor, stopped: Callable[[], bool] = lambda: False
) -> Campaign:
    """Return a campaign whose store is a folder."""
    store = Store(str(folder))
    store.create()
    return Campaign(base, executor, store, stopped, CampaignProgress(0), lambda progress: None)


def rows_of(campaign: Campaign, batches: list[Batch]) -> pa.Table:
    """Return the result rows of batches in their order, without the evaluation time."""
    return pa.concat_tables(list(campaign.tables(batches))).drop_columns(["wall_s"])


def evaluated(folder: Path, base: Base, executor: Executor, values: Floats = VALUES, size: int = 5) -> pa.Table:
    """Return the result rows of variants evaluated by an executor (see `rows_of`), and close the executor."""
    return evaluated_in(campaign_in(folder, base, executor), values, size)


def evaluated_in(campaign: Campaign, values: Floats = VALUES, size: int = 5) -> pa.Table:
    """Return the result rows of variants evaluated by a campaign, and close its executor."""
    batches = batches_of(campaign.base, values, size)
    try:
        campaign.evaluate(batches)
        return rows_of(campaign, batches)
    finally:
        campaign.executor.close()
