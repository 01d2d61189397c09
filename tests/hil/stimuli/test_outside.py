"""Stimuli that act during a tick: each profile, each command, each figure arrives under its own name."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest
from hil_support import stimuli_alone

from liftgate_compiler import compiled
from liftgate_hil.signals import Timing
from liftgate_hil.stimuli.command_queue import HELD, LENGTH, post_values
from liftgate_hil.stimuli.moments import Instant, no_moments
from liftgate_hil.stimuli.stimulus_plan import Outside, TimedStimuli, outside_at, take_posted
from liftgate_hil.stimuli.timeline import Profile, TimedObstacle, obstacle_at, profiles_over
from liftgate_plant.dynamics import NO_OBSTACLE
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Surroundings
from tests.plant.distinct import distinct

BOTH = pytest.mark.parametrize("which", ["plain", "compiled"])


def called(function: Callable[..., Any], which: str) -> Callable[..., Any]:
    """Return the function itself ("plain") or its machine code ("compiled")."""
    return function if which == "plain" else compiled(function)


def by_name(around: Outside) -> dict[str, float]:
    """Commanded values by their names."""
    obstacle = {f"obstacle_{name}": value for name, value in around.commanded_obstacle._asdict().items()}
    return {**around.commanded._asdict(), **obstacle, **around.timing._asdict()}


def same(first: dict[str, float], second: dict[str, float]) -> bool:
    return first.keys() == second.keys() and all(
        first[name] == second[name] or (math.isnan(first[name]) and math.isnan(second[name])) for name in first
    )


@BOTH
def test_every_profile_changes_the_quantity_of_its_name(which: str) -> None:
    said = distinct(Surroundings)._asdict()
    # In another order than the catalogue's.
    stimuli = stimuli_alone(
        TimedStimuli({name: Profile([(0.0, said[name]), (1.0, said[name])]) for name in reversed(said)})
    )
    assert called(profiles_over, which)(stimuli.timeline, 0.5, 0.001)._asdict() == said
    around = called(outside_at, which)(stimuli, 0.5, 0.001, 0, False, False)
    assert around.profiles._asdict() == said


@BOTH
def test_a_timeline_without_profiles_sets_no_value(which: str) -> None:
    around = called(outside_at, which)(stimuli_alone(), 1.0, 0.001, 0, False, False)
    assert all(math.isnan(value) for value in around.profiles)
    assert all(math.isnan(value) for value in by_name(around).values())
    assert around.obstacle == NO_OBSTACLE


@BOTH
def test_every_field_of_a_timelines_obstacle_is_kept_under_its_name(which: str) -> None:
    obstacle = distinct(Obstacle)
    stimuli = stimuli_alone(TimedStimuli({}, [TimedObstacle(obstacle, Instant(1.0), Instant(2.0))]))
    assert called(obstacle_at, which)(stimuli.timeline, no_moments(), 1.5) == obstacle
    around = called(outside_at, which)(stimuli, 1.5, 0.001, 0, False, False)
    assert around.obstacle == obstacle


@BOTH
def test_every_commanded_value_is_held_under_its_name(which: str) -> None:
    numbers, stimuli = count(1.5), stimuli_alone()
    expected = dict.fromkeys(HELD._fields, math.nan)
    for name in reversed(HELD._fields):
        expected[name] = next(numbers)
        assert post_values(stimuli.queue, {name: expected[name]})
        called(take_posted, which)(stimuli, 0.0)
        around = called(outside_at, which)(stimuli, 0.0, 0.001, 0, False, False)
        assert same(by_name(around), expected), name
    assert stimuli.queue.head.tolist() == [len(HELD._fields)] * 2


def test_one_call_sets_several_unrelated_values() -> None:
    stimuli = stimuli_alone()
    obstacle, timing = distinct(Obstacle), distinct(Timing)
    body = {f"obstacle_{name}": value for name, value in obstacle._asdict().items()}
    assert post_values(stimuli.queue, {**timing._asdict(), **body, "hand_force_n": 2.0})
    take_posted(stimuli, 0.0)
    around = outside_at(stimuli, 0.0, 0.001, 0, False, False)
    assert around.commanded_obstacle == obstacle
    assert around.timing == timing
    others = around.commanded._replace(hand_force_n=math.nan)
    assert around.commanded.hand_force_n == 2.0
    assert all(math.isnan(value) for value in others)


def test_missed_ticks_and_the_silent_and_stop_flags_are_not_mixed_up() -> None:
    for silent in (False, True):
        for stop in (False, True):
            around = compiled(outside_at)(stimuli_alone(), 0.0, 0.001, 17, silent, stop)
            assert (around.ticks_missed, around.is_silent, around.is_stop) == (17, silent, stop)


@BOTH
def test_commands_are_applied_in_order_and_a_full_queue_refuses_more(which: str) -> None:
    stimuli = stimuli_alone()
    take, held = called(take_posted, which), stimuli.held
    for turn in range(3):
        for number in range(LENGTH):
            assert post_values(stimuli.queue, {"hand_force_n": 1000.0 * turn + number})
        assert not post_values(stimuli.queue, {"hand_force_n": -1.0})
        take(stimuli, 0.0)
        assert held[HELD.hand_force_n] == 1000.0 * turn + LENGTH - 1
        assert np.isnan(np.delete(held, HELD.hand_force_n)).all()
    take(stimuli, 0.0)
    assert stimuli.queue.head[1] == 3 * LENGTH
