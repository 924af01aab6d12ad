"""How late a machine answers commands, by its motion: without stamps, and not where only gain, dead-band or play are wrong."""

from __future__ import annotations

import numpy as np
import pytest
from runner_case import DT, MIDDLE, PLANT, case, true_crane
from test_loop import AT, tracking

from sysid.machine import KnownEffect
from sysid.plant import Plant, PlantNumber, Uncertainty
from sysid_rl.control import tune
from sysid_rl.run import faults as f
from sysid_rl.run.checks.settings import BOUNDS, CheckSettings, DelayCheck, MotionCheck
from sysid_rl.run.faults import Injection
from sysid_rl.run.response import ResponseMonitor
from sysid_rl.run.response_range import Tolerance
from sysid_rl.run.valves import axis_valves

VALVES = axis_valves(tune(PLANT), DT)
LATE = f.Delayed(0.2, stamped=False)


def answers(
    late: int,
    gain: float = 1.0,
    band: float = 0.0,
    seconds: float = 6.0,
    play: float = 0.0,
    known: bool = True,
    size: float = 0.5,
) -> list[float]:
    """Seconds of delay found each cycle, 0 where none is, on axes that go to and fro and answer ``late`` cycles late.

    Args:
        play: at top speed [s]; ``known``: to the plant.
        size: of the commands.
    """
    valves = axis_valves(tune(PLANT), DT)
    for valve in valves:
        valve.backlash = play * valve.fastest if known else 0.0
    response, rng = ResponseMonitor(valves, DT, Tolerance()), np.random.default_rng(0)
    drive, read, past, found = np.zeros(4), np.zeros(4), [np.zeros(4)] * 100, []
    width = 0.5 * play * np.array([valve.fastest for valve in valves])
    for k in range(round(seconds / DT)):
        read = np.clip(read, drive - width, drive + width)
        command = size * np.sin(2.0 * np.pi * k * DT / 3.0) * np.ones(4)
        response.measure(read + 1e-4 * np.array([5.0, 0.2, 0.2, 0.2]) * rng.standard_normal(4))
        found.append(max((item.seconds for item in response.late), default=0.0))
        response.step(command)
        past = [*past[1:], command]
        for i, valve in enumerate(VALVES):
            u = past[-1 - valve.dead_steps - late][i]
            drive[i] += gain * valve.speed(float(np.sign(u) * max(0.0, abs(u) - band))) * DT
    return found


@pytest.mark.parametrize("late", [12, 20, 32])
def test_a_late_answer_is_found_and_measured(late: int) -> None:
    found = answers(late)
    first = next(k for k, value in enumerate(found) if value)
    assert first * DT < (1.3 if late >= 20 else 4.0)
    assert np.median([value for value in found if value]) == pytest.approx(late * DT, abs=0.041)


@pytest.mark.parametrize("late", [0, 2, 4])
@pytest.mark.parametrize(("gain", "band"), [(1.0, 0.0), (0.75, 0.0), (1.3, 0.0), (1.0, 0.1), (0.85, 0.06)])
def test_gain_and_dead_band_are_no_delay(late: int, gain: float, band: float) -> None:
    assert not any(answers(late, gain, band))


@pytest.mark.parametrize(("play", "size"), [(0.08, 0.25), (0.1, 0.35), (0.15, 0.5)])
def test_play_that_the_plant_knows_is_no_delay(play: float, size: float) -> None:
    assert not any(answers(0, play=play, size=size))
    assert any(answers(0, play=play, size=size, known=False)), "play that it does not know is taken for a delay"
    assert any(answers(32, play=0.01)), "a late answer is found beside it"


def test_the_tolerance_is_that_of_the_recipe_and_of_what_the_plant_knows() -> None:
    settings = CheckSettings(delay=DelayCheck(after_s=0.1), motion=MotionCheck(wider=0.2))
    assert Tolerance.of(PLANT, settings) == Tolerance(0.1, 0.2)
    plant = PLANT.with_effect(KnownEffect("input_delay", "boom", {"delay": 0.05}))
    places = (PlantNumber("input_delay", "boom", None, "delay"), PlantNumber("valve_deadband", "slew", None, "positive"))
    known = plant.with_uncertainty(Uncertainty(places, np.diag([0.01**2, 0.02**2])))
    found = Tolerance.of(known, settings)
    assert (found.delay_s, found.wider) == pytest.approx((0.13, 0.26))
    certain = Tolerance.of(plant.with_uncertainty(Uncertainty(places, np.diag([1.0, 1.0]))), settings)
    assert (certain.delay_s, certain.wider) == (BOUNDS["delay.after_s"].most, BOUNDS["motion.wider"].most)


def test_readings_that_do_not_come_are_no_delay() -> None:
    response = ResponseMonitor(VALVES, DT, Tolerance())
    for k in range(200):
        response.measure(np.full(4, np.nan if k % 3 else 0.0))
        response.step(np.full(4, 0.5))
    assert response.late == ()


@pytest.mark.parametrize("true", [PLANT, true_crane(1)], ids=["as planned", "other gains and play"])
@pytest.mark.parametrize("begin", [0.0, AT])
def test_a_whole_line_that_is_late_without_stamps_stops_the_machine(true: Plant, begin: float) -> None:
    """It went on, up to 140 mm off its path."""
    made = case(tracking, true=true, plan=(Injection(LATE, begin),))
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    ends = np.array(made.machine.ends)
    speed = np.linalg.norm(np.diff(ends, axis=0), axis=1) / DT
    moving = max(int(np.argmax(speed > 0.005)), round(begin / DT))
    assert made.loop.outcome.ended == "fault"
    assert "the line is late" in made.loop.outcome.why
    assert (min(made.verdicts().get(check, 10**6) for check in ("delay", "motion")) - moving) * DT < 1.1
    off = [np.linalg.norm(ends[k.number + 1] - k.target) for k in made.cycles if k.enabled and np.isfinite(k.target).all()]
    assert max(off) < 0.075


def test_a_machine_that_is_not_as_planned_is_not_late() -> None:
    rng = np.random.default_rng(5)
    plant = true_crane(5)
    for axis, valve in zip(plant.machine.axis_names, VALVES, strict=True):
        bands = {name: max(0.0, getattr(valve, name) + float(rng.uniform(-0.06, 0.06))) for name in ("positive", "negative")}
        plant = plant.with_effect(KnownEffect("valve_deadband", axis, bands))
    made = case(tracking, true=plant)
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    assert made.loop.outcome.ended == "done"
    assert "delay" not in made.verdicts()
