"""The closed loop in machine code: bit-identical on all clocks, in one piece and in many."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest
from hil_support import COMMAND, OF_DRIVES, OPEN, SLOWER, both, command_payload, decoded, frames_of, loop_config
from run_support import Keeper, ScriptedEcu, episode_of, message, releasing, reversing, run_kept

import liftgate_hil as lh
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.tick import STOPPED
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI


@pytest.fixture
def log(tmp_path: Path) -> tuple[Path, ...]:
    """The bus log to which a test records, as the argument `records`."""
    return (tmp_path / "bus.log",)


# The same bits.


@pytest.mark.parametrize("scenario", [reversing(), releasing()])
def test_an_episode_gives_the_same_bits_compiled_and_in_plain_python(
    scenario: Scenario, log: tuple[Path, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    fast, fast_keeper = run_kept(scenario, records=log)
    monkeypatch.setenv("LIFTGATE_COMPILE", "0")
    plain, plain_keeper = run_kept(scenario, records=log)
    assert fast.verdict == plain.verdict == "pass"
    assert fast_keeper.bits() == plain_keeper.bits()
    assert len(fast_keeper.frames) > 300
    assert fast.events == plain.events != []
    assert fast.summary == plain.summary
    # There was something to see.
    if scenario.initial == 39.0:
        assert fast.maxima["pinch_force_n"] > 100.0
        assert fast.maxima["gate_rate_degps"] > 1.0
    else:
        assert (fast.minima["latched"], fast.maxima["latched"]) == (0.0, 1.0)


def test_a_python_ecu_acts_the_same_with_a_compiled_and_a_plain_python_loop(
    rig: Rig, log: tuple[Path, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def says(turn: int) -> list[can.Message]:
        command = message(COMMAND, command_payload(rig, turn, **both(60.0, OPEN, release=1)))
        return [command, message(0x400, bytes(64), is_fd=True), message(0x401, is_remote_frame=True)]

    ecus, bits = [], []
    for compile_it in ("1", "0"):
        monkeypatch.setenv("LIFTGATE_COMPILE", compile_it)
        ecus.append(ScriptedEcu(says))
        scenario = Scenario(NO_STIMULI, (), 0.3)
        result, keeper = run_kept(scenario, ecus[-1], records=log)
        assert result.verdict == "pass", result.reason
        bits.append(keeper.bits())
    assert bits[0] == bits[1]
    for (time, frames), (other_time, others) in zip(*(ecu.heard for ecu in ecus), strict=True):
        assert time == other_time
        assert all(one.equals(other) for one, other in zip(frames, others, strict=True))


def recorded(folder: Path, scenario: Scenario, clock: str, **more: Any) -> tuple[bytes, list[str]]:
    """Return (the plant's recording, the lines of the bus log without the name of the bus)."""
    paths = [folder / f"{clock}.csv", folder / f"{clock}.log"]
    result = lh.run(scenario, clock=clock, record=paths, **more)
    assert result.verdict == "pass", result.reason
    lines = [" ".join(line.split()[::2]) for line in paths[1].read_text().splitlines()]
    return paths[0].read_bytes(), lines


@pytest.mark.parametrize("scenario", [reversing(), releasing()])
def test_the_free_and_the_lockstep_clock_give_the_same_bits(tmp_path: Path, scenario: Scenario) -> None:
    free, locked = (recorded(tmp_path, scenario, clock) for clock in ("free", "lockstep"))
    assert free[0] == locked[0]
    assert free[1] == locked[1]
    assert len(free[1]) > 300


def test_the_free_and_the_lockstep_clock_end_with_the_same_figures() -> None:
    one, other = (lh.run(reversing(), clock=clock) for clock in ("free", "lockstep"))
    assert (one.events, one.maxima, one.minima) == (other.events, other.maxima, other.minima)
    assert one.pinch_time_s == other.pinch_time_s
    assert one.summary.bus_load_percent == pytest.approx(other.summary.bus_load_percent)
    figures = [replace(each.summary, clock="", bus_load_percent=0.0) for each in (one, other)]
    assert figures[0] == figures[1]


def test_an_episode_repeats_bit_for_bit_and_differs_with_another_seed(log: tuple[Path, ...]) -> None:
    scenario = reversing()
    (_, first), (_, second) = (run_kept(scenario, records=log) for _ in range(2))
    _, other = run_kept(scenario, records=log, seed=2)
    assert first.bits() == second.bits()
    assert first.rows.shape == other.rows.shape
    # The truth is the same until the ECU has reacted to what it sees.
    sensed, true = (COLUMN_PLACE[name] for name in ("sensed_left_current_a", "left_current_a"))
    assert first.rows[0, sensed] != other.rows[0, sensed]
    assert first.rows[:20, true].tobytes() == other.rows[:20, true].tobytes()
    assert first.rows[-2, true] != other.rows[-2, true]


def test_the_seed_has_no_effect_without_noise(log: tuple[Path, ...]) -> None:
    scenario = Scenario(NO_STIMULI, (Request(Instant(0.05), "open"),), 1.0)
    (_, first), (_, second) = (run_kept(scenario, records=log, seed=seed, ideal=True) for seed in (1, 2))
    assert first.bits() == second.bits()


def test_recording_does_not_change_an_episode(log: tuple[Path, ...]) -> None:
    with_one, kept = run_kept(reversing(), records=log)
    without, bare = run_kept(reversing())
    assert kept.rows.tobytes() == bare.rows.tobytes()
    assert not len(bare.frames)
    assert replace(with_one.summary, recordings=[]) == without.summary
    assert with_one.events == without.events


def test_episodes_in_several_threads_do_not_affect_each_other() -> None:
    alone = {seed: run_kept(reversing(seed))[1].rows.tobytes() for seed in range(4)}
    together: dict[int, bytes] = {}

    def work(seed: int) -> None:
        for _ in range(3):
            together[seed] = run_kept(reversing(seed))[1].rows.tobytes()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in alone]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert together == alone


# Stretches.


def least_frames() -> int:
    """Size of the largest ring of frames that is refused; with one frame more it has room for any tick."""
    return 2 * (wire.CAPACITY + len(loop_config().outputs.messages))


@pytest.mark.parametrize(("rows", "frames"), [(7, 16_384), (4096, 5), (1, 1), (64, 200)])
def test_a_full_ring_interrupts_an_episode_without_losing_rows_or_frames(rig: Rig, rows: int, frames: int) -> None:
    whole = Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        episode = episode_of([whole], adapter)
        episode.run(900)
        episode.finish()
        events = adapter.events()
        episode.close()
    memory, pieces = Memory(rows, least_frames() + frames), Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        episode = episode_of([pieces], adapter, memory=memory)
        episode.run(900)
        episode.finish()
        assert adapter.events() == events
    assert pieces.bits() == whole.bits()
    assert len(pieces.blocks) > 3
    assert all(block[0] <= rows for block in pieces.blocks)
    memory.close()


def test_an_episode_run_in_pieces_equals_one_run_at_once(rig: Rig) -> None:
    whole, pieces = Keeper(), Keeper()
    for keeper, stops in ((whole, [500]), (pieces, [1, 2, 3, 10, 11, 250, 499, 500])):
        with ReferenceEcu(rig, 2) as adapter:
            episode = episode_of([keeper], adapter)
            for stop in stops:
                episode.run(stop)
                assert episode.time == pytest.approx(stop * 0.001)
            episode.close()
    assert whole.bits() == pieces.bits()
    assert [rows for rows, _ in pieces.blocks] == [1, 1, 1, 7, 1, 239, 249, 1]


def test_a_ring_too_small_for_a_tick_is_refused(rig: Rig) -> None:
    memory = Memory(4096, least_frames())
    with ReferenceEcu(rig, 2) as adapter, pytest.raises(ValueError, match="frames"):
        episode_of([], adapter, memory=memory)
    memory.close()


def test_an_episode_asked_to_stop_ends_after_the_current_piece(rig: Rig) -> None:
    memory, keeper = Memory(100, 16_384), Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        episode = episode_of([keeper], adapter, memory=memory)
        episode.run(900, stopped=lambda: episode.state.tick >= 300)
        assert episode.state.tick == 300
        episode.finish()
    assert len(keeper.rows) == 301
    memory.close()


def test_an_episode_stopped_before_it_began_makes_only_its_last_tick(rig: Rig) -> None:
    keeper = Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        episode = episode_of([keeper], adapter)
        episode.run(900, stopped=lambda: True)
        episode.finish()
        episode.close()
    assert len(keeper.rows) == 1


def test_the_last_tick_has_the_motors_off_and_sends_everything(rig: Rig) -> None:
    keeper = Keeper()
    with ReferenceEcu(rig, 2) as adapter:
        episode = episode_of([keeper], adapter)
        episode.run(603)
        driven = keeper.rows[-1]
        episode.finish()
        episode.close()
    place = COLUMN_PLACE
    assert driven[place["left_duty"]] < 0.0
    assert driven[place["left_coast"]] == 0.0
    last = keeper.rows[-1]
    assert last[place["left_coast"]] == last[place["right_coast"]] == 1.0
    frames = [row for row in keeper.wires(is_sent=True) if row[0] == 604.0]
    assert sorted(identifier for _, identifier, _ in frames) == [*OF_DRIVES, *SLOWER]
    status = decoded(rig, frames_of([(number, data) for _, number, data in frames]), "BenchStatus")
    assert status[0]["EmulatorState"] == STOPPED
