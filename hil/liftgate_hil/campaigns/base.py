"""Base of a campaign: all that its variants have in common, with a hash of everything that determines a result.

It is picklable, and holds the content of its files: any process makes a variant from it without reading files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.space import DRAW, KEY, PARAMETER, SEED_OF_RUN, VariedTarget
from liftgate_hil.plan.plan import Plan
from liftgate_hil.plan.request import Job
from liftgate_hil.version import versions

ID_DIGITS = 32  # of a variant's hash: 128 bits, no two of 10¹² variants alike (birthday bound 1e-15)


@dataclass(frozen=True)
class Base:
    """Base of a campaign: the scenario, the vehicle, the ECU and the targets that all its variants share."""

    job: Job  # its scenario, vehicle and rig are loaded
    targets: tuple[VariedTarget, ...]
    expectations: tuple[str, ...]  # names, in the order of the columns
    versions: Mapping[str, str]
    identity: str  # SHA-256 of all that goes into a result, but for the values
    ecu: Mapping[str, Any]  # identity of the ECU, by its content
    margin_units: tuple[str, ...]  # of each expectation; "": none, or several

    def variant(self, values: Sequence[float] | Floats) -> str:
        """Return the name of the variant with values (d,), or of a batch (n, d): a hash of all that defines it."""
        content = bytes.fromhex(self.identity) + np.asarray(values, dtype="<f8").tobytes()
        return hashlib.sha256(content).hexdigest()[:ID_DIGITS]

    def job_of(self, values: Sequence[float]) -> Job:
        """Return the job that runs the variant with these values, one for each varied target."""
        own = self.job.request
        given = list(zip(self.targets, map(float, values), strict=True))
        parameters = {each.name: value for each, value in given if each.kind == PARAMETER}
        seeds = {each.kind: int(value) for each, value in given if each.kind in (SEED_OF_RUN, DRAW)}
        return self.job.asking(
            parameters={**own.parameter_values, **parameters},
            settings=(*own.settings, *settings_of(given)),
            seed=seeds.get(SEED_OF_RUN, own.seed),
            draw=seeds.get(DRAW, own.draw),
            ideal=own.ideal and DRAW not in seeds,
        )


def settings_of(given: Sequence[tuple[VariedTarget, float]]) -> list[str]:
    """Return varied keys of the vehicle file as KEY=VALUE texts; both coordinates of a point form one text."""
    points: dict[str, list[float]] = {}
    found: dict[str, str] = {}
    for target, value in given:
        if target.kind != KEY:
            continue
        if target.point is None:
            found[target.key] = repr(int(value)) if target.quantity and target.quantity.is_whole else repr(value)
        else:
            point = points.setdefault(target.key, list(target.point))
            point[int(target.name[-2])] = value
            found[target.key] = repr(point)
    return [f"{key}={text}" for key, text in found.items()]


def base_of(plan: Plan, targets: Sequence[VariedTarget]) -> Base:
    """Build the base of a campaign from the plan of its scenario, whose job has its files loaded."""
    job, setup = plan.job, plan.setup
    expectations = tuple(each.name for each in setup.scenario.expectations)
    known: dict[str, Any] = {
        "versions": versions(),
        "files": {purpose: each.sha256 for purpose, each in sorted(plan.sources.items())},
        "ecu": ecu_of(plan),
        "profiles": repr(setup.scenario.stimuli.profiles),  # also those of CSV files
        "rate": job.request.rate,
        "duration": plan.duration,
        "parameters": dict(setup.scenario.parameters),
        "settings": list(job.request.settings),
        "initial_rad": setup.start_angle,
        "seed": setup.seed,
        "variant": [job.request.draw, job.request.ideal],
        "varied": [[each.name, each.kind] for each in targets],
    }
    text = json.dumps(known, sort_keys=True, default=str)
    identity = hashlib.sha256(text.encode()).hexdigest()
    units = tuple(plan.expected.margin_unit(k) for k in range(len(expectations)))
    return Base(job, tuple(targets), expectations, versions(), identity, ecu_of(plan), units)


def ecu_of(plan: Plan) -> dict[str, object]:
    """Return the identity of a plan's ECU without its path, so that a copied library is the same ECU."""
    return {name: value for name, value in plan.ecu_identity.items() if name != "path"}
