"""What the runner's pipeline makes of a run: only the machine's own truth counts."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

BEGIN = 1_000_000_000_000
AXES = ("slew", "boom", "stick", "telescope")


@pytest.fixture(scope="module")
def runner(pipeline: Callable[[str], ModuleType]) -> Any:
    return pipeline("runner")


def record(
    runner: Any, stops_after: float, speed: float = 0.1, outcome: dict[str, Any] | None = None, drift: float = 0.0
) -> Any:
    """A machine that moves along x at ``speed`` [m/s]; its valves are shut ``stops_after`` seconds after a fault at 1 s."""
    time = np.arange(0.0, 6.0, 0.01)
    open_ = time <= 1.0 + stops_after
    x = 0.8 + speed * np.minimum(time, 1.0 + stops_after) + drift * np.maximum(time - 1.0 - stops_after, 0.0)
    truth = {"at_ns": BEGIN + time * 1e9, "ee.x": x, "ee.y": 0.0 * time, "ee.z": 0.3 + 0.0 * time}
    truth |= {f"{axis}.passed": 0.3 * open_ * (axis == "slew") for axis in AXES}
    lines = [("track", BEGIN, ""), ("fault", BEGIN + 10**9, "NaN"), ("verdict", BEGIN + 1_012_000_000, "not_finite hold x")]
    ended = {"ended": "stopped", "state": "ready", "why": "x"} if outcome is None else outcome
    return runner.RunRecord(lines, ended, truth, {}, BEGIN + 10**9)


def test_a_stop_is_measured_at_the_valves(runner: Any) -> None:
    row = runner.evaluated("NaN", record(runner, 0.25))
    assert row["reaction_ms"] == pytest.approx(12.0)
    assert row["neutral_ms"] == pytest.approx(250.0, abs=10.0)
    assert row["peak_motion_m"] == pytest.approx(0.026, abs=0.002)
    assert (row["state"], row["ok"]) == ("stopped", True)


def test_a_clamp_is_no_notice_of_a_fault(runner: Any) -> None:
    run = record(runner, 0.25)
    run.lines.insert(2, ("verdict", BEGIN + 1_007_000_000, "acceleration clamp acceleration of slew: 13.3, limit 1.9"))
    assert runner.evaluated("NaN", run)["reaction_ms"] == pytest.approx(12.0)
    goes_on = record(runner, 5.0, outcome={"ended": "time", "state": "ready"})
    goes_on.lines[-1] = ("verdict", BEGIN + 1_007_000_000, "acceleration clamp acceleration of slew: 13.3, limit 1.9")
    row = runner.evaluated("1 frame dropped", goes_on)
    assert (row["reaction_ms"], row["state"]) == (None, "goes on")


@pytest.mark.parametrize(
    ("run", "why"),
    [
        ({"stops_after": 0.25, "speed": 0.9}, "it left the fence"),
        ({"stops_after": 0.25, "drift": 0.05}, "it moves on"),
        ({"stops_after": 5.0, "outcome": {"ended": "time", "state": "ready"}}, "it went on where it had to stop"),
    ],
)
def test_what_is_not_as_it_should_be(runner: Any, run: dict[str, Any], why: str) -> None:
    assert not runner.evaluated("NaN", record(runner, **run))["ok"], why


def test_the_machines_own_time_out_counts_where_the_runner_is_dead(runner: Any) -> None:
    row = runner.evaluated("kill -9 of the runner", record(runner, 0.1, outcome={}))
    assert row["state"] == "machine's own time-out"
    assert row["reaction_ms"] == row["neutral_ms"] == pytest.approx(100.0, abs=10.0)
    assert row["ok"]


def test_a_refusal_has_to_be_wanted_and_nothing_may_have_moved(runner: Any) -> None:
    refused = {"ended": "refused", "state": "refused", "why": "another database"}
    assert runner.evaluated("wrong DBC", record(runner, 0.0, speed=0.0, outcome=refused))["ok"]
    assert not runner.evaluated("NaN", record(runner, 0.0, speed=0.0, outcome=refused))["ok"]
    assert not runner.evaluated("wrong DBC", record(runner, 0.0, outcome=refused))["ok"]


def test_a_run_that_ended_before_its_fault_proves_nothing(runner: Any) -> None:
    early = record(runner, 0.25)
    early.fault_ns = 0
    row = runner.evaluated("NaN", early)
    assert (row["state"], row["ok"]) == ("ended before the fault", False)


def test_a_machine_that_was_killed_leaves_no_motion_after(runner: Any) -> None:
    run = record(runner, 0.25, outcome={"ended": "stopped", "state": "fault"})
    run.truth = {name: values[:100] for name, values in run.truth.items()}
    row = runner.evaluated("kill -9 of the machine", run)
    assert row["ok"]
    assert row["neutral_ms"] is None


@pytest.mark.parametrize(
    ("run", "name", "ok"),
    [
        ({"stops_after": 0.25, "speed": 0.01}, "valve of boom turned", True),
        ({"stops_after": 0.25, "speed": 0.01, "outcome": {"ended": "done"}}, "valve of boom turned", False),
        ({"stops_after": 0.25, "speed": 0.01, "outcome": {"ended": "done"}}, "wired right", True),
        ({"stops_after": 0.25, "speed": 0.01}, "wired right", False),
        ({"stops_after": 0.25, "speed": 0.06}, "valve of boom turned", False),
        ({"stops_after": 1.25, "speed": 0.01}, "valve of boom turned", False),
        ({"stops_after": 0.25, "speed": 0.01, "outcome": {"ended": "refused"}}, "valve of boom turned", False),
    ],
)
def test_a_commissioning_finds_slowly_what_is_wrong_and_nothing_else(
    runner: Any, run: dict[str, Any], name: str, *, ok: bool
) -> None:
    row = runner.commissioning_row(name, record(runner, **run))
    assert row["ok"] is ok
    assert row["moved_for_s"] == pytest.approx(run["stops_after"], abs=0.02)
