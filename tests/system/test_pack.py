"""The pack: scenarios that any gate ECU should pass. The reference ECU does; each of its mutants fails one."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

import liftgate_hil as lh
from liftgate_hil.config.shipped import shipped_folder
from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.plan.plan import Plan
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing import scenario_files, suite
from liftgate_hil.testing.outcome import Case

# For each mutant a scenario that is quick to find it; `make pack` runs all with all.
KILLERS = {
    "threshold_too_high": "trap_25deg_10npmm",
    "blanking_too_long": "trap_70deg_10npmm",
    "detection_too_slow": "trap_40deg_10npmm",
    "filter_too_slow": "trap_40deg_10npmm",
    "reference_follows": "trap_soft_body",
    "inertia_uncompensated": "undisturbed",
    "reversal_too_short": "trap_40deg_10npmm",
    "closing_too_fast": "trap_40deg_10npmm",
    "stall_unseen": "spindle_jammed",
    "latch_not_released": "undisturbed",
    "end_missed": "trap_70deg_10npmm",
    "learning_presses": "learning_with_obstacle",
    "closing_unwatched": "trap_40deg_10npmm",
    "opening_unwatched": "trap_soft_stop",
    "one_drive_watched": "trap_beside",
    "second_run_unwatched": "second_attempt",
    "only_stops": "trap_40deg_10npmm",
    "learns_disturbed": "ten_attempts",
    "stop_ignored": "stop_button",
    "latch_unseen": "undisturbed",
    "latch_believed": "latch_switch_stuck_latched",
    "one_drive_commanded": "undisturbed",
    "goes_on_after_reset": "reset_in_motion",
    "end_never_learned_again": "learning_with_obstacle",
    "stale_data_used": "feedback_lost",
    "counter_unchecked": "feedback_counter",
    "checksum_unchecked": "feedback_checksum",
    "hall_ignored": "hall_a_stuck",
    "frozen_current_unseen": "current_frozen",
    "lost_current_unseen": "motor_open",
    "over_current_unseen": "motor_short",
    "fall_unseen": "falling",
    "heat_ignored": "over_temperature",
}


@cache
def pack() -> dict[str, Case]:
    files = scenario_files.scenario_files(["pack"])
    job = Job(RunRequest())
    return {path.stem: case for path, case in zip(files, suite.cases_of(files, job), strict=True)}


def test_the_reference_ecu_passes_every_scenario_of_the_pack() -> None:
    assert len(pack()) >= 25
    done = {name: suite.run_case(case) for name, case in pack().items()}
    assert {name: each.verdict for name, each in done.items() if each.verdict != "pass"} == {}
    assert not [note for each in done.values() for note in each.notes if "too short" in note]


def test_each_scenario_of_the_pack_has_description_requirement_and_reason() -> None:
    folder = shipped_folder("scenarios", "pack")
    assert folder is not None
    for path in folder.glob("*.toml"):
        head = path.read_text(encoding="utf-8").split("\n\n")[0]
        assert re.fullmatch(r"(# .+\n?)+", head), path
        scenario = pack()[path.stem].plan.setup.scenario
        assert scenario.description, path
        assert scenario.requirement, path


def test_faults_waiting_for_the_gate_last_as_long_if_the_gate_is_late(tmp_path: Path) -> None:
    """Such a fault ends after its own duration or by a condition on the gate, not at a time of the run."""
    for name, case in pack().items():
        for fault in case.plan.setup.scenario.faults:
            if fault.start.condition:
                assert "time_s" not in fault.end.condition, name
                assert fault.end.condition or fault.end.time == math.inf, name
    for name in ("commands_stale", "supply_drop_out"):
        text = Path(pack()[name].plan.setup.scenario.source).read_text(encoding="utf-8")
        late = text.replace("time = 0.5", "time = 3.5")
        assert late != text
        (tmp_path / "late.toml").write_text(late, encoding="utf-8")
        assert lh.run(tmp_path / "late.toml").notes == ()


def test_an_ecu_that_stops_without_reversing_fails_the_reversal_expectations() -> None:
    """Movement alone is no reversal: the obstacle pushes the gate back, too."""
    turning = {
        name: case
        for name, case in pack().items()
        if any(each.name.startswith("turns back") for each in case.plan.setup.scenario.expectations)
    }
    assert len(turning) >= 20
    for name, case in turning.items():
        found = suite.run_case(mutated(case, "only_stops"))
        told = {each.name: each.verdict for each in found.expectations}
        assert {told[each] for each in told if each.startswith("turns back")} == {"fail"}, name


def mutated(case: Case, mutant: str) -> Case:
    """A case of the pack with a mutant of the reference ECU."""
    assert isinstance(case.plan, Plan)
    return replace(case, plan=case.plan.varied(case.job._replace(mutant=mutant)))


def test_every_mutant_has_a_scenario_named_to_kill_it() -> None:
    assert set(KILLERS) == set(MUTANTS)


@pytest.mark.parametrize("mutant", list(MUTANTS))
def test_a_scenario_kills_its_mutant(mutant: str) -> None:
    case = pack()[KILLERS[mutant]]
    found = suite.run_case(mutated(case, mutant))
    assert found.verdict == "fail", [each.verdict for each in found.expectations]
