"""Commands that are held up on the way: what the simulated machine makes of them. Runner and machine in process, no clock."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from live_machine import DATABASE, ROOT, SIGNALS, VALVES, old_database

from simulated_bench.live import COLUMNS, LiveProcess
from simulated_bench.live_bus import CanFrame
from simulated_bench.live_machine import LATE_NS, TIME_OUT_NS, Watchdog
from simulated_bench.recipe_file import load_recipe
from sysid_rl.run.bus import BusSettings, MachineBus
from sysid_rl.run.line_delay import MachineClock

MS = 1_000_000
CYCLE = 10 * MS
#: A stamp is cut off to 1 ms; a command waits for the machine's next step.
STEP = 2 * MS


def run(database: Path, late: Callable[[int], int], turns: int = 150) -> tuple[list[int], np.ndarray, Watchdog]:
    """Each cycle sends a command of its own, which comes ``late(cycle)`` cycles later, 1 ms after the machine's cycle began.

    Returns:
        How late each command was that was executed [ns], and each row of the machine's truth.
    """
    process = LiveProcess(load_recipe(ROOT / "datasets/autolog/bench.toml"), database)
    process.switches.dead_man = True
    bus = MachineBus(BusSettings(database, SIGNALS, VALVES), "test")
    clock = MachineClock()
    waits: dict[int, list[CanFrame]] = {}
    rows = []
    for turn in range(turns):
        end = (turn + 1) * CYCLE
        frames, row = process.cycle(end)
        rows.append(row)
        for frame in frames:
            heard = bus.decode(frame.identifier, frame.extended, frame.data)
            if heard is not None and heard.message == "MACHINE_STATUS":
                clock.tick(heard.values["time"], end)
        # One step of the valve a cycle: each value is of one cycle alone.
        said = bus.encode([(turn + 1) / 250.0] * 4, True, clock.now(end + MS))
        waits.setdefault(turn + late(turn), []).extend(CanFrame(number, True, data) for number, data in said)
        process.received_frames(waits.pop(turn, []), end + MS)
    table = np.array(rows)
    passed = table[:, COLUMNS.index("boom.passed")]
    late_by = []
    for value in np.unique(passed[passed > 0.0]):
        turn = round(float(value) * 250.0) - 1
        first = int(np.argmax(passed == value))
        late_by.append((first - turn - 1) * CYCLE)
    return late_by, table, process.watchdog


@pytest.mark.parametrize("turns", [7, 10, 11, 50])
def test_commands_that_are_held_up_are_not_executed(tmp_path: Path, turns: int) -> None:
    """From cycle 50 on the line holds them up; before, it works. They were executed 100 to 500 ms late."""
    late, table, watchdog = run(DATABASE, lambda turn: turns if turn >= 50 else 0)
    assert len(late) == 50
    assert max(late) <= CYCLE
    assert watchdog.refused > 0
    assert watchdog.fault == 3, "and the machine says why its valves are neutral"
    passed = table[:, COLUMNS.index("boom.passed")]
    assert np.flatnonzero(passed)[-1] * CYCLE - 50 * CYCLE <= TIME_OUT_NS
    old, _, _ = run(old_database(tmp_path), lambda turn: turns if turn >= 50 else 0)
    assert max(old) >= turns * CYCLE, "without a stamp they are"


@pytest.mark.parametrize("turns", [1, 3, 4])
def test_commands_within_60_ms_are_executed(turns: int) -> None:
    late, _, watchdog = run(DATABASE, lambda turn: turns)
    assert len(late) > 100
    assert max(late) <= LATE_NS
    assert watchdog.refused == 0


def test_a_burst_after_a_hold_up_brings_only_what_is_fresh() -> None:
    """Eleven sets come at once: of them those of the last 60 ms."""
    late, _, watchdog = run(DATABASE, lambda turn: 60 - turn if 49 <= turn < 60 else 0)
    assert max(late) <= LATE_NS
    assert watchdog.fault == 0, "and it goes on"


def test_that_nobody_commands_is_heard_at_any_age() -> None:
    watchdog = Watchdog()
    for axis in range(4):
        watchdog.command(axis, 0.4, True, 0)
    watchdog.alive(1, True, 0)
    watchdog.command(1, 0.0, False, MS, 10**12)
    assert not watchdog.passed(MS).any()


def test_a_command_is_forgotten_100_ms_after_what_it_answers() -> None:
    watchdog = Watchdog()
    for axis in range(4):
        watchdog.command(axis, 0.4, True, 40 * MS, 40 * MS)
    watchdog.alive(1, True, 40 * MS)
    assert watchdog.passed(100 * MS).any()
    assert not watchdog.passed(101 * MS).any()


@pytest.mark.parametrize("age", [-LATE_NS, LATE_NS + 1])
def test_a_stamp_of_the_future_or_the_past_is_none(age: int) -> None:
    watchdog = Watchdog()
    watchdog.alive(1, True, 0)
    for axis in range(4):
        watchdog.command(axis, 0.4, True, 0, age)
    assert not watchdog.passed(0).any()
