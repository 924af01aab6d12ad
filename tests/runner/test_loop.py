"""A run from idle to rest, and what each fault makes of it: which check objects, how soon, which state stays."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from runner_case import DT, MIDDLE, PLANT, Case, Memory, Quick, case, inverse

from sysid_rl.run import faults as f
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.faults import FaultyTransport, Injection
from sysid_rl.run.limits import AxisLimits, Limits, LimitSettings
from sysid_rl.run.modes.hold import Hold, Shadow, Teleop
from sysid_rl.run.modes.mode import Mode
from sysid_rl.run.modes.replay import ReplayJoints
from sysid_rl.run.modes.track import TrackPath
from sysid_rl.run.operator import Unattended
from sysid_rl.train.paths import Path as Course

Array = npt.NDArray[np.float64]
EE = Quick(PLANT).predict(MIDDLE)[0]
#: When the machine is in full motion [s].
AT = 2.2


def sweep(seconds: float = 4.0) -> Course:
    """A round in front of the machine that begins and ends where it stands."""
    phase = 2.0 * np.pi * np.arange(round(100 * seconds) + 1) / round(100 * seconds)
    points = EE + np.column_stack([-0.1 + 0.1 * np.cos(phase), 0.12 * np.sin(phase), 0.0 * phase])
    return Course("round", 100.0, points)


def tracking(limits: Limits, chain: ControlChain) -> Mode:
    path = sweep()
    start, _ = inverse().solve(path.points[:1], MIDDLE[None])
    return TrackPath(path, start[0], limits, DT, ahead=chain.ahead)


def run(mode: Callable[[Limits, ControlChain], Mode] = tracking, *plan: Injection, **settings: object) -> Case:
    made = case(mode, plan=plan, **settings)  # type: ignore[arg-type]
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    return made


def test_the_line_is_opened_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """Locking memory takes seconds, in which nobody would read."""
    made = case(tracking)
    order: list[str] = []

    @contextmanager
    def slow(priority: int, lock: bool) -> Iterator[tuple[str, ...]]:
        order.append("locked")
        yield ()

    def notify(name: str) -> None:
        whole = getattr(made.transport, name)
        monkeypatch.setattr(made.transport, name, lambda *given: (order.append(name), whole(*given))[1])

    monkeypatch.setattr("sysid_rl.run.loop.real_time", slow)
    for name in ("open", "read", "close"):
        notify(name)
    made.loop.run()
    assert order[:3] == ["locked", "open", "read"]
    assert order.count("open") == order.count("close") == 1
    assert order[-1] == "close"


def test_a_run_from_idle_to_rest() -> None:
    made = run()
    outcome = made.loop.outcome
    assert made.states() == ["idle", "ready", "armed", "running", "stopping", "ready"]
    assert (outcome.ended, outcome.state, outcome.missed) == ("done", "ready", 0)
    assert not outcome.verdicts
    rows = [
        (cycle.target, after.ee) for cycle, after in zip(made.cycles, made.cycles[1:], strict=False) if cycle.source == "track"
    ]
    error = np.array([ee - target for target, ee in rows])
    assert np.sqrt((error**2).mean(axis=0)).max() < 2e-3
    assert made.machine.neutral
    assert outcome.lateness.count == outcome.cycles == len(made.cycles)


def test_a_dead_man_that_is_held_all_the_time_starts_nothing() -> None:
    class Taped(Unattended):
        def commands(self, state: str, now_ns: int) -> list[str]:  # type: ignore[override]
            said = list(super().commands(state, now_ns))  # type: ignore[arg-type]
            self.machine.set_inputs(dead_man=True)
            return said

    made = run(operator=Taped, seconds=1.5)
    assert made.states() == ["idle", "ready", "armed"]
    assert not any(cycle.enabled for cycle in made.cycles)


@dataclass(frozen=True)
class Row:
    """A fault, the check that has to object, within how long [s], and the state that stays."""

    fault: object
    check: str
    within: float
    state: str
    lasts: float = 10.0


ROWS = [
    Row(f.DroppedFrames(), "stale", 0.06, "fault"),
    Row(f.DroppedFrames(("boom.cylinder",)), "stale", 0.06, "fault"),
    Row(f.Frozen("slew.joint"), "frozen", 0.7, "fault"),
    Row(f.Frozen("stick.cylinder"), "frozen", 0.7, "fault"),
    Row(f.Delayed(0.2), "stale", 0.02, "fault"),
    Row(f.NotANumber("slew.joint"), "not_finite", 0.02, "fault"),
    Row(f.Jumped("telescope.joint", 0.05), "jump", 0.02, "fault"),
    Row(f.Scaled("boom.cylinder", 1.3), "jump", 0.02, "fault"),
    Row(f.Scaled("stick.joint", 0.5), "jump", 0.02, "fault"),
    Row(f.Unplugged("slew.joint"), "stale", 0.02, "fault"),
    Row(f.BusOff(), "machine", 0.02, "fault"),
    Row(f.BusOff(silent=True), "stale", 0.06, "fault"),
    Row(f.WritesLost(), "motion", 1.5, "fault"),
    Row(f.Paused(0.3), "expired", 0.32, "fault"),
    Row(f.ReadFails(), "line", 0.02, "fault"),
    Row(f.ClockJumped(1.0), "clock", 0.02, "fault"),
    Row(f.ClockJumped(-1.0), "stale", 0.02, "fault"),
    Row(f.EmergencyPressed(), "emergency", 0.02, "fault", 0.1),
    Row(f.DeadManReleased(), "dead_man", 0.02, "ready", 0.1),
    Row(f.MachineReportsFault("valve driver"), "machine", 0.02, "fault", 0.1),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row.fault))
def test_each_fault_is_seen_in_time_and_ends_in_its_state(row: Row) -> None:
    made = run(tracking, Injection(row.fault, AT, AT + row.lasts))  # type: ignore[arg-type]
    first = made.verdicts().get(row.check)
    assert first is not None, made.verdicts()
    assert made.cycles[round(AT / DT) - 2].state == "running"
    assert (made.cycles[first].at_ns / 1e9) - AT <= row.within + 1e-6
    assert made.states()[-1] == row.state, made.loop.outcome.notes
    assert not made.cycles[-1].enabled
    last = np.array(made.machine.drives[-3:])  # what is left of the valves' lag
    assert np.ptp(last, axis=0).max() < 5e-4


@pytest.mark.parametrize("frames", [1, 3])
def test_a_few_lost_frames_are_nothing(frames: int) -> None:
    made = run(tracking, Injection(f.DroppedFrames(), AT, AT + frames * DT - 1e-4))
    assert made.loop.outcome.ended == "done"
    assert not made.verdicts()


def test_a_short_gap_is_held_through() -> None:
    made = run(tracking, Injection(f.DroppedFrames(), AT, AT + 0.08))
    assert made.loop.outcome.ended == "done"
    assert next(iter(made.verdicts())) == "stale"
    assert set(made.verdicts()) <= {"stale", "speed", "acceleration", "jerk"}, "it catches up within its limits"
    assert "hold" in {cycle.source for cycle in made.cycles}


class Answers:
    """A policy that is inverse kinematics until it is not."""

    inputs = (*(f"{axis}.joint" for axis in ("slew", "boom", "stick", "telescope")),
              *(f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz"))  # fmt: skip
    outputs = inputs[:4]

    def __init__(self, wrong: Array | None, after: int = 60) -> None:
        self._wrong, self._left, self._last = wrong, after, None

    def act(self, observations: Array) -> Array:
        self._left -= 1
        if self._left < 0:
            if self._wrong is None:
                raise ValueError("no answer")
            return self._wrong[None]
        self._last, _ = inverse().solve(observations[:, 7:10], observations[:, :4] if self._last is None else self._last)
        return self._last.copy()


@pytest.mark.parametrize("wrong", [np.full(4, np.nan), np.array([9.0, 0.0, -1.0, 0.1]), None], ids=["nan", "extreme", "raises"])
def test_a_policy_that_fails_is_taken_off_and_the_fallback_goes_on(wrong: Array | None) -> None:
    made = run(tracking, policy=Answers(wrong))
    assert made.loop.outcome.ended == "done"
    assert list(made.verdicts()) == ["policy"]
    sources = [cycle.source for cycle in made.cycles]
    assert "fallback" in sources
    assert "track" not in sources[sources.index("fallback") :], "it is not asked again"
    made = run(tracking, policy=Answers(wrong), fallback="hold", seconds=4.0)
    assert made.cycles[-60].source in ("hold", "stop")


def test_a_hold_that_begins_in_motion_comes_to_rest() -> None:
    made = run(tracking, policy=Answers(np.full(4, np.nan), after=150), fallback="hold", seconds=7.0)
    held = np.array([cycle.setpoints for cycle in made.cycles if cycle.source == "hold"])
    assert len(held) > 100
    assert np.abs(held[1] - held[0]).max() > 1e-4, "it was in motion"
    assert np.ptp(held[-100:], axis=0).max() < 1e-6, "it stands"
    assert np.abs(held[-1] - held[0]).max() < 0.01, "where it began"


def test_a_full_disk_stops() -> None:
    made = run(recorder=Memory(fails_at=220))
    assert made.loop.outcome.ended == "stopped"
    assert "disk full" in made.loop.outcome.why


def test_a_fault_waits_for_a_person_and_is_not_reset_while_it_lasts() -> None:
    class Person(Unattended):
        stays = True

    def person(machine: FaultyTransport) -> Person:
        return Person(machine, [(AT + 0.1, "arm"), (AT + 0.15, "reset"), (AT + 0.8, "reset"), (AT + 1.5, "quit")])

    made = run(tracking, Injection(f.EmergencyPressed(), AT, AT + 0.5), operator=person)
    # the machine behind keeps its button pressed until it is released there
    assert made.states()[-1] == "fault"
    lines = "\n".join(made.operator.lines)  # type: ignore[attr-defined]
    assert "'arm' while fault (emergency stop); expected reset" in lines
    assert "not reset while it lasts: emergency stop" in lines


@pytest.mark.parametrize("mode", [lambda limits, chain: Shadow(tracking(limits, chain)), lambda limits, chain: Teleop()])
def test_who_watches_sends_nothing(mode: Callable[[Limits, ControlChain], Mode], monkeypatch: pytest.MonkeyPatch) -> None:
    def never(self: object, commands: object, enabled: bool) -> None:
        raise AssertionError("something was sent")

    monkeypatch.setattr(FaultyTransport, "write", never)
    made = run(mode, seconds=3.0)
    assert made.states() == ["idle", "ready"]
    requested = np.array([cycle.requested for cycle in made.cycles])
    assert np.isfinite(requested).any() == (made.loop.mode.name == "shadow")


def test_holding_stays() -> None:
    made = run(lambda limits, chain: Hold(DT, 1.0))
    assert made.loop.outcome.ended == "done"
    assert np.ptp(np.array(made.machine.joints), axis=0).max() < 3e-3


def test_a_run_loads_no_torch() -> None:
    text = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_loop as t; t.run(lambda a, b: t.Hold(t.DT, 0.2)); "
        "import sysid_rl.cli.run, sysid_rl.run.assemble, sysid_rl.run.transports, sysid_rl.run.dry_run; "
        "assert 'torch' not in sys.modules, 'torch is loaded'"
    )
    here = Path(__file__).parent
    env_path = [str(here), str(here.parent / "helpers")]
    program = f"import sys; sys.path[:0] = {env_path!r}; {text}"
    done = subprocess.run([sys.executable, "-c", program, str(here)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_machine_that_stands_outside_comes_back_in_and_is_told_so() -> None:
    narrow = LimitSettings(axes={"slew": AxisLimits(low=0.05, high=1.0)})
    made = run(
        lambda limits, chain: ReplayJoints(np.tile(MIDDLE + np.array([0.3, 0.0, 0.0, 0.0]), (20, 1)), limits, DT), limits=narrow
    )
    assert made.loop.outcome.ended == "done"
    assert "slew is at" in "\n".join(made.loop.outcome.notes)
    joints = np.array(made.machine.joints)[:, 0]
    assert joints.min() > -2e-3
    assert abs(joints[-1] - 0.3) < 5e-3
