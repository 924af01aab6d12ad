"""The machines of the fleet study: what differs and what drifts, drawn from a seed, and their logs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from simulated_bench.joint_machines import write_joint_machine
from simulated_bench.joint_recipe import ServoArm, ServoAxis, Take
from simulated_bench.servo_arm import run_servo_arm
from sysid.datasets import Recording

#: Hidden parameter → effect and parameter by which it is named.
NAMED = {
    "backlash": ("backlash", "width"),
    "delay": ("input_delay", "delay"),
    "time_constant": ("first_order_lag", "time_constant"),
}
#: Values of the type [rad, s, s]; standard deviations between machines that do not differ, and between recordings.
TYPE = {"backlash": 6e-3, "delay": 0.03, "time_constant": 0.05}
BETWEEN = {"backlash": 2e-5, "delay": 2e-4, "time_constant": 2e-4}
SCATTER = {"backlash": 5e-5, "delay": 1e-4, "time_constant": 1e-4}
#: Changes that are negligible in practice, from the catalogue of effects.
NEGLIGIBLE = {"backlash": 2e-4, "delay": 5e-3, "time_constant": 5e-3}
#: Detection limit of a single value, in standard deviations (Currie, Anal. Chem. 40 (1968), 586: 5 % of both errors).
CURRIE = 3.29

MACHINES, DIFFERING, DRIFTING = 20, 8, 10
#: Recordings at the beginning, from which effects are named; before a drift; after its beginning; of a machine without one.
FIRST, BEFORE, DURING, STABLE = 8, 30, 90, 60
SECONDS, RATE, NOISE = 20.0, 50.0, 1e-4


@dataclass(frozen=True)
class HiddenDrift:
    """A parameter that changes: at once, or by a constant rate. ``rate``: per recording; ``step``: at the beginning."""

    parameter: str
    step: float
    rate: float

    def change(self, since: int) -> float:
        """The change in the recording ``since`` the beginning (0: the first one)."""
        return 0.0 if since < 0 else self.step + self.rate * (since + 0.5)


@dataclass(frozen=True)
class HiddenMachine:
    """One machine: its values, the parameter by which it differs from the type, and the one that drifts."""

    number: int
    values: dict[str, float]
    differs: str | None
    drift: HiddenDrift | None

    @property
    def name(self) -> str:
        return f"servo-{self.number:02d}"

    @property
    def later(self) -> int:
        """Recordings after the first ones."""
        return STABLE if self.drift is None else BEFORE + DURING

    def at(self, recording: int, draw: np.random.Generator) -> dict[str, float]:
        """Values in a recording, counted from the first one."""
        found = {key: value + draw.normal(0.0, SCATTER[key]) for key, value in self.values.items()}
        if self.drift is not None:
            found[self.drift.parameter] += self.drift.change(recording - FIRST - BEFORE)
        return found


def sealed(seed: int) -> list[HiddenMachine]:
    """The machines of one fleet."""
    rng = np.random.default_rng(seed)
    differing = {int(k): list(NAMED)[i % 3] for i, k in enumerate(rng.permutation(MACHINES)[:DIFFERING])}
    drifting = {int(k): i for i, k in enumerate(rng.permutation(MACHINES)[:DRIFTING])}
    machines = []
    for number in range(MACHINES):
        values = {key: value + rng.normal(0.0, BETWEEN[key]) for key, value in TYPE.items()}
        differs = differing.get(number)
        if differs is not None:
            values[differs] += rng.choice([-1, 1]) * rng.uniform(2.0, 4.0) * NEGLIGIBLE[differs]
        drift = None
        if number in drifting:
            which = drifting[number]
            parameter = list(NAMED)[which % 3]
            limit = max(NEGLIGIBLE[parameter], CURRIE * SCATTER[parameter])
            if which % 2 == 0:  # grows, and reaches its limit after 3 to 15 minutes of motion
                drift = HiddenDrift(parameter, 0.0, limit / (rng.uniform(3.0, 15.0) * 60.0 / SECONDS))
            else:
                drift = HiddenDrift(parameter, rng.uniform(1.2, 3.0) * limit, 0.0)
        machines.append(HiddenMachine(number, values, differs, drift))
    return machines


def arm_at(machine: HiddenMachine, recording: int, seed: int) -> ServoArm:
    """The machine as it is in one recording, which is its only one."""
    draw = np.random.default_rng([seed, machine.number, recording])
    axis = ServoAxis("shoulder", (-0.5, 1.5), 0.3, 1.0, **machine.at(recording, draw))
    take = Take(f"run-{recording:03d}", recording, SECONDS)
    return ServoArm("servo_arm", "arm", 1000 * seed + machine.number, (axis,), (take,), rate=RATE, noise=NOISE)


def write_first(machine: HiddenMachine, folder: Path, seed: int) -> Path:
    """Logs of the beginning, with ``machine.toml``."""
    for recording in range(FIRST):
        write_joint_machine(arm_at(machine, recording, seed), folder)
    return folder


def later(machine: HiddenMachine, seed: int) -> list[Recording]:
    """What follows, on the machine's grid, with the noise of the logs."""
    found = []
    for number in range(FIRST, FIRST + machine.later):
        arm = arm_at(machine, number, seed)
        (take,) = arm.recordings
        time, setpoint, joints = run_servo_arm(arm, take)
        noise = np.random.default_rng([arm.seed, take.seed, 1]).standard_normal(joints.shape)
        measured = joints[:, 0] + arm.noise * noise[:, 0]
        table = pd.DataFrame({"time": time, "shoulder.command": setpoint[:, 0], "shoulder.joint": measured})
        found.append(Recording(take.name, table, arm.rate))
    return found
