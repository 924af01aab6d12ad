"""The first move after a start: slow until every axis has answered, whatever is wired wrong; released where nothing is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from runner_case import DT, MIDDLE, PLANT, Case, Quick, case
from test_commission import DRIVEN, STANDS, off
from test_loop import tracking

from sysid.machine import KnownEffect
from sysid.plant import Plant
from sysid_rl.control import tune
from sysid_rl.run import faults as f
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.checks.settings import CheckSettings, MotionCheck, PathCheck
from sysid_rl.run.faults import Fault, Injection
from sysid_rl.run.limits import Limits
from sysid_rl.run.modes.commission import Commission, CommissionSettings
from sysid_rl.run.modes.hold import Hold
from sysid_rl.run.modes.mode import Goal, Mode
from sysid_rl.run.modes.replay import ReplayCommands, ReplayJoints
from sysid_rl.run.response_range import ResponseRange, Tolerance
from sysid_rl.run.task_clock import TaskClock
from sysid_rl.run.valves import axis_valves

Array = npt.NDArray[np.float64]
VALVES = axis_valves(tune(PLANT), DT)
#: Ways of the joints that move the boom tip by 0.2 to 0.3 m [rad or m].
WAYS = np.array([0.35, 0.25, 0.35, 0.06])


def swing(limits: Limits, chain: ControlChain) -> Mode:
    return ReplayJoints(np.tile(MIDDLE + np.array([0.4, -0.25, 0.45, 0.08]), (20, 1)), limits, DT)


def alone(axis: int) -> Callable[[Limits, ControlChain], Mode]:
    """One axis alone goes forth and back within 6 s."""
    s = np.sin(np.pi * np.linspace(0.0, 1.0, 600))[:, None] ** 2
    return lambda limits, chain: ReplayJoints(MIDDLE + s * WAYS * (np.arange(4) == axis), limits, DT)


def moved(
    mode: Callable[[Limits, ControlChain], Mode], *faults: Fault, true: Plant = PLANT, seed: int = 0, wider: float = 0.0
) -> Case:
    plan, off_path = [Injection(fault, 0.0) for fault in faults], PathCheck(distance=0.1 if wider else 0.03)
    checks = CheckSettings(motion=MotionCheck(wider=wider), path=off_path)
    made = case(
        mode, true=true, plan=plan, seed=seed, checks=checks,
        first_move=True, settle_s=0.5, ready_within_s=2.0, seconds=25.0,
    )  # fmt: skip
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    return made


def slow(made: Case) -> tuple[float, float]:
    """Greatest speed of the boom tip [m/s], and how far it went from where it began [m]."""
    ends, over = np.array(made.machine.ends), round(0.05 / DT)
    fast = np.linalg.norm(ends[over:] - ends[:-over], axis=1).max() / 0.05
    return float(fast), float(np.linalg.norm(ends - ends[0], axis=1).max())


def wrong_wiring() -> list[tuple[str, int, Fault]]:
    """Name, axis that moves first, fault."""
    found: list[tuple[str, int, Fault]] = []
    for a in range(4):
        signal = DRIVEN[a]
        found += [
            (f"valve {a} turned", a, f.ValveTurned(a)), (f"valve {a} dead", a, f.ValveDead(a)),
            (f"sensor {a} turned", a, f.Scaled(signal, -1.0, STANDS[signal])), (f"sensor {a} dead", a, f.Frozen(signal)),
        ]  # fmt: skip
        for b in range(4):
            if a != b:
                found += [
                    (f"valves {a} {b} swapped", a, f.ValvesSwapped(a, b)),
                    (f"sensors {a} {b} swapped", a, f.Swapped(signal, DRIVEN[b])),
                    (f"message of {a} also for valve {b}", a, f.ValveShared(a, b)),
                    (f"message of {b} also for valve {a}", a, f.ValveShared(b, a)),
                    (f"sensor {a} also for {b}", a, f.SensorShared(signal, DRIVEN[b])),
                    (f"sensor {b} also for {a}", a, f.SensorShared(DRIVEN[b], signal)),
                ]
    return found


WIRING = wrong_wiring()
FEW = WIRING[::9]


def check(axis: int, fault: Fault, true: Plant, seed: int, far: float, top: float, wider: float = 0.0) -> None:
    made = moved(alone(axis), fault, true=true, seed=seed, wider=wider)
    assert made.loop.outcome.ended != "done"
    fast, way = slow(made)
    if isinstance(fault, f.ValveShared) and fault.one == axis:
        # The axis itself is wired right, and may be released before the other valve opens.
        drives, ratios = np.array(made.machine.drives)[:, fault.other], np.array([0.9, 15.2, 9.2, 1.0])
        fast, way = 0.0, float(np.ptp(drives)) * ratios[fault.other]
    assert fast <= top
    assert way <= far, made.loop.outcome.why


@pytest.mark.parametrize(("axis", "fault"), [row[1:] for row in FEW], ids=[row[0] for row in FEW])
def test_wrong_wiring_moves_little_and_slowly(axis: int, fault: Fault) -> None:
    check(axis, fault, PLANT, 0, 0.025, 0.055)


@pytest.mark.parametrize(("axis", "fault"), [row[1:] for row in FEW], ids=[row[0] for row in FEW])
def test_wrong_wiring_is_found_where_dead_bands_are_not_known(axis: int, fault: Fault) -> None:
    """A reading that is not the axis's own, and stands, permits most: the command rises until it is beyond any dead-band."""
    blind = isinstance(fault, f.SensorShared)
    check(axis, fault, PLANT, 0, 0.30 if blind else 0.025, 0.25 if blind else 0.055, wider=0.4)


@pytest.mark.parametrize("wider", [0.1, 0.35])
def test_a_dead_band_that_is_wider_than_the_plant_s_is_released_where_the_recipe_permits_it(wider: float) -> None:
    true = PLANT
    for axis, valve in zip(PLANT.machine.axis_names, VALVES, strict=True):
        band = {"positive": valve.positive + wider, "negative": valve.negative + wider}
        true = true.with_effect(KnownEffect("valve_deadband", axis, band))
    refused, released = moved(swing, true=true), moved(swing, true=true, wider=wider + 0.05)
    assert "moves nothing: its valve, its sensor, or a dead-band" in refused.loop.outcome.why
    assert released.loop.outcome.ended == "done", released.loop.outcome.why
    assert released.loop.supervisor.first_move.done


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "fault"), [row[1:] for row in WIRING], ids=[row[0] for row in WIRING])
@pytest.mark.parametrize("seed", range(3))
def test_wrong_wiring_moves_little_on_machines_that_are_not_as_planned(axis: int, fault: Fault, seed: int) -> None:
    check(axis, fault, off(seed, 0.04), seed, 0.035, 0.07)


@pytest.mark.parametrize("factor", [2.0, 0.5])
@pytest.mark.parametrize("axis", range(4))
def test_a_wrong_gain_is_found_before_the_axis_is_fast(axis: int, factor: float) -> None:
    made = moved(alone(axis), f.Scaled(DRIVEN[axis], factor, STANDS[DRIVEN[axis]]))
    fast, way = slow(made)
    assert made.loop.outcome.ended == "fault"
    assert fast <= 0.15
    assert way <= 0.15


def test_each_says_which_axis_and_what_to_look_at() -> None:
    assert (
        "slew moves against its command: its valve or its sensor is reversed"
        in moved(alone(0), f.ValveTurned(0)).loop.outcome.why
    )
    assert "the command of stick moves nothing" in moved(alone(2), f.ValveDead(2)).loop.outcome.why
    why = moved(alone(3), f.ValvesSwapped(2, 3)).loop.outcome.why
    assert "stick" in why
    assert "swapped" in why


def null(seed: int, mode: Callable[[Limits, ControlChain], Mode]) -> None:
    made = moved(mode, true=off(seed, 0.04), seed=seed)
    outcome = made.loop.outcome
    assert outcome.ended == "done", outcome.why
    assert set(outcome.verdicts) <= {"jerk"}
    assert "first move: released slew after" in outcome.notes[-1]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("mode", [tracking, swing])
def test_machines_that_are_not_quite_as_planned_are_released(seed: int, mode: Callable[[Limits, ControlChain], Mode]) -> None:
    null(seed, mode)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 43))
@pytest.mark.parametrize("mode", [tracking, swing])
def test_no_false_alarm_over_many_machines(seed: int, mode: Callable[[Limits, ControlChain], Mode]) -> None:
    null(seed, mode)


def test_one_axis_at_a_time_until_it_has_answered() -> None:
    made = moved(swing)
    first_move, unanswered = made.loop.supervisor.first_move, 4
    assert first_move.done
    commanded = np.array([cycle.commands != 0.0 for cycle in made.cycles])
    begun = [int(np.flatnonzero(commanded[:, axis])[0]) for axis in range(4)]
    assert len(set(begun)) == unanswered, "each has its own turn"
    speeds = np.array([cycle.setpoints for cycle in made.cycles if cycle.state == "running"])
    ends = Quick(PLANT).predict(speeds)
    early = ends[: round(first_move.released_s.min() / DT)]
    assert np.linalg.norm(np.diff(early, axis=0), axis=1).max() / DT < 0.08


def test_an_axis_that_is_never_asked_to_move_is_said_to_be_unreleased() -> None:
    made = moved(lambda limits, chain: Hold(DT, 1.0))
    assert made.loop.outcome.ended == "done"
    assert "not released slew" in made.loop.outcome.notes[-1]
    assert not made.loop.outcome.verdicts


def test_open_loop_commands_are_reduced_until_the_axis_has_answered() -> None:
    commands = np.zeros((400, 4))
    commands[:, 0] = 0.6
    made = moved(lambda limits, chain: ReplayCommands(commands, limits, DT))
    sent = np.array([cycle.commands[0] for cycle in made.cycles if cycle.source == "replay"])
    assert sent[:50].max() < 0.2
    assert sent[-50:].max() == pytest.approx(0.6)
    assert slow(made)[0] > 0.1, "it was released"
    wrong = moved(lambda limits, chain: ReplayCommands(commands, limits, DT), f.ValveTurned(0))
    assert wrong.loop.outcome.ended == "fault"
    assert slow(wrong)[1] < 0.02


def test_after_a_reset_each_axis_has_to_answer_again() -> None:
    made = case(swing, first_move=True)
    first_move = made.loop.supervisor.first_move
    first_move.begin(MIDDLE, np.array(list(STANDS.values())))
    first_move.skip()
    assert first_move.done
    first_move.begin(MIDDLE, np.array(list(STANDS.values())))
    assert not first_move.released.any()


def test_a_commissioning_is_its_own_first_move() -> None:
    def mode(limits: Limits, chain: ControlChain) -> Mode:
        return Commission(PLANT.machine, made_filter(limits, chain), CommissionSettings(reference=STANDS))

    made = case(mode, first_move=True, settle_s=0.5, seconds=3.0)
    made.loop.warm_up(MIDDLE)
    task = made.loop.mode
    assert isinstance(task, Commission)
    made.loop.run(task.watch)
    assert made.loop.supervisor.first_move.done
    assert not any("first move" in note for note in made.loop.outcome.notes)


def made_filter(limits: Limits, chain: ControlChain):  # type: ignore[no-untyped-def]
    return case(swing).loop.supervisor.command_filter


class Steps:
    """A task of numbers."""

    name, moves, writes, computes = "steps", True, True, True

    def __init__(self) -> None:
        self.asked: list[int] = []

    def begin(self, joints: Array, ee: Array) -> None:
        """Nothing begins."""

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        self.asked.append(k)
        return Goal("steps", target=np.full(3, float(k)), aim=np.full(3, k + 10.0), joints=np.full(2, k**2))


def test_the_clock_of_a_task_slows_down_without_steps() -> None:
    steps = Steps()
    clock, seen = TaskClock(steps), []
    for pace in (1.0, 1.0, 0.5, 0.25, 0.25, 0.0, 0.5, 0.5, 1.0, 1.0):
        seen.append(clock.goal(np.zeros(2), np.zeros(3)))
        clock.advance(pace)
    assert [goal.target[0] for goal in seen] == pytest.approx([0, 1, 2, 2.5, 2.75, 3, 3, 3.5, 4, 5])
    assert [goal.joints[0] for goal in seen] == pytest.approx([0, 1, 4, 6.5, 7.75, 9, 9, 12.5, 16, 25])  # type: ignore[index]
    assert sorted(set(steps.asked)) == list(range(6))


def responses(gain: float, band: float, late: int, sign: float = 1.0, seconds: float = 8.0, seed: int = 0) -> Array:
    """Greatest excess over the range of responses, as time at top speed, (A,) [s]."""
    monitor, rng = ResponseRange(VALVES, DT, Tolerance()), np.random.default_rng(seed)
    noise, fastest = np.array([5e-4, 2e-5, 2e-5, 2e-5]), np.array([valve.fastest for valve in VALVES])
    drive, past, worst = np.zeros(4), [np.zeros(4)] * 60, np.zeros(4)
    for k in range(round(seconds / DT)):
        command = np.zeros(4) if k < 50 else 0.5 * np.sin(2.0 * np.pi * (k - 50) * DT / 3.0) * np.ones(4)
        monitor.measure(drive + noise * rng.standard_normal(4))
        worst = np.maximum(worst, monitor.excess.max(axis=0) / fastest)
        monitor.step(command)
        past = [*past[1:], command]
        for i, valve in enumerate(VALVES):
            u = past[-1 - valve.dead_steps - late][i]
            drive[i] += sign * gain * valve.speed(float(np.sign(u) * max(0.0, abs(u) - band))) * DT
    return worst


@pytest.mark.parametrize(
    ("gain", "band", "late"), [(1.0, 0.0, 0), (0.75, 0.0, 4), (1.4, 0.0, 0), (1.0, 0.07, 2), (0.85, 0.05, 6)]
)
@pytest.mark.parametrize("seed", range(5))
def test_what_machines_like_the_plant_do_is_in_the_range(gain: float, band: float, late: int, seed: int) -> None:
    assert responses(gain, band, late, seed=seed).max() < 0.008


@pytest.mark.parametrize(("gain", "sign"), [(0.0, 1.0), (1.0, -1.0), (3.0, 1.0)])
def test_what_they_do_not_is_outside(gain: float, sign: float) -> None:
    assert responses(gain, 0.0, 0, sign).min() > 0.05
