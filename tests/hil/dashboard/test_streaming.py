"""Streaming of states to viewers that read at different speeds."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from liftgate_hil.dashboard.streaming import Viewers, merged


class Wire:
    """The WebSocket of a viewer that reads a message only on request."""

    def __init__(self) -> None:
        self.taken: list[Any] = []
        self._may_take = asyncio.Semaphore(0)

    async def send_text(self, text: str) -> None:
        await self._may_take.acquire()
        self.taken.append(json.loads(text))

    async def receive_text(self) -> str:
        await asyncio.Event().wait()
        raise AssertionError

    async def takes(self, count: int) -> None:
        for _ in range(count):
            self._may_take.release()
            await turns()


async def turns() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


def state(k: int, **more: Any) -> dict[str, Any]:
    span = {"low": [float(k), -float(k)], "high": [k + 0.5, 0.5 - k]}
    return {"number": 1, "time_s": float(k), "span": span, "log": [[k, 0.0, f"line {k}"]], **more}


def test_a_slow_viewer_gets_one_merged_state_in_place_of_several() -> None:
    async def go() -> tuple[Wire, Wire]:
        viewers, quick, slow = Viewers(), Wire(), Wire()
        serving = [asyncio.create_task(viewers.serve(each)) for each in (quick, slow)]  # type: ignore[arg-type]
        await turns()
        for k in range(1, 6):
            viewers.publish(state(k, **({"messages": ["of 3"]} if k == 3 else {})))
            await quick.takes(1)
        await slow.takes(3)
        for each in serving:
            each.cancel()
        await asyncio.gather(*serving, return_exceptions=True)
        return quick, slow

    quick, slow = asyncio.run(go())
    assert [each["time_s"] for each in quick.taken] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert [each["log"][0][0] for each in quick.taken] == [1, 2, 3, 4, 5]
    first, rest = slow.taken
    assert first["time_s"] == 1.0
    assert rest["time_s"] == 5.0
    assert [number for number, _, _ in rest["log"]] == [2, 3, 4, 5]
    assert rest["messages"] == ["of 3"]
    assert rest["span"] == {"low": [2.0, -5.0], "high": [5.5, -1.5]}


def test_merging_a_state_without_new_rows_keeps_the_earlier_extremes() -> None:
    assert merged(state(1), {"number": 1, "span": {}, "log": []})["span"] == state(1)["span"]
    assert merged({"number": 1, "span": {}}, state(2))["span"] == state(2)["span"]


def test_merging_ignores_nan_where_the_other_state_has_a_number() -> None:
    nan = {"number": 1, "span": {"low": [float("nan")], "high": [float("nan")]}}
    known = {"number": 1, "span": {"low": [2.0], "high": [3.0]}}
    assert merged(nan, known)["span"] == merged(known, nan)["span"] == known["span"]


def test_states_of_different_runs_are_not_merged() -> None:
    other = {"number": 2, "time_s": 0.0}
    assert merged(state(1, messages=["old"]), other) == other


def test_the_log_for_a_viewer_that_reads_nothing_is_limited() -> None:
    waiting = state(0)
    for k in range(1, 1000):
        waiting = merged(waiting, state(k))
    assert len(waiting["log"]) == 200
    assert waiting["log"][-1][0] == 999
