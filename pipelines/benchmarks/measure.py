"""One measurement in a process of its own, so that its cores can be chosen: the last line of its output is the result as JSON.

.venv/bin/python pipelines/benchmarks/measure.py rollout|lanes|environment|first_run [REPEATS]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.crane import FOLDER, RATE, commands, crane, joint_speeds, middle, recorded
from benchmarks.rows import in_turns, seconds
from sysid.cores import cores
from sysid.datasets import Recording
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant, free_run
from sysid.plant.stepper import Stepper

Array = npt.NDArray[np.float64]

HOUR = 3600.0
#: PyBullet is called a step at a time from Python: it gets this part of the hour.
BULLET_PART = 300.0
LANES, LANE_SECONDS = 64, 600.0
#: MuJoCo's lanes are cut to this length.
MUJOCO_PART = 120.0
ENVIRONMENTS, STEPS = 256, 500
#: PyBullet steps one environment so often.
BULLET_STEPS = 5000


def rollout(repeats: int) -> dict[str, Any]:
    """The hour of all axes in one lane, in seconds."""
    from benchmarks.peers import BulletCrane, MujocoCrane, must_follow

    plant = crane()
    machine, hour = plant.machine, recorded(plant, HOUR)
    commanded = commands(HOUR) * joint_speeds(machine)
    part = commanded[: round(BULLET_PART * RATE)]
    mujoco, bullet = (
        MujocoCrane(machine, RATE, middle(machine), 1),
        BulletCrane(machine, str(FOLDER / "autolog.urdf"), RATE, middle(machine)),
    )
    settled = slice(round(5.0 * RATE), len(part))
    must_follow("MuJoCo", part[settled], mujoco.driven_speeds(mujoco.rollout(part)[0])[settled])
    must_follow("PyBullet", part[settled], bullet.run(part)[settled, 4:8])
    taken = in_turns(
        {
            "ours": lambda: free_run(plant, hour),
            "mujoco": lambda: mujoco.rollout(commanded),
            "pybullet": lambda: bullet.run(part),
        },
        repeats,
    )
    mujoco.close(), bullet.close()
    scaled = [HOUR / BULLET_PART * t for t in taken["pybullet"]]
    return {**taken, "pybullet": scaled, "effects": len(plant.effects), "resting": resting(plant, hour)}


def lanes(repeats: int) -> dict[str, Any]:
    """Candidates through every stage of the plant, in seconds."""
    from benchmarks.peers import MujocoCrane

    plant = crane()
    machine, log = plant.machine, recorded(plant, LANE_SECONDS)
    model, thetas = compile_plant(plant), candidates(plant)

    def stages() -> None:
        for axis in machine.axes:
            model.drive(thetas, log, axis.name)
            if axis.drives == "cylinder":
                model.joint(thetas, log, axis.name)
        model.tip(thetas, log)
        model.tool(thetas, log)

    mujoco = MujocoCrane(machine, RATE, middle(machine), cores())
    commanded = commands(MUJOCO_PART) * joint_speeds(machine)
    taken = in_turns({"ours": stages, "mujoco": lambda: mujoco.rollout(commanded, LANES)}, repeats)
    mujoco.close()
    return {**taken, "mujoco": [LANE_SECONDS / MUJOCO_PART * t for t in taken["mujoco"]]}


def environment(repeats: int) -> dict[str, Any]:
    """Steps of all environments under commands that change at every step, in seconds."""
    from benchmarks.peers import BulletCrane, MujocoCrane

    plant = crane()
    machine = plant.machine
    commanded = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, ENVIRONMENTS, len(machine.axes)))
    speeds = commanded * joint_speeds(machine)
    alone = np.resize(speeds, (BULLET_STEPS, len(machine.axes)))
    stepper = Stepper(plant, RATE, ENVIRONMENTS)
    stepper.reset(middle(machine))

    def steps() -> None:
        for command in commanded:
            stepper.step(command)

    mujoco = MujocoCrane(machine, RATE, middle(machine), cores())
    bullet = BulletCrane(machine, str(FOLDER / "autolog.urdf"), RATE, middle(machine))
    taken = in_turns(
        {"ours": steps, "mujoco": lambda: mujoco.step_by_step(speeds), "pybullet": lambda: bullet.run(alone)}, repeats
    )
    mujoco.close(), bullet.close()
    factor = ENVIRONMENTS * STEPS / BULLET_STEPS / cores()
    return {**taken, "pybullet": [factor * t for t in taken["pybullet"]]}


def first_run(repeats: int) -> dict[str, Any]:
    """The first free run of this process, then the same again, in seconds."""
    plant = crane()
    return {"first": seconds(lambda: recorded(plant, 60.0)), "again": seconds(lambda: recorded(plant, 60.0))}


def candidates(plant: Plant) -> Array:
    """Parameter vectors of plants that differ in their lags, (LANES, N)."""
    rng, axes = np.random.default_rng(1), plant.machine.axis_names
    found = []
    for _ in range(LANES):
        other = plant
        for axis in axes:
            lag = {"time_constant": float(rng.uniform(0.03, 0.1))}
            other = other.with_effect(KnownEffect("first_order_lag", axis, lag))
        found.append(other.vector())
    return np.array(found)


def resting(plant: Plant, recording: Recording) -> float:
    """The largest share of samples that an axis rests at an end stop: a plant that does not move would be no measurement."""
    shares = []
    for axis in plant.machine.axes:
        values, (low, high) = recording.values(axis.driven), axis.range
        near = 0.002 * (high - low)
        shares.append(float(np.mean((values < low + near) | (values > high - near))))
    return max(shares)


WORKS: dict[str, Callable[[int], dict[str, Any]]] = {
    "rollout": rollout,
    "lanes": lanes,
    "environment": environment,
    "first_run": first_run,
}

if __name__ == "__main__":
    print(json.dumps(WORKS[sys.argv[1]](int(sys.argv[2]) if len(sys.argv) > 2 else 1)))
