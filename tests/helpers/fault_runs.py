"""Random runs of the sample crane with random faults: whatever happens, it stays inside its limits and its fence."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from runner_case import MIDDLE, PLANT, Case, Quick, case, true_crane

from sysid_rl.run import faults as f
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.faults import Injection
from sysid_rl.run.limits import AxisLimits, Limits, LimitSettings
from sysid_rl.run.modes.mode import Goal

Array = npt.NDArray[np.float64]
SIGNALS = ("slew.joint", "boom.cylinder", "stick.cylinder", "telescope.joint", "boom.joint", "stick.joint")
RANGES = {
    "slew.joint": 5.2,
    "boom.cylinder": 0.1,
    "stick.cylinder": 0.13,
    "telescope.joint": 0.25,
    "boom.joint": 1.6,
    "stick.joint": 2.4,
}
#: Truth may be this far outside [m, rad]: rounding, not motion.
TOUCH = 1e-6


class Wild:
    """Asks for anything: targets and joints that jump, extremes, no numbers, or valves wide open."""

    name, moves, writes, computes = "wild", True, True, True

    def __init__(self, rng: np.random.Generator, limits: Limits) -> None:
        self._rng, self._limits = rng, limits
        self._kind = str(rng.choice(["joints", "commands", "target", "corner"]))
        self._goal = Goal("wild")

    def begin(self, joints: Array, ee: Array) -> None:
        self._new(joints, ee)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        if k and k % 40 == 0:
            self._new(joints, ee)
        return self._goal

    def _new(self, joints: Array, ee: Array) -> None:
        rng, of = self._rng, self._limits
        if self._kind == "commands":
            values = rng.choice([-1.0, 1.0, 0.0, 2.0, np.nan], 4, p=[0.4, 0.4, 0.1, 0.05, 0.05])
            self._goal = Goal("wild", commands=values)
        elif self._kind == "target":
            aim = ee + rng.normal(0.0, 0.4, 3)
            self._goal = Goal("wild", target=aim, aim=aim)
        else:
            span = of.hard_high - of.hard_low
            wanted = (
                rng.choice([of.hard_low - span, of.hard_high + span])
                if self._kind == "corner"
                else rng.uniform(of.hard_low, of.hard_high)
            )
            self._goal = Goal("wild", joints=np.array(wanted))


def injection(rng: np.random.Generator) -> Injection:
    """Any fault, somewhere in the run."""
    signal = str(rng.choice(SIGNALS))
    some = tuple(rng.choice(SIGNALS, int(rng.integers(1, 4)), replace=False).tolist()) if rng.random() < 0.5 else ()
    far = RANGES[signal]
    kinds: list[Any] = [
        f.DroppedFrames(some), f.Frozen(signal), f.Delayed(float(rng.choice([0.05, 0.2])), some, bool(rng.random() < 0.5)),
        f.NotANumber(signal), f.Jumped(signal, float(rng.choice([-1, 1]) * rng.uniform(0.005, 0.5) * far)),
        f.Scaled(signal, float(rng.choice([0.5, 0.8, 0.9, 1.1, 1.25, 2.0, -1.0]))), f.Unplugged(signal),
        f.BusOff(bool(rng.random() < 0.5)), f.WritesLost(), f.Paused(float(rng.choice([0.03, 0.09, 0.3, 1.0]))),
        f.ClockJumped(float(rng.choice([-1.0, -0.05, 0.05, 1.0]))), f.DeadManReleased(), f.EmergencyPressed(),
        f.MachineReportsFault(),
    ]  # fmt: skip
    begin = float(rng.uniform(0.4, 1.6))
    length = float(rng.choice([0.01, 0.05, 0.2, 10.0]))
    return Injection(kinds[int(rng.integers(len(kinds)))], begin, begin + length)


def fault_run(seed: int) -> tuple[Case, dict[str, float]]:
    """One run, and how far the machine was inside each bound at its worst (negative: outside)."""
    rng = np.random.default_rng([seed, 77])
    half = rng.uniform(0.15, 0.5, 3)
    low, high = Quick(PLANT).low, Quick(PLANT).high
    start = np.clip(MIDDLE + rng.uniform(-0.3, 0.3, 4) * (high - low), low + 0.08 * (high - low), high - 0.08 * (high - low))
    ee = Quick(PLANT).predict(start)[0]
    box = {letter: (float(ee[k] - half[k]), float(ee[k] + half[k])) for k, letter in enumerate("xyz")}
    narrow = {}
    if rng.random() < 0.5:  # an end stop close by
        room = 0.12 * (high[0] - low[0])
        narrow["slew"] = AxisLimits(low=float(max(low[0], start[0] - room)), high=float(min(high[0], start[0] + room)))
    limits = LimitSettings(fence=box if rng.random() < 0.7 else {}, axes=narrow)
    plan = tuple(injection(rng) for _ in range(int(rng.integers(1, 3))))

    def mode(bounds: Limits, chain: ControlChain) -> Wild:
        return Wild(rng, bounds)

    run = case(mode, start=start, true=true_crane(int(rng.integers(1000))), plan=plan, limits=limits, seed=seed, seconds=2.2)
    run.loop.run()
    joints, ends = np.array(run.machine.joints), np.array(run.machine.ends)
    of, fence = run.limits, run.limits.hard_fence
    room = {"joints": float(np.minimum(joints - of.hard_low, of.hard_high - joints).min())}
    if limits.fence:
        room["fence"] = float(np.minimum(ends - fence[0], fence[1] - ends).min())
    return run, room
